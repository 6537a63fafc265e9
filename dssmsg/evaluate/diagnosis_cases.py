"""Small seeded homes and goals in which a fault can be told: what an evaluation of diagnosis is made of."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dssmsg.errors import DssmsgError
from dssmsg.evaluate.diagnosis_views import Shown, shown_by
from dssmsg.evaluate.faults.host import Aim
from dssmsg.evaluate.faults.kinds import FAULTS, Fault
from dssmsg.evaluate.navigation_cases import Goal, Home, possible_goals
from dssmsg.sim.scenario_views import TourViews
from dssmsg.sim.scene import Change, Disappear, Door, Piece, Placement, Relocate, Scene, load_scene

HOMES = 12
"""So many generated homes are taken for the even seeds, and as many others for the odd ones."""
ASSETS = "embedded"
"""The furniture that is always there: the same episodes on every machine."""
_STOPS, _STOPS_CHANGING = 3, 4
_IMAGE_SIZE, _IMAGE_SIZE_CHANGING = (200, 150), (320, 240)
"""Of the episodes' cameras, pixels: few, since hundreds are driven; more where small things move."""
_MOST_MOVES = 40
"""So many places of so many things are looked at for one that a tour shows."""
_MOST_SHOWN = 0.5
"""A goal is shown by no larger share of the views: it is not to be reached by accident."""
_BARRIER = (1.1, 0.3, 1.0)
"""Size of what closes a door, metres."""
_CARRIED = 0.12
"""Cubic metres: what is carried to another place is no larger."""


@dataclass(frozen=True, slots=True)
class FaultCase:
    """One try at an episode: a home of a few stops, a goal, a fault and what it is aimed at."""

    seed: int
    attempt: int
    fault: Fault
    scene: Path
    goal: Goal
    aim: Aim

    @property
    def phases(self) -> tuple[str, ...]:
        """The mission's phases."""
        return ("survey", "revisit", "seek") if self.fault.changes else ("survey", "seek")


