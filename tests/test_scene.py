"""Scene files: what is accepted, what is refused, and whether the stock scenes are sound."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dssmsg.errors import ConfigError, InputError
from dssmsg.interfaces import Stop
from dssmsg.sim.camera import make_renderer
from dssmsg.sim.check import scene_problems, validate_scene
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.mesh import box
from dssmsg.sim.occupancy import Occupancy
from dssmsg.sim.scene import STOCK_SCENES, Scene, load_scene, parse_scene
from dssmsg.sim.scene_layout import build_layout
from dssmsg.sim.scene_placement import Placer, surface_heights
from dssmsg.sim.script import visit_states
from dssmsg.sim.solid import Solid, clearance, overlap_depth
from dssmsg.sim.tour import check_tour, estimate, tour_of, tour_problems
from dssmsg.sim.visibility import SEEN_FRAMES, View, choose_views, seen_frames
from dssmsg.sim.world import World

SMALL_SCENE = """
name: two_rooms
rooms:
  - {name: left, type: living room, x: [0, 3], y: [0, 3]}
  - {name: right, type: kitchen, x: [3.1, 6], y: [0, 3]}
doors:
  - {name: door, between: [left, right], along: 1.5, width: 0.8}
furniture:
  - {id: table-1, category: table, wall: left.north, along: 1.5, size: [1.2, 0.8, 0.75]}
  - {id: mug-1, category: mug, on: table-1, at: [0.3, 0.1]}
  - {id: sofa-1, category: sofa, wall: right.east, along: 1.5, size: [1.8, 0.8, 0.8]}
tour:
  - {name: a, at: [1.5, 1.5], views: [[90, 0]]}
  - {name: b, at: [4.5, 1.5], views: [[0, 0], [0, -25]]}
changes:
  - {kind: disappear, object: mug-1, before_visit: 1}
