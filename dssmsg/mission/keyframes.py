"""Which frames perception runs on (ALGORITHM A.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dssmsg.config import MissionConfig
from dssmsg.frame import FloatArray, Frame


@dataclass(frozen=True, slots=True)
class KeyFrameRule:
    """Three a heading at a stop, 5 deg or 5 cm apart; while driving each 0.5 m or 30 deg.

    "A heading" is a bin around the first key frame of it, as wide as viewpoints match (20 deg, same
    tilt, 0.5 m). Turning in place between two headings gives no key frame: it is neither.
    """

    per_heading: int = 3
    stop_step_m: float = 0.05
    stop_step_rad: float = math.radians(5)
    heading_rad: float = math.radians(20)
    tilt_rad: float = math.radians(6)
    place_m: float = 0.5
    drive_step_m: float = 0.5
    drive_step_rad: float = math.radians(30)


def key_frame_rule(mission: MissionConfig) -> KeyFrameRule:
    """The rule of a configured mission: as many key frames a heading, as far apart, as it looks."""
    return KeyFrameRule(
        per_heading=mission.views_per_heading,
        stop_step_rad=min(KeyFrameRule().stop_step_rad, math.radians(mission.heading_step_deg)),
    )


class KeyFrameSelector:
    """Decides frame by frame; remembers one visit only, so its cost does not grow."""

    def __init__(self, rule: KeyFrameRule | None = None) -> None:
        self.rule = rule or KeyFrameRule()
        self._visit = -1
        self._last: Frame | None = None
        self._previous_position: FloatArray | None = None
        self._bins: list[tuple[FloatArray, float, float, int]] = []

    def is_key(self, frame: Frame) -> bool:
        """Whether perception shall run on this frame; frames must come in order."""
        if frame.visit != self._visit:
            self._visit, self._last, self._bins, self._previous_position = frame.visit, None, [], None
        previous, self._previous_position = self._previous_position, frame.position
        key = self._is_stop_key(frame) if frame.at_stop else self._is_drive_key(frame, previous)
        if key:
            self._last = frame
        return key

    def _is_stop_key(self, frame: Frame) -> bool:
        rule = self.rule
        if self._last is not None and self._last.at_stop and not self._apart(frame, self._last):
            return False
        # Bins of places left behind cannot be met again from here in this visit's next frames.
        self._bins = [b for b in self._bins if np.linalg.norm(b[0] - frame.position) <= rule.place_m]
        for i, (position, heading, tilt, count) in enumerate(self._bins):
            if (
                angle_between(heading, frame.heading_rad) <= rule.heading_rad
                and abs(tilt - frame.tilt_rad) <= rule.tilt_rad
            ):
                if count >= rule.per_heading:
                    return False
                self._bins[i] = (position, heading, tilt, count + 1)
                return True
        self._bins.append((frame.position, frame.heading_rad, frame.tilt_rad, 1))
        return True

    def _is_drive_key(self, frame: Frame, previous: FloatArray | None) -> bool:
        if self._last is None:
            return True
        if previous is None or float(np.linalg.norm(frame.position - previous)) < 0.02:
            return False
        moved = float(np.linalg.norm(frame.position - self._last.position))
        turned = angle_between(frame.heading_rad, self._last.heading_rad)
        return moved >= self.rule.drive_step_m or turned >= self.rule.drive_step_rad

    def _apart(self, a: Frame, b: Frame) -> bool:
        return (
            float(np.linalg.norm(a.position - b.position)) >= self.rule.stop_step_m
            or angle_between(a.heading_rad, b.heading_rad) >= self.rule.stop_step_rad - 1e-3
            or abs(a.tilt_rad - b.tilt_rad) >= self.rule.stop_step_rad - 1e-3
        )


def angle_between(a: float, b: float) -> float:
    """The absolute difference of two angles in radians, 0..pi."""
    return abs(math.remainder(a - b, math.tau))
