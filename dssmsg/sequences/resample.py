"""Bringing colour and depth of different sizes to one pinhole camera."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dssmsg.frame import ByteArray, Camera, FloatArray
from dssmsg.sequences.sequence import Intrinsics

_TIE = 1e-6  # a ray between two pixels takes the lower one, everywhere


def scaled_camera(width: int, height: int, intrinsics: Intrinsics, size: tuple[int, int]) -> Camera:
    """The camera of a (width, height) image after resizing it to `size`, pixel centres at integers."""
    sx, sy = size[0] / width, size[1] / height
    fx, fy, cx, cy = intrinsics
    return Camera(size[0], size[1], fx * sx, fy * sy, (cx + 0.5) * sx - 0.5, (cy + 0.5) * sy - 0.5)


def resize_rgb(rgb: ByteArray, size: tuple[int, int]) -> ByteArray:
    """(H, W, 3) resized to `size` (width, height); smaller by averaging the pixels covered."""
    if (rgb.shape[1], rgb.shape[0]) == size:
        return rgb
    image = Image.fromarray(rgb)
    shrinks = size[0] < image.width or size[1] < image.height
    method = Image.Resampling.BOX if shrinks else Image.Resampling.BILINEAR
    return np.asarray(image.resize(size, method))


def resample_depth(depth: FloatArray, depth_camera: Camera, camera: Camera) -> FloatArray:
    """Depth (H, W) as `camera` sees it: for every ray the nearest reading, 0 outside.

    Both cameras share centre and axes (a depth image aligned with colour), so z stays what it is; readings
    are never averaged, which would put surfaces where there are none.
    """
    if depth_camera == camera:
        return depth
    rows, row_fits = _nearest(
        camera.height, camera.fy, camera.cy, depth_camera.height, depth_camera.fy, depth_camera.cy
    )
    columns, column_fits = _nearest(
        camera.width, camera.fx, camera.cx, depth_camera.width, depth_camera.fx, depth_camera.cx
    )
    return np.where(np.outer(row_fits, column_fits), depth[np.ix_(rows, columns)], 0.0)


@functools.lru_cache(maxsize=16)
def _nearest(
    count: int, focal: float, centre: float, from_count: int, from_focal: float, from_centre: float
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """For each pixel along an axis the other camera's pixel on its ray, and whether there is one."""
    ray = (np.arange(count) - centre) / focal
    place = np.floor(ray * from_focal + from_centre + 0.5 - _TIE).astype(np.intp)
    fits = (place >= 0) & (place < from_count)
    return np.clip(place, 0, from_count - 1), fits