"""


@pytest.fixture(scope="module")
def library() -> FurnitureLibrary:
    return FurnitureLibrary.open("embedded")


@pytest.fixture
def small() -> Scene:
    return parse_scene(SMALL_SCENE, file="small.yaml")


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ("name: two_rooms", "nam: two_rooms", "name", "required"),
        ("along: 1.5, width: 0.8}", "along: 1.5, wide: 0.8}", "doors.0.wide", "not permitted"),
        (
            "between: [left, right]",
            "between: [left, attic]",
            None,
            "unknown name 'attic'; known: left, right",
        ),
        ("on: table-1", "on: table-9", None, "unknown name 'table-9'"),
        ("id: mug-1", "id: table-1", None, "piece named twice: table-1"),
        ("id: mug-1", "id: Mug", "furniture.1.id", "pattern"),
        ("at: [0.3, 0.1]", "wall: left.north", "furniture.1", "`wall` needs `along`"),
        ("object: mug-1", "object: mug-2", None, "unknown name 'mug-2'"),
        ("before_visit: 1", "during_visit: 1", "changes.0.disappear", "needs one of `at_stop` and `at_time`"),
        ("kind: disappear", "kind: explode", "changes.0", "appear"),
        ("x: [0, 3], y: [0, 3]", "x: [3, 0], y: [0, 3]", "rooms.0.x", "expected [low, high]"),
        ("x: [0, 3], y: [0, 3]", "x: [0, .nan], y: [0, 3]", "rooms.0.x.1", "finite"),
    ],
)
def test_a_broken_scene_file_is_refused_with_file_and_key(
    old: str, new: str, key: str | None, words: str
) -> None:
    assert old in SMALL_SCENE
    with pytest.raises(InputError) as caught:
        parse_scene(SMALL_SCENE.replace(old, new, 1), file="small.yaml")
    assert caught.value.file == "small.yaml"
    assert caught.value.key == key
    assert words in caught.value.message


def test_yaml_that_is_no_scene_is_refused() -> None:
    with pytest.raises(InputError, match="line 2: not valid YAML"):
        parse_scene("name: x\nrooms: [", file="x.yaml")
    with pytest.raises(InputError, match="the key 'name' is written twice"):
        parse_scene("name: x\nname: y", file="x.yaml")
    with pytest.raises(InputError, match="nested more than"):
        parse_scene("[" * 3000 + "]" * 3000, file="x.yaml")
    with pytest.raises(InputError, match="expected a mapping"):
        parse_scene("- a list", file="x.yaml")


def test_scene_names_and_paths(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(SMALL_SCENE)
    assert load_scene("mine.yaml", base_dir=tmp_path).name == "two_rooms"
    with pytest.raises(ConfigError, match="known: rs_int, ihlen_1_int, generated:<seed>") as caught:
        load_scene("rs_in")
    assert caught.value.key == "source.scene"
    with pytest.raises(ConfigError, match="expected generated:<seed>"):
        load_scene("generated:x")
    with pytest.raises(InputError, match="no such scene file"):
        load_scene("none.yaml", base_dir=tmp_path)
    (tmp_path / "huge.yaml").write_text("#" * 2_000_001)
    with pytest.raises(InputError, match="larger than"):
        load_scene("huge.yaml", base_dir=tmp_path)


@pytest.mark.parametrize(
    ("name", "rooms", "area", "pieces"), [("rs_int", 5, 41.5, 58), ("ihlen_1_int", 10, 120.0, 110)]
)
def test_stock_scenes_have_the_room_programme(name: str, rooms: int, area: float, pieces: int) -> None:
    scene = load_scene(name)
    assert len(scene.rooms) == rooms
    assert sum(room.area for room in scene.rooms) == pytest.approx(area, rel=0.03)
    assert len(scene.furniture) == pytest.approx(pieces, rel=0.1)
    kinds = [change.kind for change in scene.changes]
    assert {"appear", "disappear", "relocate"} <= set(kinds)
    assert len(kinds) >= 8
    assert any(change.during_visit is not None for change in scene.changes)


@pytest.mark.parametrize("name", STOCK_SCENES)
def test_stock_scenes_are_sound_in_every_state(name: str, library: FurnitureLibrary) -> None:
    assert scene_problems(load_scene(name), library) == ()


@pytest.mark.parametrize("name", STOCK_SCENES)
def test_stock_tours_fit_the_budget(name: str) -> None:
    costs = [estimate(tour_of(load_scene(name), visit)) for visit in (0, 1)]
    assert all(cost.frames <= 600 and cost.views <= 72 for cost in costs)
    assert sum(cost.key_frames for cost in costs) <= 450


def test_rooms_of_rs_int_form_a_chain_and_those_of_ihlen_a_driven_loop() -> None:
    rs = load_scene("rs_int")
    assert len(rs.doors) == len(rs.rooms) - 1  # a tree: no detour
    ihlen = load_scene("ihlen_1_int")
    points = [point for stop in tour_of(ihlen, 0) for point in (*stop.via, (stop.x, stop.y))]
    rooms = []
    for start, end in itertools.pairwise(points):
        for x, y in np.linspace(start, end, 50):
            here = ihlen.room_at(float(x), float(y))
            if here and (not rooms or rooms[-1] != here):
                rooms.append(here)
    driven = {frozenset(pair) for pair in itertools.pairwise(rooms)}
    for side in (
        ("living", "dining"),
        ("dining", "kitchen"),
        ("kitchen", "corridor_1"),
        ("corridor_1", "living"),
    ):
        assert frozenset(side) in driven


def test_the_second_visit_drives_the_first_one_backwards() -> None:
    scene = load_scene("ihlen_1_int")
    there, back = tour_of(scene, 0), tour_of(scene, 1)
    assert [stop.name for stop in back] == [stop.name for stop in there][::-1]

    def way(tour: tuple[Stop, ...]) -> list[tuple[float, float]]:
        return [point for stop in tour for point in (*stop.via, (stop.x, stop.y))]

    assert way(back) == way(there)[::-1]
    assert there[0].via == back[0].via == ()


def test_a_wall_has_a_hole_only_where_a_door_is(small: Scene) -> None:
    layout = build_layout(small)
    walls = [solid for solid in layout.solids if solid.bottom < 1.0]
    across = np.array([[3.05, y] for y in np.arange(0.05, 3.0, 0.05)])
    inside_hole = np.abs(across[:, 1] - 1.5) < 0.4 - 1e-6
    free = clearance(across, walls) > 0
    assert (free == inside_hole).all()
    lintel = [solid for solid in layout.solids if solid.bottom > 1.0]
    assert [solid.bottom for solid in lintel] == pytest.approx([2.05])


def test_a_door_between_rooms_that_do_not_meet_is_refused() -> None:
    with pytest.raises(InputError, match="must face each other") as caught:
        build_layout(parse_scene(SMALL_SCENE.replace("x: [3.1, 6]", "x: [4.1, 6]"), file="s"))
    assert caught.value.key == "doors.door"
    door = "doors:\n  - {name: door, between: [left, right], along: 1.5, width: 0.8}\n"
    overlapping = parse_scene(SMALL_SCENE.replace(door, "").replace("x: [3.1, 6]", "x: [2.5, 6]"), file="s")
    with pytest.raises(InputError, match="rooms overlap"):
        build_layout(overlapping)


@pytest.mark.parametrize("side", ["north", "east", "south", "west"])
def test_a_piece_at_a_wall_turns_its_back_to_it(side: str, library: FurnitureLibrary) -> None:
    text = SMALL_SCENE.replace("wall: right.east, along: 1.5", f"wall: right.{side}, along: 1.45")
    scene = parse_scene(text, file="s")
    sofa = Placer(scene, library).initial()["sofa-1"]
    front = sofa.world_from_object[:2, :2] @ [0.0, -1.0]
    outward = {"north": (0, 1), "east": (1, 0), "south": (0, -1), "west": (-1, 0)}[side]
    assert front @ outward == pytest.approx(-1.0)
    room = scene.room("right")
    edge = {"north": room.y[1], "east": room.x[1], "south": room.y[0], "west": room.x[0]}[side]
    box_edge = {
        "north": sofa.box_max[1],
        "east": sofa.box_max[0],
        "south": sofa.box_min[1],
        "west": sofa.box_min[0],
    }
    assert abs(box_edge[side] - edge) == pytest.approx(0.01, abs=2e-3)
    assert sofa.room == "right"


def test_things_rest_on_their_support_and_move_with_its_yaw(small: Scene, library: FurnitureLibrary) -> None:
    placed = Placer(small, library).initial()
    table, mug = placed["table-1"], placed["mug-1"]
    assert mug.box_min[2] == pytest.approx(table.box_max[2], abs=0.02)
    offset = (mug.world_from_object - table.world_from_object)[:2, 3]
    assert offset == pytest.approx([0.3, 0.1])
    with pytest.raises(InputError, match="does not lie over table-1"):
        Placer(
            parse_scene(SMALL_SCENE.replace("at: [0.3, 0.1]", "at: [0.9, 0.1]"), file="s"), library
        ).initial()


def test_surface_heights_take_the_highest_face() -> None:
    mesh = box((1.0, 1.0, 0.5), (0, 0, 0))
    heights = surface_heights(mesh, np.array([[0.0, 0.0], [0.49, -0.49], [0.51, 0.0]]))
    assert heights[:2] == pytest.approx([0.5, 0.5])
    assert np.isneginf(heights[2])


def test_a_change_that_cannot_happen_is_refused(library: FurnitureLibrary) -> None:
    scene = parse_scene(SMALL_SCENE.replace("object: mug-1", "object: table-1"), file="s")
    with pytest.raises(InputError, match="carries mug-1"):
        visit_states(scene, Placer(scene, library), 1)
    twice = SMALL_SCENE + "  - {kind: disappear, object: mug-1, before_visit: 2}\n"
    scene = parse_scene(twice, file="s")
    with pytest.raises(InputError, match="is not in the scene then"):
        visit_states(scene, Placer(scene, library), 2)


def test_an_unreachable_stop_names_what_is_in_the_way(library: FurnitureLibrary) -> None:
    text = SMALL_SCENE.replace("at: [4.5, 1.5], views", "at: [5.3, 1.5], views")
    scene = parse_scene(text, file="s")
    with pytest.raises(
        InputError, match=r"stop b: .* passes sofa-1 at 0.00 m; the robot needs 0.18 m"
    ) as caught:
        check_tour(scene, build_layout(scene), Placer(scene, library))
    assert caught.value.key == "tour"
    through_wall = parse_scene(
        SMALL_SCENE.replace("at: [1.5, 1.5], views", "at: [1.5, 0.5], views"), file="s"
    )
    with pytest.raises(InputError, match="passes a wall"):
        check_tour(through_wall, build_layout(through_wall), Placer(through_wall, library))


def test_validation_finds_pieces_in_pieces_walls_and_out_of_reach(library: FurnitureLibrary) -> None:
    broken = SMALL_SCENE.replace(
        "tour:",
        "  - {id: table-2, category: table, at: [1.9, 2.4], size: [1.2, 0.8, 0.75]}\n"
        "  - {id: bed-1, category: bed, at: [0.4, 0.2], size: [1.0, 2.0, 0.6]}\n"
        "  - {id: mug-2, category: mug, at: [0.2, 2.8]}\n"
        "  - {id: mirror-1, category: mirror, wall: left.west, along: 2.0, z: 1.4, size: [0.5, 0.03, 0.6]}\n"
        "tour:",
    )
    scene = parse_scene(broken, file="s")
    problems = "\n".join(scene_problems(scene, library))
    assert "table-2 is 0.610 m inside table-1" in problems
    assert "bed-1 is 0.100 m inside a wall" in problems
    assert "mug-2 is 1.84 m from the nearest stop" in problems
    assert "mirror-1 hangs outside" in problems
    assert "table-2 and table-1 are only 0.00 m apart" in problems
    with pytest.raises(InputError, match="more"):
        validate_scene(scene, library)


def test_a_path_leads_around_what_stands_in_the_way(small: Scene) -> None:
    block = Solid((4.4, 1.3, 0.5), (0.15, 1.0, 0.5))
    occupancy = Occupancy(small, [*build_layout(small).solids, block])
    start, end = (1.5, 1.5), (5.5, 1.0)
    assert occupancy.leg_clearance(start, end) == 0.0
    path = occupancy.path(start, end)
    assert path is not None
    assert (path[0], path[-1]) == (start, end)
    assert all(occupancy.leg_clearance(a, b) > 0.18 for a, b in itertools.pairwise(path))
    assert len(path) <= 6
    closed = Solid((3.05, 1.5, 1.0), (0.05, 0.4, 1.0))
    assert Occupancy(small, [*build_layout(small).solids, closed]).path(start, end) is None


def test_tables_block_and_mirrors_and_rugs_do_not(small: Scene) -> None:
    occupancy = Occupancy(
        small,
        [
            Solid((1.0, 1.0, 0.7), (0.4, 0.4, 0.05), owner="table"),
            Solid((2.0, 1.0, 1.3), (0.4, 0.4, 0.3), owner="mirror"),
            Solid((2.0, 2.0, 0.006), (0.4, 0.4, 0.006), owner="rug"),
        ],
    )
    assert [solid.owner for solid in occupancy.solids] == ["table"]
    stop = replace(tour_of(small, 0)[0], x=1.0, y=1.0)
    assert "passes table" in tour_problems([stop], occupancy)[0]


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    st.tuples(st.floats(0.1, 1), st.floats(0.1, 1)),
    st.floats(-math.pi, math.pi),
    st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
)
def test_clearance_agrees_with_densely_sampled_boxes(
    center: tuple[float, float], half: tuple[float, float], yaw: float, point: tuple[float, float]
) -> None:
    solid = Solid((*center, 0.5), (*half, 0.5), yaw)
    grid = (
        np.stack(np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41)), axis=-1).reshape(-1, 2) * half
    )
    cos, sin = math.cos(yaw), math.sin(yaw)
    world = grid @ np.array([[cos, sin], [-sin, cos]]) + center
    sampled = float(np.hypot(*(world - point).T).min())
    exact = float(clearance(np.array([point]), [solid])[0])
    assert exact <= sampled + 1e-9
    assert sampled - exact < 0.04


@settings(max_examples=60, deadline=None)
@given(st.floats(-2, 2), st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_overlap_is_symmetric_and_ends_at_contact(x: float, yaw_a: float, yaw_b: float) -> None:
    a = Solid((0, 0, 0.5), (0.4, 0.2, 0.5), yaw_a)
    b = Solid((x, 0.1, 0.5), (0.3, 0.3, 0.5), yaw_b)
    assert overlap_depth(a, b) == pytest.approx(overlap_depth(b, a))
    corners_apart = clearance(b.corners(), [a]).min() > 0 and clearance(a.corners(), [b]).min() > 0
    if overlap_depth(a, b) <= 0:
        assert corners_apart or overlap_depth(a, b) > -1e-9
    above = Solid((0, 0, 2.0), (0.4, 0.2, 0.5), yaw_a)
    assert overlap_depth(a, above) == pytest.approx(-0.5)


def test_the_views_of_rs_int_show_every_piece_in_three_frames(library: FurnitureLibrary) -> None:
    world = World(load_scene("rs_int"), library, make_renderer("auto")[0])
    for visit in (0, 1):
        world.start_visit(visit)
        counts = seen_frames(world, tour_of(world.scene, visit))
        assert sum(count >= SEEN_FRAMES for count in counts.values()) >= 0.97 * len(counts), counts
    world.close()


def test_chosen_views_cover_what_can_be_seen_and_keep_apart() -> None:
    stops = [Stop("a", 0, 0, ()), Stop("b", 1, 0, ())]
    options = [
        View("a", 0.0, 0.0, frozenset({1, 2, 3})),
        View("a", 0.3, 0.0, frozenset({1, 2, 3, 4})),
        View("a", 2.0, 0.0, frozenset({5})),
        View("b", 0.0, 0.0, frozenset()),
    ]
    chosen = choose_views(stops, options, 10)
    assert sorted(chosen["a"]) == [(0.3, 0.0), (2.0, 0.0)]  # (0.0, 0.0) is too near to a better one
    assert chosen["b"] == ((0.0, 0.0),)  # every stop looks at least once
    assert sum(map(len, choose_views(stops, options, 2).values())) == 2
