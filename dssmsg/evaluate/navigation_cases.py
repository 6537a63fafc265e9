"""What a robot is asked to do in an evaluation of navigation: goals, and obstacles on its ways, by a seed."""

from __future__ import annotations

import itertools
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.evaluate.queries import load_queries
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.occupancy import Occupancy
from dssmsg.sim.scene import STOCK_SCENES, Obstacle, Piece, Scene, load_scene
from dssmsg.sim.scene_layout import build_layout
from dssmsg.sim.scene_placement import Placed, Placer
from dssmsg.sim.script import visit_states
from dssmsg.sim.solid import Solid, clearance, overlap_depth
from dssmsg.sim.tour import visit_solids

SEEK_VISIT = 1
Point = tuple[float, float]
_PASSABLE_M = (0.3, 0.27, 0.24, 0.22)
"""A robot of the first of these radii that gets everywhere in a home still must with obstacles in it."""
_FROM_STOPS_M = 0.75
_TRIES = 120
_THINGS: tuple[tuple[str, tuple[float, float, float]], ...] = (
    ("piano", (1.42, 0.56, 1.3)),
    ("box", (0.5, 0.4, 0.45)),
    ("suitcase", (0.46, 0.26, 0.68)),
    ("chair", (0.44, 0.48, 0.9)),
    ("armchair", (0.8, 0.8, 0.85)),
    ("dresser", (0.9, 0.4, 0.8)),
)


@dataclass(frozen=True, slots=True)
class Goal:
    """A sentence and the names of the pieces that answer it."""

    text: str
    targets: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Case:
    """One survey and the episodes that follow it, in the visit after."""

    scene: str
    seed: int
    goals: tuple[Goal, ...]
    obstacles: tuple[Obstacle, ...]


class Home:
    """A scene as it stands in the visit of the episodes."""

    def __init__(self, name: str, assets: str) -> None:
        self.name = name
        self.scene: Scene = load_scene(name)
        self.library = FurnitureLibrary.open(assets)
        self.placer = Placer(self.scene, self.library)
        layout = build_layout(self.scene)
        self.solids = visit_solids(self.scene, layout, self.placer, SEEK_VISIT)
        self._occupancy: Occupancy | None = None

    def unchanged(self) -> frozenset[str]:
        """Names of the pieces that stand in the episodes where the survey found them."""
        before = self.placer.initial()
        states: list[Mapping[str, Placed]] = [*visit_states(self.scene, self.placer, SEEK_VISIT)]
        return frozenset(
            name
            for name, piece in before.items()
            if all(
                name in state and np.allclose(state[name].world_from_object, piece.world_from_object)
                for state in states
            )
        )

    def shortest(self, start: Point, ends: Sequence[Point]) -> float | None:
        """Metres of the shortest way for a robot from `start` to the nearest of `ends`; None without one."""
        if self._occupancy is None:
            self._occupancy = Occupancy(self.scene, self.solids)
        best: float | None = None
        for end in sorted(ends, key=lambda place: math.dist(start, place)):
            if best is not None and math.dist(start, end) >= best:
                break
            path = self._occupancy.path(start, end)
            if path is not None:
                length = sum(math.dist(a, b) for a, b in itertools.pairwise(path))
                best = length if best is None else min(best, length)
        return best


def make_case(home: Home, seed: int, episodes: int, obstacles: int) -> Case:
    """Goals and obstacles of one home, the same for the same seed.

    Goals are the packaged queries of the scene, for other homes the scene's own and "the <label>"; at least
    one answer of each stands where the survey found it, and an obstacle that bears the label is one as well.
    Two in a row have no answer in common.
    """
    rng = np.random.default_rng((seed, zlib.crc32(home.name.encode())))
    pool = possible_goals(home)
    goals: list[Goal] = []
    while len(goals) < episodes and pool:
        last = set(goals[-1].targets) if goals else set()
        fitting = [goal for goal in pool if not last & set(goal.targets)] or pool
        goals.append(fitting[int(rng.integers(len(fitting)))])
        if len(pool) > 1:
            pool = [goal for goal in pool if goal != goals[-1]]
    met = tuple(_obstacles(home, rng, obstacles))
    return Case(home.name, seed, tuple(_answered(home, goal, met) for goal in goals), met)


