"""What the networks are shown of a frame: colour, and the geometry that depth and pose give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dssmsg.frame import ByteArray, Camera, Float32Array, FloatArray, MaskArray

GEOMETRY_CHANNELS = 7
"""Depth, height, normal (right, ahead, up), whether there is a reading, whether depth steps there."""
MEAN = np.array([0.485, 0.456, 0.406], np.float32) * 255
DEVIATION = np.array([0.229, 0.224, 0.225], np.float32) * 255
_REACH = 2
_STEP_M, _STEP_RATIO = 0.05, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class HalfGeometry:
    """Geometry at half the image's size (h, w), so that noise averages out and time is saved.

    depth (h, w) metres, 0 = no reading; points (h, w, 3) metres: right of the camera, ahead of it on the
    floor, and up from the floor; normals (h, w, 3) in the same axes, zero where unknown.
    """

    depth: Float32Array
    valid: MaskArray
    points: Float32Array
    normals: Float32Array


def half_geometry(
    depth: Float32Array, camera: Camera, world_from_camera: FloatArray, floor_m: float
) -> HalfGeometry:
    """Geometry of a depth image (H, W), H and W even; `floor_m` is the floor's height in the world."""
    quads = np.stack([depth[0::2, 0::2], depth[0::2, 1::2], depth[1::2, 0::2], depth[1::2, 1::2]])
    # The nearest surface of each 2 x 2 patch: means across an edge would float between the surfaces.
    near = np.where(quads > 0, quads, np.float32(1e3)).min(axis=0)
    same = (quads > 0) & (quads < near * np.float32(1.03) + np.float32(0.02))
    count = same.sum(axis=0)
    valid = count > 0
    half = np.where(valid, (quads * same).sum(axis=0) / np.maximum(count, 1), 0).astype(np.float32)
    points = upright_points(half, valid, camera, world_from_camera, floor_m)
    return HalfGeometry(half, valid, points, upright_normals(points, valid))


def upright_points(
    half: Float32Array, valid: MaskArray, camera: Camera, world_from_camera: FloatArray, floor_m: float
) -> Float32Array:
    """(h, w, 3) float32: right, ahead, up; the frame turns with the camera but stands on the floor."""
    height, width = half.shape
    u = (2 * np.arange(width, dtype=np.float32) + 0.5 - np.float32(camera.cx)) / np.float32(camera.fx)
    v = (2 * np.arange(height, dtype=np.float32) + 0.5 - np.float32(camera.cy)) / np.float32(camera.fy)
    turn = upright_from_camera(world_from_camera)
    rays = np.stack([np.broadcast_to(u, half.shape), np.broadcast_to(v[:, None], half.shape),
                     np.ones_like(half)], axis=-1)  # fmt: skip
    points: Float32Array = ((rays * half[..., None]) @ turn.T.astype(np.float32)).astype(np.float32)
    points[..., 2] += np.float32(world_from_camera[2, 3] - floor_m)
    points[~valid] = 0
    return points


def upright_from_camera(world_from_camera: FloatArray) -> FloatArray:
    """(3, 3): camera axes to right, ahead, up, where up is the world's and ahead the camera's heading."""
    up = np.array([0.0, 0.0, 1.0])
    right = world_from_camera[:3, 0] * [1, 1, 0]
    length = float(np.linalg.norm(right))
    right = right / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    ahead = np.cross(up, right)
    return np.stack([right, ahead, up]) @ world_from_camera[:3, :3]


def upright_normals(points: Float32Array, valid: MaskArray) -> Float32Array:
    """(h, w, 3) unit normals towards the camera's side, from points averaged over 5 x 5; 0 = unknown."""
    size = 2 * _REACH + 1
    weight = ndimage.uniform_filter(valid.astype(np.float32), size)
    smooth = np.empty_like(points)
    for axis in range(3):
        smooth[..., axis] = ndimage.uniform_filter(points[..., axis], size) / np.maximum(weight, 1e-6)
    across, down = np.zeros_like(smooth), np.zeros_like(smooth)
    across[:, _REACH:-_REACH] = smooth[:, 2 * _REACH :] - smooth[:, : -2 * _REACH]
    down[_REACH:-_REACH] = smooth[2 * _REACH :] - smooth[: -2 * _REACH]
    normals = np.stack(
        [
            down[..., 1] * across[..., 2] - down[..., 2] * across[..., 1],
            down[..., 2] * across[..., 0] - down[..., 0] * across[..., 2],
            down[..., 0] * across[..., 1] - down[..., 1] * across[..., 0],
        ],
        axis=-1,
    )
    length = np.sqrt(np.einsum("ijk,ijk->ij", normals, normals))
    known = valid & (weight > 0.4) & (length > 1e-9)
    # down x across points towards the camera in these axes wherever depth is read at all.
    normals *= np.where(known, 1 / np.maximum(length, 1e-9), 0)[..., None]
    return normals


def geometry_channels(geometry: HalfGeometry) -> Float32Array:
    """(GEOMETRY_CHANNELS, h, w) float32, each about in -1..1."""
    depth = geometry.depth
    step = np.zeros(depth.shape, np.bool_)
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        far = np.abs(depth[a] - depth[b]) > _STEP_M + _STEP_RATIO * np.minimum(depth[a], depth[b])
        step[a] |= far
        step[b] |= far
    return np.stack(
        [
            depth / 3 - np.float32(0.7) * geometry.valid,
            geometry.points[..., 2] * np.float32(0.8) - np.float32(0.7) * geometry.valid,
            geometry.normals[..., 0],
            geometry.normals[..., 1],
            geometry.normals[..., 2],
            geometry.valid.astype(np.float32),
            step.astype(np.float32),
        ]
    ).astype(np.float32)


def normalised_rgb(rgb: ByteArray) -> Float32Array:
    """(3, H, W) float32 from (H, W, 3) uint8, as ImageNet networks want it."""
    image: NDArray[np.float32] = (rgb.astype(np.float32) - MEAN) / DEVIATION
    return np.ascontiguousarray(image.transpose(2, 0, 1))
