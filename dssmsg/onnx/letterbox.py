"""An image laid into the size that a model takes, and boxes taken back out of it exactly.

Coordinates are pixel edges: an image reaches from (0, 0) to (width, height), a pixel's centre lies at + 0.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import ByteArray, FloatArray

Layout = Literal["letterbox", "square", "corner", "stretch"]
"""How: centred with a rim; squared before it is scaled; in the upper left corner; or pulled to size."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Where an image of `image_size` lies in a model's input of `input_size`, both (height, width) pixels.

    It covers `inner_size` = (height, width) pixels of the input, from `offset` = (top, left) on. Sizes are
    whole numbers, so the two axes may be scaled a little differently: each by what was really done.
    """

    image_size: tuple[int, int]
    input_size: tuple[int, int]
    inner_size: tuple[float, float]
    offset: tuple[float, float]

    @property
    def scale(self) -> tuple[float, float]:
        """(y, x): input pixels an image pixel."""
        return self.inner_size[0] / self.image_size[0], self.inner_size[1] / self.image_size[1]

    def to_input(self, xy: NDArray[Any]) -> FloatArray:
        """(..., 2) points x, y of the image in the input; boxes as (..., 4) xyxy go as two points."""
        return self._map(xy, inverse=False)

    def to_image(self, xy: NDArray[Any]) -> FloatArray:
        """(..., 2) points x, y, or (..., 4) boxes xyxy, of the input in the image; not clipped."""
        return self._map(xy, inverse=True)

    def clip(self, boxes: NDArray[Any]) -> FloatArray:
        """(N, 4) boxes xyxy cut at the image's rim."""
        height, width = self.image_size
        limits = np.array([width, height, width, height], dtype=np.float64)
        return np.clip(np.asarray(boxes, dtype=np.float64), 0.0, limits)

    def _map(self, xy: NDArray[Any], *, inverse: bool) -> FloatArray:
        values = np.asarray(xy, dtype=np.float64)
        pairs = values.shape[-1] // 2
        scale = np.tile(np.array(self.scale[::-1]), pairs)
        offset = np.tile(np.array(self.offset[::-1]), pairs)
        mapped: FloatArray = (values - offset) / scale if inverse else values * scale + offset
        return mapped


def lay_in(
    rgb: ByteArray, size: tuple[int, int], layout: Layout = "letterbox", pad: int = 114
) -> tuple[ByteArray, Fit]:
    """An image (H, W, 3) uint8 laid into (height, width), and where it lies; the rest has the value `pad`.

    letterbox: scaled as a whole, centred (Ultralytics); square: rim first, then scaled (AILab-CVC); corner:
    scaled as a whole, upper left (SAM); stretch: each axis on its own.
    """
    height, width = rgb.shape[:2]
    if layout == "stretch":
        return resize(rgb, size), Fit((height, width), size, (float(size[0]), float(size[1])), (0.0, 0.0))
    if layout == "square":
        side = max(height, width)
        top, left = (side - height) // 2, (side - width) // 2
        square = np.full((side, side, 3), pad, dtype=np.uint8)
        square[top : top + height, left : left + width] = rgb
        y, x = size[0] / side, size[1] / side
        return resize(square, size), Fit((height, width), size, (height * y, width * x), (top * y, left * x))
    ratio = min(size[0] / height, size[1] / width)
    inner = (
        min(size[0], max(1, math.floor(height * ratio + 0.5))),
        min(size[1], max(1, math.floor(width * ratio + 0.5))),
    )
    top, left = (0, 0) if layout == "corner" else ((size[0] - inner[0]) // 2, (size[1] - inner[1]) // 2)
    laid = np.full((*size, 3), pad, dtype=np.uint8)
    laid[top : top + inner[0], left : left + inner[1]] = resize(rgb, inner)
    return laid, Fit((height, width), size, (float(inner[0]), float(inner[1])), (float(top), float(left)))


def resize(rgb: ByteArray, size: tuple[int, int], *, bicubic: bool = False) -> ByteArray:
    """(h, w, 3) of an image (H, W, 3) uint8; bilinear, smoothed where it shrinks."""
    if rgb.shape[:2] == size:
        return rgb
    from PIL import Image

    method = Image.Resampling.BICUBIC if bicubic else Image.Resampling.BILINEAR
    return np.asarray(Image.fromarray(rgb).resize((size[1], size[0]), method))


def planes(
    rgb: ByteArray, mean: tuple[float, ...] = (0, 0, 0), std: tuple[float, ...] = (1, 1, 1)
) -> NDArray[np.float32]:
    """(1, 3, H, W) float32 of an RGB image (H, W, 3) uint8: 0..1, then (x - mean) / std a channel."""
    scaled = rgb.astype(np.float32) / np.float32(255.0)
    normal = (scaled - np.array(mean, np.float32)) / np.array(std, np.float32)
    return np.ascontiguousarray(normal.transpose(2, 0, 1)[None], dtype=np.float32)
