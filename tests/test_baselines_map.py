"""The baselines as plug-ins: change logs worked out by hand, and the laws that every method must keep."""

import dataclasses
import json

import numpy as np
import pytest
from box_scene import LabelEncoder, Thing, context, look, pose_at
from dssmsg_plugins.association.conceptgraphs import ConceptGraphs, ConceptGraphsConfig
from dssmsg_plugins.association.dovsg import DovsgAssociation, DovsgConfig
from dssmsg_plugins.perception.oracle import Oracle, OracleConfig
from dssmsg_plugins.update.dovsg import DovsgUpdate, DovsgUpdateConfig
from pydantic import ValidationError
from test_baselines import add, observe, slab, unit, wall

from dssmsg.frame import Detection
from dssmsg.graph.codec import encode
from dssmsg.graph.compare import first_difference
from dssmsg.graph.nodes import BELIEVED, TENTATIVE
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.interfaces import Association, Update
from dssmsg.lift import Lifter
from dssmsg.mission.pipeline import object_ids_of

FRAME = look([], pose_at(0, 0, 0))
BOX = slab((2.0, 0, 0.5), (2.2, 0.5, 0.9))
FAR_BOX = slab((2.0, 1.0, 0.5), (2.2, 1.5, 0.9))
METHODS = {"conceptgraphs": (ConceptGraphs, ConceptGraphsConfig), "dovsg": (DovsgAssociation, DovsgConfig)}


class World:
    """A graph with a baseline at work on it; `log` holds every change."""

    def __init__(self, method, *, update=None, **config):
        self.context = context()
        self.graph = self.context.graph
        plugin, options = METHODS[method]
        self.association = plugin(options(**config), self.context)
        self.update = None if update is None else DovsgUpdate(DovsgUpdateConfig(**update), self.context)
        self.log = []
        self.index = -1

    def see(self, *observations, frame=FRAME):
        self.index += 1
        observations = [dataclasses.replace(o, detection_index=i) for i, o in enumerate(observations)]
        changes = self.apply(self.association.associate(frame, observations, None))
        if self.update is not None:
            ids = object_ids_of(observations, changes)
            changes += self.apply(self.update.update(frame, observations, ids, None).changes)
        return changes

    def finish(self):
        changes = self.apply(self.association.finish())
        if self.update is not None:
            changes += self.apply(self.update.finish().changes)
        return changes

    def apply(self, changes):
        stamped = list(self.graph.apply_all(changes, self.index, self.index * 0.2))
        self.log += stamped
        return stamped


def rules(changes):
    return [(change.cause.rule, change.subjects[0]) for change in changes]


def scores(change):
    return {score.name: (score.value, score.threshold) for score in change.scores}


# -- association -------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_plugins_keep_their_contract(method):
    assert isinstance(World(method).association, Association)
    assert isinstance(World(method, update={}).update, Update)
    with pytest.raises(ValidationError, match="Extra inputs"):
        METHODS[method][1](delta_sim=1.0)
    with pytest.raises(ValidationError, match="Extra inputs"):
        DovsgUpdateConfig(dz=0.02)


