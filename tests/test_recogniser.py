"""The recogniser's parts: geometry, crops, votes, joining, rooms and the split of its models."""

from __future__ import annotations

import math

import numpy as np
import pytest
from box_view import box_frame

from dssmsg.evaluate.perception import mask_iou
from dssmsg.frame import Camera
from dssmsg.recogniser.contract import CROP_EXTRA, CROP_FACTS, CROP_SIDE, OFFSET_PX
from dssmsg.recogniser.crops import CropImages, cut
from dssmsg.recogniser.grouping import Group, GroupingRule, candidates, chosen, limited, sharpened
from dssmsg.recogniser.inputs import GEOMETRY_CHANNELS, geometry_channels, half_geometry
from dssmsg.recogniser.joining import Contacts, merges
from dssmsg.recogniser.lived import lived_in_home, lived_in_room, near_poses
from dssmsg.recogniser.rooms import arrange_room, camera_poses, look, surface_height
from dssmsg.recogniser.shelf import Shelf, all_labels, load_table, seed_range
from dssmsg.recogniser.views import CAMERA
from dssmsg.recogniser.working import WorkingFrame
from dssmsg.sim.camera import Instance
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.furniture.categories import load_categories
from dssmsg.sim.generate import generate_scene
from dssmsg.sim.mesh import box
from dssmsg.sim.scene import load_scene
from dssmsg.sim.solid import clearance

# -- what the networks are shown


def test_geometry_knows_height_and_which_way_surfaces_face():
    frame, hit = box_frame()
    geometry = half_geometry(frame.depth, frame.camera, frame.world_from_camera, 0.0)
    on_box = hit[::2, ::2] & hit[1::2, 1::2]
    away = ~(hit[::2, ::2] | hit[1::2, 1::2] | hit[1::2, ::2] | hit[::2, 1::2]) & geometry.valid
    assert np.abs(geometry.points[away][:, 2]).max() < 0.03
    assert geometry.points[on_box][:, 2].max() == pytest.approx(0.5, abs=0.02)
    assert geometry.points[on_box][:, 1].min() == pytest.approx(1.6, abs=0.03)
    assert np.median(geometry.normals[away][:, 2]) > 0.97
    front = on_box & (geometry.points[..., 2] < 0.4) & (geometry.points[..., 2] > 0.1)
    assert np.median(geometry.normals[front][:, 1]) < -0.95  # towards the camera
    channels = geometry_channels(geometry)
    assert channels.shape == (GEOMETRY_CHANNELS, 120, 160)
    assert np.isfinite(channels).all()


def test_upright_axes_do_not_depend_on_where_the_camera_stands_or_looks():
    frame, _ = box_frame()
    turn = np.eye(4)
    turn[:2, :2] = [[0, -1], [1, 0]]
    turn[:3, 3] = [3.0, -2.0, 1.0]
    first = half_geometry(frame.depth, frame.camera, frame.world_from_camera, 0.0)
    second = half_geometry(frame.depth, frame.camera, turn @ frame.world_from_camera, 1.0)
    np.testing.assert_allclose(first.points, second.points, atol=1e-4)


