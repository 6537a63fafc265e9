"""What belongs to an object: masks that now and then take in a neighbour do not make it larger for good."""

import numpy as np
import pytest
from box_scene import Thing, look, pose_at
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from test_association import World, rules

from dssmsg.frame import Detection
from dssmsg.graph.changes import ObjectReplaced
from dssmsg.graph.extent import Extents, _Votes, outgrows, shrinks
from dssmsg.lift import Lifter

DESK = Thing("desk", (1.4, -0.6, 0.0), (2.0, 0.6, 0.5))
MUG = Thing("mug", (1.5, -0.1, 0.5), (1.62, 0.02, 0.62))


def views(count):
    """Frames of a desk with a mug on it, from places side by side."""
    return [look([DESK, MUG], pose_at(0, 0.03 * i, 0, tilt=-0.25), index=i) for i in range(count)]


def seen(frame, *numbers, label="mug", score=0.9):
    """What a mask of these things lifts to."""
    mask = np.isin(frame.truth.instance_ids, numbers)
    box = np.array([0.0, 0.0, 160.0, 120.0])
    detection = Detection(mask, box, label, score)
    (observation,) = Lifter().lift(frame, [detection]).observations
    return observation


def length(node):
    return float((node.box_max - node.box_min).max())


def watched(masks, **config):
    """The one object of a world that was shown these masks, and all changes."""
    world = World(**config)
    changes = []
    for frame, numbers in zip(views(len(masks)), masks, strict=True):
        changes += world.see(seen(frame, *numbers), frame=frame)
    return world.graph.objects["object-1"], changes


def test_a_mask_that_took_in_the_desk_once_is_cut_off_again():
    node, changes = watched([(1, 2), *[(2,)] * 4])
    assert length(node) < 0.2
    (cut,) = [change for change in changes if isinstance(change, ObjectReplaced)]
    assert cut.cause.rule == "cut"
    assert cut.history_id is None
    assert {score.name for score in cut.scores} == {"kept_share", "extent_share"}


def test_the_paper_keeps_every_point():
    for config in ({"paper_exact": True}, {"extent_share": 0.0}):
        node, changes = watched([(1, 2), *[(2,)] * 4], **config)
        assert length(node) > 1.0
        assert ("object_replaced", "cut") not in rules(changes)


@pytest.mark.parametrize("wrong", range(3, 7))
def test_one_wrong_mask_adds_nothing_to_a_known_thing(wrong):
    masks = [(2,)] * 8
    masks[wrong] = (1, 2)
    world = World(min_views=0.5, min_votes=0.5)
    for frame, numbers in zip(views(8), masks, strict=True):
        world.see(seen(frame, *numbers), frame=frame)
        assert length(world.graph.objects["object-1"]) < 0.2


def test_a_thing_that_comes_into_view_bit_by_bit_grows_to_its_size():
    world = World(min_views=0.5, min_votes=0.5)
    for index, heading in enumerate(np.linspace(-0.75, 0.75, 16)):
        frame = look([DESK], pose_at(0, 0, heading, tilt=-0.25), index=index)
        if (frame.truth.instance_ids == 1).any():
            world.see(seen(frame, 1, label="desk"), frame=frame)
    (node,) = world.graph.objects.values()
    assert node.box_max[1] - node.box_min[1] > 1.1


@pytest.mark.parametrize(("away", "trusted"), [(0.03, False), (0.7, True)])
def test_what_two_frames_from_one_place_agree_on_may_be_one_mistake(away, trusted):
    extents = Extents(0.5)
    for y in (0.0, away):
        frame = look([DESK, MUG], pose_at(0, y, 0, tilt=-0.25))
        both = seen(frame, 1, 2).points_world
        extents.vote("mug", both, both, [], frame, 0.025)
    assert extents.confirmed("mug", both, elsewhere=False).mean() > 0.9
    assert (extents.confirmed("mug", both, elsewhere=True).mean() > 0.9) == trusted


