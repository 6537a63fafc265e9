"""All textures of a scene in one flat, mip-mapped buffer, so that a pixel's colour is a single gather."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dssmsg.frame import ByteArray, Float32Array, IntArray

MAX_SIDE = 512
"""Pixels: larger textures are reduced, because a 320 px wide camera never resolves them."""


def power_of_two(length: int) -> int:
    """The power of two nearest to `length` pixels, at most MAX_SIDE."""
    return int(min(MAX_SIDE, 2 ** round(np.log2(max(length, 1)))))


class TextureStore:
    """An append-only buffer of texels, each a little-endian 0xAABBGGRR word.

    Every level of every texture has power-of-two sides, so that wrapping around is a bit mask. Row 0 of a
    level is the bottom of the image (v = 0).
    """

    def __init__(self) -> None:
        self._known: dict[int, tuple[int, ByteArray]] = {}  # the array is held, so that its id stays its own
        self._chunks: list[NDArray[np.uint32]] = []
        self._length = 0
        self._texels = np.zeros(1, np.uint32)
        self._offsets: list[list[int]] = []
        self._sides: list[tuple[int, int]] = []
        self._stale = False

    def add(self, image: ByteArray) -> int:
        """Index of `image` (H, W, 3) uint8, stored on first sight."""
        known = self._known.get(id(image))
        if known is not None:
            return known[0]
        width, height = power_of_two(image.shape[1]), power_of_two(image.shape[0])
        base = image
        if image.shape[:2] != (height, width):
            resized = Image.fromarray(np.ascontiguousarray(image)).resize(
                (width, height), Image.Resampling.BOX
            )
            base = np.asarray(resized)
        level: NDArray[np.floating[Any]] = base[::-1].astype(np.float32)
        offsets = []
        while True:
            offsets.append(self._length)
            words = np.zeros((*level.shape[:2], 4), np.uint8)
            words[..., :3] = np.rint(level)
            self._chunks.append(words.view("<u4").ravel())
            self._length += self._chunks[-1].size
            if level.shape[:2] == (1, 1):
                break
            if level.shape[0] > 1:
                level = (level[0::2] + level[1::2]) / 2
            if level.shape[1] > 1:
                level = (level[:, 0::2] + level[:, 1::2]) / 2
        index = len(self._offsets)
        self._offsets.append(offsets)
        self._sides.append((width, height))
        self._known[id(image)] = (index, image)
        self._stale = True
        return index

    def texel_count(self, index: int) -> int:
        """Number of texels of texture `index` at full size."""
        width, height = self._sides[index]
        return width * height

    def sample(
        self, texture: IntArray, uv: Float32Array, texels_per_pixel_log2: Float32Array
    ) -> NDArray[np.uint32]:
        """Colour words (N,) at `uv` (N, 2) of `texture` (N,), at the level where a texel covers a pixel."""
        if self._stale:
            self._flatten()
        level = (texels_per_pixel_log2 + np.float32(0.5)).astype(np.int32)
        np.clip(level, 0, self._last[texture], out=level)
        bits_x, bits_y = self._bits[0].take(texture), self._bits[1].take(texture)
        np.maximum(bits_x - level, 0, out=bits_x)
        np.maximum(bits_y - level, 0, out=bits_y)
        side_x, side_y = np.left_shift(1, bits_x), np.left_shift(1, bits_y)
        x = np.floor(uv[:, 0] * side_x).astype(np.int32) & (side_x - 1)
        y = np.floor(uv[:, 1] * side_y).astype(np.int32) & (side_y - 1)
        place = self._table.take(texture * self._table.shape[1] + level) + (y << bits_x) + x
        words: NDArray[np.uint32] = self._texels.take(place)
        return words

    def _flatten(self) -> None:
        self._texels = np.concatenate(self._chunks)
        self._chunks = [self._texels]
        levels = max(len(row) for row in self._offsets)
        self._table = np.array([row + [row[-1]] * (levels - len(row)) for row in self._offsets], np.int32)
        self._last = np.array([len(row) - 1 for row in self._offsets], np.int32)
        self._bits = np.array(
            [[side.bit_length() - 1 for side in sides] for sides in self._sides], np.int32
        ).T
        self._bits = np.ascontiguousarray(self._bits)
        self._stale = False
