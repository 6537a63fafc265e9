"""Sweet Home 3D furniture libraries (`.sh3f`): a zip of a properties file and OBJ models, y up, cm."""

from __future__ import annotations

import hashlib
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dssmsg.errors import InputError
from dssmsg.frame import FloatArray
from dssmsg.sim.furniture.wavefront import read_obj
from dssmsg.sim.mesh import Mesh

PROPERTIES = "PluginFurnitureCatalog.properties"
CONVERTER_VERSION = 3
"""Raised when a conversion gives another mesh for the same file: it is part of the cache key."""

_LINE = re.compile(r"(\w+)#(\d+)\s*[=:]\s*(.*)")
_ESCAPE = re.compile(r"\\(?:u([0-9a-fA-F]{4})|(.))")
_OBJECT_FROM_MODEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Their x right, y up, front +z; ours x right, z up, front -y."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One model of a library. `model` is `<library>/<id>`; size (x, y, z) and elevation in metres."""

    model: str
    name: str
    archive: Path
    member: str
    size: tuple[float, float, float]
    elevation: float
    rotation: tuple[float, ...] | None
    credit: str


def read_catalogue(archive: Path) -> dict[str, Entry]:
    """The models of an `.sh3f` file, by `<library>/<id>`.

    Raises InputError when the file is no such library.
    """
    try:
        with zipfile.ZipFile(archive) as content:
            text = content.read(PROPERTIES).decode("latin-1")
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(
            f"expected a .sh3f furniture library, a zip with {PROPERTIES} ({error})", file=archive
        ) from None
    rows: dict[int, dict[str, str]] = {}
    licence = "licence not stated"
    for line in text.splitlines():
        found = _LINE.match(line.strip())
        if found:
            rows.setdefault(int(found[2]), {})[found[1]] = _unescape(found[3].strip())
        elif line.startswith("license="):
            licence = _short_licence(_unescape(line.partition("=")[2]))
    entries = {}
    for row in rows.values():
        try:
            model = f"{archive.stem}/{row['id'].rsplit('#', 1)[-1]}"
            width, depth, height = (float(row[key]) / 100 for key in ("width", "depth", "height"))
            rotation = (
                tuple(float(x) for x in row["modelRotation"].split()) if "modelRotation" in row else None
            )
            elevation = float(row.get("elevation") or 0) / 100
            member = row["model"].lstrip("/")
        except (KeyError, ValueError):  # one incomplete row must not cost the library
            continue
        author, terms = row.get("creator", "unknown"), row.get("license", licence)
        credit = f"{row['name']} by {author} ({archive.stem}), {terms}"
        entries[model] = Entry(
            model, row["name"], archive, member, (width, depth, height), elevation, rotation, credit
        )
    return entries


def convert(entry: Entry) -> Mesh:
    """The entry's mesh in the object frame at catalogue size. Raises InputError when it cannot be read."""
    with zipfile.ZipFile(entry.archive) as content:
        names = {name.lower(): name for name in content.namelist()}

        def read(path: str) -> bytes | None:
            name = names.get(path.lower())
            return None if name is None else content.read(name)

        mesh = read_obj(entry.member, read)
    turn: FloatArray = np.eye(3) if entry.rotation is None else np.array(entry.rotation).reshape(3, 3)
    return mesh.transformed(_OBJECT_FROM_MODEL @ turn).scaled_to(entry.size)


def cache_key(entry: Entry) -> str:
    """A digest of everything `convert` depends on, without unpacking (the zip's check sums stand for it)."""
    digest = hashlib.sha256(repr((CONVERTER_VERSION, entry.member, entry.size, entry.rotation)).encode())
    folder = entry.member.rpartition("/")[0]
    with zipfile.ZipFile(entry.archive) as content:
        for info in sorted(content.infolist(), key=lambda info: info.filename):
            if info.filename.startswith(folder):
                digest.update(repr((info.filename, info.CRC, info.file_size)).encode())
    return digest.hexdigest()[:32]


def _unescape(text: str) -> str:
    """Java properties escapes."""
    return _ESCAPE.sub(lambda m: chr(int(m[1], 16)) if m[1] else m[2], text)


def _short_licence(text: str) -> str:
    if "public domain" in text.lower():
        return "public domain (CC0)"
    return "CC BY 3.0" if "attribution 3.0" in text.lower() else text
