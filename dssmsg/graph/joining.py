"""Which objects are one thing that was split: the merge pass of ALGORITHM A.2, on a read-only graph."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from dssmsg.frame import FloatArray
from dssmsg.geometry import grow_box, points_in_box
from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import BELIEVED, DISAPPEARED, ObjectNode
from dssmsg.graph.scoring import neighbour_share
from dssmsg.graph.view import GraphView

_OUTSIZED = 1.4
"""So many times as wide as the others of its label is too wide."""


@dataclass(frozen=True, slots=True)
class Join:
    """`absorbed_id` is part of `object_id`, the older one. `value` is what joined them: a share, or a gap in
    metres, held against `limit`."""

    object_id: str
    absorbed_id: str
    value: float
    limit: float


def contained_pieces(
    graph: GraphView, touched: Iterable[str], apart: Iterable[str], min_share: float, tolerance: float
) -> list[Join]:
    """Joins by containment among the `touched` objects and what is beside them, to be applied in this order.

    Two objects join where they have the same label and more than `min_share` of the smaller cloud's points
    lie within `tolerance` metres of the larger one, the largest share first. Never two that one frame
    saw as different things, be it in the past (a frame gives an object at most one detection, so their
    `frames` then share an index) or, for the objects in `apart`, in the frame at hand.
    """
    found = []
    for a, b in _candidates(graph, touched, tolerance):
        small, large = (a, b) if len(a.points) <= len(b.points) else (b, a)
        # Points outside the larger one's box have no neighbour on it: no need to ask.
        inside = points_in_box(small.points, *grow_box(large.box_min, large.box_max, tolerance))
        bound = np.count_nonzero(inside) / len(small.points)
        if bound <= min_share:
            continue
        share = bound * neighbour_share(small.points[inside], graph.tree(large.id), tolerance)
        if share > min_share:
            found.append(Join(a.id, b.id, share, min_share))
    found.sort(key=lambda join: -join.value)  # stable: ties stay in order of ids
    return _consistent(graph, found, apart)


def fragments(
    graph: GraphView, touched: Iterable[str], joined: Iterable[Join], min_share: float, tolerance: float
) -> list[Join]:
    """Joins of doubtful objects with the believed one of their label that holds all but a little of them.

    Also where one frame saw both: it saw the neck of a guitar beside its body. `joined` are joins made just
    before, that the graph does not show yet: what is in them is left alone.
    """
    busy = {name for join in joined for name in (join.object_id, join.absorbed_id)}
    found: dict[str, Join] = {}
    for first, second in sorted(_near_pairs(graph, touched, tolerance)):
        a, b = graph.objects[first], graph.objects[second]
        part, whole = (a, b) if b.status == BELIEVED else (b, a)
        told = part.status != BELIEVED and whole.status == BELIEVED and part.label == whole.label
        if not told or DISAPPEARED in (a.state, b.state) or {first, second} & busy:
            continue
        share = neighbour_share(part.points, graph.tree(whole.id), tolerance)
        best = found.get(part.id)
        if share >= min_share and (best is None or share > best.value):
            keep, lose = sorted((part.id, whole.id), key=id_order)
            found[part.id] = Join(keep, lose, share, min_share)
    once: set[str] = set()
    joins = []
    for join in sorted(found.values(), key=lambda join: (-join.value, id_order(join.object_id))):
        if not {join.object_id, join.absorbed_id} & once:
            once |= {join.object_id, join.absorbed_id}
            joins.append(join)
    return joins


def aligned_pieces(
    graph: GraphView,
    touched: Iterable[str],
    joined: Iterable[Join],
    unnamed: Iterable[str],
    max_gap: float,
    max_gap_share: float,
) -> list[Join]:
    """Joins by fit: pieces of one label that line up and leave a small gap, the smallest first.

    For when no view showed the whole: a wardrobe seen left and right of what stands before it, a lamp's foot
    and shade. Along one axis the pieces may be apart, by at most `max_gap` metres and `max_gap_share` of
    their joint length, between boxes as between clouds (so that thin things back to back, two mirrors on a
    wall's two sides, do not fit); along the other axes half of the shorter one must lie beside the other.
    Pieces whose label is in `unnamed` (those of a class-agnostic perception) have no label in common and
    never fit. `joined` are joins made just before, that the graph does not show yet: these are added to them.
    The same two never join that `contained_pieces` keeps apart, nor two that would be too large for their
    kind, see `_outsized`: two chairs side by side line up as well as the halves of a wardrobe.
    """
    nameless = frozenset(unnamed)
    found = []
    for a, b in _candidates(graph, touched, max_gap):
        if a.label in nameless:
            continue
        overlaps = np.minimum(a.box_max, b.box_max) - np.maximum(a.box_min, b.box_min)
        axis = int(np.argmin(overlaps))
        shorter = np.minimum(a.box_max - a.box_min, b.box_max - b.box_min)
        beside = overlaps >= 0.5 * shorter
        beside[axis] = True
        joint = float(max(a.box_max[axis], b.box_max[axis]) - min(a.box_min[axis], b.box_min[axis]))
        limit = min(max_gap, max_gap_share * joint)
        if not beside.all() or -overlaps[axis] > limit or _outsized(graph, a, b, max_gap):
            continue
        small, large = (a, b) if len(a.points) <= len(b.points) else (b, a)
        gaps, _ = graph.tree(large.id).query(small.points, distance_upper_bound=limit)
        gap = float(np.min(gaps))
        if gap < limit:
            found.append(Join(a.id, b.id, gap, limit))
    found.sort(key=lambda join: join.value)
    before = list(joined)
    return _consistent(graph, [*before, *found], ())[len(before) :]


def _outsized(graph: GraphView, a: ObjectNode, b: ObjectNode, max_gap: float) -> bool:
    """Whether two are much wider together than either, and than any other of their label; False where none is
    known. What is within `max_gap` of the two may be one more piece of them, and tells nothing."""
    low, high = np.minimum(a.box_min, b.box_min), np.maximum(a.box_max, b.box_max)
    beside = frozenset(graph.objects_touching(*grow_box(low, high, max_gap)))
    others = [
        _width(other.box_min, other.box_max)
        for other in graph.objects.values()
        if other.label == a.label and other.status == BELIEVED and other.id not in beside
    ]
    apart = max(_width(a.box_min, a.box_max), _width(b.box_min, b.box_max))
    return bool(others) and _width(low, high) > _OUTSIZED * max(*others, apart)


def _width(box_min: FloatArray, box_max: FloatArray) -> float:
    """The longer side of a box on the floor, metres."""
    return float((box_max - box_min)[:2].max())


def _candidates(
    graph: GraphView, touched: Iterable[str], distance: float
) -> Iterator[tuple[ObjectNode, ObjectNode]]:
    """Pairs (older, newer) within `distance`, of one label, that no past frame saw as two; ordered by id."""
    for first, second in sorted(
        _near_pairs(graph, touched, distance), key=lambda pair: [*map(id_order, pair)]
    ):
        a, b = graph.objects[first], graph.objects[second]
        gone = DISAPPEARED in (a.state, b.state)  # what took the place of a vanished thing is not part of it
        if a.label == b.label and not gone and set(a.frames).isdisjoint(b.frames):
            yield a, b


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
        joins.append(replace(pair, object_id=keep, absorbed_id=lose))
    return joins
