"""Denoising of clouds as the methods do it: of density clusters only the largest stays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dssmsg.cluster import density_clusters
from dssmsg.frame import MaskArray

NEIGHBOURS = 10
"""`min_points` of both methods' DBSCAN, and the neighbour that DovSG measures its eps by."""


def largest_cluster(points: NDArray[np.floating[Any]], eps: float) -> MaskArray:
    """(N,) bool: the points (N, 3), metres, of the largest DBSCAN cluster; all where there is no cluster.

    Of equally large clusters the one with the first point stays.
    """
    labels = density_clusters(np.asarray(points, dtype=np.float64), eps, NEIGHBOURS)
    sizes = np.bincount(labels[labels >= 0])
    if len(sizes) == 0:
        return np.ones(len(points), dtype=np.bool_)
    largest: MaskArray = labels == int(np.argmax(sizes))
    return largest


def neighbour_eps(points: NDArray[np.floating[Any]], percentile: float = 95.0) -> float:
    """DovSG's eps in metres: the 95th percentile of the points' distances to their 10th neighbour.

    points (N, 3); infinite where there are ten points or fewer, so that all of them are one cluster.
    """
    if len(points) <= NEIGHBOURS:
        return float("inf")
    distances, _ = KDTree(points).query(points, k=[NEIGHBOURS + 1])  # a point's first neighbour is itself
    return float(np.percentile(distances, percentile))