def _answered(home: Home, goal: Goal, obstacles: Sequence[Obstacle]) -> Goal:
    """The goal with the obstacles that answer it, too: who asks for "the chair" may be led to any chair."""
    met = [one.piece.id for one in obstacles if goal.text == f"the {home.placer.model(one.piece).label}"]
    return Goal(goal.text, (*goal.targets, *met))


def possible_goals(home: Home) -> list[Goal]:
    """All sentences for a home that can be answered after its changes."""
    there = home.unchanged()
    if home.name in STOCK_SCENES:
        goals = [Goal(query.text, query.targets) for query in load_queries(home.name)]
    else:
        goals = [Goal(query.text, query.targets) for query in home.scene.queries]
        labels: dict[str, list[str]] = {}
        for piece in home.scene.pieces():
            labels.setdefault(home.placer.model(piece).label, []).append(piece.id)
        goals += [Goal(f"the {label}", tuple(names)) for label, names in sorted(labels.items())]
    return [goal for goal in goals if there & set(goal.targets)]


def _obstacles(home: Home, rng: np.random.Generator, count: int) -> Iterator[Obstacle]:
    """Things across the ways of the survey's tour, which leave some way to every stop."""
    legs = list(_legs(home.scene))
    lengths = np.array([math.dist(a, b) for a, b in legs])
    stops = [stop.at for stop in home.scene.tour]
    solids: list[Solid] = list(home.solids)
    empty = Occupancy(home.scene, solids)
    radius = next((r for r in _PASSABLE_M if empty.connected(stops, r)), None)
    if radius is None:
        return
    number = 900  # far above the numbers of the scene's own pieces
    for _ in range(_TRIES):
        if count <= 0 or not lengths.sum():
            return
        a, b = legs[int(rng.choice(len(legs), p=lengths / lengths.sum()))]
        category, size = _THINGS[int(rng.integers(len(_THINGS)))]
        share, aside = float(rng.uniform(0.15, 0.85)), float(rng.uniform(-0.3, 0.3))
        bearing = math.atan2(b[1] - a[1], b[0] - a[0])
        x = a[0] + share * (b[0] - a[0]) - aside * math.sin(bearing)
        y = a[1] + share * (b[1] - a[1]) + aside * math.cos(bearing)
        number += 1
        piece = Piece(
            id=f"{category.replace(' ', '_')}-{number}",
            category=category,
            size=size,
            at=(round(x, 3), round(y, 3)),
            yaw_deg=round(math.degrees(math.remainder(bearing + math.pi / 2, math.tau)), 1),
        )
        solid = Solid((x, y, size[2] / 2), (size[0] / 2, size[1] / 2, size[2] / 2), bearing + math.pi / 2)
        if home.scene.room_at(x, y) and _fits(solid, solids, stops) and _lies_across(solid, a, b):
            if not Occupancy(home.scene, [*solids, solid]).connected(stops, radius):
                continue
            solids.append(solid)
            count -= 1
            yield Obstacle(piece=piece, from_visit=SEEK_VISIT)


def _legs(scene: Scene) -> Iterator[tuple[Point, Point]]:
    """The straight legs of the tour, but for short ones: an obstacle appears 1.5 m ahead."""
    for before, after in itertools.pairwise(scene.tour):
        for a, b in itertools.pairwise([before.at, *after.via, after.at]):
            if math.dist(a, b) > 1.0:
                yield a, b


def _fits(solid: Solid, others: Sequence[Solid], stops: Sequence[Point]) -> bool:
    if float(clearance(np.asarray(stops), [solid]).min()) < _FROM_STOPS_M:
        return False
    return all(overlap_depth(solid, other) <= 0.0 for other in others)


def _lies_across(solid: Solid, a: Point, b: Point) -> bool:
    return float(clearance(np.linspace(a, b, 50), [solid]).min()) < 0.1
