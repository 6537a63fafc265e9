"""Non-maximum suppression of boxes, class by class."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_CANDIDATES = 3000
"""Boxes that are looked at, best first: a detector that fires everywhere must not hang the run."""


def nms(
    boxes: NDArray[Any], scores: NDArray[Any], classes: NDArray[Any], iou: float, limit: int
) -> NDArray[np.int64]:
    """Indices of the boxes that stay, best score first; equal scores in their order, at most `limit`.

    boxes (N, 4) xyxy, scores (N,), classes (N,). A box falls to a better one of its class that it overlaps by
    more than `iou`.
    """
    order = np.argsort(-np.asarray(scores, dtype=np.float64), kind="stable")[:MOST_CANDIDATES]
    corners = np.asarray(boxes, dtype=np.float64)[order]
    labels = np.asarray(classes)[order]
    areas = np.prod(np.clip(corners[:, 2:] - corners[:, :2], 0.0, None), axis=1)
    alive = np.ones(len(order), dtype=np.bool_)
    kept: list[int] = []
    for place in range(len(order)):
        if not alive[place]:
            continue
        kept.append(int(order[place]))
        if len(kept) == limit:
            break
        later = slice(place + 1, None)
        low = np.maximum(corners[later, :2], corners[place, :2])
        high = np.minimum(corners[later, 2:], corners[place, 2:])
        shared = np.prod(np.clip(high - low, 0.0, None), axis=1)
        union = areas[later] + areas[place] - shared
        # A box without area overlaps nothing.
        alive[later] &= ~((labels[later] == labels[place]) & (shared > iou * union))
    return np.array(kept, dtype=np.int64)
