"""The robot, the script and the truth: what happens in a world when it is driven through."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from dssmsg.frame import Camera, FloatArray
from dssmsg.interfaces import Command
from dssmsg.sim.camera import Instance, Render
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.physics import Physics
from dssmsg.sim.robot import Robot, RobotSpec, camera_pose
from dssmsg.sim.scene import Scene, parse_scene
from dssmsg.sim.solid import Solid
from dssmsg.sim.world import World

SCENE = """
name: hall
rooms:
  - {name: hall, type: corridor, x: [0, 6], y: [0, 3]}
furniture:
  - {id: table-1, category: table, at: [4.0, 1.5], size: [0.8, 1.0, 0.75]}
  - {id: mug-1, category: mug, on: table-1, at: [-0.2, 0.1]}
  - {id: rug-1, category: rug, at: [2.0, 1.5], size: [1.0, 1.0, 0.012]}
  - {id: mirror-1, category: mirror, wall: hall.north, along: 2.0, z: 0.95, size: [0.5, 0.03, 0.6]}
  - {id: box-1, category: box, at: [0.5, 0.5], size: [0.4, 0.4, 0.4]}
tour:
  - {name: a, at: [1.0, 1.5], views: [[0, 0]]}
  - {name: b, at: [2.5, 1.5], views: [[0, 0]]}
changes:
  - {kind: disappear, object: mug-1, before_visit: 1}
  - {kind: relocate, object: box-1, before_visit: 1, to: {at: [0.5, 2.0]}}
  - {kind: appear, during_visit: 1, at_stop: b, piece: {id: book-1, category: book, on: table-1}}
  - {kind: relocate, object: box-1, during_visit: 1, at_time: 9.0, to: {at: [0.5, 0.5]}}