def fault_of(seed: int) -> Fault:
    """The fault of a seed; the even and the odd seeds each go through all of them."""
    return FAULTS[(seed // 2) % len(FAULTS)]


def image_size(fault: Fault) -> tuple[int, int]:
    """Width and height of the images in episodes with a fault, pixels."""
    return _IMAGE_SIZE_CHANGING if fault.changes else _IMAGE_SIZE


def make_case(work: Path, folder: Path, seed: int, attempt: int, views: TourViews) -> FaultCase | None:
    """A try at the episode of a seed, its scene written into a folder; None where the home does not fit.

    The same for the same seed and attempt. Whole homes are kept in the work folder.
    """
    fault = fault_of(seed)
    rng = np.random.default_rng((seed, attempt))
    whole = _home(work, 2 * int(rng.integers(HOMES)) + 1 + seed % 2)
    count = _STOPS_CHANGING if fault.changes else _STOPS
    first = int(rng.integers(max(1, len(whole.tour) - count + 1)))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"home-{seed}-{attempt}.yaml"
    part = _part(whole, first, count)
    scenes: Iterable[tuple[Scene, Piece | None]] = ((part, None),)
    if fault.changes:
        scenes = itertools.islice(_moves(part, rng), _MOST_MOVES)
    for scene, moved in scenes:
        _write(scene, path)
        try:
            case = _case_in(Home(str(path), ASSETS), moved, views, rng, (seed, attempt, fault, path))
        except DssmsgError:  # the thing cannot stand where it was to be carried
            continue
        if case is not None:
            return case
    return None


def _case_in(
    home: Home,
    moved: Piece | None,
    views: TourViews,
    rng: np.random.Generator,
    about: tuple[int, int, Fault, Path],
) -> FaultCase | None:
    """The episode in a home, if its tour shows something that is worth asking for."""
    width, _ = image_size(about[2])
    labels = {piece.id: home.placer.model(piece).label for piece in home.scene.pieces()}
    shown = shown_by(views, home.scene, home.placer, 0, width)
    if moved is None:
        goals = _goals(home, labels, shown)
    elif moved.id in shown.shares and moved.id in shown_by(views, home.scene, home.placer, 1, width).shares:
        goals = [Goal(f"the {labels[moved.id]}", (moved.id,))]
    else:
        goals = []
    if not goals:
        return None
    goal = goals[int(rng.integers(len(goals)))]
    label = labels[goal.targets[0]]
    others = tuple(sorted({labels[name] for name in shown.shares if not _alike(labels[name], label)}))
    if not others:
        return None
    chance = int(rng.integers(1000))
    barriers = tuple(_barrier(home.scene, door, 950 + i) for i, door in enumerate(home.scene.doors))
    return FaultCase(*about, goal, Aim(label, others, chance, 1, barriers))


def _home(work: Path, number: int) -> Scene:
    """A generated home, from the work folder if it is there: drawing its plan takes seconds."""
    kept = work / "homes" / f"generated_{number}.yaml"
    if not kept.is_file():
        kept.parent.mkdir(parents=True, exist_ok=True)
        draft = kept.with_name(f".{kept.name}-{os.getpid()}")
        _write(load_scene(f"generated:{number}"), draft)
        draft.replace(kept)
    return load_scene(str(kept.resolve()))


def _write(scene: Scene, path: Path) -> None:
    path.write_text(json.dumps(scene.model_dump(mode="json", exclude_none=True, by_alias=True)), "utf-8")


def _part(whole: Scene, first: int, count: int) -> Scene:
    """The home with a stretch of its tour, and with what changes before visits or at these stops."""
    tour = whole.tour[first : first + count]
    tour = (tour[0].model_copy(update={"via": ()}), *tour[1:])
    names = {None, *(stop.name for stop in tour)}
    changes = tuple(change for change in whole.changes if getattr(change, "at_stop", None) in names)
    return whole.model_copy(update={"tour": tour, "changes": changes})


def _moves(scene: Scene, rng: np.random.Generator) -> Iterator[tuple[Scene, Piece]]:
    """Homes in which one small thing, the only one of its kind, stands elsewhere in the second visit."""
    placed = {p.id: p for p in scene.furniture if p.at is not None or p.wall is not None}
    small = [
        piece
        for piece in scene.furniture
        if piece.on in placed
        and piece.size is not None
        and math.prod(piece.size) < _CARRIED
        and sum(other.category == piece.category for other in scene.pieces()) == 1
    ]
    supports = sorted({p.on for p in scene.furniture if p.on in placed and p.on})
    pairs = [(piece, onto) for piece in small for onto in supports if onto != piece.on]
    for place in rng.permutation(len(pairs)):
        piece, onto = pairs[int(place)]
        others = [
            change
            for change in scene.changes
            if not (isinstance(change, Relocate | Disappear) and change.object in (piece.id, onto))
            and _support(change) != onto
        ]
        to = Placement(on=onto, at=(0.0, 0.0))
        move = Relocate(kind="relocate", object=piece.id, before_visit=1, to=to)
        yield scene.model_copy(update={"changes": (*others, move)}), piece


def _support(change: Change) -> str | None:
    place = getattr(change, "piece", None) or getattr(change, "to", None)
    return None if place is None else place.on


def _goals(home: Home, labels: Mapping[str, str], shown: Shown) -> list[Goal]:
    """Sentences that name one kind of thing, which some views of the tour show, but none at its end."""
    return [
        goal
        for goal in possible_goals(home)
        if len({labels[name] for name in goal.targets}) == 1
        and 0.0 < sum(shown.shares.get(name, 0.0) for name in goal.targets) <= _MOST_SHOWN
        and not shown.last & set(goal.targets)
    ]


def _alike(a: str, b: str) -> bool:
    return set(a.split()) & set(b.split()) != set()


def _barrier(scene: Scene, door: Door, number: int) -> Mapping[str, Any]:
    """Something in a door, an entry of `source.obstacles`; it appears ahead of the robot in visit 1."""
    a, b = (scene.room(name) for name in door.between)
    beside = [(abs(a.x[1] - b.x[0]), a.x[1], b.x[0]), (abs(b.x[1] - a.x[0]), b.x[1], a.x[0])]
    above = [(abs(a.y[1] - b.y[0]), a.y[1], b.y[0]), (abs(b.y[1] - a.y[0]), b.y[1], a.y[0])]
    side, over = min(beside), min(above)
    upright = side[0] <= over[0]
    wall = (side if upright else over)[1:]
    middle = sum(wall) / 2
    at = (middle, door.along) if upright else (door.along, middle)
    return {
        "piece": {
            "id": f"box-{number}",
            "category": "box",
            "size": list(_BARRIER),
            "at": [round(at[0], 3), round(at[1], 3)],
            "yaw_deg": 90.0 if upright else 0.0,
        },
        "from_visit": 1,
    }


def chosen_seeds(episodes: int, half: str) -> Sequence[int]:
    """The first so many seeds: `development` has the even ones, `reported` the odd ones, `both` all."""
    if half == "both":
        return range(episodes)
    return range(0 if half == "development" else 1, 2 * episodes, 2)
