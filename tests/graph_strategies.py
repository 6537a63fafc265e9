"""Hypothesis strategies for the scene graph: sequences of changes that a graph accepts.

`batches()` draws the changes of some frames. Each is drawn against the graph as the earlier ones left it, so
removed things stay removed and edges have ends; a `SceneGraph` applies them all.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hypothesis import strategies as st

from dssmsg.graph import changes as c
from dssmsg.graph.ids import IdAllocator, id_order
from dssmsg.graph.nodes import NEAR, PATH, SEES
from dssmsg.graph.scene_graph import SceneGraph

CAUSE = c.Cause("test/strategy", "drawn")
LABELS = ("chair", "table", "cup", "sofa")
Draw = Callable[[st.SearchStrategy], object]


def cloud(
    seed: int, count: int, center: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> dict[str, np.ndarray]:
    """`points` (N, 3) float32 in a 0.4 m box around a centre, and `colors` (N, 3), from a seed."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.2, 0.2, (count, 3)) + np.asarray(center)
    return {"points": points.astype(np.float32), "colors": rng.integers(0, 256, (count, 3), dtype=np.uint8)}


def unit(seed: int, length: int = 8) -> np.ndarray:
    """A unit vector (D,) float32 from a seed."""
    vector = np.random.default_rng(seed).normal(size=length)
    return (vector / np.linalg.norm(vector)).astype(np.float32)


