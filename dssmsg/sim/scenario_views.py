"""What the views of a tour show of a home, and what they would show of a thing that is not there."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.frame import Camera, Float32Array, FloatArray
from dssmsg.interfaces.source import Stop
from dssmsg.sim.camera import Instance, Render, Renderer
from dssmsg.sim.mesh import Mesh
from dssmsg.sim.robot import RobotSpec, camera_pose
from dssmsg.sim.scene_layout import Layout
from dssmsg.sim.scene_placement import Placed
from dssmsg.sim.visibility import (
    FULL_HEIGHT,
    FULL_WIDTH,
    HORIZONTAL_FOV_RAD,
    SEEN_PIXELS,
    SEEN_RANGE_M,
    SWEEP_RAD,
)

IN_FRONT_M = 0.05
"""A surface this much nearer than a thing's own hides it: more than the sensor's noise within 4 m."""
HALF = 2
NEED = 1.25 * SEEN_PIXELS / HALF**2
"""Pixels at half size from which a view counts: some more than it must."""


class Ghosts:
    """Casts single meshes against measured depth: how many pixels of a thing would be seen.

    The renderer is filled with the meshes asked for; nobody else may use it meanwhile.
    """

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._shown: tuple[int, bytes] | None = None

    def pixels(
        self,
        mesh: Mesh,
        world_from_object: FloatArray,
        camera: Camera,
        world_from_camera: FloatArray,
        depth: FloatArray | Float32Array,
        range_m: float = SEEN_RANGE_M,
    ) -> int:
        """Pixels of the mesh at a pose (4, 4) that nothing in `depth` (H, W; metres, 0 = no reading) hides.

        Only those nearer than `range_m`; pixels without a reading do not count.
        """
        if not _in_view(mesh, world_from_object, camera, world_from_camera, range_m):
            return 0
        wanted = (id(mesh), np.asarray(world_from_object).tobytes())
        if self._shown != wanted:
            self._renderer.set_static([Instance(1, mesh, world_from_object)])
            self._renderer.set_movable([])
            self._shown = wanted
        ghost = self._renderer.render(camera, world_from_camera).depth
        seen = (ghost > 0) & (ghost < range_m) & (depth > 0) & (depth > ghost - IN_FRONT_M)
        return int(np.count_nonzero(seen))

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One view of a tour: its stop and pose (4, 4).

    A view is swept over three headings. `depth` (H, W) metres and `pixels` (by instance id, within range)
    hold what all three of them show, 0 elsewhere; `glimpsed` the pixels that any of them shows.
    """

    stop: str
    world_from_camera: FloatArray
    depth: FloatArray
    pixels: dict[int, int]
    glimpsed: dict[int, int]


class TourViews:
    """Takes the views of tours in one home, at half the camera's size, with two renderers of its own."""

    def __init__(self, renderer: Renderer, second: Renderer, robot: RobotSpec | None = None) -> None:
        self._renderer = renderer
        self._ghosts = Ghosts(second)
        self._robot = robot or RobotSpec()
        view = Camera.from_fov(FULL_WIDTH // HALF, FULL_HEIGHT // HALF, HORIZONTAL_FOV_RAD)
        # At the side of the image a degree is more pixels than in its middle.
        side = HORIZONTAL_FOV_RAD / 2
        margin = math.ceil(view.fx * (math.tan(side + SWEEP_RAD) - math.tan(side)))
        self._camera = Camera(
            view.width + 2 * margin, view.height, view.fx, view.fy, view.cx + margin, view.cy
        )
        self._margin = 2 * margin

    def take(self, tour: Sequence[Stop], layout: Layout, pieces: Iterable[Placed]) -> list[Shot]:
        """All views of a tour in a home furnished with `pieces`."""
        structure = Instance(0, layout.mesh, np.eye(4))
        furniture = [Instance(p.instance_id, p.model.mesh, p.world_from_object) for p in pieces]
        self._renderer.set_static([structure, *furniture])
        self._renderer.set_movable([])
        shots = []
        for stop in tour:
            for heading, tilt in stop.views:
                pose = camera_pose(stop.x, stop.y, heading, 0.0, tilt, self._robot)
                render = self._renderer.render(self._camera, pose)
                always = render.depth.copy()
                always[:, : self._margin] = always[:, -self._margin :] = 0.0
                pixels, glimpsed = (_pixels(render, depth) for depth in (always, render.depth))
                shots.append(Shot(stop.name, pose, always, pixels, glimpsed))
        return shots

    def shown(self, shots: Sequence[Shot], piece: Placed) -> bool:
        """Whether any of the views shows a piece that stood there when they were taken."""
        return any(shot.pixels.get(piece.instance_id, 0) >= NEED for shot in shots)

    def place_shown(self, shots: Sequence[Shot], piece: Placed) -> bool:
        """Whether any of the views would have shown a piece that was not there, had it been."""
        mesh, pose = piece.model.mesh, piece.world_from_object
        return any(
            self._ghosts.pixels(mesh, pose, self._camera, shot.world_from_camera, shot.depth) >= NEED
            for shot in shots
        )

    def close(self) -> None:
        """Release both renderers."""
        self._renderer.close()
        self._ghosts.close()


def _pixels(render: Render, depth: FloatArray) -> dict[int, int]:
    counts = np.bincount(render.instance_ids[(depth > 0) & (depth < SEEN_RANGE_M)])
    return {number: int(count) for number, count in enumerate(counts) if number and count}


def _in_view(
    mesh: Mesh, world_from_object: FloatArray, camera: Camera, world_from_camera: FloatArray, range_m: float
) -> bool:
    """Whether the sphere around a mesh touches the view's pyramid and its range."""
    low, high = mesh.bounds
    radius = float(np.linalg.norm(high - low)) / 2
    middle = (world_from_object @ [*((low + high) / 2), 1.0])[:3]
    x, y, z = (middle - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
    if z < -radius or math.hypot(x, y, z) - radius > range_m / math.cos(math.radians(45)):
        return False
    for offset, half, focal in ((x, camera.width / 2, camera.fx), (y, camera.height / 2, camera.fy)):
        slope = math.atan2(half, focal)
        if abs(offset) * math.cos(slope) - z * math.sin(slope) > radius:
            return False
    return True
