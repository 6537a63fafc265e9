"""The scene graph as Rerun archetypes: pure functions from a graph view to what the viewer draws.

Whatever there is many of goes into one batch an entity: hundreds of entities slow the viewer down.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from dssmsg.frame import FloatArray
from dssmsg.graph.nodes import BELIEVED, NEAR, PATH, SEES, STATIC, Edge, ObjectNode
from dssmsg.graph.view import GraphView
from dssmsg.recording import palette

LABELS_UP_TO = 100
"""Above this many nodes, labels hide what they name."""

GRAPH_SCALE = 75.0
"""Graph-view units a metre: the graph is drawn as a floor plan seen from above."""

_LIFT = np.array([0.0, 0.0, 0.06], dtype=np.float32)
"""Metres by which waypoints and the ways between them are drawn above the floor, and the trail on it."""

_SPREAD_STEPS = 40

SURFACE_POINTS = 30_000
"""At most this many points show the surfaces of all objects together."""

_Points = NDArray[np.float32]


def objects_look(graph: GraphView) -> rr.Boxes3D:
    """A box an object, coloured by dynamic state, dim while tentative; names stand in `labels_look`."""
    nodes = list(graph.objects.values())
    centers, half_sizes = _boxes(nodes)
    return rr.Boxes3D(
        centers=centers,
        half_sizes=half_sizes,
        class_ids=[palette.object_class(node) for node in nodes],
        labels=[f"{node.id} {node.label}" for node in nodes],
        show_labels=False,
        radii=np.array([-1.2 if node.status == BELIEVED else -0.6 for node in nodes], dtype=np.float32),
        fill_mode=rr.components.FillMode.MajorWireframe,
    )


def labels_look(graph: GraphView) -> rr.Points3D:
    """A label above every believed object; where those are too many to be read, above what changed."""
    nodes = [node for node in graph.objects.values() if node.status == BELIEVED]
    if len(nodes) > LABELS_UP_TO:
        nodes = [node for node in nodes if node.state != STATIC]
    centers, half_sizes = _boxes(nodes)
    tops = centers + half_sizes * np.array([0.0, 0.0, 1.0], dtype=np.float32)
    return rr.Points3D(
        tops,
        class_ids=[palette.object_class(node) for node in nodes],
        labels=[node.label for node in nodes],
        show_labels=len(nodes) <= LABELS_UP_TO,
        radii=rr.Radius.ui_points(1.0),
    )


def history_look(graph: GraphView) -> rr.Boxes3D:
    """A box a former place, labelled with the object that was there."""
    places = list(graph.history.values())
    lows = np.array([place.box_min for place in places], dtype=np.float32).reshape(-1, 3)
    highs = np.array([place.box_max for place in places], dtype=np.float32).reshape(-1, 3)
    return rr.Boxes3D(
        centers=(lows + highs) / 2,
        half_sizes=(highs - lows) / 2,
        class_ids=[palette.OBJECT_CLASSES["history"][0]] * len(places),
        labels=[f"{place.label} (was {place.object_id})" for place in places],
        show_labels=len(places) <= LABELS_UP_TO,
        radii=rr.Radius.ui_points(1.0),
    )


def waypoints_look(graph: GraphView) -> rr.Points3D:
    """A dot a waypoint, on the floor."""
    nodes = list(graph.waypoints.values())
    return rr.Points3D(
        np.array([node.position for node in nodes], dtype=np.float32).reshape(-1, 3) + _LIFT,
        colors=palette.WAYPOINT_COLOUR,
        radii=rr.Radius.ui_points(7.0),
        labels=[node.id.removeprefix("waypoint-") for node in nodes],
        show_labels=len(nodes) <= LABELS_UP_TO,
    )


def viewpoints_look(graph: GraphView) -> rr.Arrows3D:
    """A short arrow a viewpoint, where the camera stood and looked."""
    poses = np.array([node.world_from_camera for node in graph.viewpoints.values()]).reshape(-1, 4, 4)
    return rr.Arrows3D(
        origins=poses[:, :3, 3],
        vectors=0.25 * poses[:, :3, 2],
        colors=palette.VIEWPOINT_COLOUR,
        radii=rr.Radius.ui_points(1.2),
        labels=list(graph.viewpoints),
        show_labels=False,
    )


def edges_looks(graph: GraphView) -> dict[str, rr.LineStrips3D]:
    """Line segments of every edge kind; blocked path edges are a kind of their own."""
    segments: dict[str, list[tuple[FloatArray, FloatArray]]] = {kind: [] for kind in palette.EDGE_COLOURS}
    names: dict[str, list[str]] = {kind: [] for kind in palette.EDGE_COLOURS}
    spots = places(graph)
    for edge in graph.edges.values():
        if edge.source not in spots or edge.target not in spots:
            continue
        ends = spots[edge.source], spots[edge.target]
        kind = "blocked" if edge.attributes.get("blocked") else edge.kind
        segments[kind].append(ends)
        names[kind].append(f"{edge.source} {edge.attributes.get('relation', edge.kind)} {edge.target}")
    widths = {PATH: 2.5, "blocked": 3.5, NEAR: 1.2, SEES: 0.3}
    return {
        kind: rr.LineStrips3D(
            np.array(strips, dtype=np.float32).reshape(-1, 2, 3)
            + (_LIFT if kind in (PATH, "blocked") else np.float32(0.0)),
            colors=palette.EDGE_COLOURS[kind],
            radii=rr.Radius.ui_points(widths[kind]),
            labels=names[kind],
            show_labels=False,
        )
        for kind, strips in segments.items()
    }


def seen_now(graph: GraphView, viewpoint_id: str | None) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """The ends (3,) of the `sees` edges of a viewpoint."""
    viewpoint = graph.viewpoints.get(viewpoint_id or "")
    if viewpoint is None:
        return ()
    spot = viewpoint.world_from_camera[:3, 3]
    edges = (edge for edge in graph.edges_of(viewpoint.id, SEES) if edge.source == viewpoint.id)
    ends = (place(graph, edge.target) for edge in edges)
    return tuple((spot, end) for end in ends if end is not None)


def seen_now_look(segments: Sequence[tuple[FloatArray, FloatArray]]) -> rr.LineStrips3D:
    """The `sees` edges of the viewpoint where the robot is, over the faint ones of all."""
    return rr.LineStrips3D(
        np.array(segments, dtype=np.float32).reshape(-1, 2, 3),
        colors=palette.SEEN_NOW_COLOUR,
        radii=rr.Radius.ui_points(0.8),
    )


def place(graph: GraphView, node_id: str) -> FloatArray | None:
    """Where a node of any kind is (3,), world metres; None if the graph has no such node."""
    if (thing := graph.objects.get(node_id)) is not None:
        return thing.center
    if (waypoint := graph.waypoints.get(node_id)) is not None:
        return waypoint.position
    if (viewpoint := graph.viewpoints.get(node_id)) is not None:
        return viewpoint.world_from_camera[:3, 3]
    return None


def places(graph: GraphView) -> dict[str, FloatArray]:
    """`place` of every node and viewpoint."""
    spots = {node.id: node.center for node in graph.objects.values()}
    spots |= {node.id: node.position for node in graph.waypoints.values()}
    return spots | {node.id: node.world_from_camera[:3, 3] for node in graph.viewpoints.values()}


def graph_looks(graph: GraphView) -> dict[str, list[rr.GraphNodes | rr.GraphEdges]]:
    """The graph views: `map` (without `sees`), `all`, and one an edge kind. Blocked ways are left out: their
    edges have been pruned.

    An edge finds only nodes of its own entity, so each has its own.
    """
    edges: dict[str, dict[tuple[str, str], Edge]] = {PATH: {}, SEES: {}, NEAR: {}}
    for edge in graph.edges.values():
        if edge.attributes.get("blocked"):
            continue
        source = edge.source
        if edge.kind == SEES:  # drawn from the waypoint: its viewpoints stand in one place
            viewpoint = graph.viewpoints.get(source)
            if viewpoint is None:
                continue
            source = viewpoint.waypoint_id
        edges[edge.kind].setdefault((source, edge.target), edge)
    believed = [node for node in graph.objects.values() if node.status == BELIEVED]
    shown = {node.id for node in believed} | set(graph.waypoints)
    kept = {
        kind: [pair for pair in pairs if pair[0] in shown and pair[1] in shown]
        for kind, pairs in edges.items()
    }
    waypoints = list(graph.waypoints)
    things = [node.id for node in believed]
    plan = _FloorPlan(graph, waypoints + things)
    return {
        "map": plan.look(waypoints + things, kept[PATH] + kept[NEAR]),
        "all": plan.look(waypoints + things, kept[PATH] + kept[NEAR] + kept[SEES]),
        PATH: plan.look(waypoints, kept[PATH]),
        SEES: plan.look(waypoints + things, kept[SEES]),
        NEAR: plan.look(things, kept[NEAR]),
    }


class _FloorPlan:
    """Where nodes stand in the graph views, and how they look: in all views the same, if all are labelled."""

    def __init__(self, graph: GraphView, ids: Sequence[str]) -> None:
        by_class = {number: colour for number, _, colour in palette.OBJECT_CLASSES.values()}
        self._rows = {node_id: row for row, node_id in enumerate(ids)}
        self._labels: list[str] = []
        self._colours: list[palette.Colour] = []
        positions = np.zeros((len(ids), 2), dtype=np.float32)
        for row, node_id in enumerate(ids):
            spot = place(graph, node_id)
            assert spot is not None  # ids come from the graph itself
            positions[row] = spot[0] * GRAPH_SCALE, -spot[1] * GRAPH_SCALE  # the view's y axis points down
            thing = graph.objects.get(node_id)
            self._labels.append(node_id.replace("waypoint-", "w") if thing is None else thing.label)
            self._colours.append(
                palette.WAYPOINT_COLOUR if thing is None else by_class[palette.object_class(thing)]
            )
        self._labelled = len(ids) <= LABELS_UP_TO
        self._positions = self._spread(positions, range(len(ids))) if self._labelled else positions

    def look(
        self, ids: Sequence[str], pairs: Sequence[tuple[str, str]]
    ) -> list[rr.GraphNodes | rr.GraphEdges]:
        """Some of the nodes, and edges between them; labelled where there are few enough."""
        rows = [self._rows[node_id] for node_id in ids]
        positions = self._positions[rows]
        if not self._labelled and len(ids) <= LABELS_UP_TO:
            positions = self._spread(positions, rows)
        nodes = rr.GraphNodes(
            ids,
            positions=positions,
            labels=[self._labels[row] for row in rows],
            colors=[self._colours[row] for row in rows],
            show_labels=len(ids) <= LABELS_UP_TO,
        )
        ends = np.array(pairs, dtype=np.str_).reshape(-1, 2)  # as an array: pair by pair is slow
        return [nodes, rr.GraphEdges(ends, graph_type="undirected")]

    def _spread(self, positions: _Points, rows: Sequence[int]) -> _Points:
        return spread_labels(positions, [len(self._labels[row]) for row in rows])


def spread_labels(positions: _Points, lengths: Sequence[int]) -> _Points:
    """Positions (N, 2) moved apart just so far that labels of these lengths (characters) do not overlap.

    Deterministic, and small moves where there is room: the floor plan stays recognisable.
    """
    return _spread(positions.astype(np.float32).tobytes(), tuple(lengths)).copy()


@lru_cache(maxsize=8)  # edges come and go more often than nodes move
def _spread(points: bytes, lengths: tuple[int, ...]) -> _Points:
    x, y = np.frombuffer(points, np.float32).reshape(-1, 2).astype(np.float64).T.copy()
    width = 3.8 * np.array(lengths, dtype=np.float64) + 12.0
    reach_x = width[:, None] + width
    np.fill_diagonal(reach_x, -1.0)  # nobody is in their own way
    reach_y = 30.0
    # Where two stand in one spot, their order says who goes which way.
    order = np.arange(len(x))
    tie = np.sign(order[:, None] - order)
    for _ in range(_SPREAD_STEPS):
        gap_x, gap_y = x[:, None] - x, y[:, None] - y
        overlap_x, overlap_y = reach_x - np.abs(gap_x), reach_y - np.abs(gap_y)
        hit = (overlap_x > 0) & (overlap_y > 0)
        if not hit.any():
            break
        # Along the axis where less is needed; each of the two goes a part of the way.
        sideways = hit & (overlap_x < overlap_y)
        upright = hit & ~sideways
        x += 0.3 * np.where(sideways, overlap_x * np.where(gap_x == 0, tie, np.sign(gap_x)), 0.0).sum(axis=1)
        y += 0.3 * np.where(upright, overlap_y * np.where(gap_y == 0, tie, np.sign(gap_y)), 0.0).sum(axis=1)
    return np.stack([x, y], axis=1).astype(np.float32)


def surface_look(graph: GraphView) -> rr.Points3D:
    """The objects' surfaces in their own colours, thinned evenly to `SURFACE_POINTS`."""
    nodes = [node for node in graph.objects.values() if node.status == BELIEVED and len(node.points)]
    total = sum(len(node.points) for node in nodes)
    stride = max(1, -(-total // SURFACE_POINTS))
    if not nodes:
        return rr.Points3D(np.zeros((0, 3), dtype=np.float32))
    return rr.Points3D(
        np.concatenate([node.points[::stride] for node in nodes]),
        colors=np.concatenate([node.colors[::stride] for node in nodes]),
        radii=0.018,
    )


def _boxes(nodes: Iterable[ObjectNode]) -> tuple[_Points, _Points]:
    lows: list[FloatArray] = []
    highs: list[FloatArray] = []
    for node in nodes:
        lows.append(node.box_min)
        highs.append(node.box_max)
    low: _Points = np.array(lows, dtype=np.float32).reshape(-1, 3)
    high: _Points = np.array(highs, dtype=np.float32).reshape(-1, 3)
    half = np.float32(0.5)
    return (low + high) * half, (high - low) * half
