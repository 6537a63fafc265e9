"""The survey: drive the scene's tour, stop, turn and tilt, look (ALGORITHM E, "before a map exists")."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dssmsg.frame import Frame
from dssmsg.interfaces import Command, Stop
from dssmsg.navigation.drive import Driver, base_heading, wrap_angle

DRIVE_TILT_RAD = math.radians(-20)
"""While driving the camera looks 20 degrees down: obstacles first (SIMULATOR, "Robot")."""


@dataclass(frozen=True, slots=True)
class SurveyStep:
    """What to do after a frame. `at_stop`: this very frame was taken while standing and looking."""

    command: Command
    at_stop: bool
    state: str
    detail: str
    target_xy: tuple[float, float]


class Surveyor:
    """Drives one tour. Feed it every frame; it answers with the next command, None when the tour is done.

    At a stop each view (heading, tilt) is looked at `looks` times, `look_step_rad` apart, so that a
    viewpoint gets several frames that are not copies of each other. The base turns towards the view
    while the pan of the mount takes up what is still missing: the gaze arrives before the base does.

    A stop that the robot cannot reach is skipped after `patience` frames without progress, a view that it
    cannot turn to after as many; `skipped` names them.
    """

    def __init__(
        self,
        tour: tuple[Stop, ...],
        driver: Driver,
        *,
        looks: int = 3,
        look_step_rad: float = math.radians(6),
        patience: int = 25,
    ) -> None:
        self._tour = tour
        self._driver = driver
        self._looks = looks
        self._step = look_step_rad
        self._patience = patience
        self._stop = 0
        self._leg: list[tuple[float, float]] = []
        self._gazes: list[tuple[float, float]] | None = None
        self._gaze_frames = 0
        self._best_distance = math.inf
        self._stale = 0
        self._last_heading: float | None = None
        self.skipped: list[str] = []
        self._begin_leg()

    def advance(self, frame: Frame) -> SurveyStep | None:
        """The next step after `frame`, or None when the last view of the last stop has been seen."""
        at_stop = False
        while self._stop < len(self._tour):
            stop = self._tour[self._stop]
            if self._gazes is None:
                command = self._drive(frame)
                if command is not None:
                    return SurveyStep(command, at_stop, "drive", f"to {stop.name}", self._leg[0])
                continue
            if self._gazes and self._is_at(frame, *self._gazes[0]):
                at_stop = True
                self._next_gaze()
            elif self._gazes and self._gaze_frames > self._patience:
                heading, tilt = (round(math.degrees(angle)) for angle in self._gazes[0])
                self.skipped.append(f"view of {heading} deg, tilt {tilt} deg, at {stop.name}")
                self._next_gaze()
            if self._gazes:
                self._gaze_frames += 1
                command = self._driver.gaze(frame, *self._gazes[0])
                return SurveyStep(command, at_stop, "look", f"at {stop.name}", (stop.x, stop.y))
            self._stop += 1
            self._begin_leg()
        return SurveyStep(Command(), at_stop, "done", "", frame_xy(frame)) if at_stop else None

    def _next_gaze(self) -> None:
        assert self._gazes is not None
        self._gazes.pop(0)
        self._gaze_frames = 0

    def _begin_leg(self) -> None:
        self._gazes, self._gaze_frames = None, 0
        self._best_distance, self._stale = math.inf, 0
        if self._stop < len(self._tour):
            stop = self._tour[self._stop]
            self._leg = [*stop.via, (stop.x, stop.y)]

    def _drive(self, frame: Frame) -> Command | None:
        """The command towards the leg's next corner; None when the leg has ended and looking begins."""
        while self._leg:
            if self._is_stuck(frame):
                self.skipped.append(self._tour[self._stop].name)
                self._stop += 1
                self._begin_leg()
                return None
            then = self._leg[1] if len(self._leg) > 1 else None
            command = self._driver.drive_to(frame, self._leg[0], DRIVE_TILT_RAD, then=then)
            if command is not None:
                return command
            self._leg.pop(0)
            self._best_distance, self._stale = math.inf, 0
        self._gazes = self._order_gazes(frame, self._tour[self._stop])
        return None

    def _is_stuck(self, frame: Frame) -> bool:
        """Whether the robot has neither come nearer nor turned for `patience` frames."""
        x, y = frame_xy(frame)
        distance = math.hypot(self._leg[0][0] - x, self._leg[0][1] - y)
        heading = base_heading(frame.world_from_base)
        turned = self._last_heading is None or abs(wrap_angle(heading - self._last_heading)) > math.radians(1)
        self._last_heading = heading
        if distance < self._best_distance - 0.01 or turned:
            self._best_distance, self._stale = min(distance, self._best_distance), 0
        else:
            self._stale += 1
        return self._stale > self._patience

    def _order_gazes(self, frame: Frame, stop: Stop) -> list[tuple[float, float]]:
        """All (heading, tilt) to look at; each view is swept from the side that the gaze comes from."""
        offsets = [self._step * (i - (self._looks - 1) / 2) for i in range(self._looks)]
        gazes: list[tuple[float, float]] = []
        heading = frame.heading_rad
        for view_heading, tilt in stop.views:
            nearest_first = sorted(offsets, key=lambda o: abs(wrap_angle(view_heading + o - heading)))
            ascending = nearest_first[0] <= nearest_first[-1]
            for offset in offsets if ascending else reversed(offsets):
                gazes.append((wrap_angle(view_heading + offset), tilt))
            heading = gazes[-1][0]
        return gazes

    def _is_at(self, frame: Frame, heading: float, tilt: float) -> bool:
        close = math.radians(1.0)
        return abs(wrap_angle(frame.heading_rad - heading)) < close and abs(frame.tilt_rad - tilt) < close


def frame_xy(frame: Frame) -> tuple[float, float]:
    """Where the robot's base stands, world metres."""
    return float(frame.world_from_base[0, 3]), float(frame.world_from_base[1, 3])
