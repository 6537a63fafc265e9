"""How fast is the simulated camera, and do two independent renderers see the same?

    taskset -c 0 python benchmarks/camera.py [--scene rs_int] [--assets real] [--frames 60] [--json]

Without --scene the furniture stands in rows in a walled hall: 58 pieces in 6 x 7 m, 110 in 11 x 11 m. Views
are the same for both renderers. Frames of the two halls are rendered in turn, so that a busy machine slows
both alike.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Sequence

import numpy as np

from dssmsg.frame import Camera, FloatArray
from dssmsg.sim.camera import Instance, Render, Renderer, make_renderer
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.mesh import box, merge

CAMERA = Camera.from_fov(320, 240, np.radians(69.4))
EYE_HEIGHT = 0.88


def hall(library: FurnitureLibrary, count: int, width: float, depth: float, seed: int) -> list[Instance]:
    """`count` pieces in a grid inside walls (width x depth metres); the last sixth are small movable ones."""
    rng = np.random.default_rng(seed)
    models = [(c, m) for c in library.categories() for m in library.models(c)]
    order = [models[i] for i in rng.permutation(len(models))]
    pieces = []
    for category, name in order:
        piece = library.model(category, name)
        if max(piece.size[:2]) < 2.0 and len(pieces) < count:
            pieces.append(piece)
    pieces.sort(key=lambda piece: piece.size[0] * piece.size[1], reverse=True)
    shell = merge(
        [
            box((width, depth, 0.1), (150, 120, 90), (0, 0, -0.05)),
            box((width, depth, 0.1), (235, 235, 230), (0, 0, 2.55)),
            *(box((0.1, depth, 2.5), (220, 215, 200), (side * width / 2, 0, 1.25)) for side in (-1, 1)),
            *(box((width, 0.1, 2.5), (205, 215, 220), (0, side * depth / 2, 1.25)) for side in (-1, 1)),
        ]
    )
    columns = round(np.sqrt(count * width / depth))
    rows = -(-count // columns)
    instances = [Instance(0, shell, np.eye(4))]
    for i, piece in enumerate(pieces):
        x = (i % columns + 0.5) / columns * (width - 0.4) - width / 2 + 0.2
        y = (i // columns + 0.5) / rows * (depth - 0.4) - depth / 2 + 0.2
        yaw = rng.integers(4) * np.pi / 2
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        pose[:3, 3] = x, y, piece.elevation
        instances.append(Instance(i + 1, piece.mesh, pose))
    return instances


def views(
    instances: Sequence[Instance], width: float, depth: float, count: int, seed: int
) -> list[FloatArray]:
    """Poses (4, 4) at the robot's eye height, looking at the middle of the hall, none inside a piece."""
    rng = np.random.default_rng(seed)
    boxes = [i.mesh.transformed(i.world_from_object).bounds for i in instances if i.instance_id]
    poses: list[FloatArray] = []
    while len(poses) < count:
        eye = np.array([*rng.uniform(-0.45, 0.45, 2) * (width, depth), EYE_HEIGHT])
        to_x, to_y = rng.uniform(-0.2, 0.2, 2) * (width, depth)
        if not any((low - 0.1 < eye).all() and (eye < high + 0.1).all() for low, high in boxes):
            heading = float(np.arctan2(to_y - eye[1], to_x - eye[0]))
            poses.append(camera_pose(eye.tolist(), heading, (0.0, -0.35, -0.44)[len(poses) % 3]))
    return poses


def camera_pose(position: Sequence[float], heading: float, tilt: float) -> FloatArray:
    """world_from_camera (4, 4) of a level camera at `position`, heading and tilt in radians."""
    forward = np.array([np.cos(heading) * np.cos(tilt), np.sin(heading) * np.cos(tilt), np.sin(tilt)])
    right = np.array([np.sin(heading), -np.cos(heading), 0.0])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, position
    return pose


class Tee:
    """Passes instances on to several renderers; views come from the first."""

    name = "tee"

    def __init__(self, renderers: Sequence[Renderer]) -> None:
        self.renderers = renderers
        self.instances: dict[str, Sequence[Instance]] = {}

    def set_static(self, instances: Sequence[Instance]) -> None:
        """To all."""
        self.instances["static"] = list(instances)
        for renderer in self.renderers:
            renderer.set_static(instances)

    def set_movable(self, instances: Sequence[Instance]) -> None:
        """To all."""
        self.instances["movable"] = list(instances)
        for renderer in self.renderers:
            renderer.set_movable(instances)

    def render(self, camera: Camera, world_from_camera: FloatArray) -> Render:
        """From the first."""
        return self.renderers[0].render(camera, world_from_camera)

    def close(self) -> None:
        """All."""
        for renderer in self.renderers:
            renderer.close()


