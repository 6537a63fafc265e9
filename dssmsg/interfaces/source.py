"""source: gives frames, takes commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from dssmsg.frame import Camera, Frame


@dataclass(frozen=True, slots=True)
class Command:
    """What the robot shall do until the next frame.

    linear m/s forward, angular rad/s counter-clockwise; pan and tilt are absolute camera angles in
    radians (pan counter-clockwise from straight ahead, tilt negative = down), reached as fast as the
    mount turns.
    """

    linear: float = 0.0
    angular: float = 0.0
    pan: float = 0.0
    tilt: float = 0.0


@dataclass(frozen=True, slots=True)
class Stop:
    """A place of the survey tour where the robot stands and looks.

    `via` are the corner points (x, y) to drive through on the way from the previous stop, in order;
    `views` are (heading_rad, tilt_rad) pairs in world axes, looked at in order.
    """

    name: str
    x: float
    y: float
    views: tuple[tuple[float, float], ...]
    via: tuple[tuple[float, float], ...] = ()
    room: str = ""


@dataclass(frozen=True, slots=True)
class SourceInfo:
    """What a source says of itself before the first frame.

    `visits` is how many passes it has to give (None: as many as asked for); a source that is not
    `drivable` ignores commands; `tours` holds one tour a visit (empty: nothing to drive);
    `credits` are lines to show for the assets in use; `facts` go into the recording's properties.
    """

    name: str
    camera: Camera
    drivable: bool
    has_truth: bool
    visits: int | None = 1
    rate_hz: float = 5.0
    scene: str = ""
    tours: tuple[tuple[Stop, ...], ...] = ()
    credits: tuple[str, ...] = ()
    depth_noise_m: tuple[float, float] = (0.001, 0.0)
    """(a, b) of the sensor's depth noise sigma(z) = a + b z^2, metres."""
    accelerations: tuple[float, float] = (1.0, 3.0)
    """How fast the robot's speeds can change: linear m/s2, angular rad/s2."""
    facts: Mapping[str, Any] = field(default_factory=dict)


@runtime_checkable
class Source(Protocol):
    """Gives frames, takes commands.

    The host calls `start_visit(0)`, then `step` until it returns None, then `start_visit(1)`, ...
    A drivable source never returns None by itself: the mission decides when a visit is over.
    """

    @property
    def info(self) -> SourceInfo:
        """What this source is; constant over its life."""
        ...

    def start_visit(self, visit: int) -> None:
        """Begin a pass through the scene; changes scripted to happen before it are made here."""
        ...

    def step(self, command: Command | None) -> Frame | None:
        """Carry out `command` for one camera period; the frame at its end, None when the visit is over."""
        ...

    def collisions(self) -> int:
        """How many control steps so far had the robot in contact with something that is not the floor."""
        ...

    def close(self) -> None:
        """Release what is held; safe to call twice."""
        ...
