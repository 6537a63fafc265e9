"""Cameras, rigid transforms, axis-aligned boxes and what a depth image says of points in space.

Metres and radians; names carry the frame: `points_world`, `world_from_camera`. Box functions take corners
(..., 3) and broadcast over leading axes. numpy only.
"""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dssmsg.frame import Camera, FloatArray, IntArray, MaskArray


def invert_rigid(target_from_source: ArrayLike) -> FloatArray:
    """The inverse of rigid transforms (..., 4, 4): `source_from_target`. No general matrix inversion."""
    forward = np.asarray(target_from_source, dtype=np.float64)
    inverse = np.zeros_like(forward)
    rotation = np.swapaxes(forward[..., :3, :3], -1, -2)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3] = -(rotation @ forward[..., :3, 3, None])[..., 0]
    inverse[..., 3, 3] = 1.0
    return inverse


def transform_points(target_from_source: ArrayLike, points: ArrayLike) -> FloatArray:
    """Points (..., 3) of the source frame in the target frame, by one transform (4, 4)."""
    matrix = np.asarray(target_from_source, dtype=np.float64)
    moved: FloatArray = np.asarray(points, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


@lru_cache(maxsize=8)
def pixel_rays(camera: Camera) -> FloatArray:
    """(H * W, 3) viewing rays in the camera frame with z = 1, row by row; read-only, cached a camera."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u, dtype=np.float64)], axis=-1
    ).reshape(-1, 3)
    rays.flags.writeable = False
    return rays


def world_rays(
    camera: Camera, world_from_camera_rotation: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """World x, y and z, each (H, W), of the pixels' viewing rays; in the camera frame these have z = 1."""
    rotation = np.asarray(world_from_camera_rotation, dtype=np.float64)
    u = (np.arange(camera.width) - camera.cx) / camera.fx
    v = (np.arange(camera.height) - camera.cy) / camera.fy
    x, y, z = (row[0] * u + (row[1] * v + row[2])[:, None] for row in rotation)
    return x, y, z


def back_project(depth: ArrayLike, camera: Camera, mask: ArrayLike | None = None) -> FloatArray:
    """Camera points (N, 3) of the pixels with a reading, in row-major pixel order.

    depth (H, W) metres along the optical axis, 0 = no reading; mask (H, W) bool keeps some of them.
    """
    flat = np.asarray(depth, dtype=np.float64).reshape(-1)
    wanted = flat > 0
    if mask is not None:
        wanted &= np.asarray(mask, dtype=bool).reshape(-1)
    pixels = np.flatnonzero(wanted)
    points: FloatArray = pixel_rays(camera)[pixels] * flat[pixels, None]
    return points


def back_project_world(
    depth: ArrayLike, camera: Camera, world_from_camera: ArrayLike, mask: ArrayLike | None = None
) -> FloatArray:
    """World points (N, 3) of the pixels with a reading: `back_project`, then the camera's pose."""
    return transform_points(world_from_camera, back_project(depth, camera, mask))


def project(points_camera: ArrayLike, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Pixel coordinates (..., 2) as (u, v) and depth (...,) of camera points (..., 3).

    Points at or behind the camera (z <= 0) get NaN coordinates.
    """
    points = np.asarray(points_camera, dtype=np.float64)
    z = points[..., 2]
    safe = np.where(z > 0, z, np.nan)
    u = points[..., 0] / safe * camera.fx + camera.cx
    v = points[..., 1] / safe * camera.fy + camera.cy
    return np.stack([u, v], axis=-1), z


def depth_sigma(range_m: ArrayLike, noise: tuple[float, float]) -> FloatArray:
    """Standard deviation of depth (metres) at a range: a + b z^2 with `noise` = (a, b) of the source."""
    z = np.asarray(range_m, dtype=np.float64)
    sigma: FloatArray = noise[0] + noise[1] * z * z
    return sigma


class Sight(IntEnum):
    """What a depth image says of a point in space."""

    OUT_OF_VIEW = 0
    """Behind the camera, outside the image, or beyond the range asked for."""
    NO_READING = 1
    """Its pixel has no depth."""
    OCCLUDED = 2
    """Something nearer is in front of it."""
    ON_SURFACE = 3
    """The measured surface is where the point is."""
    SEEN_THROUGH = 4
    """The measured surface lies behind the point: its place is free."""


def sight_of_points(
    points_world: ArrayLike,
    depth: ArrayLike,
    camera: Camera,
    world_from_camera: ArrayLike,
    tolerance: ArrayLike,
    max_range: float = np.inf,
) -> IntArray:
    """A `Sight` code (N,) int32 for world points (N, 3), by looking up the pixel each one falls on.

    `tolerance` is metres along the optical axis, a number or (N,): nearer than that is on the surface.
    (Paper III-A and III-B need it to tell "gone" from "not seen"; the test itself is ours.)
    """
    points_camera = transform_points(invert_rigid(world_from_camera), points_world)
    uv, z = project(points_camera, camera)
    u, v = np.rint(np.nan_to_num(uv, nan=-1e9)).T
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height) & (z <= max_range)
    codes = np.full(len(points_camera), Sight.OUT_OF_VIEW, dtype=np.int32)
    measured = np.asarray(depth, dtype=np.float64)[v[inside].astype(np.intp), u[inside].astype(np.intp)]
    behind = measured - z[inside]
    margin = np.broadcast_to(np.asarray(tolerance, dtype=np.float64), z.shape)[inside]
    codes[inside] = np.select(
        [measured <= 0, behind < -margin, behind > margin],
        [Sight.NO_READING, Sight.OCCLUDED, Sight.SEEN_THROUGH],
        Sight.ON_SURFACE,
    )
    return codes


def box_of(points: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Corners (3,), (3,) of the axis-aligned box of points (N, 3), N > 0."""
    columns = np.ascontiguousarray(np.asarray(points, dtype=np.float64).T)
    return columns.min(axis=1), columns.max(axis=1)


def grow_box(box_min: ArrayLike, box_max: ArrayLike, margin: float) -> tuple[FloatArray, FloatArray]:
    """The box with every face moved outwards by `margin` metres."""
    return np.asarray(box_min, dtype=np.float64) - margin, np.asarray(box_max, dtype=np.float64) + margin


def box_gaps(a_min: ArrayLike, a_max: ArrayLike, b_min: ArrayLike, b_max: ArrayLike) -> FloatArray:
    """(..., 3) free space between boxes on each axis, 0 where their shadows on that axis touch."""
    below = np.subtract(a_min, b_max, dtype=np.float64)
    above = np.subtract(b_min, a_max, dtype=np.float64)
    gaps: FloatArray = np.maximum(np.maximum(below, above), 0.0)
    return gaps


def boxes_touch(a_min: ArrayLike, a_max: ArrayLike, b_min: ArrayLike, b_max: ArrayLike) -> NDArray[Any]:
    """(...,) bool: the boxes share at least a point."""
    touch: NDArray[Any] = np.all(box_gaps(a_min, a_max, b_min, b_max) == 0.0, axis=-1)
    return touch


def box_distance(a_min: ArrayLike, a_max: ArrayLike, b_min: ArrayLike, b_max: ArrayLike) -> FloatArray:
    """(...,) smallest distance between the boxes in metres; 0 if they touch."""
    distance: FloatArray = np.linalg.norm(box_gaps(a_min, a_max, b_min, b_max), axis=-1)
    return distance


def box_volume(box_min: ArrayLike, box_max: ArrayLike) -> FloatArray:
    """(...,) volume in cubic metres; 0 for an empty (inverted) box."""
    size = np.maximum(np.subtract(box_max, box_min, dtype=np.float64), 0.0)
    volume: FloatArray = np.prod(size, axis=-1)
    return volume


def box_intersection(a_min: ArrayLike, a_max: ArrayLike, b_min: ArrayLike, b_max: ArrayLike) -> FloatArray:
    """(...,) volume that both boxes cover."""
    return box_volume(np.maximum(a_min, b_min), np.minimum(a_max, b_max))


def box_iou(a_min: ArrayLike, a_max: ArrayLike, b_min: ArrayLike, b_max: ArrayLike) -> FloatArray:
    """(...,) intersection over union, 0..1; 0 where both boxes have no volume."""
    shared = box_intersection(a_min, a_max, b_min, b_max)
    union = box_volume(a_min, a_max) + box_volume(b_min, b_max) - shared
    iou: FloatArray = np.divide(shared, union, out=np.zeros_like(shared, dtype=np.float64), where=union > 0)
    return iou


def points_in_box(points: ArrayLike, box_min: ArrayLike, box_max: ArrayLike) -> MaskArray:
    """(N,) bool: which of the points (N, 3) lie in the box, faces included."""
    array = np.asarray(points)
    inside: MaskArray = np.ones(len(array), dtype=np.bool_)
    for axis, (low, high) in enumerate(zip(np.asarray(box_min), np.asarray(box_max), strict=True)):
        inside &= (array[:, axis] >= low) & (array[:, axis] <= high)
    return inside


def cell_keys(
    points: FloatArray, side: float, groups: NDArray[np.intp] | None = None
) -> tuple[NDArray[np.int64], tuple[int, int, int]]:
    """One int64 a point (N, 3), equal for points of the same grid cell floor(p / side) and the same group.

    Keys order by group (N,), then x, y, z. The second value is what a step of one cell along x, y, z adds to
    a key; cells are padded by one on each side, so that such a step never lands in another row or group.
    """
    columns = []
    sizes = []
    for axis in range(3):  # column by column: reductions over a short last axis are slow
        cells = np.floor(points[:, axis] / side).astype(np.int64)
        cells -= int(cells.min()) - 1
        columns.append(cells)
        sizes.append(int(cells.max()) + 2)
    keys = (columns[0] * sizes[1] + columns[1]) * sizes[2] + columns[2]
    if groups is not None:
        keys += groups * (sizes[0] * sizes[1] * sizes[2])
    return keys, (sizes[1] * sizes[2], sizes[2], 1)
