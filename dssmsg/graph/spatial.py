"""Spatial indexes over boxes and positions: a hash of 1 m columns of the floor plan.

An insertion, a removal or a question costs what lies in the columns it touches, however large the map
is. Columns rather than cubes: a home is flat, so height is left to the exact test.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

from dssmsg.frame import FloatArray

CELL_M = 1.0
MAX_CELLS = 1024  # what spans more columns than this is kept apart (or, as a question, asks every box)

Cell = tuple[int, int]
Corners = tuple[float, float, float, float, float, float]


class BoxIndex:
    """Axis-aligned boxes by name; finds those that touch a box."""

    def __init__(self) -> None:
        self._boxes: dict[str, Corners] = {}
        self._cells: defaultdict[Cell, set[str]] = defaultdict(set)
        self._large: set[str] = set()

    def set(self, name: str, box_min: FloatArray, box_max: FloatArray) -> None:
        """Insert a box, corners (3,) in metres, or replace the one of that name."""
        corners = _corners(box_min, box_max)
        if self._boxes.get(name) == corners:
            return
        self.remove(name)
        self._boxes[name] = corners
        cells = _cells(corners)
        if cells is None:
            self._large.add(name)
        else:
            for cell in cells:
                self._cells[cell].add(name)

    def remove(self, name: str) -> None:
        """Forget a box; nothing happens if there is none of that name."""
        corners = self._boxes.pop(name, None)
        if corners is None:
            return
        self._large.discard(name)
        for cell in _cells(corners) or ():
            self._cells[cell].discard(name)
            if not self._cells[cell]:
                del self._cells[cell]

    def touching(self, box_min: FloatArray, box_max: FloatArray) -> list[str]:
        """Names of the boxes that share at least a point with the given one, in no particular order."""
        asked = _corners(box_min, box_max)
        cells = _cells(asked)
        near: set[str] = set(self._boxes) if cells is None else set(self._large)
        for cell in cells or ():
            if cell in self._cells:
                near |= self._cells[cell]
        return [name for name in near if _touch(self._boxes[name], asked)]


class PointIndex:
    """Positions by name; finds those within a radius."""

    def __init__(self) -> None:
        self._points: dict[str, FloatArray] = {}
        self._boxes = BoxIndex()

    def set(self, name: str, position: FloatArray) -> None:
        """Insert a position (3,) in metres, or replace the one of that name."""
        self._points[name] = position
        self._boxes.set(name, position, position)

    def remove(self, name: str) -> None:
        """Forget a position; nothing happens if there is none of that name."""
        self._points.pop(name, None)
        self._boxes.remove(name)

    def within(self, position: FloatArray, radius: float) -> list[str]:
        """Names of the positions at most `radius` metres from `position` (3,), in no particular order."""
        near = self._boxes.touching(position - radius, position + radius)
        return [name for name in near if math.dist(self._points[name], position) <= radius]


def _corners(box_min: FloatArray, box_max: FloatArray) -> Corners:
    x0, y0, z0 = (float(value) for value in box_min)
    x1, y1, z1 = (float(value) for value in box_max)
    return x0, y0, z0, x1, y1, z1


def _cells(corners: Corners) -> Sequence[Cell] | None:
    """The columns a box stands on; None if they are too many to list."""
    xs = range(math.floor(corners[0] / CELL_M), math.floor(corners[3] / CELL_M) + 1)
    ys = range(math.floor(corners[1] / CELL_M), math.floor(corners[4] / CELL_M) + 1)
    return [(x, y) for x in xs for y in ys] if len(xs) * len(ys) <= MAX_CELLS else None


def _touch(a: Corners, b: Corners) -> bool:
    return (
        a[0] <= b[3] and b[0] <= a[3]
        and a[1] <= b[4] and b[1] <= a[4]
        and a[2] <= b[5] and b[2] <= a[5]
    )  # fmt: skip
