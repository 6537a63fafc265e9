"""Things that come to stand in the robot's way while it drives there: a piano in a corridor.

Unlike a scripted change, an obstacle waits for the robot: it appears when the robot drives towards its place
and is near, but never nearer than 1.5 m. It stays for the rest of the run, and no survey tour is held
against it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dssmsg.errors import ConfigError
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.scene import Appear, Obstacle, Piece, Scene
from dssmsg.sim.scene_placement import Placer
from dssmsg.sim.solid import Solid, clearance

NEAREST_M = 1.5
"""An obstacle never appears nearer than this to the robot's axis."""
AHEAD_RAD = math.radians(30.0)
"""It appears only this much off the robot's heading at most."""


def with_obstacles(scene: Scene, obstacles: Sequence[Obstacle], library: FurnitureLibrary) -> Scene:
    """The scene with more obstacles than its own.

    Raises ConfigError (key `source.obstacles`) for an id that the scene has already, and for a place or a
    category that is none.
    """
    if not obstacles:
        return scene
    known = {piece.id for piece in scene.pieces()}
    for index, obstacle in enumerate(obstacles):
        key = f"source.obstacles.{index}.piece"
        if obstacle.piece.id in known:
            raise ConfigError(f"the scene has a {obstacle.piece.id} already; take another number", key=key)
        known.add(obstacle.piece.id)
    more = scene.model_copy(update={"obstacles": (*scene.obstacles, *obstacles)})
    placer = Placer(more, library)
    placed = placer.initial()
    for index, obstacle in enumerate(obstacles):
        try:
            placer.place(obstacle.piece, obstacle.piece, placed)
        except (KeyError, ValueError) as error:
            message = f"cannot be placed: {error}"
            raise ConfigError(message, key=f"source.obstacles.{index}.piece") from None
    return more


class Obstacles:
    """The obstacles of a scene that have not appeared yet."""

    def __init__(self, scene: Scene, placer: Placer, walls: Sequence[Solid]) -> None:
        self._waiting = list(scene.obstacles)
        self._placer = placer
        self._solids: dict[str, Solid] = {}
        self._walls = tuple(walls)

    def names(self) -> frozenset[str]:
        """Names of all pieces that may still appear."""
        return frozenset(obstacle.piece.id for obstacle in self._waiting)

    def due(self, visit: int, pose: tuple[float, float, float]) -> list[Appear]:
        """What appears now; `pose` is the robot's x, y (metres) and heading (radians)."""
        due = []
        for obstacle in list(self._waiting):
            if visit < obstacle.from_visit:
                continue
            if not self._is_ahead(self._solid(obstacle.piece), pose, obstacle.within):
                continue
            self._waiting.remove(obstacle)
            due.append(Appear(kind="appear", piece=obstacle.piece, during_visit=visit, at_time=0.0))
        return due

    def _solid(self, piece: Piece) -> Solid:
        """Where a piece will stand; on the floor that depends on nothing else."""
        if piece.id not in self._solids:
            self._solids[piece.id] = self._placer.place(piece, piece, {}).solid
        return self._solids[piece.id]

    def _is_ahead(self, solid: Solid, pose: tuple[float, float, float], within: float) -> bool:
        """Whether a solid would stand ahead in free sight, not too near and not too far."""
        x, y, heading = pose
        dx, dy = solid.center[0] - x, solid.center[1] - y
        if abs(math.remainder(math.atan2(dy, dx) - heading, math.tau)) > AHEAD_RAD:
            return False
        gap = float(clearance(np.array([[x, y]]), [solid])[0])
        if not NEAREST_M <= gap <= within:
            return False
        sight = np.linspace((x, y), solid.center[:2], max(2, math.ceil(math.hypot(dx, dy) / 0.05)))
        return not self._walls or float(clearance(sight, self._walls).min()) > 0.0