"""


class CountingRenderer:
    """Renders nothing; remembers what it was given."""

    name = "counting"

    def __init__(self) -> None:
        self.static: list[int] = []
        self.movable: list[int] = []
        self.static_calls = 0

    def set_static(self, instances: Sequence[Instance]) -> None:
        self.static = [i.instance_id for i in instances]
        self.static_calls += 1

    def set_movable(self, instances: Sequence[Instance]) -> None:
        self.movable = [i.instance_id for i in instances]

    def render(self, camera: Camera, world_from_camera: FloatArray) -> Render:
        size = (camera.height, camera.width)
        return Render(
            np.zeros((*size, 3), np.uint8), np.zeros(size), np.zeros(size, np.int32), np.zeros(size)
        )

    def close(self) -> None:
        pass


@pytest.fixture
def scene() -> Scene:
    return parse_scene(SCENE, file="hall.yaml")


@pytest.fixture
def world(scene: Scene) -> Iterator[World]:
    made = World(scene, FurnitureLibrary.open("embedded"), CountingRenderer())
    made.robot.place(1.0, 1.5, 0.0)
    yield made
    made.close()
    made.close()


@pytest.fixture
def robot() -> Iterator[Robot]:
    physics = Physics()
    made = Robot(physics, RobotSpec())
    made.place(0.0, 0.0, 0.0)
    yield made
    physics.close()


def test_a_circle_is_driven_exactly(robot: Robot) -> None:
    for _ in range(10):  # up to speed, so that the circle itself is steady
        robot.act(Command(linear=0.3, angular=1.0))
    x, y, heading = robot.x, robot.y, robot.heading
    assert (robot.linear, robot.angular) == pytest.approx((0.3, 1.0))
    steps = round(math.tau * 240)
    robot.act(Command(linear=0.3, angular=1.0), steps)
    assert math.hypot(robot.x - x, robot.y - y) < 1e-3
    assert math.remainder(robot.heading - heading - steps / 240, math.tau) == pytest.approx(0.0, abs=1e-9)


def test_speeds_and_accelerations_have_limits(robot: Robot) -> None:
    speeds = []
    for _ in range(12):
        robot.act(Command(linear=9.0, angular=-9.0))
        speeds.append((robot.linear, robot.angular))
    assert speeds[0] == pytest.approx((0.1, -0.5))  # 1 m/s2 and 5 rad/s2 for 0.1 s
    assert speeds[-1] == pytest.approx((0.5, -1.57))
    gone = robot.x, robot.y
    robot.act(Command())
    assert math.dist(gone, (robot.x, robot.y)) <= 0.05


def test_the_head_turns_at_its_speed_to_its_limits(robot: Robot) -> None:
    robot.act(Command(pan=3.1, tilt=-0.2))
    assert robot.pan == pytest.approx(0.3)
    assert robot.tilt == pytest.approx(-0.2)
    for _ in range(20):
        robot.act(Command(pan=3.1, tilt=-2.0))
    assert (robot.pan, robot.tilt) == pytest.approx((2.6, -1.4))


def test_the_camera_is_where_the_robot_description_puts_it(robot: Robot) -> None:
    robot.place(0.4, -0.3, 0.7)
    for _ in range(10):
        robot.act(Command(pan=0.5, tilt=-0.4))
    api, client = robot._physics.api, robot._physics.client
    state = api.getLinkState(
        robot.body, robot.tilt_joint, computeForwardKinematics=True, physicsClientId=client
    )
    turn = np.array(api.getMatrixFromQuaternion(state[5])).reshape(3, 3)
    pose = robot.world_from_camera
    assert pose[:3, 3] == pytest.approx(state[4], abs=1e-6)
    assert pose[:3, 2] == pytest.approx(turn @ [1, 0, 0], abs=1e-6)
    assert pose[:3, 1] == pytest.approx(turn @ [0, 0, -1], abs=1e-6)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


def test_the_camera_mount_is_configurable() -> None:
    pose = camera_pose(1.0, 2.0, math.pi / 2, 0.0, 0.0, RobotSpec(camera_height=0.591, camera_forward=0.047))
    assert pose[:3, 3] == pytest.approx([1.0, 2.047, 0.591])
    assert pose[:3, 2] == pytest.approx([0, 1, 0])


def test_the_robot_stops_at_a_table_and_every_step_of_contact_counts(world: World) -> None:
    for _ in range(40):
        world.step(Command(linear=0.5), 0.2)
    assert world.robot.x == pytest.approx(3.6 - 0.178, abs=0.01)
    assert world.robot.hit == "table-1"
    first = world.collisions
    assert first > 0
    world.step(Command(linear=0.5), 0.2)
    assert world.collisions == first + 2  # two actions of 0.1 s
    world.step(Command(linear=-0.5), 1.0)
    assert world.robot.x < 3.4
    assert world.collisions <= first + 3  # the first action back may still touch


def test_rugs_and_mirrors_are_not_hit(world: World) -> None:
    for _ in range(10):
        world.step(Command(linear=0.5), 0.2)
    assert world.robot.x > 1.8  # on the rug
    assert world.collisions == 0


def test_even_a_thin_thing_stops_the_robot(robot: Robot) -> None:
    robot._physics.add(Solid((0.5, 0.0, 0.5), (0.002, 0.5, 0.5), owner="screen"))
    contacts = sum(robot.act(Command(linear=0.5)) for _ in range(30))
    assert robot.x == pytest.approx(0.5 - 0.178, abs=0.01)
    assert contacts > 5


def test_a_robot_that_something_is_put_upon_can_drive_out(robot: Robot) -> None:
    robot._physics.add(Solid((-0.15, 0.0, 0.5), (0.05, 0.1, 0.5), owner="box"))
    assert robot.probe()
    for _ in range(20):
        robot.act(Command(linear=0.3))
    assert robot.x > 0.3


def test_nothing_teleports(world: World) -> None:
    rng = np.random.default_rng(3)
    world.start_visit(0)
    for visit in (0, 1):
        world.start_visit(visit)
        for _ in range(40):
            before = world.robot.x, world.robot.y
            world.step(Command(*(float(v) for v in rng.uniform(-1, 1, 2))), 0.2)
            assert math.dist(before, (world.robot.x, world.robot.y)) <= 0.5 * 0.2 + 1e-9


def test_the_script_happens_at_its_time_and_truth_follows(world: World) -> None:
    def states() -> dict[str, str]:
        return {o.name: o.state for o in world.truth_log.objects()}

    world.start_visit(0)
    world.step(Command(linear=0.5), 2.0)
    assert set(states().values()) == {"static"}
    old_mug = next(o for o in world.truth_log.objects() if o.name == "mug-1")
    world.robot.place(1.0, 1.5, 0.0)
    world.start_visit(1)
    assert states() | {"mug-1": "disappeared", "box-1": "moved"} == states()
    gone = next(o for o in world.truth_log.objects() if o.name == "mug-1")
    assert (gone.box_min == old_mug.box_min).all()
    assert "book-1" not in states()
    world.step(Command(), 0.2)
    assert "book-1" not in states()  # the robot is not at stop b
    while world.robot.x < 2.3:
        world.step(Command(linear=0.5), 0.2)
    assert states()["book-1"] == "appeared"
    book = world.pieces["book-1"]
    assert book.box_min[2] == pytest.approx(0.75, abs=0.02)
    while world.sim_time - 2.0 < 8.9:
        assert states()["box-1"] == "moved"
        world.step(Command(), 0.2)
    world.step(Command(), 0.4)
    assert states()["box-1"] == "static"  # it is back where the first visit saw it


def test_changes_cost_no_rebuild_of_the_static_scene_and_keep_ids(world: World) -> None:
    renderer = world.renderer
    assert isinstance(renderer, CountingRenderer)
    ids = {piece.name: piece.instance_id for piece in world.pieces.values()}
    assert set(renderer.static) == {0, ids["table-1"], ids["rug-1"], ids["mirror-1"]}
    assert set(renderer.movable) == {ids["mug-1"], ids["box-1"]}
    world.start_visit(1)
    assert renderer.static_calls == 1
    assert set(renderer.movable) == {ids["box-1"]}
    assert world.pieces["box-1"].instance_id == ids["box-1"]


def test_bodies_are_made_in_a_fixed_order(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    monkeypatch.setattr(world, "_add_body", lambda piece: made.append(piece.name))
    pieces = dict(world.pieces)
    results = iter([{}, pieces])  # all of it goes, all of it comes
    monkeypatch.setattr("dssmsg.sim.world.changed", lambda *_: next(results))
    world.make(world.scene.changes[:2])
    assert made == sorted(pieces) != list(pieces)


def test_without_the_script_nothing_changes(scene: Scene) -> None:
    world = World(scene, FurnitureLibrary.open("embedded"), CountingRenderer(), scripted=False)
    world.start_visit(1)
    world.step(Command(), 12.0)
    assert {o.state for o in world.truth_log.objects()} == {"static"}
    world.close()


def test_truth_boxes_hold_exactly_the_mesh(world: World) -> None:
    for name, piece in world.pieces.items():
        points = (
            piece.model.mesh.vertices @ piece.world_from_object[:3, :3].T + piece.world_from_object[:3, 3]
        )
        truth = next(o for o in world.truth_log.objects() if o.name == name)
        assert truth.box_min == pytest.approx(points.min(axis=0), abs=1e-6)
        assert truth.box_max == pytest.approx(points.max(axis=0), abs=1e-6)
        assert truth.room == "hall"
        assert not truth.box_min.flags.writeable
