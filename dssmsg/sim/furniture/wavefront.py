"""A reader of Wavefront OBJ/MTL as furniture catalogues use it: polygons, materials, texture maps.

Flaws that occur in the wild do not stop it: a material that is not defined is grey, a texture that is
missing or unreadable, or a face without texture coordinates, falls back to the material's plain colour.
"""

from __future__ import annotations

import io
import posixpath
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from dssmsg.errors import InputError
from dssmsg.frame import ByteArray, FloatArray, IntArray
from dssmsg.sim.mesh import Mesh
from dssmsg.sim.texture import power_of_two

Point = tuple[float, float]
ReadMember = Callable[[str], bytes | None]
"""Content of an archive member by its path, None where there is none."""

INVISIBLE_BELOW = 0.05
"""Materials that are more transparent than this are left out: helper geometry, not glass."""


MAX_WRAPS = 1000
"""A face around which a texture wraps more often has damaged coordinates."""


@dataclass(frozen=True, slots=True)
class _Material:
    color: tuple[float, float, float] = (0.7, 0.7, 0.7)
    opacity: float = 1.0
    texture: str | None = None


def read_obj(path: str, read: ReadMember) -> Mesh:
    """The mesh at `path` in the file's own axes and units.

    Raises InputError when the file is missing, or holds no visible face.
    """
    data = read(path)
    if data is None:
        raise InputError("the archive has no such model", file=path)
    vertices: list[list[float]] = []
    coordinates: list[list[float]] = []
    materials: dict[str, _Material] = {}
    corners: list[tuple[int, int, int]] = []
    uv_corners: list[tuple[int, int, int]] = []
    owners: list[str] = []
    current = ""
    for line in _lines(data):
        key, _, rest = line.partition(" ")
        if key == "v":
            vertices.append([float(x) for x in rest.split()[:3]])
        elif key == "vt":
            coordinates.append([float(x) for x in [*rest.split(), "0"][:2]])
        elif key == "f":
            points, uvs = _corners(rest.split(), len(vertices), len(coordinates))
            for a, b, c in triangulate(points, vertices):
                corners.append((points[a], points[b], points[c]))
                uv_corners.append((uvs[a], uvs[b], uvs[c]))
                owners.append(current)
        elif key == "usemtl":
            current = rest.strip()
        elif key == "mtllib":
            materials |= _read_mtl(posixpath.join(posixpath.dirname(path), rest.strip()), read)
    if not corners:
        raise InputError("the model holds no face", file=path)
    return _assemble(
        np.array(vertices), np.array(corners), np.array(coordinates).reshape(-1, 2), np.array(uv_corners),
        owners, materials, read, path,
    )  # fmt: skip


def triangulate(points: Sequence[int], vertices: Sequence[Sequence[float]]) -> list[tuple[int, int, int]]:
    """Split a polygon (indices into `vertices`) into triangles of places in `points`, by ear clipping."""
    count = len(points)
    if count < 3:
        return []
    if count == 3:
        return [(0, 1, 2)]
    corner = [vertices[i] for i in points]
    normal = [0.0, 0.0, 0.0]  # by Newell: robust for bent polygons too
    for (ax, ay, az), (bx, by, bz) in zip(corner, [*corner[1:], corner[0]], strict=True):
        normal[0] += (ay - by) * (az + bz)
        normal[1] += (az - bz) * (ax + bx)
        normal[2] += (ax - bx) * (ay + by)
    drop = max(range(3), key=lambda axis: abs(normal[axis]))
    across, up = ((1, 2), (2, 0), (0, 1))[drop]
    if normal[drop] < 0:
        across, up = up, across
    flat = [(point[across], point[up]) for point in corner]
    if all(_turn(flat[i - 2], flat[i - 1], flat[i]) >= 0 for i in range(count)):  # convex, as most are
        return [(0, i, i + 1) for i in range(1, count - 1)]
    left = list(range(count))
    triangles: list[tuple[int, int, int]] = []
    while len(left) > 3:
        for i in range(len(left)):
            a, b, c = left[i - 1], left[i], left[(i + 1) % len(left)]
            if _turn(flat[a], flat[b], flat[c]) > 0 and not any(
                _inside(flat[p], flat[a], flat[b], flat[c]) for p in left if p not in (a, b, c)
            ):
                triangles.append((a, b, c))
                del left[i]
                break
        else:  # degenerate outline: a fan is as good as anything
            return triangles + [(left[0], left[i], left[i + 1]) for i in range(1, len(left) - 1)]
    return [*triangles, (left[0], left[1], left[2])]


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _inside(p: Point, a: Point, b: Point, c: Point) -> bool:
    return _turn(a, b, p) >= 0 and _turn(b, c, p) >= 0 and _turn(c, a, p) >= 0


