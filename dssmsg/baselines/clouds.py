"""Denoising of clouds as the methods do it: of density clusters only the largest stays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from dssmsg.cluster import density_clusters
from dssmsg.frame import MaskArray

NEIGHBOURS = 10
"""`min_points` of both methods' DBSCAN, and the neighbour that DovSG measures its eps by."""


def largest_clusters(clouds: Sequence[NDArray[np.floating[Any]]], eps: float) -> list[MaskArray]:
    """(N,) bool a cloud: which of its points (N, 3), metres, are in its largest DBSCAN cluster.

    All of them where there is no cluster; of equally large ones that with the first point stays. Clouds are
    clustered apart from each other, in one go: that is much faster than one by one.
    """
    if not clouds:
        return []
    sizes = [len(cloud) for cloud in clouds]
    points = np.concatenate(clouds).astype(np.float64)
    labels = density_clusters(points, eps, NEIGHBOURS, groups=np.repeat(np.arange(len(clouds)), sizes))
    return [_largest(own) for own in np.split(labels, np.cumsum(sizes)[:-1])]


def largest_neighbour_cluster(points: NDArray[np.floating[Any]], percentile: float = 95.0) -> MaskArray:
    """(N,) bool: as `largest_clusters`, by DovSG's eps, the 95th percentile of distances to 10th neighbours.

    That eps makes nearly every point a core point, of clusters that are hardly wider than a voxel; so the
    neighbours that it was measured by are used again. All points where there are ten or fewer.
    """
    count = len(points)
    if count <= NEIGHBOURS:
        return np.ones(count, dtype=np.bool_)
    tree = KDTree(points)
    found: Any = tree.query(points, k=NEIGHBOURS + 1)  # a point's first neighbour is itself
    distances, nearest = found
    eps = float(np.percentile(distances[:, NEIGHBOURS], percentile))
    core = distances[:, NEIGHBOURS - 1] <= eps  # the point itself counts, as in `largest_clusters`
    pairs = tree.query_pairs(eps, output_type="ndarray")
    links = pairs[core[pairs[:, 0]] & core[pairs[:, 1]]].T
    graph = coo_array((np.ones(links.shape[1], dtype=np.int8), (links[0], links[1])), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    # A point that is not core has fewer than ten points within eps: its nearest core point is among these.
    reached = core[nearest] & (distances <= eps)
    bound = core | reached.any(axis=1)
    part = np.where(core, part, part[nearest[np.arange(count), np.argmax(reached, axis=1)]])
    return _largest(np.where(bound, part, -1).astype(np.int64))


def _largest(labels: NDArray[np.int64]) -> MaskArray:
    """(N,) bool: the label with most points, -1 not counted; all where there is no other."""
    named, first, sizes = np.unique(labels[labels >= 0], return_index=True, return_counts=True)
    if len(named) == 0:
        return np.ones(len(labels), dtype=np.bool_)
    largest: MaskArray = labels == named[np.lexsort((first, -sizes))[0]]
    return largest
