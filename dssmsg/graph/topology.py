"""Keeps the waypoint topology true to what depth shows (ALGORITHM C, "Topology"; paper III-B).

- A blocked `path` edge is out of E_W and stays as a candidate (`blocked: true`). When its place was seen
  clear in n consecutive frames it is put back. Consecutive are frames that see the place; one that shows
  something there begins the count anew.
- A waypoint whose edges are all blocked is isolated: it leaves with its viewpoints and their `sees` edges.
  Its candidates are remembered with it, and the first that is seen clear brings all of it back, under new
  ids, as ids are never used twice.
- Two waypoints in free line of sight get a `path` edge (`verified: "seen"`) where the way between them over
  the topology is much longer than the straight one: loops close without having been driven.

Only waypoints around the robot are looked at, so a frame's cost does not grow with the map.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dssmsg.frame import FloatArray
from dssmsg.graph.changes import (
    Cause,
    Change,
    EdgeAdded,
    EdgeChanged,
    Score,
    ViewpointAdded,
    WaypointAdded,
    WaypointRemoved,
)
from dssmsg.graph.ids import IdAllocator, id_order
from dssmsg.graph.nodes import DISAPPEARED, PATH, SEES, Edge, Viewpoint
from dssmsg.graph.paths import edge_key, shortest_path
from dssmsg.graph.spatial import PointIndex
from dssmsg.graph.view import GraphView

CAUSE = "graph/topology"
Point = tuple[float, float]


class Strip(Protocol):
    """What is known of a straight strip of floor: see `dssmsg.navigation.grid.Corridor`."""

    @property
    def cells(self) -> int:
        """How many of its cells something stands in."""
        ...

    @property
    def free(self) -> float:
        """Share of its cells known to be free."""
        ...

    @property
    def fresh(self) -> float:
        """Share of its cells that the newest frame showed free."""
        ...


class Floor(Protocol):
    """A floor plan of the robot's surroundings: see `dssmsg.navigation.grid.RollingGrid`."""

    def corridor(self, start: Point, end: Point, half_width: float) -> Strip:
        """What is known of the strip of `half_width` metres along a straight leg."""
        ...


@dataclass(frozen=True, slots=True)
class TopologyOptions:
    """Metres and shares, unless said otherwise."""

    clear_frames: int = 5
    """n: so many consecutive frames must show a candidate clear."""
    around: float = 3.0
    """Waypoints further from the robot than this are not looked at: the floor plan ends there."""
    half_width: float = 0.22
    """Half the corridor that must be free: the robot and a margin."""
    obstacle_reach: float = 0.5
    """How far along the edge on either side of the obstacle a frame must see it clear."""
    fresh: float = 0.5
    """Share of that stretch which a frame must show free to count as one that sees it clear."""
    free: float = 0.98
    """Share of a closure's corridor that must be known free."""
    closure_max: float = 2.8
    closure_min: float = 0.4
    gain: float = 1.6
    """A closure must be shorter than the way over the topology by this factor."""
    closures: bool = True


@dataclass(slots=True)
class _Lost:
    """An isolated waypoint that left: all that is needed to put it back."""

    name: str
    position: FloatArray
    viewpoints: tuple[tuple[Viewpoint, tuple[Edge, ...]], ...]
    edges: tuple[Edge, ...]
    clear: int = 0