@pytest.mark.parametrize(("method", "needed"), [("conceptgraphs", 3), ("dovsg", 2)])
def test_two_boxes_one_moves(method, needed):
    """The golden log: both methods leave what moved where it was, and add it where it is."""
    world = World(method)
    box, lamp = observe(BOX), observe(FAR_BOX + np.float32([0, 3, 0]), "lamp")
    assert rules(world.see(box, lamp)) == [("new", "object-1"), ("new", "object-2")]
    for count in range(2, 5):
        merges = [("merge", "object-1"), ("merge", "object-2")]
        beliefs = [("believe", "object-1"), ("believe", "object-2")] if count == needed else []
        assert rules(world.see(box, lamp)) == merges + beliefs
    assert world.finish() == []
    moved = observe(FAR_BOX)
    for count in range(1, 4):
        first = ("new" if count == 1 else "merge", "object-3")
        beliefs = [("believe", "object-3")] if count == needed else []
        assert rules(world.see(moved, lamp)) == [first, ("merge", "object-2"), *beliefs]
    assert world.finish() == []
    assert {one: node.status for one, node in world.graph.objects.items()} == dict.fromkeys(
        ("object-1", "object-2", "object-3"), BELIEVED
    )
    np.testing.assert_allclose(world.graph.objects["object-1"].center, [2.1, 0.25, 0.7], atol=1e-6)
    np.testing.assert_allclose(world.graph.objects["object-3"].center, [2.1, 1.25, 0.7], atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_what_was_seen_too_rarely_is_dropped_at_the_end_of_a_visit(method):
    world = World(method)
    for _ in range(3):
        world.see(observe(BOX))
    world.see(observe(BOX), observe(FAR_BOX, "lamp"))
    assert world.graph.objects["object-2"].status == TENTATIVE
    (change,) = world.finish()
    assert rules([change]) == [("few_detections", "object-2")]
    assert change.history_id is None
    assert list(world.graph.objects) == ["object-1"]


@pytest.mark.parametrize(("method", "share", "taken"), [
    ("conceptgraphs", 0.3, True), ("conceptgraphs", 0.1, False), ("dovsg", 0.6, True), ("dovsg", 0.4, False),
])  # fmt: skip
def test_how_much_overlap_two_views_of_one_label_need(method, share, taken):
    """Both cosines are 1 (labels stand in): 1.2 - 1 = 0.2 of overlap, and (0.75 - 0.5) / 0.5 = 0.5."""
    world = World(method)
    world.see(observe(BOX))
    length = 0.5
    view = observe(BOX + np.float32([0, round(length * (1 - share) / 0.025) * 0.025, 0]))
    (change, *_) = world.see(view)
    assert change.cause.rule == ("merge" if taken else "new")
    value, threshold = scores(change)["score"]
    assert threshold == (1.2 if method == "conceptgraphs" else 0.75)
    assert (value >= threshold) is taken
    assert scores(change)["overlap"][0] == pytest.approx(share, abs=0.06)


@pytest.mark.parametrize("method", METHODS)
def test_another_label_in_the_same_place_is_another_object(method):
    world = World(method)
    world.see(observe(BOX, "box", text=unit(1, 0)))
    assert rules(world.see(observe(BOX, "lamp", text=unit(0, 1)))) == [("new", "object-2")]


@pytest.mark.parametrize("method", METHODS)
def test_two_detections_of_a_frame_may_go_to_one_object(method):
    world = World(method)
    world.see(observe(BOX))
    halves = [
        observe(slab((2.0, 0, 0.5), (2.2, 0.25, 0.9))),
        observe(slab((2.0, 0.25, 0.5), (2.2, 0.5, 0.9))),
    ]
    changes = world.see(*halves)
    assert rules(changes)[:2] == [("merge", "object-1")] * 2
    assert all(len(change.points) == 0 for change in changes[:2])  # no new voxels: none written
    assert world.graph.objects["object-1"].observations == 3


def test_image_features_decide_where_perception_gives_them():
    world = World("conceptgraphs")
    world.see(observe(BOX, image=unit(1, 0)))
    assert rules(world.see(observe(BOX, image=unit(0, 1))))[0] == ("new", "object-2")  # 1 + 0 < 1.2
    (change, *_) = world.see(observe(BOX, image=unit(1, 1)))
    assert (change.cause.rule, change.subjects[0]) == ("merge", "object-1")
    assert scores(change)["score"][0] == pytest.approx(1 + np.sqrt(0.5))
    world = World("dovsg")
    world.see(observe(BOX, image=unit(1, 0)))
    (change, *_) = world.see(observe(BOX, image=unit(1, 1)))
    assert scores(change)["score"][0] == pytest.approx(0.5 + 0.4 * np.sqrt(0.5) + 0.1)


def test_conceptgraphs_names_by_majority_dovsg_by_confidence():
    alike = unit(1, 0)
    votes = [("cup", 0.9), ("mug", 0.4), ("mug", 0.4)]
    labels = {}
    for method in METHODS:
        world = World(method)
        for label, score in votes:
            world.see(observe(BOX, label, score=score, text=alike))
        assert list(world.graph.objects) == ["object-1"]
        labels[method] = world.graph.objects["object-1"].label
    assert labels == {"conceptgraphs": "mug", "dovsg": "cup"}


def test_the_surest_label_holds_against_any_number_of_others():
    world, alike = World("dovsg"), unit(1, 0)
    world.see(observe(BOX, "cup", score=0.6, text=alike))
    for _ in range(4):
        world.see(observe(BOX, "mug", score=0.5, text=alike))
        assert world.graph.objects["object-1"].label == "cup"
    world.see(observe(BOX, "vase", score=0.7, text=alike))
    assert world.graph.objects["object-1"].label == "vase"
    assert ("surest_label", "object-1") in rules(world.log)


@pytest.mark.parametrize("method", METHODS)
def test_unsure_small_and_large_detections_are_left_out(method):
    world = World(method, min_confidence=0.25)
    assert world.see(observe(BOX, score=0.2)) == []
    assert world.see(observe(BOX[:9])) == []
    frame = wall(2.0)
    full = Lifter(part_share=1.0)
    mask = np.zeros(frame.depth.shape, dtype=bool)
    mask[:, :100] = True  # 62 % of the image
    assert world.see(*lifted(full, frame, mask), frame=frame) == []
    mask[:, 40:] = False  # 25 %
    assert rules(world.see(*lifted(full, frame, mask), frame=frame)) == [("new", "object-1")]


def lifted(lifter, frame, mask):
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], dtype=float)
    return lifter.lift(frame, [Detection(mask, box, "board", 0.9)]).observations


