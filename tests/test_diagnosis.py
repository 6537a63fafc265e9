"""Diagnosis as a whole: verdicts, rules from the configuration, and missions with a fault put into them."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from box_house import mission
from episode_story import LAST, SURVEY, Story
from project import project

from dssmsg.checks import CheckFailed, check_findings
from dssmsg.config import load_config
from dssmsg.errors import InputError
from dssmsg.evaluate.diagnosis import HEALTHY, Explained, confusion, diagnosis_rows
from dssmsg.evaluate.diagnosis_cases import chosen_seeds, fault_of
from dssmsg.evaluate.diagnosis_rules import build_rules
from dssmsg.evaluate.faults.kinds import FAULTS
from dssmsg.host import Host
from dssmsg.interfaces import Finding
from dssmsg.interfaces.diagnosis import BLAME, LAYERS, Decision
from dssmsg.review.diagnosis import (
    CANNOT_TELL,
    FAULT,
    NO_FAULT,
    NOT_BEGUN,
    diagnose,
    diagnosed_json,
    diagnosed_text,
)
from dssmsg.review.episode import ReviewedRecording, same_thing
from dssmsg.review.episode_map import MapHistory
from dssmsg.review.explain_query import explain_match, query_explained_json, query_explained_text

MINE = """
from dssmsg.hookspecs import PluginConfig, hookimpl
from dssmsg.interfaces.diagnosis import Finding
from dssmsg.review.episode_rule import EpisodeRule

class Config(PluginConfig):
    layer: str = "control"

class Mine(EpisodeRule[Config]):
    def findings(self, case):
        yield Finding(self.config.layer, case.last, 0.99, f"a stranger's rule on {case.goal}")

@hookimpl
def register_diagnosis(register):
    register("mine", Mine, config=Config)
"""


class Says:
    """A rule that says what it was told to."""

    def __init__(self, *findings):
        self.findings = findings

    def diagnose(self, recording, episode):
        return self.findings


class Fails:
    def diagnose(self, recording, episode):
        raise RuntimeError("no idea")


def failed():
    return Story().spoilt()


def finding(layer="detector", confidence=0.9, frame=15, **more):
    return Finding(layer, frame, confidence, f"{layer} it was", **more)


@pytest.fixture(scope="module")
def missions(tmp_path_factory):
    """Missions in the home of boxes: healthy, and with another target graph than the goal's."""
    folder = tmp_path_factory.mktemp("missions")
    found = {}
    for fault in (None, "wrong target graph"):
        path, judged = mission(folder / str(fault), "the sofa", fault)
        assert (judged.outcome == "success") == (fault is None)
        found[fault] = path
    return found


@pytest.fixture(scope="module")
def rules():
    config = load_config(None)
    return build_rules(config, Host.load(config.plugins, config.base_dir))


# Verdicts.


def test_the_surest_finding_names_the_layer():
    told = diagnose(failed(), 0, [("a", Says(finding("control", 0.6))), ("b", Says(finding("update", 0.7)))])
    assert (told.verdict, told.layer, told.frame) == (FAULT, "update", 15)
    assert [one.rule for one in told.findings] == ["b", "a"]


def test_of_equally_sure_ones_the_earlier_rule_counts():
    both = [("a", Says(finding("control"))), ("b", Says(finding("update")))]
    assert diagnose(failed(), 0, both).layer == "control"
    assert diagnose(failed(), 0, both[::-1]).layer == "update"


def test_cannot_tell_is_an_answer():
    told = diagnose(failed(), 0, [("a", Says(finding(confidence=0.4)))])
    assert (told.verdict, told.layer) == (CANNOT_TELL, "")
    assert "cannot tell" in diagnosed_text("a.rrd", told)


def test_an_episode_that_ended_well_is_doubted_only_by_the_very_sure():
    assert diagnose(Story(), 0, [("a", Says(finding(confidence=0.7)))]).verdict == NO_FAULT
    assert diagnose(Story(), 0, [("a", Says(finding(confidence=0.9)))]).verdict == FAULT
    assert diagnose(Story().with_truth(), 0, [("a", Says(finding(confidence=0.9)))]).verdict == NO_FAULT