class TopologyMaintenance:
    """Looks at the topology around the robot frame by frame, and says what has to change."""

    def __init__(
        self, graph: GraphView, ids: IdAllocator, floor: Floor, options: TopologyOptions | None = None
    ) -> None:
        self._graph = graph
        self._ids = ids
        self._floor = floor
        self._options = options or TopologyOptions()
        self._clear: defaultdict[tuple[str, str, str], int] = defaultdict(int)
        self._lost: dict[str, _Lost] = {}
        self._lost_places = PointIndex()
        self._now: dict[str, str] = {}
        """The new names of waypoints that came back."""

    def observe(self, base: FloatArray, *, closures: bool, keep: str | None = None) -> tuple[Change, ...]:
        """Changes after a frame that the floor plan has taken in.

        base (3,): the robot's place, world metres. `closures`: whether to look for loop closures too, which
        costs more (key frames). `keep`: a waypoint that must not leave now, as the robot is at it.
        """
        here = [name for name in self._around(base) if name in self._graph.waypoints]
        changes = [*self._healed(here), *self._restored(base)]
        healed = {change.subjects for change in changes if isinstance(change, EdgeChanged)}
        changes += self._isolated(here, healed, keep)
        if closures and self._options.closures:
            gone = {change.waypoint_id for change in changes if isinstance(change, WaypointRemoved)}
            changes += self._closed([name for name in here if name not in gone])
        return tuple(changes)

    def _around(self, base: FloatArray) -> list[str]:
        """Waypoints around a place, by the index over viewpoints: every waypoint has one."""
        reach = self._options.around + 0.5  # a viewpoint's camera is off its waypoint
        middle = np.array([base[0], base[1], base[2] + 0.6])  # between floor and a camera's height
        views = self._graph.viewpoints
        names = {views[name].waypoint_id for name in self._graph.viewpoints_near(middle, reach)}
        return sorted(names, key=id_order)

    # -- candidates ---------------------------------------------------------------------------------------

    def _healed(self, here: list[str]) -> Iterator[EdgeChanged]:
        """Blocked edges seen clear often enough are put back."""
        n = self._options.clear_frames
        for edge in self._edges(here, blocked=True):
            key = (edge.kind, edge.source, edge.target)
            verdict = self._sees_clear(edge, self._xy(edge.source), self._xy(edge.target))
            if verdict is None:
                continue
            self._clear[key] = self._clear[key] + 1 if verdict else 0
            if self._clear[key] >= n:
                score = Score("clear_frames", float(self._clear.pop(key)), float(n))
                yield EdgeChanged(
                    cause=Cause(CAUSE, "seen_clear"),
                    scores=(score,),
                    edge=edge.kind,
                    source=edge.source,
                    target=edge.target,
                    attributes={"blocked": False, "obstacle": None},
                )

    def _sees_clear(self, edge: Edge, a: Point, b: Point) -> bool | None:
        """What the newest frame says of a candidate: clear, something there, or (None) nothing."""
        start, end = self._stretch(edge, a, b)
        strip = self._floor.corridor(start, end, self._options.half_width)
        if strip.cells:
            return False
        return True if strip.fresh >= self._options.fresh else None

    def _stretch(self, edge: Edge, a: Point, b: Point) -> tuple[Point, Point]:
        """The part of an edge around its obstacle; all of it where nobody said where that stood."""
        place = edge.attributes.get("obstacle")
        length = math.dist(a, b)
        if not place or length < 1e-6:
            return a, b
        ux, uy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
        along = (place[0] - a[0]) * ux + (place[1] - a[1]) * uy
        low = min(max(along - self._options.obstacle_reach, 0.0), length)
        high = min(max(along + self._options.obstacle_reach, 0.0), length)
        if high - low < 0.1:  # it stands beyond an end
            return a, b
        return (a[0] + low * ux, a[1] + low * uy), (a[0] + high * ux, a[1] + high * uy)

    # -- isolated waypoints -------------------------------------------------------------------------------

    def _isolated(
        self, here: list[str], healed: set[tuple[str, ...]], keep: str | None
    ) -> Iterator[WaypointRemoved]:
        """Waypoints all of whose edges are blocked leave, and are remembered."""
        for name in here:
            edges = tuple(self._graph.edges_of(name, PATH))
            if name == keep or not edges or not all(edge.attributes.get("blocked") for edge in edges):
                continue
            if any((edge.source, edge.target) in healed for edge in edges):
                continue
            waypoint = self._graph.waypoints[name]
            views = [self._graph.viewpoints[view] for view in waypoint.viewpoints]
            self._lost[name] = _Lost(
                name,
                waypoint.position,
                tuple((view, tuple(self._graph.edges_of(view.id, SEES))) for view in views),
                edges,
            )
            self._lost_places.set(name, waypoint.position)
            yield WaypointRemoved(
                cause=Cause(CAUSE, "isolated"),
                scores=(Score("open_edges", 0.0, 1.0), Score("blocked_edges", float(len(edges)))),
                waypoint_id=name,
            )

    def _restored(self, base: FloatArray) -> Iterator[Change]:
        """A lost waypoint comes back with the first of its candidates that was seen clear often enough."""
        near = sorted(self._lost_places.within(base, self._options.around), key=id_order)
        for name in near:
            lost = self._lost[name]
            known = [edge for edge in lost.edges if self._other_end(lost, edge) in self._graph.waypoints]
            for edge in known:
                other = self._xy(self._other_end(lost, edge))
                here = (float(lost.position[0]), float(lost.position[1]))
                ends = (here, other) if edge.source == name else (other, here)
                verdict = self._sees_clear(edge, *ends)
                if verdict is None:
                    continue
                lost.clear = lost.clear + 1 if verdict else 0
                if lost.clear >= self._options.clear_frames:
                    yield from self._put_back(lost, edge, known)
                break

    def _other_end(self, lost: _Lost, edge: Edge) -> str:
        """Today's name of the waypoint at the other end of a lost one's edge."""
        name = edge.target if edge.source == lost.name else edge.source
        while name in self._now:
            name = self._now[name]
        return name

    def _put_back(self, lost: _Lost, clear: Edge, known: list[Edge]) -> Iterator[Change]:
        del self._lost[lost.name]
        self._lost_places.remove(lost.name)
        cause = Cause(CAUSE, "put_back")
        n = float(self._options.clear_frames)
        scores = (Score("clear_frames", float(lost.clear), n),)
        waypoint_id = self._now[lost.name] = self._ids.new("waypoint")
        yield WaypointAdded(cause=cause, scores=scores, waypoint_id=waypoint_id, position=lost.position)
        for view, edges in lost.viewpoints:
            viewpoint_id = self._ids.new_viewpoint(waypoint_id)
            yield ViewpointAdded(
                cause=cause,
                viewpoint_id=viewpoint_id,
                waypoint_id=waypoint_id,
                world_from_camera=view.world_from_camera,
                heading=view.heading,
                tilt=view.tilt,
            )
            for edge in edges:
                node = self._graph.objects.get(edge.target)
                if node is not None and node.state != DISAPPEARED:
                    yield EdgeAdded(
                        cause=cause,
                        edge=SEES,
                        source=viewpoint_id,
                        target=edge.target,
                        attributes=dict(edge.attributes),
                    )
        for edge in known:
            _kind, source, target = edge_key(waypoint_id, self._other_end(lost, edge))
            attributes = dict(edge.attributes)
            if edge is clear:
                attributes |= {"blocked": False, "obstacle": None, "verified": "seen"}
            yield EdgeAdded(
                cause=cause, scores=scores, edge=PATH, source=source, target=target, attributes=attributes
            )

    # -- loop closures ------------------------------------------------------------------------------------

    def _closed(self, here: list[str]) -> Iterator[EdgeAdded]:
        """Edges between waypoints in verified free line of sight that are far apart over the topology."""
        o, taken = self._options, set[str]()
        pairs = [(math.dist(self._xy(a), self._xy(b)), a, b) for a, b in itertools.combinations(here, 2)]
        for length, a, b in sorted(pairs, key=lambda pair: (pair[0], id_order(pair[1]), id_order(pair[2]))):
            if not o.closure_min <= length <= o.closure_max or edge_key(a, b) in self._graph.edges:
                continue
            if a in taken or b in taken:  # the edge found first may make this one needless: next key frame
                continue
            start, end = self._xy(a), self._xy(b)
            strip = self._floor.corridor(start, end, o.half_width)
            if strip.cells or strip.free < o.free or self._stands_between(start, end):
                continue
            if shortest_path(self._graph, a, b, longest=o.gain * length) is not None:
                continue
            taken |= {a, b}
            _kind, source, target = edge_key(a, b)
            yield EdgeAdded(
                cause=Cause(CAUSE, "line_of_sight"),
                scores=(Score("free", strip.free, o.free), Score("length_m", length, o.closure_max)),
                edge=PATH,
                source=source,
                target=target,
                attributes={"length": length, "verified": "seen", "blocked": False},
            )

    def _stands_between(self, start: Point, end: Point) -> bool:
        """Whether the box of an object that the robot would hit reaches into the corridor.

        Depth may show the floor below a table or between the legs of a chair.
        """
        half = self._options.half_width
        low = np.array([min(start[0], end[0]) - half, min(start[1], end[1]) - half, 0.05])
        high = np.array([max(start[0], end[0]) + half, max(start[1], end[1]) + half, 0.9])
        for name in self._graph.objects_touching(low, high):
            node = self._graph.objects[name]
            if node.state != DISAPPEARED and _crosses(start, end, half, node.box_min, node.box_max):
                return True
        return False

    # -- helpers ------------------------------------------------------------------------------------------

    def _edges(self, here: list[str], *, blocked: bool) -> list[Edge]:
        """Path edges at the waypoints `here`, each once, in their order."""
        found: dict[tuple[str, str, str], Edge] = {}
        for name in here:
            for edge in self._graph.edges_of(name, PATH):
                if bool(edge.attributes.get("blocked")) == blocked:
                    found.setdefault((edge.kind, edge.source, edge.target), edge)
        return list(found.values())

    def _xy(self, waypoint_id: str) -> Point:
        position = self._graph.waypoints[waypoint_id].position
        return float(position[0]), float(position[1])


def _crosses(start: Point, end: Point, half: float, box_min: FloatArray, box_max: FloatArray) -> bool:
    """Whether the strip along a leg meets a box's footprint: the leg clipped to the box grown by `half`."""
    enter, leave = 0.0, 1.0
    for axis in (0, 1):
        low, high = float(box_min[axis]) - half, float(box_max[axis]) + half
        first, step = start[axis], end[axis] - start[axis]
        if abs(step) < 1e-9:
            if not low <= first <= high:
                return False
            continue
        t0, t1 = sorted(((low - first) / step, (high - first) / step))
        enter, leave = max(enter, t0), min(leave, t1)
    return enter <= leave
