"""A rolling floor plan around the robot, from depth: where something stands, where the floor is free.

6 m wide with cells of 5 cm, in world axes; it moves with the robot and forgets what leaves it. Cells are
remembered, because the camera sees nothing lower than 0.33 m at 0.5 m distance (ALGORITHM E): what was seen
from further off still stands there. A cell counts as occupied after two frames (or one with many pixels)
show something in it between the step-over height and the robot's top, and no longer after its place was
seen through as often.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dssmsg.frame import FloatArray, Frame, IntArray, MaskArray
from dssmsg.geometry import Sight, depth_sigma, sight_of_points, world_rays
from dssmsg.navigation.astar import Cell
from dssmsg.navigation.footprint import covered

Point = tuple[float, float]
_SURE_HITS = 6
_STANDING_HITS = 2
"""What speaks for a cell being occupied counts no more than this."""


@dataclass(frozen=True, slots=True)
class GridOptions:
    """Metres. `low`..`high` are the heights of what is in the robot's way."""

    size: float = 6.0
    cell: float = 0.05
    low: float = 0.05
    high: float = 0.9
    max_range: float = 4.0
    footprint: float = 0.16
    """Where the robot itself stands is free, this far around its axis."""
    noise: tuple[float, float] = (0.001, 0.002)
    """(a, b) of the sensor's depth noise a + b z^2: floor pixels must not become obstacles."""
    body: float = 0.2
    """Unseen floor this close to something occupied counts as part of it where a way is looked for."""
    min_pixels: int = 3
    """Fewer pixels of a frame in a cell are taken as noise."""
    sure_pixels: int = 12
    """So many of one frame occupy a cell at once."""


@dataclass(frozen=True, slots=True)
class Corridor:
    """What the grid knows of a straight strip of floor.

    `obstacle`: where (x, y) the first occupied cell along it lies, None if none is; `cells` how many are.
    `free`: share of its cells known to be free; `fresh`: share that the newest frame showed free.
    """

    obstacle: Point | None
    cells: int
    free: float
    fresh: float


