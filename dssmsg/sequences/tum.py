"""TUM RGB-D: `rgb.txt`, `depth.txt` (time, file) and `groundtruth.txt` (time, xyz, qxyzw).

Three clocks: an image pair is a colour and a depth image that are each other's nearest in time, its pose the
nearest of the motion capture, both within 0.02 s. Depth is 16-bit, 5000 units a metre; the world is z up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dssmsg.errors import InputError
from dssmsg.frame import FloatArray
from dssmsg.sequences.poses import from_quaternion, parse_numbers, read_text
from dssmsg.sequences.sequence import Intrinsics, Sequence, View, listed_name

NAME = "tum"
SIGNATURE = "rgb.txt, depth.txt, groundtruth.txt"
MAX_DIFFERENCE_SECS = 0.02
_CAMERAS: dict[str, Intrinsics] = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3),
    "freiburg2": (520.9, 521.0, 325.1, 249.7),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
_DEFAULT: Intrinsics = (525.0, 525.0, 319.5, 239.5)


def matches(folder: Path) -> bool:
    """Whether the folder is in this layout."""
    return all((folder / name).is_file() for name in ("rgb.txt", "depth.txt", "groundtruth.txt"))


def read(folder: Path) -> Sequence:
    """Where everything lies in a TUM folder, colour, depth and pose associated by time."""
    color_times, colors = _read_list(folder / "rgb.txt")
    depth_times, depths = _read_list(folder / "depth.txt")
    pose_times, poses = _read_trajectory(folder / "groundtruth.txt")
    views = []
    for index, (time, color) in enumerate(zip(color_times, colors, strict=True)):
        partner = _nearest(depth_times, time)
        paired = partner is not None and _nearest(color_times, depth_times[partner]) == index
        pose = _nearest(pose_times, time)
        views.append(
            View(
                folder / color,
                folder / depths[partner] if paired and partner is not None else None,
                None if pose is None else from_quaternion(poses[pose, 3:], poses[pose, :3]),
                float(time),
            )
        )
    camera = next((k for name, k in _CAMERAS.items() if name in str(folder.resolve())), _DEFAULT)
    return Sequence(NAME, folder, tuple(views), camera, depth_scale=5000.0, up="z", published_size=(640, 480))


def _nearest(times: FloatArray, time: float) -> int | None:
    """Index of the nearest time (sorted) within MAX_DIFFERENCE_SECS, or None."""
    place = int(np.searchsorted(times, time))
    best = min(
        (i for i in (place - 1, place) if 0 <= i < len(times)),
        key=lambda i: abs(times[i] - time),
        default=None,
    )
    return best if best is not None and abs(times[best] - time) <= MAX_DIFFERENCE_SECS else None


def _lines(path: Path) -> list[str]:
    lines = (line.partition("#")[0].strip() for line in read_text(path).splitlines())
    return [line for line in lines if line]


def _read_list(path: Path) -> tuple[FloatArray, list[str]]:
    rows = [line.split(maxsplit=1) for line in _lines(path)]
    if not rows or any(len(row) != 2 for row in rows):
        raise InputError("expected lines of a time and a file name", file=path)
    times = parse_numbers(" ".join(row[0] for row in rows), path)
    order = np.argsort(times, kind="stable")
    return times[order], [listed_name(rows[i][1], path) for i in order]


def _read_trajectory(path: Path) -> tuple[FloatArray, FloatArray]:
    lines = _lines(path)
    numbers = parse_numbers(" ".join(lines), path)
    if not lines or numbers.size != 8 * len(lines):
        raise InputError("expected lines of 8 numbers: time tx ty tz qx qy qz qw", file=path)
    table = numbers.reshape(-1, 8)
    table = table[np.argsort(table[:, 0], kind="stable")]
    return table[:, 0], table[:, 1:]
