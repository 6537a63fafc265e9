"""Which cells of a floor plan an outline covers."""

from __future__ import annotations

import numpy as np

from dssmsg.frame import FloatArray, MaskArray


def covered(corners: FloatArray, x: FloatArray, y: FloatArray) -> MaskArray:
    """(n, m) bool: which cell middles (x (n,), y (m,)) lie in a rectangle (4, 2), its edge included."""
    inside: MaskArray = np.ones((len(x), len(y)), dtype=np.bool_)
    for side in (0, 1):
        along = corners[side + 1] - corners[side]
        length = float(np.hypot(*along))
        if length < 1e-9:
            continue
        way = (
            (x[:, None] - corners[side, 0]) * along[0] + (y[None, :] - corners[side, 1]) * along[1]
        ) / length
        inside &= (way >= -1e-9) & (way <= length + 1e-9)
    return inside
