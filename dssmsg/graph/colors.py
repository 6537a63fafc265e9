"""How alike two clouds' colours are: s_rgb of eq. 1, by soft HSV histograms over the points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import ByteArray, FloatArray

HUES, SATURATIONS, VALUES = 12, 3, 5
_GREY = 0.15
"""Below this saturation a hue is mostly noise, and blends into grey."""


def hsv_of(colors: ByteArray) -> FloatArray:
    """(N, 3) hue, saturation and value, each 0..1, of colours (N, 3) uint8."""
    rgb = colors.astype(np.float64) / 255.0
    high, low = rgb.max(axis=1), rgb.min(axis=1)
    spread = high - low
    safe = np.where(spread > 0, spread, 1.0)
    r, g, b = rgb.T
    hue = np.where(high == g, (b - r) / safe + 2.0, (r - g) / safe + 4.0)
    hue = np.where(high == r, ((g - b) / safe) % 6.0, hue)
    hue = np.where(spread > 0, hue / 6.0, 0.0)
    return np.stack([hue, spread / np.where(high > 0, high, 1.0), high], axis=1)


def color_histogram(colors: ByteArray, gain: float = 1.0) -> FloatArray:
    """The histogram (VALUES * (1 + HUES * SATURATIONS),) of colours (N, 3), sum 1; `gain` scales their value.

    Each colour is shared out between the two nearest bins of every axis, so that a little more light moves a
    little weight. Greys have bins without hue.
    """
    if not len(colors):
        return np.zeros(VALUES * (1 + HUES * SATURATIONS))
    hue, saturation, value = hsv_of(colors).T
    value = np.minimum(value * gain, 1.0)
    chroma = np.clip((saturation - _GREY / 2) / _GREY, 0.0, 1.0) * np.minimum(value / 0.1, 1.0)
    hues = _split_round(hue * HUES)
    saturations = _split(saturation * (SATURATIONS - 1), SATURATIONS)
    bins, weights = [], []
    for value_bin, value_weight in _split(value * (VALUES - 1), VALUES):
        row = value_bin * (1 + HUES * SATURATIONS)
        bins.append(row)
        weights.append(value_weight * (1 - chroma))
        for hue_bin, hue_weight in hues:
            for sat_bin, sat_weight in saturations:
                bins.append(row + (1 + hue_bin * SATURATIONS + sat_bin))
                weights.append(value_weight * hue_weight * sat_weight * chroma)
    size = VALUES * (1 + HUES * SATURATIONS)
    histogram = np.bincount(np.concatenate(bins), np.concatenate(weights), minlength=size)
    return np.asarray(histogram / len(colors), dtype=np.float64)


def histogram_similarity(a: FloatArray, b: FloatArray) -> float:
    """s_rgb: Bhattacharyya's coefficient of two histograms of sum 1, 0..1; 1 for equal ones."""
    return float(min(1.0, np.sum(np.sqrt(a * b))))


def color_similarity(a: ByteArray, b: ByteArray, gain: float = 1.0) -> float:
    """s_rgb of two clouds' colours (N, 3), (M, 3); `gain` brings the values of `b` to the light of `a`."""
    return histogram_similarity(color_histogram(a), color_histogram(b, gain))


def mean_value(colors: ByteArray) -> float:
    """Mean HSV value 0..1 of colours (N, 3): how bright they are."""
    return float(colors.max(axis=1).mean()) / 255.0 if len(colors) else 0.0


def _split(position: FloatArray, count: int) -> list[tuple[NDArray[np.int64], FloatArray]]:
    low = np.minimum(position.astype(np.int64), count - 1)  # positions are not negative
    share = np.minimum(position - low, 1.0)
    return [(low, 1.0 - share), (np.minimum(low + 1, count - 1), share)]


def _split_round(position: FloatArray) -> list[tuple[NDArray[np.int64], FloatArray]]:
    low = np.floor(position).astype(np.int64)
    share = position - low
    return [(low % HUES, 1.0 - share), ((low + 1) % HUES, share)]
