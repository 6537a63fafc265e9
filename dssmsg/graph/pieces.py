"""Pieces of one thing that come or go together.

One mask for the body of a guitar, one for its neck: a frame that shows both keeps them apart in the map. But
what of one kind touches, and comes or goes with it, is one thing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from dssmsg.geometry import boxes_touch, grow_box
from dssmsg.graph.nodes import ObjectNode
from dssmsg.graph.view import GraphView

PIECE_GAP = 0.1
"""Metres between the boxes of two of a kind up to which they are one thing."""


def came_with(graph: GraphView, node: ObjectNode, come: Collection[str]) -> str | None:
    """The thing of its kind, among those that have `come` (ids), which a new object touches; or None."""
    for object_id in graph.objects_touching(*grow_box(node.box_min, node.box_max, PIECE_GAP)):
        if object_id in come and object_id != node.id and graph.objects[object_id].label == node.label:
            return object_id
    return None


def left_with(graph: GraphView, node: ObjectNode, gone: Iterable[ObjectNode]) -> str | None:
    """The thing of its kind that a vanished object touched and that has left itself, if there is one.

    It may be `gone`, or have been found elsewhere since: then its former place counts.
    """
    left = [(other.id, other.label, other.box_min, other.box_max) for other in gone]
    left += [
        (place.object_id, place.label, place.box_min, place.box_max)
        for place in graph.history.values()
        if place.to_time >= node.last_seen
    ]
    low, high = grow_box(node.box_min, node.box_max, PIECE_GAP)
    for object_id, label, box_min, box_max in left:
        if object_id != node.id and label == node.label and boxes_touch(low, high, box_min, box_max):
            return object_id
    return None
