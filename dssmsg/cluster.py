"""Density clustering (DBSCAN) of voxelised surfaces, exact and fast.

The definition is that of Ester et al. (1996) with the point itself counted: a point with at least
`min_neighbours` points within `eps` is core; core points within `eps` of each other share a cluster; any
other point within `eps` of a core point belongs to the cluster of the nearest one (the original leaves
that choice to the order of visits); the rest is noise.

Most points need no search. In a grid of side eps / sqrt(6) any two points of one cell, or of two cells
that share a face, are at most eps apart: the largest distance is sqrt(1 + 1 + 4) sides. Hence a cell
whose own points and those behind its six faces are `min_neighbours` or more holds core points only. In a
grid of side eps / sqrt(12) the same holds of two cells that share a corner, and so core points in cells that
hang together are of one cluster. What this leaves open, few points at rims and gaps between parts, is
settled by exact search in a KD-tree, so that the result equals the definition.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dssmsg.frame import FloatArray, MaskArray
from dssmsg.geometry import cell_keys
from dssmsg.neighbours import quick_tree

LabelArray = NDArray[np.int64]
_FACES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
_HALF_AROUND = tuple(
    (x, y, z) for x, y, z in itertools.product((-1, 0, 1), repeat=3) if (x, y, z) > (0, 0, 0)
)
"""Half of the 26 cells around one; the other half lies the other way."""


def density_clusters(
    points: FloatArray, eps: float, min_neighbours: int, groups: NDArray[np.intp] | None = None
) -> LabelArray:
    """Cluster number (N,) of points (N, 3) in metres, -1 = noise; clusters count from 0 by first point.

    `groups` (N,), numbers from 0, are sets of points to be clustered apart from each other in one call.
    """
    count = len(points)
    if count == 0:
        return np.zeros(0, dtype=np.int64)
    if groups is None:
        groups = np.zeros(count, dtype=np.intp)
    else:  # move each group along x out of reach of the others
        points = points.copy()
        points[:, 0] += groups * (float(np.ptp(points[:, 0])) + 2 * eps)
    cell_of, cell_sizes, faces = _grid(points, eps / math.sqrt(6.0) * (1 - 1e-9), _FACES)
    reach = cell_sizes.copy()
    np.add.at(reach, faces[:, 0], cell_sizes[faces[:, 1]])
    np.add.at(reach, faces[:, 1], cell_sizes[faces[:, 0]])
    core = (reach >= min_neighbours)[cell_of]
    open_points = np.flatnonzero(~core)
    if len(open_points):
        core[open_points] = _have_within(points, points[open_points], min_neighbours, eps)
    part = np.full(count, -1, dtype=np.int64)
    if not core.any():
        return part
    core_points = points[core]
    part[core] = _parts(core_points, groups[core], eps)
    border = np.flatnonzero(~core)
    if len(border):
        nearest = _nearest_within(core_points, points[border], eps)
        reached = nearest >= 0
        part[border[reached]] = part[core][nearest[reached]]
    return _number_by_first(part)


def _grid(
    points: FloatArray, side: float, around: Sequence[tuple[int, int, int]]
) -> tuple[LabelArray, LabelArray, LabelArray]:
    """Cell of each point (N,), points a cell (C,), and the pairs (F, 2) of cells that are `around` apart."""
    keys, steps = cell_keys(points, side)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    sizes = np.diff(np.append(starts, len(points)))
    cell_of = np.empty(len(points), dtype=np.int64)
    cell_of[order] = np.repeat(np.arange(len(starts)), sizes)
    distinct = ordered[starts]
    pairs = []
    for x, y, z in around:
        beside = distinct + (x * steps[0] + y * steps[1] + z * steps[2])
        place = np.searchsorted(distinct, beside)
        place[place == len(distinct)] = 0
        hit = np.flatnonzero(distinct[place] == beside)
        pairs.append(np.stack([hit, place[hit]], axis=1))
    return cell_of, sizes.astype(np.int64), np.concatenate(pairs)


def _parts(points: FloatArray, groups: NDArray[np.intp], eps: float) -> LabelArray:
    """The cluster (N,) of each of core points (N, 3): those within eps of each other share one."""
    cell_of, cell_sizes, touching = _grid(points, eps / math.sqrt(12.0) * (1 - 1e-9), _HALF_AROUND)
    part = _components(len(cell_sizes), touching)[cell_of]
    # Gaps wider than a cell are searched around points off the largest part of their group: every link over
    # one has an end there.
    sizes = np.bincount(part)
    group_of = np.empty(len(sizes), dtype=np.intp)
    group_of[part] = groups
    by_size = np.lexsort((-sizes, group_of))
    is_largest = np.zeros(len(sizes), dtype=np.bool_)
    is_largest[by_size[np.concatenate([[True], np.diff(group_of[by_size]) > 0])]] = True
    off = np.flatnonzero(~is_largest[part])
    if len(off) == 0:
        return part
    # Most parts touch the largest of their group: one nearest neighbour a point shows it. Only parts that do
    # not, and links among them, need all neighbours.
    main = np.flatnonzero(is_largest[part])
    nearest = _nearest_within(points[main], points[off], eps)
    near = nearest >= 0
    links = np.stack([part[off[near]], part[main[nearest[near]]]], axis=1)
    loose = np.ones(len(sizes), dtype=np.bool_)
    loose[links[:, 0]] = False
    far = off[loose[part[off]]]
    if len(far):
        found: Any = quick_tree(points[off]).query_ball_point(points[far], eps)
        lengths = [len(hits) for hits in found]
        others = off[np.concatenate([np.asarray(hits, dtype=np.int64) for hits in found])]
        links = np.concatenate([links, np.stack([part[np.repeat(far, lengths)], part[others]], axis=1)])
    return _components(len(sizes), links)[part]


def _components(nodes: int, links: LabelArray) -> LabelArray:
    """Component number (nodes,) of an undirected graph with links (L, 2)."""
    graph = coo_array((np.ones(len(links), dtype=np.int8), (links[:, 0], links[:, 1])), shape=(nodes, nodes))
    _, labels = connected_components(graph.tocsr(), directed=False)
    return np.asarray(labels, dtype=np.int64)


def _nearest_within(points: FloatArray, asked: FloatArray, eps: float) -> LabelArray:
    """Index (M,) of the nearest of points (N, 3) to each of `asked` (M, 3), -1 where none is within eps."""
    # The bound of a query is exclusive, eps is not.
    bound = float(np.nextafter(eps, np.inf))
    distance, nearest = quick_tree(points).query(asked, distance_upper_bound=bound)
    return np.where(np.isfinite(distance), nearest, -1).astype(np.int64)


def _have_within(points: FloatArray, asked: FloatArray, n: int, eps: float) -> MaskArray:
    """(M,) bool: which of `asked` (M, 3) have n of points (N, 3) within eps: the n-th nearest tells."""
    bound = float(np.nextafter(eps, np.inf))
    distance: Any = quick_tree(points).query(asked, k=[n], distance_upper_bound=bound)[0]
    within: MaskArray = np.isfinite(distance[:, 0])
    return within


def _number_by_first(part: LabelArray) -> LabelArray:
    """The same partition, numbered 0, 1, ... in order of first point; -1 stays."""
    named = part >= 0
    _, first, inverse = np.unique(part[named], return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    labels = np.full(len(part), -1, dtype=np.int64)
    labels[named] = rank[inverse]
    return labels
