"""Furniture for generated rooms: what belongs into a room of a type, and where it fits.

The ways from every door to the middle of its room are kept free, so that a home can always be driven through.
Sizes are given here, so that a generated home is the same whatever furniture is installed.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dssmsg.sim.scene import Piece, Room
from dssmsg.sim.solid import Solid, overlap_depth

WAY_HALF_M = 0.32
"""Half the width of the ways kept free: the robot's radius and some room to steer."""
_FRONT_M = 0.25
_TOP_M = 0.7
"""Room kept above what carries things, so that nothing hangs into them."""
_TRIES = 30
_WALL_YAW = {"north": 0.0, "east": -math.pi / 2, "south": math.pi, "west": math.pi / 2}
Size = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Want:
    """A piece that a room type would like: at a wall or free in the room, with a chance.

    It `holds` so many small things, carries a `top` of its own, and has `chairs`.
    """

    category: str
    size: Size
    chance: float = 1.0
    z: float | None = None
    free: bool = False
    holds: int = 0
    chairs: int = 0
    top: tuple[str, Size] | None = None


@dataclass(frozen=True, slots=True)
class Slot:
    """A place for one small thing on a support: offset (x, y) in the support's axes, and where that is."""

    support: str
    offset: tuple[float, float]
    world: tuple[float, float]
    room: str


_WANTS: dict[str, tuple[Want, ...]] = {
    "living room": (
        Want("sofa", (2.0, 0.85, 0.82)),
        Want("tv stand", (1.4, 0.4, 0.5), top=("tv", (1.0, 0.18, 0.65))),
        Want("bookcase", (0.9, 0.32, 1.8)),
        Want("coffee table", (0.9, 0.55, 0.42), free=True, holds=2),
        Want("armchair", (0.78, 0.8, 0.9), chance=0.7),
        Want("piano", (1.42, 0.56, 1.25), chance=0.3),
        Want("dresser", (1.2, 0.42, 0.8), chance=0.8, holds=2),
        Want("plant", (0.5, 0.5, 1.2), chance=0.8),
        Want("floor lamp", (0.36, 0.36, 1.5), chance=0.7),
        Want("picture", (0.8, 0.03, 0.55), z=1.25),
        Want("radiator", (0.9, 0.12, 0.6)),
    ),
    "dining room": (
        Want("table", (1.3, 0.8, 0.75), free=True, holds=3, chairs=4),
        Want("cabinet", (1.1, 0.4, 1.3)),
        Want("plant", (0.5, 0.5, 1.2), chance=0.6),
        Want("picture", (0.8, 0.03, 0.55), z=1.25),
        Want("radiator", (0.8, 0.12, 0.6), chance=0.6),
    ),
    "kitchen": (
        Want("fridge", (0.65, 0.62, 1.75)),
        Want("sink", (0.7, 0.58, 0.9)),
        Want("oven", (0.6, 0.6, 0.88)),
        Want("kitchen cabinet", (0.95, 0.55, 0.88), holds=2),
        Want("dishwasher", (0.6, 0.6, 0.85), chance=0.6),
        Want("wall cabinet", (0.7, 0.32, 0.7), z=1.45, chance=0.7),
        Want("trash can", (0.3, 0.3, 0.42), chance=0.7),
    ),
    "bedroom": (
        Want("bed", (1.5, 2.05, 0.9)),
        Want("wardrobe", (1.3, 0.55, 1.95)),
        Want("desk", (1.0, 0.5, 0.74), holds=2, chairs=1),
        Want("nightstand", (0.42, 0.38, 0.5), top=("lamp", (0.28, 0.28, 0.5))),
        Want("mirror", (0.5, 0.03, 0.66), z=0.92, chance=0.6),
        Want("picture", (0.7, 0.03, 0.5), z=1.25, chance=0.7),
        Want("radiator", (0.8, 0.12, 0.6), chance=0.6),
    ),
    "study": (
        Want("desk", (1.3, 0.6, 0.74), holds=3, chairs=1),
        Want("bookcase", (0.9, 0.32, 1.8)),
        Want("armchair", (0.78, 0.8, 0.9), chance=0.6),
        Want("plant", (0.5, 0.5, 1.2), chance=0.6),
        Want("picture", (0.7, 0.03, 0.5), z=1.25),
    ),
    "bathroom": (
        Want("bathtub", (1.65, 0.7, 0.6), chance=0.7),
        Want("toilet", (0.4, 0.66, 0.76)),
        Want("washbasin", (0.54, 0.43, 0.84)),
        Want("mirror", (0.5, 0.03, 0.62), z=0.95),
        Want("cabinet", (0.45, 0.28, 0.75), holds=1),
        Want("washing machine", (0.6, 0.58, 0.86), chance=0.6),
        Want("basket", (0.34, 0.34, 0.5), chance=0.5),
    ),
}
ROOM_TYPES = tuple(_WANTS)
SMALL: tuple[tuple[str, Size], ...] = (
    ("mug", (0.085, 0.12, 0.108)),
    ("book", (0.28, 0.18, 0.024)),
    ("laptop", (0.34, 0.25, 0.26)),
    ("bottle", (0.08, 0.08, 0.3)),
    ("vase", (0.2, 0.2, 0.3)),
    ("bowl", (0.22, 0.22, 0.1)),
    ("teddy bear", (0.28, 0.26, 0.36)),
    ("phone", (0.197, 0.219, 0.073)),
    ("kettle", (0.2, 0.22, 0.24)),
    ("cup", (0.1, 0.1, 0.09)),
)


