"""The parts of the baselines, each against cases worked out by hand or by brute force."""

import dataclasses

import numpy as np
import pytest
from box_scene import CAMERA, LabelEncoder, Thing, context, look, pose_at
from dssmsg_plugins.perception.oracle import Oracle, OracleConfig
from scipy.spatial import KDTree

from dssmsg.baselines.appearance import image_cosine, text_cosine
from dssmsg.baselines.clouds import largest_clusters, largest_neighbour_cluster
from dssmsg.baselines.depth_test import DepthTest
from dssmsg.baselines.footprint import (
    box_share,
    covered_pixels,
    has_pixels,
    mask_share,
    pixel_box,
    without_contained,
)
from dssmsg.baselines.pairs import PairScorer, Weights
from dssmsg.frame import Frame, Observation
from dssmsg.graph.changes import Cause, ObjectAdded
from dssmsg.lift import Lifter


def slab(low, high, step=0.025):
    """One point in the middle of each cell of a box, so that sides count in cells."""
    axes = [np.arange(a + step / 2, b, step) for a, b in zip(low, high, strict=True)]
    return np.stack([g.ravel() for g in np.meshgrid(*axes, indexing="ij")], axis=1).astype(np.float32)


def observe(points, label="box", *, index=0, score=1.0, text=None, image=None):
    points = np.asarray(points, dtype=np.float32)
    return Observation(
        detection_index=index,
        label=label,
        score=score,
        points_world=points,
        colors=np.full((len(points), 3), 128, np.uint8),
        box_min=points.min(axis=0).astype(float),
        box_max=points.max(axis=0).astype(float),
        range_m=2.0,
        text_feature=text,
        image_feature=image,
    )


def unit(*values):
    vector = np.array(values, dtype=np.float32)
    return vector / np.linalg.norm(vector)


def add(surroundings, *observations):
    changes = [
        ObjectAdded(
            cause=Cause("test", "new"),
            object_id=surroundings.ids.new("object"),
            label=one.label,
            score=one.score,
            points=one.points_world,
            colors=one.colors,
            viewpoint_id=None,
            range_m=2.0,
            text_feature=one.text_feature,
            image_feature=one.image_feature,
        )
        for one in observations
    ]
    surroundings.graph.apply_all(changes, 0, 0.0)
    return [change.object_id for change in changes]


# -- looks and names ---------------------------------------------------------------------------------


def test_cosines_are_raw_and_labels_stand_in_for_missing_features():
    points = slab((0, 0, 0), (0.1, 0.1, 0.1))
    mug = observe(points, "mug", text=unit(1, 0), image=unit(1, 0))
    cup = observe(points, "cup", text=unit(1, 1), image=unit(-1, 0))
    assert text_cosine(mug, cup) == pytest.approx(np.sqrt(0.5))
    assert image_cosine(mug, cup) == -1.0
    plain_mug, plain_cup = observe(points, "mug", text=unit(1, 0)), observe(points, "cup")
    assert image_cosine(mug, plain_mug) == 1.0  # one has no image feature: their text features speak
    assert image_cosine(cup, plain_mug) == pytest.approx(np.sqrt(0.5))
    assert text_cosine(mug, plain_cup) == image_cosine(mug, plain_cup) == 0.0
    assert text_cosine(cup, plain_cup) == 1.0


# -- clouds ------------------------------------------------------------------------------------------


def test_the_largest_cluster_stays_each_cloud_for_itself():
    big, small = slab((0, 0, 0), (0.2, 0.2, 0.1)), slab((1, 0, 0), (1.1, 0.1, 0.1))
    sparse = np.array([[5.0, 0, 0], [9.0, 0, 0]], np.float32)
    kept = largest_clusters([np.concatenate([small, big]), sparse, small], eps=0.1)
    assert kept[0].tolist() == [False] * len(small) + [True] * len(big)
    assert kept[1].all()  # no cluster at all: nothing is thrown away
    assert kept[2].all()
    assert largest_clusters([], eps=0.1) == []


