"""ScanNet as its exporter writes it: `color/0.jpg`, `depth/0.png`, `pose/0.txt`, `intrinsic/*.txt`.

Poses are camera-to-world, -inf where tracking was lost; depth is 16-bit millimetres in its own camera, whose
axis is taken as the colour camera's (the published extrinsics are the identity); the world is z up.
"""

from __future__ import annotations

from pathlib import Path

from dssmsg.sequences.poses import read_matrix, read_pose
from dssmsg.sequences.sequence import (
    COLOR_SUFFIXES,
    DEPTH_SUFFIXES,
    Intrinsics,
    Sequence,
    View,
    numbered_files,
)

NAME = "scannet"
SIGNATURE = "color/0.jpg, depth/0.png, pose/0.txt, intrinsic/intrinsic_color.txt"


def matches(folder: Path) -> bool:
    """Whether the folder is in this layout."""
    return all((folder / name).is_dir() for name in ("color", "depth", "pose"))


def read(folder: Path) -> Sequence:
    """Where everything lies in a ScanNet folder."""
    depths = numbered_files(folder / "depth", DEPTH_SUFFIXES)
    poses = numbered_files(folder / "pose", (".txt",))
    views = tuple(
        View(color, depths.get(number), read_pose(poses[number]) if number in poses else None)
        for number, color in numbered_files(folder / "color", COLOR_SUFFIXES).items()
    )
    return Sequence(
        NAME,
        folder,
        views,
        _intrinsics(folder / "intrinsic" / "intrinsic_color.txt"),
        depth_scale=1000.0,
        up="z",
        depth_intrinsics=_intrinsics(folder / "intrinsic" / "intrinsic_depth.txt"),
    )


def _intrinsics(path: Path) -> Intrinsics | None:
    if not path.is_file():
        return None
    k = read_matrix(path, 4)
    return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])
