"""A room with a table, ray-cast in numpy: RGB-D frames whose every surface is known. World: z up, metres."""

from __future__ import annotations

import math

import numpy as np

from dssmsg.frame import Camera

ROOM_MIN, ROOM_MAX = np.array([-2.0, -1.5, 0.0]), np.array([2.0, 1.5, 2.4])
TABLE_MIN, TABLE_MAX = np.array([0.3, 0.2, 0.0]), np.array([1.1, 1.0, 0.7])


def look(x, y, z, heading_deg, tilt_deg, roll_deg=0.0):
    """world_from_camera (4, 4), OpenCV axes."""
    h, t, r = (math.radians(a) for a in (heading_deg, tilt_deg, roll_deg))
    forward = np.array([math.cos(h) * math.cos(t), math.sin(h) * math.cos(t), math.sin(t)])
    right = np.array([math.sin(h), -math.cos(h), 0.0])
    down = np.cross(forward, right)
    pose = np.eye(4)
    pose[:3, 0] = math.cos(r) * right + math.sin(r) * down
    pose[:3, 1] = math.cos(r) * down - math.sin(r) * right
    pose[:3, 2] = forward
    pose[:3, 3] = x, y, z
    return pose


def walk(count=10):
    """Camera poses of somebody who turns on the spot, wobbling, in the middle of the room."""
    return [
        look(
            -0.8 + 0.05 * i,
            -0.6 + 0.02 * i,
            1.45 + 0.03 * math.sin(i),
            36 * i,
            -18 - 8 * (i % 3),
            3 * (i % 3 - 1),
        )
        for i in range(count)
    ]


def cast(camera: Camera, world_from_camera):
    """rgb (H, W, 3) uint8 and depth (H, W) metres along the optical axis."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u, dtype=float)], -1
    )
    direction = rays @ world_from_camera[:3, :3].T
    origin = world_from_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.where(direction > 0, (ROOM_MAX - origin) / direction, (ROOM_MIN - origin) / direction)
        far[~np.isfinite(far)] = np.inf
        wall = far.argmin(axis=-1)
        depth = far.min(axis=-1)
        enter = np.minimum((TABLE_MIN - origin) / direction, (TABLE_MAX - origin) / direction)
        leave = np.maximum((TABLE_MIN - origin) / direction, (TABLE_MAX - origin) / direction)
    entry, exit_ = enter.max(axis=-1), leave.min(axis=-1)
    hit = (entry < exit_) & (entry > 0) & (entry < depth)
    depth = np.where(hit, entry, depth)
    tone = np.where(hit, 3, wall)
    palette = np.array([[180, 90, 60], [60, 160, 80], [120, 120, 130], [200, 180, 40]], dtype=np.uint8)
    return palette[tone], depth


def distance_to_surface(points):
    """Metres (N,) from world points (N, 3) to the nearest face of the room or the table."""
    room = np.minimum(np.abs(points - ROOM_MIN), np.abs(points - ROOM_MAX)).min(axis=1)
    outside = np.maximum(np.maximum(TABLE_MIN - points, points - TABLE_MAX), 0.0)
    inside = np.minimum(points - TABLE_MIN, TABLE_MAX - points).min(axis=1)
    table = np.where(inside > 0, inside, np.linalg.norm(outside, axis=1))
    return np.minimum(room, table)
