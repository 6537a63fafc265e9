"""How much of the image an observation takes up, from its points: observations carry no masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import FloatArray, Frame, MaskArray, Observation
from dssmsg.geometry import (
    back_project_world,
    box_of,
    invert_rigid,
    project,
    transform_points,
)
from dssmsg.graph.voxels import contained, voxel_keys

_RIM_PIXELS = 8


def pixel_box(frame: Frame, observation: Observation) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of the observation in pixels, within the image."""
    camera = frame.camera
    points = transform_points(invert_rigid(frame.world_from_camera), observation.points_world)
    uv, z = project(points, camera)
    u, v = uv[z > 0].T
    if len(u) == 0:
        return 0.0, 0.0, 0.0, 0.0
    left, right = np.clip([u.min() - 0.5, u.max() + 0.5], -0.5, camera.width - 0.5) + 0.5
    top, bottom = np.clip([v.min() - 0.5, v.max() + 0.5], -0.5, camera.height - 0.5) + 0.5
    return float(left), float(top), float(right), float(bottom)


def box_share(frame: Frame, observation: Observation) -> float:
    """Share 0..1 of the image that the observation's pixel box covers."""
    left, top, right, bottom = pixel_box(frame, observation)
    return (right - left) * (bottom - top) / (frame.camera.width * frame.camera.height)


def covered_pixels(frame: Frame, observation: Observation) -> int:
    """How many pixels lie in the observation's voxels: the size of its mask, as far as it was lifted."""
    wanted: MaskArray = np.zeros(frame.depth.shape, dtype=np.bool_)
    left, top, right, bottom = pixel_box(frame, observation)
    # Voxels are held by their mean point: pixels of one may fall a little outside of the points' box.
    rows = slice(max(int(top) - _RIM_PIXELS, 0), int(bottom) + _RIM_PIXELS)
    columns = slice(max(int(left) - _RIM_PIXELS, 0), int(right) + _RIM_PIXELS)
    wanted[rows, columns] = True
    points = back_project_world(frame.depth, frame.camera, frame.world_from_camera, wanted)
    keys = voxel_keys(points.astype(observation.points_world.dtype))
    return int(np.count_nonzero(contained(keys, np.sort(voxel_keys(observation.points_world)))))


def has_pixels(frame: Frame, observation: Observation, least: int) -> bool:
    """Whether the observation covers at least so many pixels. Each voxel comes from one at least."""
    return len(observation.points_world) >= least or covered_pixels(frame, observation) >= least


def mask_share(frame: Frame, observation: Observation) -> float:
    """Share 0..1 of the image that the observation covers."""
    return covered_pixels(frame, observation) / frame.depth.size


def without_contained(
    frame: Frame, observations: Sequence[Observation], max_inside: float = 0.8, min_inside: float = 0.7
) -> list[Observation]:
    """The observations, each without the voxels of those that lie in it: a table loses the cup on it.

    ConceptGraphs' rule on pixel boxes: b lies in a where more than `min_inside` of b's box is within a's
    and less than `max_inside` of a's within b's. Those left with no voxel are left out.
    """
    boxes = np.array([pixel_box(frame, observation) for observation in observations]).reshape(-1, 4)
    inside_first, inside_second = _shares(boxes)
    holds = (inside_first < max_inside) & (inside_second > min_inside)
    keys: list[NDArray[np.int64]] = [voxel_keys(observation.points_world) for observation in observations]
    kept = []
    for place, observation in enumerate(observations):
        inner = [keys[other] for other in np.flatnonzero(holds[place]) if other != place]
        if not inner:
            kept.append(observation)
            continue
        own = ~contained(keys[place], np.sort(np.concatenate(inner)))
        if own.any():
            kept.append(cut(observation, own))
    return kept


def cut(observation: Observation, keep: MaskArray) -> Observation:
    """The observation with only those of its points (N,) that `keep` says, at least one."""
    if keep.all():
        return observation
    points = observation.points_world[keep]
    low, high = box_of(points)
    return replace(
        observation, points_world=points, colors=observation.colors[keep], box_min=low, box_max=high
    )


def _shares(boxes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, N) each: intersection over the first box's area, and over the second's, of boxes (N, 4)."""
    low = np.maximum(boxes[:, None, :2], boxes[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], boxes[None, :, 2:])
    shared: FloatArray = np.prod(np.maximum(high - low, 0.0), axis=-1)
    areas = np.maximum(np.prod(boxes[:, 2:] - boxes[:, :2], axis=-1), 1e-9)
    return shared / areas[:, None], shared / areas[None, :]
