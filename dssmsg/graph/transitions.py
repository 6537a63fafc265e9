"""The changes behind each verdict on an object: it vanished, appeared, moved, came back (paper III-A,
III-B)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from dssmsg.graph.changes import (
    Cause,
    Change,
    EdgeRemoved,
    ObjectChanged,
    ObjectRemoved,
    ObjectReplaced,
    ObjectsJoined,
    Score,
)
from dssmsg.graph.movement import MoveScore
from dssmsg.graph.nodes import APPEARED, BELIEVED, DISAPPEARED, NEAR, SEES, ObjectNode
from dssmsg.graph.view import GraphView

Scores = tuple[Score, ...]


def vanished(graph: GraphView, object_id: str, cause: Cause, scores: Scores) -> Iterator[Change]:
    """It is no longer there: no viewpoint sees it, nothing is near it; the node keeps its last place.

    A tentative one is believed from now on: what was there and is not was a thing.
    """
    believe = graph.objects[object_id].status != BELIEVED
    yield _state(object_id, DISAPPEARED, cause, scores, believe=believe)
    yield from without_edges(graph, object_id, cause)


def without_edges(graph: GraphView, object_id: str, cause: Cause) -> Iterator[Change]:
    """All `sees` and `near` edges of an object go."""
    for edge in graph.edges_of(object_id):
        if edge.kind in (SEES, NEAR):
            yield EdgeRemoved(cause=cause, edge=edge.kind, source=edge.source, target=edge.target)


def corrected(object_id: str, cause: Cause, scores: Scores) -> Change:
    """It never was there: an early error of perception."""
    return ObjectRemoved(cause=cause, scores=scores, object_id=object_id)


def piece(whole_id: str, piece_id: str, cause: Cause, scores: Scores) -> Change:
    """What came or went beside a thing of its kind, and with it, is a piece of it."""
    return ObjectsJoined(cause=cause, scores=scores, object_id=whole_id, absorbed_id=piece_id)


def appeared(object_id: str, cause: Cause, scores: Scores, *, believe: bool = False) -> Change:
    """It was not there before; so it is a thing: `believe` one that was tentative."""
    return _state(object_id, APPEARED, cause, scores, believe=believe)


def moved(
    old: ObjectNode, new: ObjectNode, state: str, history_id: str, cause: Cause, scores: Scores
) -> Iterator[Change]:
    """The vanished `old` is where `new` was found: it keeps its id, the newer one retires into it.

    The former place stays as a history node; the edges of the newer id come along.
    """
    yield ObjectReplaced(
        cause=cause,
        scores=scores,
        object_id=old.id,
        points=new.points,
        colors=new.colors,
        history_id=history_id,
    )
    yield ObjectsJoined(cause=cause, object_id=old.id, absorbed_id=new.id)
    yield _state(old.id, state, cause, ())


def returned(old: ObjectNode, new: ObjectNode, state: str, cause: Cause, scores: Scores) -> Iterator[Change]:
    """The vanished `old` is back in its place: what was found there is it."""
    yield ObjectsJoined(cause=cause, scores=scores, object_id=old.id, absorbed_id=new.id)
    yield _state(old.id, state, cause, ())


def move_scores(score: MoveScore, delta_move: float, delta_sem: float) -> Scores:
    """The terms of eq. 1-2 as a change records them."""
    return (
        Score("s_move", score.s_move, delta_move),
        Score("s_rgb", score.s_rgb),
        Score("s_sem", score.s_sem, delta_sem),
        Score("s_v", score.s_v),
    )


def frame_scores(frames: Sequence[int], k: int) -> Scores:
    """How many consistent frames speak for a verdict, and the first of them."""
    return (Score("consistent_frames", float(len(frames)), float(k)), Score("since_frame", float(frames[0])))


def without_repeats(changes: Iterable[Change]) -> Iterator[Change]:
    """The changes of one frame where each edge goes once: neighbours that vanish together share theirs."""
    gone: set[tuple[str, str, str]] = set()
    removed: set[str] = set()
    for change in changes:
        if isinstance(change, EdgeRemoved):
            key = (change.edge, change.source, change.target)
            if key in gone or not removed.isdisjoint(change.subjects):
                continue
            gone.add(key)
        elif isinstance(change, ObjectRemoved):
            removed.add(change.object_id)
        yield change


def _state(
    object_id: str, state: str, cause: Cause, scores: Scores, *, believe: bool = False
) -> ObjectChanged:
    values = {"status": BELIEVED, "state": state} if believe else {"state": state}
    return ObjectChanged(cause=cause, scores=scores, object_id=object_id, values=values)
