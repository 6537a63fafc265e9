"""The arrays that changes and nodes carry: dtype, shape, and whether they are stored apart, by hash."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import frozen_array


@dataclass(frozen=True, slots=True)
class ArrayField:
    """One array by its field name. A `bulky` one goes into a side table, a small one inline as numbers."""

    dtype: type[np.generic]
    shape: tuple[int | None, ...]
    bulky: bool
    optional: bool = False

    def frozen(self, name: str, value: Any) -> NDArray[Any]:
        """`value` as a read-only array of this dtype and shape, finite; ValueError with expected and got."""
        return frozen_array(name, value, self.dtype, self.shape, finite=True)


ARRAYS: Mapping[str, ArrayField] = {
    "points": ArrayField(np.float32, (None, 3), bulky=True),
    "colors": ArrayField(np.uint8, (None, 3), bulky=True),
    "text_feature": ArrayField(np.float32, (None,), bulky=True, optional=True),
    "image_feature": ArrayField(np.float32, (None,), bulky=True, optional=True),
    "position": ArrayField(np.float64, (3,), bulky=False),
    "box_min": ArrayField(np.float64, (3,), bulky=False),
    "box_max": ArrayField(np.float64, (3,), bulky=False),
    "world_from_camera": ArrayField(np.float64, (4, 4), bulky=False),
}
"""Every array field of `dssmsg.graph.changes` and `dssmsg.graph.nodes`, by name."""
