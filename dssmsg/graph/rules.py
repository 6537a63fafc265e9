"""What each kind of change does: a pure rule from (graph, change) to the rows to write.

A rule reads the graph, refuses what does not fit with `GraphError`, and returns an `Effect`;
`SceneGraph` alone writes it. Nothing here depends on the size of the graph, only on the subject's own
points and edges.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from dssmsg.graph import changes as c
from dssmsg.graph import fusion
from dssmsg.graph.checks import refusal
from dssmsg.graph.facts import Node, facts
from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import (
    APPEARED,
    BELIEVED,
    DISAPPEARED,
    MOVED,
    SEES,
    STATIC,
    TENTATIVE,
    Edge,
    HistoryNode,
    ObjectNode,
    Viewpoint,
    WaypointNode,
)
from dssmsg.graph.relations import inverse
from dssmsg.graph.view import GraphView

EdgeKey = tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class Effect:
    """Rows to remove (ids, edge keys), to insert and to replace, in this order, and the subject's facts."""

    drop: tuple[str | EdgeKey, ...] = ()
    new: tuple[Node | Edge, ...] = ()
    put: tuple[Node | Edge, ...] = ()
    before: Mapping[str, Any] = field(default_factory=dict)
    after: Mapping[str, Any] = field(default_factory=dict)


def effect_of(graph: GraphView, change: c.Change) -> Effect:
    """What a checked change does to the graph; GraphError if it does not fit."""
    return _RULES[type(change)](graph, change)


def _object_added(graph: GraphView, change: c.ObjectAdded) -> Effect:
    if not len(change.points):
        raise refusal(change, "at least one point", "none")
    _require_viewpoint(graph, change)
    points, colors = fusion.thinned(change.points, change.colors)
    box_min, box_max = fusion.bounds(points)
    node = ObjectNode(
        id=change.object_id,
        label=change.label,
        votes=MappingProxyType({change.label: change.score}),
        status=TENTATIVE,
        state=STATIC,
        dynamic_attribute=None,
        points=points,
        colors=colors,
        box_min=box_min,
        box_max=box_max,
        observations=1,
        frames=(change.frame,),
        viewpoints=() if change.viewpoint_id is None else (change.viewpoint_id,),
        first_seen=change.sim_time,
        last_seen=change.sim_time,
        text_feature=change.text_feature,
        image_feature=change.image_feature,
    )
    return Effect(new=(node,), after=facts(node))


def _object_merged(graph: GraphView, change: c.ObjectMerged) -> Effect:
    old = _object(graph, change, change.object_id)
    _require_viewpoint(graph, change)
    known = graph.known_voxels(old.id, change.points)
    points, colors = fusion.united(old.points, old.colors, change.points, change.colors, known)
    votes = fusion.counted(old.votes, {change.label: change.score})
    seen_from = () if change.viewpoint_id is None else (change.viewpoint_id,)
    node = replace(
        _with_cloud(old, points, colors),
        votes=votes,
        label=fusion.winner(votes),
        observations=old.observations + 1,
        frames=fusion.with_frame(old.frames, change.frame),
        viewpoints=fusion.appended(old.viewpoints, seen_from),
        last_seen=max(old.last_seen, change.sim_time),
        text_feature=_averaged(change, "text_feature", old, change.text_feature, 1),
        image_feature=_averaged(change, "image_feature", old, change.image_feature, 1),
    )
    return Effect(put=(node,), before=facts(old), after=facts(node))


def _objects_joined(graph: GraphView, change: c.ObjectsJoined) -> Effect:
    if change.object_id == change.absorbed_id:
        raise refusal(change, "two objects", f"{change.absorbed_id} twice")
    old, gone = _object(graph, change, change.object_id), _object(graph, change, change.absorbed_id)
    known = graph.known_voxels(old.id, gone.points)
    points, colors = fusion.united(old.points, old.colors, gone.points, gone.colors, known)
    votes = fusion.counted(old.votes, gone.votes)
    count = gone.observations
    node = replace(
        _with_cloud(old, points, colors),
        votes=votes,
        label=fusion.winner(votes),
        status=BELIEVED if BELIEVED in (old.status, gone.status) else TENTATIVE,
        dynamic_attribute=gone.dynamic_attribute if old.dynamic_attribute is None else old.dynamic_attribute,
        observations=old.observations + count,
        frames=tuple(sorted({*old.frames, *gone.frames})),
        viewpoints=fusion.appended(old.viewpoints, gone.viewpoints),
        first_seen=min(old.first_seen, gone.first_seen),
        last_seen=max(old.last_seen, gone.last_seen),
        text_feature=_averaged(change, "text_feature", old, gone.text_feature, count),
        image_feature=_averaged(change, "image_feature", old, gone.image_feature, count),
    )
    left = tuple(graph.edges_of(gone.id))
    moved = (_moved(edge, gone.id, old.id) for edge in left)
    fresh = tuple(
        e for e in moved if e.source != e.target and (e.kind, e.source, e.target) not in graph.edges
    )
    return Effect(
        drop=(*map(edge_key, left), gone.id),
        new=fresh,
        put=(node, *(replace(place, object_id=old.id) for place in graph.history_of(gone.id))),
        before={**facts(old), "absorbed": facts(gone)},
        after={**facts(node), "absorbed": None},
    )


