"""Which way is up in a sequence, and where its floor is.

People hold a camera roughly level, so the mean of the cameras' upward axes starts the search. Rooms are made
of level and of upright surfaces, so the direction along which the most surface normals lie, or to which they
are square, refines it. The floor is the lowest level surface of some size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass

import numpy as np

from dssmsg.frame import Camera, FloatArray

AXES: dict[str, tuple[float, float, float]] = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
}
SNAP_RAD = math.radians(15.0)
_SEED_TILTS_RAD = tuple(math.radians(a) for a in (0, 15, -15, 30, -30, 45, -45, 60, -60))
_SEED_LIMIT_RAD = math.radians(65.0)
_BLOCKS_ACROSS = 80
_FLOOR_BIN_M = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Surface samples in the world of the files: points (N, 3), unit normals (N, 3) towards the camera."""

    points: FloatArray
    normals: FloatArray


def surface_samples(depth: FloatArray, camera: Camera, world_from_camera: FloatArray) -> Surfaces:
    """Points and normals of blocks of a depth image (H, W) metres; blocks with gaps or jumps are left out."""
    block = max(1, camera.width // _BLOCKS_ACROSS)
    rows, columns = depth.shape[0] // block, depth.shape[1] // block
    tiles = depth[: rows * block, : columns * block].reshape(rows, block, columns, block)
    nearest, farthest = tiles.min(axis=(1, 3)), tiles.max(axis=(1, 3))
    z = tiles.mean(axis=(1, 3))
    smooth = (nearest > 0) & (farthest - nearest < 0.05 + 0.1 * z)
    u = (np.arange(columns) + 0.5) * block - 0.5
    v = (np.arange(rows) + 0.5) * block - 0.5
    grid = np.stack(
        [(u[None, :] - camera.cx) / camera.fx * z, (v[:, None] - camera.cy) / camera.fy * z, z], axis=-1
    )
    across = grid[1:-1, 2:] - grid[1:-1, :-2]
    down = grid[2:, 1:-1] - grid[:-2, 1:-1]
    jump = 0.05 + 0.15 * z[1:-1, 1:-1]
    usable = smooth[1:-1, 1:-1] & smooth[1:-1, 2:] & smooth[1:-1, :-2] & smooth[2:, 1:-1] & smooth[:-2, 1:-1]
    usable &= (np.abs(across[..., 2]) < jump) & (np.abs(down[..., 2]) < jump)
    normals = np.cross(across, down)[usable]
    points = grid[1:-1, 1:-1][usable]
    length = np.linalg.norm(normals, axis=1)
    normals, points = normals[length > 0] / length[length > 0, None], points[length > 0]
    normals *= -np.sign(np.sum(normals * points, axis=1, keepdims=True))
    rotation = world_from_camera[:3, :3]
    return Surfaces(points @ rotation.T + world_from_camera[:3, 3], normals @ rotation.T)


def joined(surfaces: SequenceOf[Surfaces]) -> Surfaces:
    """All samples of several frames."""
    return Surfaces(
        np.concatenate([s.points for s in surfaces] or [np.empty((0, 3))]),
        np.concatenate([s.normals for s in surfaces] or [np.empty((0, 3))]),
    )


def estimate_up(normals: FloatArray, rotations: FloatArray) -> FloatArray:
    """The unit vector (3,) that points up, from normals (N, 3) and camera rotations (M, 3, 3), OpenCV axes.

    Seeds are the cameras' mean upward axis and the same tilted about their mean sideways axis (a camera that
    looks down all the time); each is refined over the normals, and the one that explains the most level and
    upright surface wins, nearer seeds before farther ones.
    """
    first = _unit(-rotations[:, :, 1].mean(axis=0), fallback=-rotations[0, :, 1])
    side = _unit(rotations[:, :, 0].mean(axis=0), fallback=rotations[0, :, 0])
    side = _unit(side - first * (side @ first), fallback=rotations[0, :, 0])
    if len(normals) < 50:
        return first
    best, best_score = first, -1.0
    for tilt in _SEED_TILTS_RAD:
        seed = math.cos(tilt) * first + math.sin(tilt) * np.cross(side, first)
        up = _refine(seed, normals)
        angle = math.acos(min(1.0, max(-1.0, float(up @ first))))
        if angle > _SEED_LIMIT_RAD:
            continue
        score = _explained(up, normals) * math.cos(0.5 * angle)
        if score > best_score + 1e-9:
            best, best_score = up, score
    return best


def floor_height(surfaces: Surfaces, up: FloatArray, lowest_camera: float) -> float:
    """Height of the floor along `up`: the lowest level surface of some size below every camera.

    Without one, the height that 1 % of the points are below; 1.5 m under the camera without any points.
    """
    heights = surfaces.points @ up
    level = heights[(surfaces.normals @ up > math.cos(math.radians(12.0))) & (heights < lowest_camera - 0.2)]
    if len(level) >= 50:
        bins = np.floor((level - level.min()) / _FLOOR_BIN_M).astype(np.intp)
        counts = np.bincount(bins)
        smoothed = np.convolve(counts, np.ones(3), mode="same")
        lowest = int(np.argmax(smoothed >= max(0.15 * smoothed.max(), 0.02 * len(level))))
        near = lowest + int(np.argmax(smoothed[lowest : lowest + 5]))  # the top of that peak
        middle = level.min() + (near + 0.5) * _FLOOR_BIN_M
        return float(np.median(level[np.abs(level - middle) <= 2 * _FLOOR_BIN_M]))
    if len(heights):
        return min(float(np.percentile(heights, 1.0)), lowest_camera)
    return lowest_camera - 1.5


def rotation_to_z(up: FloatArray) -> FloatArray:
    """The smallest rotation (3, 3) that turns the unit vector `up` into z; straight down turns about x."""
    x, y, z = (float(c) for c in up)
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    rotation: FloatArray = np.eye(3) + cross + cross @ cross / (1.0 + z)
    return rotation


def _refine(up: FloatArray, normals: FloatArray) -> FloatArray:
    """Alternate: call normals level or upright by their angle to `up`, then find the `up` that fits best."""
    for degrees in (30.0, 20.0, 12.0, 8.0, 5.0, 5.0):
        cosine = np.abs(normals @ up)
        level = normals[cosine > math.cos(math.radians(degrees))]
        upright = normals[cosine < math.sin(math.radians(degrees))]
        if len(level) + len(upright) < 20:
            break
        _values, vectors = np.linalg.eigh(level.T @ level - upright.T @ upright)
        refined = vectors[:, -1]
        up = refined * (1.0 if refined @ up >= 0 else -1.0)
    return up


def _explained(up: FloatArray, normals: FloatArray) -> float:
    """Share of the normals that are level or upright; a direction without level surface explains little."""
    cosine = np.abs(normals @ up)
    level = float(np.mean(cosine > math.cos(math.radians(8.0))))
    upright = float(np.mean(cosine < math.sin(math.radians(8.0))))
    return upright + level + min(level, 0.15)


def _unit(vector: FloatArray, fallback: FloatArray) -> FloatArray:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-6 else fallback