def pose(x: float, y: float, z: float = 0.88) -> np.ndarray:
    """A camera pose (4, 4) at a position, looking along world x."""
    matrix = np.eye(4)
    matrix[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    matrix[:3, 3] = x, y, z
    return matrix


@st.composite
def batches(draw: Draw, max_frames: int = 6, max_changes: int = 5) -> list[list[c.Change]]:
    """The changes of some frames, unstamped, in an order that a fresh graph accepts."""
    graph, ids = SceneGraph(), IdAllocator()
    frames = []
    for frame in range(draw(st.integers(1, max_frames))):
        batch = []
        for _ in range(draw(st.integers(1, max_changes))):
            change = draw(st.sampled_from(_possible(graph)))(draw, graph, ids)
            graph.apply_all([change], frame, frame / 5)
            batch.append(change)
        frames.append(batch)
    return frames


def _possible(graph: SceneGraph) -> list[Callable]:
    makers = [_object_added, _waypoint_added]
    if graph.objects:
        makers += [_object_merged, _object_merged, _object_changed, _object_replaced, _object_removed]
    if len(graph.objects) > 1:
        makers.append(_objects_joined)
    if graph.waypoints:
        makers += [_viewpoint_added, _waypoint_removed]
    if graph.viewpoints:
        makers.append(_viewpoint_seen)
    if _free_edges(graph):
        makers += [_edge_added] * 3
    if graph.edges:
        makers += [_edge_changed, _edge_removed]
    return makers


def _observation(draw: Draw, graph: SceneGraph, least: int) -> dict:
    seed = draw(st.integers(0, 5))
    return {
        "cause": CAUSE,
        "scores": (c.Score("s", draw(st.floats(-2, 2)), draw(st.sampled_from([None, 1.1]))),),
        "label": draw(st.sampled_from(LABELS)),
        "score": draw(st.floats(0, 1)),
        "viewpoint_id": draw(st.sampled_from([None, *graph.viewpoints])),
        "range_m": 2.0,
        "text_feature": draw(st.sampled_from([None, unit(seed)])),
        "image_feature": draw(st.sampled_from([None, unit(seed + 10, 4)])),
        **cloud(seed, draw(st.integers(least, 12)), (seed % 3, 0.0, 0.5)),
    }


def _object_added(draw: Draw, graph: SceneGraph, ids: IdAllocator) -> c.Change:
    return c.ObjectAdded(object_id=ids.new("object"), **_observation(draw, graph, 1))


def _object_merged(draw: Draw, graph: SceneGraph, _ids: IdAllocator) -> c.Change:
    return c.ObjectMerged(
        object_id=draw(st.sampled_from(list(graph.objects))), **_observation(draw, graph, 0)
    )


def _objects_joined(draw: Draw, graph: SceneGraph, _ids: IdAllocator) -> c.Change:
    kept, absorbed = draw(st.permutations(list(graph.objects)))[:2]
    return c.ObjectsJoined(cause=CAUSE, object_id=kept, absorbed_id=absorbed)


def _object_changed(draw: Draw, graph: SceneGraph, _ids: IdAllocator) -> c.Change:
    possible = {
        "status": st.sampled_from(["tentative", "believed"]),
        "state": st.sampled_from(["static", "appeared", "disappeared", "moved"]),
        "dynamic_attribute": st.none() | st.floats(0, 1),
        "label": st.sampled_from(LABELS),
    }
    names = draw(st.lists(st.sampled_from(sorted(possible)), min_size=1, unique=True))
    values = {name: draw(possible[name]) for name in names}
    return c.ObjectChanged(cause=CAUSE, object_id=draw(st.sampled_from(list(graph.objects))), values=values)


def _object_replaced(draw: Draw, graph: SceneGraph, ids: IdAllocator) -> c.Change:
    return c.ObjectReplaced(
        cause=CAUSE,
        object_id=draw(st.sampled_from(list(graph.objects))),
        history_id=ids.new("history") if draw(st.booleans()) else None,
        **cloud(draw(st.integers(0, 5)), 6, (3.0, 1.0, 0.5)),
    )


def _object_removed(draw: Draw, graph: SceneGraph, ids: IdAllocator) -> c.Change:
    gone = draw(st.sampled_from(list(graph.objects)))
    return c.ObjectRemoved(
        cause=CAUSE,
        object_id=gone,
        history_id=ids.new("history") if draw(st.booleans()) else None,
        successor_id=draw(st.sampled_from([None, *(i for i in graph.objects if i != gone)])),
    )


def _waypoint_added(draw: Draw, _graph: SceneGraph, ids: IdAllocator) -> c.Change:
    position = np.array([draw(st.integers(-5, 5)) / 2, draw(st.integers(-5, 5)) / 2, 0.0])
    return c.WaypointAdded(cause=CAUSE, waypoint_id=ids.new("waypoint"), position=position)


def _waypoint_removed(draw: Draw, graph: SceneGraph, _ids: IdAllocator) -> c.Change:
    return c.WaypointRemoved(cause=CAUSE, waypoint_id=draw(st.sampled_from(list(graph.waypoints))))


def _viewpoint_added(draw: Draw, graph: SceneGraph, ids: IdAllocator) -> c.Change:
    waypoint = draw(st.sampled_from(list(graph.waypoints)))
    x, y, _ = graph.waypoints[waypoint].position
    return c.ViewpointAdded(
        cause=CAUSE,
        viewpoint_id=ids.new_viewpoint(waypoint),
        waypoint_id=waypoint,
        world_from_camera=pose(x, y),
        heading=draw(st.floats(-3, 3)),
        tilt=-0.3,
    )


def _viewpoint_seen(draw: Draw, graph: SceneGraph, _ids: IdAllocator) -> c.Change:
    return c.ViewpointSeen(cause=CAUSE, viewpoint_id=draw(st.sampled_from(list(graph.viewpoints))))


def _free_edges(graph: SceneGraph) -> list[tuple[str, str, str]]:
    objects, waypoints = sorted(graph.objects, key=id_order), sorted(graph.waypoints, key=id_order)
    keys = [(NEAR, a, b) for i, a in enumerate(objects) for b in objects[i + 1 :]]
    keys += [(PATH, a, b) for i, a in enumerate(waypoints) for b in waypoints[i + 1 :]]
    keys += [(SEES, v, o) for v in graph.viewpoints for o in objects]
    return [key for key in keys if key not in graph.edges]


def _edge_added(draw: Draw, graph: SceneGraph, _ids: IdAllocator) -> c.Change:
    edge, source, target = draw(st.sampled_from(_free_edges(graph)))
    attributes = {
        NEAR: {
            "distance": 0.25,
            "relation": draw(st.sampled_from(["on", "next to"])),
            "offset": [0.1, 0.0, 0.2],
        },
        PATH: {"length": draw(st.floats(0, 3)), "verified": "driven", "blocked": False},
        SEES: {"distance": draw(st.floats(0, 4))},
    }[edge]
    return c.EdgeAdded(cause=CAUSE, edge=edge, source=source, target=target, attributes=attributes)


def _edge_changed(draw: Draw, graph: SceneGraph, _ids: IdAllocator) -> c.Change:
    edge, source, target = draw(st.sampled_from(list(graph.edges)))
    attributes = {"blocked": draw(st.booleans())} if edge == PATH else {"distance": draw(st.floats(0, 4))}
    return c.EdgeChanged(cause=CAUSE, edge=edge, source=source, target=target, attributes=attributes)


def _edge_removed(draw: Draw, graph: SceneGraph, _ids: IdAllocator) -> c.Change:
    edge, source, target = draw(st.sampled_from(list(graph.edges)))
    return c.EdgeRemoved(cause=CAUSE, edge=edge, source=source, target=target)
