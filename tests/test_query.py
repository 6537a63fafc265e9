"""`dssmsg query`: a sentence grounded in a recorded graph."""

from __future__ import annotations

import re

import pytest
from project import project

from dssmsg.events import Candidate
from dssmsg.recording.reader import Recording
from dssmsg.review.query import query_text


def query(tmp_path, run, *arguments):
    return project(tmp_path).run("query", str(run.recording), *arguments)


def test_it_ranks_viewpoints_and_tells_every_term(tmp_path, oracle_run):
    done = query(tmp_path, oracle_run, "the mirror above the washbasin", "--json")
    assert done.code == 0, done.err
    best = done.json["candidates"][0]
    assert {"s_node", "s_top", "s_graph", "score", "s_relation"} <= set(best["scores"])
    assert best["scores"]["s_graph"] == pytest.approx(best["scores"]["s_node"] + best["scores"]["s_top"])
    with Recording.open(oracle_run.recording) as recording:
        graph = recording.graph_at()
    labels = {row: graph.objects[name].label for row, name in best["matching"].items()}
    assert labels[str(done.json["target"]["core"])] == "mirror"
    assert best["waypoint"] == graph.viewpoints[best["viewpoint"]].waypoint_id
    assert [one["rank"] for one in done.json["candidates"]] == list(
        range(1, len(done.json["candidates"]) + 1)
    )


def test_the_same_words_at_an_earlier_time_know_less(tmp_path, oracle_run):
    early = query(tmp_path, oracle_run, "the bathtub", "--at", "frame=20", "--json").json
    late = query(tmp_path, oracle_run, "the bathtub", "--json").json
    assert early["frame"] == 20
    assert len(early["candidates"]) < len(late["candidates"])


def test_for_a_reader_it_prints_scores_and_reasons(tmp_path, oracle_run):
    done = query(tmp_path, oracle_run, "the mirror above the washbasin", "--top", "2")
    assert done.code == 0, done.err
    assert "looking for mirror" in done.out
    assert "s_graph  s_node  s_top" in done.out
    assert "washbasin: washbasin (object-" in done.out
    assert "more" in done.out.splitlines()[-1]


def test_a_sentence_that_is_not_understood_is_bad_input(tmp_path, oracle_run):
    done = query(tmp_path, oracle_run, "\N{DUCK}" + "x" * 5000, "--json")
    assert done.code == 2
    assert (done.json["error"]["kind"], done.json["error"]["key"]) == ("input", "TEXT")
    assert re.search(r"^error: TEXT: no (known )?object, purpose or room in '.{,90}\(English only", done.err)
    assert "plug-in" not in done.err


def test_explain_takes_such_a_sentence_as_query_does(tmp_path, oracle_run):
    done = project(tmp_path).run("explain", str(oracle_run.recording), "--query", "xyzzy", "--json")
    assert done.code == 2
    assert (done.json["error"]["kind"], done.json["error"]["key"]) == ("input", "--query")


def test_a_language_model_that_fails_is_not_the_fault_of_the_sentence(tmp_path, oracle_run):
    fails = "llm={use: scripted, answers: {target_graph: [prose]}}"
    done = query(tmp_path, oracle_run, "the bathtub", "--set", fails, "--json")
    assert (done.code, done.json["error"]["kind"]) == (1, "plugin")
    assert "plug-in llm/scripted" in done.err


@pytest.mark.parametrize("words", [["run.rrd"], ["missing/run.rrd"], ["run.rrd", ""], [" "]])
def test_a_forgotten_sentence_is_said_before_anything_is_read(tmp_path, words):
    done = project(tmp_path, {"run.rrd": "no recording"}).run("query", *words)
    assert done.code == 2
    assert "expected a sentence, got" in done.err


def test_more_than_a_recording_and_a_sentence_is_refused(tmp_path, oracle_run):
    done = query(tmp_path, oracle_run, "the", "bathtub")
    assert done.code == 2
    assert "quotes" in done.err


def test_nothing_that_matches_is_said():
    answer = {
        "query": "a", "target": {"kind": "explicit", "core": 0, "edges": [],
                                 "nodes": [{"label": "bed", "attributes": ["red"]}]},
        "candidates": [],
    }  # fmt: skip
    assert query_text(answer, 5).splitlines() == [
        "a: explicit, looking for red bed",
        "nothing in the map matches",
    ]
    one = Candidate("viewpoint-1.1", 1, {"score": 1.0}, {})
    row = {
        "rank": 1,
        "viewpoint": one.viewpoint_id,
        "waypoint": "waypoint-1",
        "scores": one.scores,
        "reason": "r",
    }
    assert query_text({**answer, "candidates": [row]}, 5).splitlines()[1:] == [
        "   viewpoint      waypoint    score", "1  viewpoint-1.1  waypoint-1  1.000", "   r",
    ]  # fmt: skip


def test_a_reader_is_told_each_waypoint_once():
    def row(rank, viewpoint, waypoint):
        return {
            "rank": rank, "viewpoint": viewpoint, "waypoint": waypoint, "scores": {"score": 1.0 / rank},
            "matching": {}, "reason": f"reason {rank}",
        }  # fmt: skip

    answer = {
        "query": "a", "target": {"kind": "explicit", "core": 0, "edges": [],
                                 "nodes": [{"label": "bed", "attributes": []}]},
        "candidates": [row(1, "viewpoint-1.1", "waypoint-1"), row(2, "viewpoint-1.2", "waypoint-1"),
                       row(3, "viewpoint-2.1", "waypoint-2"), row(4, "viewpoint-3.1", "waypoint-3")],
    }  # fmt: skip
    lines = query_text(answer, 2).splitlines()
    assert [line.split()[:2] for line in lines if line[:1].isdigit()] == [
        ["1", "viewpoint-1.1"], ["3", "viewpoint-2.1"],
    ]  # fmt: skip
    assert lines[-1] == "... and 1 more waypoints; --json tells every viewpoint"
