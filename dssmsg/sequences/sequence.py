"""What a layout tells of a folder: `Sequence` and its `View`s, and how numbered files are found."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePath

from dssmsg.errors import InputError
from dssmsg.frame import FloatArray

Intrinsics = tuple[float, float, float, float]
"""fx, fy, cx, cy in pixels of the colour image as it is on disk (pixel centres at integers)."""

COLOR_SUFFIXES = (".jpg", ".jpeg", ".png", ".ppm", ".bmp")
DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".pgm", ".npy")

_NUMBER = re.compile(r"(\d+)(?!.*\d)")


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One frame on disk. `world_from_camera` (4, 4) is None where the pose is invalid or missing.

    `depth` is None where there is no depth image; `time_secs` is None where the layout has no clock;
    `intrinsics` only where they change from frame to frame.
    """

    color: Path
    depth: Path | None
    world_from_camera: FloatArray | None
    time_secs: float | None = None
    intrinsics: Intrinsics | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Sequence:
    """A folder of posed RGB-D frames in one of the layouts.

    Poses are as in the files: `camera_axes` says whether the camera looks along +z (`opencv`) or along -z
    with y up (`opengl`, also ARKit). `depth_scale` is depth units a metre. `up` is the world axis that the
    layout promises to point up, None if it promises nothing. `depth_intrinsics` are those of the depth
    image where it has its own (None: aligned with the colour image). `raw_depth_size` (width, height)
    is given where depth files are bare arrays. `depth_noise_m` (a, b): sigma(z) = a + b z^2. `published_size`
    (width, height) is given where the intrinsics are not the folder's own but published for the data set.
    """

    layout: str
    folder: Path
    views: tuple[View, ...]
    intrinsics: Intrinsics | None
    depth_scale: float
    rate_hz: float = 30.0
    up: str | None = None
    camera_axes: str = "opencv"
    depth_intrinsics: Intrinsics | None = None
    raw_depth_size: tuple[int, int] | None = None
    depth_noise_m: tuple[float, float] = (0.0012, 0.002)
    published_size: tuple[int, int] | None = None


def listed_name(name: str, file: Path) -> str:
    """A file name that a list says, for use below the list's folder.

    Raises InputError naming the list for an absolute name or one with `..`: what a data set says must not
    lead out of its folder.
    """
    path = PurePath(name)
    if path.is_absolute() or ".." in path.parts:
        raise InputError(f"expected names of files below its folder, got {name[:200]!r}", file=file)
    return name


def file_number(path: Path) -> int | None:
    """The last number in a file's name (`frame000012.jpg` -> 12), None if there is none."""
    match = _NUMBER.search(path.stem)
    return None if match is None else int(match[1])


def numbered_files(folder: Path, suffixes: Iterable[str], prefix: str = "") -> dict[int, Path]:
    """Files of `folder` by their number, in ascending order; other files are left out."""
    wanted = tuple(suffixes)
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        number = file_number(path)
        if number is not None and path.name.startswith(prefix) and path.suffix.lower() in wanted:
            found.setdefault(number, path)
    return dict(sorted(found.items()))
