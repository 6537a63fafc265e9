"""Replica as rendered for NICE-SLAM: `results/frame*.jpg`, `results/depth*.png`, `traj.txt`.

One pose a line, 16 numbers, camera-to-world, OpenCV axes; depth is 16-bit, 6553.5 units a metre; the world is
z up. Intrinsics from `cam_params.json` here or in the folder above, else the published ones.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from dssmsg.errors import InputError
from dssmsg.sequences.poses import parse_numbers, read_text, rigid_or_none
from dssmsg.sequences.sequence import (
    COLOR_SUFFIXES,
    DEPTH_SUFFIXES,
    Intrinsics,
    Sequence,
    View,
    numbered_files,
)

NAME = "replica"
SIGNATURE = "results/frame000000.jpg, results/depth000000.png, traj.txt"
_PUBLISHED: Intrinsics = (600.0, 600.0, 599.5, 339.5)
_PUBLISHED_SCALE = 6553.5


def matches(folder: Path) -> bool:
    """Whether the folder is in this layout."""
    return (folder / "traj.txt").is_file() and (folder / "results").is_dir()


def read(folder: Path) -> Sequence:
    """Where everything lies in a Replica folder. Frame n has the pose of line n."""
    trajectory = folder / "traj.txt"
    lines = [line for line in read_text(trajectory).splitlines() if line.strip()]
    poses = []
    for number, line in enumerate(lines, start=1):
        numbers = parse_numbers(line, trajectory)
        if numbers.size != 16:
            raise InputError(f"line {number}: expected 16 numbers, got {numbers.size}", file=trajectory)
        poses.append(rigid_or_none(numbers.reshape(4, 4)))
    colors = numbered_files(folder / "results", COLOR_SUFFIXES, "frame")
    depths = numbered_files(folder / "results", DEPTH_SUFFIXES, "depth")
    views = tuple(
        View(color, depths.get(number), poses[number] if number < len(poses) else None)
        for number, color in colors.items()
    )
    own = _camera(folder)
    intrinsics, scale = own or (_PUBLISHED, _PUBLISHED_SCALE)
    return Sequence(
        NAME,
        folder,
        views,
        intrinsics,
        depth_scale=scale,
        up="z",
        depth_noise_m=(0.0005, 0.0),
        published_size=None if own else (1200, 680),
    )


def _camera(folder: Path) -> tuple[Intrinsics, float] | None:
    for place in (folder, folder.parent):
        path = place / "cam_params.json"
        if path.is_file():
            try:
                values: dict[str, Any] = json.loads(read_text(path))["camera"]
                fx, fy, cx, cy = (float(values[key]) for key in ("fx", "fy", "cx", "cy"))
                return (fx, fy, cx, cy), float(values.get("scale", _PUBLISHED_SCALE))
            except (ValueError, KeyError, TypeError):
                raise InputError("expected {camera: {fx, fy, cx, cy, scale}}", file=path) from None
    return None
