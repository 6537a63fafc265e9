"""Density clustering (DBSCAN) of voxelised surfaces, exact and fast.

The definition is that of Ester et al. (1996) with the point itself counted: a point with at least
`min_neighbours` points within `eps` is core; core points within `eps` of each other share a cluster; any
other point within `eps` of a core point belongs to the cluster of the nearest one (the original leaves
that choice to the order of visits); the rest is noise.

Most points need no search. In a grid of side eps / sqrt(6) any two points of one cell, or of two cells
that share a face, are at most eps apart: the largest distance is sqrt(1 + 1 + 4) sides. Hence a cell
whose own points and those behind its six faces are `min_neighbours` or more holds core points only, and
two such cells behind one face hold one cluster. What this leaves open, few points at rims and between
parts, is settled by exact search in a KD-tree, so that the result equals the definition.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from dssmsg.frame import FloatArray, MaskArray
from dssmsg.geometry import cell_keys

LabelArray = NDArray[np.int64]


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
    cell_of, cell_sizes, faces = _grid(points, eps / math.sqrt(6.0) * (1 - 1e-9))
    reach = cell_sizes.copy()
    np.add.at(reach, faces[:, 0], cell_sizes[faces[:, 1]])
    np.add.at(reach, faces[:, 1], cell_sizes[faces[:, 0]])
    sure_cell = reach >= min_neighbours
    sure_faces = faces[sure_cell[faces[:, 0]] & sure_cell[faces[:, 1]]]
    part_of_cell = _components(len(cell_sizes), sure_faces)

    # From here on a "part" is a set of core points known to be one cluster: a component of sure cells, or a
    # single point found to be core by search.
    core = sure_cell[cell_of]
    part = np.where(core, part_of_cell[cell_of], -1)
    open_points = np.flatnonzero(~core)
    tree = None
    if len(open_points):
        tree = _tree(points)
        lengths = tree.query_ball_point(points[open_points], eps, return_length=True)
        found = open_points[np.asarray(lengths) >= min_neighbours]
        core[found] = True
        part[found] = len(cell_sizes) + np.arange(len(found))
    if not core.any():
        return np.full(count, -1, dtype=np.int64)
    part = _join_parts(points, groups, core, part, eps)
    border = np.flatnonzero(~core)
    if len(border):
        core_indices = np.flatnonzero(core)
        nearest = _nearest_within(points[core_indices], points[border], eps)
        reached = nearest >= 0
        part[border[reached]] = part[core_indices[nearest[reached]]]
    return _number_by_first(part)


def _grid(points: FloatArray, side: float) -> tuple[LabelArray, LabelArray, LabelArray]:
    """Cell of each point (N,), points a cell (C,), and the pairs (F, 2) of cells that share a face."""
    keys, steps = cell_keys(points, side)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    sizes = np.diff(np.append(starts, len(points)))
    cell_of = np.empty(len(points), dtype=np.int64)
    cell_of[order] = np.repeat(np.arange(len(starts)), sizes)
    distinct = ordered[starts]
    pairs = []
    for step in steps:
        place = np.searchsorted(distinct, distinct + step)
        place[place == len(distinct)] = 0
        hit = np.flatnonzero(distinct[place] == distinct + step)
        pairs.append(np.stack([hit, place[hit]], axis=1))
    return cell_of, sizes.astype(np.int64), np.concatenate(pairs)


def _join_parts(
    points: FloatArray, groups: NDArray[np.intp], core: MaskArray, part: LabelArray, eps: float
) -> LabelArray:
    """Give parts with core points within eps of each other one number.

    Searches only around points off the largest part of their group: every link has an end there.
    """
    numbers, dense = np.unique(part[core], return_inverse=True)
    joined = np.full(len(part), -1, dtype=np.int64)
    joined[core] = dense
    core_indices = np.flatnonzero(core)
    sizes = np.bincount(dense)
    group_of = np.empty(len(numbers), dtype=np.intp)
    group_of[dense] = groups[core_indices]
    by_size = np.lexsort((-sizes, group_of))
    is_largest = np.zeros(len(numbers), dtype=np.bool_)
    is_largest[by_size[np.concatenate([[True], np.diff(group_of[by_size]) > 0])]] = True
    off = np.flatnonzero(~is_largest[dense])
    if len(off) == 0:
        return joined
    # Most parts touch the largest of their group: one nearest neighbour a point shows it. Only parts that do
    # not, and links among them, need all neighbours.
    main = np.flatnonzero(is_largest[dense])
    nearest = _nearest_within(points[core_indices[main]], points[core_indices[off]], eps)
    near = nearest >= 0
    links = np.stack([dense[off[near]], dense[main[nearest[near]]]], axis=1)
    loose = np.ones(len(numbers), dtype=np.bool_)
    loose[links[:, 0]] = False
    far = off[loose[dense[off]]]
    if len(far):
        found: Any = _tree(points[core_indices[off]]).query_ball_point(points[core_indices[far]], eps)
        lengths = [len(hits) for hits in found]
        others = off[np.concatenate([np.asarray(hits, dtype=np.int64) for hits in found])]
        links = np.concatenate([links, np.stack([dense[np.repeat(far, lengths)], dense[others]], axis=1)])
    joined[core] = _components(len(numbers), links)[dense]
    return joined


def _components(nodes: int, links: LabelArray) -> LabelArray:
    """Component number (nodes,) of an undirected graph with links (L, 2)."""
    graph = coo_array((np.ones(len(links), dtype=np.int8), (links[:, 0], links[:, 1])), shape=(nodes, nodes))
    _, labels = connected_components(graph.tocsr(), directed=False)
    return np.asarray(labels, dtype=np.int64)


def _nearest_within(points: FloatArray, asked: FloatArray, eps: float) -> LabelArray:
    """Index (M,) of the nearest of points (N, 3) to each of `asked` (M, 3), -1 where none is within eps."""
    # The bound of a query is exclusive, eps is not.
    distance, nearest = _tree(points).query(asked, distance_upper_bound=float(np.nextafter(eps, np.inf)))
    return np.where(np.isfinite(distance), nearest, -1).astype(np.int64)


def _tree(points: FloatArray) -> KDTree:
    """A KD-tree made for few searches: quick to build."""
    return KDTree(points, balanced_tree=False, compact_nodes=False)


def _number_by_first(part: LabelArray) -> LabelArray:
    """The same partition, numbered 0, 1, ... in order of first point; -1 stays."""
    named = part >= 0
    _, first, inverse = np.unique(part[named], return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    labels = np.full(len(part), -1, dtype=np.int64)
    labels[named] = rank[inverse]
    return labels
