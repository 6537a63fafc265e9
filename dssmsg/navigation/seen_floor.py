"""What all rolling grids of a run have shown of the floor, kept; and ways over it (ALGORITHM E).

The topology knows the ways that were driven. Where all of them are blocked there may still be floor that was
only seen: through another door, or along the other side of a room.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dssmsg.frame import FloatArray, MaskArray
from dssmsg.navigation.astar import Cell, cheapest_way
from dssmsg.navigation.footprint import covered
from dssmsg.navigation.grid import Point, RollingGrid
from dssmsg.navigation.shortcut import corners_of

_UNKNOWN, _FREE, _OCCUPIED = 0, 1, 2
_GROW = 40
"""Cells by which the plan grows beyond what made it grow."""


@dataclass(frozen=True, slots=True)
class FreeWayOptions:
    """Metres, unless said otherwise."""

    radius: float = 0.18
    margin: float = 0.04
    """On top of the radius: cells and readings are not exact."""
    comfort: float = 0.15
    """Further from things than radius + margin by this, a cell costs nothing extra."""
    unknown_cost: float = math.inf
    """How many times as dear a step over floor is that was never seen; inf: never."""
    outlined: bool = True
    """Whether the outlines of known things are kept off."""
    near_end: float = 0.6
    """Where the end itself cannot be reached, a place this near stands in for it."""


class SeenFloor:
    """Takes over what a rolling grid knows; all questions are in world metres.

    Cells are those of the grids: free, occupied, or never seen. What was seen last counts, so what stands in
    a plan of an earlier visit stays until somebody looks there again.
    """

    def __init__(self, cell: float = 0.05) -> None:
        self._cell = cell
        self._corner: Cell | None = None
        self._state: NDArray[np.uint8] = np.zeros((0, 0), dtype=np.uint8)

    def take(self, grid: RollingGrid) -> None:
        """Take over the cells that a grid knows."""
        corner = grid.corner
        if corner is None:
            return
        occupied, free = grid.occupied, grid.known_free
        window = self._window(corner, occupied.shape)
        self._state[window][free] = _FREE
        self._state[window][occupied] = _OCCUPIED

    def way(
        self,
        start: Point,
        end: Point,
        options: FreeWayOptions | None = None,
        outlines: Sequence[FloatArray] = (),
    ) -> tuple[Point, ...] | None:
        """Corner points from `start` (left out) to `end` or a place near it; None if there is no way.

        `outlines`: corners (4, 2) of what known things may cover.
        """
        o = options or FreeWayOptions()
        here = self.cell(start)
        if here is None:
            return None
        cost = self._costs(here, o, outlines)
        islands, _ = ndimage.label(np.isfinite(cost), structure=np.ones((3, 3)))
        target = self._nearest(islands == islands[here], end, o.near_end)
        if target is None:
            return None
        cells = cheapest_way(cost, here, target)
        if cells is None:
            return None
        last = end if self.cell(end) == target else self.center(target)
        return corners_of(self, cost, start, cells, last)

    def cell(self, point: Point) -> Cell | None:
        """The cell of a place, None outside of the plan."""
        if self._corner is None:
            return None
        row, column = (
            math.floor(value / self._cell) - low for value, low in zip(point, self._corner, strict=True)
        )
        rows, columns = self._state.shape
        return (row, column) if 0 <= row < rows and 0 <= column < columns else None

    def center(self, cell: Cell) -> Point:
        """The middle of a cell. Raises ValueError while the plan is empty."""
        if self._corner is None:
            raise ValueError("the plan has seen no frame yet")
        x, y = ((index + low + 0.5) * self._cell for index, low in zip(cell, self._corner, strict=True))
        return x, y

    def _costs(self, here: Cell, options: FreeWayOptions, outlines: Sequence[FloatArray]) -> FloatArray:
        """(n, m) what a step into a cell costs; near the start it may be as close to things as it is now."""
        o, occupied = options, self._state == _OCCUPIED
        rooms = [self._distance(occupied)]
        if o.outlined and outlines:
            rooms.append(self._distance(occupied | self._covered(outlines)))
        tight = np.clip((o.radius + o.margin + o.comfort - rooms[-1]) / o.comfort, 0.0, 1.0)
        cost: FloatArray = np.where(self._state == _FREE, 1.0, o.unknown_cost) * (1.0 + 3.0 * tight)
        rows, columns = (np.arange(count) for count in occupied.shape)
        away = np.hypot(rows[:, None] - here[0], columns[None, :] - here[1]) * self._cell
        for room in rooms:
            need = np.where(away <= 0.3, min(o.radius + o.margin, float(room[here])), o.radius + o.margin)
            cost[room < need - 1e-9] = np.inf
        cost[occupied] = np.inf
        cost[here] = 1.0
        return cost

    def _covered(self, outlines: Sequence[FloatArray]) -> MaskArray:
        assert self._corner is not None
        x, y = (
            (np.arange(count) + low + 0.5) * self._cell
            for count, low in zip(self._state.shape, self._corner, strict=True)
        )
        cells: MaskArray = np.zeros(self._state.shape, dtype=np.bool_)
        for corners in outlines:
            cells |= covered(corners, x, y)
        return cells

    def _distance(self, cells: MaskArray) -> FloatArray:
        """(n, m) metres from each cell's middle to the nearest of `cells`."""
        if not cells.any():
            return np.full(cells.shape, np.inf)
        steps: FloatArray = ndimage.distance_transform_edt(~cells)
        return np.maximum(steps - 0.5, 0.0) * self._cell

    def _nearest(self, reachable: MaskArray, end: Point, within: float) -> Cell | None:
        """The reachable cell nearest to a place, at most so far from it."""
        own = self.cell(end)
        if own is not None and reachable[own]:
            return own
        cells = np.argwhere(reachable)
        assert self._corner is not None
        middles = (cells + np.array(self._corner) + 0.5) * self._cell
        away = np.hypot(middles[:, 0] - end[0], middles[:, 1] - end[1])
        if not len(cells) or float(away.min()) > within:
            return None
        row, column = cells[int(away.argmin())].tolist()
        return row, column

    def _window(self, corner: Cell, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """The part of the plan that a grid covers; the plan grows where it does not reach."""
        if self._corner is None:
            self._corner = corner
        low = [min(a, b) for a, b in zip(self._corner, corner, strict=True)]
        high = [
            max(a + n, b + m)
            for a, n, b, m in zip(self._corner, self._state.shape, corner, shape, strict=True)
        ]
        before = [a - b for a, b in zip(self._corner, low, strict=True)]
        after = [h - a - n for h, a, n in zip(high, self._corner, self._state.shape, strict=True)]
        if any(before) or any(after):
            grown = [(b + _GROW * (b > 0), a + _GROW * (a > 0)) for b, a in zip(before, after, strict=True)]
            self._state = np.pad(self._state, grown)
            self._corner = (self._corner[0] - grown[0][0], self._corner[1] - grown[1][0])
        first = [a - b for a, b in zip(corner, self._corner, strict=True)]
        return slice(first[0], first[0] + shape[0]), slice(first[1], first[1] + shape[1])
