"""Walls, floors, ceilings and doors of a scene, as one mesh for the camera and as solids for the robot.

The plan is cut into cells along every room edge and opening. A cell inside a room is floor, one within a
wall's thickness of a room is wall, unless an opening goes through it. Surfaces are drawn where a room
cell meets a wall cell, in the room's own colour, so that each side of a wall may look different.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from dssmsg.errors import InputError
from dssmsg.frame import FloatArray
from dssmsg.sim.mesh import Mesh, box, from_triangles, merge
from dssmsg.sim.scene import Color, Door, Room, Scene
from dssmsg.sim.solid import Solid

LEAF_THICKNESS = 0.04
MAX_DOOR_GAP = 0.5
_CEILING: Color = (238, 238, 234)
_FRAME: Color = (226, 220, 208)
_LEAF: Color = (205, 178, 140)
_FLOORS: dict[str, Color] = {
    "kitchen": (176, 168, 152),
    "bathroom": (158, 172, 178),
    "bedroom": (178, 142, 104),
    "corridor": (166, 136, 104),
    "lobby": (150, 146, 140),
    "storage": (146, 142, 138),
}
_WALLS: dict[str, Color] = {
    "kitchen": (236, 230, 206),
    "bathroom": (204, 222, 228),
    "bedroom": (216, 222, 232),
    "corridor": (232, 228, 220),
    "storage": (216, 214, 208),
}
_DEFAULT_FLOOR: Color = (184, 150, 112)
_DEFAULT_WALL: Color = (234, 226, 212)


@dataclass(frozen=True, slots=True)
class Opening:
    """A door's hole in plan: `low` and `high` corners (x, y); `axis` is 0 where one walks along x."""

    door: Door
    low: tuple[float, float]
    high: tuple[float, float]
    axis: int

    @property
    def center(self) -> tuple[float, float]:
        """Middle of the hole on the floor, world metres."""
        return ((self.low[0] + self.high[0]) / 2, (self.low[1] + self.high[1]) / 2)


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """The structure of a scene: `mesh` in world metres, `solids` (walls, lintels and leaves), `openings`."""

    mesh: Mesh
    solids: tuple[Solid, ...]
    openings: tuple[Opening, ...]


def build_layout(scene: Scene, closed: Collection[str] = ()) -> Layout:
    """The structure of `scene` with the doors named in `closed` shut and the others as the file has them.

    InputError where a door's rooms do not face each other across a wall.
    """
    openings = tuple(_opening(scene, door) for door in scene.doors)
    xs, ys = _cuts(scene, openings)
    room_of, wall = _classify(scene, openings, xs, ys)
    meshes = _surfaces(scene, openings, xs, ys, room_of, wall)
    solids = [
        Solid((*_mid(low, high), scene.wall_height / 2), (*_half(low, high), scene.wall_height / 2))
        for low, high in _merged(wall, xs, ys)
    ]
    for opening in openings:
        gap = scene.wall_height - opening.door.height
        if gap > 0.01:
            z = opening.door.height + gap / 2
            solids.append(Solid((*opening.center, z), (*_half(opening.low, opening.high), gap / 2)))
        leaf = _shut(opening) if opening.door.name in closed else _leaf(scene, opening)
        if leaf is not None:
            solids.append(leaf)
            turn = np.eye(4)
            cos, sin = math.cos(leaf.yaw_rad), math.sin(leaf.yaw_rad)
            turn[:2, :2] = [[cos, -sin], [sin, cos]]
            turn[:3, 3] = leaf.center
            panel = box([2 * part for part in leaf.half], _LEAF, center=(0.0, 0.0, 0.0))
            meshes.append(panel.transformed(turn))
    return Layout(merge(meshes), tuple(solids), openings)


def _mid(low: tuple[float, float], high: tuple[float, float]) -> tuple[float, float]:
    return ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)


def _half(low: tuple[float, float], high: tuple[float, float]) -> tuple[float, float]:
    return ((high[0] - low[0]) / 2, (high[1] - low[1]) / 2)