@pytest.mark.parametrize(
    ("parent", "used_up", "key", "why"),
    [
        (None, True, "mission.max_frames", "where mission.max_frames (30) was used up; raise it"),
        (None, False, None, "where the source gave no more frames"),
        ("before", True, None, "where the recorded run that it replays did"),
    ],
)
def test_an_episode_that_never_began_says_how_the_run_ended(parent, used_up, key, why):
    class Cut(Story):
        facts = property(lambda self: {"parent": parent})
        stored_summary = property(lambda self: {"out_of_frames": used_up})

    story = Cut().spoilt(reason="not begun")
    story.options = {"mission": {"max_frames": 30}}
    told = diagnose(story, 0, [("a", Fails()), ("b", Says(finding()))])
    text, as_json = diagnosed_text("a.rrd", told), diagnosed_json("a.rrd", told)
    assert f"never begun: the run ended at frame {LAST}, {why}" in text
    assert "cannot tell" not in text
    assert (as_json["verdict"], as_json["layer"], as_json["key"]) == (NOT_BEGUN, None, key)
    assert why in as_json["note"]
    assert as_json["findings"] == as_json["problems"] == []


def test_what_touched_something_went_wrong():
    story = Story().with_truth()
    story.collisions = lambda index: int(index >= 20)
    told = diagnose(story, 0, [("a", Says(finding(confidence=0.7)))])
    assert (told.verdict, told.note) == (FAULT, "the robot touched something at frame 20")


def test_a_rule_that_fails_does_no_harm():
    told = diagnose(failed(), 0, [("a", Fails()), ("b", Says(finding()))])
    assert told.layer == "detector"
    assert told.problems == ("rule a failed: RuntimeError: no idea",)
    assert "no idea" in diagnosed_text("a.rrd", told)


def test_a_layer_that_there_is_not_is_the_rules_mistake():
    with pytest.raises(CheckFailed, match="expected a layer of detector"):
        check_findings([finding("perception")])
    assert "expected a layer" in diagnose(failed(), 0, [("a", Says(finding("perception")))]).problems[0]


def test_the_page_tells_frame_chain_margin_and_command():
    lead = finding(
        frame=SURVEY, focus="object-1", decision=Decision("share", 0.2, 0.5), events=("frame 12: so",)
    )
    told = diagnose(failed(), 0, [("a", Says(lead))])
    page = diagnosed_text("a.rrd", told)
    for part in (
        "guilty layer: detector",
        "frame 12 (2.4 s)",
        "margin -0.3",
        "the episode failed: wrong match",
    ):
        assert part in page
    assert page.endswith("look at it: dssmsg view a.rrd --at frame=12 --focus object-1")
    assert told.chain[0] == "frame 12: so"
    assert told.chain[-1].startswith(f"frame {LAST}: ")
    answer = json.loads(json.dumps(diagnosed_json("a.rrd", told)))
    assert (answer["layer"], answer["frame"], answer["basis"]) == ("detector", 12, "recording")
    assert answer["decision"]["margin"] == pytest.approx(-0.3)


def test_content_with_something_else_is_a_failure():
    story = Story()
    story.drive[-1] |= {"detail": "object-2 (bed) from viewpoint-1.1"}
    told = diagnose(story, 0, [])
    assert (told.mistaken, told.verdict) == (True, CANNOT_TELL)


def test_an_unknown_episode_is_named_with_those_there_are():
    with pytest.raises(InputError, match=r"no episode 3 in the recording; its episodes: 0$"):
        diagnose(Story(), 3, [])


def test_names_are_compared_by_words():
    assert same_thing("double bed", ["bed"])
    assert same_thing("chairs", ["chair"])
    assert not same_thing("bedside table", ["bed"])


def test_blame_and_layers_agree():
    assert set(BLAME.values()) <= set(LAYERS)


def test_the_history_of_the_map_follows_joins():
    story = Story()
    join = {
        "kind": "objects_joined",
        "frame": 9,
        "object_id": "object-2",
        "absorbed_id": "object-1",
        "cause": {"plugin": "p", "rule": "join"},
        "scores": [],
        "after": {"status": "believed"},
    }
    history = MapHistory.of([*story.rows, join])
    assert history.last("object-1") is history.objects["object-2"]
    assert not history.objects["object-1"].is_there(9)
    assert history.objects["object-1"].is_there(8)
    assert history.connected("waypoint-1", "waypoint-2", 9)
    assert not history.connected("waypoint-1", "waypoint-2", 6)


# The command.


