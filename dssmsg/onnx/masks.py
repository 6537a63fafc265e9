"""Small maps of mask logits read out at the pixels of the image that they belong to."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import Float32Array, FloatArray, MaskArray
from dssmsg.onnx.letterbox import Fit


def image_mask(logits: NDArray[Any], fit: Fit, box: NDArray[Any] | None = None) -> MaskArray:
    """(H, W) bool of the image: where the logits (h, w), which span the model's input, are above 0.

    Read by bilinear interpolation at the pixels' centres, so that the rim of a letterbox is undone exactly.
    With a `box` (4,) xyxy in image pixels, only pixels whose centre lies in it.
    """
    height, width = fit.image_size
    mask = np.zeros((height, width), dtype=np.bool_)
    rows, columns = slice(0, height), slice(0, width)
    if box is not None:
        left, top, right, bottom = (float(one) for one in box)
        rows = slice(max(0, int(np.ceil(top - 0.5))), min(height, int(np.floor(bottom - 0.5)) + 1))
        columns = slice(max(0, int(np.ceil(left - 0.5))), min(width, int(np.floor(right - 0.5)) + 1))
        if rows.start >= rows.stop or columns.start >= columns.stop:
            return mask
    centres_y = np.arange(rows.start, rows.stop) + 0.5
    centres_x = np.arange(columns.start, columns.stop) + 0.5
    y = (centres_y * fit.scale[0] + fit.offset[0]) * logits.shape[0] / fit.input_size[0] - 0.5
    x = (centres_x * fit.scale[1] + fit.offset[1]) * logits.shape[1] / fit.input_size[1] - 0.5
    mask[rows, columns] = sample(np.asarray(logits, dtype=np.float32), y, x) > 0
    return mask


def sample(values: Float32Array, y: FloatArray, x: FloatArray) -> Float32Array:
    """(len(y), len(x)) of a map (h, w) where rows y and columns x cross, bilinear, clamped at its rim."""
    top, down = _neighbours(y, values.shape[0])
    left, across = _neighbours(x, values.shape[1])
    lower, right = np.minimum(top + 1, values.shape[0] - 1), np.minimum(left + 1, values.shape[1] - 1)
    between = values[top] * (1 - down[:, None]) + values[lower] * down[:, None]
    mixed: Float32Array = between[:, left] * (1 - across) + between[:, right] * across
    return mixed


def _neighbours(position: FloatArray, size: int) -> tuple[NDArray[np.int64], Float32Array]:
    clamped = np.clip(position, 0.0, size - 1.0)
    below = np.floor(clamped).astype(np.int64)
    return below, (clamped - below).astype(np.float32)
