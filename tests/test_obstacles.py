"""Pieces that appear ahead of the robot."""

from __future__ import annotations

import math

import pytest
from test_world import SCENE, CountingRenderer

from dssmsg.errors import ConfigError, InputError
from dssmsg.interfaces import Command
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.obstacles import NEAREST_M, with_obstacles
from dssmsg.sim.scene import Obstacle, Scene, parse_scene
from dssmsg.sim.world import World

PIECE = {"id": "box-9", "category": "box", "at": [3.2, 1.5], "size": [0.4, 0.4, 0.4]}


@pytest.fixture(scope="module")
def library():
    return FurnitureLibrary.open("embedded")


def home() -> Scene:
    return parse_scene(
        SCENE.replace("  - {id: box-1, category: box, at: [0.5, 0.5], size: [0.4, 0.4, 0.4]}\n", "").split(
            "changes:"
        )[0],
        file="hall.yaml",
    )


def world(library, **options) -> World:
    obstacle = Obstacle(piece=PIECE, **options)
    return World(with_obstacles(home(), [obstacle], library), library, CountingRenderer())


def drive(world, frames, linear=0.5):
    """Distances to the obstacle when it appears, None if it does not."""
    for _ in range(frames):
        world.step(Command(linear), 0.1)
        if "box-9" in world.pieces:
            return 3.0 - world.robot.x
    return None


def test_it_appears_ahead_and_never_too_near(library):
    made = world(library, within=2.0)
    made.start_visit(0)
    made.robot.place(0.4, 1.5, 0.0)
    gap = drive(made, 60)
    assert NEAREST_M <= gap <= 2.0
    assert made.collisions == 0
    assert any(o.name == "box-9" and o.state == "appeared" for o in made.truth_log.objects())
    made.close()


@pytest.mark.parametrize(
    ("x", "heading"), [(0.4, math.pi / 2), (0.4, math.pi), (1.8, 0.0)], ids=["aside", "behind", "too near"]
)
def test_it_waits_while_the_robot_does_not_come(library, x, heading):
    made = world(library)
    made.start_visit(0)
    made.robot.place(x, 1.5, heading)
    assert drive(made, 5, linear=0.0) is None
    made.close()


def test_it_waits_for_its_visit(library):
    made = world(library, from_visit=1)
    made.start_visit(0)
    made.robot.place(0.9, 1.5, 0.0)
    assert drive(made, 5, linear=0.0) is None
    made.start_visit(1)
    assert drive(made, 5, linear=0.0) is not None
    made.close()


def test_its_number_comes_after_the_scene_s(library):
    scene = with_obstacles(home(), [Obstacle(piece=PIECE)], library)
    assert [piece.id for piece in scene.pieces()][-1] == "box-9"


@pytest.mark.parametrize("change", [{"id": "table-1"}, {"category": "dragon"}], ids=["known id", "no such"])
def test_a_wrong_obstacle_is_named(library, change):
    with pytest.raises((ConfigError, InputError), match=r"table-1|dragon"):
        with_obstacles(home(), [Obstacle(piece={**PIECE, **change})], library)


def test_an_obstacle_stands_on_the_floor():
    with pytest.raises(ValueError, match="stands on the floor"):
        Obstacle(piece={"id": "mug-9", "category": "mug", "on": "table-1"})
