"""Which groups are pieces of one thing: what the votes split along no border that anything else shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.frame import Float32Array, IntArray

FACTS = 7
_MIN_CONTACT = 3
_FAR_M = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """Pairs of groups that touch: first < second (P,) group numbers, length (P,) of the contact in pixels,
    facts (P, FACTS), see `contacts`."""

    first: IntArray
    second: IntArray
    length: IntArray
    facts: Float32Array


def contacts(
    numbers: IntArray,
    peaks: Sequence[float],
    border: Float32Array,
    labels: Float32Array,
    half_depth: Float32Array,
    votes: Float32Array,
) -> Contacts:
    """What speaks for and against each pair of touching groups being one thing.

    numbers (h, w), 0 = none; border (h, w) probability; labels (G, C) mean probabilities by group; votes
    (G, 2) mean voted centres in pixels. Facts: mean border along the contact, likeness of the labels 0..1,
    depth step in units of 0.3 m, length of the contact against the smaller group's size, the lower peak,
    distance of the voted centres against the joint size, and 1.
    """
    ends = []
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        touch = (numbers[a] != numbers[b]) & (numbers[a] > 0) & (numbers[b] > 0)
        pair = np.stack([numbers[a][touch], numbers[b][touch]], axis=1)
        at_border = np.maximum(border[a][touch], border[b][touch])
        known = (half_depth[a][touch] > 0) & (half_depth[b][touch] > 0)
        step = np.where(known, np.abs(half_depth[a][touch] - half_depth[b][touch]), 0)
        ends.append((np.sort(pair, axis=1), at_border, np.minimum(step / _FAR_M, 1)))
    pairs, borders, steps = (np.concatenate(part) for part in zip(*ends, strict=True))
    if len(pairs) == 0:
        none = np.zeros(0, np.int32)
        return Contacts(none, none, none, np.zeros((0, FACTS), np.float32))
    unique, inverse, counts = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(-1)
    enough = counts >= _MIN_CONTACT
    sizes = np.bincount(numbers.ravel(), minlength=len(peaks) + 1).astype(np.float64)
    first, second = unique[:, 0], unique[:, 1]
    likeness = np.sqrt(labels[first - 1] * labels[second - 1]).sum(axis=1)
    smaller = np.minimum(sizes[first], sizes[second])
    high = np.asarray(peaks)
    apart = np.hypot(*(votes[first - 1] - votes[second - 1]).T)
    facts = np.stack(
        [
            np.bincount(inverse, borders) / counts,
            likeness,
            np.bincount(inverse, steps) / counts,
            np.minimum(counts / np.sqrt(smaller), 3),
            np.minimum(high[first - 1], high[second - 1]),
            np.minimum(apart / np.sqrt(sizes[first] + sizes[second]), 3),
            np.ones(len(unique)),
        ],
        axis=1,
    ).astype(np.float32)
    pairs_of = unique[enough].astype(np.int32)
    return Contacts(pairs_of[:, 0], pairs_of[:, 1], counts[enough].astype(np.int32), facts[enough])


@dataclass(frozen=True, slots=True)
class Merge:
    """Two nodes that may be one thing: numbers of pieces (from 1), or of earlier merges after all pieces."""

    first: int
    second: int
    chance: float


def merges(found: Contacts, groups: int, weights: Sequence[float], least: float) -> list[Merge]:
    """What would be joined, the likeliest pair first, down to the chance `least`.

    The chance is a logistic of a pair's facts with `weights` (FACTS,); what a joint node has in contact with
    a third one counts by the contact's length. Merge k makes the node `groups + 1 + k`.
    """
    odds = found.facts.astype(np.float64) @ np.asarray(weights, np.float64)
    # (lower, higher node) -> summed odds x length, length
    touching = {
        (int(a), int(b)): (float(value) * int(length), int(length))
        for a, b, value, length in zip(found.first, found.second, odds, found.length, strict=True)
    }
    made: list[Merge] = []
    while touching:
        pair, (total, length) = max(touching.items(), key=lambda item: (item[1][0] / item[1][1], item[0]))
        chance = float(1 / (1 + np.exp(-total / length)))
        if chance < least:
            break
        made.append(Merge(*pair, chance))
        node = groups + len(made)
        del touching[pair]
        for other in [one for one in touching if set(pair) & set(one)]:
            value = touching.pop(other)
            third = other[0] if other[1] in pair else other[1]
            before = touching.get((third, node), (0.0, 0))
            touching[third, node] = (before[0] + value[0], before[1] + value[1])
    return made
