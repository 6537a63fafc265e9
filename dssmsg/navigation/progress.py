"""Where a drive over the waypoints stands."""

from __future__ import annotations

from dataclasses import dataclass, field

from dssmsg.navigation.gaze import Gazes
from dssmsg.navigation.grid import Point
from dssmsg.navigation.surroundings import Obstacle


@dataclass(slots=True)
class Progress:
    """One drive to one of several viewpoints. `path`: waypoints still to visit; `behind`: the one left last.

    `corners`: what is left of a detour, which leads to the way's point `leg`; `free`: whether they lead all
    the way over floor that was only seen; `unreachable`: waypoints that could not be got to from where the
    robot stood without an edge to blame; `closed`: edges that the drive gave up itself; `reopened`: whether
    it has hoped for those again; `avoided`: what the detour leads round; `found`: what is being looked at
    before its edge is given up; `kept_off`: where it was tried last to keep off something close.
    """

    goals: tuple[str, ...] = ()
    goal: str = ""
    path: tuple[str, ...] = ()
    behind: str | None = None
    planned: bool = False
    replans: int = 0
    detours: int = 0
    corners: tuple[Point, ...] = ()
    leg: int = 0
    free: bool = False
    unreachable: set[str] = field(default_factory=set)
    closed: set[tuple[str, str, str]] = field(default_factory=set)
    reopened: bool = False
    avoided: Obstacle | None = None
    found: Obstacle | None = None
    kept_off: Point | None = None
    inspecting: Gazes | None = None
    gazes: Gazes | None = None
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    still: int = 0

    def leave_detour(self) -> None:
        """Go straight to the next waypoint again."""
        self.corners, self.leg, self.free = (), 0, False

    def plan_anew(self) -> None:
        """Forget the way, as waypoints of it have left the map."""
        self.leave_detour()
        self.planned, self.found, self.inspecting = False, None, None

    def advance(self) -> None:
        """A point of the way, or a corner of a detour, was reached."""
        passed = 1
        if self.corners:
            self.corners = self.corners[1:]
            if self.corners:
                return
            passed, self.leg, self.free = self.leg, 0, False
        if passed:
            self.behind, self.path = self.path[passed - 1], self.path[passed:]
            self.detours, self.avoided = 0, None
