"""How alike two clouds' colours are: s_rgb of eq. 1, by soft HSV histograms over the points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import ByteArray, FloatArray

HUES, SATURATIONS, VALUES = 12, 3, 5
_BINS = VALUES * (1 + HUES * SATURATIONS)
_GREY = 0.15
"""Below this saturation a hue is mostly noise, and blends into grey."""


def hsv_of(colors: ByteArray) -> FloatArray:
    """(N, 3) hue, saturation and value, each 0..1, of colours (N, 3) uint8."""
    r, g, b = np.ascontiguousarray(colors.T).astype(np.float64) / 255.0
    high, low = np.maximum(np.maximum(r, g), b), np.minimum(np.minimum(r, g), b)
    spread = high - low
    safe = np.where(spread > 0, spread, 1.0)
    hue = np.where(high == g, (b - r) / safe + 2.0, (r - g) / safe + 4.0)
    hue = np.where(high == r, ((g - b) / safe) % 6.0, hue)
    hue = np.where(spread > 0, hue / 6.0, 0.0)
    return np.stack([hue, spread / np.where(high > 0, high, 1.0), high], axis=1)


def color_histogram(colors: ByteArray, gain: float = 1.0) -> FloatArray:
    """The histogram (VALUES * (1 + HUES * SATURATIONS),) of colours (N, 3), sum 1; `gain` scales their value.

    Each colour is shared out between the two nearest bins of every axis, so that a little more light moves a
    little weight. Greys have bins without hue.
    """
    histogram: FloatArray = color_histograms([colors], [gain])[0]
    return histogram


def color_histograms(clouds: Sequence[ByteArray], gains: Sequence[float]) -> FloatArray:
    """`color_histogram` of several clouds (N, 3), each with its gain, as rows."""
    counts = [len(colors) for colors in clouds]
    if not sum(counts):
        return np.zeros((len(clouds), _BINS))
    hue, saturation, value = hsv_of(np.concatenate(clouds)).T
    value = np.minimum(value * np.repeat(gains, counts), 1.0)
    chroma = np.clip((saturation - _GREY / 2) / _GREY, 0.0, 1.0) * np.minimum(value / 0.1, 1.0)
    hues = _split_round(hue * HUES)
    saturations = _split(saturation * (SATURATIONS - 1), SATURATIONS)
    first_bin = np.repeat(np.arange(len(clouds)) * _BINS, counts)
    bins, weights = [], []
    for value_bin, value_weight in _split(value * (VALUES - 1), VALUES):
        row = first_bin + value_bin * (1 + HUES * SATURATIONS)
        bins.append(row)
        weights.append(value_weight * (1 - chroma))
        for hue_bin, hue_weight in hues:
            for sat_bin, sat_weight in saturations:
                bins.append(row + (1 + hue_bin * SATURATIONS + sat_bin))
                weights.append(value_weight * hue_weight * sat_weight * chroma)
    sums = np.bincount(np.concatenate(bins), np.concatenate(weights), minlength=len(clouds) * _BINS)
    histograms: FloatArray = sums.reshape(len(clouds), _BINS) / np.maximum(counts, 1)[:, None]
    return histograms


def color_similarity(a: ByteArray, b: ByteArray, gain: float = 1.0) -> float:
    """s_rgb of two clouds' colours (N, 3), (M, 3); `gain` brings the values of `b` to the light of `a`.

    Bhattacharyya's coefficient of their histograms, 0..1; 1 for equal ones.
    """
    return color_similarities([(a, b)], gain)[0]


def color_similarities(pairs: Sequence[tuple[ByteArray, ByteArray]], gain: float = 1.0) -> list[float]:
    """`color_similarity` of several pairs, all with the same gain."""
    clouds = [colors for pair in pairs for colors in pair]
    histograms = color_histograms(clouds, [1.0, gain] * len(pairs))
    alike: list[float] = np.minimum(1.0, np.sqrt(histograms[::2] * histograms[1::2]).sum(axis=1)).tolist()
    return alike


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
