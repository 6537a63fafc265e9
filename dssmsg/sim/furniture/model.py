"""One piece of furniture, ready to be placed."""

from __future__ import annotations

from dataclasses import dataclass

from dssmsg.sim.mesh import Mesh


@dataclass(frozen=True, slots=True, eq=False)
class FurnitureModel:
    """A furniture mesh with what a scene needs to know of it.

    `mesh` is in the object frame (x width, y depth, z up, front towards -y, origin at the middle of the
    footprint, bottom at z = 0), metres; `size` (x, y, z) metres; `label` is the word a person would use;
    `elevation` metres above the floor at which such a piece hangs (0 = it stands); `credit` names the
    author and licence where the model is not our own.
    """

    category: str
    model: str
    mesh: Mesh
    size: tuple[float, float, float]
    label: str
    credit: str | None
    movable: bool
    elevation: float = 0.0
