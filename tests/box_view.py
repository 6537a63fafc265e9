"""An exact view of one box on an endless floor, for tests of what looks at frames."""

from __future__ import annotations

import math

import numpy as np

from dssmsg.frame import Frame
from dssmsg.recogniser.rooms import look
from dssmsg.recogniser.views import CAMERA


def box_frame(camera=CAMERA, tilt_deg=-20.0):
    """A box of 0.6 x 0.4 x 0.5 m on the floor, 1.6 m ahead, in an empty plane; seen by exact ray casting."""
    pose = look(0.0, 0.0, 0.88, 0.0, math.radians(tilt_deg))
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = (
        np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], -1)
        @ pose[:3, :3].T
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(rays[..., 2] < -1e-6, -0.88 / rays[..., 2], np.inf)
        low, high = np.array([1.6, -0.3, 0.0]), np.array([2.0, 0.3, 0.5])
        a, b = (low - [0, 0, 0.88]) / rays, (high - [0, 0, 0.88]) / rays
    enter, leave = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
    hit = (enter < leave) & (enter > 0)
    depth = np.where(hit, enter, floor)
    depth[~np.isfinite(depth) | (depth > 8)] = 0
    rgb = np.where(hit[..., None], np.uint8(200), np.uint8(90)) * np.ones(3, np.uint8)
    millimetres = np.rint(depth * 1000).astype(np.float32) / np.float32(1000)
    base = np.eye(4)
    return Frame(0, 0.0, rgb.astype(np.uint8), millimetres, camera, pose, base), hit
