"""Places that frames were taken from, numbered as they come; a hash of cells finds those near by."""

from __future__ import annotations

from itertools import product

import numpy as np

from dssmsg.frame import FloatArray

_AROUND = tuple(product((-1, 0, 1), repeat=3))


class Stations:
    """Numbers places: what is nearer than `apart` metres to a place already numbered is that place.

    Finding one costs the same however many there are: places are `apart` metres from each other, so that the
    27 cells asked hold only a few.
    """

    def __init__(self, apart: float) -> None:
        self._apart = apart
        self._places: list[FloatArray] = []
        self._cells: dict[tuple[int, ...], list[int]] = {}

    def number(self, position: FloatArray) -> int:
        """The number of the place at a position (3,), metres: the lowest of those near, or a new one."""
        cell = tuple(int(value) for value in np.floor(position / self._apart))
        near = (
            number
            for step in _AROUND
            for number in self._cells.get(tuple(a + b for a, b in zip(cell, step, strict=True)), ())
        )
        for number in sorted(near):
            if np.linalg.norm(position - self._places[number]) < self._apart:
                return number
        self._places.append(position.copy())
        self._cells.setdefault(cell, []).append(len(self._places) - 1)
        return len(self._places) - 1
