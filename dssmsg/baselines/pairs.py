"""How well a thing fits an object: overlap in space plus alike looks and names, each with its weight."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from dssmsg.baselines.appearance import image_cosine, text_cosine
from dssmsg.frame import Float32Array, Observation
from dssmsg.geometry import box_iou, grow_box, points_in_box
from dssmsg.graph.changes import Score
from dssmsg.graph.nodes import ObjectNode
from dssmsg.graph.scoring import neighbour_share
from dssmsg.graph.view import GraphView
from dssmsg.graph.voxels import VOXEL_M

MIN_IOU = 1e-6
"""Boxes that have less than this in common do not overlap."""


@dataclass(frozen=True, slots=True)
class Weights:
    """What each term counts in a pair's score."""

    overlap: float
    image: float
    text: float


@dataclass(frozen=True, slots=True)
class Pair:
    """The terms of one pair: overlap 0..1, cosines -1..1, and `score`, their weighted sum.

    `exact` is False while the overlap is only an upper bound.
    """

    object_id: str
    overlap: float
    image: float
    text: float
    score: float
    exact: bool

    def exceeds(self, limits: Mapping[str, float]) -> bool:
        """Whether every term named (`overlap`, `image`, `text`, `score`) is above its limit."""
        return all(value > limits[name] for name, value in self._terms() if name in limits)

    def terms(self, limits: Mapping[str, float]) -> tuple[Score, ...]:
        """The terms as a change states them, with the limits they were held against."""
        return tuple(Score(name, value, limits.get(name)) for name, value in self._terms())

    def _terms(self) -> tuple[tuple[str, float], ...]:
        return (
            ("score", self.score), ("overlap", self.overlap), ("image", self.image), ("text", self.text)
        )  # fmt: skip


class PairScorer:
    """Scores things against the objects of a graph.

    The overlap is the share of the thing's points with a point of the object nearer than `tolerance` metres,
    and 0 where their boxes have no volume in common (both methods; ConceptGraphs, section III-B).
    """

    def __init__(self, graph: GraphView, weights: Weights, tolerance: float) -> None:
        self._graph = graph
        self._weights = weights
        self._tolerance = tolerance

    def bound(self, thing: Observation | ObjectNode, object_id: str) -> Pair:
        """The pair with an overlap that is never too small: the share of points in the object's box."""
        node = self._graph.objects[object_id]
        image, text = image_cosine(thing, node), text_cosine(thing, node)
        # A voxel stands for its whole cell, so that a rug or a picture has a volume, too.
        own = grow_box(thing.box_min, thing.box_max, VOXEL_M / 2)
        iou = float(box_iou(*own, *grow_box(node.box_min, node.box_max, VOXEL_M / 2)))
        overlap = 0.0
        if iou >= MIN_IOU:
            points = points_of(thing)
            reach = grow_box(node.box_min, node.box_max, self._tolerance)
            overlap = int(np.count_nonzero(points_in_box(points, *reach))) / len(points)
        return self._pair(object_id, overlap, image, text, exact=overlap == 0.0)

    def exact(self, thing: Observation | ObjectNode, pair: Pair) -> Pair:
        """The same pair with its overlap counted point by point."""
        if pair.exact:
            return pair
        node = self._graph.objects[pair.object_id]
        points = points_of(thing)
        # Points outside of the object's box have no neighbour on it: no need to ask.
        near = points[points_in_box(points, *grow_box(node.box_min, node.box_max, self._tolerance))]
        share = neighbour_share(near, self._graph.tree(node.id), self._tolerance)
        return self._pair(node.id, share * len(near) / len(points), pair.image, pair.text, exact=True)

    def best(self, thing: Observation, object_ids: Iterable[str]) -> Pair | None:
        """The pair with the largest score (of equal ones the first), None where there are no objects.

        Overlaps are counted only as long as a bound promises more than what is found.
        """
        order = {object_id: place for place, object_id in enumerate(object_ids)}
        best: Pair | None = None
        for bound in sorted((self.bound(thing, one) for one in order), key=lambda pair: -pair.score):
            if best is not None and bound.score < best.score:
                break
            pair = self.exact(thing, bound)
            if best is None or (pair.score, -order[pair.object_id]) > (best.score, -order[best.object_id]):
                best = pair
        return best

    def _pair(self, object_id: str, overlap: float, image: float, text: float, exact: bool) -> Pair:
        weights = self._weights
        score = weights.overlap * overlap + weights.image * image + weights.text * text
        return Pair(object_id, overlap, image, text, score, exact)


def points_of(thing: Observation | ObjectNode) -> Float32Array:
    """The cloud (N, 3) of an observation or of an object, world metres."""
    return thing.points_world if isinstance(thing, Observation) else thing.points
