"""A tiny ray caster for tests: boxes on a floor, seen by a pinhole camera, with truth."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dssmsg.frame import Camera, Frame, Truth, TruthObject, quantise_depth
from dssmsg.geometry import pixel_rays
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.interfaces import Context, SourceInfo

CAMERA = Camera.from_fov(160, 120, math.radians(69.4))
NOISE = (0.001, 0.002)


@dataclass(frozen=True)
class Thing:
    label: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]


def pose_at(x: float, y: float, heading: float, tilt: float = 0.0, height: float = 0.88) -> np.ndarray:
    """world_from_camera of a camera on the floor plan."""
    forward = np.array(
        [math.cos(heading) * math.cos(tilt), math.sin(heading) * math.cos(tilt), math.sin(tilt)]
    )
    right = np.array([math.sin(heading), -math.cos(heading), 0.0])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(forward, right), forward
    pose[:3, 3] = [x, y, height]
    return pose


def look(
    things: list[Thing],
    pose: np.ndarray,
    index: int = 0,
    *,
    camera: Camera = CAMERA,
    noise: tuple[float, float] = (0.0, 0.0),
    room: float = 4.0,
) -> Frame:
    """A frame of the things in a square room of 2 * `room` metres; instance ids count from 1."""
    # A row an axis: numpy goes along rows faster than across them.
    rays = np.ascontiguousarray((pixel_rays(camera) @ pose[:3, :3].T).T)
    origin = pose[:3, 3, None]
    ids = np.zeros(rays.shape[1], dtype=np.int32)
    far, near = np.array([[room], [room], [2.6]]), np.array([[-room], [-room], [0.0]])
    with np.errstate(divide="ignore", invalid="ignore"):
        to_walls = (np.where(rays > 0, far, near) - origin) / rays
        depth = np.where(to_walls > 0, to_walls, np.inf).min(axis=0)
        for number, thing in enumerate(things, start=1):
            a, b = ((np.array(corner)[:, None] - origin) / rays for corner in (thing.low, thing.high))
            enter, leave = np.minimum(a, b).max(axis=0), np.maximum(a, b).min(axis=0)
            hit = (enter < leave) & (enter > 0) & (enter < depth)
            depth[hit] = enter[hit]
            ids[hit] = number
    depth = depth + np.random.default_rng(index).standard_normal(len(depth)) * (
        noise[0] + noise[1] * depth**2
    )
    size = (camera.height, camera.width)
    rgb = np.random.default_rng(ids.max()).integers(0, 255, (len(things) + 1, 3))[ids].astype(np.uint8)
    objects = tuple(
        TruthObject(i, f"{t.label}-{i}", t.label, np.array(t.low), np.array(t.high))
        for i, t in enumerate(things, 1)
    )
    return Frame(
        index=index,
        sim_time=index * 0.2,
        rgb=rgb.reshape(*size, 3),
        depth=quantise_depth(depth.reshape(size)),
        camera=camera,
        world_from_camera=pose,
        world_from_base=np.eye(4),
        truth=Truth(ids.reshape(size), objects),
    )


class LabelEncoder:
    """Stands in for a text encoder: a fixed random unit vector a label."""

    space = "test/32"
    dimension = 32

    def encode_labels(self, labels):
        vectors = np.stack(
            [np.random.default_rng(list(label.encode())).standard_normal(32) for label in labels]
        )
        return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)

    encode_text = encode_labels

    def encode_crops(self, crops):
        return None


def context(
    *, has_truth: bool = True, encoder=None, seed: int = 0, noise=NOISE, name: str = "boxes"
) -> Context:
    """A plug-in's context around an empty graph."""
    return Context(
        seed=seed,
        rng=np.random.default_rng(seed),
        graph=SceneGraph(),
        ids=IdAllocator(),
        log=logging.getLogger("test"),
        base_dir=Path(),
        run_dir=Path(),
        run_id="test",
        build=lambda kind, slot: None,
        source=SourceInfo(name, CAMERA, drivable=False, has_truth=has_truth, depth_noise_m=noise),
        encoder=encoder,
    )
