"""Objects of two graphs matched by place: which are in one alone, and which of both say different things."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from dssmsg.frame import FloatArray
from dssmsg.geometry import box_iou
from dssmsg.graph.nodes import ObjectNode
from dssmsg.graph.view import GraphView

MIN_IOU = 0.25
MAX_DISTANCE_M = 0.3
"""Same place: boxes overlap by so much, or centres are so near (ALGORITHM, Scores)."""
_FACTS = ("label", "status", "state")


@dataclass(frozen=True, slots=True)
class ObjectBrief:
    """An object in a few words; `center` in world metres."""

    id: str
    label: str
    status: str
    state: str
    center: tuple[float, float, float]
    observations: int

    @classmethod
    def of(cls, node: ObjectNode) -> ObjectBrief:
        """The words on a node."""
        x, y, z = (round(float(value), 3) for value in node.center)
        return cls(node.id, node.label, node.status, node.state, (x, y, z), node.observations)


@dataclass(frozen=True, slots=True)
class Placed:
    """An object with its box, corners (3,) in world metres: a graph without its clouds."""

    brief: ObjectBrief
    box_min: FloatArray
    box_max: FloatArray


@dataclass(frozen=True, slots=True)
class ObjectPair:
    """One thing in both graphs. `differs` names the facts that are not the same in both."""

    a: ObjectBrief
    b: ObjectBrief
    distance_m: float
    differs: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ObjectDifference:
    """How the objects of two graphs differ; `same` counts the pairs that agree."""

    same: int
    differing: tuple[ObjectPair, ...]
    only_a: tuple[ObjectBrief, ...]
    only_b: tuple[ObjectBrief, ...]


def placed(graph: GraphView) -> list[Placed]:
    """The objects of a graph, of which nothing large is kept."""
    return [Placed(ObjectBrief.of(node), node.box_min, node.box_max) for node in graph.objects.values()]


def compare_objects(ours: Sequence[Placed], theirs: Sequence[Placed]) -> ObjectDifference:
    """Match the objects of two graphs one to one by place, those of the same label first."""
    pairs: list[ObjectPair] = []
    for i, j, distance in _matched(ours, theirs):
        a, b = ours[i].brief, theirs[j].brief
        differs = tuple(name for name in _FACTS if getattr(a, name) != getattr(b, name))
        pairs.append(ObjectPair(a, b, round(distance, 3), differs))
    known_a, known_b = {pair.a.id for pair in pairs}, {pair.b.id for pair in pairs}
    return ObjectDifference(
        sum(not pair.differs for pair in pairs),
        tuple(pair for pair in pairs if pair.differs),
        tuple(one.brief for one in ours if one.brief.id not in known_a),
        tuple(one.brief for one in theirs if one.brief.id not in known_b),
    )


def _matched(ours: Sequence[Placed], theirs: Sequence[Placed]) -> list[tuple[int, int, float]]:
    """(place in a, place in b, metres between the centres) of a best one-to-one matching, in a's order."""
    if not ours or not theirs:
        return []
    low_a, high_a = _boxes(ours)
    low_b, high_b = _boxes(theirs)
    iou = box_iou(low_a[:, None], high_a[:, None], low_b[None], high_b[None])
    centers_a, centers_b = (low_a + high_a) / 2, (low_b + high_b) / 2
    distance = np.linalg.norm(centers_a[:, None] - centers_b[None], axis=-1)
    halves = np.linalg.norm(high_a - low_a, axis=-1) / 2
    fits = (iou >= MIN_IOU) | (distance <= np.minimum(MAX_DISTANCE_M, halves)[:, None])
    # A label in common counts more than any overlap; what does not fit is worth nothing.
    alike = np.array([[one.brief.label == other.brief.label for other in theirs] for one in ours])
    worth = np.where(fits, 1.0 + 2.0 * alike + iou - 0.1 * np.minimum(distance, 1.0), 0.0)
    rows, columns = linear_sum_assignment(worth, maximize=True)
    return [(int(i), int(j), float(distance[i, j])) for i, j in zip(rows, columns, strict=True) if fits[i, j]]


def _boxes(nodes: Sequence[Placed]) -> tuple[np.ndarray, np.ndarray]:
    return np.array([node.box_min for node in nodes]), np.array([node.box_max for node in nodes])
