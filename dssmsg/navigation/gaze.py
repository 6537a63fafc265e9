"""Looking at several directions one after the other while standing."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dssmsg.frame import Frame
from dssmsg.interfaces.source import Command
from dssmsg.navigation.drive import TILT_RANGE_RAD, Driver, wrap_angle

_REACHED_RAD = math.radians(1.0)


class Gazes:
    """(heading, tilt) pairs in world radians, looked at in order.

    One that is not reached in `patience` frames is left out.
    """

    def __init__(self, gazes: Sequence[tuple[float, float]], patience: int = 15) -> None:
        low, high = TILT_RANGE_RAD
        self._gazes = [(heading, min(max(tilt, low), high)) for heading, tilt in gazes]
        self._patience = patience
        self._frames = 0

    def advance(self, frame: Frame, driver: Driver) -> tuple[Command | None, bool]:
        """The next command, None when all were looked at; and whether this very frame is one of the looks."""
        reached = bool(self._gazes) and self._is_at(frame, *self._gazes[0])
        if reached or self._frames > self._patience:
            self._gazes, self._frames = self._gazes[1:], 0
        if not self._gazes:
            return None, reached
        self._frames += 1
        return driver.gaze(frame, *self._gazes[0]), reached

    @staticmethod
    def _is_at(frame: Frame, heading: float, tilt: float) -> bool:
        turn = abs(wrap_angle(frame.heading_rad - heading))
        return turn < _REACHED_RAD and abs(frame.tilt_rad - tilt) < _REACHED_RAD
