"""The graph as plug-ins get it: everything of `GraphView`, and no way to write."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from dssmsg.frame import Float32Array, FloatArray, MaskArray
from dssmsg.graph.nodes import Edge, HistoryNode, ObjectNode, Viewpoint, WaypointNode
from dssmsg.graph.view import GraphView

if TYPE_CHECKING:
    from scipy.spatial import KDTree  # takes a quarter of a second; who only reads recordings needs none


class ReadOnlyGraph:
    """Forwards `GraphView` to a graph; `SceneGraph.apply` stays with the pipeline."""

    __slots__ = ("_view",)

    def __init__(self, view: GraphView) -> None:
        self._view = view

    @property
    def objects(self) -> Mapping[str, ObjectNode]:
        """See `GraphView.objects`."""
        return self._view.objects

    @property
    def history(self) -> Mapping[str, HistoryNode]:
        """See `GraphView.history`."""
        return self._view.history

    @property
    def waypoints(self) -> Mapping[str, WaypointNode]:
        """See `GraphView.waypoints`."""
        return self._view.waypoints

    @property
    def viewpoints(self) -> Mapping[str, Viewpoint]:
        """See `GraphView.viewpoints`."""
        return self._view.viewpoints

    @property
    def edges(self) -> Mapping[tuple[str, str, str], Edge]:
        """See `GraphView.edges`."""
        return self._view.edges

    @property
    def updates(self) -> int:
        """See `GraphView.updates`."""
        return self._view.updates

    def edges_of(self, node_id: str, kind: str | None = None) -> Iterator[Edge]:
        """See `GraphView.edges_of`."""
        return self._view.edges_of(node_id, kind)

    def history_of(self, object_id: str) -> Iterator[HistoryNode]:
        """See `GraphView.history_of`."""
        return self._view.history_of(object_id)

    def objects_touching(self, box_min: FloatArray, box_max: FloatArray) -> list[str]:
        """See `GraphView.objects_touching`."""
        return self._view.objects_touching(box_min, box_max)

    def viewpoints_near(self, position: FloatArray, radius: float) -> list[str]:
        """See `GraphView.viewpoints_near`."""
        return self._view.viewpoints_near(position, radius)

    def tree(self, object_id: str) -> KDTree:
        """See `GraphView.tree`."""
        return self._view.tree(object_id)

    def known_voxels(self, object_id: str, points: Float32Array) -> MaskArray:
        """See `GraphView.known_voxels`."""
        return self._view.known_voxels(object_id, points)

    def facts(self, node_id: str) -> dict[str, Any]:
        """See `GraphView.facts`."""
        return self._view.facts(node_id)
