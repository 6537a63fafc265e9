"""Recordings that were killed, cut, damaged or are still growing: read as far as they go, never touched."""

from __future__ import annotations

import hashlib
import json
import os
import random
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from recorded_run import SyntheticRun, record

from dssmsg.cli import main
from dssmsg.errors import InputError, StorageError
from dssmsg.graph.compare import same
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.recording import repair, schema
from dssmsg.recording.reader import Recording
from dssmsg.recording.writer import RecordingWriter
from dssmsg.review.summary import summarize

LAYOUT_BYTES = 140_000
"""A finished file begins with the viewer's layout and what never changes."""

ENDLESS = """
import sys, time
from pathlib import Path
from recorded_run import SyntheticRun, context
from dssmsg_plugins.observer.rerun import Config, RerunObserver

run = SyntheticRun(100_000)
observer = RerunObserver(Config(), context(Path(sys.argv[1])))
observer.on_event(run.started())
for index in range(run.frames):
    for event in run.frame_events(index):
        observer.on_event(event)
    print(index, time.monotonic(), flush=True)
    time.sleep(0.02)
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SyntheticRun]:
    run = SyntheticRun(40)
    return record(run, tmp_path_factory.mktemp("repair") / "whole.rrd"), run


def call(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    code = main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def fingerprint(path: Path) -> tuple[str, int]:
    return hashlib.sha256(path.read_bytes()).hexdigest(), path.stat().st_mtime_ns


def check_prefix(recording: Recording, run: SyntheticRun) -> None:
    """What is there is the beginning of what was told, without a hole."""
    indices = list(recording.frame_indices)
    assert indices == list(range(len(indices)))
    changes = list(recording.changes())
    assert [change.update for change in changes] == list(range(1, len(changes) + 1))
    assert same(recording.graph_at(), SceneGraph.fold(run.told[: len(changes)]))


@pytest.mark.parametrize("delay", [1.3, 2.6])
def test_kill_loses_at_most_three_seconds(tmp_path: Path, delay: float) -> None:
    # A process group of its own, so that the kill ends nothing else.
    child = subprocess.Popen(
        [sys.executable, "-c", ENDLESS, str(tmp_path)],
        stdout=subprocess.PIPE,
        cwd=Path(__file__).parent,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
    )
    assert child.stdout is not None
    told: dict[int, float] = {}
    stop = None
    while stop is None or time.monotonic() < stop:
        ready, _, _ = select.select([child.stdout], [], [], 0.05)
        if ready:
            index, moment = child.stdout.readline().split()
            told[int(index)] = float(moment)
            stop = stop or time.monotonic() + delay
    child.send_signal(signal.SIGKILL)
    killed = time.monotonic()
    child.wait()
    child.stdout.close()
    path = tmp_path / "synthetic.rrd"
    before = fingerprint(path)
    with Recording.open(path) as recording:
        assert not recording.complete
        kept = len(recording.frame_indices)
        rerun = SyntheticRun(100_000)
        for index in range(kept + 1):
            list(rerun.frame_events(index))
        check_prefix(recording, rerun)
        summary = summarize(recording)
    assert summary["complete"] is False
    assert summary["frames"] == kept
    must_be_there = [index for index, moment in told.items() if moment < killed - 3.0]
    assert kept > max(must_be_there, default=-1)
    assert kept > len(told) - 3.0 / 0.02 - 1
    assert kept > 0
    assert fingerprint(path) == before


def test_cut_anywhere_behind_the_first_flush(tmp_path: Path) -> None:
    run = SyntheticRun(40)
    path = tmp_path / "killed.rrd"
    writer = RecordingWriter(path, "killed")
    flushed = []
    for number, event in enumerate(run.events()):
        writer.write(event)
        if number % 30 == 29:
            writer.flush()
            flushed.append(path.stat().st_size)
    data = path.read_bytes()
    assert len(data) == flushed[-1]
    writer.close()
    draw = random.Random(1)
    kept = set()
    for cut in sorted(draw.randrange(flushed[0], len(data)) for _ in range(10)):
        copy = tmp_path / f"cut-{cut}.rrd"
        copy.write_bytes(data[:cut])
        before = fingerprint(copy)
        with Recording.open(copy) as recording:
            # A cut in the middle of a flush may part two tables, but no row is wrong or missing in between.
            indices = list(recording.frame_indices)
            assert indices == list(range(len(indices)))
            for row, change in zip(recording.change_rows(), run.told, strict=False):
                assert (row["update"], row["kind"]) == (change.update, change.kind)
            kept.add(len(indices))
        assert fingerprint(copy) == before
    assert len(kept) > 2
    assert min(kept) > 0


@pytest.mark.parametrize(("frames", "width", "share", "least"), [(50, 128, 1.0, 0), (40, 64, 0.5, 2)])
def test_a_finished_file_cut_anywhere_opens_too(
    frames: int, width: int, share: float, least: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = SyntheticRun(frames, width=width, height=width * 3 // 4)
    data = record(run, tmp_path / "whole.rrd").read_bytes()
    draw = random.Random(5)
    partial = 0
    cuts = [draw.randrange(max(LAYOUT_BYTES, len(data) // 20), int(share * len(data))) for _ in range(7)]
    for cut in [*cuts, len(data) - 1]:
        copy = tmp_path / f"cut-{cut}.rrd"
        copy.write_bytes(data[:cut])
        before = fingerprint(copy)
        code, out, err = call(capsys, "inspect", copy, "--json")
        assert code == 0, err
        summary = json.loads(out)
        with Recording.open(copy) as recording:
            assert recording.facts["run_id"] == run.run_id
            changes = list(recording.changes())
            graph = recording.graph_at()
            known = recording.last_known_frame
            assert len(list(recording.frames())) == recording.frames_readable == summary["frames_readable"]
        number = len(changes)
        assert [change.update for change in changes] == list(range(1, number + 1))
        assert same(graph, SceneGraph.fold(run.told[:number]))
        assert summary["changes_readable"] == number == sum(summary["changes"].values())
        assert number <= summary["changes_recorded"] <= len(run.told)
        assert summary["objects"] + summary["tentative"] == len(graph.objects)
        assert summary["waypoints"] == len(graph.waypoints)
        assert summary["complete"] == (number == len(run.told) and summary["frames_readable"] == run.frames)
        assert known is None or sum(change.frame <= known for change in run.told) <= number
        if number < summary["changes_recorded"]:
            partial += 1
            assert f"{number} of at least {summary['changes_recorded']} changes" in summary["notes"][0]
            assert summary["notes"][0] in call(capsys, "inspect", copy)[1]
            assert summary["notes"][0] in call(capsys, "export", copy)[2]
            beyond = 0 if known is None else known + 1
            code, out, err = call(capsys, "export", copy, "--at", f"frame={beyond}")
            assert (code, out) == (2, "")
            assert str(copy) in err.splitlines()[-1]
            assert "cut off" in err.splitlines()[-1]
        if known is not None:
            assert call(capsys, "export", copy, "--at", f"frame={known}")[0] == 0
        assert fingerprint(copy) == before
    assert partial >= least


@pytest.mark.parametrize("spoil", ["json", "blob"])
def test_damage_in_a_finished_file_is_said_with_its_path(
    whole: tuple[Path, SyntheticRun], spoil: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, _ = whole
    with Recording.open(path) as recording:
        if spoil == "json":
            texts = recording._file.table(schema.GRAPH_LOG).values("json")
            spoilt = [text[:-9] if number == 1 else text for number, text in enumerate(texts)]
            monkeypatch.setattr(recording._changes, "texts", lambda: iter(spoilt))
        else:
            monkeypatch.setattr(recording._changes, "_blobs", {})
        with pytest.raises(InputError, match="the changes") as caught:
            list(recording.changes())
        assert caught.value.file == str(path)


def test_a_growing_file_reads_as_far_as_it_is(tmp_path: Path) -> None:
    run = SyntheticRun(12)
    path = tmp_path / "growing.rrd"
    writer = RecordingWriter(path, "growing")
    seen = []
    for event in run.events():
        writer.write(event)
        if type(event).__name__ == "StageTimed" and event.frame % 4 == 3:
            writer.flush()
            with Recording.open(path) as recording:
                assert not recording.complete
                check_prefix(recording, run)
                seen.append(len(recording.frame_indices))
    writer.close()
    assert seen == [4, 8, 12]
    with Recording.open(path) as recording:
        assert recording.complete


def test_the_repaired_copy_goes_away(whole: tuple[Path, SyntheticRun], tmp_path: Path) -> None:
    copy = tmp_path / "cut.rrd"
    copy.write_bytes(whole[0].read_bytes()[:-100])
    recording = Recording.open(copy)
    assert recording.readable_path != copy
    assert recording.readable_path.exists()
    recording.close()
    recording.close()
    assert not recording.readable_path.exists()


def test_a_repaired_copy_is_made_and_said_once_and_goes_with_the_last_reader(
    whole: tuple[Path, SyntheticRun], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(whole[0].read_bytes()[:-100])
    with Recording.open(cut) as first, Recording.open(tmp_path / "." / "cut.rrd") as second:
        assert first.readable_path == second.readable_path
        first.close()
        assert second.readable_path.exists()
        assert len(second.frame_indices) == len(first.frame_indices)
        cut.write_bytes(whole[0].read_bytes()[:-200])  # another state of it
        with Recording.open(cut) as third:
            assert third.readable_path != second.readable_path
    assert not second.readable_path.exists()
    assert len([one for one in caplog.records if "repaired copy" in one.getMessage()]) == 2


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "the file is empty"),
        (b"hello, world, this is a text", "not a recording"),
        (b"RRF", "not a recording"),
        (b"RRF2" + bytes(8), "nothing can be read"),
        (b"RRF2\x00)\x00\x00\x01\x02\x00\x00" + b"\xff" * 400, "holds no recording"),
    ],
)
def test_what_is_no_recording_is_said_with_its_path(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "bad.rrd"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        Recording.open(path)
    assert caught.value.file == str(path)
    assert path.read_bytes() == content


def test_missing_and_folder_are_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such recording"):
        Recording.open(tmp_path / "none.rrd")
    with pytest.raises(InputError, match="folder"):
        Recording.open(tmp_path)


def test_optimizing_keeps_every_value(tmp_path: Path) -> None:
    run = SyntheticRun(30)
    path = record(run, tmp_path / "run.rrd")
    path.chmod(0o640)
    with Recording.open(path) as recording:
        before = summarize(recording), [frame.depth.tobytes() for frame in recording.frames()]
    repair.optimize(path)
    assert path.stat().st_mode & 0o777 == 0o640
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.rrd"]
    with Recording.open(path) as recording:
        assert recording.complete
        assert (summarize(recording), [frame.depth.tobytes() for frame in recording.frames()]) == before
        assert same(recording.graph_at(), run.live)


def test_failing_to_optimize_keeps_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = record(SyntheticRun(3), tmp_path / "run.rrd")
    before = path.read_bytes()
    monkeypatch.setattr(repair, "rerun_program", lambda: Path("/bin/false"))
    with pytest.raises(StorageError, match="nothing of it is lost"):
        repair.optimize(path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.rrd"]