def test_pieces_join_once_a_view_has_bridged_them():
    """Left and right of a box, then the whole: it goes to one of them, which then overlaps the other."""
    left, right = slab((2.0, 0, 0.5), (2.2, 0.25, 0.9)), slab((2.0, 0.3, 0.5), (2.2, 0.5, 0.9))
    for method in METHODS:
        world = World(method, every=2)
        world.see(observe(left), observe(right))
        assert list(world.graph.objects) == ["object-1", "object-2"]
        world.see(observe(BOX))
        changes = world.see(observe(BOX))
        assert rules(changes)[0] == ("join", "object-1")
        assert changes[0].absorbed_id == "object-2"
        assert rules(changes)[1] == ("merge", "object-1")
        assert list(world.graph.objects) == ["object-1"]
        assert world.graph.objects["object-1"].observations == 4
        assert world.graph.objects["object-1"].status == BELIEVED


def test_objects_of_another_name_do_not_join():
    world = World("conceptgraphs", every=1)
    world.see(observe(BOX, "box", text=unit(1, 0)), observe(BOX, "lamp", text=unit(0, 1)))
    world.see()
    world.finish()
    assert "join" not in {change.cause.rule for change in world.log}


def test_conceptgraphs_denoises_the_clouds_of_what_it_saw():
    world = World("conceptgraphs", every=1)
    stray = slab((2.0, 0.65, 0.5), (2.2, 0.85, 0.6))
    add(world.context, observe(np.concatenate([stray, BOX])), observe(np.concatenate([stray, BOX]), "lamp"))
    world.see(observe(BOX))
    changes = world.see(observe(BOX))
    assert rules(changes) == [("denoise", "object-1"), ("merge", "object-1"), ("believe", "object-1")]
    assert len(world.graph.objects["object-1"].points) == len(BOX)
    assert len(world.graph.objects["object-2"].points) == len(BOX) + len(stray)  # not seen: not touched
    assert rules(world.see(observe(BOX))) == [("merge", "object-1")]  # it is clean


# -- update ------------------------------------------------------------------------------------------

ROOM = [
    Thing("table", (1.5, -0.8, 0.0), (2.3, 0.0, 0.5)),
    Thing("chair", (1.5, 0.4, 0.0), (1.9, 0.8, 0.6)),
    Thing("cabinet", (3.0, -0.6, 0.0), (3.4, 0.9, 1.2)),
]
MOVED = [ROOM[0], Thing("chair", (2.4, 1.0, 0.0), (2.8, 1.4, 0.6)), ROOM[2]]
POSES = [pose_at(0.05 * i, 0.05 * i, 0.04 * i - 0.08, -0.25) for i in range(5)]


def live(world, things, visit, poses=POSES):
    encoder = LabelEncoder()
    perception = Oracle(OracleConfig(min_pixels=20), context(encoder=encoder))
    for pose in poses:
        frame = look(things, pose, world.index + 1, noise=(0.001, 0.001))
        # Each thing keeps its colour, whatever else is in view.
        labels = {0: 90, **{i: len(t.label) * 20 for i, t in enumerate(things, 1)}}
        grey = np.vectorize(labels.get)(frame.truth.instance_ids).astype(np.uint8)
        frame = dataclasses.replace(frame, visit=visit, rgb=np.repeat(grey[..., None], 3, axis=2))
        world.see(*Lifter().lift(frame, perception.detect(frame)).observations, frame=frame)
    return world.finish()


def believed(world):
    return {one: node.label for one, node in world.graph.objects.items() if node.status == BELIEVED}