def test_facts_hold_the_size_of_what_is_seen():
    frame, hit = box_frame()
    images = CropImages.of(frame.rgb, half_geometry(frame.depth, frame.camera, frame.world_from_camera, 0.0))
    crops, facts = cut(images, [hit])
    assert crops.shape == (1, 3 + CROP_EXTRA, CROP_SIDE, CROP_SIDE)
    assert facts.shape == (1, CROP_FACTS)
    assert facts[0, 0] == pytest.approx(0.6, abs=0.06)
    assert facts[0, 2] == pytest.approx(0.5, abs=0.06)
    assert facts[0, 4] == pytest.approx(0.5, abs=0.04)
    inside = crops[0, 3] > 0.5
    assert inside[CROP_SIDE // 2, CROP_SIDE // 2]
    assert not inside[:8].any()
    assert not inside[:, :4].any()


def test_a_crop_at_the_image_rim_is_empty_outside():
    frame, _ = box_frame()
    images = CropImages.of(frame.rgb, half_geometry(frame.depth, frame.camera, frame.world_from_camera, 0.0))
    mask = np.zeros(frame.depth.shape, np.bool_)
    mask[-30:, -30:] = True
    crops, _ = cut(images, [mask])
    assert (crops[0, :, -6:, -6:] == 0).all()
    assert (crops[0, 0, 20:60, 20:60] != 0).all()


@pytest.mark.parametrize("size", [(320, 240), (640, 480), (960, 540), (1280, 720), (200, 150)])
def test_other_image_sizes_come_back_at_their_own(size):
    frame, hit = box_frame(Camera.from_fov(*size, math.radians(69.4)))
    working = WorkingFrame.of(frame)
    assert working.depth.shape[0] % 4 == working.depth.shape[1] % 4 == 0
    assert 200 <= working.depth.shape[1] <= 480
    again = working.enlarged(working.reduced(hit))
    assert again.shape == hit.shape
    assert mask_iou(again, hit) > 0.95
    low = half_geometry(working.depth, working.camera, frame.world_from_camera, 0.0).points
    assert np.abs(low[-10:, :, 2]).max() < 0.05  # the floor is still the floor


# -- from votes to masks


def ideal_maps(ids, labels=3):
    """What a perfect network would say of ids (h, w) at half size."""
    height, width = ids.shape
    v, u = np.mgrid[:height, :width]
    dense = np.full((5, height, width), -8.0, np.float32)
    dense[0][ids > 0] = 8
    classes = np.full((labels + 1, height // 2, width // 2), -6.0, np.float32)
    classes[-1] = 6
    for number in np.unique(ids[ids > 0]):
        at = ids == number
        cu, cv = u[at].mean(), v[at].mean()
        dense[1] = np.maximum(dense[1], 8 - 0.3 * np.hypot(u - cu, v - cv) ** 2)
        dense[2][at] = (cu - u[at]) / OFFSET_PX
        dense[3][at] = (cv - v[at]) / OFFSET_PX
        there = at[::2, ::2]
        classes[:, there] = -6
        classes[number % labels, there] = 6
    return dense, classes


def flat(depth=None):
    """Depth (240, 320) of a wall 2 m ahead, or as given, and its geometry."""
    depth = np.full((240, 320), 2.0, np.float32) if depth is None else depth
    return depth, half_geometry(depth, CAMERA, look(0, 0, 0.88, 0, 0), 0.0)


def touching_ids():
    """Two things side by side, and a small one in front of the first."""
    ids = np.zeros((120, 160), np.int32)
    ids[30:90, 20:70] = 1
    ids[30:90, 70:130] = 2
    ids[32:42, 22:32] = 3
    return ids


def test_perfect_votes_give_the_true_masks():
    ids = touching_ids()
    groups = candidates(*ideal_maps(ids), *flat(), GroupingRule())
    assert len(groups) == 3
    full = ids.repeat(2, axis=0).repeat(2, axis=1)
    for number in (1, 2, 3):
        best = max(groups, key=lambda g: mask_iou(g.mask, full == number))
        assert mask_iou(best.mask, full == number) > 0.95
        assert int(np.argmax(best.labels)) == number % 3
        assert best.thing > 0.9


def test_an_empty_room_has_no_things():
    dense, classes = ideal_maps(np.zeros((120, 160), np.int32))
    assert candidates(dense, classes, *flat(), GroupingRule()) == []


def split_maps():
    """One thing in two halves of votes, without a border between them."""
    ids = np.zeros((120, 160), np.int32)
    ids[30:90, 20:70] = 1
    ids[30:90, 70:130] = 4  # the same label: 4 % 3 == 1
    dense, classes = ideal_maps(ids)
    dense[4] = -8
    return dense, classes, ids


def test_halves_become_one_candidate_beside_them():
    dense, classes, _ids = split_maps()
    # Weights that ask for equal labels and no border: sure of it, or not.
    for bias, sure in ((6.0, True), (0.0, False)):
        rule = GroupingRule(join=(-8.0, 0.5, -8.0, 0.0, 0.0, 0.0, bias))
        groups = candidates(dense, classes, *flat(), rule)
        whole = [one for one in groups if one.mask.sum() > 12_000 * 2]
        assert len(whole) == 1
        assert len(groups) == (1 if sure else 3)
        assert set(whole[0].parts) == (set() if sure else {0, 1})


def test_votes_from_afar_do_not_make_one_thing_of_two():
    ids = np.zeros((120, 160), np.int32)
    ids[30:90, 20:60] = 1
    ids[30:90, 62:100] = 1  # beside it in the image and of one centre, but a metre behind
    depth = np.full((240, 320), 3.0, np.float32)
    depth[60:180, 40:120] = 2.0
    groups = candidates(*ideal_maps(ids), *flat(depth), GroupingRule())
    assert len(groups) == 2
    assert not (groups[0].mask & groups[1].mask).any()
    depth[:] = 2.0  # at one depth, 4 px = 3 cm apart, it is one
    assert len(candidates(*ideal_maps(ids), *flat(depth), GroupingRule())) == 1


def stack(*sizes):
    """Pieces of the given pixel counts, and what joins the first two."""
    blank = np.zeros((2, 2), np.bool_)
    labels = np.zeros(3, np.float32)
    pieces = [Group(blank, size, 1.0, 1.0, labels) for size in sizes]
    return [*pieces, Group(blank, sizes[0] + sizes[1], 1.0, 1.0, labels, (0, 1))]


def test_the_whole_or_its_parts_by_what_they_look_like():
    groups = stack(900, 400, 100)
    assert chosen(groups, [0.1, 0.1, 0.5, 0.9]) == [3, 2]
    assert chosen(groups, [0.9, 0.9, 0.5, 0.3]) == [0, 1, 2]


def test_the_number_of_crops_is_bounded_and_parts_stay_with_their_whole():
    groups = stack(900, 400, 100)
    assert [one.pixels for one in limited(groups, 10)] == [900, 400, 100, 1300]
    few = limited(groups, 3)
    assert [one.pixels for one in few] == [900, 400, 1300]
    assert few[2].parts == (0, 1)
    assert [one.pixels for one in limited(groups, 1)] == [900]


def test_merges_come_likeliest_first_and_count_contacts_by_length():
    facts = np.zeros((3, 7), np.float32)
    facts[:, -1] = [2.0, 0.5, -3.0]
    first, second = np.array([1, 2, 1], np.int32), np.array([2, 3, 3], np.int32)
    found = Contacts(first, second, np.array([10, 10, 30], np.int32), facts)
    made = merges(found, 3, (0, 0, 0, 0, 0, 0, 1), 0.01)
    assert [(one.first, one.second) for one in made] == [(1, 2), (3, 4)]
    assert made[0].chance > made[1].chance
    assert made[1].chance == pytest.approx(1 / (1 + math.exp(-(0.5 * 10 - 3 * 30) / 40)))
    assert merges(found, 3, (0, 0, 0, 0, 0, 0, 1), 0.95) == []


def test_edges_of_masks_follow_edges_of_depth():
    depth = np.full((240, 320), 3.0, np.float32)
    depth[81:161, 101:181] = 1.5  # an odd edge: a cell of the half image holds both
    half = half_geometry(depth, CAMERA, look(0, 0, 0.88, 0, 0), 0.0).depth
    numbers = (half < 2).astype(np.int32)
    np.testing.assert_array_equal(sharpened(numbers, depth, half) == 1, depth == 1.5)


# -- what it is trained on


def test_the_split_keeps_scene_models_known_and_seeds_apart():
    held_out = set(load_table()["held_out"])
    table = load_categories()
    for name in ("rs_int", "ihlen_1_int"):
        for piece in load_scene(name).pieces():
            assert (piece.model or table[piece.category].pieces[0].model) not in held_out
    seeds = [seed_range(name) for name in ("train", "evaluation", "unseen_models")]
    assert all(set(a).isdisjoint(b) for i, a in enumerate(seeds) for b in seeds[:i])
    assert {category.label for category in table.values()} <= set(all_labels())


def test_a_room_is_the_same_from_the_same_seed_and_things_do_not_overlap():
    shelf = Shelf("embedded")
    rooms = [arrange_room(shelf, np.random.default_rng([7])) for _ in range(2)]
    first, second = ([(t.model.model, t.box_min.tolist()) for t in room.things] for room in rooms)
    assert first == second
    assert len(first) > 5
    room = rooms[0]
    for thing in room.things:
        assert (thing.box_min[:2] > -0.05).all()
        assert (thing.box_max[:2] < np.array(room.size) + 0.05).all()
    poses = camera_poses(room, np.random.default_rng(0), 5)
    for pose in poses:
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert pose[2, 3] == pytest.approx(0.88)


def test_the_height_of_a_surface_is_read_off_the_mesh():
    pose = np.eye(4)
    pose[:3, 3] = [1.0, 2.0, 0.1]
    instance = Instance(1, box([0.8, 0.6, 0.7], [9, 9, 9]), pose)
    assert surface_height(instance, (1.2, 2.1)) == pytest.approx(0.8)
    assert surface_height(instance, (1.5, 2.0)) is None


def test_rooms_are_full_of_small_things_where_people_live():
    shelf = Shelf("embedded")
    rooms = [lived_in_room(shelf, np.random.default_rng([11])) for _ in range(2)]
    first, second = ([(t.model.model, t.box_min.tolist()) for t in room.things] for room in rooms)
    assert first == second

    def share(rooms):
        """Of small things that stand on others, among all."""
        things = [thing for room in rooms for thing in room.things]
        return np.mean([(t.box_max - t.box_min).max() < 0.65 and t.box_min[2] > 0.2 for t in things])

    seeds = range(11, 17)
    lived_in = share([lived_in_room(shelf, np.random.default_rng([seed])) for seed in seeds])
    arranged = share([arrange_room(shelf, np.random.default_rng([seed])) for seed in seeds])
    assert lived_in > 1.3 * arranged


def test_a_home_keeps_its_walls_and_gets_more_small_things():
    shelf, library = Shelf("embedded"), FurnitureLibrary.open("embedded")
    room = lived_in_home(shelf, library, np.random.default_rng([4]), 4)
    pieces = generate_scene(4).furniture
    assert len(room.things) > len(pieces) + 10
    fixed = room.solids[: len(room.solids) - len(room.things)]
    walls = [solid for solid in fixed if solid.bottom < 0.5]  # the others are above doors
    assert walls
    for thing in room.things[len(pieces) :]:
        middle = (thing.box_min + thing.box_max)[None, :2] / 2
        assert clearance(middle, walls)[0] > 0  # none stands in a wall
    numbers = [thing.instance.instance_id for thing in room.things]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) < 256  # an id is a byte in the shards


def test_near_poses_look_at_small_things_from_where_the_robot_fits():
    room = lived_in_room(Shelf("embedded"), np.random.default_rng([11]))
    poses = near_poses(room, np.random.default_rng(0), 8)
    assert len(poses) > 4
    floor = [solid for solid in room.solids if solid.bottom < 1.0 and solid.top > 0.05]
    goals = np.array([(thing.box_min + thing.box_max)[:2] / 2 for thing in room.things])
    for pose in poses:
        assert clearance(pose[None, :2, 3], floor)[0] >= 0.22
        apart = goals - pose[:2, 3]
        ahead = apart @ pose[:2, 2] / np.linalg.norm(pose[:2, 2])
        assert ((ahead > 0.3) & (np.linalg.norm(apart, axis=1) < 2.7)).any()
