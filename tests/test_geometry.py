import math

import numpy as np
import pytest
from box_scene import CAMERA, Thing, look, pose_at
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dssmsg import geometry as g
from dssmsg.cluster import density_clusters

metres = st.floats(-20, 20, allow_nan=False, width=32)
point = arrays(np.float64, 3, elements=metres)
points = arrays(np.float64, st.tuples(st.integers(1, 20), st.just(3)), elements=metres)
angle = st.floats(-math.pi, math.pi)


@st.composite
def poses(draw):
    return pose_at(draw(metres), draw(metres), draw(angle), draw(st.floats(-1.4, 1.4)), draw(metres))


@st.composite
def boxes(draw):
    a, b = draw(point), draw(point)
    return np.minimum(a, b), np.maximum(a, b)


@given(poses(), points)
def test_a_rigid_transform_and_its_inverse_cancel(pose, cloud):
    back = g.transform_points(g.invert_rigid(pose), g.transform_points(pose, cloud))
    np.testing.assert_allclose(back, cloud, atol=1e-9)
    np.testing.assert_allclose(g.invert_rigid(pose) @ pose, np.eye(4), atol=1e-9)


@given(poses(), poses(), points)
def test_transforms_compose(first, second, cloud):
    both = g.transform_points(second @ first, cloud)
    np.testing.assert_allclose(both, g.transform_points(second, g.transform_points(first, cloud)), atol=1e-8)


@given(st.lists(poses(), min_size=1, max_size=4))
def test_inverses_come_in_batches(many):
    np.testing.assert_array_equal(g.invert_rigid(np.stack(many)), np.stack([g.invert_rigid(p) for p in many]))


@given(arrays(np.float64, (CAMERA.height, CAMERA.width), elements=st.sampled_from([0.0, 0.5, 1.25, 4.0])))
def test_projection_undoes_back_projection(depth):
    uv, z = g.project(g.back_project(depth, CAMERA), CAMERA)
    v, u = np.nonzero(depth)
    np.testing.assert_allclose(uv, np.stack([u, v], axis=1), atol=1e-9)
    np.testing.assert_array_equal(z, depth[v, u])


def test_points_behind_the_camera_have_no_pixel():
    uv, _ = g.project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]), CAMERA)
    assert np.isnan(uv).all()


def test_a_mask_keeps_its_pixels_only():
    depth = np.full((CAMERA.height, CAMERA.width), 2.0)
    mask = np.zeros_like(depth, dtype=bool)
    mask[10, 20:25] = True
    points = g.back_project(depth, CAMERA, mask)
    assert len(points) == 5
    assert (points[:, 2] == 2.0).all()


def test_the_centre_pixel_lies_straight_ahead():
    pose = pose_at(1.0, 2.0, math.pi / 2)
    depth = np.zeros((120, 160))
    depth[59:61, 79:81] = 3.0
    ahead = g.back_project_world(depth, CAMERA, pose).mean(axis=0)
    np.testing.assert_allclose(ahead, [1.0, 5.0, 0.88], atol=1e-9)


@given(boxes(), boxes())
def test_box_relations_are_symmetric_and_agree(a, b):
    assert g.box_distance(*a, *b) == g.box_distance(*b, *a)
    assert g.box_iou(*a, *b) == pytest.approx(float(g.box_iou(*b, *a)))
    assert bool(g.boxes_touch(*a, *b)) == (g.box_distance(*a, *b) == 0)
    assert 0 <= g.box_iou(*a, *b) <= 1 + 1e-12
    if g.box_intersection(*a, *b) > 0:
        assert g.boxes_touch(*a, *b)


@given(boxes())
def test_a_box_is_itself(box):
    assert g.box_distance(*box, *box) == 0
    assert g.box_iou(*box, *box) == pytest.approx(1.0 if g.box_volume(*box) > 0 else 0.0)


@given(boxes(), boxes(), st.floats(0, 5))
def test_growing_by_the_distance_makes_boxes_touch(a, b, margin):
    gap = float(g.box_gaps(*a, *b).max())
    assert g.boxes_touch(*g.grow_box(*a, gap + 1e-9), *b)
    if margin < gap - 1e-9:
        assert not g.boxes_touch(*g.grow_box(*a, margin), *b)


@given(points)
def test_a_cloud_lies_in_its_box(cloud):
    low, high = g.box_of(cloud)
    assert g.points_in_box(cloud, low, high).all()
    assert not g.points_in_box(cloud, high + 1, high + 2).any()


