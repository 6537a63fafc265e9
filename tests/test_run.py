"""Whole runs of the real simulator: what lands in the recording is what happened, and it happens again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from conftest import real_run

from dssmsg.evaluate.recorded import are_connected, score_recording
from dssmsg.graph.compare import first_difference
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.recording.reader import Recording

BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"


def test_the_summary_is_the_json_contract(oracle_run):
    wanted = {
        "recording",
        "seed",
        "frames",
        "objects",
        "waypoints",
        "changes",
        "episodes",
        "errors",
        "seconds",
    }
    assert wanted <= set(oracle_run.summary)
    assert oracle_run.summary["frames"] == 150
    assert oracle_run.summary["collisions"] == 0
    assert sum(oracle_run.summary["changes"].values()) > 100


def test_folding_gives_the_same_graph_by_every_way(oracle_run):
    """Folded in one go, or read at the last frame, or half way and then on."""
    with Recording.open(oracle_run.recording) as recording:
        changes = list(recording.changes())
        whole = SceneGraph.fold(changes)
        assert first_difference(whole, recording.graph_at()) is None
        middle = changes[len(changes) // 2].frame
        partly = recording.graph_at(middle)
        assert first_difference(partly, SceneGraph.fold(c for c in changes if c.frame <= middle)) is None
        for change in changes[partly.updates :]:
            partly.apply(change)
        assert first_difference(partly, whole) is None


def test_the_map_is_right(oracle_run):
    """150 frames see some furniture from one end only; the whole run is measured by `make verify`."""
    result = score_recording(oracle_run.recording)
    assert result.score.precision >= 0.85, result.score.wrong
    assert result.score.recall >= 0.85, result.score.missed
    assert result.score.median_centre_error_m <= 0.1
    assert result.stop_pairs > 0
    assert result.connected_stops == result.stop_pairs


def test_two_processes_write_the_same_log(oracle_run, tmp_path):
    again = real_run(tmp_path, "perception.use=oracle", "mission.max_frames=40")
    theirs, ours = (run.change_log.read_bytes().splitlines() for run in (oracle_run, again))
    # The shorter run ended its visit with its last frame, 39; up to that the two did the same.
    common = [line for line in ours if json.loads(line)["frame"] < 39]
    assert len(common) > 100
    assert theirs[: len(common)] == common


def test_another_seed_gives_another_log(oracle_run, tmp_path):
    """Or the test above could not fail."""
    other = real_run(tmp_path, "perception.use=oracle", "mission.max_frames=20", "seed=1")
    ours = other.change_log.read_bytes()
    assert not oracle_run.change_log.read_bytes().startswith(ours)


def test_without_truth_the_log_is_the_same(tmp_path):
    logs = []
    for name, sets in (
        ("with", []),
        ("without", [f"plugins=[{BENCHMARKS / 'truthless.py'}]", "source={use: truthless}"]),
    ):
        folder = tmp_path / name
        folder.mkdir()
        run = real_run(folder, "mission.max_frames=14", *sets)  # with the default perception
        assert run.summary["key_frames"] > 3
        logs.append(run.change_log.read_bytes())
    assert logs[0] == logs[1]
    assert logs[0]


def test_a_goal_that_was_never_tried_is_no_success(tmp_path):
    run = real_run(
        tmp_path,
        "perception.use=oracle",
        "mission={phases: [survey, seek], goals: [a quiet place]}",
        "mission.max_frames=4",
    )
    assert run.summary["out_of_frames"]
    assert run.summary["episodes"] == [{"goal": "a quiet place", "outcome": "failure", "reason": "not begun"}]


def test_the_log_holds_scores_and_thresholds(oracle_run):
    rows = [json.loads(line) for line in oracle_run.change_log.read_text().splitlines()]
    merges = [row for row in rows if row["kind"] == "object_merged"]
    assert merges
    for row in merges:
        terms = {name: (value, threshold) for name, value, threshold in row["scores"]}
        assert {"s_geo", "s_sem", "s"} <= set(terms)
        assert terms["s"][0] >= terms["s"][1] == pytest.approx(1.1)
        assert row["cause"]["plugin"] == "association/dssm"


@pytest.mark.parametrize("index", [0, 37, 149])
def test_frames_come_back_exactly(oracle_run, index):
    """Lossless images: what is read is a frame with a picture, depth and pose, and no truth on it."""
    with Recording.open(oracle_run.recording) as recording:
        frame = recording.frame(index)
        assert frame.index == index
        assert frame.rgb.std() > 5
        assert (frame.depth > 0).mean() > 0.5
        assert recording.truth(index) is not None
        assert frame.truth is None


def test_replaying_a_recording_gives_the_same_log(oracle_run, tmp_path):
    """Source `recording` with its recorded detections: the map is built again, change for change."""
    replayed = real_run(
        tmp_path,
        f"source={{use: recording, recording: {oracle_run.recording}}}",
        f"perception={{use: recorded, recording: {oracle_run.recording}}}",
    )
    assert replayed.summary["frames"] == 150
    assert replayed.change_log.read_bytes() == oracle_run.change_log.read_bytes()


def test_connectedness_can_fail():
    import numpy as np

    from dssmsg.graph.changes import Cause, WaypointAdded

    graph = SceneGraph()
    places = np.array([[0.0, 0, 0], [5.0, 0, 0]])
    for number, position in enumerate(places, 1):
        graph.apply(
            WaypointAdded(cause=Cause("test", "t"), waypoint_id=f"waypoint-{number}", position=position)
        )
    assert not are_connected(graph, places[0], places[1])
    assert are_connected(graph, places[0], places[0])
