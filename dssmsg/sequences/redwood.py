"""Redwood and Open3D: colour and depth folders with a trajectory `.log`.

A log entry is a line of three integers (the first is the frame's place in the folder, from 0) and a 4x4
camera-to-world matrix, OpenCV axes. Depth is 16-bit millimetres. Intrinsics from a JSON with
`intrinsic_matrix` (9 numbers, column by column), else the PrimeSense defaults. Up is not promised.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from dssmsg.errors import InputError
from dssmsg.frame import FloatArray
from dssmsg.sequences.poses import parse_numbers, read_text, rigid_or_none
from dssmsg.sequences.sequence import (
    COLOR_SUFFIXES,
    DEPTH_SUFFIXES,
    Intrinsics,
    Sequence,
    View,
    numbered_files,
)

NAME = "redwood"
SIGNATURE = "color/ (or image/, rgb/), depth/, trajectory.log"
_COLOR_FOLDERS = ("color", "image", "images", "rgb")
_PRIMESENSE: Intrinsics = (525.0, 525.0, 319.5, 239.5)


def matches(folder: Path) -> bool:
    """Whether the folder is in this layout."""
    return _log(folder) is not None and (folder / "depth").is_dir() and _colors(folder) is not None


def read(folder: Path) -> Sequence:
    """Where everything lies in a Redwood folder."""
    log, color_folder = _log(folder), _colors(folder)
    if log is None or color_folder is None:
        raise InputError(f"not in the {NAME} layout: expected {SIGNATURE}", file=folder)
    poses = _read_log(log)
    depths = list(numbered_files(folder / "depth", DEPTH_SUFFIXES).values())
    views = tuple(
        View(color, depths[place] if place < len(depths) else None, poses.get(place))
        for place, color in enumerate(numbered_files(color_folder, COLOR_SUFFIXES).values())
    )
    own = _intrinsics(folder)
    return Sequence(
        NAME,
        folder,
        views,
        own or _PRIMESENSE,
        depth_scale=1000.0,
        published_size=None if own else (640, 480),
    )


def _log(folder: Path) -> Path | None:
    """The trajectory: `trajectory.log` before others, here or in `scene/`."""
    found = [*sorted(folder.glob("*.log")), *sorted((folder / "scene").glob("*.log"))]
    return min(found, key=lambda path: path.name != "trajectory.log", default=None)


def _colors(folder: Path) -> Path | None:
    return next((path for name in _COLOR_FOLDERS if (path := folder / name).is_dir()), None)


def _read_log(path: Path) -> dict[int, FloatArray | None]:
    numbers = parse_numbers(read_text(path), path)
    if numbers.size == 0 or numbers.size % 19:
        raise InputError("expected entries of three integers and a 4x4 matrix", file=path)
    entries = numbers.reshape(-1, 19)
    if not np.isfinite(entries[:, 0]).all():
        raise InputError("a frame number is not finite", file=path)
    return {int(entry[0]): rigid_or_none(entry[3:].reshape(4, 4)) for entry in entries}


def _intrinsics(folder: Path) -> Intrinsics | None:
    for path in sorted(folder.glob("*.json")):
        try:
            values = json.loads(read_text(path))
            if isinstance(values, dict) and "intrinsic_matrix" in values:
                k = np.asarray(values["intrinsic_matrix"], dtype=np.float64).reshape(3, 3).T
                return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])
        except (ValueError, TypeError):
            raise InputError("expected JSON with an intrinsic_matrix of 9 numbers", file=path) from None
    return None