@pytest.mark.parametrize("percentile", [60.0, 95.0])
def test_dovsgs_clusters_are_dbscan_with_its_eps(percentile):
    rng = np.random.default_rng(4)
    for _ in range(25):
        centres = rng.random((3, 3)) * 2
        points = np.concatenate([rng.normal(c, 0.2, (rng.integers(4, 150), 3)) for c in centres])
        distances, _ = KDTree(points).query(points, k=[11])
        (expected,) = largest_clusters([points], float(np.percentile(distances, percentile)))
        np.testing.assert_array_equal(largest_neighbour_cluster(points, percentile), expected)


def test_dovsgs_clusters_drop_a_far_piece_and_keep_small_clouds():
    big, far = slab((0, 0, 0), (0.5, 0.5, 0.05)), slab((2, 0, 0), (2.05, 0.05, 0.05))
    kept = largest_neighbour_cluster(np.concatenate([far, big]))
    assert kept.tolist() == [False] * len(far) + [True] * len(big)
    assert largest_neighbour_cluster(big[:10]).all()


# -- footprints --------------------------------------------------------------------------------------

TABLE, CUP = (
    Thing("table", (1.4, -0.6, 0.0), (2.2, 0.6, 0.7)),
    Thing("cup", (1.5, -0.1, 0.7), (1.7, 0.1, 0.9)),
)


def seen(things, pose, index=0, *, encoder=None):
    frame = look(things, pose, index)
    perception = Oracle(OracleConfig(min_pixels=20), context(encoder=encoder))
    return frame, perception.detect(frame)


def test_an_observation_covers_its_mask():
    frame, detections = seen([TABLE, CUP], pose_at(0, 0, 0, -0.3))
    for detection, observation in zip(detections, Lifter().lift(frame, detections).observations, strict=True):
        size = int(detection.mask.sum())
        assert 0.9 * size <= covered_pixels(frame, observation) <= 1.05 * size
        assert mask_share(frame, observation) == covered_pixels(frame, observation) / (160 * 120)
        # Lifting leaves out rims on depth steps: up to five pixels of the table's far edge.
        np.testing.assert_allclose(pixel_box(frame, observation), detection.box_xyxy, atol=6)
        left, top, right, bottom = pixel_box(frame, observation)
        assert box_share(frame, observation) == (right - left) * (bottom - top) / (160 * 120)


def test_only_observations_with_few_voxels_have_their_pixels_counted():
    frame, detections = seen([TABLE, CUP], pose_at(0, 0, 0, -0.3))
    _, cup = Lifter().lift(frame, detections).observations
    assert has_pixels(frame, cup, len(cup.points_world))
    few = dataclasses.replace(cup, points_world=cup.points_world[:1], colors=cup.colors[:1])
    pixels = covered_pixels(frame, few)
    assert 1 < pixels < 100
    assert has_pixels(frame, few, pixels)
    assert not has_pixels(frame, few, pixels + 1)


def test_what_lies_behind_the_camera_covers_nothing():
    frame = look([], pose_at(0, 0, 0))
    behind = observe(slab((-2, 0, 0.8), (-1.9, 0.1, 0.9)))
    assert pixel_box(frame, behind) == (0.0, 0.0, 0.0, 0.0)
    assert covered_pixels(frame, behind) == 0


def test_a_container_loses_the_voxels_of_what_lies_in_it():
    frame = look([], pose_at(0, 0, 0))
    shelf = observe(slab((2.0, -0.5, 0.4), (2.05, 0.5, 1.4)), "shelf")
    book = observe(slab((2.0, -0.1, 0.8), (2.05, 0.1, 1.0)), "book")
    beside = observe(slab((2.0, 0.4, 0.8), (2.05, 0.9, 1.0)), "lamp")
    left = without_contained(frame, [shelf, book, beside])
    assert [one.label for one in left] == ["shelf", "book", "lamp"]
    assert len(left[0].points_world) == len(shelf.points_world) - len(book.points_world)
    assert len(left[0].colors) == len(left[0].points_world)
    assert left[1] is book  # a book lies in the shelf, not the shelf in a book
    assert left[2] is beside  # a third of the lamp's box is in the shelf's: not contained
    assert without_contained(frame, [book, book]) == [book, book]  # alike: neither holds the other