@dataclass(slots=True)
class Furnisher:
    """Fills rooms with pieces; ids are numbered by category over the whole home."""

    rng: np.random.Generator
    doors: Sequence[tuple[str, tuple[float, float]]]
    """(room, middle of the opening) of every door, once for each of its two rooms."""
    pieces: list[Piece] = field(default_factory=list)
    slots: list[Slot] = field(default_factory=list)
    solids: list[Solid] = field(default_factory=list)
    _numbers: Counter[str] = field(default_factory=Counter)

    def furnish(self, room: Room) -> None:
        """Put into a room what its type wants, as far as it fits."""
        ways = self._ways(room)
        taken: list[Solid] = []
        for want in _WANTS[room.type]:
            if self.rng.random() >= want.chance:
                continue
            for _ in range(_TRIES):
                solid = self._free(room, want) if want.free else self._at_wall(room, want)
                if solid is not None and self._fits(room, solid, want, taken, ways):
                    self._put(room, solid, want, taken, ways)
                    break

    def small(self, slot: Slot, category: str, size: Size) -> Piece:
        """A small thing for a slot; the caller decides whether it is there from the beginning."""
        yaw = float(np.round(self.rng.uniform(-8, 8)))
        return Piece(
            id=self.name(category), category=category, size=size, on=slot.support, at=slot.offset, yaw_deg=yaw
        )

    def name(self, category: str) -> str:
        """The next free id of a category."""
        self._numbers[category] += 1
        return f"{category.replace(' ', '_')}-{self._numbers[category]}"

    def _ways(self, room: Room) -> list[Solid]:
        middle = np.array(room.center)
        ways = [Solid((*room.center, 0.45), (0.42, 0.42, 0.45))]
        for name, door in self.doors:
            if name != room.name:
                continue
            # First straight in, then to the middle: legs cross the doorway in its centre.
            inside = np.clip(door, [room.x[0] + 0.4, room.y[0] + 0.4], [room.x[1] - 0.4, room.y[1] - 0.4])
            for start, end in ((np.array(door), inside), (inside, middle)):
                length = float(np.linalg.norm(end - start))
                center = (start + end) / 2
                yaw = math.atan2(end[1] - start[1], end[0] - start[0])
                half = (length / 2 + WAY_HALF_M, WAY_HALF_M, 0.45)
                ways.append(Solid((float(center[0]), float(center[1]), 0.45), half, yaw))
        return ways

    def _at_wall(self, room: Room, want: Want) -> Solid | None:
        side = str(self.rng.choice(list(_WALL_YAW)))
        low, high = room.x if side in ("north", "south") else room.y
        if high - low < want.size[0] + 0.04:
            return None
        along = float(self.rng.uniform(low + want.size[0] / 2 + 0.02, high - want.size[0] / 2 - 0.02))
        inward = want.size[1] / 2 + 0.01
        x, y = {
            "north": (along, room.y[1] - inward),
            "south": (along, room.y[0] + inward),
            "east": (room.x[1] - inward, along),
            "west": (room.x[0] + inward, along),
        }[side]
        return _solid(x, y, want, _WALL_YAW[side])

    def _free(self, room: Room, want: Want) -> Solid | None:
        reach = max(want.size[:2]) / 2 + (0.55 if want.chairs else 0.3)
        if min(room.x[1] - room.x[0], room.y[1] - room.y[0]) < 2 * reach:
            return None
        x = float(self.rng.uniform(room.x[0] + reach, room.x[1] - reach))
        y = float(self.rng.uniform(room.y[0] + reach, room.y[1] - reach))
        return _solid(x, y, want, float(self.rng.choice([0.0, math.pi / 2])))

    def _fits(
        self, room: Room, solid: Solid, want: Want, taken: Sequence[Solid], ways: Sequence[Solid]
    ) -> bool:
        corners = solid.corners()
        if not all(room.contains(float(x), float(y), -1e-6) for x, y in corners):
            return False
        if any(overlap_depth(solid, other) > 0 for other in taken):
            return False
        if any(overlap_depth(way, solid) > 0 for way in ways):  # what hangs above the robot is above the ways
            return False
        # Nothing stands or hangs where a door is, whatever its height.
        return not any(
            name == room.name and math.dist(door, solid.center[:2]) < 0.5 + max(solid.half[:2])
            for name, door in self.doors
        )

    def _put(self, room: Room, solid: Solid, want: Want, taken: list[Solid], ways: Sequence[Solid]) -> None:
        piece = _piece(self.name(want.category), want, solid)
        self.pieces.append(piece)
        # Some air around each piece keeps things of one name apart and fronts in view.
        above = _TOP_M if want.holds or want.top else 0.0
        taken.append(_grown(solid, 0.06 if not want.free else _FRONT_M, above))
        self.solids.append(solid)
        if want.top is not None:
            category, size = want.top
            self.pieces.append(Piece(id=self.name(category), category=category, size=size, on=piece.id))
        for dx in _spread(want.holds, want.size[0]):
            cos, sin = math.cos(solid.yaw_rad), math.sin(solid.yaw_rad)
            world = (solid.center[0] + dx * cos, solid.center[1] + dx * sin)
            self.slots.append(Slot(piece.id, (dx, 0.0), world, room.name))
        for dx, dy, yaw in _seats(want):
            cos, sin = math.cos(solid.yaw_rad), math.sin(solid.yaw_rad)
            x = solid.center[0] + dx * cos - dy * sin
            y = solid.center[1] + dx * sin + dy * cos
            chair = Want("chair", (0.42, 0.46, 0.88))
            seat = _solid(x, y, chair, solid.yaw_rad + yaw)
            others = [*(other for other in taken[:-1]), *ways]
            inside = all(room.contains(float(cx), float(cy), 0.02) for cx, cy in seat.corners())
            if inside and not any(overlap_depth(seat, other) > 0 for other in others):
                self.pieces.append(_piece(self.name("chair"), chair, seat))
                taken.append(_grown(seat, 0.04))
                self.solids.append(seat)


