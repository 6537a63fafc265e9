"""Rooms and homes as people leave them: small things on everything that carries, chairs in place, bags about.

`rooms` gives variety; here things stand as closely as they do where somebody lives, in the numbers that homes
have of them, and the robot looks at them from near by. Used for training only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dssmsg.frame import FloatArray
from dssmsg.recogniser.rooms import (
    CAMERA_HEIGHT_M,
    SMALL_M,
    SOFT,
    SUPPORTS,
    TILTS_DEG,
    WALL_HUNG_FROM_M,
    ArrangedRoom,
    Arranger,
    Thing,
    look,
)
from dssmsg.recogniser.shelf import Shelf, ShelfModel
from dssmsg.sim.camera import Instance
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.generate import generate_scene
from dssmsg.sim.scene_layout import build_layout
from dssmsg.sim.scene_placement import Placer
from dssmsg.sim.solid import clearance

_ON_TOPS = {
    "book": 6.0, "mug": 5.0, "laptop": 4.0, "cup": 3.0, "phone": 3.0, "bottle": 3.0,
    "vase": 2.5, "plant": 2.5, "lamp": 2.5, "bowl": 2.0, "kettle": 2.0, "box": 2.0, "plate": 1.5,
    "teddy bear": 1.5, "flowers": 1.0, "newspaper": 1.0, "tablet": 1.0, "handbag": 1.0, "toaster": 1.0,
    "microwave": 1.5, "coffee maker": 1.0, "teapot": 1.0, "speaker": 1.0, "clothes": 0.7, "backpack": 0.7,
    "pot": 0.7, "radio": 0.5, "printer": 0.5, "milk carton": 0.7, "remote control": 0.5, "candle": 0.5,
    "clock": 0.5, "ball": 0.5, "toy": 0.5,
}  # fmt: skip
_ON_SOFT = {
    "cushion": 8.0, "book": 3.0, "teddy bear": 2.0, "laptop": 1.5, "handbag": 1.0, "clothes": 1.0,
    "newspaper": 1.0, "tablet": 1.0, "backpack": 1.0, "cat": 0.3, "phone": 0.5, "box": 0.5,
}  # fmt: skip
_ABOUT = {
    "box": 3.0, "shoes": 2.0, "backpack": 2.0, "handbag": 1.5, "trash can": 2.0, "stool": 2.0,
    "suitcase": 1.0, "basket": 1.5, "ball": 1.0, "teddy bear": 1.0, "toy": 1.0, "book": 0.5, "guitar": 1.0,
    "plant": 1.0, "speaker": 0.5, "vase": 0.5, "step ladder": 0.7, "pouf": 0.7, "fan": 0.5, "cat": 0.3,
    "dog": 0.3,
}  # fmt: skip
"""How often a thing is drawn, by label: on tops, on seats and beds, on the floor."""
_CARRIERS = ("table", "coffee table", "desk", "dresser", "kitchen cabinet", "bench", "cabinet", "nightstand",
             "kitchen island", "tv stand")  # fmt: skip
_SEAT_M, _FLOOR_M = 0.75, 1.1
_MOST_THINGS = 240
"""Numbers of things must fit the shards' bytes."""


def lived_in_room(shelf: Shelf, rng: np.random.Generator) -> ArrangedRoom:
    """A room around a few pieces that carry things, and the things."""
    return _LivedIn(shelf, rng).room()


def lived_in_home(
    shelf: Shelf, library: FurnitureLibrary, rng: np.random.Generator, seed: int
) -> ArrangedRoom:
    """The generated home of `seed` with many more small things in it than its slots hold."""
    return _LivedIn(shelf, rng).home(seed, library)


def near_poses(room: ArrangedRoom, rng: np.random.Generator, count: int) -> list[FloatArray]:
    """`count` poses world_from_camera (4, 4) that look at one of the smaller things from 0.7 to 2.6 m.

    The robot must fit where it stands, and nothing tall may stand between.
    """
    obstacles = [solid for solid in room.solids if solid.bottom < 1.0 and solid.top > 0.05]
    tall = [solid for solid in room.solids if solid.top > 1.2 and solid.bottom < 0.6]
    goals = [
        (thing.box_min + thing.box_max) / 2
        for thing in room.things
        if (thing.box_max - thing.box_min).max() < 1.1 and thing.box_min[2] < 1.2
    ]
    poses: list[FloatArray] = []
    for _ in range(100 * count):
        if len(poses) == count or not goals:
            break
        goal = goals[int(rng.integers(len(goals)))]
        angle, away = rng.uniform(0, math.tau), rng.uniform(0.7, 2.6)
        at = goal[:2] + away * np.array([math.cos(angle), math.sin(angle)])
        if (at < 0.25).any() or (at > np.asarray(room.size) - 0.25).any():
            continue
        if obstacles and clearance(at[None, :], obstacles)[0] < 0.22:
            continue
        between = at + np.linspace(0, 0.8, 9)[:, None] * (goal[:2] - at)
        if tall and clearance(between, tall).min() <= 0:
            continue
        heading = math.atan2(goal[1] - at[1], goal[0] - at[0]) + rng.normal(0, 0.22)
        tilt = math.radians(float(rng.choice(TILTS_DEG)) + float(rng.normal(0, 1.0)))
        poses.append(look(float(at[0]), float(at[1]), CAMERA_HEIGHT_M, heading, tilt))
    return poses


