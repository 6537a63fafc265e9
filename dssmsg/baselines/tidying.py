"""What both methods do to their map now and then: denoise clouds, unite objects that are one thing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from dssmsg.baselines.pairs import Pair, PairScorer
from dssmsg.frame import Float32Array, MaskArray
from dssmsg.geometry import grow_box
from dssmsg.graph.changes import Cause, ObjectReplaced, ObjectsJoined, Score
from dssmsg.graph.ids import id_order
from dssmsg.graph.view import GraphView

Denoise = Callable[[Sequence[Float32Array]], Sequence[MaskArray]]
"""Of clouds (N, 3) the points to keep, (N,) bool each."""


def denoised(
    graph: GraphView, object_ids: Sequence[str], denoise: Denoise, min_points: int, plugin: str
) -> list[ObjectReplaced]:
    """The clouds of objects, cut to the points that `denoise` keeps, where at least `min_points` are left."""
    nodes = [graph.objects[object_id] for object_id in object_ids]
    changes = []
    for node, kept in zip(nodes, denoise([node.points for node in nodes]), strict=True):
        count = int(np.count_nonzero(kept))
        if count == len(kept) or count < min_points:
            continue
        changes.append(
            ObjectReplaced(
                cause=Cause(plugin, "denoise"),
                scores=(Score("points", float(count), float(min_points)),),
                object_id=node.id,
                points=node.points[kept],
                colors=node.colors[kept],
            )
        )
    return changes


def joined(
    graph: GraphView, scorer: PairScorer, touched: Iterable[str], limits: Mapping[str, float], plugin: str
) -> list[ObjectsJoined]:
    """Joins of the touched objects with what they overlap, all terms above their limits, the best first.

    The overlap is asked both ways and the larger one counts: of the smaller object's points. The older id
    stays. An object that was joined is not scored again with its new cloud; the next pass does that.
    """
    found: list[tuple[str, Pair]] = []
    seen: set[frozenset[str]] = set()
    for first in touched:
        node = graph.objects[first]
        for second in graph.objects_touching(*grow_box(node.box_min, node.box_max, 0.05)):
            couple = frozenset((first, second))
            if len(couple) == 1 or couple in seen:
                continue
            seen.add(couple)
            pair = _fit(graph, scorer, first, second, limits)
            if pair is not None:
                found.append((second if pair.object_id == first else first, pair))
    found.sort(key=lambda one: (-one[1].score, id_order(one[0]), id_order(one[1].object_id)))
    root: dict[str, str] = {}

    def find(object_id: str) -> str:
        while object_id in root:
            object_id = root[object_id]
        return object_id

    changes = []
    for other, pair in found:
        keep, lose = sorted((find(other), find(pair.object_id)), key=id_order)
        if keep == lose:
            continue
        root[lose] = keep
        changes.append(
            ObjectsJoined(
                cause=Cause(plugin, "join"), scores=pair.terms(limits), object_id=keep, absorbed_id=lose
            )
        )
    return changes


def _fit(
    graph: GraphView, scorer: PairScorer, first: str, second: str, limits: Mapping[str, float]
) -> Pair | None:
    """The better of both directions where it exceeds the limits."""
    best: Pair | None = None
    for one, other in ((first, second), (second, first)):
        thing = graph.objects[one]
        bound = scorer.bound(thing, other)
        if not bound.exceeds(limits):
            continue
        pair = scorer.exact(thing, bound)
        if pair.exceeds(limits) and (best is None or pair.score > best.score):
            best = pair
    return best
