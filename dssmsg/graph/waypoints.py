"""Viewpoint fusion and the waypoint topology (paper III-A; ALGORITHM A.5).

A viewpoint is a pose from which the robot looked; a waypoint is a place on the floor with the viewpoints
taken there; a `path` edge joins two waypoints that the robot was at one after the other.

- A key frame *matches* a viewpoint within 0.5 m, 20 deg of heading and the same tilt, whichever visit made
  it; of several, the best in heading and distance together, but a robot that stands stays with its last
  one. Three key frames at -6, 0 and +6 deg around one heading therefore share one viewpoint.
- A *new* viewpoint is made where none matches and the pose is more than 0.5 m, 30 deg or the tilt
  tolerance away from the last viewpoint of this visit. At a stop the robot looks on purpose, so there a
  pose without a match always gets its viewpoint.
- The robot is *at* the nearest waypoint within 0.25 m of its base, else at that of the viewpoint which the
  pose matched. The second keeps the topology connected where a later visit passes beside known places.
  Key frames come each 0.5 m, so such edges are short.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from dssmsg.frame import FloatArray, Frame
from dssmsg.graph.changes import (
    Cause,
    Change,
    EdgeAdded,
    EdgeChanged,
    Score,
    ViewpointAdded,
    ViewpointSeen,
    WaypointAdded,
)
from dssmsg.graph.ids import IdAllocator, id_order
from dssmsg.graph.nodes import PATH, Viewpoint, WaypointNode
from dssmsg.graph.view import GraphView

CAUSE = "graph/waypoints"


@dataclass(frozen=True, slots=True)
class WaypointOptions:
    """Thresholds in metres and radians."""

    match_distance: float = 0.5
    """A pose this close (on the floor plan) to a viewpoint can match it; beyond it has moved."""
    match_height: float = 0.5
    """And its camera at most this much higher or lower, for cameras carried by hand."""
    match_heading: float = math.radians(20.0)
    match_tilt: float = math.radians(6.0)
    new_heading: float = math.radians(30.0)
    """Turned further than this from the last viewpoint, a driving robot gets a new one."""
    waypoint_radius: float = 0.25
    visit_gap: float = 0.5
    """Base positions this far apart at the start of a visit: the robot was carried, not driven."""
    drive_gap: float = 1.0
    """And this far apart between two key frames of one visit (frames are missing)."""


@dataclass(frozen=True, slots=True)
class _Pose:
    """A camera's place and direction: camera position (3,), heading and tilt in radians."""

    position: FloatArray
    heading: float
    tilt: float


@dataclass(frozen=True, slots=True)
class _Offset:
    """How far one pose is from another: metres on the floor and in height, radians."""

    distance: float
    height: float
    heading: float
    tilt: float


