"""What a driving robot knows of the floor around it, and what that means for its way (ALGORITHM E).

A rolling grid takes in the depth of every frame; here the way ahead is held against it: what stands in the
corridor, and how to get round it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from dssmsg.frame import Frame
from dssmsg.navigation.detour import Detour, DetourOptions, find_detour
from dssmsg.navigation.grid import GridOptions, Point, RollingGrid

_FAR_M = 20.0
"""A way round may be this much longer than the straight one where nothing else leads to the goal."""
_TIGHT_M = 0.015
"""And through gaps that leave so little beside the robot."""
_BERTH_M = 0.025
"""What is nearer to the way than the robot's radius and this the robot might touch: half a cell."""


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Something in the corridor: where (x, y) it begins, on which leg of the way, in how many cells."""

    place: Point
    leg: int
    cells: int


class Surroundings:
    """Takes in every frame, and answers in world metres.

    `radius` is the robot's, `half_width` half the width of a driven way that must be clear, `reach` how far
    ahead the way is watched.
    """

    def __init__(self, grid: GridOptions, radius: float, half_width: float, reach: float) -> None:
        self._grid = RollingGrid(grid)
        self._radius = radius
        self._half_width = half_width
        self._reach = reach
        self._round = DetourOptions(radius=radius, half_width=half_width)
        far_round = replace(self._round, extra=_FAR_M)
        squeezing = replace(far_round, margin=_TIGHT_M)
        self._last_resorts = (far_round, squeezing, replace(squeezing, hopeful=True))
        self._seen: tuple[int, int] | None = None

    def observe(self, frame: Frame) -> None:
        """Take a frame's depth into the grid, once; another visit begins with an empty one."""
        seen = (frame.visit, frame.index)
        if self._seen == seen:
            return
        if self._seen is not None and self._seen[0] != frame.visit:
            self._grid.forget()
        self._seen = seen
        self._grid.observe(frame)

    def obstacle(self, start: Point, points: Sequence[Point], undriven: int = 0) -> Obstacle | None:
        """The first thing in the way within reach.

        A way may pass as close to things as it was driven once; so many of its first legs as are `undriven`
        must be as wide as the robot, but for what it stands close to already.
        """
        width = self._half_width
        if undriven:
            cell = self._grid.cell(start)
            room = math.inf if cell is None else float(self._grid.clearance(hopeful=True)[cell])
            width = max(width, min(self._radius + _BERTH_M, room))
        return self._first(start, points, [width] * undriven, self._half_width)

    def close_by(self, start: Point, points: Sequence[Point]) -> Obstacle | None:
        """The first thing within reach that a robot exactly on the way might touch, as cells go."""
        return self._first(start, points, [], self._radius + _BERTH_M)

    def way_round(self, start: Point, way: Sequence[Point], *, far: bool = False) -> Detour | None:
        """Back onto the way behind what blocks it.

        `far`: however long it takes, else through narrow gaps, else over unseen floor right behind things.
        """
        found = (
            find_detour(self._grid, start, way, options)
            for options in (self._last_resorts if far else (self._round,))
        )
        return next((detour for detour in found if detour is not None), None)

    def blocked_place(self, start: Point, end: Point) -> Point | None:
        """Where a straight leg is blocked first, as far as the grid shows it."""
        return self._grid.corridor(start, end, self._half_width).obstacle

    def _first(
        self, start: Point, points: Sequence[Point], widths: Sequence[float], otherwise: float
    ) -> Obstacle | None:
        left = self._reach
        for leg, (a, b) in enumerate(itertools.pairwise([start, *points])):
            length = math.dist(a, b)
            share = min(1.0, left / length) if length > 1e-9 else 1.0
            end = (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))
            corridor = self._grid.corridor(a, end, widths[leg] if leg < len(widths) else otherwise)
            if corridor.obstacle is not None:
                return Obstacle(corridor.obstacle, leg, corridor.cells)
            left -= length
            if left <= 0:
                break
        return None
