"""A solid: an upright box turned about z. What the robot can hit, in physics and in planning alike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.frame import FloatArray


@dataclass(frozen=True, slots=True)
class Solid:
    """`center`, `half` extents (x, y, z) in metres, `yaw_rad` about z; `owner` an object's name or ''."""

    center: tuple[float, float, float]
    half: tuple[float, float, float]
    yaw_rad: float = 0.0
    owner: str = ""

    @property
    def bottom(self) -> float:
        """Lowest z."""
        return self.center[2] - self.half[2]

    @property
    def top(self) -> float:
        """Highest z."""
        return self.center[2] + self.half[2]

    def corners(self) -> FloatArray:
        """The footprint's four corners (4, 2), counter-clockwise, world metres."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        local = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.asarray(self.half[:2])
        return np.asarray(local @ np.array([[cos, sin], [-sin, cos]]) + np.asarray(self.center[:2]))


def overlap_depth(first: Solid, second: Solid) -> float:
    """How deep two solids penetrate each other, metres; 0 or negative when they do not.

    Separating-axis test over the four footprint directions and z; the smallest overlap is the depth.
    """
    depth = min(first.top, second.top) - max(first.bottom, second.bottom)
    corners = (first.corners(), second.corners())
    for yaw in (first.yaw_rad, second.yaw_rad):
        for angle in (yaw, yaw + math.pi / 2):
            axis = np.array([math.cos(angle), math.sin(angle)])
            a, b = corners[0] @ axis, corners[1] @ axis
            depth = min(depth, float(min(a.max(), b.max()) - max(a.min(), b.min())))
    return depth


def clearance(points: FloatArray, solids: Sequence[Solid]) -> FloatArray:
    """Distance (N,) in metres from floor points (N, 2) to the nearest footprint; 0 inside, inf for none."""
    nearest = np.full(len(points), np.inf)
    for solid in solids:
        offset = points - np.asarray(solid.center[:2])
        cos, sin = math.cos(solid.yaw_rad), math.sin(solid.yaw_rad)
        away_x = np.maximum(np.abs(offset[:, 0] * cos + offset[:, 1] * sin) - solid.half[0], 0.0)
        away_y = np.maximum(np.abs(offset[:, 1] * cos - offset[:, 0] * sin) - solid.half[1], 0.0)
        np.minimum(nearest, np.hypot(away_x, away_y), out=nearest)
    return nearest
