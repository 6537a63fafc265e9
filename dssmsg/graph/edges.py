"""`sees` and `near` edges from what one key frame saw (paper III-A; ALGORITHM A.4).

Only what was seen in this frame is looked at, so the cost depends on what is in view. `near` edges arise
between things seen together, hence never through a wall; tentative objects get theirs, too, as the frame
that showed both may not come again. Removing edges on evidence of absence is the update plug-in's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from dssmsg.frame import Frame
from dssmsg.graph.changes import Cause, Change, EdgeAdded, EdgeChanged, EdgeRemoved, Score
from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import NEAR, SEES, Edge, ObjectNode
from dssmsg.graph.relations import gap, relation
from dssmsg.graph.view import GraphView

CAUSE = "graph/edges"


@dataclass(frozen=True, slots=True)
class EdgeOptions:
    """In metres: how far a viewpoint sees, how close near things are, what is worth an update."""

    sees_within: float = 4.0
    near_within: float = 0.5
    refresh: float = 0.05


def edge_changes(
    graph: GraphView,
    observed_ids: Sequence[str],
    viewpoint_id: str | None,
    frame: Frame,
    cause: Cause | None = None,
    options: EdgeOptions = EdgeOptions(),
) -> tuple[Change, ...]:
    """Changes of `sees` and `near` edges after the objects of one key frame are in the graph.

    `observed_ids` are the objects observed in the frame (repeated or since removed ones are passed over),
    `viewpoint_id` the viewpoint it was taken from, if any. `sees` carries the distance from the camera to
    the object's box; `near` the distance of the boxes, the relation of source to target and the offset of
    their centres. Known edges change where the relation does or a length by more than `options.refresh`.
    """
    seen = sorted({i for i in observed_ids if i in graph.objects}, key=id_order)
    objects = [graph.objects[object_id] for object_id in seen]
    plugin = CAUSE if cause is None else cause.plugin
    changes: list[Change] = []
    if viewpoint_id is not None:
        for node in objects:
            changes += _sees(graph, viewpoint_id, node, frame, plugin, options)
    for a, b in combinations(objects, 2):
        changes += _near(graph, a, b, plugin, options)
    return tuple(changes)


def _sees(
    graph: GraphView, viewpoint_id: str, node: ObjectNode, frame: Frame, plugin: str, options: EdgeOptions
) -> Iterator[Change]:
    position = frame.position
    distance = gap(position, position, node.box_min, node.box_max)
    known = graph.edges.get((SEES, viewpoint_id, node.id))
    if distance > options.sees_within:
        return
    scores = (Score("distance_m", distance, options.sees_within),)
    attributes = {"distance": distance}
    if known is None:
        yield EdgeAdded(
            cause=Cause(plugin, "sees"),
            scores=scores,
            edge=SEES,
            source=viewpoint_id,
            target=node.id,
            attributes=attributes,
        )
    elif _outdated(known, attributes, options.refresh):
        yield _changed(known, attributes, Cause(plugin, "sees_refreshed"), scores)


def _near(
    graph: GraphView, a: ObjectNode, b: ObjectNode, plugin: str, options: EdgeOptions
) -> Iterator[Change]:
    distance = gap(a.box_min, a.box_max, b.box_min, b.box_max)
    known = graph.edges.get((NEAR, a.id, b.id))
    scores = (Score("distance_m", distance, options.near_within),)
    if distance >= options.near_within:
        if known is not None:
            yield EdgeRemoved(
                cause=Cause(plugin, "near_apart"), scores=scores, edge=NEAR, source=a.id, target=b.id
            )
        return
    attributes = {
        "distance": distance,
        "relation": relation(a, b),
        "offset": (b.center - a.center).tolist(),
    }
    if known is None:
        yield EdgeAdded(
            cause=Cause(plugin, "near"),
            scores=scores,
            edge=NEAR,
            source=a.id,
            target=b.id,
            attributes=attributes,
        )
    elif _outdated(known, attributes, options.refresh):
        yield _changed(known, attributes, Cause(plugin, "near_refreshed"), scores)


def _changed(edge: Edge, attributes: dict[str, Any], cause: Cause, scores: tuple[Score, ...]) -> EdgeChanged:
    return EdgeChanged(
        cause=cause,
        scores=scores,
        edge=edge.kind,
        source=edge.source,
        target=edge.target,
        attributes=attributes,
    )


def _outdated(edge: Edge, attributes: dict[str, Any], refresh: float) -> bool:
    """Whether a value changed by more than `refresh` metres, or a word at all."""
    return any(_differs(edge.attributes.get(name), value, refresh) for name, value in attributes.items())


def _differs(old: Any, new: Any, refresh: float) -> bool:
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        return math.dist(old, new) > refresh
    if isinstance(old, float | int) and isinstance(new, float | int):
        return abs(old - new) > refresh
    return bool(old != new)
