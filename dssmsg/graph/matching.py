"""A target graph against a local subgraph: s_node (eq. 3) and the exact optimum of s_top (eq. 4-5).

The paper enumerates permutations. The same maximum is reached here without it. Of a matching only two sums
count: `a`, the inner product of the two degree vectors, and `b`, the squared length of the candidate's. Both
are linear in the matched pairs, and the cosine grows with a^2 / b, which is convex: its maximum lies on a
vertex of the convex hull of all points (b, a), on the side of large a and small b. For a slope p / q the
vertex that maximises q a - p b is a linear assignment (with t = 2 p / q this is the matching that minimises
the sum of (deg_tar - t deg_can)^2), and following the breakpoints of that one-dimensional problem visits
every vertex that can win. Degrees are whole numbers, so all of it is exact.

A matching is one-to-one and of the largest size that the allowed pairs give; a target node that is left over
has candidate degree 0. Zero vectors have no direction: a target graph without edges asks for no topology, and
s_top is the share of its nodes matched; a candidate whose matched nodes have no `near` edge scores 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from dssmsg.frame import FloatArray, MaskArray

UNMATCHED = -1
ZERO, DROP = "zero", "drop"
"""What a target node without a partner does to the vectors: degree 0, or it is left out of both."""
_EXACT = 2**52
"""Up to here sums of whole numbers are exact in the doubles that the assignment works with."""
_STEPS = 10**6
"""Similarities decide between equal scores to this many steps a unit, fewer where that would not be exact."""

Degrees = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class TopologyMatch:
    """The best matching. columns (T,): the object of each target node, -1 for none.

    `score` is s_top, 0..1; `similarity` the summed similarity of the matched pairs, which decides between
    matchings of equal score.
    """

    score: float
    columns: NDArray[np.int64]
    similarity: float


@dataclass(slots=True, eq=False)
class _Vertex:
    """A matching as a point: a = deg_tar . deg_can, b = |deg_can|^2; and the slopes it was found best at."""

    a: int
    b: int
    flattest: float = math.inf
    steepest: float = 0.0

    def beats(self, other: _Vertex) -> int:
        """Sign of the difference of both cosines; exact."""
        left, right = self.a**2 * max(other.b, 1), other.a**2 * max(self.b, 1)
        return (left > right) - (left < right)

    @property
    def square(self) -> float:
        """a^2 / b, which grows with the cosine."""
        return self.a**2 / max(self.b, 1)


def node_score(similarity: FloatArray) -> float:
    """s_node (eq. 3) of similarities (T, N): every target node's best, averaged; 0 without objects."""
    if not similarity.size:
        return 0.0
    return float(similarity.max(axis=1).mean())


def match_topology(
    wanted: Degrees,
    offered: Degrees,
    allowed: MaskArray,
    similarity: FloatArray,
    *,
    unmatched: str = ZERO,
) -> TopologyMatch:
    """s_top (eq. 4-5) maximised over matchings.

    wanted (T,) degrees in the target graph; offered (N,) degrees in the subgraph; allowed (T, N) which pairs
    may match; similarity (T, N) cosines, which only break ties. With `unmatched="drop"` the vectors of the
    best matching are shortened to the matched nodes before they are compared.
    """
    problem = _Problem(wanted, offered, allowed)
    if not allowed.any():
        return TopologyMatch(0.0, np.full(len(wanted), UNMATCHED), 0.0)
    winners = problem.winners() if wanted.any() else []
    best: tuple[float, NDArray[np.int64]] | None = None
    for vertex in winners or [_Vertex(0, 0)]:
        columns = problem.solve_tie(vertex, similarity)
        total = _total(similarity, columns)
        if best is None or total > best[0]:
            best = total, columns
    assert best is not None
    total, columns = best
    return TopologyMatch(_score(wanted, offered, columns, unmatched), columns, total)


