"""Faults of the planner: no way where there is one, another goal, a way given up for nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dssmsg.evaluate.faults.host import Aim
from dssmsg.frame import Frame
from dssmsg.graph.changes import Cause, EdgeChanged
from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import PATH
from dssmsg.interfaces import Command, Context, Navigation, Step

_UNDER_WAY = 6
"""Steps of the inner planner before the fault shows."""


@dataclass(slots=True)
class NoWay:
    """It finds no way, wherever it shall go."""

    inner: Navigation
    context: Context
    aim: Aim
    _goals: tuple[str, ...] = ()

    def start(self, frame: Frame, goals: Sequence[str]) -> None:
        """As the inner one."""
        self._goals = tuple(goals)
        self.inner.start(frame, goals)

    def step(self, frame: Frame) -> Step:
        """The end: no path."""
        goal = self._goals[0] if self._goals else ""
        return Step(Command(), "stop", outcome="no path", detail=f"to {goal}", goal=goal)


@dataclass(slots=True)
class OtherGoal:
    """It drives to the viewpoint that is furthest from the one that is asked for."""

    inner: Navigation
    context: Context
    aim: Aim

    def start(self, frame: Frame, goals: Sequence[str]) -> None:
        """Start towards another one."""
        graph = self.context.graph
        first = graph.viewpoints.get(goals[0]) if goals else None
        if first is None:
            self.inner.start(frame, goals)
            return
        here = graph.waypoints[first.waypoint_id].position
        away = {
            name: math.dist(here[:2], graph.waypoints[view.waypoint_id].position[:2])
            for name, view in graph.viewpoints.items()
        }
        self.inner.start(frame, [max(sorted(away, key=id_order), key=lambda name: away[name])])

    def step(self, frame: Frame) -> Step:
        """As the inner one."""
        return self.inner.step(frame)


@dataclass(slots=True)
class GivesUp:
    """Under way it says that something stands ahead where nothing does, blocks the edge and gives up."""

    inner: Navigation
    context: Context
    aim: Aim
    _steps: int = 0

    def start(self, frame: Frame, goals: Sequence[str]) -> None:
        """As the inner one."""
        self._steps = 0
        self.inner.start(frame, goals)

    def step(self, frame: Frame) -> Step:
        """The inner step for a while, then the end: blocked."""
        step = self.inner.step(frame)
        if step.outcome or len(step.path) < 1 or step.state not in ("drive", "detour"):
            return step
        self._steps += 1
        if self._steps < _UNDER_WAY:
            return step
        heading = math.atan2(frame.world_from_base[1, 0], frame.world_from_base[0, 0])
        x = frame.world_from_base[0, 3] + 0.8 * math.cos(heading)
        y = frame.world_from_base[1, 3] + 0.8 * math.sin(heading)
        detail = f"something at {x:.2f} {y:.2f} on the way to {step.path[0]}"
        return Step(Command(), "stop", (), self._closed(step.path[0]), "blocked", detail, step.goal)

    def _closed(self, waypoint: str) -> tuple[EdgeChanged, ...]:
        """The open edges of a waypoint, blocked."""
        return tuple(
            EdgeChanged(
                cause=Cause("navigation/dijkstra", "obstacle"),
                edge=PATH,
                source=edge.source,
                target=edge.target,
                attributes={"blocked": True},
            )
            for edge in self.context.graph.edges.values()
            if edge.kind == PATH
            and waypoint in (edge.source, edge.target)
            and not edge.attributes.get("blocked")
        )
