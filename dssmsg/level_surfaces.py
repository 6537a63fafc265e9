"""Level surfaces that carry things: which pixels face up, and the planes that tops and floors lie in.

Points are world points (z up, metres), as images (H, W, 3) or lists (N, 3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dssmsg.frame import Float32Array, MaskArray

MAX_SLOPE = 0.1
"""How far (rise a metre) a level plane may lean: poses of hand-held cameras are a few degrees off."""
_BIN_M = 0.02
_REACH = 2


@dataclass(frozen=True, slots=True)
class LevelPlane:
    """z = slope_x * x + slope_y * y + offset, world metres."""

    slope_x: float
    slope_y: float
    offset: float

    def above(self, points: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """How far (...) points (..., 3) lie above the plane, metres."""
        height: NDArray[np.floating[Any]] = points[..., 2] - (
            self.slope_x * points[..., 0] + self.slope_y * points[..., 1] + self.offset
        )
        return height


def up_facing(points: Float32Array, valid: MaskArray, least: float = 0.85) -> MaskArray:
    """(H, W) bool: pixels whose surface normal has an upward part of at least `least`.

    Normals come from every second pixel, averaged over 5 x 5 of these; on the borders of a surface they are
    wrong, and pixels without a reading never face up.
    """
    sparse, known = points[::2, ::2], valid[::2, ::2]
    size = 2 * _REACH + 1
    weight = ndimage.uniform_filter(known.astype(np.float32), size)
    smooth = np.empty(sparse.shape, dtype=np.float32)
    for axis in range(3):
        channel = np.where(known, sparse[..., axis], np.float32(0))
        smooth[..., axis] = ndimage.uniform_filter(channel, size) / np.maximum(weight, np.float32(1e-6))
    across, down = np.zeros_like(smooth), np.zeros_like(smooth)
    across[:, _REACH:-_REACH] = smooth[:, 2 * _REACH :] - smooth[:, : -2 * _REACH]
    down[_REACH:-_REACH] = smooth[2 * _REACH :] - smooth[: -2 * _REACH]
    normals = np.cross(down, across)
    length = np.sqrt(np.sum(normals * normals, axis=-1))
    # The sign says which side is seen, and level surfaces are seen from one side only: take either.
    facing = known & (weight > 0.5) & (np.abs(normals[..., 2]) >= least * length) & (length > 0)
    full = np.repeat(np.repeat(facing, 2, axis=0), 2, axis=1)[: valid.shape[0], : valid.shape[1]]
    return full & valid


def fit_level(
    points: NDArray[np.floating[Any]], height: float, slack: float, rounds: int = 3
) -> LevelPlane | None:
    """The plane through those of points (N, 3) that lie within `slack` metres of it, begun at `height`.

    None where too few lie there, or they do not lie level.
    """
    plane = LevelPlane(0.0, 0.0, height)
    for _ in range(rounds):
        near = points[np.abs(plane.above(points)) < slack].astype(np.float64)
        if len(near) < 12:
            return None
        middle = near.mean(axis=0)
        offsets = near - middle
        # A small weight on flatness: on a narrow strip the slope across it is anyone's guess.
        normal = offsets[:, :2].T @ offsets[:, :2] + 1e-3 * len(near) * np.eye(2)
        slope_x, slope_y = np.linalg.solve(normal, offsets[:, :2].T @ offsets[:, 2])
        if np.hypot(slope_x, slope_y) > MAX_SLOPE:
            return None
        offset = middle[2] - slope_x * middle[0] - slope_y * middle[1]
        plane = LevelPlane(float(slope_x), float(slope_y), float(offset))
    return plane


def crowded_heights(heights: NDArray[np.floating[Any]], least: int) -> list[float]:
    """Heights (metres, ascending) that at least `least` of the values (N,) crowd around, within 3 cm."""
    if len(heights) < max(least, 1):
        return []
    start = float(heights.min())
    counts = np.bincount(((heights - start) / _BIN_M).astype(np.int64))
    padded = np.concatenate([[0], counts, [0]])
    crowd = padded[:-2] + padded[1:-1] + padded[2:]
    sides = np.concatenate([[0], crowd, [0]])
    peaks = np.flatnonzero((crowd >= least) & (crowd >= sides[:-2]) & (crowd > sides[2:]))
    return [start + (float(peak) + 0.5) * _BIN_M for peak in peaks]
