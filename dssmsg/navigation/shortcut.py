"""A way over cells made into few straight legs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from dssmsg.frame import FloatArray
from dssmsg.navigation.astar import Cell

Point = tuple[float, float]
_SLACK = 1.15
"""A straight leg may cost so many times what the path that it replaces costs where that is dearest."""


class Plan(Protocol):
    """A floor plan of square cells: see `RollingGrid` and `SeenFloor`."""

    def cell(self, point: Point) -> Cell | None:
        """The cell of a place (world metres), None outside of the plan."""
        ...

    def center(self, cell: Cell) -> Point:
        """The middle of a cell, world metres."""
        ...


def corners_of(
    plan: Plan, cost: FloatArray, start: Point, cells: Sequence[Cell], end: Point
) -> tuple[Point, ...]:
    """The path with its needless bends left out, where a straight leg comes no closer to things than it.

    cost (n, m): what a step into each cell costs, inf where one must not go. The corners begin behind `start`
    and end with `end`, world metres.
    """
    points = [start, *(plan.center(cell) for cell in cells[1:-1]), end]
    prices = [float(cost[cell]) for cell in cells]
    corners, here = [], 0
    while here < len(points) - 1:
        ahead = len(points) - 1
        while ahead > here + 1 and not _passable(
            plan, cost, points[here], points[ahead], _SLACK * max(prices[here : ahead + 1])
        ):
            ahead -= 1
        corners.append(points[ahead])
        here = ahead
    return tuple(corners)


def _passable(plan: Plan, cost: FloatArray, a: Point, b: Point, most: float) -> bool:
    """Whether every cell of a straight leg costs no more than `most`."""
    side = abs(plan.center((1, 0))[0] - plan.center((0, 0))[0])
    count = max(2, math.ceil(2 * math.dist(a, b) / side))
    for x, y in zip(np.linspace(a[0], b[0], count), np.linspace(a[1], b[1], count), strict=True):
        cell = plan.cell((float(x), float(y)))
        if cell is None or not cost[cell] <= most:
            return False
    return True
