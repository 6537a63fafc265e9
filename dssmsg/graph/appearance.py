"""Did it appear, or was it only not seen before? (paper III-A; ALGORITHM B)

A new object has appeared where enough earlier frames showed its place free; otherwise it is discovered.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from dssmsg.frame import Float32Array, FloatArray
from dssmsg.geometry import points_in_box
from dssmsg.graph.evidence import SightRule, look_at, telling, verdict_of
from dssmsg.graph.memory import Remembered
from dssmsg.graph.verdicts import MISSED, PRESENT

MAX_VIEWS = 40
"""As many earlier frames, those from nearby first, are asked; more say nothing new."""


@dataclass(frozen=True, slots=True)
class BaseEvidence:
    """Earlier frames (indices) that show a new object's place free, and those that show a surface there."""

    free: tuple[int, ...]
    taken: tuple[int, ...]

    def shows_free(self, k: int) -> bool:
        """At least k frames show the place free, and most of those that tell anything do."""
        return len(self.free) >= k and len(self.free) > 2 * len(self.taken)


def base_evidence(
    points: Float32Array,
    former: Iterable[tuple[FloatArray, FloatArray]],
    views: Iterable[Remembered],
    noise: tuple[float, float],
    rule: SightRule,
) -> BaseEvidence:
    """What earlier views say of the place of a new object with `points` (N, 3).

    `former` are boxes (corners (3,), (3,)) of things that have vanished since: a chair pushed aside stands
    partly where it stood, so points in such a box are not asked, unless hardly any would be left.
    """
    asked = high = telling(points)
    for low, up in former:
        asked = asked & ~points_in_box(points, low, up)
    if np.count_nonzero(asked) < max(rule.min_points, 0.1 * len(points)):
        asked = high
    free, taken = [], []
    for remembered in islice(views, MAX_VIEWS):
        verdict = verdict_of(look_at(points[asked], remembered.view, noise, rule), rule)
        if verdict == MISSED:
            free.append(remembered.view.frame)
        elif verdict == PRESENT:
            taken.append(remembered.view.frame)
    return BaseEvidence(tuple(sorted(set(free))), tuple(sorted(set(taken))))
