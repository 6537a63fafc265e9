"""Query sets, true viewpoints, ranks and rows of Table IV; the command on a short run."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from floor_graph import CAUSE, FloorGraph, camera_pose
from project import project

from dssmsg.config import load_config
from dssmsg.errors import ConfigError, InputError
from dssmsg.evaluate.queries import KINDS, Query, generated_queries, load_queries
from dssmsg.evaluate.table4 import METHODS, Answer, by_waypoint, chance_level, describe, slot_of, table4_rows
from dssmsg.evaluate.viewpoint_truth import ViewpointTruth
from dssmsg.events import Candidate
from dssmsg.frame import Truth, TruthObject
from dssmsg.graph import changes as c
from dssmsg.interfaces import TargetEdge, TargetGraph, TargetNode


@pytest.mark.parametrize("scene", ["rs_int", "ihlen_1_int"])
def test_there_are_twenty_of_each_kind_half_of_them_written_first(scene):
    queries = load_queries(scene)
    for kind in KINDS:
        for name in ("first", "second"):
            assert sum((query.kind, query.set) == (kind, name) for query in queries) == 10
    assert len({query.text for query in queries}) == 40


def test_a_scene_without_queries_names_those_that_have_some():
    with pytest.raises(ConfigError, match="ihlen_1_int, rs_int"):
        load_queries("palace")


def true_object(name, low, high, room="", state="static", number=1):
    label = name.rpartition("-")[0].replace("_", " ")
    return TruthObject(number, name, label, np.array(low, float), np.array(high, float), room, False, state)


ROOM = [
    true_object("desk-1", (0, 0, 0), (1, 0.6, 0.75), "bedroom_1"),
    true_object("mug-1", (0.2, 0.2, 0.75), (0.3, 0.3, 0.85), "bedroom_1"),
    true_object("chair-1", (0.2, 0.8, 0), (0.6, 1.2, 0.9), "bedroom_1"),
    true_object("picture-1", (0.2, 0.0, 1.4), (0.8, 0.05, 1.8), "bedroom_1"),
    true_object("mug-2", (5, 5, 0), (5.1, 5.1, 0.1), "kitchen"),
    true_object("book-1", (0.5, 0.2, 0.75), (0.7, 0.4, 0.8), "bedroom_1", "disappeared"),
]


def test_generated_sentences_hold_in_the_truth():
    queries = {query.text: query.targets for query in generated_queries(ROOM, 100, 0)}
    assert queries["the mug on the desk"] == ("mug-1",)
    assert queries["the chair next to the desk"] == ("chair-1",)
    assert queries["the picture above the desk"] == ("picture-1",)
    assert queries["the mug in the kitchen"] == ("mug-2",)
    assert queries["the mug in the bedroom"] == ("mug-1",)
    assert not any("book" in text for text in queries)  # it is not there any more
    assert "the mug next to the desk" not in queries


def test_generated_sentences_are_chosen_by_the_seed():
    every = [query.text for query in generated_queries(ROOM, 100, 0)]
    some = [[query.text for query in generated_queries(ROOM, 4, seed)] for seed in (1, 1, 2)]
    assert some[0] == some[1] != some[2]
    assert set(some[0]) < set(every)
    assert len(some[0]) == 4


class StubRecording:
    """Frames of 20 x 20 pixels that show objects by area: {frame: (viewpoint, {name: pixels}, objects)}."""

    path = "stub.rrd"

    def __init__(self, rows, depth=1.0, truth=True):
        self._rows, self._depth, self._truth = rows, depth, truth
        self.key_frames = sorted(rows)

    def viewpoint(self, index):
        return self._rows[index][0]

    def frame(self, index):
        return SimpleNamespace(depth=np.full((20, 20), self._depth, np.float32))

    def truth(self, index):
        _, pixels, objects = self._rows[index]
        ids = np.zeros(400, np.int32)
        start = 0
        for known in objects:
            count = pixels.get(known.name, 0)
            ids[start : start + count] = known.instance_id
            start += count
        return Truth(ids.reshape(20, 20), tuple(objects)) if self._truth else None


def cup(x, state="static"):
    return true_object("cup-1", (x, 0, 0), (x + 0.1, 0.1, 0.1), state=state)


def test_a_viewpoint_is_right_with_200_pixels_of_a_target_where_it_is():
    recording = StubRecording(
        {
            1: ("viewpoint-1.1", {"cup-1": 200}, [cup(0)]),
            2: ("viewpoint-2.1", {"cup-1": 199}, [cup(0)]),
            3: (None, {"cup-1": 400}, [cup(0)]),
            4: ("viewpoint-3.1", {"cup-1": 300}, [cup(5, "moved")]),
            5: ("viewpoint-4.1", {}, [cup(5, "disappeared")]),
        }
    )
    truth = ViewpointTruth(recording)
    assert truth.showing(["cup-1"], 3) == {"viewpoint-1.1"}
    assert truth.showing(["cup-1"], 4) == {"viewpoint-3.1"}  # it is there now
    assert truth.showing(["cup-1"], 5) == {"viewpoint-3.1"}  # its last place
    assert truth.showing(["other-1"], 5) == frozenset()
    assert (truth.gone(4), truth.gone(5)) == (frozenset(), {"cup-1"})
    assert truth.objects(3)["cup-1"].box_min[0] == 0
    assert truth.objects(5)["cup-1"].box_min[0] == 5


def test_beyond_four_metres_nothing_is_shown_and_without_truth_nothing_is_scored():
    rows = {1: ("viewpoint-1.1", {"cup-1": 400}, [cup(0)])}
    assert ViewpointTruth(StubRecording(rows, depth=4.5)).showing(["cup-1"], 1) == frozenset()
    with pytest.raises(InputError, match="no ground truth"):
        ViewpointTruth(StubRecording(rows, truth=False))


@pytest.fixture
def graph():
    """Four waypoints with 1, 1, 2 and 3 viewpoints."""
    floor = FloorGraph()
    for place in range(4):
        floor.waypoint(2.0 * place, 0)
    for waypoint, count in ((3, 1), (4, 2)):
        for number in range(count):
            floor.add(
                c.ViewpointAdded(
                    cause=CAUSE,
                    viewpoint_id=f"viewpoint-{waypoint}.{number + 2}",
                    waypoint_id=f"waypoint-{waypoint}",
                    world_from_camera=camera_pose(2.0 * waypoint - 2.0, 0, number + 1.0),
                    heading=number + 1.0,
                    tilt=0.0,
                )
            )
    return floor.graph


def test_ranks_count_waypoints(graph):
    names = ["viewpoint-4.2", "viewpoint-4.1", "viewpoint-1.1", "viewpoint-4.3", "viewpoint-3.1"]
    ranked = by_waypoint(graph, [Candidate(name, place, {}, {}) for place, name in enumerate(names, 1)])
    assert [one.viewpoint_id for one in ranked] == ["viewpoint-4.2", "viewpoint-1.1", "viewpoint-3.1"]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 9])
def test_chance_is_what_all_draws_come_to(graph, count):
    right = frozenset({"viewpoint-2.1", "viewpoint-3.1", "viewpoint-4.1", "viewpoint-4.3"})
    views = {}
    for name, viewpoint in graph.viewpoints.items():
        views.setdefault(viewpoint.waypoint_id, []).append(name)
    draws = []
    for chosen in itertools.combinations(views, min(count, len(views))):
        picks = list(itertools.product(*(views[waypoint] for waypoint in chosen)))
        draws.append(np.mean([bool(right & set(pick)) for pick in picks]))
    assert chance_level(graph, right, count) == pytest.approx(np.mean(draws))


def answer(rank, *, scene="a", seed=0, kind="explicit", which="first", method="dssm"):
    query = Query(text="x", kind=kind, targets=("t",), set=which)
    return Answer(scene, "oracle", seed, "static", method, query, rank, (0.1, 0.2, 0.3), "", "")


def test_rows_are_means_over_queries_then_over_seeds():
    answers = [
        answer(1), answer(3), answer(None, which="second"), answer(2, scene="b", kind="implicit"),
        answer(1, seed=1), answer(1, seed=1), answer(1, seed=1, which="second"),
        answer(1, which="generated"),
    ]  # fmt: skip
    rows = {(row["scene"], row["method"], row["metric"]): row for row in table4_rows(answers)}
    first = rows["a", "dssm", "static_explicit_R@1"]
    assert first["mean"] == pytest.approx((1 / 3 + 1) / 2)
    assert first["std"] == pytest.approx(np.std([1 / 3, 1], ddof=1))
    assert first["n"] == 6
    assert rows["a", "dssm", "static_explicit_first_R@3"]["mean"] == 1.0
    assert rows["a", "dssm", "static_explicit_second_R@3"]["mean"] == 0.5
    assert rows["a", "dssm", "static_generated_R@1"]["n"] == 1
    assert rows["b", "dssm", "static_implicit_R@1"]["mean"] == 0.0
    assert rows["all", "dssm", "static_implicit_R@2"]["mean"] == 1.0
    assert rows["all", "chance", "static_explicit_R@2"]["mean"] == pytest.approx(0.2)
    assert ("b", "dssm", "static_explicit_R@1") not in rows


def test_a_target_graph_in_a_line():
    target = TargetGraph("x", (TargetNode("mug", ("red",)), TargetNode("desk")), (TargetEdge(0, 1, "on"),))
    assert describe(target) == "red mug [red mug on desk]"
    assert describe(TargetGraph("x", (TargetNode("bed"),))) == "bed [bed]"
    assert describe("no idea") == "no target graph: no idea"


def test_the_command_on_a_short_run(tmp_path):
    """The bathroom is seen in 30 frames; the second time the recording is there already."""
    home = project(tmp_path)
    command = [
        *[
            "eval",
            "table4",
            "--scenes",
            "rs_int",
            "--perception",
            "oracle",
            "--when",
            "changed",
            "--work",
            "w",
        ],
        *["--set", "mission.max_frames=30", "--set", "source.assets=embedded", "--generated", "5", "--json"],
    ]
    done = home.run(*command, "--methods", ",".join(METHODS))
    assert done.code == 0, done.err
    rows = {(row["method"], row["metric"]): row for row in done.json}
    assert {method for method, _ in rows} == {*METHODS, "chance"}
    assert {row["table"] for row in done.json} == {"table4"}
    assert rows["dssm", "changed_implicit_R@1"]["mean"] > rows["chance", "changed_implicit_R@1"]["mean"]
    assert 1 <= rows["dssm", "changed_implicit_R@1"]["n"] < 20  # what was never seen cannot be found
    assert rows["dssm", "changed_generated_R@1"]["n"] <= 5
    again = home.run(*command, "--methods", "dssm")
    assert "kept" in again.err
    assert [row for row in again.json if row["method"] == "dssm"] == [
        row for row in done.json if row["method"] == "dssm"
    ]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--methods", "magic"], "dssm_paper"),
        (["--when", "soon"], "static or changed"),
        (["--scenes", "rs_int,rs_int"], "each once"),
    ],
)
def test_wrong_options_name_what_is_accepted(tmp_path, options, said):
    done = project(tmp_path).run("eval", "table4", "--perception", "oracle", *options)
    assert done.code == 2
    assert said in done.err


def test_configured_options_hold_for_the_rows_of_their_plug_in():
    asked = load_config(None, sets=["grounding={use: dssm, relation_weight: 0.25, vanished: 0.5}"])
    assert slot_of(asked, "configured").flat() == asked.grounding.flat()
    assert slot_of(asked, "dssm").flat() == asked.grounding.flat()
    assert slot_of(asked, "dssm_paper").flat() == {
        **METHODS["dssm_paper"],
        "vanished": 0.5,
    }
    assert slot_of(asked, "objects").flat() == {"use": "objects"}
