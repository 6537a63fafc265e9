"""Nodes and edges of the scene graph: frozen values, replaced as a whole by `SceneGraph.apply`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from dssmsg.frame import ByteArray, Float32Array, FloatArray

TENTATIVE, BELIEVED = "tentative", "believed"
STATIC, APPEARED, DISAPPEARED, MOVED = "static", "appeared", "disappeared", "moved"
PATH, SEES, NEAR = "path", "sees", "near"


@dataclass(frozen=True, slots=True, eq=False)
class ObjectNode:
    """An object (N_O). points (N, 3) float32 world metres, one a voxel, by first sight; colors (N, 3) uint8.

    `votes` label -> summed confidence; `observations` is the number of merged detections, `frames` the
    frame indices they came from; `viewpoints` the ids it was seen from, in order of first sight;
    features are unit vectors (D,) averaged over observations. `state` is d_s, `dynamic_attribute` d_a.
    """

    id: str
    label: str
    votes: Mapping[str, float]
    status: str
    state: str
    dynamic_attribute: float | None
    points: Float32Array
    colors: ByteArray
    box_min: FloatArray
    box_max: FloatArray
    observations: int
    frames: tuple[int, ...]
    viewpoints: tuple[str, ...]
    first_seen: float
    last_seen: float
    text_feature: Float32Array | None = None
    image_feature: Float32Array | None = None

    @property
    def center(self) -> FloatArray:
        """Centre (3,) of the box."""
        centre: FloatArray = (self.box_min + self.box_max) / 2
        return centre


@dataclass(frozen=True, slots=True, eq=False)
class HistoryNode:
    """A former place of an object, with the time span it was there (seconds of sim time)."""

    id: str
    object_id: str
    label: str
    box_min: FloatArray
    box_max: FloatArray
    from_time: float
    to_time: float


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """A pose from which the robot looked; belongs to one waypoint. `frame` is its newest observation."""

    id: str
    waypoint_id: str
    world_from_camera: FloatArray
    heading: float
    tilt: float
    frame: int
    observations: int


@dataclass(frozen=True, slots=True, eq=False)
class WaypointNode:
    """A place on the floor (N_W): viewpoints within 0.25 m of each other. position (3,) world metres."""

    id: str
    position: FloatArray
    viewpoints: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """An edge of kind `path`, `sees` or `near`; key is (kind, source, target)."""

    kind: str
    source: str
    target: str
    attributes: Mapping[str, Any] = field(default_factory=dict)