def _opening(scene: Scene, door: Door) -> Opening:
    first, second = (scene.room(name) for name in door.between)
    for axis in (0, 1):
        a, b = ((first.x, second.x), (first.y, second.y))[axis]
        if a[0] > b[0]:
            a, b = b, a
        across = ((first.y, second.y), (first.x, second.x))[axis]
        shared = (max(across[0][0], across[1][0]), min(across[0][1], across[1][1]))
        low, high = door.along - door.width / 2, door.along + door.width / 2
        if 0 < b[0] - a[1] <= MAX_DOOR_GAP and shared[0] - 1e-9 <= low and high <= shared[1] + 1e-9:
            if axis == 0:
                return Opening(door, (a[1], low), (b[0], high), 0)
            return Opening(door, (low, a[1]), (high, b[0]), 1)
    raise InputError(
        f"no wall between {first.name} and {second.name} holds an opening of {door.width} m centred at "
        f"{door.along}; the rooms must face each other within {MAX_DOOR_GAP} m there",
        key=f"doors.{door.name}",
    )


def _cuts(scene: Scene, openings: tuple[Opening, ...]) -> tuple[FloatArray, FloatArray]:
    t = scene.wall_thickness
    xs = [edge + d for room in scene.rooms for edge in room.x for d in (-t, 0.0, t)]
    ys = [edge + d for room in scene.rooms for edge in room.y for d in (-t, 0.0, t)]
    for opening in openings:
        xs += [opening.low[0], opening.high[0]]
        ys += [opening.low[1], opening.high[1]]
    return np.unique(np.round(xs, 6)), np.unique(np.round(ys, 6))


