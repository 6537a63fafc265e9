"""What the simulator knows and perception must find out: names, boxes and states of all objects."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dssmsg.frame import FloatArray, TruthObject
from dssmsg.sim.scene_placement import Placed

MOVED_M = 0.02
"""A piece whose pose differs by more than this from where the first visit found it counts as moved."""


class TruthLog:
    """Remembers every piece that was ever there, and tells each one's state since the first visit began."""

    def __init__(self, initial: Mapping[str, Placed]) -> None:
        self._initial = dict(initial)
        self._last = dict(initial)
        self._now = dict(initial)
        self._objects: tuple[TruthObject, ...] | None = None

    def update(self, now: Mapping[str, Placed]) -> None:
        """Take over the furniture as it is now."""
        self._now = dict(now)
        self._last.update(now)
        self._objects = None

    def objects(self) -> tuple[TruthObject, ...]:
        """All pieces that are or were there, by instance id; those that are gone keep their last box."""
        if self._objects is None:
            ordered = sorted(self._last.values(), key=lambda piece: piece.instance_id)
            self._objects = tuple(self._describe(piece) for piece in ordered)
        return self._objects

    def state(self, name: str) -> str:
        """static, appeared, disappeared or moved; KeyError for a piece that never was there."""
        last = self._last[name]
        if name not in self._now:
            return "disappeared"
        if name not in self._initial:
            return "appeared"
        shift = np.abs(last.world_from_object - self._initial[name].world_from_object).max()
        return "moved" if shift > MOVED_M else "static"

    def _describe(self, piece: Placed) -> TruthObject:
        return TruthObject(
            instance_id=piece.instance_id,
            name=piece.name,
            label=piece.model.label,
            box_min=_frozen(piece.box_min),
            box_max=_frozen(piece.box_max),
            room=piece.room,
            movable=piece.movable,
            state=self.state(piece.name),
        )


def _frozen(corner: FloatArray) -> FloatArray:
    corner = corner.astype(np.float64)
    corner.flags.writeable = False
    return corner
