"""Furniture put in its place: from a scene file's `wall`, `at` and `on` to poses, boxes and solids."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from dssmsg.errors import InputError
from dssmsg.frame import FloatArray
from dssmsg.sim.furniture import FurnitureLibrary, FurnitureModel
from dssmsg.sim.mesh import Mesh
from dssmsg.sim.scene import Piece, Placement, Scene
from dssmsg.sim.solid import Solid

_WALL_YAW_DEG = {"north": 0.0, "east": -90.0, "south": 180.0, "west": 90.0}


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """A piece where it stands now.

    world_from_object (4, 4); box_min, box_max (3,) the true mesh's axis-aligned box in world metres.
    """

    instance_id: int
    piece: Piece
    model: FurnitureModel
    world_from_object: FloatArray
    box_min: FloatArray
    box_max: FloatArray
    solid: Solid
    room: str
    support: str = ""
    """Name of the piece it rests on, '' for the floor or a wall."""

    @property
    def name(self) -> str:
        """The piece's id in the scene file."""
        return self.piece.id

    @property
    def movable(self) -> bool:
        """Whether people move it."""
        return self.model.movable if self.piece.movable is None else self.piece.movable


@dataclass(frozen=True, slots=True, eq=False)
class Placer:
    """Places the pieces of one scene with the models of one library."""

    scene: Scene
    library: FurnitureLibrary
    _models: dict[str, FurnitureModel] = field(default_factory=dict, init=False, repr=False)

    def initial(self) -> dict[str, Placed]:
        """Every piece of the scene's `furniture`, by id, before any change; supports come first."""
        placed: dict[str, Placed] = {}
        waiting = list(self.scene.furniture)
        while waiting:
            ready = [piece for piece in waiting if piece.on is None or piece.on in placed]
            if not ready:
                raise InputError("pieces carry each other in a circle", key=f"furniture.{waiting[0].id}.on")
            for piece in ready:
                placed[piece.id] = self.place(piece, piece, placed)
            waiting = [piece for piece in waiting if piece.id not in placed]
        return placed

    def model(self, piece: Piece) -> FurnitureModel:
        """The model of a piece, asked of the library once."""
        if piece.id not in self._models:
            self._models[piece.id] = self.library.model(piece.category, model=piece.model, size=piece.size)
        return self._models[piece.id]

    def place(self, piece: Piece, where: Placement, others: Mapping[str, Placed]) -> Placed:
        """`piece` standing as `where` says; InputError if its support is absent or not below it."""
        model = self.model(piece)
        low, high = model.mesh.bounds
        yaw = math.radians(where.yaw_deg)
        z = where.z if where.z is not None else 0.0 if where.on else model.elevation
        if where.wall is not None:
            x, y, wall_yaw = self._at_wall(where, float(high[1] - low[1]))
            yaw += wall_yaw
        elif where.on is not None:
            support = others.get(where.on)
            if support is None:
                raise InputError(f"{where.on} is not in the scene then", key=f"{piece.id}.on")
            yaw += support.solid.yaw_rad
            dx, dy = where.at or (0.0, 0.0)
            x, y, _ = (support.world_from_object @ [dx, dy, 0.0, 1.0])[:3]
            if where.z is None:
                z = self._rest(piece, support, (dx, dy), math.radians(where.yaw_deg), (low, high))
        else:
            x, y = where.at or (0.0, 0.0)
        cos, sin = math.cos(yaw), math.sin(yaw)
        pose = np.array([[cos, -sin, 0, x], [sin, cos, 0, y], [0, 0, 1, z], [0, 0, 0, 1]], dtype=np.float64)
        vertices = model.mesh.vertices @ pose[:3, :3].T + pose[:3, 3]
        center = pose[:3, :3] @ ((low + high) / 2) + pose[:3, 3]
        half = (high - low) / 2
        solid = Solid(
            (float(center[0]), float(center[1]), float(center[2])),
            (float(half[0]), float(half[1]), float(half[2])),
            yaw,
            piece.id,
        )
        box_min, box_max = vertices.min(axis=0), vertices.max(axis=0)
        middle = (box_min + box_max) / 2
        room = self.scene.room_at(float(middle[0]), float(middle[1]))
        number = self.instance_id(piece.id)
        return Placed(number, piece, model, pose, box_min, box_max, solid, room, where.on or "")

    def instance_id(self, name: str) -> int:
        """The number of a piece in instance images: its place in `Scene.pieces()`, from 1."""
        for index, piece in enumerate(self.scene.pieces()):
            if piece.id == name:
                return index + 1
        raise KeyError(name)

    def _at_wall(self, where: Placement, depth: float) -> tuple[float, float, float]:
        name, _, side = (where.wall or "").partition(".")
        along = where.along or 0.0
        room = self.scene.room(name)
        inward = where.gap + depth / 2
        yaw = math.radians(_WALL_YAW_DEG[side])
        if side in ("north", "south"):
            y = room.y[1] - inward if side == "north" else room.y[0] + inward
            return room.x[0] + along, y, yaw
        x = room.x[1] - inward if side == "east" else room.x[0] + inward
        return x, room.y[0] + along, yaw

    def _rest(
        self,
        piece: Piece,
        support: Placed,
        offset: tuple[float, float],
        yaw: float,
        bounds: tuple[FloatArray, FloatArray],
    ) -> float:
        """World height at which a piece comes to rest when it is let down onto its support's mesh."""
        low, high = bounds
        grid = np.stack(np.meshgrid([-0.4, 0.0, 0.4], [-0.4, 0.0, 0.4]), axis=-1).reshape(-1, 2)
        local = grid * (high - low)[:2] + ((low + high) / 2)[:2]
        cos, sin = math.cos(yaw), math.sin(yaw)
        points = local @ np.array([[cos, sin], [-sin, cos]]) + np.asarray(offset)
        heights = surface_heights(support.model.mesh, points)
        if not np.isfinite(heights).any():
            raise InputError(
                f"does not lie over {support.name}; its offset must be within half of that one's size "
                f"({support.model.size[0]:.2f} x {support.model.size[1]:.2f} m)",
                key=f"{piece.id}.at",
            )
        return float(support.world_from_object[2, 3] + heights[np.isfinite(heights)].max())


def surface_heights(mesh: Mesh, points: FloatArray) -> FloatArray:
    """Height (N,) of the mesh's highest surface over each point (N, 2) of its own frame; -inf beside it."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    level = np.abs(area) > 1e-12  # upright faces have no height of their own
    a, ab, ac, area = a[level], ab[level], ac[level], area[level]
    heights = np.full(len(points), -np.inf)
    for index, point in enumerate(points):
        offset = point - a[:, :2]
        u = (offset[:, 0] * ac[:, 1] - offset[:, 1] * ac[:, 0]) / area
        v = (ab[:, 0] * offset[:, 1] - ab[:, 1] * offset[:, 0]) / area
        hit = (u >= 0) & (v >= 0) & (u + v <= 1)
        if hit.any():
            heights[index] = float((a[hit, 2] + u[hit] * ab[hit, 2] + v[hit] * ac[hit, 2]).max())
    return heights