def _object_changed(graph: GraphView, change: c.ObjectChanged) -> Effect:
    old = _object(graph, change, change.object_id)
    if not change.values:
        raise refusal(change, f"values for any of {', '.join(_CHANGEABLE)}", "none")
    for name, value in change.values.items():
        if name not in _CHANGEABLE:
            raise refusal(change, f"values for any of {', '.join(_CHANGEABLE)}", repr(name))
        fits, wanted = _CHANGEABLE[name]
        if not fits(value):
            raise refusal(change, f"{name} {wanted}", repr(value))
    node = replace(old, **change.values)
    return Effect(put=(node,), before=facts(old), after=facts(node))


def _object_replaced(graph: GraphView, change: c.ObjectReplaced) -> Effect:
    old = _object(graph, change, change.object_id)
    if not len(change.points):
        raise refusal(change, "at least one point", "none")
    node = _with_cloud(old, *fusion.thinned(change.points, change.colors))
    if change.history_id is None:
        return Effect(put=(node,), before=facts(old), after=facts(node))
    node = replace(node, last_seen=max(node.last_seen, change.sim_time))
    place = _former_place(graph, change, old, change.history_id)
    return Effect(new=(place,), put=(node,), before=facts(old), after=facts(node))


def _object_removed(graph: GraphView, change: c.ObjectRemoved) -> Effect:
    old = _object(graph, change, change.object_id)
    if change.successor_id == old.id:
        raise refusal(change, "another object as successor", old.id)
    if change.successor_id is not None:
        _object(graph, change, change.successor_id)
    places = () if change.history_id is None else (_former_place(graph, change, old, change.history_id),)
    return Effect(drop=(*map(edge_key, graph.edges_of(old.id)), old.id), new=places, before=facts(old))


def _waypoint_added(graph: GraphView, change: c.WaypointAdded) -> Effect:
    node = WaypointNode(change.waypoint_id, change.position)
    return Effect(new=(node,), after=facts(node))


def _waypoint_removed(graph: GraphView, change: c.WaypointRemoved) -> Effect:
    old = graph.waypoints.get(change.waypoint_id)
    if old is None:
        raise refusal(change, "a known waypoint", change.waypoint_id)
    edges = [edge for node_id in (*old.viewpoints, old.id) for edge in graph.edges_of(node_id)]
    return Effect(drop=(*map(edge_key, edges), *old.viewpoints, old.id), before=facts(old))


