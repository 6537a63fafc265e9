"""Grounding `objects`: the node score of eq. 3, viewpoint by viewpoint."""

from __future__ import annotations

import numpy as np
import pytest
from dssmsg_plugins.grounding.objects import Config, ObjectsGrounding
from floor_graph import CAUSE, FloorGraph, WordEncoder, context

from dssmsg.checks import check_candidates
from dssmsg.errors import ConfigError
from dssmsg.graph import changes as c
from dssmsg.graph.nodes import DISAPPEARED
from dssmsg.interfaces.grounding import TargetGraph, TargetNode


@pytest.fixture
def floor():
    made = FloorGraph()
    made.waypoint(0, 0)
    made.waypoint(3, 0)
    made.waypoint(6, 0)
    made.thing("sink", 4, 1, ["viewpoint-2.1"])
    made.thing("mirror", 4, 1.5, ["viewpoint-2.1", "viewpoint-3.1"])
    made.thing("washbasin", 6.5, 1, ["viewpoint-3.1"])
    return made


def target(*labels, core=0):
    return TargetGraph("a goal", tuple(TargetNode(label) for label in labels), core=core)


def ground(floor, wanted, encoder=None, **options):
    made = ObjectsGrounding(
        Config(**options), context(floor.graph, encoder or WordEncoder({"washbasin": "sink"}))
    )
    return check_candidates(floor.graph, made.ground(wanted))


def test_mean_of_best_cosines_ranks_viewpoints_and_says_why(floor):
    first, second = ground(floor, target("sink", "mirror"))
    assert (first.viewpoint_id, first.rank) == ("viewpoint-2.1", 1)
    assert first.scores["s_node"] == pytest.approx(1.0)
    assert first.matching == {"0": "object-1", "1": "object-2"}
    assert (second.viewpoint_id, second.rank) == ("viewpoint-3.1", 2)
    assert second.scores["s_node"] == pytest.approx((0.6 + 1.0) / 2)
    assert second.scores["node_0"] == pytest.approx(0.6)
    assert second.reason == "sink: washbasin (object-3) 0.60; mirror: mirror (object-2) 1.00"


def test_a_viewpoint_that_sees_nothing_is_no_candidate(floor):
    assert "viewpoint-1.1" not in {candidate.viewpoint_id for candidate in ground(floor, target("sink"))}


def test_of_equals_the_one_near_the_core_target_wins(floor):
    floor.waypoint(4.2, 0)
    floor.add(c.EdgeAdded(cause=CAUSE, edge="sees", source="viewpoint-4.1", target="object-1"))
    best = ground(floor, target("sink"))
    assert [candidate.viewpoint_id for candidate in best[:2]] == ["viewpoint-4.1", "viewpoint-2.1"]
    assert best[0].scores["core_distance"] < best[1].scores["core_distance"]


def test_core_decides_between_equal_means(floor):
    floor.waypoint(9, 0)
    floor.thing("towel", 9, 1, ["viewpoint-4.1"])
    wanted = target("mirror", "towel", core=1)
    assert ground(floor, wanted)[0].viewpoint_id == "viewpoint-4.1"
    assert ground(floor, target("towel", "mirror", core=1))[0].viewpoint_id != "viewpoint-4.1"


def test_scores_are_sums_in_double_precision(floor):
    goal, own = np.array([1.0, 2e-8, 0.0], np.float32), np.array([0.6, 0.8, 0.0], np.float32)

    class OneGoal(WordEncoder):
        def encode_labels(self, labels):
            return np.tile(goal, (len(labels), 1))

    floor.thing("object", 0, 1, ["viewpoint-1.1"], feature=own)
    scores = {c.viewpoint_id: c.scores["s_node"] for c in ground(floor, target("x"), OneGoal())}
    assert scores["viewpoint-1.1"] == float(goal[0]) * float(own[0]) + float(goal[1]) * float(own[1])
    assert scores["viewpoint-1.1"] != float(own[0])  # which is what it rounds to in single precision


def test_own_features_of_objects_count_before_their_labels(floor):
    encoder = WordEncoder()
    tub = encoder.encode_labels(["bathtub"])[0]
    floor.thing("object", 0, 1, ["viewpoint-1.1"], feature=tub)
    assert ground(floor, target("bathtub"), encoder)[0].viewpoint_id == "viewpoint-1.1"


def test_features_of_another_space_are_not_compared(floor):
    floor.thing("bathtub", 0, 1, ["viewpoint-1.1"], feature=np.eye(3, dtype=np.float32)[0])
    best = ground(floor, target("bathtub"))[0]
    assert (best.viewpoint_id, best.scores["s_node"]) == ("viewpoint-1.1", pytest.approx(1.0))


def test_tentative_and_vanished_objects_do_not_count(floor):
    floor.thing("guitar", 0, 1, ["viewpoint-1.1"], status="tentative")
    assert ground(floor, target("guitar"))[0].viewpoint_id != "viewpoint-1.1"
    assert ground(floor, target("guitar"), tentative=True)[0].viewpoint_id == "viewpoint-1.1"
    floor.add(c.ObjectChanged(cause=CAUSE, object_id="object-1", values={"state": DISAPPEARED}))
    assert ground(floor, target("sink"))[0].viewpoint_id == "viewpoint-3.1"  # the washbasin is what is left


def test_an_empty_graph_and_an_empty_target_match_nothing(floor):
    assert ground(FloorGraph(), target("sink")) == ()
    assert ground(floor, target()) == ()


def test_without_an_encoder_there_is_no_grounding(floor):
    with pytest.raises(ConfigError) as caught:
        ObjectsGrounding(Config(), context(floor.graph))
    assert caught.value.key == "encoder.use"
