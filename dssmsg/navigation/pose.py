"""Where the robot is on the floor, read off a frame."""

from __future__ import annotations

import math

from dssmsg.frame import Frame
from dssmsg.navigation.drive import base_heading


def floor_pose(frame: Frame) -> tuple[float, float, float]:
    """x, y (world metres) and heading (radians) of the base."""
    base = frame.world_from_base
    return float(base[0, 3]), float(base[1, 3]), base_heading(base)


def floor_place(frame: Frame) -> tuple[float, float]:
    """x, y (world metres) of the base."""
    return float(frame.world_from_base[0, 3]), float(frame.world_from_base[1, 3])


def is_on_leg(
    place: tuple[float, float], start: tuple[float, float], end: tuple[float, float], width: float
) -> bool:
    """Whether a place lies between the ends of a straight leg, at most `width` metres beside it."""
    (ax, ay), (bx, by) = start, end
    length = math.hypot(bx - ax, by - ay)
    if length < 1e-6:
        return False
    along = ((place[0] - ax) * (bx - ax) + (place[1] - ay) * (by - ay)) / length
    aside = abs((place[0] - ax) * (by - ay) - (place[1] - ay) * (bx - ax)) / length
    return 0.0 <= along <= length and aside <= width
