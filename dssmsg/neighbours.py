"""Which points of two clouds lie near each other, by a KD-tree that is made for few searches."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import MaskArray

if TYPE_CHECKING:
    from scipy.spatial import KDTree  # takes a quarter of a second; who only reads recordings needs none


def quick_tree(points: NDArray[np.floating[Any]]) -> KDTree:
    """A KD-tree of points (N, 3): quick to build, a little slower to search, the answers are the same."""
    from scipy.spatial import KDTree

    return KDTree(points, balanced_tree=False, compact_nodes=False)


def near_any(
    points: NDArray[np.floating[Any]], cloud: NDArray[np.floating[Any]], tolerance: float
) -> MaskArray:
    """(N,) bool: which of points (N, 3) have a point of the cloud (M, 3) nearer than `tolerance` metres."""
    near: MaskArray = np.zeros(len(points), dtype=np.bool_)
    if not len(points) or not len(cloud):
        return near
    asked = np.ones(len(points), dtype=np.bool_)
    for column, line in zip(cloud.T, points.T, strict=True):  # quicker one by one than across
        asked &= (line >= column.min() - tolerance) & (line <= column.max() + tolerance)
    if asked.any():
        distances, _ = quick_tree(cloud).query(points[asked], distance_upper_bound=tolerance)
        near[asked] = np.isfinite(distances)
    return near
