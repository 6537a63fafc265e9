"""segmenter/depth: what of a box is the thing, and what carries it, hides it or is seen behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from box_scene import Thing, look, pose_at
from dssmsg_plugins.segmenter.depth import Config, DepthSegmenter
from hypothesis import given
from hypothesis import strategies as st

from dssmsg.checks import check_masks
from dssmsg.frame import Camera, quantise_depth
from dssmsg.geometry import back_project_world
from dssmsg.interfaces import Box
from dssmsg.level_surfaces import crowded_heights, fit_level, up_facing

CAMERA = Camera.from_fov(320, 240, 1.2)
NOISE = (0.001, 0.002)
TABLE = Thing("table", (1.2, -0.7, 0.68), (2.2, 0.7, 0.72))
LEG = Thing("leg", (1.25, -0.65, 0.0), (1.33, -0.57, 0.68))
CUP = Thing("cup", (1.45, -0.05, 0.72), (1.54, 0.04, 0.82))
BOOK = Thing("book", (1.5, 0.2, 0.72), (1.8, 0.4, 0.725))
SEAT = Thing("seat", (1.5, -0.25, 0.42), (1.95, 0.25, 0.47))
BACK = Thing("back", (1.9, -0.25, 0.47), (1.95, 0.25, 0.95))
FEET = [Thing("foot", (x, y, 0.0), (x + 0.05, y + 0.05, 0.42)) for x in (1.5, 1.9) for y in (-0.25, 0.2)]


def scene(things, noise=NOISE, pose=None):
    return look(
        things, pose_at(0.0, 0.0, 0.0, -0.35, 1.3) if pose is None else pose, camera=CAMERA, noise=noise
    )


def pixels(frame, *numbers):
    return np.isin(frame.truth.instance_ids, numbers)


def around(mask, label, grow=3):
    rows, columns = np.nonzero(mask)
    box = [columns.min() - grow, rows.min() - grow, columns.max() + 1 + grow, rows.max() + 1 + grow]
    return Box(np.array(box, dtype=np.float64), label, 0.9)


def segment(frame, *boxes, **options):
    segmenter = DepthSegmenter(Config(**options), NOISE)
    return check_masks(frame, segmenter.segment(frame, boxes), len(boxes))


def iou(a, b):
    return (a & b).sum() / max((a | b).sum(), 1)


def test_the_table_under_a_cup_is_no_cup():
    frame = scene([TABLE, CUP])
    truth = pixels(frame, 2)
    (mask,) = segment(frame, around(truth, "cup", grow=8))
    assert iou(mask, truth) > 0.75
    assert (mask & pixels(frame, 1)).sum() < 0.15 * truth.sum()


def test_the_floor_under_a_chair_and_the_wall_behind_it_are_no_chair():
    frame = scene([SEAT, BACK, *FEET], pose=pose_at(0.0, 0.3, 0.0, -0.3, 1.2))
    truth = frame.truth.instance_ids > 0
    (mask,) = segment(frame, around(truth, "chair", grow=6))
    assert iou(mask, truth) > 0.85


def test_a_table_before_a_chair_is_no_chair():
    before = Thing("table", (0.9, -0.7, 0.68), (1.45, 0.7, 0.72))
    frame = scene([before, BACK])
    truth = pixels(frame, 2)
    (mask,) = segment(frame, around(truth, "chair", grow=6))
    assert iou(mask, truth) > 0.85


def test_a_table_is_its_top_and_its_legs_without_what_stands_on_it_or_behind():
    frame = scene([TABLE, LEG, CUP, Thing("chair", (2.2, -0.2, 0.3), (2.25, 0.3, 0.95))])
    table, others = pixels(frame, 1, 2), pixels(frame, 3, 4)
    box = around(pixels(frame, 1, 2, 3, 4), "dining table")
    (mask,) = segment(frame, box)
    assert (mask & table).sum() > 0.9 * table.sum()
    assert (mask & others).sum() < 0.2 * others.sum()  # their foot, where normals are wrong
    (whole,) = segment(frame, box, flat_topped=[])
    assert (whole & others).sum() > 0.5 * others.sum()


def test_a_book_is_the_surface_inside_its_box():
    frame = scene([TABLE, BOOK])
    truth = pixels(frame, 2)
    (mask,) = segment(frame, around(truth, "book", grow=1))
    assert iou(mask, truth) > 0.6  # the corners of the box show the table
    assert (mask & truth).sum() > 0.95 * truth.sum()


def test_a_glass_without_readings_is_not_the_table_around_it():
    frame = scene([TABLE, CUP])
    truth = pixels(frame, 2)
    blind = replace(frame, depth=quantise_depth(np.where(truth, 0.0, frame.depth)))
    (mask,) = segment(blind, around(truth, "cup", grow=2))
    assert not mask.any()


def test_a_rug_is_on_the_floor_and_still_there():
    frame = scene([], pose=pose_at(0.0, 0.0, 0.0, -0.6, 1.3))
    box = Box(np.array([100.0, 120.0, 220.0, 200.0]), "rug", 0.9)
    (mask,) = segment(frame, box)
    assert mask[130:190, 110:210].mean() > 0.95


def test_a_pixel_belongs_to_the_smallest_mask():
    frame = scene([TABLE, CUP])
    cup, table = around(pixels(frame, 2), "cup"), around(pixels(frame, 1, 2), "board")
    small, large = segment(frame, cup, table)
    assert small.any()
    assert not (small & large).any()
    both = segment(frame, cup, table, exclusive=False)
    assert (both[0] & both[1]).any()
    assert np.array_equal(both[0], small)


def test_the_masks_of_a_detector_stay_and_nothing_is_written_into_them():
    frame = scene([TABLE, CUP])
    own = pixels(frame, 1, 2)
    own.flags.writeable = False
    given = Box(np.array([0.0, 0.0, 320.0, 240.0]), "table", 0.9, own)
    kept, small = segment(frame, given, around(pixels(frame, 2), "cup"))
    assert np.array_equal(kept, own)
    assert small.any()


@given(st.lists(st.floats(-400, 700), min_size=4, max_size=4))
def test_a_mask_never_leaves_its_box(corners):
    frame = FRAME
    x0, x1 = sorted(corners[:2])
    y0, y1 = sorted(corners[2:])
    box = Box(np.array([x0, y0, x1, y1]), "table", 0.5)
    (mask,) = segment(frame, box)
    inside = np.zeros_like(mask)
    rows = slice(max(0, int(np.floor(y0))), max(0, int(np.ceil(y1))))
    inside[rows, max(0, int(np.floor(x0))) : max(0, int(np.ceil(x1)))] = True
    assert not (mask & ~inside).any()
    assert not (mask & (frame.depth == 0)).any()


FRAME = scene([TABLE, CUP, LEG])


# Level surfaces.


@given(
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
    st.floats(-1, 2),
    st.floats(-0.02, 0.02),
    st.integers(0, 9),
)
def test_a_level_plane_is_found_from_a_rough_height(slope_x, slope_y, offset, error, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.4, 0.4, (400, 3))
    points[:, 2] = slope_x * points[:, 0] + slope_y * points[:, 1] + offset
    noisy = points + rng.normal(0, 0.002, points.shape)
    clutter = rng.uniform(-0.4, 0.4, (60, 3)) + np.array([0, 0, offset + 1.0])
    plane = fit_level(np.concatenate([noisy, clutter]), offset + error, 0.05, rounds=4)
    assert plane is not None
    assert np.abs(plane.above(points)).max() < 0.01


def test_what_is_no_level_plane_is_none():
    rng = np.random.default_rng(0)
    assert fit_level(rng.uniform(0, 1, (8, 3)), 0.5, 0.5) is None
    steep = rng.uniform(0, 1, (500, 3))
    steep[:, 2] = 0.5 * steep[:, 0]
    assert fit_level(steep, 0.25, 0.5) is None


def test_heights_that_many_share():
    rng = np.random.default_rng(0)
    heights = np.concatenate(
        [rng.normal(0.0, 0.004, 500), rng.normal(0.72, 0.004, 300), rng.uniform(0, 2, 300)]
    )
    assert crowded_heights(heights, 150) == pytest.approx([0.0, 0.72], abs=0.02)
    assert crowded_heights(heights, 5000) == []
    assert crowded_heights(np.zeros(0), 0) == []


def test_tops_face_up_and_walls_do_not():
    frame = scene([TABLE], noise=(0.0, 0.0))
    points = back_project_world(frame.depth, frame.camera, frame.world_from_camera)
    points = points.reshape(*frame.depth.shape, 3).astype(np.float32)
    found = up_facing(points, frame.depth > 0)
    floor = np.abs(points[..., 2]) < 0.01
    top = np.abs(points[..., 2] - 0.72) < 0.005
    wall = np.abs(points[..., 0] - 4.0) < 0.01
    assert found[top].mean() > 0.85
    assert found[floor].mean() > 0.85
    assert found[wall].mean() < 0.1
    assert not up_facing(points, np.zeros(frame.depth.shape, bool)).any()
