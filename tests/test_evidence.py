"""What a frame says of places and colours: several asked at once get what each alone would."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dssmsg.frame import Camera
from dssmsg.geometry import project, transform_points
from dssmsg.graph.colors import color_histogram, color_histograms, color_similarities, color_similarity
from dssmsg.graph.evidence import View, look_at, look_at_each, verdict_of
from dssmsg.graph.memory import ViewpointWindows
from dssmsg.graph.verdicts import MISSED, OCCLUDED, OUT_OF_RANGE, OUT_OF_VIEW, PRESENT
from dssmsg.graph.voxels import BESIDE, VOXEL_M, voxel_keys

CAMERA = Camera(20, 15, 18.0, 18.0, 9.5, 7.0)
NOISE = (0.001, 0.002)
PATCH = np.stack(np.meshgrid(np.linspace(-0.2, 0.2, 6), np.linspace(-0.2, 0.2, 6), [0.0]), -1).reshape(-1, 3)


def view(depth: np.ndarray, world_from_camera: np.ndarray | None = None, frame: int = 0) -> View:
    pose = np.eye(4) if world_from_camera is None else world_from_camera
    return View(frame, 0, CAMERA, pose, depth.astype(np.float32), np.zeros((*depth.shape, 3), np.uint8))


@pytest.mark.parametrize(
    ("place", "wall_m", "verdict"),
    [
        ((0, 0, 2.0), 2.0, PRESENT),
        ((0, 0, 2.0), 3.5, MISSED),
        ((0, 0, 2.0), 1.0, OCCLUDED),
        ((0, 0, 6.0), 9.0, OUT_OF_RANGE),
        ((9, 0, 2.0), 3.5, OUT_OF_VIEW),
        ((0, 0, -2.0), 3.5, OUT_OF_VIEW),
    ],
)
def test_a_wall_behind_before_or_at_a_place(place, wall_m, verdict):
    sight = look_at((PATCH + place).astype(np.float32), view(np.full((15, 20), wall_m)), NOISE)
    assert verdict_of(sight) == verdict


def test_no_reading_is_no_evidence():
    sight = look_at((PATCH + np.array([0, 0, 2.0])).astype(np.float32), view(np.zeros((15, 20))), NOISE)
    assert (sight.unread, sight.free, sight.surface) == (1.0, 0.0, 0.0)


points = st.lists(st.tuples(*[st.floats(-3, 3, width=32)] * 3), max_size=9).map(
    lambda rows: np.array(rows, np.float32).reshape(-1, 3)
)


@given(st.lists(points, max_size=5), st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_clouds_looked_at_together_look_as_each_alone(clouds, seed):
    depth = np.random.default_rng(seed).uniform(0.0, 4.0, (15, 20)) * (np.arange(20) % 4 > 0)
    together = look_at_each(clouds, view(depth), NOISE)
    for cloud, sight in zip(clouds, together, strict=True):
        alone = look_at(cloud, view(depth), NOISE)
        assert sight.values() == alone.values()
        assert (sight.asked, sight.inside, sight.unread) == (alone.asked, alone.inside, alone.unread)
        assert sight.on_surface.tolist() == alone.on_surface.tolist()
        assert sight.rows.tolist() == alone.rows.tolist()


colors = st.lists(st.tuples(*[st.integers(0, 255)] * 3), max_size=9).map(
    lambda rows: np.array(rows, np.uint8).reshape(-1, 3)
)


@given(st.lists(st.tuples(colors, colors), max_size=4), st.floats(0.2, 5.0))
@settings(max_examples=60, deadline=None)
def test_colours_compared_together_are_as_alike_as_each_pair_alone(pairs, gain):
    alone = [color_similarity(a, b, gain) for a, b in pairs]
    assert color_similarities(pairs, gain) == pytest.approx(alone)
    clouds = [cloud for pair in pairs for cloud in pair]
    rows = color_histograms(clouds, [gain] * len(clouds))
    for cloud, row in zip(clouds, rows, strict=True):
        assert row == pytest.approx(color_histogram(cloud, gain))
        assert row.sum() == pytest.approx(1.0 if len(cloud) else 0.0)


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3.1, 3.1), st.floats(0.05, 1.0))
@settings(max_examples=60, deadline=None)
def test_views_that_hold_a_box_are_those_that_a_corner_or_its_middle_projects_into(x, y, turn, half):
    cos, sin = np.cos(turn), np.sin(turn)
    turned = np.array([[cos, 0, sin, 0], [0, 1, 0, 0], [-sin, 0, cos, 0], [0, 0, 0, 1.0]])
    poses = [np.eye(4), turned, turned @ turned]
    windows = ViewpointWindows(SimpleNamespace(viewpoints_near=lambda _c, _r: ["viewpoint-1.1"]), 8, 5.0)
    for frame, pose in enumerate(poses):
        windows.add("viewpoint-1.1", view(np.ones((15, 20)), pose, frame), {})
    low, high = np.array([x, y, 1.0]) - half, np.array([x, y, 1.0]) + half
    spots = [(low + high) / 2, *(np.where(pick, high, low) for pick in np.ndindex(2, 2, 2))]
    expected = set()
    for frame, pose in enumerate(poses):
        uv, _ = project(transform_points(np.linalg.inv(pose), np.array(spots)), CAMERA)
        with np.errstate(invalid="ignore"):
            if ((uv >= 0) & (uv < (CAMERA.width, CAMERA.height))).all(axis=1).any():
                expected.add(frame)
    assert {remembered.view.frame for remembered in windows.looking_at(low, high, 2)} == expected - {2}


def test_the_keys_beside_a_voxel_are_its_own_and_its_faces():
    middle = np.array([[0.51 * VOXEL_M, -7.5 * VOXEL_M, 3.5 * VOXEL_M]])
    steps = np.array([[0, 0, 0], *(sign * np.eye(3)[axis] for axis in range(3) for sign in (1, -1))])
    assert {int(voxel_keys(middle)[0]) + step for step in BESIDE} == set(
        voxel_keys(middle + steps * VOXEL_M).tolist()
    )