def _classify(
    scene: Scene, openings: tuple[Opening, ...], xs: FloatArray, ys: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(room index + 1 or 0, is wall) a cell; an opening's cells are -1 - its index and no wall."""
    mid_x, mid_y = (xs[:-1] + xs[1:]) / 2, (ys[:-1] + ys[1:]) / 2
    room_of = np.zeros((len(mid_x), len(mid_y)))
    wall = np.zeros_like(room_of)
    t = scene.wall_thickness

    def inside(x: tuple[float, float], y: tuple[float, float]) -> FloatArray:
        return np.asarray(
            np.outer((mid_x > x[0]) & (mid_x < x[1]), (mid_y > y[0]) & (mid_y < y[1])), dtype=np.float64
        )

    for index, room in enumerate(scene.rooms):
        cells = inside(room.x, room.y) > 0
        if (room_of[cells] != 0).any():
            raise InputError("rooms overlap", key=f"rooms.{room.name}")
        room_of[cells] = index + 1
        wall[inside((room.x[0] - t, room.x[1] + t), (room.y[0] - t, room.y[1] + t)) > 0] = 1
    wall[room_of > 0] = 0
    for index, opening in enumerate(openings):
        cells = inside((opening.low[0], opening.high[0]), (opening.low[1], opening.high[1])) > 0
        wall[cells] = 0
        room_of[cells] = -1 - index
    return room_of, wall


def _merged(
    wall: FloatArray, xs: FloatArray, ys: FloatArray
) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """The wall cells as few rectangles: greedy, first along x, then y."""
    left = wall > 0
    rectangles = []
    for i in range(left.shape[0]):
        for j in range(left.shape[1]):
            if not left[i, j]:
                continue
            width = 1
            while i + width < left.shape[0] and left[i + width, j]:
                width += 1
            height = 1
            while j + height < left.shape[1] and left[i : i + width, j + height].all():
                height += 1
            left[i : i + width, j : j + height] = False
            rectangles.append(((float(xs[i]), float(ys[j])), (float(xs[i + width]), float(ys[j + height]))))
    return rectangles


def _leaf(scene: Scene, opening: Opening) -> Solid | None:
    """The open leaf as a solid: hinged at one end of the opening, on the side it opens into."""
    door, axis = opening.door, opening.axis
    if door.leaf is None:
        return None
    room = scene.room(door.leaf.into)
    # Work in the opening's own axes: u along the wall, v out of the wall into the room.
    into_high = room.center[axis] > opening.center[axis]
    out = 1.0 if into_high else -1.0
    v0 = (opening.high if into_high else opening.low)[axis]
    along = 1 - axis
    at_low = door.leaf.hinge == "low"
    u0 = (opening.low if at_low else opening.high)[along]
    swing = math.radians(door.leaf.angle_deg)
    du, dv = math.cos(swing) * (1.0 if at_low else -1.0), math.sin(swing) * out
    length = door.width - 0.01
    u = u0 + du * length / 2
    v = v0 + dv * length / 2 + (out * LEAF_THICKNESS / 2)
    center = (v, u) if axis == 0 else (u, v)
    direction = (dv, du) if axis == 0 else (du, dv)
    height = door.height - 0.01
    return Solid(
        (center[0], center[1], height / 2),
        (length / 2, LEAF_THICKNESS / 2, height / 2),
        math.atan2(direction[1], direction[0]),
    )


def _shut(opening: Opening) -> Solid:
    """The closed leaf: it fills the opening in the middle of the wall."""
    half = list(_half(opening.low, opening.high))
    half[opening.axis] = LEAF_THICKNESS / 2
    height = opening.door.height
    return Solid((*opening.center, height / 2), (half[0], half[1], height / 2))


def _surfaces(
    scene: Scene,
    openings: tuple[Opening, ...],
    xs: FloatArray,
    ys: FloatArray,
    room_of: FloatArray,
    wall: FloatArray,
) -> list[Mesh]:
    meshes = []
    for room in scene.rooms:
        meshes.append(_flat(room.x, room.y, 0.0, _color(room, floor=True), up=True))
        meshes.append(_flat(room.x, room.y, scene.wall_height, _CEILING, up=False))
    for opening in openings:
        x, y = (opening.low[0], opening.high[0]), (opening.low[1], opening.high[1])
        first = scene.room(opening.door.between[0])
        meshes.append(_flat(x, y, 0.0, _color(first, floor=True), up=True))
        meshes.append(_flat(x, y, min(opening.door.height, scene.wall_height), _FRAME, up=False))
    columns, rows = room_of.shape
    for i in range(columns):
        for j in range(rows):
            here = int(room_of[i, j])
            if here == 0:
                continue
            for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                ni, nj = i + di, j + dj
                outside = not (0 <= ni < columns and 0 <= nj < rows)
                there = 0 if outside else int(room_of[ni, nj])
                if there == here or (here < 0 and there > 0):
                    continue  # the same space, or an opening that looks into its room
                if here > 0:
                    color = _color(scene.rooms[here - 1], floor=False)
                    low = openings[-1 - there].door.height if there < 0 else 0.0
                    high = scene.wall_height
                else:
                    color, low, high = _FRAME, 0.0, openings[-1 - here].door.height
                if high - low < 1e-6:
                    continue
                x0, x1, y0, y1 = float(xs[i]), float(xs[i + 1]), float(ys[j]), float(ys[j + 1])
                start, end = {
                    (1, 0): ((x1, y0), (x1, y1)),
                    (-1, 0): ((x0, y1), (x0, y0)),
                    (0, 1): ((x1, y1), (x0, y1)),
                    (0, -1): ((x0, y0), (x1, y0)),
                }[di, dj]
                meshes.append(_upright(start, end, low, high, color))
    return meshes


def _color(room: Room, *, floor: bool) -> Color:
    chosen = room.floor_color if floor else room.wall_color
    if chosen is not None:
        return chosen
    table, default = (_FLOORS, _DEFAULT_FLOOR) if floor else (_WALLS, _DEFAULT_WALL)
    return next((color for kind, color in table.items() if kind in room.type), default)


def _flat(x: tuple[float, float], y: tuple[float, float], z: float, color: Color, *, up: bool) -> Mesh:
    corners = [(x[0], y[0], z), (x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z)]
    return from_triangles(corners, [[0, 1, 2], [0, 2, 3]] if up else [[0, 2, 1], [0, 3, 2]], color)


def _upright(
    start: tuple[float, float], end: tuple[float, float], low: float, high: float, color: Color
) -> Mesh:
    corners = [(*start, low), (*end, low), (*end, high), (*start, high)]
    return from_triangles(corners, [[0, 2, 1], [0, 3, 2]], color)  # faces the space it bounds
