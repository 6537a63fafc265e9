"""From the dense network's maps to masks: each pixel of a thing votes for its centre, votes are grouped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dssmsg.frame import Float32Array, IntArray, MaskArray
from dssmsg.recogniser.contract import OFFSET_PX


@dataclass(frozen=True, slots=True)
class GroupingRule:
    """Thresholds of the grouping; lengths in pixels of the half-size image."""

    thing: float = 0.5
    peak: float = 0.15
    peak_gap: int = 5
    reach: float = 6.0
    reach_share: float = 0.45
    min_pixels: int = 20
    max_peaks: int = 60


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """One thing: mask (H, W) bool at full size, the mean probability of being a thing, the height of its
    centre's peak, and mean label probabilities (C + 1,) over it."""

    mask: MaskArray
    thing: float
    peak: float
    labels: Float32Array


def group(
    dense: Float32Array,
    classes: Float32Array,
    depth: Float32Array,
    half_depth: Float32Array,
    rule: GroupingRule,
) -> Sequence[Group]:
    """The things of a frame, the largest first.

    dense (5, h, w) and classes (C + 1, h/2, w/2) logits; depth (2h, 2w) and half_depth (h, w) metres.
    """
    thing = _sigmoid(dense[0])
    heat = ndimage.uniform_filter(_sigmoid(dense[1]), 3)
    numbers, peaks = _votes(thing, heat, dense[2:4], rule)
    full = sharpened(numbers, depth, half_depth)
    probability = _softmax(classes)
    coarse = numbers[::2, ::2]
    groups = []
    counts = np.bincount(numbers.ravel(), minlength=len(peaks) + 1)
    for number in np.argsort(-counts[1:], kind="stable") + 1:
        if counts[number] < rule.min_pixels:
            break
        mask = full == number
        if not mask.any():
            continue
        inside = numbers == number
        there = coarse == number
        labels = probability[:, there].mean(axis=1) if there.any() else probability.mean(axis=(1, 2))
        groups.append(Group(mask, float(thing[inside].mean()), peaks[number - 1], labels))
    return groups


def _votes(
    thing: Float32Array, heat: Float32Array, offset: Float32Array, rule: GroupingRule
) -> tuple[IntArray, list[float]]:
    """Group number (h, w) of each pixel, 0 = none, and the peak of each group."""
    numbers = np.zeros(thing.shape, np.int32)
    v, u = np.nonzero(thing > rule.thing)
    if len(v) == 0:
        return numbers, []
    top = ndimage.maximum_filter(heat, 2 * rule.peak_gap + 1)
    at_v, at_u = np.nonzero((heat == top) & (heat > rule.peak))
    order = np.argsort(-heat[at_v, at_u], kind="stable")[: rule.max_peaks]
    at_v, at_u = at_v[order], at_u[order]
    peaks = [float(value) for value in heat[at_v, at_u]]
    vote_u = u + offset[0, v, u] * np.float32(OFFSET_PX)
    vote_v = v + offset[1, v, u] * np.float32(OFFSET_PX)
    chosen = np.zeros(len(v), np.int32)
    if peaks:
        away = np.hypot(vote_u[:, None] - at_u[None, :], vote_v[:, None] - at_v[None, :])
        nearest = away.argmin(axis=1)
        length = np.hypot(offset[0, v, u], offset[1, v, u]) * np.float32(OFFSET_PX)
        close = away[np.arange(len(v)), nearest] < rule.reach + rule.reach_share * length
        chosen = np.where(close, nearest + 1, 0).astype(np.int32)
    numbers[v, u] = chosen
    # What no centre was near to: pieces of their own.
    rest = np.zeros(thing.shape, np.bool_)
    rest[v, u] = chosen == 0
    pieces, count = ndimage.label(rest)
    sizes = np.bincount(pieces.ravel(), minlength=count + 1)
    for piece in np.flatnonzero(sizes[1:] >= 3 * rule.min_pixels) + 1:
        peaks.append(0.0)
        numbers[pieces == piece] = len(peaks)
    return numbers, peaks


def sharpened(numbers: IntArray, depth: Float32Array, half_depth: Float32Array) -> IntArray:
    """Numbers (h, w) at full size (2h, 2w): of the cell around and its four neighbours, the one that is
    nearest in depth; edges of the mask then follow edges of the depth."""
    padded = np.pad(numbers, 1, mode="edge")
    padded_depth = np.pad(half_depth, 1, mode="edge")
    height, width = numbers.shape

    def grown(part: NDArray[Any]) -> NDArray[Any]:
        return part.repeat(2, axis=0).repeat(2, axis=1)

    best = grown(numbers)
    away = np.abs(grown(half_depth) - depth)
    unknown = depth <= 0
    away = np.where(unknown, 0, np.maximum(away - 0.02, 0))
    for dv, du in ((0, 1), (2, 1), (1, 0), (1, 2)):
        window = np.s_[dv : dv + height, du : du + width]
        other = np.abs(grown(padded_depth[window]) - depth)
        nearer = other < away
        best = np.where(nearer, grown(padded[window]), best)
        away = np.where(nearer, other, away)
    return best.astype(np.int32)


def _sigmoid(x: Float32Array) -> Float32Array:
    y: Float32Array = (1 / (1 + np.exp(-np.clip(x, -30, 30)))).astype(np.float32, copy=False)
    return y


def _softmax(x: Float32Array) -> Float32Array:
    e = np.exp(x - x.max(axis=0))
    y: Float32Array = e / e.sum(axis=0)
    return y