def test_explain_names_the_layer_of_a_recorded_mission(missions, tmp_path):
    done = project(tmp_path).run("explain", str(missions["wrong target graph"]), "--episode", "0", "--json")
    assert done.code == 0, done.err
    told = done.json
    assert (told["verdict"], told["layer"], told["goal"]) == ("fault", "grounding", "the sofa")
    assert told["with_truth"]
    assert told["view"].startswith(f"dssmsg view {missions['wrong target graph']} --at frame=")
    assert {one["rule"] for one in told["findings"]} >= {"language"}


def test_explain_without_truth_reasons_from_what_does_not_fit(missions, tmp_path):
    done = project(tmp_path).run(
        "explain", str(missions["wrong target graph"]), "--episode", "0", "--no-truth", "--json"
    )
    assert (done.json["layer"], done.json["basis"], done.json["with_truth"]) == (
        "grounding",
        "recording",
        False,
    )


@pytest.mark.parametrize("more", [[], ["--no-truth"]])
def test_a_healthy_mission_has_no_fault(missions, tmp_path, more):
    done = project(tmp_path).run("explain", str(missions[None]), "--episode", "0", *more)
    assert done.code == 0
    assert "no fault was found" in done.out


def test_a_strangers_rule_in_a_folder(missions, tmp_path):
    folder = project(tmp_path, {"rules/mine.py": MINE, "dssmsg.yaml": "plugins: [rules]\n"})
    told = folder.run("explain", str(missions["wrong target graph"]), "--episode", "0", "--json").json
    assert told["findings"][0]["rule"] == "mine"
    assert told["layer"] == "control"


def test_a_strangers_rule_has_options(missions, tmp_path):
    files = {
        "rules/mine.py": MINE,
        "dssmsg.yaml": "plugins: [rules]\ndiagnosis: [{use: mine, layer: update}]\n",
    }
    told = project(tmp_path, files).run(
        "explain", str(missions["wrong target graph"]), "--episode", "0", "--json"
    )
    assert [(one["rule"], one["layer"]) for one in told.json["findings"]] == [("mine", "update")]


def test_rules_can_be_chosen(missions, tmp_path):
    files = {
        "rules/mine.py": MINE,
        "dssmsg.yaml": "plugins: [rules]\ndiagnosis: [{use: language, reread: false}]\n",
    }
    told = project(tmp_path, files).run(
        "explain", str(missions["wrong target graph"]), "--episode", "0", "--json"
    )
    assert {one["rule"] for one in told.json["findings"]} == {"language"}


