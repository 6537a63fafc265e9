"""The scene graph G = (N_O, N_W, E_O, E_W, E_WO) of the paper (III-A), event-sourced.

`apply`, `apply_all` and `follow` are the only writers. Nodes and edges are immutable values; indexes
(adjacency, boxes, positions, KD-trees, voxels) follow the tables and are never part of the state. A change
costs what its subject costs, however large the graph is. Folding the changes that `apply` returned gives the
same graph again, exactly (`dssmsg.graph.compare.same`).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from dssmsg.frame import Float32Array, FloatArray, MaskArray
from dssmsg.graph.changes import Change
from dssmsg.graph.checks import checked, refusal
from dssmsg.graph.facts import Node, facts
from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import Edge, HistoryNode, ObjectNode, Viewpoint, WaypointNode
from dssmsg.graph.rules import EdgeKey, Effect, edge_key, effect_of
from dssmsg.graph.spatial import BoxIndex, PointIndex
from dssmsg.graph.tables import Table
from dssmsg.graph.voxels import KeyArray, contained, voxel_keys
from dssmsg.neighbours import quick_tree

if TYPE_CHECKING:
    from scipy.spatial import KDTree  # takes a quarter of a second; who only reads recordings needs none


class SceneGraph:
    """The live graph; a `dssmsg.graph.view.GraphView` with its writers.

    Not thread-safe: one thread owns it.
    """

    def __init__(self) -> None:
        self._objects: Table[str, ObjectNode] = Table(self._index_object)
        self._history: Table[str, HistoryNode] = Table(self._index_history)
        self._waypoints: Table[str, WaypointNode] = Table()
        self._viewpoints: Table[str, Viewpoint] = Table(self._index_viewpoint)
        self._edges: Table[EdgeKey, Edge] = Table(self._index_edge)
        self._retired: Table[str, int] = Table()
        self._updates = 0
        self._tables: Mapping[str, Table[str, Any]] = {
            "object": self._objects,
            "history": self._history,
            "waypoint": self._waypoints,
            "viewpoint": self._viewpoints,
        }
        self._adjacent: defaultdict[str, set[EdgeKey]] = defaultdict(set)
        self._in_order: dict[str, list[EdgeKey]] = {}
        """Adjacent edges in order of creation, until another one comes or goes."""
        self._places: defaultdict[str, set[str]] = defaultdict(set)
        self._boxes = BoxIndex()
        self._cameras = PointIndex()
        # A cache entry holds the very array it was made from and is stale once the object has another one.
        self._trees: dict[str, tuple[Float32Array, KDTree]] = {}
        self._voxels: dict[str, tuple[Float32Array, KeyArray]] = {}

    @classmethod
    def fold(cls, changes: Iterable[Change]) -> SceneGraph:
        """The graph that recorded changes lead to.

        Raises GraphError where a change does not fit, or does not have the effect that was recorded.
        """
        graph = cls()
        for change in changes:
            graph.apply(change)
        return graph

    @classmethod
    def restored(cls, rows: Iterable[Node | Edge], retired: Mapping[str, int], updates: int) -> SceneGraph:
        """A graph from stored rows, each table's in order of creation (`dssmsg.graph.codec` reads them)."""
        graph = cls()
        for row in rows:
            graph._put(row)
        for node_id, update in retired.items():
            graph._retired.put(node_id, update)
        graph._updates = updates
        graph._keep()
        return graph

    # -- writing ------------------------------------------------------------------------------------

    def apply(self, change: Change) -> Change:
        """Carry out one change; returns it stamped with `update`, `before` and `after`.

        `update` counts from 1, so that it equals `updates` right after. A change that is already stamped
        (read from a recording) must have its number and its effect. Raises GraphError, graph unchanged.
        """
        return self._apply_batch([checked(change)])[0]

    def follow(self, changes: Sequence[Change]) -> None:
        """Carry out changes that another graph has stamped: their form is not looked at again."""
        self._apply_batch(changes)

    def apply_all(self, changes: Sequence[Change], frame: int, sim_time: float) -> tuple[Change, ...]:
        """Carry out the changes of one frame, stamped with it: all, or none and GraphError."""
        return self._apply_batch(
            [checked(replace(change, frame=frame, sim_time=sim_time)) for change in changes]
        )

    def _apply_batch(self, changes: Sequence[Change]) -> tuple[Change, ...]:
        updates = self._updates
        try:
            stamped = tuple([self._apply_one(change) for change in changes])
        except BaseException:
            self._updates = updates
            self._take_back()
            raise
        self._keep()
        return stamped

    def _apply_one(self, change: Change) -> Change:
        effect = effect_of(self, change)
        stamped = self._stamped(change, effect)
        self._write(change, effect)
        self._updates += 1
        return stamped

    def _stamped(self, change: Change, effect: Effect) -> Change:
        for name, value in change.before.items():
            if name not in effect.before:
                known = ", ".join(effect.before) or "none"
                raise refusal(change, f"before to name facts of the subject ({known})", repr(name))
            if effect.before[name] != value:
                raise refusal(change, f"{name} {value!r} before", f"{effect.before[name]!r}")
        update = self._updates + 1
        before, after = _differing(effect.before, effect.after)
        if change.update >= 0:
            if change.update != update:
                raise refusal(change, f"update {update}", str(change.update))
            if change.after != after:
                raise refusal(change, f"the recorded effect {dict(change.after)}", str(after))
        return replace(change, update=update, before=MappingProxyType(before), after=MappingProxyType(after))

    def _write(self, change: Change, effect: Effect) -> None:
        for key in effect.drop:
            if isinstance(key, tuple):
                self._edges.drop(key)
            else:
                self._tables[id_order(key)[0]].drop(key)
                self._retired.put(key, self._updates + 1)
        for row in effect.new:
            if isinstance(row, Edge):
                if edge_key(row) in self._edges.rows:
                    raise refusal(change, f"no such {row.kind} edge yet", "one in the graph")
            elif row.id in self._tables[id_order(row.id)[0]].rows or row.id in self._retired.rows:
                raise refusal(change, "an id that was never used", row.id)
            self._put(row)
        for row in effect.put:
            self._put(row)

    def _put(self, row: Node | Edge) -> None:
        if isinstance(row, Edge):
            self._edges.put(edge_key(row), row)
        else:
            self._tables[id_order(row.id)[0]].put(row.id, row)

    def _all_tables(self) -> Iterator[Table[Any, Any]]:
        yield from self._tables.values()
        yield self._edges
        yield self._retired

    def _keep(self) -> None:
        for table in self._all_tables():
            table.keep()

    def _take_back(self) -> None:
        for table in self._all_tables():
            table.take_back()

    # -- reading ------------------------------------------------------------------------------------

    @property
    def objects(self) -> Mapping[str, ObjectNode]:
        """Objects by id, tentative ones included, in order of creation."""
        return self._objects.rows

    @property
    def history(self) -> Mapping[str, HistoryNode]:
        """Former places by id."""
        return self._history.rows

    @property
    def waypoints(self) -> Mapping[str, WaypointNode]:
        """Waypoints by id."""
        return self._waypoints.rows

    @property
    def viewpoints(self) -> Mapping[str, Viewpoint]:
        """Viewpoints by id."""
        return self._viewpoints.rows

    @property
    def edges(self) -> Mapping[EdgeKey, Edge]:
        """Edges by (kind, source, target)."""
        return self._edges.rows

    @property
    def retired(self) -> Mapping[str, int]:
        """Ids that left the graph and are never used again, with the update they left in."""
        return self._retired.rows

    @property
    def updates(self) -> int:
        """How many changes have been applied."""
        return self._updates

    def edges_of(self, node_id: str, kind: str | None = None) -> Iterator[Edge]:
        """Edges that touch a node (or a viewpoint), in order of creation."""
        keys = self._in_order.get(node_id)
        if keys is None:
            keys = sorted(self._adjacent.get(node_id, ()), key=self._edges.rank)
            if keys:
                self._in_order[node_id] = keys
        return (self._edges.rows[key] for key in keys if kind is None or key[0] == kind)

    def history_of(self, object_id: str) -> Iterator[HistoryNode]:
        """Former places of an object, a removed one included, in order of creation."""
        places = sorted(self._places.get(object_id, ()), key=self._history.rank)
        return (self._history.rows[place] for place in places)

    def objects_touching(self, box_min: FloatArray, box_max: FloatArray) -> list[str]:
        """Ids of the objects whose box touches a box, by a spatial index, in order of their numbers."""
        return sorted(self._boxes.touching(box_min, box_max), key=id_order)

    def viewpoints_near(self, position: FloatArray, radius: float) -> list[str]:
        """Ids of viewpoints whose camera is within `radius` metres of a position (3,), by their numbers."""
        return sorted(self._cameras.within(position, radius), key=id_order)

    def tree(self, object_id: str) -> KDTree:
        """The object's points as a KD-tree, cached until its points change. Raises KeyError if unknown."""
        points = self._objects.rows[object_id].points
        cached = self._trees.get(object_id)
        if cached is None or cached[0] is not points:
            cached = self._trees[object_id] = (points, quick_tree(points))
        return cached[1]

    def known_voxels(self, object_id: str, points: Float32Array) -> MaskArray:
        """(N,) bool: which of the points (N, 3) lie in a voxel that the object already has.

        Raises KeyError for an unknown object, ValueError for points that are not finite.
        """
        cloud = self._objects.rows[object_id].points
        cached = self._voxels.get(object_id)
        if cached is None or cached[0] is not cloud:
            cached = self._voxels[object_id] = (cloud, np.sort(voxel_keys(cloud)))
        return contained(voxel_keys(points), cached[1])

    def facts(self, node_id: str) -> dict[str, Any]:
        """The JSON facts of a node, as they stand in `before` and `after`. Raises KeyError if unknown."""
        table = self._tables.get(node_id.partition("-")[0])
        if table is None or node_id not in table.rows:
            raise KeyError(node_id)
        return facts(table.rows[node_id])

    # -- indexes ------------------------------------------------------------------------------------

    def _index_object(self, object_id: str, _old: ObjectNode | None, new: ObjectNode | None) -> None:
        if new is None:
            self._boxes.remove(object_id)
            self._trees.pop(object_id, None)
            self._voxels.pop(object_id, None)
        else:
            self._boxes.set(object_id, new.box_min, new.box_max)

    def _index_history(self, place_id: str, old: HistoryNode | None, new: HistoryNode | None) -> None:
        if old is not None:
            self._places[old.object_id].discard(place_id)
        if new is not None:
            self._places[new.object_id].add(place_id)

    def _index_viewpoint(self, viewpoint_id: str, _old: Viewpoint | None, new: Viewpoint | None) -> None:
        if new is None:
            self._cameras.remove(viewpoint_id)
        else:
            self._cameras.set(viewpoint_id, new.world_from_camera[:3, 3])

    def _index_edge(self, key: EdgeKey, old: Edge | None, new: Edge | None) -> None:
        for end in key[1:]:
            if old is None or new is None:
                self._in_order.pop(end, None)
            if new is not None:
                self._adjacent[end].add(key)
                continue
            self._adjacent[end].discard(key)
            if not self._adjacent[end]:
                del self._adjacent[end]


def _differing(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The facts that differ, and `observations`, which tells how well founded the others are."""
    same = {
        name
        for name in before.keys() & after.keys()
        if name != "observations" and before[name] == after[name]
    }
    return (
        {name: value for name, value in before.items() if name not in same},
        {name: value for name, value in after.items() if name not in same},
    )