def _lines(data: bytes) -> list[str]:
    text = (
        data.decode("utf-8", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ").replace("\t", " ")
    )
    return [line.strip() for line in text.splitlines()]


def _corners(words: list[str], vertex_count: int, uv_count: int) -> tuple[list[int], list[int]]:
    """Zero-based vertex and texture indices of a face line; -1 for a corner without texture coordinates."""
    points, uvs = [], []
    for word in words:
        parts = word.split("/")
        point = int(parts[0])
        point = point - 1 if point > 0 else vertex_count + point
        if not 0 <= point < vertex_count:
            continue
        uv = int(parts[1]) if len(parts) > 1 and parts[1] else 0
        uv = uv - 1 if uv > 0 else uv_count + uv if uv < 0 else -1
        points.append(point)
        uvs.append(uv if 0 <= uv < uv_count else -1)
    return points, uvs


def _read_mtl(path: str, read: ReadMember) -> dict[str, _Material]:
    materials: dict[str, _Material] = {}
    name = None
    for line in _lines(read(path) or b""):
        key, _, rest = line.partition(" ")
        if key == "newmtl":
            name = rest.strip()
            materials[name] = _Material()
        if name is None:
            continue
        if key == "Kd":
            red, green, blue = (float(x) for x in rest.split()[:3])
            materials[name] = replace(materials[name], color=(red, green, blue))
        elif key in ("d", "Tr") and rest.split():
            value = float(rest.split()[-1])
            materials[name] = replace(materials[name], opacity=value if key == "d" else 1 - value)
        elif key == "map_Kd" and rest.split():
            # Options ("-s 1 1 1") may come first; file names may hold spaces.
            file = rest.strip() if not rest.strip().startswith("-") else rest.split()[-1]
            texture = posixpath.normpath(posixpath.join(posixpath.dirname(path), file.replace("\\", "/")))
            materials[name] = replace(materials[name], texture=texture)
    return materials


def read_texture(data: bytes | None) -> ByteArray | None:
    """An image file as (H, W, 3) uint8 with power-of-two sides, or None if it cannot be read.

    Transparent texels take the mean colour of the others: the camera does not see through leaves.
    """
    if data is None:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of odd palettes, which convert all the same
            image = Image.open(io.BytesIO(data)).convert("RGBA")
            image = image.resize(
                (power_of_two(image.width), power_of_two(image.height)), Image.Resampling.BOX
            )
    except (OSError, ValueError, SyntaxError):
        return None
    pixels = np.asarray(image)
    color = pixels[..., :3].copy()
    hidden = pixels[..., 3] < 128
    if hidden.any() and not hidden.all():
        color[hidden] = np.rint(color[~hidden].mean(axis=0))
    return color


def _assemble(
    vertices: FloatArray, corners: np.ndarray, coordinates: FloatArray, uv_corners: np.ndarray,
    owners: list[str], materials: dict[str, _Material], read: ReadMember, path: str,
) -> Mesh:  # fmt: skip
    names = sorted(set(owners))
    used = [materials.get(name, _Material()) for name in names]
    place = {name: i for i, name in enumerate(names)}
    owner = np.array([place[name] for name in owners])
    files = sorted({m.texture for m in used if m.texture})
    images = {file: read_texture(read(file)) for file in files}
    textures = tuple(image for file in files if (image := images[file]) is not None)
    order = {file: i for i, file in enumerate(f for f in files if images[f] is not None)}
    link = np.array([order.get(m.texture, -1) if m.texture else -1 for m in used], np.int32)
    colors = np.clip(np.rint(np.array([m.color for m in used]) * 255), 0, 255).astype(np.uint8)
    textured = (uv_corners >= 0).all(axis=1) & (link[owner] >= 0)
    for i, material in enumerate(used):  # a textured material's own colour is often just white
        if material.texture and (image := images[material.texture]) is not None:
            colors[i] = np.rint(image.reshape(-1, 3).mean(axis=0))
    uv = np.zeros((len(corners), 3, 2), np.float32)
    if len(coordinates):
        uv[textured] = coordinates[uv_corners[textured]]
        uv = uv - np.floor(uv.min(axis=1, keepdims=True))  # whole turns cost float32 digits
        damaged = ~(uv.max(axis=(1, 2)) < MAX_WRAPS)
        textured &= ~damaged
        uv[damaged] = 0.0
    shown = np.array([m.opacity >= INVISIBLE_BELOW for m in used])[owner]
    corner = vertices[corners]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    shown &= (area > 0) & np.isfinite(corner).all(axis=(1, 2))
    if not shown.any():
        raise InputError("the model holds no visible face", file=path)
    kept, faces = np.unique(corners[shown], return_inverse=True)
    links = np.where(textured, link[owner], -1)[shown].astype(np.int32)
    points, colors = vertices[kept].astype(np.float32), colors[owner[shown]]
    triangles: IntArray = faces.reshape(-1, 3).astype(np.int32)
    if (links < 0).all():
        return Mesh(points, triangles, colors)
    return Mesh(points, triangles, colors, uv[shown], links, textures)
