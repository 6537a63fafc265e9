"""Crops for the crop encoder: a thing cut out with its mask, and numbers that depth gives of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import ByteArray, Float32Array, MaskArray
from dssmsg.recogniser.contract import CROP_EXTRA, CROP_FACTS, CROP_MARGIN, CROP_SIDE
from dssmsg.recogniser.inputs import DEVIATION, MEAN, HalfGeometry

_POINTS = 400
"""Points that the extents are taken from: more change nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class CropImages:
    """A frame prepared for cutting: levels of (H, W, 3) float32 rgb, each half the size of the one before;
    geometry of the half-size image."""

    levels: tuple[Float32Array, ...]
    geometry: HalfGeometry

    @classmethod
    def of(cls, rgb: ByteArray, geometry: HalfGeometry) -> CropImages:
        """Prepare a frame's rgb (H, W, 3) uint8, H and W multiples of 4."""
        full: Float32Array = ((rgb.astype(np.float32) - MEAN) / DEVIATION).astype(np.float32, copy=False)
        half = _halved(full)
        return cls((full, half, _halved(half)), geometry)


def _halved(image: Float32Array) -> Float32Array:
    total = image[0::2, 0::2] + image[1::2, 0::2] + image[0::2, 1::2] + image[1::2, 1::2]
    mean: Float32Array = (total / 4).astype(np.float32, copy=False)
    return mean


def cut(images: CropImages, masks: Sequence[MaskArray]) -> tuple[Float32Array, Float32Array]:
    """Crops (N, 3 + CROP_EXTRA, S, S) and facts (N, CROP_FACTS), float32, of masks (H, W), none empty."""
    crops = np.zeros((len(masks), 3 + CROP_EXTRA, CROP_SIDE, CROP_SIDE), np.float32)
    numbers = np.zeros((len(masks), CROP_FACTS), np.float32)
    for i, mask in enumerate(masks):
        window = bounds(mask)
        half_mask = _any2(mask)
        numbers[i] = facts(images.geometry, half_mask, window, mask)
        crops[i] = _crop(images, half_mask, window, float(numbers[i, 6]) * 3)
    return crops, numbers


def bounds(mask: MaskArray) -> tuple[int, int, int, int]:
    """left, top, right, bottom of a mask that is not empty; the last two exclusive."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def _any2(mask: MaskArray) -> MaskArray:
    return mask[0::2, 0::2] | mask[1::2, 0::2] | mask[0::2, 1::2] | mask[1::2, 1::2]


def _crop(
    images: CropImages, half_mask: MaskArray, window: tuple[int, int, int, int], distance: float
) -> Float32Array:
    """(3 + CROP_EXTRA, S, S): a square around the window; outside the image is zero (the mean colour)."""
    left, top, right, bottom = window
    side = max(right - left, bottom - top) * (1 + 2 * CROP_MARGIN) + 4
    place = (np.arange(CROP_SIDE, dtype=np.float32) + np.float32(0.5)) / CROP_SIDE - np.float32(0.5)
    u = (left + right) / 2 + place * side  # continuous coordinates, pixel k spans k .. k + 1
    v = (top + bottom) / 2 + place * side
    level = 0 if side < 1.6 * CROP_SIDE else 1 if side < 3.2 * CROP_SIDE else 2
    colour = _bilinear(images.levels[level], u / 2**level, v / 2**level)
    geometry = images.geometry
    rows, columns = np.floor(v / 2).astype(np.intp), np.floor(u / 2).astype(np.intp)
    height, width = geometry.depth.shape
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None, :]
    at = np.ix_(np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1))
    valid = inside & geometry.valid[at]
    crop = np.empty((3 + CROP_EXTRA, CROP_SIDE, CROP_SIDE), np.float32)
    crop[:3] = colour.transpose(2, 0, 1) * inside
    crop[3] = half_mask[at] & inside
    crop[4] = np.where(valid, geometry.points[at][..., 2] - np.float32(0.8), 0)
    crop[5] = np.where(valid, np.clip((geometry.depth[at] - np.float32(distance)) * 2, -2, 2), 0)
    return crop


def _bilinear(image: Float32Array, u: NDArray[np.float32], v: NDArray[np.float32]) -> Float32Array:
    """(S, S, 3) samples at columns u and rows v, continuous coordinates, clamped at the image's rim."""
    height, width = image.shape[:2]
    x, y = np.clip(u - 0.5, 0, width - 1), np.clip(v - 0.5, 0, height - 1)
    x0, y0 = np.minimum(x.astype(np.intp), width - 2), np.minimum(y.astype(np.intp), height - 2)
    fx, fy = (x - x0).astype(np.float32)[None, :, None], (y - y0).astype(np.float32)[:, None, None]
    rows0, rows1 = image[y0], image[y0 + 1]
    mixed = rows0 + (rows1 - rows0) * fy
    left, right = mixed[:, x0], mixed[:, x0 + 1]
    sampled: Float32Array = left + (right - left) * fx
    return sampled


def facts(
    geometry: HalfGeometry, half_mask: MaskArray, window: tuple[int, int, int, int], mask: MaskArray
) -> Float32Array:
    """(CROP_FACTS,) float32: extents, heights, range, and how the mask lies in the image; see the body."""
    numbers = np.zeros(CROP_FACTS, np.float32)
    height, width = mask.shape
    left, top, right, bottom = window
    pixels = int(np.count_nonzero(mask))
    where = np.flatnonzero(half_mask & geometry.valid)
    if len(where) > _POINTS:
        where = where[(np.arange(_POINTS) * len(where)) // _POINTS]
    if len(where) >= 4:
        points = geometry.points.reshape(-1, 3)[where]
        flat = points[:, :2] - points[:, :2].mean(axis=0)
        _, axes = np.linalg.eigh(flat.T @ flat)
        along = np.sort(flat @ axes, axis=0)
        low, high = int(0.03 * len(where)), len(where) - 1 - int(0.03 * len(where))
        z = np.sort(points[:, 2])
        normals = geometry.normals.reshape(-1, 3)[where]
        numbers[:6] = (along[high, 1] - along[low, 1], along[high, 0] - along[low, 0], z[high] - z[low],
                       z[low], z[high], z[len(z) // 2])  # fmt: skip
        numbers[6] = float(np.median(geometry.depth.reshape(-1)[where])) / 3
        numbers[12] = float((normals[:, 2] > 0.8).mean())
        numbers[13] = float((np.abs(normals[:, 2]) < 0.3).mean())
    numbers[7] = np.sqrt(pixels) / 100
    numbers[8:12] = (left <= 1, top <= 1, right >= width - 1, bottom >= height - 1)
    numbers[14] = pixels / ((right - left) * (bottom - top))
    numbers[15] = np.log((right - left) / (bottom - top))
    return numbers
