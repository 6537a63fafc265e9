"""Where the robot is on the floor, read off a frame."""

from __future__ import annotations

from dssmsg.frame import Frame
from dssmsg.navigation.drive import base_heading


def floor_pose(frame: Frame) -> tuple[float, float, float]:
    """x, y (world metres) and heading (radians) of the base."""
    base = frame.world_from_base
    return float(base[0, 3]), float(base[1, 3]), base_heading(base)


def floor_place(frame: Frame) -> tuple[float, float]:
    """x, y (world metres) of the base."""
    return float(frame.world_from_base[0, 3]), float(frame.world_from_base[1, 3])
