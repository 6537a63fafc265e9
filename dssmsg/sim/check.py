"""Is a scene sound? Pieces inside each other, in walls or out of reach; tours that cannot be driven."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from dssmsg.errors import InputError
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.occupancy import STEP_OVER, Occupancy
from dssmsg.sim.scene import Scene
from dssmsg.sim.scene_layout import Layout, build_layout
from dssmsg.sim.scene_placement import Placed, Placer, surface_heights
from dssmsg.sim.script import visit_states
from dssmsg.sim.solid import overlap_depth
from dssmsg.sim.tour import tour_of, tour_problems, visit_solids

TOLERANCE_M = 0.012
SMALL_REACH_M = 1.3
"""A mug fills 200 pixels within about this distance, so a stop must be as near to every small thing."""
SMALL_M = 0.4
TWIN_GAP_M = 0.12
"""Two things of one name nearer than this cannot be told apart by position."""
RIM_MAX_M = 0.80
MIRROR_BAND_M = (0.9, 1.6)
_SEATS = {"chair", "stool", "bench"}
_TABLES = {"table", "desk", "dressing table", "kitchen island", "piano"}


def scene_problems(scene: Scene, library: FurnitureLibrary, visits: int = 2) -> tuple[str, ...]:
    """What is wrong with a scene in its first `visits` visits, a line each; empty when it is sound.

    Raises InputError only where the scene cannot be built at all.
    """
    layout = build_layout(scene)
    placer = Placer(scene, library)
    found: dict[str, None] = {}
    for visit in range(visits):
        for state in visit_states(scene, placer, visit):
            for problem in (*_standing(state, layout), *_telling_apart(state), *_seeing(scene, state)):
                found.setdefault(problem)
        occupancy = Occupancy(scene, visit_solids(scene, layout, placer, visit))
        for problem in tour_problems(tour_of(scene, visit), occupancy):
            found.setdefault(f"visit {visit}: {problem}")
    return tuple(found)


def validate_scene(scene: Scene, library: FurnitureLibrary, visits: int = 2) -> None:
    """Raise InputError with the first problem and the number of the others."""
    problems = scene_problems(scene, library, visits)
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise InputError(problems[0] + more, file=scene.name, key="source.scene")


def _standing(state: Mapping[str, Placed], layout: Layout) -> Iterator[str]:
    pieces = [piece for piece in state.values() if piece.solid.half[2] * 2 > STEP_OVER]
    for index, piece in enumerate(pieces):
        if not piece.room:
            yield f"{piece.name} stands in no room"
        for solid in layout.solids:
            depth = overlap_depth(piece.solid, solid)
            if depth > TOLERANCE_M:
                yield f"{piece.name} is {depth:.3f} m inside a wall or door leaf"
        for other in pieces[:index]:
            depth = overlap_depth(piece.solid, other.solid)
            if depth > TOLERANCE_M and not _may_overlap(piece, other, state):
                yield f"{piece.name} is {depth:.3f} m inside {other.name}"


def _may_overlap(first: Placed, second: Placed, state: Mapping[str, Placed]) -> bool:
    """A thing may be inside its support's box (on a sofa's seat), and a seat may be tucked under a table."""
    for one, other in ((first, second), (second, first)):
        below = one.support
        while below:
            if below == other.name:
                return True
            below = state[below].support if below in state else ""
        if one.model.label in _SEATS and other.model.label in _TABLES:
            return True
    return False


def _telling_apart(state: Mapping[str, Placed]) -> Iterator[str]:
    pieces = list(state.values())
    for index, piece in enumerate(pieces):
        for other in pieces[:index]:
            if piece.model.label != other.model.label or piece.model.label == "chair":
                continue
            if piece.room != other.room:  # nobody sees both of them from one side of a wall
                continue
            gap = np.maximum(piece.box_min - other.box_max, other.box_min - piece.box_max)
            distance = float(np.linalg.norm(np.maximum(gap, 0.0)))
            if distance < TWIN_GAP_M:
                yield f"{piece.name} and {other.name} are only {distance:.2f} m apart"


def _seeing(scene: Scene, state: Mapping[str, Placed]) -> Iterator[str]:
    for piece in state.values():
        middle = (piece.box_min + piece.box_max) / 2
        if scene.tour and piece.movable and float((piece.box_max - piece.box_min).max()) < SMALL_M:
            nearest = min(math.dist(stop.at, middle[:2]) for stop in scene.tour)
            if nearest > SMALL_REACH_M:
                yield f"{piece.name} is {nearest:.2f} m from the nearest stop, further than {SMALL_REACH_M} m"
        if piece.model.label == "mirror" and not (
            MIRROR_BAND_M[0] - 1e-6 <= piece.box_min[2] and piece.box_max[2] <= MIRROR_BAND_M[1] + 1e-6
        ):
            yield f"{piece.name} hangs outside {MIRROR_BAND_M[0]} to {MIRROR_BAND_M[1]} m"
        if piece.model.label in ("sink", "washbasin"):
            rim = rim_height(piece)
            if rim > RIM_MAX_M + 1e-3:
                yield f"the rim of {piece.name} is {rim:.2f} m high, above {RIM_MAX_M} m"


def rim_height(piece: Placed) -> float:
    """Height of a basin's rim above the floor, metres: the usual height of its outermost top surface."""
    low, high = piece.model.mesh.bounds
    sides = np.linspace(0.1, 0.9, 9)
    border = [(side, edge) for side in sides for edge in (0.04, 0.06)]
    border += [(edge, side) for side in sides for edge in (0.04, 0.96)]
    points = low[:2] + np.array(border) * (high - low)[:2]
    heights = surface_heights(piece.model.mesh, points)
    heights = heights[np.isfinite(heights)]
    return float(piece.world_from_object[2, 3] + (np.median(heights) if len(heights) else high[2]))