class RollingGrid:
    """Takes in every frame; all questions are in world metres."""

    def __init__(self, options: GridOptions | None = None) -> None:
        self.options = options or GridOptions()
        self._count = round(self.options.size / self.options.cell)
        shape = (self._count, self._count)
        self._corner: Cell | None = None
        self._hits = np.zeros(shape, dtype=np.int8)
        self._height = np.zeros(shape, dtype=np.float32)
        self._free = np.zeros(shape, dtype=np.bool_)
        self._fresh = np.zeros(shape, dtype=np.bool_)
        self._outlined = np.zeros(shape, dtype=np.bool_)
        self._touched: list[Point] = []
        self._clearance: dict[tuple[bool, bool], FloatArray] = {}

    def forget(self) -> None:
        """Begin with an empty floor plan (the robot was carried, or a visit ended)."""
        self._corner = None
        for array in (self._hits, self._height, self._free, self._fresh, self._outlined):
            array.fill(0)
        self._touched.clear()
        self._clearance.clear()

    def observe(self, frame: Frame) -> None:
        """Take in a frame's depth; the plan's middle follows the robot's base."""
        base = frame.world_from_base[:2, 3]
        self._roll((float(base[0]), float(base[1])))
        self._clearance.clear()
        hit = self._mark(frame)
        self._see_through(frame, hit)
        self._mark_touched()
        near = self._cells_around((float(base[0]), float(base[1])), self.options.footprint)
        self._hits[near], self._free[near], self._fresh[near] = 0, True, True

    def touch(self, places: Iterable[Point]) -> None:
        """Something was felt at these places (world metres): it stands there, whatever a camera says.

        They stay occupied until the plan is forgotten, also where they leave it meanwhile.
        """
        self._touched.extend(places)
        self._mark_touched()
        self._clearance.clear()

    def outline(self, rectangles: Sequence[FloatArray]) -> None:
        """What known things may cover, as corners (4, 2) each; it takes the place of what was told before."""
        self._outlined.fill(False)
        self._clearance = {key: room for key, room in self._clearance.items() if not key[1]}
        if self._corner is None:
            return
        x, y = (
            (np.arange(self._count, dtype=np.float64) + low + 0.5) * self.options.cell for low in self._corner
        )
        for corners in rectangles:
            rows = slice(*np.searchsorted(x, [corners[:, 0].min(), corners[:, 0].max()]))
            columns = slice(*np.searchsorted(y, [corners[:, 1].min(), corners[:, 1].max()]))
            self._outlined[rows, columns] |= covered(corners, x[rows], y[columns])

    def corridor(self, start: Point, end: Point, half_width: float, *, outlined: bool = False) -> Corridor:
        """What is known of the strip of `half_width` along a straight leg; cells outside are unknown.

        `outlined`: outlines of known things count as occupied.
        """
        if self._corner is None:
            return Corridor(None, 0, 0.0, 0.0)
        rows, columns, along = _leg_cells(start, end, half_width, self.options.cell)
        rows, columns = rows - self._corner[0], columns - self._corner[1]
        known = (rows >= 0) & (rows < self._count) & (columns >= 0) & (columns < self._count)
        if not known.all():
            rows, columns, along = rows[known], columns[known], along[known]
        cells = rows * self._count + columns
        occupied = self._hits.reshape(-1)[cells] >= _STANDING_HITS
        if outlined:
            occupied |= self._outlined.reshape(-1)[cells]
        total = _cell_count(start, end, half_width, self.options.cell)
        free = int(np.count_nonzero(self._free.reshape(-1)[cells])) / total
        fresh = int(np.count_nonzero(self._fresh.reshape(-1)[cells])) / total
        obstacle = None
        if occupied.any():
            nearest = int(np.where(occupied, along, np.inf).argmin())
            obstacle = self.center((int(rows[nearest]), int(columns[nearest])))
        return Corridor(obstacle, int(np.count_nonzero(occupied)), min(1.0, free), min(1.0, fresh))

    @property
    def occupied(self) -> MaskArray:
        """(n, n) bool: cells in which something stands."""
        standing: MaskArray = self._hits >= _STANDING_HITS
        return standing

    @property
    def known_free(self) -> MaskArray:
        """(n, n) bool: cells whose floor, or the space above it, was seen free."""
        return self._free & ~self.occupied

    @property
    def corner(self) -> Cell | None:
        """Cell (0, 0) of the plan in cells from the world's origin; None before the first frame."""
        return self._corner

    def clearance(self, *, hopeful: bool = False, outlined: bool = False) -> FloatArray:
        """(n, n) metres from each cell's middle to the nearest cell not to be touched (inf if none is).

        Those are the occupied ones and, unless `hopeful`, unseen ones close to them: a camera sees the face
        of a thing, and what lies behind it belongs to the thing. With `outlined` also those of outlines.
        """
        key = (hopeful, outlined)
        if key not in self._clearance:
            cells = self.occupied
            if not hopeful:
                cells = cells | ((self._distance(cells) <= self.options.body) & ~self._free)
            if outlined:
                cells = cells | self._outlined
            self._clearance[key] = self._distance(cells)
        return self._clearance[key]

    def _distance(self, cells: MaskArray) -> FloatArray:
        """(n, n) metres from each cell's middle to the nearest of `cells`."""
        if not cells.any():
            return np.full(cells.shape, np.inf)
        steps: FloatArray = ndimage.distance_transform_edt(~cells)
        return np.maximum(steps - 0.5, 0.0) * self.options.cell

    def cell(self, point: Point) -> Cell | None:
        """The cell of a place, None outside of the plan."""
        if self._corner is None:
            return None
        row, column = (
            math.floor(value / self.options.cell) - low
            for value, low in zip(point, self._corner, strict=True)
        )
        return (row, column) if 0 <= row < self._count and 0 <= column < self._count else None

    def center(self, cell: Cell) -> Point:
        """The middle of a cell. Raises ValueError before the first frame."""
        if self._corner is None:
            raise ValueError("the grid has seen no frame yet")
        x, y = (
            (index + low + 0.5) * self.options.cell for index, low in zip(cell, self._corner, strict=True)
        )
        return x, y

    # -- taking in a frame ------------------------------------------------------------------------------

    def _roll(self, middle: Point) -> None:
        low = tuple(math.floor(value / self.options.cell) - self._count // 2 for value in middle)
        corner = (low[0], low[1])
        if self._corner is None:
            self._corner = corner
        dx, dy = corner[0] - self._corner[0], corner[1] - self._corner[1]
        self._corner = corner
        if not (dx or dy):
            self._fresh.fill(False)
            return
        for array in (self._hits, self._height, self._free):
            _shift(array, dx, dy)
        self._fresh.fill(False)

    def _mark(self, frame: Frame) -> MaskArray:
        """Count the frame's points into cells; (n, n) bool: cells in which it shows something standing."""
        o, n = self.options, self._count
        assert self._corner is not None
        depth = frame.depth.astype(np.float64)
        x, y, fall = world_rays(frame.camera, frame.world_from_camera[:3, :3])
        place = frame.world_from_camera[:3, 3]
        height = fall * depth + (float(place[2]) - float(frame.world_from_base[2, 3]))
        # Along a ray the reading errs by sigma, so in height by sigma times the ray's fall.
        slack = 3.0 * depth_sigma(depth, o.noise) * np.abs(fall)
        telling = (depth > 0) & (depth < o.max_range) & (height > -0.1 - slack) & (height < o.high)
        pixels = np.flatnonzero(telling)
        depth, height, slack = (values.reshape(-1)[pixels] for values in (depth, height, slack))
        row, column = (
            (np.floor((rays.reshape(-1)[pixels] * depth + start) / o.cell) - low).astype(np.int32)
            for rays, start, low in zip((x, y), place[:2], self._corner, strict=True)
        )
        within = (row >= 0) & (row < n) & (column >= 0) & (column < n)
        flat, high = row * n + column, height > o.low + slack
        standing, floor = within & high, within & ~high
        hits = np.bincount(flat[standing], minlength=n * n).reshape(n, n)
        seen_floor = np.bincount(flat[floor], minlength=n * n).reshape(n, n)
        heights = np.bincount(flat[standing], weights=height[standing], minlength=n * n).reshape(n, n)
        hit: MaskArray = hits >= o.min_pixels
        self._hits[hit] = np.minimum(self._hits[hit] + 1 + (hits[hit] >= o.sure_pixels), _SURE_HITS)
        self._height[hit] = heights[hit] / hits[hit]
        clear = (seen_floor >= 1) & (hits == 0)
        self._free |= clear
        self._fresh |= clear
        some: MaskArray = hits > 0
        return some

    def _see_through(self, frame: Frame, hit: MaskArray) -> None:
        """Cells thought occupied whose place the camera looks through lose what spoke for them."""
        cells = np.argwhere((self._hits > 0) & ~hit)
        if not len(cells):
            return
        assert self._corner is not None
        middle = (cells + np.array(self._corner) + 0.5) * self.options.cell
        floor = float(frame.world_from_base[2, 3])
        places = np.column_stack([middle, floor + self._height[cells[:, 0], cells[:, 1]]])
        sight = sight_of_points(
            places, frame.depth, frame.camera, frame.world_from_camera, 0.15, self.options.max_range
        )
        rows, columns = cells[sight == Sight.SEEN_THROUGH].T
        self._hits[rows, columns] -= 1
        gone = self._hits[rows, columns] == 0
        self._free[rows[gone], columns[gone]] = True
        self._fresh[rows[gone], columns[gone]] = True

    def _mark_touched(self) -> None:
        for place in self._touched:
            cell = self.cell(place)
            if cell is not None:
                self._hits[cell], self._free[cell] = _SURE_HITS, False

    # -- cells of a place -------------------------------------------------------------------------------

    def _cells_around(self, middle: Point, radius: float) -> tuple[IntArray, IntArray]:
        reach = math.ceil(radius / self.options.cell) + 1
        centre = self.cell(middle)
        assert centre is not None  # the plan's middle is where the robot stands
        steps = np.arange(-reach, reach + 1, dtype=np.int32)
        rows, columns = (part.reshape(-1) for part in np.meshgrid(steps, steps, indexing="ij"))
        x, y = self.center(centre)
        away = np.hypot(rows * self.options.cell + x - middle[0], columns * self.options.cell + y - middle[1])
        near = away <= radius
        return (rows[near] + centre[0]).astype(np.int32), (columns[near] + centre[1]).astype(np.int32)


@lru_cache(maxsize=1024)  # the legs between waypoints are asked about from every key frame around
def _leg_cells(
    start: Point, end: Point, half_width: float, cell: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """World rows and columns (N,) of the cells in a strip along a leg, row by row, and their way along it."""
    low = [math.floor((min(start[axis], end[axis]) - half_width) / cell) for axis in (0, 1)]
    high = [math.floor((max(start[axis], end[axis]) + half_width) / cell) for axis in (0, 1)]
    x, y = ((np.arange(low[axis], high[axis] + 1) + 0.5) * cell for axis in (0, 1))
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy)
    ux, uy = (dx / length, dy / length) if length > 1e-9 else (1.0, 0.0)
    across, ahead = x[:, None] - start[0], y[None, :] - start[1]
    along = across * ux + ahead * uy
    aside = np.abs(across * uy - ahead * ux)
    rows, columns = np.nonzero((aside <= half_width) & (along >= 0.0) & (along <= length))
    way = along[rows, columns]
    return (rows + low[0]).astype(np.int32), (columns + low[1]).astype(np.int32), way


def _cell_count(start: Point, end: Point, half_width: float, cell: float) -> int:
    """About how many cells the whole strip has, those outside of the plan included."""
    return max(1, math.floor(0.97 * math.dist(start, end) * 2 * half_width / cell**2))


def _shift(array: NDArray[Any], dx: int, dy: int) -> None:
    """Move what a plan (n, n) holds by whole cells; what comes in is empty."""
    n = len(array)
    moved = np.zeros_like(array)
    if abs(dx) < n and abs(dy) < n:
        to = tuple(slice(max(0, -d), n - max(0, d)) for d in (dx, dy))
        source = tuple(slice(max(0, d), n - max(0, -d)) for d in (dx, dy))
        moved[to] = array[source]
    array[...] = moved
