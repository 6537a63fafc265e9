"""What was told comes back: frames, detections, truth, changes, and the graph at any time."""

from __future__ import annotations

import gzip
import json
import math
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from project import project
from recorded_run import SyntheticRun, record

from dssmsg import events as ev
from dssmsg.errors import InputError
from dssmsg.graph import codec
from dssmsg.graph.compare import same
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.recording import blob_column, migrations, rows, schema, snapshots
from dssmsg.recording.chunk_index import ChunkIndex, Place
from dssmsg.recording.damage import json_value
from dssmsg.recording.newest import newest
from dssmsg.recording.reader import Recording
from dssmsg.recording.writer import RecordingWriter
from dssmsg.review.summary import summarize
from dssmsg.review.text import summary_text

FRAMES = 40


@pytest.fixture(scope="module")
def run() -> SyntheticRun:
    return SyntheticRun(FRAMES)


@pytest.fixture(scope="module")
def told(run: SyntheticRun) -> list[ev.Event]:
    return list(run.events())


@pytest.fixture(scope="module")
def path(run: SyntheticRun, told: list[ev.Event], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("reader") / "run.rrd"
    writer = RecordingWriter(path, run.run_id, images="lossless")
    for number, event in enumerate(told):
        writer.write(event)
        if number % 37 == 0:
            writer.flush()
    writer.close()
    return path


@pytest.fixture(scope="module")
def recording(path: Path) -> Recording:
    return Recording.open(path)


def test_run_facts(recording: Recording, run: SyntheticRun) -> None:
    assert recording.complete
    assert recording.seed == 0
    assert recording.facts["run_id"] == run.run_id
    assert recording.config["source"] == {"use": "synthetic"}
    assert recording.facts["source"]["credits"] == ["furniture: nobody"]
    assert recording.stored_summary == {"seed": 0, "frames": FRAMES, "errors": 0}


def test_frames_are_exact(recording: Recording, told: list[ev.Event]) -> None:
    captured = [event for event in told if isinstance(event, ev.FrameCaptured)]
    back = list(recording.frames())
    assert len(back) == len(captured) == FRAMES
    for event, frame in zip(captured, back, strict=True):
        want = event.frame
        assert np.array_equal(frame.rgb, want.rgb)
        assert np.array_equal(frame.depth, want.depth)
        assert np.array_equal(frame.world_from_camera, want.world_from_camera)
        assert np.array_equal(frame.world_from_base, want.world_from_base)
        assert frame.sim_time == want.sim_time
        assert (frame.index, frame.visit, frame.at_stop) == (want.index, want.visit, want.at_stop)
        assert frame.camera == want.camera
        assert frame.truth is None
        assert recording.command(frame.index) == event.command
        assert recording.collisions(frame.index) == event.collisions
        assert recording.viewpoint(frame.index) == event.viewpoint_id
    assert list(recording.key_frames) == [event.frame.index for event in captured if event.key_frame]


def test_detections_are_exact(recording: Recording, told: list[ev.Event]) -> None:
    detected = [event for event in told if isinstance(event, ev.Detected)]
    assert sum(len(event.detections) for event in detected) > 20
    for event in detected:
        back = recording.detections(event.frame)
        assert back is not None
        assert len(back) == len(event.detections)
        for got, want in zip(back, event.detections, strict=True):
            assert np.array_equal(got.mask, want.mask)
            assert np.array_equal(got.box_xyxy, want.box_xyxy)
            assert (got.label, got.score, got.label_scores) == (want.label, want.score, want.label_scores)
            for name in ("text_feature", "image_feature"):
                ours, theirs = getattr(got, name), getattr(want, name)
                assert (ours is None) == (theirs is None)
                assert ours is None or np.array_equal(ours, theirs)
    assert recording.detections(1) is None  # not a key frame


def test_truth_is_exact_and_changes_over_time(recording: Recording, told: list[ev.Event]) -> None:
    for event in told:
        if isinstance(event, ev.TruthSeen):
            truth = recording.truth(event.frame)
            assert truth is not None
            assert np.array_equal(truth.instance_ids, event.truth.instance_ids)
            assert rows.truth_objects_json(truth.objects) == rows.truth_objects_json(event.truth.objects)
    early, late = recording.truth(0), recording.truth(FRAMES - 1)
    assert early is not None
    assert late is not None
    assert (early.objects[0].state, late.objects[0].state) == ("static", "appeared")
    assert recording.frame(3, with_truth=True).truth is not None


def test_changes_are_told_again_word_for_word(recording: Recording, run: SyntheticRun) -> None:
    want = [codec.canonical_json(codec.encode(change)[0]) for change in run.told]
    assert [codec.canonical_json(codec.encode(change)[0]) for change in recording.changes()] == want
    assert [codec.canonical_json(row) for row in recording.change_rows()] == want
    assert sum(recording.change_counts().values()) == len(want)


def test_folding_gives_the_live_graph_at_every_key_frame(recording: Recording, run: SyntheticRun) -> None:
    assert same(recording.graph_at(), run.live)
    live = SceneGraph()
    pending = list(run.told)
    for frame in recording.key_frames:
        while pending and pending[0].frame <= frame:
            live.apply(pending.pop(0))
        assert same(recording.graph_at(frame), live)
        assert same(recording.graph_at(frame + 1), live)
    middle = len(run.told) // 2
    assert same(recording.graph_at(update=middle), SceneGraph.fold(run.told[:middle]))
    assert not same(recording.graph_at(update=middle), run.live)


def test_everything_else_comes_back(recording: Recording) -> None:
    assert [phase["phase"] for phase in recording.phases()] == ["survey", "revisit"]
    assert recording.errors() == [
        {
            "frame": 4,
            "sim_time": 0.8,
            "plugin": "perception/synthetic",
            "message": "NaN in a box",
            "skipped": "1 detection",
            "fatal": False,
        }
    ]
    assert [step["state"] for step in recording.navigation()] == ["drive", "look", "turn"]
    assert recording.timings()[3] == {"source": 0.02, "perception": 0.01}
    assert len(recording.logs()) == FRAMES
    assert recording.frame_at_time(1.0) == 5
    assert recording.frame_of_update(1) == 0


def test_seldom_events_come_back(tmp_path: Path) -> None:
    run = SyntheticRun(1)
    writer = RecordingWriter(tmp_path / "r.rrd", "r")
    writer.write(run.started())
    evidence = ev.Evidence(7, "object-1", "missed", {"behind_m": 0.4})
    writer.write(
        ev.WindowEvaluated(
            "viewpoint-1.1", 9, 1.8, (7, 8), (1, 2), (evidence,), {"object-1": "disappeared"}, 3
        )
    )
    best = ev.Candidate("viewpoint-1.1", 1, {"s_graph": 1.9, "s_node": 1.0}, {"sink": "object-1"}, "a sink")
    writer.write(ev.Matched("wash up", 9, 1.8, {"nodes": [{"label": "sink"}]}, (best,)))
    writer.write(ev.Matched("fly", 9, 1.8, {"nodes": []}, ()))
    writer.write(
        ev.LlmCalled("target_graph", "lexicon", 9, 1.8, "wash up", "{}", "abc", False, "slow", None, 0.1)
    )
    writer.write(ev.EpisodeEnded(0, "wash up", "no_path", "blocked", 9, 1.8, {"spl": 0.0}))
    writer.close()
    recording = Recording.open(tmp_path / "r.rrd")
    assert recording.windows(["object-10", "viewpoint-1"]) == []
    assert recording.windows(["object-1"]) == recording.windows()
    assert recording.windows([]) == []
    (window,) = recording.windows()
    assert window["evidence"] == [
        {"frame": 7, "object": "object-1", "verdict": "missed", "values": {"behind_m": 0.4}}
    ]
    assert window["verdicts"] == {"object-1": "disappeared"}
    first, second = recording.matches()
    assert first["candidates"][0]["scores"] == {"s_graph": 1.9, "s_node": 1.0}
    assert second["candidates"] == []
    (call,) = recording.llm_calls()
    assert (call["role"], call["ok"], call["error"], call["tokens"]) == ("target_graph", False, "slow", None)
    (episode,) = recording.episodes()
    assert (episode["outcome"], episode["reason"]) == ("no_path", "blocked")


def test_what_python_wrote_as_json_is_read() -> None:
    for value in ({"label": "\ud800"}, [1e-300, "\N{DUCK}", None]):
        assert json_value(json.dumps(value)) == value
    for text in ("{", "", "[" * 5000):
        with pytest.raises((ValueError, RecursionError)):
            json_value(text)


def test_floor_poses_are_those_of_the_base(recording: Recording) -> None:
    for index in recording.frame_indices:
        _, base = recording.poses(index)
        heading = math.atan2(base[1, 0], base[0, 0])
        assert recording.floor_pose(index) == pytest.approx((base[0, 3], base[1, 3], heading))
    with pytest.raises(InputError, match=f"no frame {FRAMES}"):
        recording.floor_pose(FRAMES)


def test_summary_counts_what_the_run_was(recording: Recording, run: SyntheticRun) -> None:
    summary = summarize(recording)
    believed = [node for node in run.live.objects.values() if node.status == "believed"]
    assert summary["objects"] == len(believed) > 0
    assert summary["waypoints"] == len(run.live.waypoints)
    assert summary["frames"] == FRAMES
    assert summary["errors"] == 0  # the run's own words come first
    assert summary["complete"] is True
    assert summary["schema_version"] == schema.SCHEMA_VERSION
    assert json.loads(json.dumps(summary)) == summary
    text = summary_text(summary, recording.errors())
    assert "NaN in a box" in text
    assert "object_added" in text


def test_a_missing_frame_is_said_with_the_range(recording: Recording) -> None:
    with pytest.raises(InputError, match="no frame 999; its frames are 0 to 39"):
        recording.frame(999)
    with pytest.raises(InputError, match="not both"):
        recording.graph_at(1, update=2)
    with pytest.raises(InputError, match="no frame at or before"):
        recording.frame_at_time(-1.0)


def test_reading_needs_no_simulator(path: Path) -> None:
    code = f"""
import sys
for name in ("pybullet", "open3d", "onnxruntime"):
    sys.modules[name] = None
from dssmsg.recording.reader import Recording
from dssmsg.review.summary import summarize
with Recording.open({str(path)!r}) as recording:
    assert len(list(recording.frames())) == {FRAMES}
    assert summarize(recording)["objects"] > 0
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_newest_is_by_time_and_says_when_there_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="dssmsg run"):
        newest(tmp_path)
    with pytest.raises(InputError, match="dssmsg run"):
        newest(tmp_path / "missing")
    for age, name in enumerate(("b.rrd", "a.rrd", "c.rrd")):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (1000 - age, 1000 - age))
    (tmp_path / ".hidden.rrd").touch()
    (tmp_path / "later.txt").touch()
    assert newest(tmp_path).name == "b.rrd"


def test_a_comparison_is_never_the_newest_recording(path: Path, tmp_path: Path) -> None:
    place = project(tmp_path, {"recordings/run.rrd": path.read_bytes()})
    os.utime(tmp_path / "recordings/run.rrd", (1000, 1000))
    run, both = "recordings/run.rrd", "recordings/both.rrd"
    assert place.run("diff", run, run, "--recording", both).code == 0
    done = place.run("inspect")
    assert done.code == 0, done.err
    assert f"reading {run}" in done.err.splitlines()
    named = place.run("inspect", both)
    assert (named.code, named.out) == (2, "")
    assert f"{both}: two runs side by side, made by `dssmsg diff --recording`" in named.err
    (tmp_path / run).unlink()
    assert "recordings: holds no recording of a run" in place.run("inspect").err


def test_another_schema_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schema, "SCHEMA_VERSION", 99)
    path = record(SyntheticRun(2), tmp_path / "new.rrd")
    monkeypatch.undo()
    with pytest.raises(
        InputError, match=r"schema version 99.*versions 1 to 2: read it with dssmsg 0 or a later"
    ):
        Recording.open(path)


@pytest.fixture(scope="module")
def version_1(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file that the first writers of version 1 wrote (seven frames, lossless), its looks left out."""
    path = tmp_path_factory.mktemp("old") / "version-1.rrd"
    path.write_bytes(gzip.decompress((Path(__file__).parent / "data" / "version-1.rrd.gz").read_bytes()))
    return path


def test_an_older_recording_reads_as_one_of_today(version_1: Path) -> None:
    before = version_1.read_bytes()
    with Recording.open(version_1) as recording:
        assert recording.schema_version == 1 < schema.SCHEMA_VERSION
        assert recording.complete
        (call,) = recording.told.llm_calls
        assert (call.prompt, call.attempt, call.fallback_for) == ("wash up", 1, "")
        assert recording.llm_calls()[0]["attempt"] == 1
        frames = [change.frame for change in recording.changes()]
        for facts in recording.frame_facts.values():
            assert facts.updates == sum(frame < facts.index for frame in frames)
        assert recording.frame_facts[6].updates == 16
        assert len(list(recording.frames())) == 7
        assert len(recording.graph_at().objects) == 4
        assert summarize(recording)["schema_version"] == 1
    assert version_1.read_bytes() == before


def test_every_version_before_the_present_one_has_a_step() -> None:
    assert [step.version for step in migrations.STEPS] == list(range(1, schema.SCHEMA_VERSION))


def test_events_come_back_as_they_were_told(recording: Recording, told: list[ev.Event]) -> None:
    def of(kind: type) -> list[Any]:
        return [event for event in told if isinstance(event, kind)]

    back = recording.told
    for kind, found in (
        (ev.PhaseStarted, back.phases),
        (ev.NavigationChanged, back.navigation),
        (ev.ErrorOccurred, back.errors),
        (ev.Logged, back.logs),
        (ev.StageTimed, back.timings),
    ):
        for one, want in zip(found, of(kind), strict=True):
            # Rerun's clock counts whole nanoseconds.
            assert asdict(one) == {**asdict(want), "sim_time": pytest.approx(want.sim_time, abs=1e-9)}
        assert found


def test_seldom_events_come_back_typed(tmp_path: Path) -> None:
    window = ev.WindowEvaluated(
        "viewpoint-1.1", 9, 1.8, (7, 8), (1, 2),
        (ev.Evidence(7, "object-1", "missed", {"behind_m": 0.4}),), {"object-1": "disappeared"}, 3,
    )  # fmt: skip
    best = ev.Candidate("viewpoint-1.1", 1, {"s_graph": 1.9}, {"0": "object-1"}, "a sink")
    told = [
        window,
        ev.Matched("wash up", 9, 1.8, {"nodes": [{"label": "sink"}]}, (best,)),
        ev.LlmCalled("target_graph", "x", 9, 1.8, "p", "{}", "abc", False, "slow", 12, 0.1, 2, "openai"),
        ev.EpisodeEnded(0, "wash up", "no_path", "blocked", 9, 1.8, {"spl": 0.0}),
    ]
    run = SyntheticRun(1)
    writer = RecordingWriter(tmp_path / "r.rrd", "r")
    for event in (run.started(), *told):
        writer.write(event)
    writer.close()
    with Recording.open(tmp_path / "r.rrd") as recording:
        back = recording.told
        found = [*back.windows, *back.matches, *back.llm_calls, *back.episodes]
        assert [asdict(one) for one in found] == [asdict(one) for one in told]
        assert len(list(back.windows_about(["object-1"]))) == 1
        assert not list(back.windows_about(["object-2"]))


def test_some_changes_are_all_changes_of_which_some_are_left_out(recording: Recording) -> None:
    every = list(recording.changes())
    ids = {"object-2", "viewpoint-1.1"}
    about = [change.update for change in recording.changes(about=ids)]
    assert about == [change.update for change in every if ids & set(change.subjects)]
    kinds = {"object_added", "edge_added"}
    some = [row["update"] for row in recording.change_rows(kinds=kinds, after=9)]
    assert some == [change.update for change in every if change.kind in kinds and change.update > 9]
    assert about
    assert some


def test_stored_graphs_are_what_folding_gives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snapshots, "EVERY_UPDATES", 20)
    run = SyntheticRun(40)
    path = record(run, tmp_path / "stored.rrd")
    used = []
    latest = snapshots.latest

    def watched(*args: Any, **names: Any) -> Any:
        used.append(latest(*args, **names))
        return used[-1]

    monkeypatch.setattr(snapshots, "latest", watched)
    with Recording.open(path) as recording:
        for frame in recording.key_frames:
            told = [change for change in run.told if change.frame <= frame]
            assert same(recording.graph_at(frame), SceneGraph.fold(told))
        for update in range(0, len(run.told) + 1, 13):
            assert same(recording.graph_at(update=update), SceneGraph.fold(run.told[:update]))
        assert same(recording.graph_at(), run.live)
    assert sum(found is not None for found in used) > len(used) / 2