def _viewpoint_added(graph: GraphView, change: c.ViewpointAdded) -> Effect:
    waypoint = graph.waypoints.get(change.waypoint_id)
    if waypoint is None:
        raise refusal(change, "a known waypoint", change.waypoint_id)
    if id_order(change.viewpoint_id)[1] != id_order(waypoint.id)[1]:
        raise refusal(change, f"an id that carries the number of {waypoint.id}", change.viewpoint_id)
    if change.world_from_camera[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise refusal(change, "a pose whose last row is 0 0 0 1", str(change.world_from_camera[3].tolist()))
    node = Viewpoint(
        id=change.viewpoint_id,
        waypoint_id=waypoint.id,
        world_from_camera=change.world_from_camera,
        heading=change.heading,
        tilt=change.tilt,
        frame=change.frame,
        observations=1,
    )
    waypoint = replace(waypoint, viewpoints=(*waypoint.viewpoints, node.id))
    return Effect(new=(node,), put=(waypoint,), after=facts(node))


def _viewpoint_seen(graph: GraphView, change: c.ViewpointSeen) -> Effect:
    old = graph.viewpoints.get(change.viewpoint_id)
    if old is None:
        raise refusal(change, "a known viewpoint", change.viewpoint_id)
    node = replace(old, frame=change.frame, observations=old.observations + 1)
    return Effect(put=(node,), before=facts(old), after=facts(node))


def _edge_added(graph: GraphView, change: c.EdgeAdded) -> Effect:
    for end in change.subjects:
        if not any(end in table for table in (graph.objects, graph.waypoints, graph.viewpoints)):
            raise refusal(change, f"{end} to be in the graph", "an unknown id")
    edge = Edge(change.edge, change.source, change.target, change.attributes)
    return Effect(new=(edge,), after=facts(edge))


def _edge_changed(graph: GraphView, change: c.EdgeChanged) -> Effect:
    old = _edge(graph, change)
    edge = replace(old, attributes=_sorted({**old.attributes, **change.attributes}))
    return Effect(put=(edge,), before=facts(old), after=facts(edge))


def _edge_removed(graph: GraphView, change: c.EdgeRemoved) -> Effect:
    old = _edge(graph, change)
    return Effect(drop=(edge_key(old),), before=facts(old))


_RULES: Mapping[type[c.Change], Callable[[GraphView, Any], Effect]] = {
    c.ObjectAdded: _object_added,
    c.ObjectMerged: _object_merged,
    c.ObjectsJoined: _objects_joined,
    c.ObjectChanged: _object_changed,
    c.ObjectReplaced: _object_replaced,
    c.ObjectRemoved: _object_removed,
    c.WaypointAdded: _waypoint_added,
    c.WaypointRemoved: _waypoint_removed,
    c.ViewpointAdded: _viewpoint_added,
    c.ViewpointSeen: _viewpoint_seen,
    c.EdgeAdded: _edge_added,
    c.EdgeChanged: _edge_changed,
    c.EdgeRemoved: _edge_removed,
}


def edge_key(edge: Edge) -> EdgeKey:
    """The key of an edge in `GraphView.edges`."""
    return edge.kind, edge.source, edge.target


def _one_of(*words: str) -> tuple[Callable[[Any], bool], str]:
    return (lambda value: value in words), f"of {', '.join(words)}"


_CHANGEABLE: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "status": _one_of(TENTATIVE, BELIEVED),
    "state": _one_of(STATIC, APPEARED, DISAPPEARED, MOVED),
    "dynamic_attribute": (
        lambda value: value is None or (isinstance(value, int | float) and 0 <= value <= 1),
        "in 0..1 or null",
    ),
    "label": (lambda value: isinstance(value, str) and bool(value.strip()), "that is a non-empty text"),
}


def _object(graph: GraphView, change: c.Change, object_id: str) -> ObjectNode:
    node = graph.objects.get(object_id)
    if node is None:
        raise refusal(change, "a known object", object_id)
    return node


def _edge(graph: GraphView, change: c.EdgeChanged | c.EdgeRemoved) -> Edge:
    edge = graph.edges.get((change.edge, change.source, change.target))
    if edge is None:
        raise refusal(change, f"a known {change.edge} edge", "none between these two")
    return edge


def _require_viewpoint(graph: GraphView, change: c.ObjectAdded | c.ObjectMerged) -> None:
    if change.viewpoint_id is not None and change.viewpoint_id not in graph.viewpoints:
        raise refusal(change, "a known viewpoint, or none", change.viewpoint_id)


def _with_cloud(node: ObjectNode, points: Any, colors: Any) -> ObjectNode:
    if points is node.points:
        return node
    box_min, box_max = fusion.bounds(points)
    return replace(node, points=points, colors=colors, box_min=box_min, box_max=box_max)


def _averaged(change: c.Change, name: str, old: ObjectNode, other: Any, weight: int) -> Any:
    try:
        return fusion.averaged(getattr(old, name), old.observations, other, weight)
    except ValueError as error:
        raise refusal(change, f"{name} of the object's feature space", str(error)) from None


def _former_place(graph: GraphView, change: c.Change, node: ObjectNode, history_id: str) -> HistoryNode:
    """The place an object leaves: from first sight, or from when it left the place before, until now."""
    earlier = [place.to_time for place in graph.history_of(node.id)]
    return HistoryNode(
        id=history_id,
        object_id=node.id,
        label=node.label,
        box_min=node.box_min,
        box_max=node.box_max,
        from_time=max(earlier, default=node.first_seen),
        to_time=change.sim_time,
    )


def _moved(edge: Edge, gone: str, kept: str) -> Edge:
    """An edge of an object that is absorbed, at the object that stays."""
    source, target = (kept if end == gone else end for end in (edge.source, edge.target))
    if edge.kind == SEES or id_order(source) <= id_order(target):
        return replace(edge, source=source, target=target)
    attributes = dict(edge.attributes)  # a near edge is told from its source: the ends change places
    if "relation" in attributes:
        attributes["relation"] = inverse(attributes["relation"])
    if "offset" in attributes:
        attributes["offset"] = [-value for value in attributes["offset"]]
    return replace(edge, source=target, target=source, attributes=_sorted(attributes))


def _sorted(attributes: Mapping[str, Any]) -> Mapping[str, Any]:
    return MappingProxyType({key: attributes[key] for key in sorted(attributes)})