def test_a_container_of_which_nothing_is_left_is_left_out():
    frame = look([], pose_at(0, 0, 0))
    cover = observe(slab((2.0, -0.1, 0.8), (2.05, 0.1, 1.0)), "cover")
    parts = [
        observe(slab((2.0, -0.1, 0.8), (2.05, 0.0, 1.0)), "left"),
        observe(slab((2.0, 0.0, 0.8), (2.05, 0.1, 1.0)), "right"),
    ]
    assert [one.label for one in without_contained(frame, [cover, *parts])] == ["left", "right"]


# -- pairs -------------------------------------------------------------------------------------------


def test_overlap_is_the_share_of_the_things_own_points():
    surroundings = context()
    (box,) = add(surroundings, observe(slab((0, 0, 0), (0.4, 0.4, 0.1))))
    scorer = PairScorer(surroundings.graph, Weights(1.0, 1.0, 0.0), 0.025)
    # Half of it lies on the box; one more layer of cells is within 0.025 m... but not nearer than it.
    shifted = observe(slab((0.2, 0, 0), (0.6, 0.4, 0.1)))
    pair = scorer.best(shifted, [box])
    assert 8 / 16 <= pair.overlap <= 9 / 16
    assert pair.image == pair.text == 1.0
    assert pair.score == pair.overlap + 1.0
    part = scorer.best(observe(slab((0, 0, 0), (0.1, 0.1, 0.1))), [box])
    assert part.overlap == 1.0  # a part lies on the whole ...
    whole = scorer.best(observe(slab((0, 0, 0), (0.8, 0.8, 0.1))), [box])
    assert whole.overlap == pytest.approx(0.25, abs=0.04)  # ... a quarter of the whole lies on the part


def test_boxes_apart_do_not_overlap_but_flat_things_do():
    surroundings = context()
    flat = slab((0, 0, 0), (1, 1, 0.025))
    flat[:, 2] = 0.0
    rug, other = add(surroundings, observe(flat, "rug"), observe(slab((3, 3, 0), (4, 4, 0.1))))
    scorer = PairScorer(surroundings.graph, Weights(0.5, 0.4, 0.1), 0.025)
    again = observe(flat, "rug")
    assert scorer.best(again, [rug]).overlap == 1.0
    assert scorer.best(again, [other]).overlap == 0.0
    assert scorer.best(again, []) is None


def test_the_best_pair_is_the_one_that_scoring_all_finds():
    rng = np.random.default_rng(2)
    surroundings = context()
    clouds = [rng.normal(rng.random(3) * 0.3, 0.1, (120, 3)) for _ in range(8)]
    looks = [unit(*rng.normal(size=3)) for _ in clouds]
    ids = add(surroundings, *(observe(c, text=f, image=f) for c, f in zip(clouds, looks, strict=True)))
    scorer = PairScorer(surroundings.graph, Weights(0.5, 0.4, 0.1), 0.05)
    for _ in range(30):
        thing = observe(rng.normal(rng.random(3) * 0.3, 0.1, (90, 3)), text=unit(*rng.normal(size=3)))
        pairs = [scorer.exact(thing, scorer.bound(thing, one)) for one in ids]
        for one, pair in zip(ids, pairs, strict=True):
            stored = surroundings.graph.objects[one].points
            gaps = np.linalg.norm(thing.points_world[:, None].astype(float) - stored[None], axis=-1)
            assert pair.overlap == pytest.approx(np.mean(gaps.min(axis=1) <= 0.05))
            assert scorer.bound(thing, one).overlap >= pair.overlap
        assert scorer.best(thing, ids) == max(pairs, key=lambda pair: pair.score)