class _Problem:
    """One target graph and one subgraph; slopes and weights are whole numbers."""

    def __init__(self, wanted: Degrees, offered: Degrees, allowed: MaskArray) -> None:
        self._allowed = allowed
        self._pairs = min(allowed.shape)
        self._products = np.multiply.outer(wanted, offered)
        self._squares = np.broadcast_to(offered * offered, allowed.shape)
        self._a_limit = int(self._products.max(initial=0)) * self._pairs
        self._b_limit = int(self._squares.max(initial=0)) * self._pairs
        self._found: dict[tuple[int, int], _Vertex] = {}

    def winners(self) -> list[_Vertex]:
        """The vertices with the largest cosine (more than one only if exactly equal)."""
        low, high = self._visit(self._a_limit + 1, 1), self._visit(1, self._b_limit + 1)
        best = low if low.beats(high) > 0 else high
        stretches = [(low, high)] if low is not high else []
        while stretches:
            # The most promising one first: what it finds shows of others that they cannot reach it.
            left, right = stretches.pop(max(range(len(stretches)), key=lambda one: _limit(*stretches[one])))
            if _limit(left, right) < best.square * (1 - 1e-9):
                break
            p, q = right.a - left.a, right.b - left.b
            between = self._visit(p, q)
            if q * between.a - p * between.b > q * left.a - p * left.b:
                stretches += [(left, between), (between, right)]
                best = between if between.beats(best) > 0 else best
        return [one for one in self._found.values() if one.beats(best) == 0]

    def _visit(self, p: int, q: int) -> _Vertex:
        """The vertex that maximises q a - p b."""
        divisor = math.gcd(p, q)
        columns = self._solve(q // divisor * self._products - p // divisor * self._squares)
        rows = np.flatnonzero(columns >= 0)
        chosen = rows, columns[rows]
        a, b = int(self._products[chosen].sum()), int(self._squares[chosen].sum())
        vertex = self._found.setdefault((b, a), _Vertex(a, b))
        vertex.flattest, vertex.steepest = min(vertex.flattest, p / q), max(vertex.steepest, p / q)
        return vertex

    def solve_tie(self, vertex: _Vertex, similarity: FloatArray) -> NDArray[np.int64]:
        """Of the matchings at a vertex the one with the largest summed similarity.

        The slope of the level curve, a / 2b, touches the hull at that vertex alone, so that whatever is best
        there lies at it, and similarity decides among these.
        """
        weights = 2 * vertex.b * self._products - vertex.a * self._squares
        reach = 2 * (self._pairs + 1) ** 2 * (1 + int(np.abs(weights).max(initial=0)))
        steps = min(_STEPS, _EXACT // (2 * reach * (self._pairs + 1)))
        if steps < 1:
            return self._solve(weights)
        fine = np.rint(np.clip(similarity, -1.0, 1.0) * steps).astype(np.int64)
        return self._solve(weights * (2 * steps * self._pairs + 1) + fine)

    def _solve(self, weights: NDArray[np.int64]) -> NDArray[np.int64]:
        """The largest matching of allowed pairs with the largest summed weight, as columns (T,)."""
        # Every allowed pair is worth more than all weights together, so none is forgone for their sake; a
        # pair that is not allowed is worth nothing and means unmatched.
        bonus = 2 * self._pairs * (int(np.abs(weights).max(initial=0)) + 1)
        rows, columns = linear_sum_assignment(
            np.where(self._allowed, weights + bonus, 0).astype(np.float64), maximize=True
        )
        found = np.full(len(weights), UNMATCHED)
        real = self._allowed[rows, columns]
        found[rows[real]] = columns[real]
        return found


def _limit(left: _Vertex, right: _Vertex) -> float:
    """The most that a^2 / b can be between two vertices: its value where their supporting lines meet."""
    slope_left, slope_right = left.flattest, right.steepest
    if slope_left <= slope_right:
        return max(left.square, right.square)
    b = (right.a - left.a + slope_left * left.b - slope_right * right.b) / (slope_left - slope_right)
    a = left.a + slope_left * (b - left.b)
    return a * a / b if b > 0 else math.inf


def _score(wanted: Degrees, offered: Degrees, columns: NDArray[np.int64], unmatched: str) -> float:
    matched = columns >= 0
    if not wanted.any():
        return float(np.count_nonzero(matched)) / len(wanted)
    found = np.where(matched, offered[columns], 0)
    sought = np.where(matched, wanted, 0) if unmatched == DROP else wanted
    lengths = int(sought @ sought) * int(found @ found)
    return float(sought @ found) / math.sqrt(lengths) if lengths else 0.0


def _total(similarity: FloatArray, columns: NDArray[np.int64]) -> float:
    rows = np.flatnonzero(columns >= 0)
    return float(similarity[rows, columns[rows]].sum())
