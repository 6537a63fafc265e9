"""What becomes of an object when an observation, or another object, turns out to be the same thing.

Pure functions on clouds, votes and features (paper III-A; ALGORITHM A.2). All results are deterministic:
sums run in a fixed order, means are formed in float64 and rounded once.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from dssmsg.frame import ByteArray, Float32Array, FloatArray, MaskArray
from dssmsg.graph.voxels import first_in_voxel, voxel_keys


def thinned(points: Float32Array, colors: ByteArray) -> tuple[Float32Array, ByteArray]:
    """A cloud (N, 3) with its colours (N, 3), at most one point a voxel; the same arrays if it was so."""
    return _picked(points, colors, first_in_voxel(voxel_keys(points)))


def united(
    points: Float32Array, colors: ByteArray, new_points: Float32Array, new_colors: ByteArray, known: MaskArray
) -> tuple[Float32Array, ByteArray]:
    """A cloud and, behind it, those of the new points whose voxel is free; the same arrays if there are none.

    `known` (N,) says which of the new points lie in a voxel that the cloud already has.
    """
    free = ~known
    if not free.any():
        return points, colors
    new_points, new_colors = thinned(*_picked(new_points, new_colors, free))
    return _frozen(np.concatenate([points, new_points])), _frozen(np.concatenate([colors, new_colors]))


def bounds(points: Float32Array) -> tuple[FloatArray, FloatArray]:
    """Corners (3,) float64 of the axis-aligned box of points (N, 3), N >= 1."""
    columns = np.ascontiguousarray(points.T)  # reducing along the short axis is 20 times slower
    low, high = columns.min(axis=1), columns.max(axis=1)
    return _frozen(low.astype(np.float64)), _frozen(high.astype(np.float64))


def counted(votes: Mapping[str, float], more: Mapping[str, float]) -> Mapping[str, float]:
    """Votes label -> summed confidence, labels in order of first mention."""
    total = dict(votes)
    for label, score in more.items():
        total[label] = total.get(label, 0.0) + score
    return MappingProxyType(total)


def winner(votes: Mapping[str, float]) -> str:
    """The label with the most confidence; of equal ones the one mentioned first."""
    return max(votes, key=lambda label: votes[label])


def averaged(
    feature: Float32Array | None, weight: int, other: Float32Array | None, other_weight: int
) -> Float32Array | None:
    """The mean direction of two unit vectors (D,), weighted by observation counts, as a unit vector.

    None stands for no feature and leaves the other as it is; opposite vectors, which have no mean direction,
    leave the first. Raises ValueError for vectors of different lengths.
    """
    if feature is None or other is None:
        return other if feature is None else feature
    if feature.shape != other.shape:
        raise ValueError(f"expected a feature of shape {feature.shape}, got {other.shape}")
    mean = weight * feature.astype(np.float64) + other_weight * other.astype(np.float64)
    length = float(np.sqrt(np.sum(mean * mean)))  # np.sum adds pairwise in a fixed order, BLAS need not
    if length < 1e-9 * (weight + other_weight):
        return feature
    unit: Float32Array = _frozen((mean / length).astype(np.float32))
    return unit


def appended(items: tuple[str, ...], more: Iterable[str]) -> tuple[str, ...]:
    """`items` and behind them what is new of `more`."""
    return tuple(dict.fromkeys((*items, *more)))


def with_frame(frames: tuple[int, ...], frame: int) -> tuple[int, ...]:
    """Ascending frame indices with one more. Copies the tuple: microseconds for thousands of frames."""
    if not frames or frames[-1] < frame:
        return (*frames, frame)
    place = bisect_left(frames, frame)
    return frames if frames[place] == frame else (*frames[:place], frame, *frames[place:])


def _picked(points: Float32Array, colors: ByteArray, mask: MaskArray) -> tuple[Float32Array, ByteArray]:
    return (points, colors) if mask.all() else (_frozen(points[mask]), _frozen(colors[mask]))


def _frozen(array: Any) -> Any:
    array.flags.writeable = False
    return array
