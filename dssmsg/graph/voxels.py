"""Voxels: which cell of the world's 0.025 m grid a point lies in, as one sortable integer a cell.

Clouds hold at most one point a cell, and the first one to come stays (ALGORITHM A.1, A.2), so a merge
that brings nothing new leaves the array, and whatever was built from it, as it is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import MaskArray

VOXEL_M = 0.025
_BITS = 21  # an axis: three of them fill the 63 value bits of an int64, +-26 km of 0.025 m cells
_HALF = 1 << (_BITS - 1)
REACH_M = (_HALF - 1) * VOXEL_M
"""Coordinates up to this many metres from the origin have a voxel."""

BESIDE = (0, *(sign << (axis * _BITS) for axis in range(3) for sign in (1, -1)))
"""Added to a voxel's key: the voxel itself, and the six that share a face with it."""

KeyArray = NDArray[np.int64]


def voxel_keys(points: NDArray[Any]) -> KeyArray:
    """Cells of points (N, 3), world metres, as int64 (N,): floor(p / 0.025 m) packed x, y, z.

    Keys order like the cells' (x, y, z). Raises ValueError for points that are not finite or further
    than 26 km from the origin.
    """
    cells = np.floor(np.asarray(points, dtype=np.float64) / VOXEL_M)
    if not (np.abs(cells) < _HALF).all():  # false for NaN and infinity, too
        raise ValueError("points: expected finite coordinates within 26 km of the origin")
    shifted = cells.astype(np.int64) + _HALF
    keys: KeyArray = (shifted[:, 0] << (2 * _BITS)) | (shifted[:, 1] << _BITS) | shifted[:, 2]
    return keys


def contained(keys: KeyArray, sorted_keys: KeyArray) -> MaskArray:
    """(N,) bool: which of `keys` occur in the ascending `sorted_keys`."""
    if not len(sorted_keys):
        return np.zeros(len(keys), dtype=np.bool_)
    place = np.searchsorted(sorted_keys, keys)
    place[place == len(sorted_keys)] = 0  # beyond the last: compares unequal to the first, as it is larger
    found: MaskArray = sorted_keys[place] == keys
    return found


def first_of_run(sorted_keys: KeyArray) -> MaskArray:
    """(N,) bool: which of ascending keys differ from the one before; the first does."""
    first: MaskArray = np.ones(len(sorted_keys), dtype=np.bool_)
    np.not_equal(sorted_keys[1:], sorted_keys[:-1], out=first[1:])
    return first


def distinct(keys: KeyArray) -> KeyArray:
    """The keys, each once, ascending."""
    ordered = np.sort(keys)  # faster than np.unique, which hashes
    return ordered[first_of_run(ordered)]


def first_in_voxel(keys: KeyArray) -> MaskArray:
    """(N,) bool: True for the first point of each cell, in the order given."""
    mask = np.zeros(len(keys), dtype=np.bool_)
    mask[np.unique(keys, return_index=True)[1]] = True
    return mask