def test_of_equal_pairs_the_first_is_best():
    surroundings = context()
    same = observe(slab((0, 0, 0), (0.2, 0.2, 0.1)))
    first, second = add(surroundings, same, same)
    scorer = PairScorer(surroundings.graph, Weights(1.0, 1.0, 0.0), 0.025)
    assert scorer.best(same, [first, second]).object_id == first


# -- the depth test ----------------------------------------------------------------------------------


def wall(depth, rgb=100):
    """A frame that sees one flat thing at a depth, all in one grey; the camera looks along world x."""
    size = (CAMERA.height, CAMERA.width)
    return Frame(
        0,
        0.0,
        np.full((*size, 3), rgb, np.uint8),
        np.full(size, depth, np.float32),
        CAMERA,
        pose_at(0, 0, 0, 0, 0),
        np.eye(4),
    )


def at(*distances, grey=100):
    """Voxels straight ahead, one a distance, beside each other in the image."""
    points = np.array([[d, 0.1 * place * d, 0.0] for place, d in enumerate(distances)], np.float32)
    return points, np.full((len(points), 3), grey, np.uint8)


@pytest.mark.parametrize(
    ("behind", "grey", "gone"),
    [
        (0.025, 100, True),  # further than 0.02 m behind: whatever the colour
        (0.015, 100, False),  # between 0.01 and 0.02 m: only with another colour
        (0.015, 140, True),  # 40 / 255 on each channel is a distance of 0.157
        (0.015, 120, False),  # 20 / 255 is 0.078
        (0.005, 255, False),  # a repainted thing is still there
        (-0.5, 255, False),  # hidden: what is in front says nothing
    ],
)
def test_a_voxel_goes_by_depth_or_by_less_depth_and_colour(behind, grey, gone):
    points, colors = at(2.0, grey=grey)
    assert DepthTest().gone(points, colors, wall(2.0 + behind)).tolist() == [gone]


def test_only_the_front_voxel_of_a_pixel_is_tested():
    points = np.array([[1.5, 0, 0], [1.6, 0, 0], [1.6, 0.3, 0]], np.float32)
    colors = np.full((3, 3), 100, np.uint8)
    assert DepthTest().gone(points, colors, wall(2.0)).tolist() == [True, False, True]
    assert DepthTest().gone(points[1:], colors[1:], wall(2.0)).tolist() == [True, True]  # the next view


def test_no_reading_out_of_view_and_out_of_range_are_no_evidence():
    points, colors = at(2.0, 3.0)
    assert not DepthTest().gone(points, colors, wall(0.0)).any()
    assert DepthTest(max_range=2.5).gone(points, colors, wall(4.0)).tolist() == [True, False]
    behind = np.array([[-1.0, 0, 0], [0.5, 5.0, 0]], np.float32)
    assert not DepthTest().gone(behind, colors, wall(4.0)).any()


def test_a_thing_that_stands_where_it_stood_loses_next_to_nothing():
    """Exact depth, slanted faces, other views than the one it was mapped from."""
    things, encoder = [TABLE, CUP], LabelEncoder()
    frame, detections = seen(things, pose_at(0, 0, 0, -0.3), encoder=encoder)
    for observation in Lifter().lift(frame, detections).observations:
        cloud, colors = observation.points_world, observation.colors
        assert DepthTest().gone(cloud, colors, frame).mean() < 0.05
        again = look(things, pose_at(0.2, 0.1, -0.1, -0.3), 1)
        assert DepthTest().gone(cloud, colors, again).mean() < 0.12
        bare = look([], pose_at(0.2, 0.1, -0.1, -0.3), 2)
        assert DepthTest().gone(cloud, colors, bare).mean() > 0.5
