"""Rooms arranged at random from every model on a shelf: variety for training, not places to live in.

Nothing here is checked for being drivable. What matters is that things stand as they do in homes: against
walls or free, small ones on supports, chairs at tables, pictures and cupboards on walls, rugs on the floor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dssmsg.frame import FloatArray
from dssmsg.recogniser.shelf import Shelf, ShelfModel
from dssmsg.sim.camera import Instance
from dssmsg.sim.mesh import Mesh, box, merge
from dssmsg.sim.solid import Solid, clearance, overlap_depth

WALL_HEIGHT_M = 2.6
CAMERA_HEIGHT_M = 0.88
TILTS_DEG = (0.0, -20.0, -25.0)
SUPPORTS = frozenset(
    {"table", "desk", "coffee table", "dresser", "nightstand", "kitchen cabinet", "cabinet", "kitchen island",
     "tv stand", "shelf", "bench", "dressing table", "washing machine", "tumble dryer", "piano", "radiator"}
)  # fmt: skip
SOFT = frozenset({"bed", "sofa", "corner sofa", "armchair"})
_SOFT_THINGS = frozenset(
    {"cushion", "teddy bear", "book", "clothes", "handbag", "cat", "tablet", "newspaper"}
)
_ON_TOP = frozenset(
    {"tv", "monitor", "computer", "printer", "microwave", "toaster", "coffee maker", "kettle", "stereo",
     "radio", "speaker", "fan", "lamp", "aquarium", "mixer", "keyboard", "cooker"}
)  # fmt: skip
WALL_HUNG_FROM_M = 0.3
SMALL_M = 0.62
_TRIES = 25
_FAVOUR = 0.75
"""Share of the draws that go to labels with held-out models, where these are favoured."""


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """A placed model; `instance` carries its id in the views. Box corners (3,) of the mesh, world metres."""

    model: ShelfModel
    instance: Instance
    box_min: FloatArray
    box_max: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ArrangedRoom:
    """A room [0, x] x [0, y] metres with its things; `shell` is walls, floor and ceiling."""

    size: tuple[float, float]
    shell: Mesh
    things: tuple[Thing, ...]
    solids: tuple[Solid, ...] = field(repr=False)


def arrange_room(
    shelf: Shelf, rng: np.random.Generator, *, held_out: bool = False, clutter: bool = False
) -> ArrangedRoom:
    """A furnished room; with `held_out` the held-out models are favoured, otherwise they never appear.

    `clutter` puts several times as many small things around.
    """
    return Arranger(shelf, rng, held_out=held_out, clutter=clutter).room()


def camera_poses(room: ArrangedRoom, rng: np.random.Generator, count: int) -> list[FloatArray]:
    """`count` poses world_from_camera (4, 4) where the robot could stand, at its tilts; OpenCV axes."""
    poses: list[FloatArray] = []
    obstacles = [solid for solid in room.solids if solid.bottom < 1.0 and solid.top > 0.05]
    for _ in range(200 * count):
        if len(poses) == count:
            break
        at = rng.uniform([0.25, 0.25], [room.size[0] - 0.25, room.size[1] - 0.25])
        if obstacles and clearance(at[None, :], obstacles)[0] < 0.22:
            continue
        # Towards the room rather than into the wall behind: a point of the room, blurred.
        target = rng.uniform([0.0, 0.0], room.size)
        heading = math.atan2(target[1] - at[1], target[0] - at[0]) + rng.normal(0, 0.2)
        tilt = math.radians(float(rng.choice(TILTS_DEG)) + float(rng.normal(0, 1.0)))
        poses.append(look(float(at[0]), float(at[1]), CAMERA_HEIGHT_M, heading, tilt))
    return poses


def look(x: float, y: float, z: float, heading: float, tilt: float) -> FloatArray:
    """world_from_camera (4, 4) of a camera at (x, y, z) metres; angles in radians, tilt negative = down."""
    forward = np.array(
        [math.cos(heading) * math.cos(tilt), math.sin(heading) * math.cos(tilt), math.sin(tilt)]
    )
    right = np.array([math.sin(heading), -math.cos(heading), 0.0])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(forward, right), forward
    pose[:3, 3] = (x, y, z)
    return pose


class Arranger:
    """Places one model after the other; `_fixed` are solids that are no things, such as a home's walls."""

    def __init__(
        self, shelf: Shelf, rng: np.random.Generator, *, held_out: bool = False, clutter: bool = False
    ) -> None:
        self._shelf = shelf
        self._rng = rng
        self._held_out = held_out
        self._clutter = clutter
        self._by_label: dict[str, list[ShelfModel]] = {}
        for model in shelf.models:
            if held_out or not model.held_out:
                self._by_label.setdefault(model.label, []).append(model)
        self._size = (float(rng.uniform(2.2, 6.0)), float(rng.uniform(2.2, 5.0)))
        self._things: list[Thing] = []
        self._solids: list[Solid] = []
        self._fixed: list[Solid] = []

    def room(self) -> ArrangedRoom:
        """A room of random size, filled."""
        area = self._size[0] * self._size[1]
        standing = [name for name in self._by_label if self._kind(name) == "stand"]
        hanging = [name for name in self._by_label if self._kind(name) == "hang"]
        small = [name for name in self._by_label if self._kind(name) == "small"]
        for _ in range(int(area * self._rng.uniform(0.5, 1.0)) + 2):
            self._stand(self._draw(standing))
        for _ in range(int(self._rng.integers(2, 7))):
            self._hang(self._draw(hanging))
        for _ in range(int(self._rng.integers(0, 3))):
            self._lay(self._draw(["rug", "rug", "doormat"]))
        supports = [
            (thing, solid)
            for thing, solid in zip(self._things, self._solids, strict=True)
            if thing.model.label in SUPPORTS | SOFT
        ]
        for thing, solid in supports:
            most = 4 if solid.half[0] > 0.35 else 2
            for _ in range(int(self._rng.integers(0, most)) + 3 * self._clutter):
                soft = thing.model.label in SOFT
                self._put_on(
                    thing, solid, self._draw([n for n in small if (n in _SOFT_THINGS) == soft] or small)
                )
        for _ in range(int(self._rng.integers(0, 4)) + 5 * self._clutter):
            self._drop(self._draw(small))
        return ArrangedRoom(self._size, self._shell(), tuple(self._things), tuple(self._solids))

    def _kind(self, label: str) -> str:
        """How things of a label are placed: `stand`, `hang`, `small` (on a support) or `lay`."""
        model = self._by_label[label][0]
        if label in ("rug", "doormat"):
            return "lay"
        if label in _ON_TOP or (max(model.size) <= SMALL_M and model.elevation < WALL_HUNG_FROM_M):
            return "small" if label not in ("stool", "trash can", "pouf") else "stand"
        return "hang" if model.elevation >= WALL_HUNG_FROM_M else "stand"

    def _draw(self, labels: Sequence[str]) -> ShelfModel:
        """A label at random, then a model of it: scenes' default ones, or held-out ones, more often."""
        names = list(labels)
        if self._held_out and self._rng.random() < _FAVOUR:
            names = [name for name in names if any(m.held_out for m in self._by_label[name])] or names
        models = self._by_label[str(self._rng.choice(names))]
        weight = np.array(
            [3.0 if m.common else 1.0 for m in models]
            if not self._held_out
            else [6.0 if m.held_out else 0.5 for m in models]
        )
        # A label with many models is also commoner in homes (chairs, lamps, plants).
        return models[int(self._rng.choice(len(models), p=weight / weight.sum()))]

    def _stretched(self, model: ShelfModel) -> Mesh | None:
        """The model's mesh at a size of its own: scenes stretch pieces to fit."""
        mesh = self._shelf.mesh(model)
        if mesh is None or not len(mesh.faces):
            return None
        factor = self._rng.uniform(0.9, 1.12) * self._rng.uniform(0.88, 1.15, 3)
        return mesh.scaled_to(np.maximum(np.asarray(mesh.size) * factor, 1e-3).tolist())

    def _stand(self, model: ShelfModel) -> None:
        mesh = self._stretched(model)
        if mesh is None:
            return
        for _ in range(_TRIES):
            at_wall = self._rng.random() < (
                0.35 if model.movable or model.label in ("table", "coffee table") else 0.9
            )
            x, y, yaw = self._at_wall(mesh, 0.0) if at_wall else self._free(mesh)
            if self._add(model, mesh, x, y, 0.0, yaw, air=0.03):
                if model.label in ("table", "desk"):
                    self._chairs()
                return

    def _chairs(self) -> None:
        """Chairs around the table that was placed last."""
        table = self._solids[-1]
        for _ in range(int(self._rng.integers(0, 5))):
            model = self._draw(["chair"])
            mesh = self._stretched(model)
            if mesh is None:
                continue
            side = float(self._rng.choice([0.0, 0.5, 1.0, 1.5])) * math.pi
            reach = table.half[1] if side % math.pi < 0.1 else table.half[0]
            along = table.half[0] if side % math.pi < 0.1 else table.half[1]
            local = np.array([self._rng.uniform(-0.7, 0.7) * along, reach + self._rng.uniform(0.05, 0.3)])
            angle = table.yaw_rad + side
            cos, sin = math.cos(angle), math.sin(angle)
            x = table.center[0] + cos * local[0] - sin * local[1]
            y = table.center[1] + sin * local[0] + cos * local[1]
            self._add(model, mesh, x, y, 0.0, angle + float(self._rng.normal(0, 0.15)), air=-0.2)

    def _hang(self, model: ShelfModel) -> None:
        mesh = self._stretched(model)
        if mesh is None:
            return
        high = float(mesh.size[2])
        z = min(model.elevation * float(self._rng.uniform(0.85, 1.15)), WALL_HEIGHT_M - high)
        for _ in range(_TRIES):
            if model.elevation > 1.6 and model.label == "lamp":
                x, y, yaw = self._free(mesh)
                z = WALL_HEIGHT_M - high
            else:
                x, y, yaw = self._at_wall(mesh, 0.0)
            if z >= 0 and self._add(model, mesh, x, y, z, yaw, air=0.02):
                return

    def _lay(self, model: ShelfModel) -> None:
        mesh = self._stretched(model)
        if mesh is not None:
            x, y, yaw = self._free(mesh)
            self._add(model, mesh, x, y, 0.0, yaw, air=None)

    def _drop(self, model: ShelfModel) -> None:
        """A small thing on the floor."""
        mesh = self._stretched(model)
        if mesh is not None:
            x, y, yaw = self._free(mesh)
            self._add(model, mesh, x, y, 0.0, yaw, air=0.02)

    def _put_on(self, support: Thing, solid: Solid, model: ShelfModel, *, highest: float = 1.4) -> None:
        """A small thing on a support, where its surface is lower than `highest` metres."""
        mesh = self._stretched(model)
        if mesh is None:
            return
        half = np.asarray(mesh.size)[:2] / 2
        room = np.asarray(solid.half[:2]) - half
        if (room <= 0).any():
            return
        for _ in range(8):
            local = self._rng.uniform(-room, room)
            cos, sin = math.cos(solid.yaw_rad), math.sin(solid.yaw_rad)
            x = solid.center[0] + cos * local[0] - sin * local[1]
            y = solid.center[1] + sin * local[0] + cos * local[1]
            top = surface_height(support.instance, (x, y))
            if top is None or not 0.2 < top < highest:
                continue
            yaw = solid.yaw_rad + float(self._rng.normal(0, 0.4))
            if self._add(model, mesh, x, y, top, yaw, air=0.0, beside=support):
                return

    def _at_wall(self, mesh: Mesh, gap: float) -> tuple[float, float, float]:
        low, high = mesh.bounds
        width, depth = float(high[0] - low[0]), float(high[1])
        side = int(self._rng.integers(4))
        length = self._size[0] if side % 2 == 0 else self._size[1]
        along = float(self._rng.uniform(min(width / 2, length / 2), max(length - width / 2, length / 2)))
        inward = depth + gap + float(self._rng.uniform(0, 0.03))
        return (
            (along, self._size[1] - inward, 0.0),
            (self._size[0] - inward, along, -math.pi / 2),
            (along, inward, math.pi),
            (inward, along, math.pi / 2),
        )[side]

    def _free(self, mesh: Mesh) -> tuple[float, float, float]:
        reach = float(np.hypot(*(np.asarray(mesh.size)[:2] / 2)))
        x, y = (
            float(self._rng.uniform(min(reach, side / 2), max(side - reach, side / 2))) for side in self._size
        )
        turn = float(self._rng.choice([0.0, 0.5, 1.0, 1.5])) * math.pi
        return x, y, turn if self._rng.random() < 0.5 else float(self._rng.uniform(0, math.tau))

    def _add(
        self,
        model: ShelfModel,
        mesh: Mesh,
        x: float,
        y: float,
        z: float,
        yaw: float,
        *,
        air: float | None,
        beside: Thing | None = None,
    ) -> bool:
        """Place it where nothing else is; `air` metres between solids, None: whatever is there (a rug)."""
        low, high = mesh.bounds
        cos, sin = math.cos(yaw), math.sin(yaw)
        pose = np.array([[cos, -sin, 0, x], [sin, cos, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])
        middle = pose[:3, :3] @ ((low + high) / 2) + pose[:3, 3]
        half = (high - low) / 2
        solid = Solid(
            (float(middle[0]), float(middle[1]), float(middle[2])),
            (float(half[0]), float(half[1]), float(half[2])), yaw,
        )  # fmt: skip
        corners = solid.corners()
        if (
            (corners < -0.02).any()
            or (corners > np.asarray(self._size) + 0.02).any()
            or solid.top > WALL_HEIGHT_M + 0.01
        ):
            return False
        others = [s for t, s in zip(self._things, self._solids, strict=True) if t is not beside]
        others += self._fixed
        if air is not None and any(
            overlap_depth(solid, other) > -air for other in others if other.half[2] > 0.02
        ):
            return False
        if air is None and any(overlap_depth(solid, other) > 0 for other in others if other.half[2] <= 0.02):
            return False
        vertices = mesh.vertices @ pose[:3, :3].T + pose[:3, 3]
        instance = Instance(len(self._things) + 1, mesh, pose)
        self._things.append(Thing(model, instance, vertices.min(axis=0), vertices.max(axis=0)))
        self._solids.append(solid)
        return True

    def _shell(self) -> Mesh:
        """Floor, ceiling and walls in colours of their own."""
        x, y = self._size

        def tint(base: Sequence[float], spread: float) -> list[int]:
            return [
                int(v)
                for v in np.clip(
                    np.asarray(base) + self._rng.normal(0, spread) + self._rng.normal(0, 12, 3), 20, 250
                )
            ]

        floors = [
            (176, 168, 152),
            (158, 172, 178),
            (178, 142, 104),
            (184, 150, 112),
            (120, 90, 60),
            (90, 90, 92),
            (205, 200, 190),
        ]
        walls = [
            (234, 226, 212),
            (216, 222, 232),
            (204, 222, 228),
            (236, 230, 206),
            (200, 190, 180),
            (170, 185, 170),
        ]
        floor = tint(floors[int(self._rng.integers(len(floors)))], 15)
        wall = tint(walls[int(self._rng.integers(len(walls)))], 12)
        t = 0.1
        parts = [
            box([x, y, t], floor, center=(x / 2, y / 2, -t / 2)),
            box([x, y, t], [238, 238, 234], center=(x / 2, y / 2, WALL_HEIGHT_M + t / 2)),
        ]
        for center, size in (
            ((x / 2, -t / 2), (x, t)), ((x / 2, y + t / 2), (x, t)),
            ((-t / 2, y / 2), (t, y)), ((x + t / 2, y / 2), (t, y)),
        ):  # fmt: skip
            parts.append(box([*size, WALL_HEIGHT_M], wall, center=(*center, WALL_HEIGHT_M / 2)))
        return merge(parts)


def surface_height(instance: Instance, at: tuple[float, float]) -> float | None:
    """The highest z, world metres, of an instance's surface above the floor point `at`; None beside it."""
    vertices = (
        instance.mesh.vertices @ instance.world_from_object[:3, :3].T + instance.world_from_object[:3, 3]
    )
    corner = vertices[instance.mesh.faces]
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    u, v, w = (b - a)[:, :2], (c - a)[:, :2], np.asarray(at) - a[:, :2]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    usable = np.abs(area) > 1e-12
    scale = np.where(usable, area, 1.0)
    s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / scale
    t = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / scale
    hit = usable & (s >= 0) & (t >= 0) & (s + t <= 1)
    if not hit.any():
        return None
    heights = a[hit, 2] + s[hit] * (b - a)[hit, 2] + t[hit] * (c - a)[hit, 2]
    return float(heights.max())
