"""Keeps the viewer's picture of the scene graph up to date, sending only what looks different.

What is drawn at once is small (a box an object); what is large (edges, graph views, surfaces) follows at
most once a second of sim time. Memory: one signature an entity, whatever the length of the run.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import Any

import rerun as rr

from dssmsg.graph.nodes import BELIEVED
from dssmsg.graph.view import GraphView
from dssmsg.recording import looks, palette, schema

SLOW_PERIOD = 1.0
"""Seconds of sim time between two looks at edges, graph views and surfaces."""

_GROWTH = 1.15  # surfaces are large: sent again once the map has grown by this, or something has moved


class SceneLog:
    """Draws a graph into a stream; one per recording, used by the writer's thread alone."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._signatures: dict[str, Hashable] = {}
        self._slow_due = 0.0
        self._surface_points = 0

    def log_static(self) -> None:
        """What never changes: axes, class names and colours."""
        self._send(schema.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._send(schema.WORLD, palette.world_annotations(), static=True)

    def update(
        self,
        graph: GraphView,
        frame: int,
        sim_time: float,
        *,
        viewpoint: str | None = None,
        everything: bool = False,
    ) -> bool:
        """Send what changed; True if something that may wait was left for a later call.

        What the `viewpoint` sees is drawn in full colour.
        """
        self._stream.set_time(schema.FRAME, sequence=max(frame, 0))
        self._stream.set_time(schema.SIM_TIME, duration=max(sim_time, 0.0))
        objects = _objects_signature(graph)
        self._draw(schema.OBJECTS, objects, lambda: looks.objects_look(graph))
        self._draw(schema.LABELS, objects, lambda: looks.labels_look(graph))
        places = tuple(graph.waypoints), tuple(graph.viewpoints)
        self._draw(schema.WAYPOINTS, places[0], lambda: looks.waypoints_look(graph))
        self._draw(schema.VIEWPOINTS, places[1], lambda: looks.viewpoints_look(graph))
        self._draw(schema.HISTORY, tuple(graph.history), lambda: looks.history_look(graph))
        now = looks.seen_now(graph, viewpoint)
        ends = tuple((start.tobytes(), end.tobytes()) for start, end in now)
        self._draw(schema.SEEN_NOW, ends, lambda: looks.seen_now_look(now))
        if not everything and sim_time < self._slow_due:
            return True
        self._slow_due = sim_time + SLOW_PERIOD
        self._update_slow(graph)
        return False

    def _update_slow(self, graph: GraphView) -> None:
        signature = _edges_signature(graph)
        if self._signatures.get(schema.EDGES) != signature:
            self._signatures[schema.EDGES] = signature
            for kind, strips in looks.edges_looks(graph).items():
                self._send(f"{schema.EDGES}/{kind}", strips)
            for name, parts in looks.graph_looks(graph).items():
                self._send(f"{schema.GRAPH}/{name}", *parts)
        believed = [node for node in graph.objects.values() if node.status == BELIEVED]
        points = sum(len(node.points) for node in believed)
        form = tuple(graph.history)
        grown = points > self._surface_points * _GROWTH
        if grown or self._signatures.get(schema.SURFACE) != form:
            self._signatures[schema.SURFACE] = form
            self._surface_points = points
            self._send(schema.SURFACE, looks.surface_look(graph))

    def _draw(self, path: str, signature: Hashable, look: Callable[[], Any]) -> None:
        if self._signatures.get(path) != signature:
            self._signatures[path] = signature
            self._send(path, look())

    def _send(self, path: str, *parts: Any, static: bool = False) -> None:
        self._stream.log(path, *parts, static=static, strict=True)


def _objects_signature(graph: GraphView) -> Hashable:
    return hash(
        tuple(
            (node.id, node.label, node.status, node.state, node.box_min.tobytes(), node.box_max.tobytes())
            for node in graph.objects.values()
        )
    )


def _edges_signature(graph: GraphView) -> Hashable:
    """Differs when an edge or a node comes or goes, or when a node has moved by a hand's breadth."""
    spots: Mapping[str, Any] = {
        node.id: (node.label, node.status, node.state, *(node.center * 10.0).round().tolist())
        for node in graph.objects.values()
    }
    edges = tuple((key, bool(edge.attributes.get("blocked"))) for key, edge in graph.edges.items())
    return hash((tuple(spots.items()), tuple(graph.waypoints), edges))
