"""Judging episodes by the truth, the rows that come of it, and cases that can be solved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_navigation import Robot

from dssmsg.evaluate import navigation_cases
from dssmsg.evaluate.navigation import Episode, evaluate_navigation, navigation_rows, scene_list
from dssmsg.evaluate.navigation_cases import SEEK_VISIT, Goal, Home, make_case, possible_goals
from dssmsg.evaluate.navigation_witness import EpisodeWitness, Judged
from dssmsg.events import EpisodeEnded, FrameCaptured, PhaseStarted, TruthSeen
from dssmsg.frame import Truth, TruthObject
from dssmsg.sim.obstacles import with_obstacles
from dssmsg.sim.occupancy import Occupancy
from dssmsg.sim.scene_placement import Placer

ISLAND = np.zeros(3), np.ones(3)


class Story:
    """Frames of a robot whose image shows `pixels` of the lamp, told to a witness."""

    def __init__(self, targets=("lamp-1",)):
        self.witness, self.robot = EpisodeWitness([targets]), Robot(0.0, 0.0)
        self.lamp = TruthObject(1, "lamp-1", "lamp", *ISLAND)
        self.contacts = 0

    def frame(self, x, pixels, viewpoint=None):
        self.robot.x = x
        self.robot.index += 1
        frame = self.robot.frame()
        ids = np.zeros(frame.depth.shape, np.int32)
        near = np.flatnonzero((frame.depth > 0) & (frame.depth < 4.0))[:pixels]
        ids.reshape(-1)[near] = 1
        self.witness.on_event(FrameCaptured(frame, None, True, viewpoint, self.contacts))
        self.witness.on_event(TruthSeen(frame.index, frame.sim_time, Truth(ids, (self.lamp,))))

    def seek(self):
        self.witness.on_event(PhaseStarted("seek", 1, self.robot.index, 0.0))

    def end(self, outcome="success", reason=""):
        index = self.robot.index
        values = {"metres": 3.0, "seconds": 9.0, "replans": 1.0}
        self.witness.on_event(EpisodeEnded(0, "the lamp", outcome, reason, index, 0.0, values))
        return self.witness.judged[0]


def test_a_success_is_near_a_true_viewpoint_with_the_target_in_view():
    story = Story()
    story.frame(2.0, 300, "viewpoint-1.1")
    story.seek()
    story.frame(2.5, 250)
    judged = story.end()
    assert (judged.outcome, judged.reason, judged.goals) == ("success", "", ((2.0, 0.0),))
    assert (judged.start, judged.end, judged.replans) == ((2.0, 0.0), (2.5, 0.0), 1)


@pytest.mark.parametrize(("x", "pixels"), [(3.5, 300), (2.0, 150)], ids=["too far off", "too little in view"])
def test_a_claim_that_the_truth_denies_is_a_wrong_match(x, pixels):
    story = Story()
    story.frame(2.0, 300, "viewpoint-1.1")
    story.seek()
    story.frame(x, pixels)
    judged = story.end()
    assert (judged.outcome, judged.reason, judged.claimed) == ("failure", "wrong match", True)


def test_a_failure_keeps_its_reason_even_where_the_target_is_in_view():
    story = Story()
    story.frame(2.0, 300, "viewpoint-1.1")
    story.seek()
    story.frame(2.0, 300)
    assert story.end("failure", "out of time").reason == "out of time"


def test_a_collision_is_never_a_success():
    story = Story()
    story.frame(2.0, 300, "viewpoint-1.1")
    story.seek()
    story.contacts = 1
    story.frame(2.0, 300)
    judged = story.end()
    assert (judged.outcome, judged.reason, judged.collisions) == ("failure", "collision", 1)


def test_what_no_viewpoint_ever_showed_is_void():
    story = Story()
    story.frame(2.0, 150, "viewpoint-1.1")
    story.frame(2.0, 300)
    story.seek()
    assert story.end("failure", "no match").outcome == "void"


def test_a_viewpoint_that_showed_it_elsewhere_is_no_goal():
    story = Story()
    story.frame(2.0, 300, "viewpoint-1.1")
    story.lamp = replace(story.lamp, box_min=np.full(3, 5.0), box_max=np.full(3, 6.0))
    story.seek()
    story.frame(2.0, 300)
    assert story.end().outcome == "void"


def judged(outcome="success", reason="", metres=4.0, collisions=0):
    return Judged("x", outcome, reason, True, collisions, metres, 9.0, 1, 0, 1, (0.0, 0.0), (1.0, 0.0), ())


def test_rows_by_hand():
    def episode(scene, told, shortest=2.0):
        return Episode(scene, "oracle", "dssm + dijkstra", 0, told, shortest)

    rows = navigation_rows(
        [
            episode("rs_int", judged()),
            episode("rs_int", judged(metres=1.0)),
            episode("rs_int", judged("failure", "blocked")),
            episode("rs_int", judged("void")),
            episode("generated:3", judged("failure", "collision", collisions=2)),
        ]
    )
    value = {(row["scene"], row["metric"]): (row["mean"], row["n"]) for row in rows}
    assert value["rs_int", "success"] == (pytest.approx(2 / 3), 3)
    assert value["rs_int", "spl"] == (pytest.approx((0.5 + 1.0) / 3), 3)
    assert value["rs_int", "failed:blocked"] == (pytest.approx(1 / 3), 3)
    assert value["rs_int", "void"] == (0.25, 4)
    assert value["generated", "collisions"] == (1.0, 1)
    assert value["all", "success"] == (0.5, 4)


def test_generated_homes_are_listed():
    assert scene_list(["rs_int", "generated"], 2) == ["rs_int", "generated:1", "generated:2"]


@pytest.fixture(scope="module")
def flat():
    return Home("rs_int", "embedded")


def test_cases_are_the_same_for_a_seed_and_can_be_solved(flat):
    case = make_case(flat, 3, 6, 1)
    again = make_case(flat, 3, 6, 1)
    assert (case.goals, case.obstacles) == (again.goals, again.obstacles)
    assert case.goals != make_case(flat, 4, 6, 0).goals
    assert len(case.goals) == 6
    assert case.obstacles
    there = flat.unchanged()
    assert "mug-2" not in there  # it disappears
    assert all(there & set(goal.targets) for goal in possible_goals(flat))
    assert not any(set(a.targets) & set(b.targets) for a, b in zip(case.goals, case.goals[1:], strict=False))
    scene = with_obstacles(flat.scene, case.obstacles, flat.library)
    placer = Placer(scene, flat.library)
    solids = [placer.place(one.piece, one.piece, {}).solid for one in case.obstacles]
    assert all(one.from_visit == SEEK_VISIT for one in case.obstacles)
    stops = [stop.at for stop in scene.tour]
    assert Occupancy(scene, [*flat.solids, *solids]).connected(stops, 0.2)


def test_an_obstacle_that_bears_the_name_is_an_answer(flat, monkeypatch):
    pool = [Goal("the box", ("box-1",)), Goal("something to carry books in", ("box-1",))]
    monkeypatch.setattr(navigation_cases, "possible_goals", lambda home: pool)
    monkeypatch.setattr(navigation_cases, "_THINGS", (("box", (0.4, 0.3, 0.4)),))
    case = next(case for case in (make_case(flat, seed, 2, 1) for seed in range(5)) if case.obstacles)
    targets = {goal.text: goal.targets for goal in case.goals}
    assert targets["the box"] == ("box-1", case.obstacles[0].piece.id)
    assert targets["something to carry books in"] == ("box-1",)


def test_shortest_way(flat):
    assert flat.shortest((2.85, 3.65), [(3.0, 2.2)]) == pytest.approx(1.46, abs=0.1)
    assert flat.shortest((2.85, 3.65), []) is None


ROOM = """
name: room
rooms:
  - {name: room, type: living room, x: [0, 5], y: [0, 3]}
furniture:
  - {id: sofa-1, category: sofa, wall: room.north, along: 1.2}
  - {id: table-1, category: table, at: [4.3, 1.5], size: [0.8, 1.0, 0.75]}
tour:
  - {name: a, at: [1.2, 1.0], views: [[90, 0]]}
  - {name: b, at: [2.6, 1.2], views: [[0, -25]]}
"""


def test_an_evaluation_is_driven_once(tmp_path):
    """A room with two stops: the survey and one goal."""
    (tmp_path / "room.yaml").write_text(ROOM)
    options = {"scenes": [str(tmp_path / "room.yaml")], "perception": "oracle", "episodes": 1, "obstacles": 0}
    sets = ["source.assets=embedded", "source.noise=none", "grounding.use=objects"]
    first = evaluate_navigation(tmp_path, sets=sets, **options)
    lines = []
    again = evaluate_navigation(tmp_path, sets=sets, progress=lines.append, **options)
    assert again == first
    assert len(first) == len(lines) == 1
    assert first[0].judged.outcome == "success"
    assert first[0].shortest is not None
