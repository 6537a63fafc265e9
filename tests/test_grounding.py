"""The grounding baselines `objects` and `image`."""

from __future__ import annotations

import numpy as np
import pytest
from dssmsg_plugins.grounding import image, objects
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


def target(text, *labels, core=0):
    return TargetGraph(text, tuple(TargetNode(label) for label in labels), core=core)


def ground(module, floor, wanted, encoder=None, **options):
    plugin = {objects: objects.ObjectsGrounding, image: image.ImageGrounding}[module]
    made = plugin(
        module.Config(**options), context(floor.graph, encoder or WordEncoder({"washbasin": "sink"}))
    )
    return check_candidates(floor.graph, made.ground(wanted))


def test_objects_takes_the_best_object_for_the_sentence_and_says_so(floor):
    first, second = ground(objects, floor, target("sink"))
    assert (first.viewpoint_id, first.rank, first.matching) == ("viewpoint-2.1", 1, {"0": "object-1"})
    assert first.scores["score"] == pytest.approx(1.0)
    assert (second.viewpoint_id, second.scores["score"]) == ("viewpoint-3.1", pytest.approx(0.6))
    assert "washbasin (object-3) 0.60" in second.reason


def test_objects_compares_the_sentence_unless_it_is_told_to_take_the_core(floor):
    wanted = target("sink", "mirror", "sink", core=1)
    assert ground(objects, floor, target("mirror", "sink"))[0].matching == {"0": "object-2"}
    assert ground(objects, floor, wanted, query="core")[0].viewpoint_id == "viewpoint-2.1"
    assert ground(objects, floor, target("mirror", "sink"), query="core")[0].matching == {"0": "object-1"}


def test_objects_needs_no_target_graph_but_for_the_core(floor):
    assert ground(objects, floor, target("sink"))[0].viewpoint_id == "viewpoint-2.1"
    assert ground(objects, floor, target("sink"), query="core") == ()


def test_of_viewpoints_that_see_the_best_object_the_nearest_comes_first(floor):
    floor.waypoint(4.2, 0)
    floor.add(c.EdgeAdded(cause=CAUSE, edge="sees", source="viewpoint-4.1", target="object-1"))
    best = ground(objects, floor, target("sink"))
    assert [candidate.viewpoint_id for candidate in best[:2]] == ["viewpoint-4.1", "viewpoint-2.1"]
    assert best[0].scores["core_distance"] < best[1].scores["core_distance"]


def test_scores_are_sums_in_double_precision(floor):
    goal, own = np.array([1.0, 2e-8, 0.0], np.float32), np.array([0.6, 0.8, 0.0], np.float32)

    class OneGoal(WordEncoder):
        def encode_labels(self, labels):
            return np.tile(goal, (len(labels), 1))

        encode_text = encode_labels

    floor.thing("object", 0, 1, ["viewpoint-1.1"], feature=own)
    scores = {c.viewpoint_id: c.scores["score"] for c in ground(objects, floor, target("x"), OneGoal())}
    assert scores["viewpoint-1.1"] == float(goal[0]) * float(own[0]) + float(goal[1]) * float(own[1])
    assert scores["viewpoint-1.1"] != float(own[0])  # which is what it rounds to in single precision


def test_own_features_of_objects_count_before_their_labels(floor):
    encoder = WordEncoder()
    tub = encoder.encode_labels(["bathtub"])[0]
    floor.thing("object", 0, 1, ["viewpoint-1.1"], feature=tub)
    assert ground(objects, floor, target("bathtub"), encoder)[0].viewpoint_id == "viewpoint-1.1"


def test_features_of_another_space_are_not_compared(floor):
    floor.thing("bathtub", 0, 1, ["viewpoint-1.1"], feature=np.eye(3, dtype=np.float32)[0])
    best = ground(objects, floor, target("bathtub"))[0]
    assert (best.viewpoint_id, best.scores["score"]) == ("viewpoint-1.1", pytest.approx(1.0))


def test_tentative_and_vanished_objects_do_not_count(floor):
    floor.thing("guitar", 0, 1, ["viewpoint-1.1"], status="tentative")
    assert "viewpoint-1.1" not in {c.viewpoint_id for c in ground(objects, floor, target("guitar"))}
    assert ground(objects, floor, target("guitar"), tentative=True)[0].viewpoint_id == "viewpoint-1.1"
    floor.add(c.ObjectChanged(cause=CAUSE, object_id="object-1", values={"state": DISAPPEARED}))
    assert ground(objects, floor, target("sink"))[0].viewpoint_id == "viewpoint-3.1"  # the washbasin is left


def test_image_compares_the_view_as_a_whole(floor):
    best = ground(image, floor, target("sink"))
    # Viewpoint 2 shows a sink and a mirror, viewpoint 3 a mirror and a washbasin, which is 0.6 of a sink.
    assert [one.viewpoint_id for one in best] == ["viewpoint-2.1", "viewpoint-3.1"]
    assert best[0].scores["score"] == pytest.approx(1 / np.sqrt(2))
    assert best[1].scores["score"] == pytest.approx(0.6 / np.sqrt(2))
    assert best[0].matching == {}
    floor.thing("sink", 1, 0, ["viewpoint-1.1"])
    assert ground(image, floor, target("sink"))[0].viewpoint_id == "viewpoint-1.1"  # nothing else in view


def test_image_takes_image_features_where_all_objects_have_them():
    floor, encoder = FloorGraph(), WordEncoder()
    floor.waypoint(0, 0)
    floor.waypoint(3, 0)
    for name, shows, place in (("a", "tub", 1), ("b", "sofa", 2)):
        floor.thing(name, place, 0, [f"viewpoint-{place}.1"], image=encoder.encode_labels([shows])[0])
    assert ground(image, floor, target("sofa"), encoder)[0].viewpoint_id == "viewpoint-2.1"
    assert ground(image, floor, target("tub"), encoder)[0].viewpoint_id == "viewpoint-1.1"
    floor.thing("c", 1, 1, ["viewpoint-1.1"])  # of which perception made no image feature
    assert ground(image, floor, target("sofa"), encoder)[0].scores["score"] == pytest.approx(0.0)


@pytest.mark.parametrize("module", [objects, image])
def test_an_empty_graph_matches_nothing(module):
    assert ground(module, FloorGraph(), target("sink", "sink")) == ()


@pytest.mark.parametrize(
    ("module", "plugin"), [(objects, objects.ObjectsGrounding), (image, image.ImageGrounding)]
)
def test_without_an_encoder_there_is_no_grounding(floor, module, plugin):
    with pytest.raises(ConfigError) as caught:
        plugin(module.Config(), context(floor.graph))
    assert caught.value.key == "encoder.use"