@given(st.floats(0.01, 3.0), st.floats(0.0, 3.0))
def test_a_box_outgrows_itself_by_a_share_and_by_metres_on_the_floor_alone(size, more):
    box = np.zeros(3), np.full(3, size)
    point = np.array([[size + more, 0, 0]], np.float32)
    limit = max(1.5 * size, size + 0.05)
    assume(abs(size + more - limit) > 1e-5)  # points are 32-bit floats: on the edge either answer is right
    assert outgrows(*box, point) == (size + more > limit)
    assert not outgrows(*box, point[:, ::-1])
    assert not outgrows(*box, point[:0])


def test_the_other_half_of_a_thing_seen_in_two_pieces_is_no_outside():
    """A desk of which each frame shows two masks, left and right, stays whole."""
    whole = Thing("desk", (1.4, -0.6, 0.0), (2.0, 0.6, 0.5))
    parts = [
        Thing("desk", (1.4, -0.6, 0.0), (2.0, 0.0, 0.5)),
        Thing("desk", (1.4, 0.0, 0.0), (2.0, 0.6, 0.5)),
    ]
    extents = Extents(0.5)
    frames = [look(parts, pose_at(0, 0.02 * i, 0, tilt=-0.25), index=i) for i in range(4)]
    cloud = seen(look([whole], frames[0].world_from_camera), 1).points_world
    for frame in frames:
        left, right = seen(frame, 1, label="desk"), seen(frame, 2, label="desk")
        extents.vote("a", cloud, left.points_world, [right.points_world], frame, 0.05)
    assert extents.belongs("a", cloud).all()


def test_joined_objects_are_not_cut_apart_by_votes_from_before():
    extents = Extents(0.5)
    frame = views(1)[0]
    desk, mug = seen(frame, 1, label="desk").points_world, seen(frame, 2).points_world
    both = np.concatenate([desk, mug])
    for _ in range(3):
        extents.vote("desk", both, desk, [], frame, 0.025)
        extents.vote("mug", both, mug, [], frame, 0.025)
    assert extents.belongs("desk", mug).mean() < 0.1
    extents.join("desk", "mug")
    assert extents.belongs("desk", both).all()
    extents.forget_all_but(())
    assert not extents.confirmed("desk", both, elsewhere=False).any()


def test_a_doubtful_mask_has_no_vote():
    world = World()
    frames = views(6)
    world.see(seen(frames[0], 1, 2), frame=frames[0])
    for frame in frames[1:]:
        world.see(seen(frame, 2, score=0.3), frame=frame)
    assert length(world.graph.objects["object-1"]) > 1.0


@given(st.lists(st.booleans(), min_size=1, max_size=12), st.sampled_from([0.25, 0.5, 0.75]))
@settings(max_examples=30, deadline=None)
def test_a_point_stays_if_enough_frames_had_it_inside(had, share):
    """Two sightings outside and less than the share inside: cut off; else it stays."""
    frame = views(1)[0]
    desk, mug = seen(frame, 1, label="desk").points_world, seen(frame, 2).points_world
    both = np.concatenate([desk, mug])
    extents = Extents(share)
    for inside in had:
        extents.vote("a", both, both if inside else mug, [], frame, 0.025)
    belongs = extents.belongs("a", both)
    off = had.count(False) >= 2 and sum(had) < share * len(had) and len(had) >= 2
    assert belongs[len(desk) :].all()
    assert shrinks(both, belongs) == off


frames = st.lists(
    st.tuples(st.sets(st.integers(0, 12)), st.booleans(), st.integers(0, 3)), min_size=1, max_size=6
)


@given(frames)
@settings(max_examples=80, deadline=None)
def test_votes_counted_one_by_one_are_those_counted_together(told):
    votes = [(np.array(sorted(keys), np.int64), inside, station) for keys, inside, station in told]
    together = _Votes.counted([_Votes.of_frame(*one) for one in votes])
    one_by_one = _Votes.of_frame(*votes[0])
    for one in votes[1:]:
        one_by_one = one_by_one.plus(*one)
    for name in ("keys", "inside", "outside", "first", "last"):
        assert getattr(one_by_one, name).tolist() == getattr(together, name).tolist()
