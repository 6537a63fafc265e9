import dataclasses
import math

import numpy as np
import pytest
from box_scene import LabelEncoder, Thing, context, look, pose_at
from dssmsg_plugins.association.dssm import DssmAssociation, DssmConfig
from dssmsg_plugins.perception.oracle import Oracle, OracleConfig
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial import KDTree

from dssmsg.frame import Observation
from dssmsg.geometry import box_iou
from dssmsg.graph.changes import ObjectAdded, ObjectChanged, ObjectMerged
from dssmsg.graph.scoring import (
    assign,
    confidence,
    neighbour_share,
    neighbour_tolerance,
    sampled_share,
    semantic_similarity,
)
from dssmsg.lift import Lifter

ROOM = [
    Thing("table", (1.5, -0.8, 0.0), (2.3, 0.0, 0.5)),
    Thing("vase", (1.8, -0.5, 0.5), (1.95, -0.35, 0.8)),
    Thing("chair", (1.5, 0.4, 0.0), (1.9, 0.8, 0.6)),
    Thing("chair", (1.5, 1.0, 0.0), (1.9, 1.4, 0.6)),
    Thing("sofa", (-0.8, 2.2, 0.0), (0.8, 3.0, 0.6)),
]
FRAME = dataclasses.replace(look([], pose_at(0, 0, 0)), depth=np.zeros((120, 160), np.float32))
"""A frame that says nothing of any place: the observations alone speak."""


def cloud(low, high, step=0.025):
    """A slab of points filling a box's top and front faces."""
    low, high = np.array(low), np.array(high)
    axes = [np.arange(a + step / 2, b, step) for a, b in zip(low, high, strict=True)]
    x, y, z = (g.ravel() for g in np.meshgrid(*axes, indexing="ij"))
    keep = (z > high[2] - step) | (x < low[0] + step)
    return np.stack([x, y, z], axis=1)[keep].astype(np.float32)


def observe(label, low, high, *, index=0, feature=None, score=1.0, points=None):
    points = cloud(low, high) if points is None else points
    return Observation(
        detection_index=index,
        label=label,
        score=score,
        points_world=points,
        colors=np.zeros((len(points), 3), np.uint8),
        box_min=points.min(axis=0).astype(float),
        box_max=points.max(axis=0).astype(float),
        range_m=2.0,
        text_feature=feature,
    )


class World:
    """A graph with the plug-in at work on it."""

    def __init__(self, **config):
        self.context = context()
        self.graph = self.context.graph
        self.plugin = DssmAssociation(DssmConfig(**config), self.context)
        self.index = -1

    def see(self, *observations, frame=FRAME):
        self.index += 1
        observations = [dataclasses.replace(o, detection_index=i) for i, o in enumerate(observations)]
        return self.apply(self.plugin.associate(frame, observations, None))

    def finish(self):
        return self.apply(self.plugin.finish())

    def apply(self, changes):
        return self.graph.apply_all(changes, self.index, self.index * 0.2)


def feature(*values):
    vector = np.array(values, dtype=np.float32)
    return vector / np.linalg.norm(vector)


def rules(changes):
    return [(change.kind, change.cause.rule) for change in changes]


# -- scores ----------------------------------------------------------------------------------------


def test_tolerance_is_two_sigma_but_never_below_a_voxel():
    assert neighbour_tolerance(1.0, (0.001, 0.002)) == 0.025
    assert neighbour_tolerance(5.0, (0.001, 0.002)) == pytest.approx(0.102)


def test_semantics_is_the_normalised_cosine():
    a, b = feature(1, 0), feature(1, 1)
    assert semantic_similarity("x", a, "y", b) == pytest.approx((1 + math.sqrt(0.5)) / 2)
    assert semantic_similarity("x", a, "y", -a) == 0.0
    assert semantic_similarity("x", None, "x", a) == 1.0
    assert semantic_similarity("x", None, "y", a) == 0.5
    assert semantic_similarity("object", None, "object", None, frozenset({"object"})) == 0.5


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.3))
@settings(max_examples=30, deadline=None)
def test_neighbour_share_is_what_brute_force_finds(seed, tolerance):
    rng = np.random.default_rng(seed)
    points, others = rng.random((80, 3)).astype(np.float32), rng.random((60, 3)).astype(np.float32)
    distance = np.linalg.norm(points[:, None].astype(float) - others[None].astype(float), axis=-1).min(axis=1)
    assert neighbour_share(points, KDTree(others), tolerance) == np.mean(distance <= tolerance)