def test_poses_and_label_vectors_need_no_images(recording: Recording, told: list[ev.Event]) -> None:
    event = next(one for one in told if isinstance(one, ev.FrameCaptured) and one.frame.index == 5)
    camera, base = recording.poses(5)
    assert np.array_equal(camera, event.frame.world_from_camera)
    assert np.array_equal(base, event.frame.world_from_base)
    known = {one.label: one.text_feature for e in told if isinstance(e, ev.Detected) for one in e.detections}
    vectors = recording.label_vectors()
    assert vectors.keys() == known.keys()
    assert all(np.array_equal(vectors[label], known[label]) for label in known)


def test_what_was_detected_is_known_without_masks(recording: Recording) -> None:
    named, hashes = recording.detected_names(), recording.detection_hashes()
    assert list(named) == list(recording.key_frames)
    assert named.keys() == hashes.keys()
    for index in named:
        detections = recording.detections(index) or ()
        assert list(named[index]) == [(one.label, one.score) for one in detections]
    first, later = list(hashes)[:2]
    assert hashes[first] != hashes[later]


def test_truth_is_decoded_when_it_is_looked_at(recording: Recording) -> None:
    lazy = recording.frame(7, with_truth=True, lazy=True)
    assert lazy.truth is not None
    whole = recording.truth(7)
    assert whole is not None
    stored = recording.encoded_truth(7)
    assert stored is not None
    assert stored[1] == whole.instance_ids.shape
    assert lazy.truth.objects == whole.objects
    assert np.array_equal(lazy.truth.instance_ids, whole.instance_ids)
    assert lazy.without_truth().truth is None