def timed(cases: Sequence[tuple[Renderer, Sequence[FloatArray]]], frames: int) -> list[list[float]]:
    """Seconds a frame of each case, the cases taking turns; the first frame of each is not counted."""
    seconds: list[list[float]] = [[] for _ in cases]
    for i in range(frames + 1):
        for place, (renderer, poses) in enumerate(cases):
            start = time.perf_counter()
            renderer.render(CAMERA, poses[i % len(poses)])
            if i:
                seconds[place].append(time.perf_counter() - start)
    return seconds


def agreement(a: Renderer, b: Renderer, poses: Sequence[FloatArray]) -> tuple[float, float]:
    """Share of pixels with the same instance id, and the 95th percentile of their depth difference in mm."""
    same, differences = [], []
    for pose in poses:
        one, two = a.render(CAMERA, pose), b.render(CAMERA, pose)
        equal = one.instance_ids == two.instance_ids
        same.append(float(equal.mean()))
        differences.append(np.abs(one.depth - two.depth)[equal & (one.depth > 0) & (two.depth > 0)] * 1000)
    return float(np.mean(same)), float(np.percentile(np.concatenate(differences), 95))


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--assets", default="auto", choices=["auto", "real", "embedded"])
    parser.add_argument(
        "--scene", action="append", help="measure this scene instead of the halls; repeatable"
    )
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--views", type=int, default=12, help="views to compare with TinyRenderer")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    library = FurnitureLibrary.open(options.assets)
    print(library.note, file=sys.stderr)
    names, renderers, poses, counts = [], [], [], []
    for spec in options.scene or ["hall-58", "hall-110"]:
        tee = Tee([make_renderer()[0], make_renderer("tiny")[0]])
        if options.scene:
            pieces, around = load(spec, library, tee)
        else:
            pieces = int(spec.rpartition("-")[2])
            extent = (6.0, 7.0) if pieces == 58 else (11.0, 11.0)
            instances = hall(library, pieces, *extent, seed=0)
            small = 1 + round(len(instances) * 5 / 6)
            tee.set_static(instances[:small])
            tee.set_movable(instances[small:])
            around = views(instances, *extent, 3 * options.views, seed=1)
        names.append(spec)
        counts.append(pieces)
        renderers.append(tee)
        poses.append(around)
    rows = []
    seconds = timed(list(zip(renderers, poses, strict=True)), options.frames)
    for name, tee, around, count, taken in zip(names, renderers, poses, counts, seconds, strict=True):
        one, two = tee.renderers
        same, depth_mm = agreement(one, two, around[: options.views])
        start = time.perf_counter()
        one.set_movable(tee.instances["movable"])
        rebuild = time.perf_counter() - start
        tiny = timed([(two, around)], 3)[0]
        milliseconds = statistics.median(taken) * 1000
        rows.append(
            {
                "scene": name,
                "pieces": count,
                "triangles": sum(len(i.mesh.faces) for part in tee.instances.values() for i in part),
                "renderer": one.name,
                "ms": round(milliseconds, 2),
                "ms_p95": round(float(np.percentile(taken, 95)) * 1000, 2),
                "frames_per_second": round(1000 / milliseconds, 1),
                "relative_cost": round(statistics.median(taken) / statistics.median(seconds[0]), 3),
                "movable_rebuild_ms": round(rebuild * 1000, 1),
                "tiny_ms": round(statistics.median(tiny) * 1000, 1),
                "same_ids": round(same, 4),
                "depth_p95_mm": round(depth_mm, 3),
            }
        )
    if options.json:
        print(json.dumps(rows))
    else:
        for key in rows[0]:
            print(f"{key:20}" + "".join(f"{row[key]!s:>16}" for row in rows))
    return 0


def load(name: str, library: FurnitureLibrary, renderer: Renderer) -> tuple[int, list[FloatArray]]:
    """Put a packaged scene before the renderer: number of pieces, and the poses of its tour's views."""
    from dssmsg.sim.scene import load_scene
    from dssmsg.sim.tour import tour_of
    from dssmsg.sim.world import World

    scene = load_scene(name)
    world = World(scene, library, renderer)
    poses = [
        camera_pose((stop.x, stop.y, EYE_HEIGHT), heading, tilt)
        for stop in tour_of(scene, 0)
        for heading, tilt in stop.views
    ]
    return len(world.pieces), poses


if __name__ == "__main__":
    sys.exit(main())
