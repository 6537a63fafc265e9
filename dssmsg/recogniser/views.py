"""Rendered views with their truth, from arranged rooms and generated homes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dssmsg.frame import Camera, FloatArray, Frame, IntArray
from dssmsg.recogniser.lived import lived_in_home, lived_in_room, near_poses
from dssmsg.recogniser.rooms import CAMERA_HEIGHT_M, TILTS_DEG, arrange_room, camera_poses, look
from dssmsg.recogniser.shelf import Shelf
from dssmsg.sim.camera import Instance, Renderer, make_renderer
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.generate import generate_scene
from dssmsg.sim.noise import PRESETS
from dssmsg.sim.scene_layout import build_layout
from dssmsg.sim.scene_placement import Placer
from dssmsg.sim.solid import clearance

CAMERA = Camera.from_fov(320, 240, math.radians(69.4))
"""The simulated robot's camera."""
_MIN_PIXELS = 200
_MIN_VISIBLE = 2
_MIN_MEDIAN_M = 0.6
"""A view of something nearer than this shows next to nothing of it."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A frame and what is in it: instance_ids (H, W) int32, 0 = structure; id -> (label, model)."""

    frame: Frame
    instance_ids: IntArray
    things: dict[int, tuple[str, str]]


def room_views(
    shelf: Shelf, seed: int, count: int, *, held_out: bool = False, clutter: bool = False
) -> Iterator[View]:
    """Up to `count` views of an arranged room; the same seed gives the same views."""
    rng = np.random.default_rng([seed, 1])
    room = arrange_room(shelf, rng, held_out=held_out, clutter=clutter)
    renderer, _ = make_renderer("auto")
    renderer.set_static([Instance(0, room.shell, np.eye(4)), *(thing.instance for thing in room.things)])
    things = {thing.instance.instance_id: (thing.model.label, thing.model.model) for thing in room.things}
    yield from _views(renderer, camera_poses(room, rng, 3 * count), things, rng, count)
    renderer.close()


def lived_in_views(
    shelf: Shelf, seed: int, count: int, library: FurnitureLibrary | None = None
) -> Iterator[View]:
    """Up to `count` views of a room full of small things, or of such a home where a library is given; two
    of three look at one of them from near by."""
    rng = np.random.default_rng([seed, 3])
    room = lived_in_room(shelf, rng) if library is None else lived_in_home(shelf, library, rng, seed)
    renderer, _ = make_renderer("auto")
    renderer.set_static([Instance(0, room.shell, np.eye(4)), *(thing.instance for thing in room.things)])
    things = {thing.instance.instance_id: (thing.model.label, thing.model.model) for thing in room.things}
    near = count * 2 // 3
    yield from _views(renderer, near_poses(room, rng, 3 * near), things, rng, near)
    yield from _views(renderer, camera_poses(room, rng, 3 * (count - near)), things, rng, count - near)
    renderer.close()


def home_views(library: FurnitureLibrary, seed: int, count: int) -> Iterator[View]:
    """Up to `count` views of the generated home of `seed`, from places where the robot fits."""
    rng = np.random.default_rng([seed, 2])
    scene = generate_scene(seed)
    layout = build_layout(scene)
    placed = Placer(scene, library).initial()
    renderer, _ = make_renderer("auto")
    renderer.set_static(
        [
            Instance(0, layout.mesh, np.eye(4)),
            *(Instance(p.instance_id, p.model.mesh, p.world_from_object) for p in placed.values()),
        ]
    )
    things = {p.instance_id: (p.model.label, p.model.model) for p in placed.values()}
    solids = [
        *layout.solids,
        *(p.solid for p in placed.values() if p.solid.bottom < 1.0 and p.solid.top > 0.05),
    ]
    poses: list[FloatArray] = []
    for _ in range(200 * count):
        if len(poses) == 3 * count:
            break
        room = scene.rooms[int(rng.integers(len(scene.rooms)))]
        at = rng.uniform([room.x[0], room.y[0]], [room.x[1], room.y[1]])
        if clearance(at[None, :], solids)[0] < 0.22:
            continue
        tilt = math.radians(float(rng.choice(TILTS_DEG)) + float(rng.normal(0, 1.0)))
        heading = float(rng.uniform(-math.pi, math.pi))
        poses.append(look(float(at[0]), float(at[1]), CAMERA_HEIGHT_M, heading, tilt))
    yield from _views(renderer, poses, things, rng, count)
    renderer.close()


def _views(
    renderer: Renderer,
    poses: list[FloatArray],
    things: dict[int, tuple[str, str]],
    rng: np.random.Generator,
    count: int,
) -> Iterator[View]:
    """The first `count` poses that show enough to learn from, through the realistic sensor model."""
    noise = PRESETS["realistic"]
    made = 0
    for pose in poses:
        if made == count:
            return
        render = renderer.render(CAMERA, pose)
        visible = np.bincount(render.instance_ids.ravel())[1:] >= _MIN_PIXELS
        if np.count_nonzero(visible) < _MIN_VISIBLE or np.median(render.depth) < _MIN_MEDIAN_M:
            continue
        rgb, depth = noise.apply(render, rng)
        base = np.eye(4)
        base[:2, 3] = pose[:2, 3]
        yield View(Frame(made, float(made), rgb, depth, CAMERA, pose, base), render.instance_ids, things)
        made += 1
