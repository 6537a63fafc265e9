"""7-Scenes, also as tsdf-fusion-python ships it: `frame-000000.{color.*,depth.png,pose.txt}`.

Poses are camera-to-world, OpenCV axes; depth is 16-bit millimetres, 0 and 65535 invalid; the world is not
z up. Intrinsics from `camera-intrinsics.txt` (3x3) here or in the folder above, else the published 585 px.
"""

from __future__ import annotations

from pathlib import Path

from dssmsg.sequences.poses import read_matrix, read_pose
from dssmsg.sequences.sequence import COLOR_SUFFIXES, DEPTH_SUFFIXES, Intrinsics, Sequence, View, file_number

NAME = "sevenscenes"
SIGNATURE = "frame-000000.color.png, frame-000000.depth.png, frame-000000.pose.txt"
_RATE_HZ = 30.0  # frame numbers count at this rate, also where frames were left out
_KINECT: Intrinsics = (585.0, 585.0, 320.0, 240.0)


def matches(folder: Path) -> bool:
    """Whether the folder is in this layout."""
    return any(folder.glob("frame-*.pose.txt"))


def read(folder: Path) -> Sequence:
    """Where everything lies in a 7-Scenes folder."""
    views = []
    for pose in sorted(folder.glob("frame-*.pose.txt")):
        stem = pose.name.removesuffix(".pose.txt")
        color = _first(folder, f"{stem}.color", COLOR_SUFFIXES)
        if color is not None:
            number = file_number(Path(stem))
            views.append(
                View(
                    color,
                    _first(folder, f"{stem}.depth", DEPTH_SUFFIXES),
                    read_pose(pose),
                    None if number is None else number / _RATE_HZ,
                )
            )
    own = _intrinsics(folder)
    return Sequence(
        NAME,
        folder,
        tuple(views),
        own or _KINECT,
        depth_scale=1000.0,
        rate_hz=_RATE_HZ,
        published_size=None if own else (640, 480),
    )


def _first(folder: Path, stem: str, suffixes: tuple[str, ...]) -> Path | None:
    return next((path for s in suffixes if (path := folder / f"{stem}{s}").is_file()), None)


def _intrinsics(folder: Path) -> Intrinsics | None:
    for place in (folder, folder.parent):
        path = place / "camera-intrinsics.txt"
        if path.is_file():
            k = read_matrix(path, 3)
            return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])
    return None
