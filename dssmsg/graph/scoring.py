"""The scores of object association, pure: ALGORITHM A.2 and A.3, after paper III-A.

s = s_geo + s_sem. Geometry is the share of an observation's points with a neighbour on the object
("neighborhood overlap"), semantics the normalised cosine of the text features.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from dssmsg.frame import Float32Array
from dssmsg.geometry import depth_sigma

MIN_TOLERANCE = 0.025
"""Metres: the voxel side, below which two clouds of one surface cannot be told apart."""


def neighbour_tolerance(range_m: float, noise: tuple[float, float]) -> float:
    """How far (metres) a point may be from an object's point and still lie on it: max(0.025, 2 sigma(z))."""
    return max(MIN_TOLERANCE, 2.0 * float(depth_sigma(range_m, noise)))


def neighbour_share(points: NDArray[np.floating[Any]], tree: KDTree, tolerance: float) -> float:
    """s_geo: share 0..1 of points (N, 3) that have a neighbour in the tree within `tolerance` metres."""
    if len(points) == 0:
        return 0.0
    # The bound of a query is exclusive, the tolerance is not.
    distances, _ = tree.query(points, distance_upper_bound=np.nextafter(tolerance, np.inf))
    return int(np.count_nonzero(np.isfinite(distances))) / len(points)


def sampled_share(
    points: NDArray[np.floating[Any]],
    tree: KDTree,
    tolerance: float,
    sample: int,
    thresholds: Sequence[float],
) -> float:
    """`neighbour_share` from `sample` points spread evenly over the cloud, exact wherever it matters.

    With n sampled points the share is off by more than e with probability below 2 exp(-2 n e^2)
    (Hoeffding; spreading evenly over points in grid order only lowers it). Where the estimate comes within
    e = sqrt(ln(2 / 0.005) / 2n) of one of the thresholds (0.077 for 512), all points are asked, so a decision
    differs from the exact one in fewer than 1 of 200 cases. The same cloud is always sampled alike.
    """
    count = len(points)
    if count <= sample:
        return neighbour_share(points, tree, tolerance)
    chosen = (np.arange(sample) * count) // sample
    share = neighbour_share(points[chosen], tree, tolerance)
    margin = math.sqrt(math.log(2 / 0.005) / (2 * sample))
    if any(abs(share - threshold) <= margin for threshold in thresholds):
        return neighbour_share(points, tree, tolerance)
    return share


def semantic_similarity(
    label_a: str,
    feature_a: Float32Array | None,
    label_b: str,
    feature_b: Float32Array | None,
    unnamed: frozenset[str] = frozenset(),
) -> float:
    """s_sem = (1 + cos) / 2 of two unit text features (D,), 0..1.

    Where a side has no feature the labels speak: 1.0 for the same label, 0.5 (cosine 0: no evidence)
    otherwise. Labels in `unnamed` ("object", from a class-agnostic perception) mean nothing: always 0.5.
    """
    if label_a in unnamed or label_b in unnamed:
        return 0.5
    if feature_a is None or feature_b is None:
        return 1.0 if label_a == label_b else 0.5
    # np.sum adds in a fixed order; the order of BLAS depends on threads and processor.
    cosine = float(np.sum(feature_a.astype(np.float64) * feature_b.astype(np.float64)))
    return (1.0 + min(1.0, max(-1.0, cosine))) / 2.0


def assign(scores: NDArray[np.float64], allowed: NDArray[np.bool_], alone: float) -> list[int]:
    """One-to-one assignment of rows to columns with the largest summed score.

    scores, allowed (N, M); a row without a column counts `alone`, the score at which it is better to
    start a new object: two weak pairs must not break up a strong one. The answer has one column, or -1, a
    row. Deterministic: the same input gives the same answer.
    """
    rows, columns = scores.shape
    answer = [-1] * rows
    if rows == 0 or columns == 0:
        return answer
    gain = np.where(allowed, np.maximum(scores - alone, 0.0) + 1e-9, 0.0)
    for row, column in zip(*linear_sum_assignment(gain, maximize=True), strict=True):
        if allowed[row, column]:
            answer[int(row)] = int(column)
    return answer


def confidence(votes: float, views: int, min_votes: float, min_views: float) -> float:
    """How far an object is believed, 0..1: 1 - 2^-(votes / min_votes + views / min_views).

    `votes` is the summed detection score behind the object's label, `views` the number of distinct
    viewpoints it was seen from. Each of the two halves the doubt once at its minimum, so both at their
    minimum give 0.75, and more of one makes up for less of the other: 3 votes from one viewpoint weigh as
    much as 2 votes from two (with both minima 2). Repeats from one place share their mistakes; that is why
    views count.
    """
    return 1.0 - math.exp2(-(votes / min_votes + views / min_views))
