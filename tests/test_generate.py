"""Generated homes: the same for a seed, sound, furnished by room type, drivable."""

from __future__ import annotations

import functools

import pytest

from dssmsg.sim.check import scene_problems
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.generate import generate_scene
from dssmsg.sim.scene import Scene, load_scene
from dssmsg.sim.tour import estimate, tour_of

SEEDS = (2, 6)


@functools.cache
def home(seed: int) -> Scene:
    return generate_scene(seed)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_generated_home_is_sound_and_its_tour_fits(seed: int) -> None:
    scene = home(seed)
    assert scene_problems(scene, FurnitureLibrary.open("embedded")) == ()
    assert 4 <= len(scene.rooms) <= 7
    costs = [estimate(tour_of(scene, visit)) for visit in (0, 1)]
    assert all(cost.frames <= 600 and cost.views <= 72 for cost in costs)
    assert sum(cost.key_frames for cost in costs) <= 450
    toured = {stop.room for stop in tour_of(scene, 0)}
    assert toured == {room.name for room in scene.rooms}
    kinds = {change.kind for change in scene.changes}
    assert kinds == {"appear", "disappear", "relocate"}
    assert any(change.during_visit == 1 for change in scene.changes)


def test_rooms_hold_what_their_type_asks_for() -> None:
    scene = home(SEEDS[0])
    held: dict[str, set[str]] = {}
    for piece in scene.furniture:
        if piece.on is None and piece.at is not None:
            held.setdefault(scene.room(scene.room_at(*piece.at)).type, set()).add(piece.category)
    assert {"toilet", "washbasin"} & held["bathroom"]
    assert {"fridge", "sink", "oven"} & held["kitchen"]
    assert "sofa" in held["living room"]
    assert "bed" in held["bedroom"]
    assert not {"bed", "toilet", "fridge"} & held["living room"]


def test_the_same_seed_gives_the_same_home_and_another_seed_another() -> None:
    first = load_scene(f"generated:{SEEDS[1]}")
    assert first == home(SEEDS[1])
    assert first != home(SEEDS[0])