def _solid(x: float, y: float, want: Want, yaw: float) -> Solid:
    x, y = round(x, 3), round(y, 3)
    z = (want.z or 0.0) + want.size[2] / 2
    return Solid((x, y, z), (want.size[0] / 2, want.size[1] / 2, want.size[2] / 2), yaw)


def _piece(name: str, want: Want, solid: Solid) -> Piece:
    yaw = round(math.degrees(math.remainder(solid.yaw_rad, math.tau)), 3)
    at = (solid.center[0], solid.center[1])
    return Piece(id=name, category=want.category, size=want.size, at=at, z=want.z or 0.0, yaw_deg=yaw)


def _grown(solid: Solid, margin: float, above: float = 0.0) -> Solid:
    half = (solid.half[0] + margin, solid.half[1] + margin, solid.half[2] + above / 2)
    center = (solid.center[0], solid.center[1], solid.center[2] + above / 2)
    return Solid(center, half, solid.yaw_rad)


def _spread(count: int, width: float) -> list[float]:
    """Offsets of `count` things along a support's width, evenly, the outer ones away from its ends."""
    return [round((i + 0.5) / count * width - width / 2, 3) for i in range(count)]


def _seats(want: Want) -> list[tuple[float, float, float]]:
    """(x, y, yaw) of the chairs at a table or desk, in its own axes, facing it."""
    reach = want.size[1] / 2 + 0.2
    if want.chairs == 1:
        return [(0.0, -reach, math.pi)]
    quarter = want.size[0] / 4
    return [
        (dx, side * reach, 0.0 if side > 0 else math.pi) for side in (1, -1) for dx in (-quarter, quarter)
    ][: want.chairs]