def test_boxes_broadcast():
    low, high = np.zeros((4, 3)), np.ones((4, 3))
    assert g.box_iou(low, high, np.zeros(3), np.array([1.0, 1.0, 2.0])).tolist() == [0.5] * 4


def test_sight_tells_gone_from_hidden():
    thing = Thing("box", (2.0, -0.3, 0.6), (2.4, 0.3, 1.2))
    pose = pose_at(0.0, 0.0, 0.0)
    front, behind, beside, back = [2.0, 0.0, 0.9], [3.0, 0.0, 0.9], [1.0, 0.0, 0.9], [-1.0, 0.0, 0.9]
    cloud = np.array([front, behind, beside, back])
    frame = look([thing], pose)
    codes = g.sight_of_points(cloud, frame.depth, CAMERA, pose, 0.03)
    assert codes.tolist() == [
        g.Sight.ON_SURFACE,
        g.Sight.OCCLUDED,
        g.Sight.SEEN_THROUGH,
        g.Sight.OUT_OF_VIEW,
    ]
    gone = g.sight_of_points(cloud[:1], look([], pose).depth, CAMERA, pose, 0.03)
    assert gone.tolist() == [g.Sight.SEEN_THROUGH]
    blind = g.sight_of_points(cloud[:1], np.zeros((120, 160)), CAMERA, pose, 0.03)
    assert blind.tolist() == [g.Sight.NO_READING]
    assert g.sight_of_points(cloud[:1], frame.depth, CAMERA, pose, 0.03, max_range=1.5).tolist() == [
        g.Sight.OUT_OF_VIEW
    ]


@given(points)
def test_cell_keys_are_equal_exactly_within_a_cell(cloud):
    keys, steps = g.cell_keys(cloud, 0.5)
    cells = np.floor(cloud / 0.5).astype(int)
    same = (cells[:, None] == cells[None]).all(axis=-1)
    np.testing.assert_array_equal(keys[:, None] == keys[None], same)
    for axis, step in enumerate(steps):
        neighbour = (cells[None] - cells[:, None] == np.eye(3, dtype=int)[axis]).all(axis=-1)
        np.testing.assert_array_equal(keys[None] - keys[:, None] == step, neighbour)


def brute_dbscan(cloud, eps, least):
    """The definition, word by word: all distances, core points, flood fill, border to the nearest."""
    distance = np.linalg.norm(cloud[:, None] - cloud[None], axis=-1)
    near = distance <= eps
    core = near.sum(axis=1) >= least
    labels = np.full(len(cloud), -1)
    count = 0
    for start in np.flatnonzero(core):
        if labels[start] >= 0:
            continue
        labels[start], stack = count, [start]
        while stack:
            for other in np.flatnonzero(near[stack.pop()] & core & (labels < 0)):
                labels[other] = count
                stack.append(other)
        count += 1
    for border in np.flatnonzero(~core):
        reachable = np.flatnonzero(core & near[border])
        if len(reachable):
            labels[border] = labels[reachable[np.argmin(distance[border, reachable])]]
    first = {}
    return np.array([-1 if label < 0 else first.setdefault(label, len(first)) for label in labels])


@pytest.mark.parametrize("seed", range(60))
def test_clusters_equal_brute_force_dbscan(seed):
    rng = np.random.default_rng(seed)
    blobs = [
        rng.normal(rng.uniform(-0.5, 0.5, 3), rng.uniform(0.01, 0.15), (rng.integers(1, 60), 3))
        for _ in range(rng.integers(1, 6))
    ]
    cloud = np.concatenate(blobs)
    np.testing.assert_array_equal(density_clusters(cloud, 0.1, 10), brute_dbscan(cloud, 0.1, 10))


def test_groups_are_clustered_apart():
    cloud = np.random.default_rng(0).normal(0, 0.03, (80, 3))
    groups = np.repeat([0, 1], 40)
    labels = density_clusters(cloud, 0.1, 10, groups)
    assert set(labels[groups == 0]) == {0}
    assert set(labels[groups == 1]) == {1}


def test_no_points_no_clusters():
    assert len(density_clusters(np.zeros((0, 3)), 0.1, 10)) == 0
    assert density_clusters(np.array([[0.0, 0, 0], [5, 0, 0], [9, 0, 0]]), 0.1, 2).tolist() == [-1, -1, -1]