def test_a_sampled_share_is_close_and_exact_at_its_thresholds():
    rng = np.random.default_rng(3)
    points = rng.random((5000, 3)).astype(np.float32)
    tree = KDTree(points[points[:, 0] < 0.6])
    exact = neighbour_share(points, tree, 0.01)
    assert abs(sampled_share(points, tree, 0.01, 512, (0.1,)) - exact) < 0.08
    assert sampled_share(points, tree, 0.01, 512, (0.58,)) == exact


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_assignment_is_one_to_one_and_best(seed):
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(0, 4), rng.integers(0, 4)
    scores, allowed = rng.uniform(1.1, 2.0, (rows, columns)), rng.random((rows, columns)) < 0.7
    answer = assign(scores, allowed, 1.1)
    used = [c for c in answer if c >= 0]
    assert len(used) == len(set(used))
    assert all(allowed[r, c] for r, c in enumerate(answer) if c >= 0)

    def best(row, free):
        if row == rows:
            return 0.0
        options = [scores[row, c] - 1.1 + best(row + 1, free - {c}) for c in free if allowed[row, c]]
        return max([best(row + 1, free), *options])

    gain = sum(scores[r, c] - 1.1 for r, c in enumerate(answer) if c >= 0)
    assert gain == pytest.approx(best(0, frozenset(range(columns))), abs=1e-6)


def test_two_weak_pairs_do_not_break_a_strong_one():
    scores = np.array([[1.9, 1.2], [1.25, 0.0]])
    assert assign(scores, scores > 1, 1.1) == [0, -1]


def test_confidence_grows_with_votes_and_views():
    assert confidence(2, 2, 2, 2) == pytest.approx(0.75)
    assert confidence(3, 1, 2, 2) == pytest.approx(0.75)
    assert confidence(0, 0, 2, 2) == 0
    assert confidence(2, 1, 2, 2) < confidence(3, 1, 2, 2) < confidence(3, 2, 2, 2)


# -- the plug-in -----------------------------------------------------------------------------------


def test_the_same_thing_merges_and_only_new_voxels_ride_along():
    world = World()
    box = ((1, 0, 0), (1.5, 0.5, 0.5))
    (added,) = world.see(observe("table", *box))
    assert isinstance(added, ObjectAdded)
    (again,) = world.see(observe("table", *box))
    assert isinstance(again, ObjectMerged)
    assert again.object_id == added.object_id
    assert len(again.points) == 0
    wider = observe("table", (1, 0, 0), (1.5, 0.6, 0.5))
    merged = world.see(wider)[0]
    assert 0 < len(merged.points) < len(wider.points_world) / 2
    assert len(world.graph.objects) == 1


def test_every_score_and_threshold_is_in_the_change():
    world = World()
    box = ((1, 0, 0), (1.5, 0.5, 0.5))
    (added,) = world.see(observe("table", *box))
    assert [(s.name, s.value, s.threshold) for s in added.scores] == [("s", 0.0, 1.1)]
    merged = world.see(observe("table", *box))[0]
    assert [(s.name, s.value, s.threshold) for s in merged.scores] == [
        ("s", 2.0, 1.1),
        ("s_geo", 1.0, None),
        ("s_sem", 1.0, 0.9),
    ]
    assert merged.cause.plugin == "association/dssm"
    assert merged.detection == 0


def test_apart_from_each_other_is_new():
    world = World()
    world.see(observe("chair", (1, 0, 0), (1.4, 0.4, 0.5)))
    (change,) = world.see(observe("chair", (1, 1, 0), (1.4, 1.4, 0.5)))
    assert rules([change]) == [("object_added", "new")]