class WaypointTopology:
    """Follows the robot and says which viewpoints, waypoints and path edges its key frames give.

    Its cost per frame depends on the viewpoints around the robot only.
    """

    def __init__(self, graph: GraphView, ids: IdAllocator, options: WaypointOptions | None = None) -> None:
        self._graph = graph
        self._ids = ids
        self._options = options or WaypointOptions()
        self._visit: int | None = None
        self._base: FloatArray | None = None
        self._last: _Pose | None = None
        self._last_id: str | None = None
        self._at: str | None = None

    def observe(self, frame: Frame) -> tuple[str | None, tuple[Change, ...]]:
        """The viewpoint a key frame was taken from, None between two, and the changes that make it so.

        The changes are to be applied before the next key frame is observed.
        """
        pose = _Pose(frame.position, frame.heading_rad, frame.tilt_rad)
        base = frame.world_from_base[:3, 3]
        self._follow(frame.visit, base)
        around = self._around(pose, base)
        here = self._nearest_waypoint(around, base)
        match = self._best_match(around, pose)
        if match is not None:
            viewpoint, offset = match
            self._last, self._last_id = _pose_of(viewpoint), viewpoint.id
            seen = ViewpointSeen(
                cause=Cause(CAUSE, "match"), scores=self._match_scores(offset), viewpoint_id=viewpoint.id
            )
            waypoint = self._graph.waypoints[viewpoint.waypoint_id] if here is None else here
            return viewpoint.id, (seen, *self._arrive(waypoint))
        if self._is_new(pose, frame.at_stop):
            viewpoint_id, waypoint, added = self._new_viewpoint(frame, pose, here)
            self._last, self._last_id = pose, viewpoint_id
            return viewpoint_id, (*added, *self._arrive(waypoint))
        return None, () if here is None else self._arrive(here)

    def _follow(self, visit: int, base: FloatArray) -> None:
        """Notice where the robot was carried instead of driven: no edge leads across."""
        gap = self._options.drive_gap
        if visit != self._visit:
            self._visit, self._last, self._last_id = visit, None, None
            gap = self._options.visit_gap
        if self._base is None or _floor_distance(self._base, base) >= gap:
            self._at = None
        self._base = base

    def _around(self, pose: _Pose, base: FloatArray) -> list[Viewpoint]:
        """Viewpoints that may match, and at least one of every waypoint that the base may stand on."""
        o = self._options
        # A waypoint's first viewpoint was taken with the base on it and the camera as far off as now, about.
        arm = _floor_distance(pose.position, base)
        reach = math.hypot(max(o.match_distance, o.waypoint_radius + 2 * arm), o.match_height)
        return [self._graph.viewpoints[i] for i in self._graph.viewpoints_near(pose.position, reach)]

    def _nearest_waypoint(self, around: list[Viewpoint], base: FloatArray) -> WaypointNode | None:
        """The waypoint nearest to the base on the floor, within the waypoint radius."""
        ids = sorted({viewpoint.waypoint_id for viewpoint in around}, key=id_order)
        waypoints = [self._graph.waypoints[waypoint_id] for waypoint_id in ids]
        nearest = min(waypoints, key=lambda w: _floor_distance(w.position, base), default=None)
        if nearest is None or _floor_distance(nearest.position, base) > self._options.waypoint_radius:
            return None
        return nearest

    def _best_match(self, around: list[Viewpoint], pose: _Pose) -> tuple[Viewpoint, _Offset] | None:
        o = self._options
        offsets = [(viewpoint, _offset(_pose_of(viewpoint), pose)) for viewpoint in around]
        fitting = [(viewpoint, offset) for viewpoint, offset in offsets if self._matches(offset)]

        def rank(found: tuple[Viewpoint, _Offset]) -> tuple[bool, float]:
            viewpoint, offset = found
            # The headings of a stop may lie closer than a viewpoint reaches: the key frames around one of
            # them must not be shared out because the next one's viewpoint is nearer to the last of them.
            left = viewpoint.id != self._last_id or offset.distance > o.waypoint_radius
            # Heading and distance weigh as the tolerances do. Heading alone would let a viewpoint half a
            # metre away take some of those key frames, and leave this place's own the others.
            return left, offset.heading / o.match_heading + offset.distance / o.match_distance

        return min(fitting, key=rank, default=None)

    def _matches(self, offset: _Offset) -> bool:
        o = self._options
        return (
            offset.distance <= o.match_distance
            and offset.height <= o.match_height
            and offset.heading <= o.match_heading
            and offset.tilt <= o.match_tilt
        )

    def _is_new(self, pose: _Pose, at_stop: bool) -> bool:
        if self._last is None or at_stop:
            return True
        o, offset = self._options, _offset(self._last, pose)
        return (
            offset.distance > o.match_distance
            or offset.height > o.match_height
            or offset.heading > o.new_heading
            or offset.tilt > o.match_tilt
        )

    def _new_viewpoint(
        self, frame: Frame, pose: _Pose, here: WaypointNode | None
    ) -> tuple[str, WaypointNode, tuple[Change, ...]]:
        changes: list[Change] = []
        base = frame.world_from_base[:3, 3]
        if here is None:
            here = WaypointNode(self._ids.new("waypoint"), base)
            changes.append(WaypointAdded(cause=Cause(CAUSE, "new_place"), waypoint_id=here.id, position=base))
        viewpoint_id = self._ids.new_viewpoint(here.id)
        changes.append(
            ViewpointAdded(
                cause=Cause(CAUSE, "new_view_at_stop" if frame.at_stop else "new_view"),
                scores=self._new_scores(pose, _floor_distance(here.position, base)),
                viewpoint_id=viewpoint_id,
                waypoint_id=here.id,
                world_from_camera=frame.world_from_camera,
                heading=pose.heading,
                tilt=pose.tilt,
            )
        )
        return viewpoint_id, here, tuple(changes)

    def _arrive(self, waypoint: WaypointNode) -> tuple[Change, ...]:
        """The robot is at a waypoint now: the path edge from the one before, if it drove there."""
        previous = None if self._at is None else self._graph.waypoints.get(self._at)
        self._at = waypoint.id
        if previous is None or previous.id == waypoint.id:
            return ()
        source, target = sorted((previous.id, waypoint.id), key=id_order)
        length = _floor_distance(previous.position, waypoint.position)
        known = self._graph.edges.get((PATH, source, target))
        if known is None:
            attributes = {"length": length, "verified": "driven", "blocked": False}
            cause = Cause(CAUSE, "driven")
            return (EdgeAdded(cause=cause, edge=PATH, source=source, target=target, attributes=attributes),)
        if known.attributes.get("verified") == "driven" or known.attributes.get("blocked"):
            return ()  # a blocked edge stays so until depth shows it free: this drive may have gone round
        driven = {"verified": "driven"}
        return (
            EdgeChanged(
                cause=Cause(CAUSE, "driven"), edge=PATH, source=source, target=target, attributes=driven
            ),
        )

    def _match_scores(self, offset: _Offset) -> tuple[Score, ...]:
        o = self._options
        return (
            Score("distance_m", offset.distance, o.match_distance),
            Score("heading_rad", offset.heading, o.match_heading),
            Score("tilt_rad", offset.tilt, o.match_tilt),
        )

    def _new_scores(self, pose: _Pose, from_waypoint: float) -> tuple[Score, ...]:
        """How far the pose is from the last viewpoint (left out for the first), and from its waypoint."""
        o = self._options
        place = Score("waypoint_m", from_waypoint, o.waypoint_radius)
        if self._last is None:
            return (place,)
        offset = _offset(self._last, pose)
        return (
            Score("moved_m", offset.distance, o.match_distance),
            Score("turned_rad", offset.heading, o.new_heading),
            Score("tilted_rad", offset.tilt, o.match_tilt),
            place,
        )


def _pose_of(viewpoint: Viewpoint) -> _Pose:
    return _Pose(viewpoint.world_from_camera[:3, 3], viewpoint.heading, viewpoint.tilt)


def _offset(a: _Pose, b: _Pose) -> _Offset:
    turn = math.remainder(b.heading - a.heading, math.tau)
    return _Offset(
        distance=_floor_distance(a.position, b.position),
        height=abs(float(b.position[2] - a.position[2])),
        heading=abs(turn),
        tilt=abs(b.tilt - a.tilt),
    )


def _floor_distance(a: FloatArray, b: FloatArray) -> float:
    """Distance in metres between two positions (3,) on the floor plan."""
    return math.dist((float(a[0]), float(a[1])), (float(b[0]), float(b[1])))
