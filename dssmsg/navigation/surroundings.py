"""What a driving robot knows of the floor around it, and what that means for its way (ALGORITHM E).

A rolling grid takes in the depth of every frame; here the way ahead is held against it: what stands in the
corridor, and how to get round it. What has left the grid stays in a floor plan, over which there are ways
that nobody has driven yet.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dssmsg.frame import FloatArray, Frame
from dssmsg.navigation.detour import Detour, DetourOptions, find_detour
from dssmsg.navigation.drive import base_heading
from dssmsg.navigation.grid import GridOptions, Point, RollingGrid
from dssmsg.navigation.pose import floor_place
from dssmsg.navigation.seen_floor import FreeWayOptions, SeenFloor

Outlines = Callable[[], Sequence[FloatArray]]

_FAR_M = 20.0
"""A way round may be this much longer than the straight one where nothing else leads to the goal."""
_TIGHT_M = 0.015
"""And through gaps that leave so little beside the robot."""
_BERTH_M = 0.025
"""What is nearer to the way than the robot's radius and this the robot might touch: half a cell."""
_TOUCH_RAD = math.radians(50.0)
_TOUCH_M = 0.05
"""What was touched is taken to stand across the robot's front, so far to either side and so deep."""
_UNSEEN_COST = 4.0
"""So many times as dear a step over floor is that was never seen, where nothing else leads to the goal."""


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Something in the corridor: where (x, y) it begins, on which leg of the way, in how many cells."""

    place: Point
    leg: int
    cells: int


class Surroundings:
    """Takes in every frame, and answers in world metres.

    `radius` is the robot's, `half_width` half the width of a driven way that must be clear, `reach` how far
    ahead the way is watched. `outlines` tells what known things may cover: corners (4, 2) each, world metres.
    """

    def __init__(
        self,
        grid: GridOptions,
        radius: float,
        half_width: float,
        reach: float,
        outlines: Outlines = tuple,
    ) -> None:
        self._grid = RollingGrid(grid)
        self._seen_floor = SeenFloor(grid.cell)
        self._outlines = outlines
        self._radius = radius
        self._half_width = half_width
        self._reach = reach
        near_round = DetourOptions(radius=radius, half_width=half_width)
        self._berth = replace(near_round, outlined=True)
        self._round = (self._berth, near_round)
        far_round = replace(near_round, extra=_FAR_M)
        squeezing = replace(far_round, margin=_TIGHT_M)
        self._last_resorts = (
            replace(far_round, outlined=True), far_round, squeezing, replace(squeezing, hopeful=True),
        )  # fmt: skip
        free = FreeWayOptions(radius=radius)
        plain = replace(free, outlined=False)
        self._free_ways = (free, plain, replace(plain, margin=_TIGHT_M))
        self._unseen_ways = (replace(plain, margin=_TIGHT_M, unknown_cost=_UNSEEN_COST),)
        self._seen: tuple[int, int] | None = None
        self._told = False

    def observe(self, frame: Frame) -> None:
        """Take a frame's depth in, once; another visit begins with an empty grid, and the old plan."""
        seen = (frame.visit, frame.index)
        if self._seen == seen:
            return
        if self._seen is not None and self._seen[0] != frame.visit:
            self._grid.forget()
        self._seen = seen
        self._grid.observe(frame)
        self._seen_floor.take(self._grid)
        self._told = False

    def touch(self, frame: Frame, *, backwards: bool = False) -> None:
        """The robot has touched something that it drove against: that stands there for the rest of the visit.

        A bump does not tell on which side; all of the robot's front (or back) counts.
        """
        x, y = floor_place(frame)
        ahead = base_heading(frame.world_from_base) + math.pi * backwards
        cell = self._grid.options.cell
        self._grid.touch(
            (x + away * math.cos(angle), y + away * math.sin(angle))
            for away in (self._radius + cell / 2, self._radius + cell / 2 + _TOUCH_M)
            for angle in np.arange(ahead - _TOUCH_RAD, ahead + _TOUCH_RAD + 1e-9, math.radians(10.0)).tolist()
        )
        self._seen_floor.take(self._grid)

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
        """The first thing within reach that a robot exactly on the way might touch, outlines included."""
        self._tell_outlines()
        return self._first(start, points, [], self._radius + _BERTH_M, outlined=True)

    def way_round(
        self, start: Point, way: Sequence[Point], *, far: bool = False, berth: bool = False
    ) -> Detour | None:
        """Back onto the way behind what blocks it, round the outlines of known things where there is room.

        `far`: however long it takes, then through narrow gaps, then over unseen floor right behind things.
        `berth`: round outlines or not at all.
        """
        self._tell_outlines()
        kinds = (self._berth,) if berth else self._last_resorts if far else self._round
        found = (find_detour(self._grid, start, way, options) for options in kinds)
        return next((detour for detour in found if detour is not None), None)

    def free_way(self, start: Point, end: Point, *, unseen: bool = False) -> tuple[Point, ...] | None:
        """Corners to a place, or close to it, over all floor that was ever seen free; None without a way.

        `unseen`: also over floor that was never seen.
        """
        outlines = self._outlines()
        found = (
            self._seen_floor.way(start, end, options, outlines)
            for options in (self._unseen_ways if unseen else self._free_ways)
        )
        return next((way for way in found if way is not None), None)

    def blocked_place(self, start: Point, end: Point) -> Point | None:
        """Where a straight leg is blocked first, as far as the grid shows it."""
        return self._grid.corridor(start, end, self._half_width).obstacle

    def _tell_outlines(self) -> None:
        """Tell the grid of the outlines, once a frame: where its cells lie has changed, and the map."""
        if not self._told:
            self._grid.outline(self._outlines())
            self._told = True

    def _first(
        self,
        start: Point,
        points: Sequence[Point],
        widths: Sequence[float],
        otherwise: float,
        *,
        outlined: bool = False,
    ) -> Obstacle | None:
        left = self._reach
        for leg, (a, b) in enumerate(itertools.pairwise([start, *points])):
            length = math.dist(a, b)
            share = min(1.0, left / length) if length > 1e-9 else 1.0
            end = (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))
            width = widths[leg] if leg < len(widths) else otherwise
            corridor = self._grid.corridor(a, end, width, outlined=outlined)
            if corridor.obstacle is not None:
                return Obstacle(corridor.obstacle, leg, corridor.cells)
            left -= length
            if left <= 0:
                break
        return None