def test_what_a_recording_says_of_rules_is_never_looked_at(missions, tmp_path):
    """The recording's configuration names plug-in files of its own: box_house.py. None of them is loaded."""
    with ReviewedRecording.open(missions[None]) as recording:
        assert recording.config["plugins"]
    script = (
        "import sys; from dssmsg.cli import main; code = main(sys.argv[1:]);"
        "assert not [name for name in sys.modules if 'box_house' in name]; sys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, "explain", str(missions[None]), "--episode", "0"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr


def test_explain_needs_no_simulator_or_model(missions, tmp_path):
    script = (
        "import sys\n"
        "for name in ('pybullet', 'open3d', 'onnxruntime'): sys.modules[name] = None\n"
        "from dssmsg.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, "explain", str(missions["wrong target graph"]), "--episode", "0"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert "guilty layer: grounding" in done.stdout


def test_one_thing_is_explained_at_a_time(missions, tmp_path):
    for more in ([], ["--episode", "0", "--query", "the sofa"]):
        done = project(tmp_path).run("explain", str(missions[None]), *more)
        assert done.code == 2
        assert "say one thing to explain" in done.err


def test_a_query_is_explained_as_it_was_recorded(missions, tmp_path):
    told = project(tmp_path).run("explain", str(missions[None]), "--query", "the sofa", "--json").json
    assert told["recorded"]
    other = next(
        one for one in told["comparisons"] if one["candidate"]["matching"] != told["winner"]["matching"]
    )
    assert other["margin"] == pytest.approx(sum(term["gap"] for term in other["terms"]))
    assert other["margin"] > 0


def candidate(rank, viewpoint, thing="object-1", **scores):
    return {
        "viewpoint": viewpoint,
        "rank": rank,
        "matching": {"0": thing},
        "reason": thing,
        "scores": {"score": 2.0, "similarity": 1.0, "core_distance": 0.5, **scores},
    }


def compared(*candidates):
    target = {"core": 0, "kind": "explicit", "edges": [], "nodes": [{"label": "sofa", "attributes": []}]}
    match = {"query": "the sofa", "frame": 9, "target": target, "candidates": candidates}
    told = explain_match(match, {"use": "dssm"}, recorded=True)
    return told.comparisons, query_explained_text("a.rrd", told), query_explained_json("a.rrd", told)


def test_the_runner_up_is_another_place():
    first, view, other = (
        candidate(1, "viewpoint-2.1"),
        candidate(2, "viewpoint-2.3"),
        candidate(3, "viewpoint-5.1"),
    )
    (one,), text, _ = compared(first, view, other)
    assert one.other is other
    assert "runner-up: viewpoint-5.1, rank 3" in text
    (one,), _, _ = compared(first, view)
    assert one.other is view


def test_another_thing_is_one_that_was_taken_for_the_core():
    first, runner_up = candidate(1, "viewpoint-2.1"), candidate(2, "viewpoint-5.1")
    nothing = {**candidate(3, "viewpoint-6.1"), "matching": {"1": "object-7"}}
    rival = candidate(4, "viewpoint-7.1", "object-3")
    told, text, _ = compared(first, runner_up, nothing)
    assert [one.other for one in told] == [runner_up]
    assert "another thing" not in text
    told, text, _ = compared(first, runner_up, nothing, rival)
    assert [one.other for one in told] == [runner_up, rival]
    assert "best with another thing: viewpoint-7.1, rank 4" in text


@pytest.mark.parametrize(
    ("scores", "viewpoint", "tie", "words"),
    [
        (
            {"similarity": 0.99999},
            "viewpoint-5.1",
            "similarity",
            "similarity decided: 1.00000 against 0.99999",
        ),
        ({"similarity": 1 - 1e-8}, "viewpoint-5.1", "viewpoint id", "the smaller viewpoint id decided"),
        (
            {"core_distance": 0.5004},
            "viewpoint-5.1",
            "core_distance",
            "decided: 0.5000 against 0.5004 metres",
        ),
        ({}, "viewpoint-12.1", "viewpoint id", "the smaller viewpoint id decided"),
        ({}, "viewpoint-1.1", "unknown", "what decided is not recorded"),
        ({}, "nowhere", "unknown", "what decided is not recorded"),
        ({"similarity": 1.5}, "viewpoint-5.1", "unknown", "what decided is not recorded"),
    ],
)
def test_a_tie_names_its_decider(scores, viewpoint, tie, words):
    _, text, as_json = compared(candidate(1, "viewpoint-2.1"), candidate(2, viewpoint, **scores))
    assert "equal scores; " in text
    assert words in text
    assert as_json["comparisons"][0]["tie"] == tie


# The evaluation.


def test_every_layer_has_its_faults_in_both_halves():
    for half in ("development", "reported"):
        seeds = chosen_seeds(60, half)
        assert {seed % 2 for seed in seeds} == {int(half == "reported")}
        assert {fault_of(seed).layer for seed in seeds} == set(LAYERS)
        assert {fault_of(seed).name for seed in seeds} == {fault.name for fault in FAULTS}


def test_rows_count_right_wrong_and_neither():
    def said(seed, true, what, truth):
        return Explained(seed, "x", true, truth, what, 0.9, "r", 0)

    told = [
        said(1, "update", "update", True),
        said(3, "update", "planner", True),
        said(5, "control", CANNOT_TELL, True),
        said(1, HEALTHY, NO_FAULT, True),
        said(0, "update", "planner", True),
    ]
    rows = {(row["scene"], row["metric"]): row for row in diagnosis_rows(told)}
    assert rows["reported", "layer_accuracy_with_truth"]["mean"] == pytest.approx(1 / 3)
    assert rows["reported", "wrong_with_truth"]["mean"] == pytest.approx(1 / 3)
    assert rows["reported", "cannot_tell_with_truth"]["mean"] == pytest.approx(1 / 3)
    assert rows["reported", "healthy_silent_with_truth"]["mean"] == 1.0
    assert rows["development", "wrong_with_truth"]["n"] == 1
    assert ("reported", "layer_accuracy_without_truth") not in rows
    assert confusion(told, with_truth=True)["update"] == {"update": 1, "planner": 2}


def test_a_fault_is_not_to_be_seen_in_what_is_recorded(missions):
    """The same run but for the fault: configuration, plug-ins and facts of both recordings agree."""
    facts = []
    for path in missions.values():
        with ReviewedRecording.open(path) as recording:
            told = json.loads(json.dumps(recording.facts))
        told.pop("run_id")
        told["config"]["recording"].pop("directory")
        facts.append(told)
    assert facts[0] == facts[1]
