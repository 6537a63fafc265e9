"""Where a thing could stand in a furnished home: on something, on the floor, within sight of a stop."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.errors import InputError
from dssmsg.interfaces.source import Stop
from dssmsg.sim.occupancy import ROBOT_RADIUS, Occupancy, blocks
from dssmsg.sim.scene import Piece, Placement, Room, Scene
from dssmsg.sim.scene_layout import Layout
from dssmsg.sim.scene_placement import Placed, Placer, surface_heights
from dssmsg.sim.solid import Solid, overlap_depth

SMALL_REACH_M = 1.2
LARGE_REACH_M = 3.0
SMALL_M = 0.45
"""Up to this length, a thing is put on furniture and must be near a stop to fill 200 pixels."""
TWIN_M = 0.6
"""Two things of one label keep this distance, so that which one went is not a riddle."""
_AIR_M = 0.04
_DOORWAY_M = 0.6
_LEG_M = ROBOT_RADIUS + 0.05
_TOP_M = (0.3, 1.1)
_LEVEL_M = 0.015
_ON_FLOOR = {"basket", "chair", "shoes", "stool", "suitcase", "trash can"}
_OFTEN_ON_FLOOR = {"backpack", "ball", "box", "teddy bear"}
_NOT_ON = {"bathtub", "sink", "toilet", "washbasin"}
"""Labels of what stands on the floor always, or mostly, and of what nothing is put on."""


@dataclass(frozen=True, slots=True, eq=False)
class Spots:
    """Draws places in one home. `tours` are those of the visits in which the thing will stand there."""

    scene: Scene
    placer: Placer
    layout: Layout
    tours: Sequence[Sequence[Stop]]

    def draw(
        self,
        rng: np.random.Generator,
        piece: Piece,
        others: Mapping[str, Placed],
        *,
        rooms: Collection[str] | None = None,
        accept: Callable[[Placed], bool] = lambda _placed: True,
        tries: int = 150,
    ) -> tuple[Placed, Placement] | None:
        """`piece` where it stands firmly and free, and how that place is written; None if none was found.

        `others` is the furniture around it; `rooms` are those to choose from, `accept` has the last word.
        """
        model = self.placer.model(piece)
        allowed = [room for room in self.scene.rooms if rooms is None or room.name in rooms]
        supports = [p for p in others.values() if _carries(p) and (rooms is None or p.room in rooms)]
        if max(model.size) > SMALL_M or model.label in _ON_FLOOR:
            supports = []
        for _ in range(tries):
            floor = not supports or (model.label in _OFTEN_ON_FLOOR and rng.random() < 0.7)
            where = _on_floor(rng, allowed) if floor else _on_top(rng, supports)
            placed = self.standing(piece, where, others)
            if placed is not None and accept(placed):
                return placed, where
        return None

    def standing(self, piece: Piece, where: Placement, others: Mapping[str, Placed]) -> Placed | None:
        """`piece` as `where` says, if it stands firmly, hits nothing, blocks no tour and a stop is near."""
        try:
            placed = self.placer.place(piece, where, others)
        except InputError:  # not above its support
            return None
        good = (
            placed.room != ""
            and self._reached(placed)
            and self._inside(placed)
            and (where.on is None or _firm(placed, others[where.on]))
            and self._free(placed, others)
            and self._drivable(placed)
        )
        return placed if good else None

    def _inside(self, placed: Placed) -> bool:
        room = self.scene.room(placed.room)
        return all(room.contains(float(x), float(y), 0.01) for x, y in placed.solid.corners())

    def _free(self, placed: Placed, others: Mapping[str, Placed]) -> bool:
        around = _grown(placed.solid)
        if any(overlap_depth(around, solid) > 0 for solid in self.layout.solids):
            return False
        middle = (placed.box_min + placed.box_max) / 2
        for other in others.values():
            if other.name == placed.name:
                continue
            # A thing may be inside its support's box, as on the seat of a sofa; `_firm` has looked there.
            if other.name != placed.support and overlap_depth(around, other.solid) > 0:
                return False
            if other.model.label == placed.model.label and other.room == placed.room:
                apart = np.linalg.norm(middle - (other.box_min + other.box_max) / 2)
                if apart < TWIN_M:
                    return False
        if placed.support:
            return True
        return all(
            math.dist(opening.center, placed.solid.center[:2]) > _DOORWAY_M + max(placed.solid.half[:2])
            for opening in self.layout.openings
        )

    def _reached(self, placed: Placed) -> bool:
        reach = SMALL_REACH_M if max(placed.model.size) <= SMALL_M else LARGE_REACH_M
        return all(
            any(
                s.room == placed.room and math.dist((s.x, s.y), placed.solid.center[:2]) <= reach
                for s in tour
            )
            for tour in self.tours
        )

    def _drivable(self, placed: Placed) -> bool:
        """Whether the tours keep clear of the piece; what was there before they keep clear of anyway."""
        if placed.support or not blocks(placed.solid):
            return True
        occupancy = Occupancy(self.scene, [placed.solid])
        return all(
            occupancy.leg_clearance(start, end) >= _LEG_M
            for tour in self.tours
            for start, end in itertools.pairwise(_corners(tour))
        )


def _corners(tour: Sequence[Stop]) -> list[tuple[float, float]]:
    corners = [corner for stop in tour for corner in (*stop.via, (stop.x, stop.y))]
    return corners if len(corners) > 1 else corners * 2


def _on_floor(rng: np.random.Generator, rooms: Sequence[Room]) -> Placement:
    area = np.array([room.area for room in rooms])
    room = rooms[int(rng.choice(len(rooms), p=area / area.sum()))]
    x, y = (float(np.round(rng.uniform(low + 0.1, high - 0.1), 3)) for low, high in (room.x, room.y))
    return Placement(at=(x, y), z=0.0, yaw_deg=float(rng.integers(-11, 13) * 15))


def _on_top(rng: np.random.Generator, supports: Sequence[Placed]) -> Placement:
    support = supports[int(rng.integers(len(supports)))]
    half = np.asarray(support.model.size[:2]) / 2
    dx, dy = (float(np.round(rng.uniform(-0.8, 0.8) * part, 3)) for part in half)
    return Placement(on=support.name, at=(dx, dy), yaw_deg=float(np.round(rng.uniform(-30, 30))))


def _carries(piece: Placed) -> bool:
    """Whether a piece is one that things are put on: it stands on the floor, and its top is in view."""
    top = float(piece.box_max[2])
    return (
        not piece.movable
        and piece.support == ""
        and piece.solid.bottom < 0.05
        and _TOP_M[0] <= top <= _TOP_M[1]
    )


def _firm(placed: Placed, support: Placed) -> bool:
    """Whether the middle of a thing's bottom and the corners of it rest on one level of the support."""
    low, high = placed.model.mesh.bounds
    local = np.array([[x, y, 0.0, 1.0] for x in (-0.4, 0.0, 0.4) for y in (-0.4, 0.0, 0.4)])
    local[:, :2] = local[:, :2] * (high - low)[:2] + ((low + high) / 2)[:2]
    on_support = local @ (np.linalg.inv(support.world_from_object) @ placed.world_from_object).T
    heights = surface_heights(support.model.mesh, on_support[:, :2])
    return bool(np.isfinite(heights).all() and np.ptp(heights) <= _LEVEL_M)


def _grown(solid: Solid) -> Solid:
    half = (solid.half[0] + _AIR_M, solid.half[1] + _AIR_M, solid.half[2])
    # Lifted a little: what it stands on does not count as in its way.
    center = (solid.center[0], solid.center[1], solid.center[2] + 0.02)
    return Solid(center, half, solid.yaw_rad, solid.owner)
