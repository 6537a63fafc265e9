"""Where the robot can be: exact clearance along a leg, and paths on a grid around what stands in the way."""

from __future__ import annotations

import functools
import heapq
import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from dssmsg.frame import FloatArray
from dssmsg.sim.scene import Scene
from dssmsg.sim.solid import Solid, clearance

ROBOT_RADIUS = 0.18
ROBOT_HEIGHT = 0.88
STEP_OVER = 0.03
"""Things no higher than this (rugs) are driven over, metres."""
CELL = 0.05
Point = tuple[float, float]


def blocks(solid: Solid) -> bool:
    """Whether a solid is in the robot's way: above the step-over height, below the robot's top."""
    return solid.top > STEP_OVER and solid.bottom < ROBOT_HEIGHT


def _samples(start: Point, end: Point) -> FloatArray:
    """Points (N, 2) along a leg, at most a centimetre apart."""
    return np.linspace(start, end, max(2, math.ceil(math.dist(start, end) / 0.01) + 1))


class Occupancy:
    """The floor plan of a scene as the robot sees it: rooms, openings and the footprints of blocking solids.

    Lengths in metres, points are world (x, y).
    """

    def __init__(self, scene: Scene, solids: Sequence[Solid]) -> None:
        self.solids = tuple(solid for solid in solids if blocks(solid))
        low_x, high_x = min(r.x[0] for r in scene.rooms), max(r.x[1] for r in scene.rooms)
        low_y, high_y = min(r.y[0] for r in scene.rooms), max(r.y[1] for r in scene.rooms)
        self._origin = np.array([low_x, low_y])
        shape = (math.ceil((high_x - low_x) / CELL), math.ceil((high_y - low_y) / CELL))
        self._shape = shape

    @functools.cached_property
    def _room(self) -> FloatArray:
        """Clearance of every cell's centre; worked out when a path is first asked for."""
        index = np.stack(np.meshgrid(*map(np.arange, self._shape), indexing="ij"), axis=-1).reshape(-1, 2)
        return clearance(self._origin + (index + 0.5) * CELL, self.solids).reshape(self._shape)

    def clearance(self, points: Sequence[Point]) -> FloatArray:
        """Distance (N,) from each point to the nearest footprint."""
        return clearance(np.asarray(points, dtype=np.float64).reshape(-1, 2), self.solids)

    def leg_clearance(self, start: Point, end: Point) -> float:
        """Smallest distance to a footprint along the straight leg, sampled every centimetre."""
        return float(clearance(_samples(start, end), self.solids).min())

    def nearest_owner(self, start: Point, end: Point) -> str:
        """Name of the piece, or 'a wall', that comes nearest to the leg."""
        points = _samples(start, end)
        nearest = min(self.solids, key=lambda solid: float(clearance(points, [solid]).min()))
        return nearest.owner or "a wall"

    def nearest_free(self, point: Point, radius: float = ROBOT_RADIUS) -> Point | None:
        """The cell centre nearest to `point` at which a robot of `radius` fits; None if there is none."""
        free = np.argwhere(self._room > radius)
        if not len(free):
            return None
        centers = self._origin + (free + 0.5) * CELL
        best = centers[int(np.hypot(*(centers - np.asarray(point)).T).argmin())]
        return float(best[0]), float(best[1])

    def path(self, start: Point, end: Point, radius: float = ROBOT_RADIUS) -> tuple[Point, ...] | None:
        """Corner points from `start` to `end`, both included, legs clear of `radius`; None: no way.

        A* on the grid, 8-connected, prefers keeping 0.1 m more distance; then corners that a straight
        leg can skip are dropped.
        """
        cells = self._search(self._cell(start), self._cell(end), radius)
        if cells is None:
            return None
        centers = self._origin + (np.array(cells) + 0.5) * CELL
        points: list[Point] = [start, *((float(x), float(y)) for x, y in centers[1:-1]), end]
        wide = radius + 0.05
        smooth, here = [points[0]], 0
        while here < len(points) - 1:
            reach = here + 1
            for ahead in range(len(points) - 1, here + 1, -1):
                # A shortcut may come close to things only where the found path itself had to.
                along = float(self.clearance(points[here : ahead + 1]).min())
                if self.leg_clearance(points[here], points[ahead]) >= min(wide, max(along, radius)):
                    reach = ahead
                    break
            smooth.append(points[reach])
            here = reach
        if any(self.leg_clearance(a, b) <= radius for a, b in itertools.pairwise(smooth)):
            return None
        return tuple(smooth)

    def connected(self, points: Sequence[Point], radius: float = ROBOT_RADIUS) -> bool:
        """Whether a robot of `radius` gets from each of the points to every other, on the grid."""
        islands, _ = ndimage.label(self._room > radius)
        found = {int(islands[self._cell(point)]) for point in points}
        return len(found) <= 1 and 0 not in found

    def _cell(self, point: Point) -> tuple[int, int]:
        cell = np.floor((np.asarray(point) - self._origin) / CELL).astype(int)
        high = np.array(self._room.shape) - 1
        cell = np.clip(cell, 0, high)
        return int(cell[0]), int(cell[1])

    def _search(
        self, start: tuple[int, int], goal: tuple[int, int], radius: float
    ) -> list[tuple[int, int]] | None:
        free = self._room > radius
        # The ends themselves may lie in a cell whose centre is just too close; the legs are checked exactly.
        cost = {start: 0.0}
        parent: dict[tuple[int, int], tuple[int, int]] = {}
        queue = [(math.dist(start, goal), start)]
        done = set()
        while queue:
            _, cell = heapq.heappop(queue)
            if cell == goal:
                cells = [cell]
                while cell in parent:
                    cell = parent[cell]
                    cells.append(cell)
                return cells[::-1]
            if cell in done:
                continue
            done.add(cell)
            for dx in (-1, 0, 1):
                for dy in (-1, 0, 1):
                    other = (cell[0] + dx, cell[1] + dy)
                    if other == cell or not (0 <= other[0] < free.shape[0] and 0 <= other[1] < free.shape[1]):
                        continue
                    if not free[other] and other != goal:
                        continue
                    tight = max(0.0, radius + 0.1 - float(self._room[other])) * 30.0
                    total = cost[cell] + math.hypot(dx, dy) * (1.0 + tight)
                    if total < cost.get(other, math.inf):
                        cost[other] = total
                        parent[other] = cell
                        heapq.heappush(queue, (total + math.dist(other, goal), other))
        return None
