"""navigation/dijkstra: over the waypoint topology to a viewpoint, round what stands in the way (ALGORITHM E).

Dijkstra over the unblocked path edges, from the nearest waypoint to the goal viewpoint's; drive from one to
the next in straight lines, as long as a rolling grid of what depth has shown has nothing in the corridor
ahead. Something there is driven round inside the grid (A*). Where that fails the robot looks at it, so that
it enters the map, and if that shows no way round either blocks the edge, goes back to the waypoint left last
and plans anew. At the goal it looks along the viewpoint's heading and tilt, then around.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from pydantic import Field

from dssmsg.frame import Frame
from dssmsg.graph.changes import Cause, EdgeChanged, Score
from dssmsg.graph.nodes import Edge
from dssmsg.graph.outlines import Outlines
from dssmsg.graph.paths import edge_key, nearest_waypoints, shortest_path
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.navigation import Step
from dssmsg.interfaces.source import Command
from dssmsg.navigation.drive import Driver, wrap_angle
from dssmsg.navigation.gaze import Gazes
from dssmsg.navigation.grid import GridOptions, Point
from dssmsg.navigation.pose import floor_place, floor_pose, is_on_leg
from dssmsg.navigation.progress import Progress
from dssmsg.navigation.surroundings import Obstacle, Surroundings

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "navigation/dijkstra"
_ON_EDGE_M = 0.15
_STILL_M, _STILL_RAD = 0.01, math.radians(1.0)
_FIRST_WAYPOINTS = 5
"""So many of the waypoints around the robot are tried as the first one."""
_INSPECT_RAD = math.radians(7.0)
_INSPECT_TILT_RAD = math.radians(-12.0)
_FIRST_M = 3.0
"""Further off than this only the very nearest is."""
_MAX_DETOURS = 6
"""More detours than this on the way to one waypoint lead nowhere."""
_AS_DRIVEN_M = 0.06
"""Nearer to an edge than this the robot drives it as it was driven before."""
_FLAT_M = 0.12
"""Things lower than this (rugs) have no outline to keep off."""
_LOOK_AGAIN_M = 0.3
"""After so many metres it is tried again to keep off what the way passes closely."""


class Config(PluginConfig):
    """Options of `navigation: {use: dijkstra}`."""

    linear_speed: float = Field(0.5, gt=0, le=2, description="Fastest driving, metres a second.")
    angular_speed: float = Field(1.2, gt=0, le=4, description="Fastest turning, radians a second.")
    drive_tilt_deg: float = Field(
        -20.0, ge=-80, le=60, description="Tilt of the camera while driving, degrees."
    )
    alternatives: int = Field(
        5, ge=1, description="How many viewpoints may be driven to; the next only if no way leads to one."
    )
    stuck_frames: int = Field(15, ge=2, description="A drive ends `stuck` after so many frames at rest.")
    max_replans: int = Field(10, ge=0, description="A drive ends `blocked` after planning anew this often.")
    obstacle_range: float = Field(1.5, ge=0, description="How far ahead the way must be clear, metres.")
    obstacle_width: float = Field(
        0.15, gt=0, le=1, description="Half the width of a driven way that must be clear, metres."
    )
    obstacle_height: tuple[float, float] = Field(
        (0.05, 0.9), description="Points between these heights are obstacles, metres above the floor."
    )
    obstacle_points: int = Field(
        3, ge=1, description="Depth pixels in a 5 cm cell that make an obstacle; fewer are noise."
    )
    robot_radius: float = Field(0.18, gt=0, le=1, description="Radius of the robot, metres.")
    detour: bool = Field(True, description="Whether obstacles are driven round before an edge is given up.")
    look_around: tuple[tuple[float, float], ...] = Field(
        ((0, 0), (6, 0), (-6, 0), (35, 0), (0, -20), (-35, 0)),
        min_length=1,
        description="Looks at the goal: (heading, tilt) in degrees relative to the viewpoint's.",
    )


class Dijkstra:
    """Drives to one viewpoint at a time; `step` asks for one frame after the other."""

    def __init__(self, config: Config, context: Context) -> None:
        self._config = config
        self._graph = context.graph
        source = context.source
        linear_acceleration, angular_acceleration = (1.0, 3.0) if source is None else source.accelerations
        self._driver = Driver(
            config.linear_speed,
            config.angular_speed,
            5.0 if source is None else source.rate_hz,
            linear_acceleration=linear_acceleration,
            angular_acceleration=angular_acceleration,
        )
        low, high = config.obstacle_height
        noise = GridOptions().noise if source is None else source.depth_noise_m
        self._floor = Surroundings(
            GridOptions(low=low, high=high, min_pixels=config.obstacle_points, noise=noise),
            config.robot_radius,
            config.obstacle_width,
            config.obstacle_range,
            Outlines(context.graph, max(low, _FLAT_M), high),
        )
        self._now = Progress()

    def start(self, frame: Frame, goals: Sequence[str]) -> None:
        """Begin a drive: viewpoint ids, most wanted first. What the grid knows of this visit stays known."""
        self._now = Progress(self._first_places(goals), pose=floor_pose(frame))

    def watch(self, frame: Frame) -> None:
        """Learn the floor from a frame that asks for no command, such as those of a survey."""
        self._floor.observe(frame)

    def touched(self, frame: Frame, command: Command) -> None:
        """A command has led against something: for the rest of the visit something stands there."""
        self._floor.observe(frame)
        self._floor.touch(frame, backwards=command.linear < 0)

    def step(self, frame: Frame) -> Step:
        """The next command, or the end of the drive: success, no path, blocked, stuck."""
        now = self._now
        self._floor.observe(frame)
        if self._is_stuck(frame):
            return self._end(frame, "stuck", f"no motion in {now.still} frames")
        if any(name not in self._graph.waypoints for name in now.path):
            # An isolated waypoint has left the map.
            now.plan_anew()
        if now.inspecting is not None and now.found is not None:
            return self._inspect(frame, now.inspecting, now.found)
        if not now.planned:
            ending = self._plan(frame)
            if ending is not None:
                return ending
        step = self._drive(frame)
        return self._look(frame) if step is None else step

    def _first_places(self, goals: Sequence[str]) -> tuple[str, ...]:
        """The best viewpoint of each of the first waypoints, as many as may be driven to."""
        best: dict[str, str] = {}
        for goal in goals:
            viewpoint = self._graph.viewpoints.get(goal)
            best.setdefault(goal if viewpoint is None else viewpoint.waypoint_id, goal)
        return tuple(best.values())[: self._config.alternatives]

    # -- planning -----------------------------------------------------------------------------------------

    def _plan(self, frame: Frame) -> Step | None:
        """Choose the goal and the way to it; the end of the drive if there is none."""
        now, (x, y) = self._now, floor_place(frame)
        if now.behind is not None and now.behind in self._graph.waypoints:
            starts: tuple[str, ...] = (now.behind,)
        else:
            now.behind = None
            near = nearest_waypoints(self._graph, x, y, _FIRST_WAYPOINTS + len(now.unreachable))
            free = [name for name in near if name not in now.unreachable]
            starts = tuple(n for n in free if n == free[0] or math.dist((x, y), self._xy(n)) <= _FIRST_M)
        # Where no way is open: over floor that was seen free, though never driven. Then over edges that this
        # drive has not found blocked itself: what stood there may be gone, and only who goes there sees it.
        if self._is_over_edges((x, y), starts, None) or self._is_over_seen_floor((x, y)):
            return None
        if self._is_over_edges((x, y), starts, self._may_be_open):
            return None
        if not now.goals:
            return self._end(frame, "no path", "no goal was given")
        if self._config.detour and now.closed and not now.reopened:
            now.closed, now.reopened = set(), True  # from elsewhere there may be a way round after all
            return self._plan(frame)
        after = f" after {now.replans} blocked edges" if now.replans else ""
        if now.unreachable and not starts:
            return self._end(frame, "blocked", f"no waypoint can be reached from here{after}")
        place = starts[0] if starts else "nowhere"
        return self._end(frame, "no path", f"from {place} to {', '.join(now.goals)}{after}")

    def _is_over_edges(
        self, here: Point, starts: Sequence[str], try_blocked: Callable[[Edge], bool] | None
    ) -> bool:
        """Whether edges lead to one of the goals; the first that can be reached is the goal from now on."""
        now = self._now
        for goal, start in itertools.product(now.goals, starts):
            viewpoint = self._graph.viewpoints.get(goal)
            if viewpoint is None:
                continue
            path = shortest_path(self._graph, start, viewpoint.waypoint_id, try_blocked=try_blocked)
            if path is None:
                continue
            now.goal, now.path, now.planned, now.detours = goal, path, True, 0
            now.leave_detour()
            if (
                now.behind is None
                and len(path) > 1
                and is_on_leg(here, self._xy(path[0]), self._xy(path[1]), _ON_EDGE_M)
            ):
                now.behind, now.path = path[0], path[1:]
            return True
        return False

    def _is_over_seen_floor(self, here: Point) -> bool:
        """Whether floor that was seen free leads to one of the goals, or close to it; the robot is on it."""
        now = self._now
        if not self._config.detour:
            return False
        for goal in now.goals:
            viewpoint = self._graph.viewpoints.get(goal)
            end = None if viewpoint is None else self._xy(viewpoint.waypoint_id)
            corners = None if end is None else self._floor.free_way(here, end)
            if viewpoint is None or end is None or corners is None:
                continue
            now.goal, now.path, now.planned, now.detours = goal, (viewpoint.waypoint_id,), True, 0
            now.behind, now.avoided = None, None
            # The last corner is the waypoint itself, or stands in for it.
            now.corners, now.leg, now.free = corners, 1, True
            return True
        return False

    def _may_be_open(self, edge: Edge) -> bool:
        return edge_key(edge.source, edge.target) not in self._now.closed

    # -- driving ------------------------------------------------------------------------------------------

    def _drive(self, frame: Frame) -> Step | None:
        """The command along the way; None at its end."""
        now, tilt = self._now, math.radians(self._config.drive_tilt_deg)
        while now.path:
            here, way = floor_place(frame), [self._xy(name) for name in now.path]
            if not self._is_passable(here, way):
                now.leave_detour()
                return self._blocked(frame, here, way)
            points = [*now.corners, *way[now.leg :]]
            then = points[1] if len(points) > 1 else None
            command = self._driver.drive_to(frame, points[0], tilt, then=then)
            if command is not None:
                state = "turn" if command.linear == 0.0 and command.angular != 0.0 else "drive"
                state = "detour" if now.corners else state
                return Step(command, state, now.path, detail=f"to {now.path[0]}", goal=now.goal)
            now.advance()
        return None

    def _is_passable(self, here: Point, way: Sequence[Point]) -> bool:
        """Whether the way is clear, or a detour leads round what is in it."""
        now = self._now
        points = [*now.corners, *way[now.leg :]]
        found = self._floor.obstacle(here, points, self._undriven(here))
        if found is None:
            self._keep_off(here, way)
            return True
        if not now.corners:
            now.avoided = found
        return self._leads_round(here, way)

    def _undriven(self, here: Point) -> int:
        """How many of the next legs never were driven: a detour's, and the one back onto the way."""
        now = self._now
        if now.corners:
            return len(now.corners) + (now.leg < len(now.path))
        ends = self._edge_ends(0)
        if ends is None:
            return 1
        return 0 if is_on_leg(here, self._xy(ends[0]), self._xy(ends[1]), _AS_DRIVEN_M) else 1

    def _keep_off(self, here: Point, way: Sequence[Point]) -> None:
        """Where the way passes something closely and there is room, drive in a bend round it."""
        now = self._now
        tried = now.kept_off is not None and math.dist(here, now.kept_off) < _LOOK_AGAIN_M
        points = [*now.corners, *way[now.leg :]]
        if tried or not self._config.detour or self._floor.close_by(here, points) is None:
            return
        now.kept_off = here
        if now.free:
            self._leads_round(here, way)
            return
        # On a detour already, only what has entered the map since then is worth another one.
        detour = self._floor.way_round(here, way, berth=bool(now.corners))
        if detour is not None and detour.leg < len(way):
            now.corners, now.leg = detour.corners, detour.leg

    def _leads_round(self, here: Point, way: Sequence[Point]) -> bool:
        """Whether there is a detour; the robot is on it from now on."""
        now = self._now
        if not self._config.detour or now.detours >= _MAX_DETOURS:
            return False
        if now.free:
            tried = now.detours + 1
            found = self._is_over_seen_floor(here)
            now.detours = tried
            return found
        detour = self._floor.way_round(here, way, far=self._is_only_way())
        if detour is None:
            return False
        now.corners, now.leg = detour.corners, detour.leg
        now.detours += 1
        return True

    def _is_only_way(self) -> bool:
        """Whether no other edges lead to the goal than the one on which something stands."""
        now = self._now
        if now.avoided is None or (ends := self._edge_ends(now.avoided.leg)) is None:
            return True
        return shortest_path(self._graph, ends[0], now.path[-1], without=edge_key(*ends)) is None

    def _edge_ends(self, leg: int) -> tuple[str, str] | None:
        """The waypoints between which the leg of that number leads; None for the way to the first one."""
        now = self._now
        ends = [now.behind, *now.path][leg : leg + 2]
        if len(ends) < 2 or ends[0] is None or ends[1] is None:
            return None
        return (ends[0], ends[1]) if edge_key(ends[0], ends[1]) in self._graph.edges else None

    def _blocked(self, frame: Frame, here: Point, way: Sequence[Point]) -> Step:
        """No way round: look at what stands there, then give the edge up."""
        now = self._now
        # Where only the detour is closed, what it should have led round is still there.
        now.found = self._floor.obstacle(here, way, self._undriven(here)) or now.avoided
        if now.found is None:
            return Step(self._stop(frame), "replan", now.path, detail="a detour was closed", goal=now.goal)
        x, y = now.found.place
        bearing = math.atan2(y - here[1], x - here[0])
        turns = (-_INSPECT_RAD, 0.0, _INSPECT_RAD)
        now.inspecting = Gazes([(bearing + turn, _INSPECT_TILT_RAD) for turn in turns])
        return self._inspect(frame, now.inspecting, now.found)

    def _inspect(self, frame: Frame, gazes: Gazes, found: Obstacle) -> Step:
        """Look at the obstacle; if that shows no way round it, block the edge that it stands on."""
        now = self._now
        command, at_stop = gazes.advance(frame, self._driver)
        x, y = found.place
        detail = f"something at {x:.2f} {y:.2f} on the way to {now.path[min(found.leg, len(now.path) - 1)]}"
        if command is not None:
            return Step(command, "inspect", now.path, detail=detail, goal=now.goal, at_stop=at_stop)
        now.found = now.inspecting = None
        if self._leads_round(floor_place(frame), [self._xy(name) for name in now.path]):
            command = self._stop(frame)
            return Step(command, "detour", now.path, detail=detail, goal=now.goal, at_stop=at_stop)
        return self._give_up_edge(frame, found, detail, at_stop)

    def _give_up_edge(self, frame: Frame, found: Obstacle, detail: str, at_stop: bool) -> Step:
        """Block the edge under an obstacle, and plan anew from the waypoint left last."""
        now = self._now
        ends = self._edge_ends(found.leg)
        path, now.path, now.planned, now.replans = now.path, (), False, now.replans + 1
        now.avoided = None
        if now.replans > self._config.max_replans:
            ending = f"{detail}; planned anew {self._config.max_replans} times"
            return self._end(frame, "blocked", ending, at_stop=at_stop)
        edge = None if ends is None else self._graph.edges[edge_key(*ends)]
        if edge is None:
            now.unreachable.add(path[0])
            now.behind = None
            return Step(self._stop(frame), "replan", detail=detail, at_stop=at_stop)
        if found.leg > 0:
            now.behind = None  # the waypoint before the edge is ahead: the way there is planned from here
        now.closed.add(edge_key(edge.source, edge.target))
        change = EdgeChanged(
            cause=Cause(PLUGIN, "obstacle"),
            scores=(
                Score("occupied_cells", float(found.cells), 1.0),
                Score("corridor_half_width_m", self._config.obstacle_width),
            ),
            edge=edge.kind,
            source=edge.source,
            target=edge.target,
            attributes={"blocked": True, "obstacle": self._place_on(edge, found.place)},
        )
        return Step(self._stop(frame), "replan", (), (change,), detail=detail, at_stop=at_stop)

    def _place_on(self, edge: Edge, place: Point) -> list[float]:
        """Where (x, y) the edge itself is blocked, as far as the grid shows it; else `place`."""
        on_edge = self._floor.blocked_place(self._xy(edge.source), self._xy(edge.target))
        return [round(value, 3) for value in on_edge or place]

    # -- arriving -----------------------------------------------------------------------------------------

    def _look(self, frame: Frame) -> Step:
        """Look along the goal viewpoint, and around."""
        now = self._now
        if now.gazes is None:
            viewpoint = self._graph.viewpoints.get(now.goal)
            if viewpoint is None:
                return self._end(frame, "no path", f"{now.goal} is no longer in the graph")
            now.gazes = Gazes(
                [
                    (viewpoint.heading + math.radians(turn), viewpoint.tilt + math.radians(tilt))
                    for turn, tilt in self._config.look_around
                ]
            )
        command, at_stop = now.gazes.advance(frame, self._driver)
        if command is None:
            return self._end(frame, "success", f"at {self._now.goal}", state="arrived", at_stop=at_stop)
        return Step(command, "look", detail=f"along {self._now.goal}", goal=self._now.goal, at_stop=at_stop)

    # -- helpers ------------------------------------------------------------------------------------------

    def _is_stuck(self, frame: Frame) -> bool:
        pose = floor_pose(frame)
        moved = math.hypot(pose[0] - self._now.pose[0], pose[1] - self._now.pose[1])
        turned = abs(wrap_angle(pose[2] - self._now.pose[2]))
        looking = (
            self._now.inspecting is not None or self._now.gazes is not None
        )  # only the mount may turn then
        if moved > _STILL_M or turned > _STILL_RAD or looking:
            self._now.pose, self._now.still = pose, 0
        else:
            self._now.still += 1
        return self._now.still > self._config.stuck_frames

    def _xy(self, waypoint_id: str) -> Point:
        position = self._graph.waypoints[waypoint_id].position
        return float(position[0]), float(position[1])

    def _stop(self, frame: Frame) -> Command:
        return self._driver.stop(frame, math.radians(self._config.drive_tilt_deg))

    def _end(
        self, frame: Frame, outcome: str, detail: str, state: str = "stop", at_stop: bool = False
    ) -> Step:
        command = self._driver.stop(frame, frame.tilt_rad)
        return Step(command, state, (), (), outcome, detail, self._now.goal, at_stop)


@hookimpl
def register_navigation(register: Register) -> None:
    """`dijkstra`: over the waypoints, round obstacles."""
    register("dijkstra", Dijkstra, config=Config)
