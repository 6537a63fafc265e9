"""Every change of the scene graph as a typed, frozen value.

A change says what it is about, why it was made (cause, scores, the thresholds they were held against),
when, and what was there before and after. Plug-ins make changes; `SceneGraph.apply` alone carries them
out, checks `before` against the graph, and returns them stamped with `before`, `after` and `update`.
Folding stamped changes into an empty graph gives the same graph back, exactly.

Arrays (voxel points, colours, features) ride along as read-only numpy arrays; `dssmsg.graph.codec`
writes them once, by hash, into a side table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from dssmsg.frame import ByteArray, Float32Array, FloatArray


@dataclass(frozen=True, slots=True)
class Cause:
    """Who made a change and by which rule: `Cause("association/dssm", "merge")`."""

    plugin: str
    rule: str


@dataclass(frozen=True, slots=True)
class Score:
    """One term of a decision. `threshold` is None where the term was not itself held against one."""

    name: str
    value: float
    threshold: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Change:
    """What all changes share. `frame`, `sim_time` are the pipeline's stamp, `update` is the graph's.

    `before` and `after` hold the facts of the subject that the change touches, as JSON values; a plug-in
    may leave `before` empty or state what it relied on, and `apply` refuses the change where it disagrees.
    """

    kind: ClassVar[str] = ""
    cause: Cause
    scores: tuple[Score, ...] = ()
    frame: int = -1
    sim_time: float = 0.0
    update: int = -1
    before: Mapping[str, Any] = field(default_factory=dict)
    after: Mapping[str, Any] = field(default_factory=dict)

    @property
    def subjects(self) -> tuple[str, ...]:
        """Ids of what this change is about, the main one first."""
        raise NotImplementedError  # pragma: no cover - every kind has its own


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObjectAdded(Change):
    """A new, tentative object from one observation.

    points (N, 3) float32 world metres, one a voxel; colors (N, 3) uint8; features unit vectors (D,);
    `detection` is the index of the detection in its frame.
    """

    kind: ClassVar[str] = "object_added"
    object_id: str
    label: str
    score: float
    points: Float32Array
    colors: ByteArray
    viewpoint_id: str | None
    range_m: float
    detection: int = -1
    text_feature: Float32Array | None = None
    image_feature: Float32Array | None = None

    @property
    def subjects(self) -> tuple[str, ...]:
        """The new object."""
        return (self.object_id,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObjectMerged(Change):
    """An observation merged into an object; `points` may leave out voxels that the object already has."""

    kind: ClassVar[str] = "object_merged"
    object_id: str
    label: str
    score: float
    points: Float32Array
    colors: ByteArray
    viewpoint_id: str | None
    range_m: float
    detection: int = -1
    text_feature: Float32Array | None = None
    image_feature: Float32Array | None = None

    @property
    def subjects(self) -> tuple[str, ...]:
        """The object merged into."""
        return (self.object_id,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObjectsJoined(Change):
    """Two objects turn out to be one: `object_id` stays and takes over all of `absorbed_id`, edges too."""

    kind: ClassVar[str] = "objects_joined"
    object_id: str
    absorbed_id: str

    @property
    def subjects(self) -> tuple[str, ...]:
        """The object that stays, then the one that goes."""
        return (self.object_id, self.absorbed_id)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObjectChanged(Change):
    """Named facts of an object get new values: any of `status`, `state`, `dynamic_attribute`, `label`."""

    kind: ClassVar[str] = "object_changed"
    object_id: str
    values: Mapping[str, Any]

    @property
    def subjects(self) -> tuple[str, ...]:
        """The object."""
        return (self.object_id,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObjectReplaced(Change):
    """The object's cloud is replaced: it moved (`history_id` keeps the old place) or was shrunk (None)."""

    kind: ClassVar[str] = "object_replaced"
    object_id: str
    points: Float32Array
    colors: ByteArray
    history_id: str | None = None

    @property
    def subjects(self) -> tuple[str, ...]:
        """The object, then the history node if one is made."""
        return (self.object_id,) if self.history_id is None else (self.object_id, self.history_id)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObjectRemoved(Change):
    """An object leaves the graph with its edges; `history_id` keeps its last place if given.

    `successor_id` names the object whose identity this one turned out to share (a retired newer id).
    """

    kind: ClassVar[str] = "object_removed"
    object_id: str
    history_id: str | None = None
    successor_id: str | None = None

    @property
    def subjects(self) -> tuple[str, ...]:
        """The object, then the history node and the successor where there are."""
        extra = tuple(i for i in (self.history_id, self.successor_id) if i is not None)
        return (self.object_id, *extra)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WaypointAdded(Change):
    """A new waypoint; position (3,) on the floor, world metres."""

    kind: ClassVar[str] = "waypoint_added"
    waypoint_id: str
    position: FloatArray

    @property
    def subjects(self) -> tuple[str, ...]:
        """The waypoint."""
        return (self.waypoint_id,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WaypointRemoved(Change):
    """A waypoint leaves with its viewpoints and its `sees` edges."""

    kind: ClassVar[str] = "waypoint_removed"
    waypoint_id: str

    @property
    def subjects(self) -> tuple[str, ...]:
        """The waypoint."""
        return (self.waypoint_id,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewpointAdded(Change):
    """A new viewpoint of a waypoint; world_from_camera (4, 4); heading and tilt in radians."""

    kind: ClassVar[str] = "viewpoint_added"
    viewpoint_id: str
    waypoint_id: str
    world_from_camera: FloatArray
    heading: float
    tilt: float

    @property
    def subjects(self) -> tuple[str, ...]:
        """The viewpoint, then its waypoint."""
        return (self.viewpoint_id, self.waypoint_id)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewpointSeen(Change):
    """A key frame matched a known viewpoint; its newest observation is now this frame."""

    kind: ClassVar[str] = "viewpoint_seen"
    viewpoint_id: str

    @property
    def subjects(self) -> tuple[str, ...]:
        """The viewpoint."""
        return (self.viewpoint_id,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeAdded(Change):
    """A new edge. `edge` is `path` (waypoints), `sees` (viewpoint -> object) or `near` (objects).

    `path` and `near` are undirected: `source` is the smaller id (by number). `attributes` are JSON values:
    path: length, verified ("driven" or "seen"), blocked; sees: distance; near: distance, relation.
    """

    kind: ClassVar[str] = "edge_added"
    edge: str
    source: str
    target: str
    attributes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def subjects(self) -> tuple[str, ...]:
        """Both ends."""
        return (self.source, self.target)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeChanged(Change):
    """Attributes of an edge get new values; a `path` edge with `blocked: true` is out of E_W, a candidate."""

    kind: ClassVar[str] = "edge_changed"
    edge: str
    source: str
    target: str
    attributes: Mapping[str, Any]

    @property
    def subjects(self) -> tuple[str, ...]:
        """Both ends."""
        return (self.source, self.target)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeRemoved(Change):
    """An edge leaves."""

    kind: ClassVar[str] = "edge_removed"
    edge: str
    source: str
    target: str

    @property
    def subjects(self) -> tuple[str, ...]:
        """Both ends."""
        return (self.source, self.target)


CHANGE_TYPES: Mapping[str, type[Change]] = {
    change_type.kind: change_type
    for change_type in (
        ObjectAdded,
        ObjectMerged,
        ObjectsJoined,
        ObjectChanged,
        ObjectReplaced,
        ObjectRemoved,
        WaypointAdded,
        WaypointRemoved,
        ViewpointAdded,
        ViewpointSeen,
        EdgeAdded,
        EdgeChanged,
        EdgeRemoved,
    )
}
