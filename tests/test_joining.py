"""Pieces of one thing join: by containment, by fit at a visit's end, and doubtful fragments of a thing."""

import dataclasses

import numpy as np
import pytest
from test_association import World, observe

from dssmsg.graph.changes import ObjectMerged, ObjectsJoined
from dssmsg.graph.joining import contained_pieces


def test_split_pieces_join_at_the_merge_pass():
    world = World(merge_every=4)
    left, right = ((1, 0, 0), (1.4, 0.5, 0.5)), ((1, 0.58, 0), (1.4, 1.0, 0.5))
    world.see(observe("sofa", *left))
    world.see(observe("sofa", *right))
    assert len(world.graph.objects) == 2
    world.see(observe("sofa", (1, 0, 0), (1.4, 1.0, 0.5)))  # the whole: goes to one of them
    assert len(world.graph.objects) == 2
    changes = world.see(observe("sofa", *right))
    joins = [c for c in changes if isinstance(c, ObjectsJoined)]
    assert [(c.object_id, c.absorbed_id) for c in joins] == [("object-1", "object-2")]
    assert joins[0].scores[0].name == "containment"
    assert joins[0].scores[0].value > 0.5 == joins[0].scores[0].threshold
    merged = next(c for c in changes if isinstance(c, ObjectMerged))
    assert merged.object_id == "object-1"  # the frame's own observation follows the join
    assert len(merged.points) == 0
    assert list(world.graph.objects) == ["object-1"]


def test_what_one_frame_saw_as_two_never_joins():
    world = World(merge_every=2)
    a, b = observe("cushion", (1, 0, 0), (1.4, 0.4, 0.5)), observe("cushion", (1, 0.1, 0), (1.4, 0.3, 0.5))
    world.see(a, b)
    for _ in range(3):
        assert not any(isinstance(c, ObjectsJoined) for c in world.see(a, b))
    assert not world.finish()
    assert len(world.graph.objects) == 2


def test_joins_run_in_chains_but_not_through_a_pair_seen_apart():
    world = World(merge_every=10**6, delta_sim=2.0, join_tolerance=0.1)
    low, high = (1, 0, 0), (1.4, 0.4, 0.5)
    first, second, third = (observe("box", low, high) for _ in range(3))
    world.see(first)
    world.see(dataclasses.replace(second, points_world=second.points_world + np.float32(0.06)))
    world.see(dataclasses.replace(third, points_world=third.points_world - np.float32(0.06)))
    ids = list(world.graph.objects)
    assert len(ids) == 3
    joins = contained_pieces(world.graph, ids, [], 0.5, 0.1)
    assert len(joins) == 2
    assert {join.object_id for join in joins} == {"object-1"}
    joins = contained_pieces(world.graph, ids, ["object-2", "object-3"], 0.5, 0.1)
    assert len(joins) == 1


def test_two_sides_of_one_thing_join_at_the_end_of_the_visit():
    left, right = ((1, 0, 0), (1.4, 0.5, 0.5)), ((1, 0.55, 0), (1.4, 1.0, 0.5))
    for config, count in (({}, 1), ({"join_gap": 0.0}, 2)):
        world = World(**config)
        world.see(observe("wardrobe", *left))
        world.see(observe("wardrobe", *right))
        world.finish()
        assert len(world.graph.objects) == count


def test_nameless_pieces_and_the_papers_literal_rule_do_not_align():
    left, right = ((1, 0, 0), (1.4, 0.5, 0.5)), ((1, 0.55, 0), (1.4, 1.0, 0.5))
    for label, config in (
        ("object", {}),
        ("blob", {"unnamed_labels": ["blob"]}),
        ("wardrobe", {"paper_exact": True}),
    ):
        world = World(**config)
        world.see(observe(label, *left))
        world.see(observe(label, *right))
        assert world.finish() == ()
        assert len(world.graph.objects) == 2


@pytest.mark.parametrize("label", ["wardrobe", "object"])
def test_at_the_end_the_contained_joins_before_what_lines_up(label):
    world = World(delta_sim=2.0)
    left = observe(label, (1, 0, 0), (1.4, 0.5, 0.5))
    world.see(left)
    world.see(dataclasses.replace(left, points_world=left.points_world + np.float32(0.026)))
    world.see(observe(label, (1, 0.6, 0), (1.4, 1.1, 0.5)))
    assert len(world.graph.objects) == 3
    joins = [change for change in world.finish() if isinstance(change, ObjectsJoined)]
    expected = [("join", "object-1", "object-2")]
    if label != "object":
        expected.append(("join_aligned", "object-1", "object-3"))
    assert [(j.cause.rule, j.object_id, j.absorbed_id) for j in joins] == expected


def test_things_back_to_back_or_askew_do_not_join_at_the_end():
    thin = (((1, 0, 1), (1.05, 0.5, 1.5)), ((1.2, 0, 1), (1.25, 0.5, 1.5)))  # two mirrors, a wall between
    askew = (((1, 0, 0), (1.4, 0.5, 0.5)), ((1.3, 0.55, 0), (1.7, 1.0, 0.5)))
    for first, second in (thin, askew):
        world = World()
        world.see(observe("mirror", *first))
        world.see(observe("mirror", *second))
        assert world.finish() == ()


def test_neighbours_that_one_frame_saw_stay_two_at_the_end():
    world = World()
    world.see(observe("chair", (1, 0, 0), (1.4, 0.5, 0.5)), observe("chair", (1, 0.55, 0), (1.4, 1.0, 0.5)))
    assert world.finish() == ()


def seen_twice(world, *observations):
    """The things, each alone, often enough to be believed."""
    for observation in observations:
        for _ in range(4):
            world.see(observation)


@pytest.mark.parametrize(("known", "count"), [(0.45, 3), (0.9, 2)])
def test_two_that_would_be_too_wide_for_their_kind_stay_two(known, count):
    """Chairs side by side line up as the halves of a bench do: what another chair measures tells."""
    world = World(min_views=0.5, min_votes=0.5)
    seen_twice(world, observe("chair", (4, 4, 0), (4.4, 4 + known, 0.5)))
    seen_twice(world, observe("chair", (1, 0, 0), (1.4, 0.45, 0.5)))
    seen_twice(world, observe("chair", (1, 0.5, 0), (1.4, 0.95, 0.5)))
    world.finish()
    assert len(world.graph.objects) == count


@pytest.mark.parametrize("gap", [0.0, 0.35])
@pytest.mark.parametrize(
    ("score", "low", "label", "count"),
    [
        (0.2, (1.0, 0.0, 0.8), "guitar", 1),  # the neck, doubtful
        (1.0, (1.0, 0.0, 0.8), "guitar", 2),  # as believed as the whole
        (0.2, (1.0, 0.2, 0.8), "guitar", 2),  # half of it is beside the whole
        (0.2, (1.0, 0.0, 0.8), "mirror", 2),
    ],
)
def test_a_doubtful_fragment_goes_to_what_holds_it_though_one_frame_saw_both(gap, score, low, label, count):
    world = World(merge_min_overlap=1.0, join_gap=gap)
    whole = observe("guitar", (1, 0, 0), (1.1, 0.3, 1.2))
    neck = observe(label, low, (1.1, low[1] + 0.3, 1.2), score=score)
    for _ in range(5):
        world.see(whole, neck)
    assert len(world.graph.objects) == 2
    joins = [change for change in world.finish() if isinstance(change, ObjectsJoined)]
    assert [(join.cause.rule, join.object_id) for join in joins] == [("join_fragment", "object-1")] * (
        2 - count
    )
    assert len(world.graph.objects) == count