class _LivedIn(Arranger):
    def __init__(self, shelf: Shelf, rng: np.random.Generator) -> None:
        super().__init__(shelf, rng, clutter=True)
        self._tops, self._floor = self._up_to(SMALL_M), self._up_to(_FLOOR_M)

    def _up_to(self, most: float) -> dict[str, list[ShelfModel]]:
        """Models by label that stand, `most` metres large at most."""
        return {
            label: [m for m in models if max(m.size) <= most and m.elevation < WALL_HUNG_FROM_M]
            for label, models in self._by_label.items()
        }

    def room(self) -> ArrangedRoom:
        """A room of random size: one to three carriers, a seat or a bed, some more, then what lies about."""
        standing = [name for name in self._by_label if self._kind(name) == "stand"]
        hanging = [name for name in self._by_label if self._kind(name) == "hang"]
        for _ in range(int(self._rng.integers(1, 4))):
            self._stand(self._draw(_CARRIERS))
        for _ in range(int(self._rng.integers(0, 3))):
            self._stand(self._draw(sorted(SOFT)))
        area = self._size[0] * self._size[1]
        for _ in range(int(area * self._rng.uniform(0.1, 0.5))):
            self._stand(self._draw(standing))
        for _ in range(int(self._rng.integers(1, 5))):
            self._hang(self._draw(hanging))
        for _ in range(int(self._rng.integers(0, 2))):
            self._lay(self._draw(["rug", "rug", "doormat"]))
        self._strew()
        return ArrangedRoom(self._size, self._shell(), tuple(self._things), tuple(self._solids))

    def home(self, seed: int, library: FurnitureLibrary) -> ArrangedRoom:
        """A generated home, strewn; its walls are among the solids."""
        scene = generate_scene(seed)
        layout = build_layout(scene)
        self._size = (max(room.x[1] for room in scene.rooms), max(room.y[1] for room in scene.rooms))
        self._fixed = list(layout.solids)
        for placed in Placer(scene, library).initial().values():
            model = ShelfModel(
                placed.model.label, placed.model.model, placed.piece.category, (0.0, 0.0, 0.0), 0.0,
                placed.movable, False, True,
            )  # fmt: skip
            instance = Instance(len(self._things) + 1, placed.model.mesh, placed.world_from_object)
            self._things.append(Thing(model, instance, placed.box_min, placed.box_max))
            self._solids.append(placed.solid)
        self._strew()
        return ArrangedRoom(self._size, layout.mesh, tuple(self._things), (*self._fixed, *self._solids))

    def _chairs(self) -> None:
        """Up to five chairs of one kind around the table that was placed last, some pushed under it."""
        table = self._solids[-1]
        model = self._draw(["chair"])
        for _ in range(int(self._rng.integers(1, 6))):
            other = self._rng.random() < 0.1
            mesh = self._stretched(seat := self._draw(["chair", "stool"]) if other else model)
            if mesh is None:
                continue
            side = int(self._rng.integers(4))
            reach, along = (table.half[1], table.half[0])[:: -1 if side % 2 else 1]
            deep = float(mesh.size[1]) / 2
            out = reach + deep - float(self._rng.uniform(-0.2, 1.2)) * deep
            angle = table.yaw_rad + side * math.pi / 2
            across = float(self._rng.uniform(-0.8, 0.8)) * max(along - 0.2, 0.0)
            cos, sin = math.cos(angle), math.sin(angle)
            x, y = table.center[0] + cos * across - sin * out, table.center[1] + sin * across + cos * out
            # A chair faces -y at yaw 0: from its side of the table it looks towards the middle.
            yaw = angle + float(self._rng.normal(0, 0.12)) + (math.pi if self._rng.random() < 0.05 else 0.0)
            self._add(seat, mesh, x, y, 0.0, yaw, air=-0.02, beside=self._things[self._solids.index(table)])

    def _strew(self) -> None:
        """Small things on everything that carries them, and on the floor."""
        carriers = [
            (thing, solid)
            for thing, solid in zip(self._things, self._solids, strict=True)
            if thing.model.label in SUPPORTS | SOFT and solid.bottom < 0.1
        ]
        for thing, solid in carriers:
            soft = thing.model.label in SOFT
            area = 4 * solid.half[0] * solid.half[1]
            most = 4 if soft else 3 if area < 0.3 else 6
            for _ in range(int(self._rng.integers(0 if soft else 1, most))):
                model = self._small(_ON_SOFT if soft else _ON_TOPS, self._tops)
                if len(self._things) < _MOST_THINGS:
                    self._put_on(thing, solid, model, highest=_SEAT_M if soft else 1.4)
        area = self._size[0] * self._size[1]
        for _ in range(int(area * self._rng.uniform(0.1, 0.35)) + 1):
            model = self._small(_ABOUT, self._floor)
            if len(self._things) < _MOST_THINGS:
                self._drop(model)

    def _small(self, often: Mapping[str, float], models: Mapping[str, list[ShelfModel]]) -> ShelfModel:
        """A model of a label that is drawn by weight; what homes take by default comes more often."""
        names = [name for name in often if models.get(name)]
        weight = np.array([often[name] for name in names])
        ones = models[str(names[int(self._rng.choice(len(names), p=weight / weight.sum()))])]
        chance = np.array([2.0 if model.common else 1.0 for model in ones])
        return ones[int(self._rng.choice(len(ones), p=chance / chance.sum()))]