def test_a_rug_under_a_table_merges_only_in_the_papers_literal_rule():
    """The rug lies against the table's feet: s_geo near 1, so s clears delta_sim whatever the labels say."""
    table = observe("table", (1, 0, 0), (2, 1, 0.5), feature=feature(1, 0.2))
    book = observe("book", (1.4, 0.4, 0.48), (1.6, 0.6, 0.5), feature=feature(0, 1))
    ours, paper = World(), World(paper_exact=True)
    frame = look([Thing("table", (1, 0, 0), (2, 1, 0.5))], pose_at(0, 0.5, 0, -0.3))
    for world in (ours, paper):
        world.see(table, frame=frame)
    (change,) = ours.see(book, frame=frame)
    assert rules([change]) == [("object_added", "new_unlike")]
    assert {s.name for s in change.scores} >= {"s", "s_geo", "s_sem", "overlap", "best_object"}
    assert rules(paper.see(book, frame=frame))[0] == ("object_merged", "merge")


def test_another_label_on_the_same_surface_is_the_same_thing():
    """A misread label: unlike in meaning, but each covers what is in sight of the other."""
    world = World()
    pose = pose_at(0, 0.25, 0, -0.4)
    frame = look([Thing("table", (1, 0, 0), (1.5, 0.5, 0.5))], pose)
    detections = Oracle(OracleConfig(min_pixels=20), context()).detect(frame)
    (seen,) = Lifter().lift(frame, detections).observations
    world.see(dataclasses.replace(seen, text_feature=feature(1, 0)), frame=frame)
    wrong = dataclasses.replace(seen, label="bench", text_feature=feature(0.2, 1), score=0.4)
    change = world.see(wrong, frame=frame)[0]
    assert rules([change]) == [("object_merged", "merge")]
    assert {s.name: s.value for s in change.scores}["overlap"] >= 0.5
    (node,) = world.graph.objects.values()
    assert node.label == "table"


def test_one_object_takes_one_observation_of_a_frame():
    world = World()
    world.see(observe("chair", (1, 0, 0), (1.4, 0.5, 0.5)))
    whole, half = observe("chair", (1, 0, 0), (1.4, 0.5, 0.5)), observe("chair", (1, 0, 0), (1.4, 0.25, 0.5))
    changes = world.see(half, whole)
    assert [(c.kind, c.detection) for c in changes if hasattr(c, "detection")] == [
        ("object_added", 0),
        ("object_merged", 1),
    ]
    assert changes[0].cause.rule == "new_taken"


def test_what_depth_shows_free_is_not_merged_into():
    """The chair is pushed aside by less than its width: what is seen overlaps it, its other half is free."""
    pose = pose_at(0, 0.6, 0, tilt=math.radians(-15))
    before, after = ((1.5, 0.4, 0.0), (1.9, 0.8, 0.6)), ((1.5, 0.65, 0.0), (1.9, 1.05, 0.6))
    world = World()
    frame = look([Thing("chair", *before)], pose)
    for _ in range(2):
        world.see(observe("chair", *before), frame=frame)
    changes = world.see(observe("chair", *after), frame=look([Thing("chair", *after)], pose))
    assert rules(changes)[0][0] == "object_added"
    exact = World(paper_exact=True)
    for _ in range(2):
        exact.see(observe("chair", *before), frame=frame)
    changes = exact.see(observe("chair", *after), frame=look([Thing("chair", *after)], pose))
    assert rules(changes)[0][0] == "object_merged"


def test_belief_needs_votes_and_views():
    world = World()
    box = ((1, 0, 0), (1.5, 0.5, 0.5))
    kinds = [rules(world.see(observe("table", *box))) for _ in range(4)]
    assert [len(k) for k in kinds] == [1, 1, 1, 2]  # without viewpoints four votes: 1 - 2^-2
    assert kinds[3][1] == ("object_changed", "believe")
    assert next(iter(world.graph.objects.values())).status == "believed"
    doubtful = World()
    for _ in range(6):
        doubtful.see(observe("table", *box, score=0.3))
    assert next(iter(doubtful.graph.objects.values())).status == "tentative"


