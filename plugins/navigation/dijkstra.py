"""navigation/dijkstra: over the waypoint topology to a viewpoint, in straight lines (ALGORITHM E).

Dijkstra over the unblocked path edges, from the nearest waypoint to the goal viewpoint's; drive from one to
the next, turn to the viewpoint's heading and tilt. Something in the way blocks the edge, and the way is
planned anew from the waypoint left last. There is no local grid and no way round inside an edge.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.frame import Frame
from dssmsg.geometry import back_project_world
from dssmsg.graph.changes import Cause, EdgeChanged, Score
from dssmsg.graph.paths import edge_key, nearest_waypoint, shortest_path
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.navigation import Step
from dssmsg.interfaces.source import Command
from dssmsg.mission.drive import Driver, base_heading, wrap_angle

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "navigation/dijkstra"
_AHEAD_RAD = 0.3  # the camera sees the way only when the robot faces it
_ON_EDGE_M = 0.15
_STILL_M, _STILL_RAD = 0.01, math.radians(1.0)


class Config(PluginConfig):
    """Options of `navigation: {use: dijkstra}`."""

    linear_speed: float = Field(0.5, gt=0, le=2, description="Fastest driving, metres a second.")
    angular_speed: float = Field(1.2, gt=0, le=4, description="Fastest turning, radians a second.")
    drive_tilt_deg: float = Field(
        -20.0, ge=-80, le=60, description="Tilt of the camera while driving, degrees."
    )
    alternatives: int = Field(
        1,
        ge=1,
        description="How many of the ranked viewpoints may be driven to; the next one only if no way leads "
        "to those before it.",
    )
    max_secs: float = Field(
        240.0, gt=0, description="An episode that takes longer ends `out of time`, seconds."
    )
    stuck_frames: int = Field(
        15, ge=2, description="An episode ends `stuck` after so many frames without motion."
    )
    max_replans: int = Field(
        10, ge=0, description="An episode ends `blocked` after planning anew this often."
    )
    obstacle_range: float = Field(0.6, ge=0, description="How far ahead the way must be clear, metres.")
    obstacle_width: float = Field(
        0.2, gt=0, description="Half the width of the way that must be clear, metres."
    )
    obstacle_height: tuple[float, float] = Field(
        (0.05, 0.9), description="Points between these heights are obstacles, metres above the floor."
    )
    obstacle_points: int = Field(
        25, ge=1, description="Depth pixels in the way that make an obstacle; fewer are taken as noise."
    )


class Dijkstra:
    """Drives one episode at a time; `step` asks for one frame after the other."""

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
        self._goal = ""
        self._goals: tuple[str, ...] = ()
        self._path: tuple[str, ...] = ()
        self._behind: str | None = None
        self._planned = False
        self._replans = 0
        self._began = 0.0
        self._pose = (0.0, 0.0, 0.0)
        self._still = 0

    def start(self, frame: Frame, goals: Sequence[str]) -> None:
        """Begin an episode: viewpoint ids, most wanted first."""
        self._goals = tuple(goals[: self._config.alternatives])
        self._goal, self._path, self._behind, self._planned = "", (), None, False
        self._replans, self._began = 0, frame.sim_time
        self._pose, self._still = _pose(frame), 0

    def step(self, frame: Frame) -> Step:
        """The next command, or the end of the episode: success, no path, blocked, stuck, out of time."""
        if frame.sim_time - self._began > self._config.max_secs:
            return self._end(frame, "out of time", f"after {self._config.max_secs:g} s")
        if self._is_stuck(frame):
            return self._end(frame, "stuck", f"no motion in {self._still} frames")
        if not self._planned:
            ending = self._plan(frame)
            if ending is not None:
                return ending
        while self._path:
            target = self._xy(self._path[0])
            obstacle = self._obstacle(frame, target)
            if obstacle:
                return self._blocked(frame, obstacle)
            then = self._xy(self._path[1]) if len(self._path) > 1 else None
            command = self._driver.drive_to(
                frame, target, math.radians(self._config.drive_tilt_deg), then=then
            )
            if command is not None:
                state = "turn" if command.linear == 0.0 and command.angular != 0.0 else "drive"
                return Step(command, state, self._path, detail=f"to {self._path[0]}")
            self._behind, self._path = self._path[0], self._path[1:]
        viewpoint = self._graph.viewpoints.get(self._goal)
        if viewpoint is None:
            return self._end(frame, "no path", f"{self._goal} is no longer in the graph")
        command = self._driver.look(frame, viewpoint.heading, viewpoint.tilt)
        if command is not None:
            return Step(command, "look", detail=f"along {self._goal}")
        return self._end(frame, "success", f"at {self._goal}", state="arrived")

    def _plan(self, frame: Frame) -> Step | None:
        """Choose the goal and the way to it; the end of the episode if there is none."""
        x, y, _heading = _pose(frame)
        start = self._behind or nearest_waypoint(self._graph, x, y)
        for goal in self._goals:
            viewpoint = self._graph.viewpoints.get(goal)
            path = None
            if viewpoint is not None and start is not None:
                path = shortest_path(self._graph, start, viewpoint.waypoint_id)
            if path is not None:
                self._goal, self._path, self._planned = goal, path, True
                if self._behind is None and len(path) > 1 and self._is_between(x, y, path[0], path[1]):
                    self._behind, self._path = path[0], path[1:]
                return None
        if not self._goals:
            return self._end(frame, "no path", "no goal was given")
        after = f" after {self._replans} blocked edges" if self._replans else ""
        return self._end(frame, "no path", f"from {start} to {', '.join(self._goals)}{after}")

    def _blocked(self, frame: Frame, obstacle: int) -> Step:
        """Mark the edge under the robot as blocked and plan anew from where it began."""
        ahead = self._path[0]
        edge = None if self._behind is None else self._graph.edges.get(edge_key(self._behind, ahead))
        detail = f"{obstacle} points in the way to {ahead}"
        if edge is None:
            return self._end(frame, "blocked", f"{detail}, and no edge to leave out")
        self._replans += 1
        changes = (
            EdgeChanged(
                cause=Cause(PLUGIN, "obstacle"),
                scores=(Score("obstacle_points", float(obstacle), float(self._config.obstacle_points)),),
                edge=edge.kind,
                source=edge.source,
                target=edge.target,
                attributes={"blocked": True},
            ),
        )
        if self._replans > self._config.max_replans:
            ending = self._end(frame, "blocked", f"{detail}; planned anew {self._config.max_replans} times")
            return Step(ending.command, ending.state, (), changes, ending.outcome, ending.detail)
        self._path, self._planned = (), False
        return Step(self._stop(frame), "replan", (), changes, detail=detail)

    def _obstacle(self, frame: Frame, target: tuple[float, float]) -> int:
        """How many depth pixels lie in the way to `target`, 0 if fewer than make an obstacle."""
        x, y, heading = _pose(frame)
        dx, dy = target[0] - x, target[1] - y
        distance = math.hypot(dx, dy)
        if distance < 1e-6 or abs(wrap_angle(math.atan2(dy, dx) - heading)) > _AHEAD_RAD:
            return 0
        config = self._config
        reach = min(config.obstacle_range, distance + config.obstacle_width)
        close = (frame.depth > 0) & (frame.depth < 2 * reach + 1.0)
        points = back_project_world(frame.depth, frame.camera, frame.world_from_camera, close)
        along = ((points[:, 0] - x) * dx + (points[:, 1] - y) * dy) / distance
        aside = np.abs((points[:, 0] - x) * dy - (points[:, 1] - y) * dx) / distance
        low, high = config.obstacle_height
        inside = (along > 0) & (along < reach) & (aside < config.obstacle_width)
        inside &= (points[:, 2] > low) & (points[:, 2] < high)
        count = int(np.count_nonzero(inside))
        return count if count >= config.obstacle_points else 0

    def _is_stuck(self, frame: Frame) -> bool:
        pose = _pose(frame)
        moved = math.hypot(pose[0] - self._pose[0], pose[1] - self._pose[1])
        turned = abs(wrap_angle(pose[2] - self._pose[2]))
        if moved > _STILL_M or turned > _STILL_RAD:
            self._pose, self._still = pose, 0
        else:
            self._still += 1
        return self._still > self._config.stuck_frames

    def _is_between(self, x: float, y: float, first: str, second: str) -> bool:
        """Whether the robot already stands on the edge, so that going back to its beginning is in vain."""
        (ax, ay), (bx, by) = self._xy(first), self._xy(second)
        length = math.hypot(bx - ax, by - ay)
        if length < 1e-6:
            return False
        along = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length
        aside = abs((x - ax) * (by - ay) - (y - ay) * (bx - ax)) / length
        return 0.0 <= along <= length and aside <= _ON_EDGE_M

    def _xy(self, waypoint_id: str) -> tuple[float, float]:
        position = self._graph.waypoints[waypoint_id].position
        return float(position[0]), float(position[1])

    def _stop(self, frame: Frame) -> Command:
        return self._driver.stop(frame, math.radians(self._config.drive_tilt_deg))

    def _end(self, frame: Frame, outcome: str, detail: str, state: str = "stop") -> Step:
        return Step(self._driver.stop(frame, frame.tilt_rad), state, (), (), outcome, detail)


def _pose(frame: Frame) -> tuple[float, float, float]:
    """x, y (world metres) and heading (radians) of the base."""
    base = frame.world_from_base
    return float(base[0, 3]), float(base[1, 3]), base_heading(base)


@hookimpl
def register_navigation(register: Register) -> None:
    """`dijkstra`: straight lines between waypoints."""
    register("dijkstra", Dijkstra, config=Config)
