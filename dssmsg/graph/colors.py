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
    hue = np.select(
        [high == r, high == g],
        [((g - b) / safe) % 6.0, (b - r) / safe + 2.0],
        (r - g) / safe + 4.0,
    )
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
    chroma = np.clip((saturation - _GREY / 2) / _GREY, 0.0, 1.0) * np.clip(value / 0.1, 0.0, 1.0)
    histogram = np.zeros((VALUES, 1 + HUES * SATURATIONS))
    for value_bin, value_weight in _split(value * (VALUES - 1), VALUES):
        np.add.at(histogram[:, 0], value_bin, value_weight * (1 - chroma))
        for hue_bin, hue_weight in _split_round(hue * HUES):
            for sat_bin, sat_weight in _split(saturation * (SATURATIONS - 1), SATURATIONS):
                column = 1 + hue_bin * SATURATIONS + sat_bin
                np.add.at(histogram, (value_bin, column), value_weight * hue_weight * sat_weight * chroma)
    flat: FloatArray = histogram.reshape(-1) / len(colors)
    return flat


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
    low = np.clip(np.floor(position).astype(np.int64), 0, count - 1)
    share = np.clip(position - low, 0.0, 1.0)
    return [(low, 1.0 - share), (np.minimum(low + 1, count - 1), share)]


def _split_round(position: FloatArray) -> list[tuple[NDArray[np.int64], FloatArray]]:
    low = np.floor(position).astype(np.int64)
    share = position - low
    return [(low % HUES, 1.0 - share), ((low + 1) % HUES, share)]
