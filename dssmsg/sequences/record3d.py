"""Record3D (iPhone LiDAR), an unpacked .r3d: `metadata`, `rgbd/0.jpg`, `rgbd/0.depth`; or `rgb/`, `depth/`.

`metadata` (or `metadata.json`) is JSON: K (3x3, column by column), poses (qx qy qz qw tx ty tz, ARKit axes:
the camera looks along -z, y up; world y up), fps, frameTimestamps, perFrameIntrinsicCoeffs, dw and dh.
Depth is float metres: bare or LZFSE-packed float32 (`.depth`) or `.npy`; `.png` holds millimetres.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from dssmsg.errors import InputError
from dssmsg.sequences.poses import from_quaternion, read_text
from dssmsg.sequences.sequence import DEPTH_SUFFIXES, Intrinsics, Sequence, View, numbered_files

NAME = "record3d"
SIGNATURE = "metadata, rgbd/0.jpg, rgbd/0.depth"


def matches(folder: Path) -> bool:
    """Whether the folder is in this layout."""
    return _metadata(folder) is not None and any((folder / name).is_dir() for name in ("rgbd", "rgb"))


def read(folder: Path) -> Sequence:
    """Where everything lies in a Record3D folder."""
    path = _metadata(folder) or folder / "metadata"
    try:
        values: dict[str, Any] = json.loads(read_text(path))
        poses = np.asarray(values["poses"], dtype=np.float64).reshape(-1, 7)
        k = np.asarray(values["K"], dtype=np.float64).reshape(3, 3).T
        coefficients = values.get("perFrameIntrinsicCoeffs") or []
        times = [float(t) for t in values.get("frameTimestamps") or []]
        rate_hz = float(values.get("fps") or 30.0)
        raw_size = (int(values["dw"]), int(values["dh"])) if "dw" in values and "dh" in values else None
        per_frame: list[Intrinsics] = [
            (float(f[0]), float(f[1]), float(f[2]), float(f[3])) for f in coefficients
        ]
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise InputError(
            f"expected JSON with K (9 numbers) and poses (7 numbers each): {type(error).__name__} {error}",
            file=path,
        ) from None
    color_folder, depth_folder = (
        (folder / "rgbd", folder / "rgbd")
        if (folder / "rgbd").is_dir()
        else (folder / "rgb", folder / "depth")
    )
    depths = numbered_files(depth_folder, (".depth", *DEPTH_SUFFIXES)) if depth_folder.is_dir() else {}
    views = tuple(
        View(
            color,
            depths.get(number),
            from_quaternion(poses[number, :4], poses[number, 4:]) if number < len(poses) else None,
            times[number] if number < len(times) else None,
            per_frame[number] if number < len(per_frame) else None,
        )
        for number, color in numbered_files(color_folder, (".jpg", ".jpeg")).items()
    )
    return Sequence(
        NAME,
        folder,
        views,
        (float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])),
        depth_scale=1000.0,
        rate_hz=rate_hz,
        up="y",
        camera_axes="opengl",
        raw_depth_size=raw_size,
        depth_noise_m=(0.01, 0.002),
    )


def _metadata(folder: Path) -> Path | None:
    return next((p for name in ("metadata", "metadata.json") if (p := folder / name).is_file()), None)
