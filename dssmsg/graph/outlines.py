"""Outlines of things on the floor: the smallest rectangle around each one's points, seen from above.

A camera that looks down sees the top of an armchair, not how far its feet reach. Furniture is rectangular
more often than not, so a robot that has room keeps off the whole rectangle.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from dssmsg.frame import Float32Array, FloatArray
from dssmsg.graph.nodes import DISAPPEARED
from dssmsg.graph.view import GraphView


class Outlines:
    """What the things of a map may cover of the floor; each is worked out again only when its points change.

    Only things that reach between two heights, metres above the world's floor, count.
    """

    def __init__(self, graph: GraphView, low: float, high: float) -> None:
        self._graph = graph
        self._low, self._high = low, high
        self._known: dict[str, tuple[Float32Array, FloatArray]] = {}

    def __call__(self) -> list[FloatArray]:
        """Corners (4, 2), world metres, of every such thing that is there as far as the map knows."""
        found = []
        for name, node in self._graph.objects.items():
            standing = node.box_min[2] < self._high and node.box_max[2] > self._low
            if node.state == DISAPPEARED or not standing or not len(node.points):
                continue
            known = self._known.get(name)
            if known is None or known[0] is not node.points:
                known = self._known[name] = (node.points, outline(node.points))
            found.append(known[1])
        return found


def outline(points: Float32Array | FloatArray) -> FloatArray:
    """Corners (4, 2) in order of the rectangle of least area around points (N, 2 or more), world metres.

    One side of it lies on a side of the convex hull. Points on one line give a rectangle without width; no
    points raise ValueError.
    """
    plan = np.asarray(points, dtype=np.float64)[:, :2]
    if not len(plan):
        raise ValueError("expected at least one point")
    try:
        hull = plan[ConvexHull(plan).vertices]
    except QhullError:  # fewer than three, or all on a line
        hull = plan
    sides = np.diff(np.vstack([hull, hull[:1]]), axis=0)
    lengths = np.hypot(*sides.T)
    along = sides[lengths > 1e-9] / lengths[lengths > 1e-9, None]
    if not len(along):
        return np.repeat(plan[:1], 4, axis=0)
    best: FloatArray | None = None
    least = np.inf
    for axis in along:
        across = np.array([-axis[1], axis[0]])
        u, v = hull @ axis, hull @ across
        area = float(np.ptp(u) * np.ptp(v))
        if best is None or area < least - 1e-12:
            least = area
            pairs = [(u.min(), v.min()), (u.max(), v.min()), (u.max(), v.max()), (u.min(), v.max())]
            best = np.array([a * axis + b * across for a, b in pairs])
    assert best is not None
    return best
