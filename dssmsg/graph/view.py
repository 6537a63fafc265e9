"""The read-only face of the scene graph that plug-ins and observers get."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Protocol

from dssmsg.frame import Float32Array, FloatArray, MaskArray
from dssmsg.graph.nodes import Edge, HistoryNode, ObjectNode, Viewpoint, WaypointNode

if TYPE_CHECKING:
    from scipy.spatial import KDTree  # takes a quarter of a second; who only reads recordings needs none


class GraphView(Protocol):
    """Read access to the scene graph. All nodes are frozen; mappings are live, read-only views."""

    @property
    def objects(self) -> Mapping[str, ObjectNode]:
        """Objects by id, tentative ones included, in order of creation."""
        ...

    @property
    def history(self) -> Mapping[str, HistoryNode]:
        """Former places by id."""
        ...

    @property
    def waypoints(self) -> Mapping[str, WaypointNode]:
        """Waypoints by id."""
        ...

    @property
    def viewpoints(self) -> Mapping[str, Viewpoint]:
        """Viewpoints by id."""
        ...

    @property
    def edges(self) -> Mapping[tuple[str, str, str], Edge]:
        """Edges by (kind, source, target)."""
        ...

    @property
    def updates(self) -> int:
        """How many changes have been applied."""
        ...

    def edges_of(self, node_id: str, kind: str | None = None) -> Iterator[Edge]:
        """Edges that touch a node (or a viewpoint), in order of creation."""
        ...

    def history_of(self, object_id: str) -> Iterator[HistoryNode]:
        """Former places of an object, a removed one included, in order of creation."""
        ...

    def objects_touching(self, box_min: FloatArray, box_max: FloatArray) -> list[str]:
        """Ids of the objects whose box touches a box, by spatial index, in order of creation (by number)."""
        ...

    def viewpoints_near(self, position: FloatArray, radius: float) -> list[str]:
        """Ids of viewpoints whose camera is within `radius` metres of a position (3,), by spatial index."""
        ...

    def tree(self, object_id: str) -> KDTree:
        """The object's points as a KD-tree, cached until its points change."""
        ...

    def known_voxels(self, object_id: str, points: Float32Array) -> MaskArray:
        """(N,) bool: which of the points (N, 3) lie in a voxel that the object already has."""
        ...

    def facts(self, node_id: str) -> dict[str, Any]:
        """The JSON facts of a node, as they stand in `before` and `after` of changes."""
        ...
