"""Local subgraphs: what each viewpoint sees and how that hangs together (paper III-C, ALGORITHM D).

A `Thing` is what a target node may match: an object where it is now, a vanished one at its last place, or a
former place of a moved one. The first kind is joined to viewpoints by `sees` edges and to others by `near`
edges; the other two have lost theirs, so the same facts are told from the places they had.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import ByteArray, Camera, Float32Array, FloatArray
from dssmsg.geometry import invert_rigid, project, transform_points
from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import BELIEVED, DISAPPEARED, NEAR, SEES, HistoryNode, ObjectNode, Viewpoint
from dssmsg.graph.relations import gap
from dssmsg.graph.view import GraphView

NOW, LAST, FORMER = "now", "last", "former"
"""Where a thing is told of: where it is, where it was last, where it stood before it was moved."""
NEAR_M, SEES_M = 0.5, 4.0
_FACING = 0.7
"""Least cosine between a camera's axis and the way to a place for the place to count as looked at."""
_VOXEL_M = 0.025
_INCIDENCE = 0.5
"""A surface is seen at a slant, and partly from behind: about half of what its voxels would cover."""


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """What a target node may match. `id` is object-N, or history-N for a former place; boxes (3,) metres.

    points (N, 3) and colors (N, 3) are the object's, none for a former place; `viewpoints` are those that see
    it, or saw it there; `feature` is the object's text feature (D,), if it has one.
    """

    id: str
    label: str
    when: str
    box_min: FloatArray
    box_max: FloatArray
    points: Float32Array
    colors: ByteArray
    viewpoints: frozenset[str]
    feature: Float32Array | None = None

    @property
    def center(self) -> FloatArray:
        """Centre (3,) of the box."""
        centre: FloatArray = (self.box_min + self.box_max) / 2
        return centre


@dataclass(frozen=True, slots=True, eq=False)
class Subgraph:
    """What one viewpoint sees: indices (N,) of things, and their degrees (N,) inside this subgraph."""

    viewpoint_id: str
    things: NDArray[np.int64]
    degrees: NDArray[np.int64]


def things_of(
    graph: GraphView, *, tentative: bool = False, vanished: bool = True, former: bool = False
) -> list[Thing]:
    """Everything that a query may be answered with, in order of ids; former places last."""
    found = []
    for object_id in sorted(graph.objects, key=id_order):
        node = graph.objects[object_id]
        gone = node.state == DISAPPEARED
        if (node.status == BELIEVED or tentative) and (vanished or not gone):
            found.append(_thing(graph, node, gone=gone))
    if former:
        found += [_former(graph, graph.history[one]) for one in sorted(graph.history, key=id_order)]
    return found


def local_subgraphs(graph: GraphView, things: Sequence[Thing]) -> Iterator[Subgraph]:
    """The subgraph of every viewpoint that sees a thing, in order of viewpoint ids."""
    seen: defaultdict[str, list[int]] = defaultdict(list)
    for index, thing in enumerate(things):
        for viewpoint in thing.viewpoints:
            seen[viewpoint].append(index)
    joined = _joined(graph, things)
    for viewpoint in sorted(seen, key=id_order):
        indices = np.array(sorted(seen[viewpoint]))
        yield Subgraph(viewpoint, indices, joined[np.ix_(indices, indices)].sum(axis=1))


def features_of(things: Sequence[Thing], of_labels: Float32Array) -> FloatArray:
    """(N, D) float64 text features: a thing's own, or its label's (N, D) where it has none of that space."""
    rows = np.array(of_labels, dtype=np.float64)
    for row, thing in enumerate(things):
        if thing.feature is not None and thing.feature.shape == rows[row].shape:
            rows[row] = thing.feature
    return rows


def pixels_of(thing: Thing, viewpoint: Viewpoint, camera: Camera) -> float:
    """About how many pixels a thing covers from a viewpoint; what may stand in between is not asked.

    Told from its voxels; for a thing without points from the nine points of its box, as one surface.
    """
    points = thing.points if len(thing.points) else _box_points(thing)
    inside = transform_points(invert_rigid(viewpoint.world_from_camera), points)
    inside = inside[inside[:, 2] > _VOXEL_M]
    if not len(inside):
        return 0.0
    pixels, depth = project(inside, camera)
    shown = (pixels >= 0).all(axis=1) & (pixels < [camera.width, camera.height]).all(axis=1)
    if len(thing.points):
        areas = (_VOXEL_M / depth[shown]) ** 2
    else:
        extent = np.sort(thing.box_max - thing.box_min)[1:]
        areas = float(np.prod(extent)) / len(points) / depth[shown] ** 2
    return float(_INCIDENCE * camera.fx * camera.fy * areas.sum())


def _thing(graph: GraphView, node: ObjectNode, *, gone: bool) -> Thing:
    if gone:
        views = list(_looking_at(graph, node.box_min, node.box_max, node.viewpoints))
    else:
        views = [e.source if e.target == node.id else e.target for e in graph.edges_of(node.id, SEES)]
    return Thing(
        node.id, node.label, LAST if gone else NOW, node.box_min, node.box_max,
        node.points, node.colors, frozenset(views), node.text_feature,
    )  # fmt: skip


def _former(graph: GraphView, place: HistoryNode) -> Thing:
    owner = graph.objects.get(place.object_id)
    known = owner.viewpoints if owner is not None else tuple(graph.viewpoints)
    views = _looking_at(graph, place.box_min, place.box_max, known)
    return Thing(
        place.id, place.label, FORMER, place.box_min, place.box_max,
        np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), frozenset(views),
        None if owner is None else owner.text_feature,
    )  # fmt: skip


def _looking_at(graph: GraphView, low: FloatArray, high: FloatArray, known: Sequence[str]) -> Iterator[str]:
    """Those of the viewpoints that look at a box from within 4 m."""
    for name in known:
        viewpoint = graph.viewpoints.get(name)
        if viewpoint is None:
            continue
        eye = viewpoint.world_from_camera[:3, 3]
        way = (low + high) / 2 - eye
        facing = float(way @ viewpoint.world_from_camera[:3, 2])
        if gap(eye, eye, low, high) <= SEES_M and facing >= _FACING * float(np.linalg.norm(way)):
            yield name


def _joined(graph: GraphView, things: Sequence[Thing]) -> NDArray[np.int64]:
    """(N, N) 1 where two things are near: by their edge, or by their boxes where one of them has none."""
    joined = np.zeros((len(things), len(things)), np.int64)
    index = {thing.id: place for place, thing in enumerate(things) if thing.when == NOW}
    for place in index.values():
        for edge in graph.edges_of(things[place].id, NEAR):
            ends = index.get(edge.source), index.get(edge.target)
            if None not in ends:
                joined[ends] = joined[ends[::-1]] = 1
    for place, thing in enumerate(things):
        if thing.when == NOW:
            continue
        for other, beside in enumerate(things):
            close = gap(thing.box_min, thing.box_max, beside.box_min, beside.box_max) < NEAR_M
            if other != place and close and thing.viewpoints & beside.viewpoints:
                joined[place, other] = joined[other, place] = 1
    return joined


def _box_points(thing: Thing) -> FloatArray:
    """(9, 3): the corners of the box and its centre."""
    corners = np.array(np.meshgrid(*zip(thing.box_min, thing.box_max, strict=True))).reshape(3, -1).T
    return np.vstack([corners, thing.center])
