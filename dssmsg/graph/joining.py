"""Which objects are one thing that was split: the merge pass of ALGORITHM A.2, on a read-only graph."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dssmsg.geometry import grow_box, points_in_box
from dssmsg.graph.ids import id_order
from dssmsg.graph.scoring import neighbour_share
from dssmsg.graph.view import GraphView


@dataclass(frozen=True, slots=True)
class Join:
    """`absorbed_id` is part of `object_id`, the older one; `share` 0..1 is what joined them."""

    object_id: str
    absorbed_id: str
    share: float


def split_objects(
    graph: GraphView, touched: Iterable[str], apart: Iterable[str], min_share: float, tolerance: float
) -> list[Join]:
    """Joins among the `touched` objects and what is beside them, to be applied in the order given.

    Two objects join where they have the same label and more than `min_share` of the smaller cloud's points
    lie within `tolerance` metres of the larger one, the largest share first. Never two that one frame
    saw as different things, be it in the past (a frame gives an object at most one detection, so their
    `frames` then share an index) or, for the objects in `apart`, in the frame at hand.
    """
    pairs = []
    for first, second in sorted(
        _near_pairs(graph, touched, tolerance), key=lambda pair: [id_order(i) for i in pair]
    ):
        a, b = graph.objects[first], graph.objects[second]
        if a.label != b.label or not set(a.frames).isdisjoint(b.frames):
            continue
        small, large = (a, b) if len(a.points) <= len(b.points) else (b, a)
        # Points outside the larger one's box have no neighbour on it: no need to ask.
        inside = points_in_box(small.points, *grow_box(large.box_min, large.box_max, tolerance))
        if np.count_nonzero(inside) <= min_share * len(small.points):
            continue
        share = neighbour_share(small.points[inside], graph.tree(large.id), tolerance)
        share *= np.count_nonzero(inside) / len(small.points)
        if share > min_share:
            pairs.append(Join(first, second, float(share)))
    pairs.sort(key=lambda join: -join.share)  # stable: ties stay in order of ids
    return _consistent(graph, pairs, apart)


def _near_pairs(graph: GraphView, touched: Iterable[str], tolerance: float) -> set[tuple[str, str]]:
    """Pairs (older, newer) of objects with boxes within `tolerance`, at least one of them touched."""
    pairs = set()
    for object_id in touched:
        node = graph.objects.get(object_id)
        if node is None:  # has left the graph since
            continue
        for other in graph.objects_touching(*grow_box(node.box_min, node.box_max, tolerance)):
            if other != object_id:
                first, second = sorted((object_id, other), key=id_order)
                pairs.add((first, second))
    return pairs


def _consistent(graph: GraphView, pairs: list[Join], apart: Iterable[str]) -> list[Join]:
    """The wanted joins, one by one between what is left; none that unites two things seen in one frame."""
    root: dict[str, str] = {}
    frames: dict[str, set[int]] = {}
    forbidden = {frozenset(pair) for pair in combinations(sorted(apart), 2)}
    members: dict[str, set[str]] = {}

    def find(object_id: str) -> str:
        while object_id in root:
            object_id = root[object_id]
        return object_id

    joins = []
    for pair in pairs:
        keep, lose = sorted((find(pair.object_id), find(pair.absorbed_id)), key=id_order)
        if keep == lose:
            continue
        for object_id in (keep, lose):
            frames.setdefault(object_id, set(graph.objects[object_id].frames))
            members.setdefault(object_id, {object_id})
        together = any(frozenset((a, b)) in forbidden for a in members[keep] for b in members[lose])
        if together or not frames[keep].isdisjoint(frames[lose]):
            continue
        root[lose] = keep
        frames[keep] |= frames.pop(lose)
        members[keep] |= members.pop(lose)
        joins.append(Join(keep, lose, pair.share))
    return joins
