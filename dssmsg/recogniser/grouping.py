"""From the dense network's maps to masks: each pixel of a thing votes for its centre, votes are grouped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dssmsg.frame import Float32Array, IntArray, MaskArray
from dssmsg.recogniser.contract import OFFSET_PX
from dssmsg.recogniser.inputs import HalfGeometry
from dssmsg.recogniser.joining import Contacts, contacts, merges
from dssmsg.recogniser.parting import parted


@dataclass(frozen=True, slots=True)
class GroupingRule:
    """Thresholds of the grouping; lengths in pixels of the half-size image, `part_gap_m` in metres.

    `join`: weights of the logistic that joins pieces, see `joining`; none: nothing is joined.
    """

    thing: float = 0.5
    peak: float = 0.15
    peak_gap: int = 5
    reach: float = 6.0
    reach_share: float = 0.45
    min_pixels: int = 14
    max_peaks: int = 60
    part_gap_m: float = 0.15
    join: tuple[float, ...] = ()
    join_sure: float = 0.9
    join_least: float = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """What may be one thing: mask (H, W) bool at full size, the mean probability of being a thing, the height
    of its centre's peak, and mean label probabilities (C + 1,) over it.

    `parts`: the two groups, by their place in the list, that it is made of; none for a piece.
    """

    mask: MaskArray
    pixels: int
    thing: float
    peak: float
    labels: Float32Array
    parts: tuple[int, ...] = ()


def candidates(
    dense: Float32Array,
    classes: Float32Array,
    depth: Float32Array,
    geometry: HalfGeometry,
    rule: GroupingRule,
) -> list[Group]:
    """What may be things: pieces, and joint ones that are made of earlier ones, largest pieces first.

    dense (5, h, w) and classes (C + 1, h/2, w/2) logits; depth (2h, 2w) metres and the geometry of its half
    (h, w). Pieces that are surely one thing are one from the start. Which of a group and its parts are the
    things is for those to say who know what they look like: `chosen`.
    """
    pieces = vote(dense, classes, geometry, rule)
    count = len(pieces.peaks)
    made = merges(pieces.contacts, count, rule.join, rule.join_least) if rule.join else []
    sure = np.arange(count + len(made) + 1)
    for k, merge in enumerate(made, start=count + 1):
        if merge.chance >= rule.join_sure:
            sure[(sure == sure[merge.first]) | (sure == sure[merge.second]) | (sure == k)] = k
    numbers = sure[pieces.numbers]
    full = sharpened(numbers.astype(np.int32), depth, geometry.depth)
    sizes = np.bincount(numbers.ravel(), minlength=len(sure))
    pixels = np.bincount(full.ravel(), minlength=len(sure))
    groups: list[Group] = []
    place: dict[int, int] = {}
    for node in np.argsort(-sizes[1:], kind="stable") + 1:
        if sizes[node] < rule.min_pixels:
            break
        if pixels[node] == 0:
            continue
        there = numbers == node
        members = sure[1 : count + 1] == node
        peak = max(p for p, member in zip(pieces.peaks, members, strict=True) if member)
        place[int(node)] = len(groups)
        groups.append(
            Group(full == node, int(pixels[node]), float(pieces.thing[there].mean()), peak,
                  pooled(pieces.labels, there))
        )  # fmt: skip
    for k, merge in enumerate(made, start=count + 1):
        ends = [place.get(int(sure[end])) for end in (merge.first, merge.second)]
        if merge.chance >= rule.join_sure:
            continue
        parts = tuple(dict.fromkeys(end for end in ends if end is not None))
        if len(parts) == 2:
            place[k] = len(groups)
            groups.append(_union(groups, parts))
        elif parts:  # the other end is too small to count
            place[k] = parts[0]
    return groups


def limited(groups: Sequence[Group], count: int) -> list[Group]:
    """At most `count` groups, the largest pieces and what is made of them: bounds a frame's time."""
    kept: dict[int, int] = {}
    pieces = [i for i, one in enumerate(groups) if not one.parts]
    while True:
        kept = {}
        for i, one in enumerate(groups):
            if i in pieces or (one.parts and all(part in kept for part in one.parts)):
                kept[i] = len(kept)
        if len(kept) <= count or not pieces:
            break
        pieces = pieces[: max(len(pieces) - (len(kept) - count + 1) // 2, 0)]
    return [replace(groups[i], parts=tuple(kept[part] for part in groups[i].parts)) for i in kept]


def _union(groups: Sequence[Group], parts: tuple[int, ...]) -> Group:
    first, second = (groups[part] for part in parts)
    pixels = first.pixels + second.pixels
    share = first.pixels / pixels
    labels = (share * first.labels + (1 - share) * second.labels).astype(np.float32)
    thing = share * first.thing + (1 - share) * second.thing
    return Group(first.mask | second.mask, pixels, thing, max(first.peak, second.peak), labels, parts)


def chosen(groups: Sequence[Group], scores: Sequence[float]) -> list[int]:
    """The groups, none part of another, with the highest scores; largest first.

    A joint group stands for its parts where its score reaches theirs, each weighted with the root of its
    pixels: by pixels a table would swallow its mugs, by count alone two halves of a table would beat it.
    """
    best: list[tuple[float, list[int]]] = []
    inner: set[int] = set()
    for i, (one, score) in enumerate(zip(groups, scores, strict=True)):
        own = score * math.sqrt(one.pixels)
        apart = sum(best[part][0] for part in one.parts)
        inner |= set(one.parts)
        best.append((own, [i]) if not one.parts or own >= apart else
                    (apart, [name for part in one.parts for name in best[part][1]]))  # fmt: skip
    names = [name for i in range(len(groups)) if i not in inner for name in best[i][1]]
    return sorted(names, key=lambda name: (-groups[name].pixels, name))


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """What the votes alone give: numbers (h, w) from 1, 0 = none; the peak of each; thing (h, w) and labels
    (C + 1, h/2, w/2) probabilities; which pieces touch."""

    numbers: IntArray
    peaks: list[float]
    thing: Float32Array
    labels: Float32Array
    contacts: Contacts


def vote(dense: Float32Array, classes: Float32Array, geometry: HalfGeometry, rule: GroupingRule) -> Pieces:
    """Pieces of a frame before any are joined; arguments as of `candidates`."""
    thing = _sigmoid(dense[0])
    heat = ndimage.uniform_filter(_sigmoid(dense[1]), 3)
    numbers, peaks = _votes(thing, heat, dense[2:4], rule)
    numbers, origins = parted(numbers, len(peaks), geometry, gap=rule.part_gap_m, least=3 * rule.min_pixels)
    peaks += [0.0] * len(origins)
    labels = _softmax(classes)
    means = np.zeros((len(peaks), len(labels) - 1), np.float32)
    for place in range(len(peaks)):
        means[place] = pooled(labels, numbers == place + 1)[:-1]
    means /= means.sum(axis=1, keepdims=True) + np.float32(1e-6)
    centres = _centres(numbers, dense[2:4], len(peaks))
    found = contacts(numbers, peaks, _sigmoid(dense[4]), means, geometry.depth, centres)
    return Pieces(numbers, peaks, thing, labels, found)


def _centres(numbers: IntArray, offset: Float32Array, groups: int) -> Float32Array:
    """Mean voted centre (G, 2) of each group, pixels."""
    v, u = np.nonzero(numbers)
    members = numbers[v, u]
    counts = np.maximum(np.bincount(members, minlength=groups + 1), 1)
    votes = (u + offset[0, v, u] * OFFSET_PX, v + offset[1, v, u] * OFFSET_PX)
    sums = [np.bincount(members, weights=part, minlength=groups + 1) for part in votes]
    centres: Float32Array = np.stack([part / counts for part in sums], axis=1)[1:].astype(np.float32)
    return centres


def pooled(labels: Float32Array, mask: MaskArray) -> Float32Array:
    """Mean (C + 1,) of labels (C + 1, h/2, w/2) over a mask (h, w); over everything for too small a mask."""
    there = mask[::2, ::2]
    mean: Float32Array = labels[:, there].mean(axis=1) if there.any() else labels.mean(axis=(1, 2))
    return mean


def _votes(
    thing: Float32Array, heat: Float32Array, offset: Float32Array, rule: GroupingRule
) -> tuple[IntArray, list[float]]:
    """Group number (h, w) of each pixel, 0 = none; the peak of each group."""
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
