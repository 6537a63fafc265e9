"""Which layout a folder is in, and reading it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from dssmsg.errors import InputError
from dssmsg.sequences import record3d, redwood, replica, scannet, sevenscenes, tum
from dssmsg.sequences.sequence import Sequence


@dataclass(frozen=True, slots=True)
class Layout:
    """A layout by name: the files it is known by, its test and its reader."""

    name: str
    signature: str
    matches: Callable[[Path], bool]
    read: Callable[[Path], Sequence]


def _layout(module: ModuleType) -> Layout:
    return Layout(module.NAME, module.SIGNATURE, module.matches, module.read)


LAYOUTS: Mapping[str, Layout] = {
    layout.name: layout for layout in map(_layout, (tum, replica, record3d, scannet, redwood, sevenscenes))
}


def find_layout(folder: Path) -> Layout | None:
    """The first layout that the folder matches."""
    return next((layout for layout in LAYOUTS.values() if layout.matches(folder)), None)


def read_folder(folder: Path, layout: str = "auto", *, key: str | None = None) -> Sequence:
    """Read a folder in the named layout (`auto`: find out which).

    Raises InputError naming the folder (and `key`, the option it came from) if it is missing, in no known
    layout, or without colour images, depth images or a single valid pose.
    """
    if not folder.is_dir():
        what = "is a file; unpack it and name the folder" if folder.exists() else "there is no such folder"
        raise InputError(what, file=folder, key=key)
    try:
        chosen = find_layout(folder) if layout == "auto" else LAYOUTS[layout]
        if chosen is None:
            raise InputError(_unknown(folder), file=folder, key=key)
        if not chosen.matches(folder):
            raise InputError(f"not in the {layout} layout: expected {chosen.signature}", file=folder, key=key)
        sequence = chosen.read(folder)
    except OSError as error:
        raise InputError(
            f"cannot be read: {error.strerror}", file=error.filename or folder, key=key
        ) from None
    for missing, what in (
        (not sequence.views, "colour images"),
        (all(view.depth is None for view in sequence.views), "depth images that go with the colour images"),
        (all(view.world_from_camera is None for view in sequence.views), "finite, rigid poses"),
    ):
        if missing:
            raise InputError(f"no {what} ({chosen.name} layout: {chosen.signature})", file=folder, key=key)
    return sequence


def _unknown(folder: Path) -> str:
    try:
        inner = next((p for p in sorted(folder.iterdir()) if p.is_dir() and find_layout(p)), None)
        empty = not any(folder.iterdir())
    except OSError:
        inner, empty = None, False
    if empty:
        return "the folder is empty"
    if inner is not None:
        return f"no sequence here, but one in {inner.name}/: name that folder"
    known = "; ".join(f"{layout.name}: {layout.signature}" for layout in LAYOUTS.values())
    return f"no known layout. Known are {known}"