@pytest.mark.parametrize("indexed", [True, False])
def test_images_are_read_in_any_order_with_little_kept(
    path: Path, monkeypatch: pytest.MonkeyPatch, indexed: bool
) -> None:
    monkeypatch.setattr(blob_column, "KEPT_BYTES", 1)
    if not indexed:  # a version of Rerun that does not tell where its chunks are
        monkeypatch.setattr(ChunkIndex, "of", lambda path, store: None)
    with Recording.open(path) as few:
        wanted = {index: few.frame(index).depth.copy() for index in range(FRAMES)}
        for index in (39, 3, 20, 20, 4, 0, 38):
            assert np.array_equal(few.frame(index).depth, wanted[index])


def test_a_late_image_is_read_without_those_before_it(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []
    whole = ChunkIndex.read

    def watched(self: ChunkIndex, places: Any) -> Any:
        read.extend(place.number for place in places)
        return whole(self, places)

    monkeypatch.setattr(ChunkIndex, "read", watched)
    with Recording.open(path) as recording:
        recording.frame(FRAMES - 1, lazy=True)
        assert len(read) == 1
        recording.frame(FRAMES - 1)
        assert len(read) == 2  # the colours
        assert recording.encoded_images(FRAMES) is None
        assert len(read) == 2


def test_a_damaged_chunk_is_missed_only_where_it_is_asked_for() -> None:
    places = [Place(number, 0, 10, number, number) for number in range(8)]
    asked: list[int] = []
    cells = pa.list_(pa.list_(pa.uint8()))
    columns = pa.schema(
        [
            pa.field(schema.FRAME, pa.int64()),
            pa.field("blob", cells, metadata={"rerun:component": "X:blob"}),
        ]
    )

    def read(wanted: Sequence[Place]) -> list[pa.RecordBatch]:
        asked.append(len(wanted))
        if any(place.number == 5 for place in wanted):
            raise InputError("damaged")
        return [
            pa.record_batch([pa.array([one.first]), pa.array([[[one.number]]], cells)], schema=columns)
            for one in wanted
        ]

    blobs = blob_column.IndexedBlobs(places, "X:blob", read)
    for number in range(8):
        if number == 5:
            with pytest.raises(InputError, match="damaged"):
                blobs[number]
        else:
            assert blobs[number] == bytes([number])
    assert max(asked) > 1  # some were read beforehand


def test_a_foreign_recording_is_refused(tmp_path: Path) -> None:
    import rerun as rr

    stream = rr.RecordingStream("another_program")
    stream.save(tmp_path / "foreign.rrd")
    stream.log("text", rr.TextLog("hello"))
    stream.disconnect()
    with pytest.raises(InputError, match="another program"):
        Recording.open(tmp_path / "foreign.rrd")