def test_belief_states_its_terms():
    world = World(min_votes=1.0, min_views=1.0, delta_conf=0.5)
    _, believed = world.see(observe("table", (1, 0, 0), (1.5, 0.5, 0.5)))
    assert isinstance(believed, ObjectChanged)
    assert [(s.name, s.value, s.threshold) for s in believed.scores] == [
        ("confidence", 0.5, 0.5),
        ("votes", 1.0, 1.0),
        ("views", 0.0, 1.0),
    ]


def test_nameless_pieces_merge_by_geometry_alone():
    world = World()
    frame = look([Thing("object", (1, 0, 0), (1.4, 0.4, 0.5))], pose_at(0, 0.2, 0, -0.4))
    seen = Lifter().lift(frame, Oracle(OracleConfig(min_pixels=20), context()).detect(frame)).observations[0]
    beside = observe("object", (1, 0.38, 0), (1.4, 0.9, 0.5))
    world.see(seen, frame=frame)
    assert rules(world.see(seen, frame=frame))[0] == ("object_merged", "merge")
    assert rules(world.see(beside, frame=frame))[0][0] == "object_added"


def test_an_empty_frame_changes_nothing():
    assert World().see() == ()


@pytest.mark.parametrize("bad", [{"delta_sim": 3}, {"sample": 1}, {"min_votes": 0}, {"delta_similarity": 1}])
def test_options_are_checked(bad):
    with pytest.raises(ValidationError):
        DssmConfig(**bad)


# -- from pixels to objects ------------------------------------------------------------------------


def survey(world, things, *, noise=(0.0, 0.0), **faults):
    perception = Oracle(
        OracleConfig(min_pixels=30, **faults), dataclasses.replace(world.context, encoder=LabelEncoder())
    )
    lifter, log = Lifter(), []
    for x, y in ((0, 0), (0.2, -1.2), (-0.5, 1.0)):
        for heading in np.arange(-2.0, 2.6, 0.35):
            for tilt in (0.0, -0.4):
                world.index += 1
                frame = look(things, pose_at(x, y, heading, tilt), world.index, noise=noise)
                seen = lifter.lift(frame, perception.detect(frame)).observations
                log += world.apply(world.plugin.associate(frame.without_truth(), seen, None))
    return [*log, *world.finish()]


@pytest.mark.parametrize("noise", [(0.0, 0.0), (0.001, 0.002)])
def test_a_survey_finds_each_thing_once_with_a_tight_box(noise):
    world = World()
    survey(world, ROOM, noise=noise)
    believed = [node for node in world.graph.objects.values() if node.status == "believed"]
    assert sorted(node.label for node in believed) == sorted(thing.label for thing in ROOM)
    for node in believed:
        iou = max(
            float(box_iou(node.box_min, node.box_max, t.low, t.high)) for t in ROOM if t.label == node.label
        )
        assert iou > 0.6, (node.label, node.box_min, node.box_max)


def test_two_runs_give_the_same_changes():
    def fingerprint(changes):
        return [
            (
                c.kind,
                c.subjects,
                c.scores,
                dict(c.before),
                dict(c.after),
                np.array(getattr(c, "points", [])).tobytes(),
            )
            for c in changes
        ]

    faults = {"miss_rate": 0.2, "split_rate": 0.1, "wrong_label_rate": 0.1}
    first, second = (survey(World(), ROOM, noise=(0.001, 0.002), **faults) for _ in range(2))
    assert fingerprint(first) == fingerprint(second)


def test_misses_and_splits_do_not_multiply_things():
    world = World()
    survey(world, ROOM, miss_rate=0.3, split_rate=0.1)
    believed = [node.label for node in world.graph.objects.values() if node.status == "believed"]
    assert set(believed) == {thing.label for thing in ROOM}
    assert len(believed) <= len(ROOM) + 3
