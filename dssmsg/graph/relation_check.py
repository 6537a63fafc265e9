"""Whether a spatial relation that a sentence names holds between two things, 0..1 (beyond the paper).

The paper matches degrees and never asks what an edge says. Here the words are held against geometry: boxes,
visible surfaces and, for words that depend on where one looks from, the viewpoints that see both things.
Nothing is a plain yes or no: a thing beside another still gets a little for "on", so that where no pair fits
the nearest one wins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dssmsg.frame import FloatArray
from dssmsg.graph.relations import ABOVE, BELOW, CONTAINS, IN, NEXT_TO, ON, UNDER, gap, relation
from dssmsg.graph.subgraph import Thing
from dssmsg.graph.view import GraphView

TOUCHING_M = 0.5
"""Up to here things are next to each other (the reach of a `near` edge)."""
NEARBY_M = 3.0
"""From here on they have nothing to do with each other."""
_APART = 0.5
"""What is left of nearness where no viewpoint sees both: there may be a wall between."""

# What each relation of `dssmsg.graph.relations` counts where a word was asked for.
_ON = {ON: 1.0, IN: 0.7, ABOVE: 0.5}
_IN = {IN: 1.0, ON: 0.7}
_UNDER = {UNDER: 1.0, BELOW: 1.0, CONTAINS: 0.3}
_ABOVE = {ABOVE: 1.0, ON: 0.6}
_WITH = {UNDER: 1.0, CONTAINS: 1.0, NEXT_TO: 0.9, BELOW: 0.8, ON: 0.7, IN: 0.7, ABOVE: 0.7}

SYNONYMS: Mapping[str, str] = {
    "on top of": "on", "upon": "on", "atop": "on", "inside": "in", "within": "in", "into": "in",
    "underneath": "under", "beneath": "under", "below": "under", "over": "above",
    "next to": "beside", "by": "beside", "adjacent to": "beside", "alongside": "beside", "at": "beside",
    "near to": "near", "close to": "near", "around": "near", "nearby": "near", "against": "near",
    "having": "with", "and": "near", "contains": "with", "holding": "with",
    "before": "in front of", "to the left of": "left of", "to the right of": "right of",
    "across from": "opposite", "facing": "opposite", "in the middle of": "between", "among": "between",
}  # fmt: skip
"""Other words for the relations that are checked."""


class RelationCheck:
    """Answers for the things of one query; each pair is looked at once a word."""

    def __init__(self, graph: GraphView, things: Sequence[Thing]) -> None:
        self._graph = graph
        self._things = things
        self._known: dict[tuple[str, int, int], float] = {}
        self._words: dict[tuple[int, int], str] = {}
        self._rules: Mapping[str, Callable[[int, int], float]] = {
            "on": lambda a, b: self._graded(a, b, _ON),
            "in": lambda a, b: self._graded(a, b, _IN),
            "under": lambda a, b: self._graded(a, b, _UNDER),
            "above": lambda a, b: max(self._graded(a, b, _ABOVE), self._higher(a, b)),
            "with": lambda a, b: self._graded(a, b, _WITH),
            "beside": self._beside,
            "near": self._near,
            "between": self._beside,
            "in front of": lambda a, b: self._beside(a, b) * (0.5 + 0.5 * self._looked(a, b, _nearer)),
            "behind": lambda a, b: self._beside(a, b) * (0.5 + 0.5 * self._looked(b, a, _nearer)),
            "left of": lambda a, b: self._near(a, b) * self._looked(a, b, _further_left),
            "right of": lambda a, b: self._near(a, b) * self._looked(b, a, _further_left),
            "opposite": self._opposite,
        }

    def holds(self, word: str, a: int, b: int) -> float:
        """How well "a <word> b" is true, 0..1. A word that is not known asks for nearness alone."""
        word = " ".join(word.lower().split())
        name = SYNONYMS.get(word, word)
        key = (name, a, b)
        if key not in self._known:
            self._known[key] = 0.0 if a == b else self._rules.get(name, self._near)(a, b)
        return self._known[key]

    def _gap(self, a: int, b: int) -> float:
        one, other = self._things[a], self._things[b]
        return gap(one.box_min, one.box_max, other.box_min, other.box_max)

    def _word(self, a: int, b: int) -> str:
        if (a, b) not in self._words:
            self._words[a, b] = relation(self._things[a], self._things[b])
        return self._words[a, b]

    def _near(self, a: int, b: int) -> float:
        """1 up to touching distance, then less and less; things that are never seen together count half."""
        closeness = (NEARBY_M - self._gap(a, b)) / (NEARBY_M - TOUCHING_M)
        together = self._things[a].viewpoints & self._things[b].viewpoints
        return float(np.clip(closeness, 0.0, 1.0)) * (1.0 if together else _APART)

    def _beside(self, a: int, b: int) -> float:
        """Nearness, but what is on or in the other is not next to it."""
        close = self._near(a, b)
        inside = self._gap(a, b) < TOUCHING_M and self._word(a, b) in (ON, IN, UNDER, CONTAINS)
        return close * (0.7 if inside else 1.0)

    def _graded(self, a: int, b: int, grades: Mapping[str, float]) -> float:
        close = self._near(a, b)
        grade = grades.get(self._word(a, b), 0.0) if self._gap(a, b) < NEARBY_M else 0.0
        return close * max(grade, 0.25)

    def _higher(self, a: int, b: int) -> float:
        """A picture above a sofa hangs on the wall behind it: higher up, side by side in plan."""
        one, other = self._things[a], self._things[b]
        aside = gap(*(np.append(corner[:2], 0.0) for t in (one, other) for corner in (t.box_min, t.box_max)))
        over = one.center[2] > other.center[2] and one.box_min[2] >= other.box_max[2] - 0.25
        return 0.9 if over and aside < TOUCHING_M else 0.0

    def _looked(self, a: int, b: int, rule: Callable[[FloatArray, FloatArray, FloatArray], bool]) -> float:
        """Share of the viewpoints that see both from which the rule holds; a half if there are none."""
        views = sorted(self._things[a].viewpoints & self._things[b].viewpoints)
        if not views:
            return 0.5
        poses = [self._graph.viewpoints[view].world_from_camera for view in views]
        ends = self._things[a].center, self._things[b].center
        return sum(rule(pose, *ends) for pose in poses) / len(poses)

    def _opposite(self, a: int, b: int) -> float:
        """Across some floor from each other: 1 to 3 m apart, and seen together or at least in one room."""
        apart = self._gap(a, b)
        return self._near(a, b) if apart < 1.0 else (1.0 if apart <= NEARBY_M + 1.0 else 0.0)


def _nearer(pose: FloatArray, a: FloatArray, b: FloatArray) -> bool:
    eye = pose[:3, 3]
    return bool(np.linalg.norm(a - eye) < np.linalg.norm(b - eye))


def _further_left(pose: FloatArray, a: FloatArray, b: FloatArray) -> bool:
    """By the angle in the image: the camera's x axis points right."""
    bearings = []
    for spot in (a, b):
        way = spot - pose[:3, 3]
        bearings.append(np.arctan2(way @ pose[:3, 0], way @ pose[:3, 2]))
    return bool(bearings[0] < bearings[1])
