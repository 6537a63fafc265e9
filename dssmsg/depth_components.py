"""Pieces of surface in a depth image: pixels joined to their neighbours where depth does not jump."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dssmsg.frame import Float32Array, MaskArray


def depth_components(
    depth: Float32Array, mask: MaskArray, step: float = 0.05, step_ratio: float = 0.02
) -> NDArray[np.int64]:
    """Component number (H, W) of each pixel of `mask` with a reading, -1 elsewhere.

    depth (H, W) metres, 0 = no reading. Pixels side by side are joined where their depths differ by at most
    `step` metres plus `step_ratio` of the nearer one. Components count from 0 by first pixel, row by row.
    """
    usable = mask & (depth > 0)
    labels = np.full(depth.shape, -1, dtype=np.int64)
    count = int(usable.sum())
    if count == 0:
        return labels
    number = np.cumsum(usable.ravel()).reshape(usable.shape) - 1
    links = [
        (number[first][joined], number[second][joined])
        for first, second in (
            ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
            ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
        )
        for joined in [
            usable[first]
            & usable[second]
            & (
                np.abs(depth[first] - depth[second])
                <= step + step_ratio * np.minimum(depth[first], depth[second])
            )
        ]
    ]
    rows, columns = (np.concatenate(side) for side in zip(*links, strict=True))
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(count, count))
    _parts, part = connected_components(graph.tocsr(), directed=False)
    _values, first_pixel, inverse = np.unique(part, return_index=True, return_inverse=True)
    rank = np.empty(len(first_pixel), dtype=np.int64)
    rank[np.argsort(first_pixel, kind="stable")] = np.arange(len(first_pixel))
    labels[usable] = rank[inverse]
    return labels
