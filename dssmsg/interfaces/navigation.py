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

    `state` is one word for the timeline (turn, drive, look, detour, replan, arrived);
    `path` the waypoint ids still to visit, the goal last.
    """

    command: Command
    state: str
    path: tuple[str, ...] = ()
    changes: tuple[Change, ...] = ()
    outcome: str = ""
    detail: str = ""


@runtime_checkable
class Navigation(Protocol):
    """Drives to a viewpoint over the waypoint topology. The graph is `context.graph`."""

    def start(self, frame: Frame, goals: Sequence[str]) -> None:
        """Begin an episode: viewpoint ids, most wanted first."""
        ...

    def step(self, frame: Frame) -> Step:
        """The next command from the newest frame."""
        ...
