"""Did it appear, or was it only not seen before? (paper III-A; ALGORITHM B)

A new object has appeared where enough earlier frames showed its place free; otherwise it is discovered.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from dssmsg.frame import ByteArray, Float32Array, FloatArray
from dssmsg.geometry import points_in_box
from dssmsg.graph.colors import color_similarity
from dssmsg.graph.evidence import PlaceSight, SightRule, View, is_thin, look_at, sampled, telling, verdict_of
from dssmsg.graph.memory import Remembered
from dssmsg.graph.verdicts import MISSED, PRESENT, UNKNOWN

MAX_VIEWS = 40
"""As many earlier frames, those from nearby first, are asked; more say nothing new."""


@dataclass(frozen=True, slots=True)
class BaseEvidence:
    """Earlier frames (indices) that show a new object's place free, and those that show a surface there."""

    free: tuple[int, ...]
    taken: tuple[int, ...]

    def shows_free(self, k: int) -> bool:
        """At least k frames show the place free, and most of those that tell anything up to the last of them.

        What shows it taken after that is the new object itself, not detected yet.
        """
        if len(self.free) < k:
            return False
        earlier = [frame for frame in self.taken if frame < self.free[-1]]
        return len(self.free) > 2 * len(earlier)


@dataclass(frozen=True, slots=True, eq=False)
class Newcomer:
    """What a new object looks like: points (N, 3), colours (N, 3); `gain`: its light against that before.

    One too thin for depth is told by colours: below `changed` (s_rgb) something else was in its place.
    """

    points: Float32Array
    colors: ByteArray
    gain: float
    changed: float


def base_evidence(
    new: Newcomer,
    former: Iterable[tuple[FloatArray, FloatArray]],
    views: Iterable[Remembered],
    noise: tuple[float, float],
    rule: SightRule,
) -> BaseEvidence:
    """What earlier views say of the place of a new object.

    `former` are boxes (corners (3,), (3,)) of things that have vanished since: a chair pushed aside stands
    partly where it stood, so points in such a box are not asked, unless hardly any would be left.
    """
    points = new.points
    asked = high = telling(points)
    thin = is_thin(points, 2 * rule.min_margin)
    for low, up in former:
        asked = asked & ~points_in_box(points, low, up)
    if np.count_nonzero(asked) < max(rule.min_points, 0.1 * len(points)):
        asked = high
    free, taken = [], []
    for remembered in islice(views, MAX_VIEWS):
        sight = look_at(points[asked], remembered.view, noise, rule)
        verdict = verdict_of(sight, rule)
        if verdict in (PRESENT, UNKNOWN) and thin:
            verdict = _by_color(new, new.colors[asked], sight, remembered.view, rule)
        if verdict == MISSED:
            free.append(remembered.view.frame)
        elif verdict == PRESENT:
            taken.append(remembered.view.frame)
    return BaseEvidence(tuple(sorted(set(free))), tuple(sorted(set(taken))))


def _by_color(new: Newcomer, colors: ByteArray, sight: PlaceSight, view: View, rule: SightRule) -> str:
    """`missed` where a view shows a surface of other colours in the place of a thin thing."""
    on = sight.on_surface
    if np.count_nonzero(on) < rule.min_points:
        return UNKNOWN
    before = view.rgb[sight.rows[on], sight.columns[on]]
    alike = color_similarity(before, sampled(colors, rule.sample)[on], 1.0 / new.gain)
    return MISSED if alike < new.changed else PRESENT
