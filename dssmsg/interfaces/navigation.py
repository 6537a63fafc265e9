"""navigation: graph + goal + frame -> command, edge changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from dssmsg.frame import Frame
from dssmsg.graph.changes import Change
from dssmsg.interfaces.source import Command


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """What to do next. `outcome` is empty while under way, `success`, or the named reason of the end.

    `state` is one word for the timeline (turn, drive, detour, inspect, replan, look, arrived);
    `path` the waypoint ids still to visit, the goal last; `goal` the viewpoint that is driven to.
    `at_stop`: the frame this step was made from was taken while standing and looking on purpose, at the goal
    (state look) or at an obstacle (inspect). Such frames become key frames, and whoever asked for the drive
    judges by those of state look whether what was sought is there.
    """

    command: Command
    state: str
    path: tuple[str, ...] = ()
    changes: tuple[Change, ...] = ()
    outcome: str = ""
    detail: str = ""
    goal: str = ""
    at_stop: bool = False


@runtime_checkable
class Navigation(Protocol):
    """Drives to a viewpoint over the waypoint topology. The graph is `context.graph`."""

    def start(self, frame: Frame, goals: Sequence[str]) -> None:
        """Begin to drive: viewpoint ids, most wanted first. May be called again within an episode."""
        ...

    def step(self, frame: Frame) -> Step:
        """The next command from the newest frame."""
        ...


@runtime_checkable
class WatchesFloor(Protocol):
    """What a navigation may offer, too: it learns from every frame, also where it is not asked to drive."""

    def watch(self, frame: Frame) -> None:
        """A frame of the mission, its truth removed; frames that `step` was asked about come as well."""
        ...


@runtime_checkable
class FeelsTouch(Protocol):
    """What a navigation may offer, too: it remembers what the robot has touched."""

    def touched(self, frame: Frame, command: Command) -> None:
        """The command that led to this frame drove the robot against something."""
        ...