def test_dovsg_sees_a_move_as_a_removal_and_an_addition():
    world = World("dovsg", update={})
    live(world, ROOM, 0)
    assert believed(world) == {"object-1": "table", "object-2": "chair", "object-3": "cabinet"}
    assert not [change for change in world.log if change.cause.plugin == "update/dovsg"]
    before = dict(world.graph.objects)
    live(world, MOVED, 1)
    assert believed(world) == {"object-1": "table", "object-3": "cabinet", "object-4": "chair"}
    (removal,) = [change for change in world.log if change.kind == "object_removed"]
    assert rules([removal]) == [("remove", "object-2")]
    assert (removal.history_id, removal.successor_id) == (None, None)
    lost, most = scores(removal)["lost"]
    assert lost > most == 0.5
    np.testing.assert_allclose(world.graph.objects["object-4"].center[:2], [2.6, 1.2], atol=0.15)
    for stays in ("object-1", "object-3"):
        assert len(world.graph.objects[stays].points) > 0.8 * len(before[stays].points)
    assert not world.graph.history


def test_what_stands_hidden_stays():
    world = World("dovsg", update={})
    live(world, ROOM, 0)
    screen = Thing("screen", (0.9, -1.5, 0.0), (0.95, 1.5, 2.0))
    live(world, [screen], 1)  # everything else was taken away, but behind the screen nobody sees that
    assert {"object-1", "object-2", "object-3"} <= set(believed(world))


def test_deletion_starts_with_the_visit_it_is_told_to():
    for from_visit, left in [(0, set()), (1, {"object-1"})]:
        world = World("dovsg", update={"from_visit": from_visit})
        world.see(observe(BOX))
        world.see(observe(BOX))
        world.see(frame=wall(3.9))
        world.see(frame=wall(3.9))
        assert set(world.graph.objects) == left


def test_a_part_shrinks_an_object_and_parts_add_up_to_its_removal():
    """A board of 40 x 40 voxels at 2 m: a third is seen through, then another, from views of a third."""
    board = slab((2.0, -0.5, -0.5), (2.025, 0.5, 0.5))
    world = World("dovsg", update={"from_visit": 0})
    world.see(observe(board), frame=wall(2.01))
    whole = len(world.graph.objects["object-1"].points)
    third = board[board[:, 1] < -0.5 + 1 / 3]

    def free(low, high):
        frame = wall(2.01)
        columns = np.arange(frame.camera.width)
        y = -(columns - frame.camera.cx) / frame.camera.fx * 2.0125
        depth = frame.depth.copy()
        depth[:, (y > low) & (y <= high)] = 3.0
        return dataclasses.replace(frame, depth=depth)

    (shrink,) = world.see(frame=free(-0.6, -0.5 + 1 / 3))
    assert rules([shrink]) == [("shrink", "object-1")]
    left = len(world.graph.objects["object-1"].points)
    assert left == pytest.approx(whole - len(third), rel=0.05)
    assert scores(shrink)["lost"][0] == pytest.approx(1 - left / whole)
    (remove,) = world.see(frame=free(-0.6, -0.5 + 2 / 3))
    assert rules([remove]) == [("remove", "object-1")]  # a half of what was left, two thirds of the whole
    assert world.graph.objects == {}


def test_a_remnant_of_a_few_voxels_is_removed():
    world = World("dovsg", update={"from_visit": 0, "max_lost": 1.0, "min_points": 10})
    few = slab((2.0, -0.05, -0.05), (2.025, 0.05, 0.05))
    world.see(observe(few), frame=wall(2.01))
    frame = wall(2.01)
    depth = frame.depth.copy()
    depth[: frame.camera.height // 2] = 3.0
    (change,) = world.see(frame=dataclasses.replace(frame, depth=depth))
    assert change.cause.rule == "remove"
    assert scores(change)["voxels"] == (8.0, 10.0)


# -- laws --------------------------------------------------------------------------------------------


def lived(method):
    world = World(method, update={} if method == "dovsg" else None)
    live(world, ROOM, 0)
    live(world, MOVED, 1)
    return world


@pytest.mark.parametrize("method", METHODS)
def test_folding_the_log_gives_the_graph_and_the_log_is_the_same_again(method):
    first, second = lived(method), lived(method)
    assert first_difference(SceneGraph.fold(first.log), first.graph) is None
    lines = [[json.dumps(encode(change)[0], sort_keys=True) for change in one.log] for one in (first, second)]
    assert lines[0] == lines[1]


def test_conceptgraphs_knows_no_change():
    world = lived("conceptgraphs")
    assert sorted(believed(world).values()) == ["cabinet", "chair", "chair", "table"]
    assert not [change for change in world.log if change.kind == "object_removed"]
