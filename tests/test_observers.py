"""The observers `rerun`, `jsonl` and `progress`: exclusive files, bounded queues, said failures."""

from __future__ import annotations

import io
import json
import multiprocessing
import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path

import pytest
from dssmsg_plugins.observer import jsonl, progress, rerun
from recorded_run import SyntheticRun, context

from dssmsg.errors import InputError, StorageError
from dssmsg.events import Detected
from dssmsg.frame import Detection
from dssmsg.graph.compare import same
from dssmsg.recording.reader import Recording
from dssmsg.recording.writer import RecordingWriter

LIMITED = """
import resource, signal, sys, time
from pathlib import Path
from recorded_run import SyntheticRun, context
from dssmsg.errors import StorageError
from dssmsg_plugins.observer import jsonl, rerun

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # writing past the limit fails, as on a full disk
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
run, place = SyntheticRun(4000), context(Path(sys.argv[1]))
if sys.argv[2] == "jsonl":
    observer = jsonl.JsonlObserver(jsonl.Config(flush_secs=0.1), place)
else:
    config = rerun.Config(flush_secs=0.1, process=sys.argv[2] == "rerun process")
    observer = rerun.RerunObserver(config, place)
try:
    try:
        for event in run.events():
            observer.on_event(event)
    finally:
        observer.close()
except StorageError as error:
    print(error)
    sys.exit(7)
"""


TOLD = """
import sys, time
from pathlib import Path
from recorded_run import SyntheticRun, context
from dssmsg_plugins.observer.rerun import Config, RerunObserver

run = SyntheticRun(40)
observer = RerunObserver(Config(process=True, flush_secs=2.0), context(Path(sys.argv[1])))
observer.on_event(run.started())
for index in range(run.frames):
    for event in run.frame_events(index):
        observer.on_event(event)
time.sleep(1.0)  # sent, and not flushed yet
print("told", flush=True)
time.sleep(60)
"""


def tell_all(observer: rerun.RerunObserver | jsonl.JsonlObserver, run: SyntheticRun) -> None:
    for event in run.events():
        observer.on_event(event)
    observer.close()
    observer.close()


@pytest.mark.parametrize("process", [False, True], ids=["thread", "process"])
def test_rerun_records_a_run(tmp_path: Path, process: bool) -> None:
    run = SyntheticRun(30)
    observer = rerun.RerunObserver(rerun.Config(process=process), context(tmp_path / "new" / "folder"))
    assert observer.outputs() == {}
    assert not (tmp_path / "new").exists()  # made on use
    tell_all(observer, run)
    path = Path(observer.outputs()["recording"])
    assert path == tmp_path / "new" / "folder" / "synthetic.rrd"
    assert [entry.name for entry in path.parent.iterdir()] == ["synthetic.rrd"]
    with Recording.open(path) as recording:
        assert recording.complete
        assert recording.stored_summary is not None
        assert len(recording.frame_indices) == 30
        assert same(recording.graph_at(), run.live)


def test_rerun_overwrites_nothing(tmp_path: Path) -> None:
    path = tmp_path / "synthetic.rrd"
    path.write_bytes(b"precious")
    observer = rerun.RerunObserver(rerun.Config(), context(tmp_path))
    with pytest.raises(StorageError, match="exists already") as caught:
        observer.on_event(SyntheticRun(1).started())
    assert caught.value.file == str(path)
    observer.close()
    assert path.read_bytes() == b"precious"


def test_a_process_that_cannot_write_says_so_and_overwrites_nothing(tmp_path: Path) -> None:
    path = tmp_path / "synthetic.rrd"
    path.write_bytes(b"precious")
    observer = rerun.RerunObserver(rerun.Config(process=True), context(tmp_path))
    with pytest.raises(StorageError, match="exists already") as caught:
        tell_all(observer, SyntheticRun(1))
    assert caught.value.file == str(path)
    with pytest.raises(StorageError, match="exists already"):
        observer.close()
    assert path.read_bytes() == b"precious"


def test_a_process_that_was_told_nothing_leaves_nothing(tmp_path: Path) -> None:
    observer = rerun.RerunObserver(rerun.Config(process=True), context(tmp_path / "new"))
    observer.close()
    observer.close()
    assert observer.outputs() == {}
    assert not (tmp_path / "new").exists()


def test_thread_and_process_write_the_same(tmp_path: Path) -> None:
    found = []
    for process in (False, True):
        observer = rerun.RerunObserver(
            rerun.Config(process=process, images="lossless"), context(tmp_path / str(process))
        )
        tell_all(observer, SyntheticRun(20, seed=4))
        with Recording.open(Path(observer.outputs()["recording"])) as recording:
            rows = [list(recording.change_rows()), recording.windows(), recording.matches()]
            images = [recording.encoded_images(index) for index in recording.frame_indices]
            seen = dict(recording.detection_hashes())
        found.append((rows, images, seen))
    assert found[0] == found[1]
    assert len(found[0][1]) == 20


def test_values_of_a_strangers_types_reach_the_writers_process(tmp_path: Path) -> None:
    """The file they are defined in is loaded in the mission's process alone."""

    class Word(str):
        __slots__ = ()

    @dataclass(frozen=True, slots=True, eq=False)
    class Mine(Detection):
        distance: float = 1.0

    Word.__module__ = Mine.__module__ = "a_strangers_file"
    run = SyntheticRun(3)
    observer = rerun.RerunObserver(rerun.Config(process=True), context(tmp_path))
    told = 0
    for event in run.events():
        if isinstance(event, Detected) and event.detections:
            plain = event.detections[0]
            values = {field.name: getattr(plain, field.name) for field in fields(Detection)}
            event = replace(event, detections=(Mine(**{**values, "label": Word("thing")}),))
            told += 1
        observer.on_event(event)
    observer.close()
    assert told
    with Recording.open(Path(observer.outputs()["recording"])) as recording:
        seen = [recording.detections(index) for index in recording.key_frames]
    assert [[one.label for one in found] for found in seen if found] == [["thing"]] * told


def test_a_writer_whose_process_was_killed_is_missed(tmp_path: Path) -> None:
    run = SyntheticRun(60)
    observer = rerun.RerunObserver(rerun.Config(process=True), context(tmp_path))
    observer.on_event(run.started())
    (child,) = [one for one in multiprocessing.active_children() if one.name == "dssmsg-writer"]
    child.kill()
    child.join()
    with pytest.raises(StorageError, match="was ended"):
        tell_all(observer, run)
    with pytest.raises(StorageError, match="was ended"):
        observer.close()


def test_jsonl_overwrites_nothing(tmp_path: Path) -> None:
    path = tmp_path / "synthetic.changes.jsonl"
    path.write_bytes(b"precious")
    observer = jsonl.JsonlObserver(jsonl.Config(), context(tmp_path))
    with pytest.raises(StorageError, match="exists already"):
        observer.on_event(SyntheticRun(1).started())
    observer.close()
    assert path.read_bytes() == b"precious"


@pytest.mark.parametrize(("module", "name"), [(rerun, "RerunObserver"), (jsonl, "JsonlObserver")])
def test_a_place_that_cannot_be_written_is_said(tmp_path: Path, module: object, name: str) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    observer = getattr(module, name)(module.Config(), context(blocked / "runs"))  # type: ignore[attr-defined]
    with pytest.raises(StorageError, match=r"recording\.directory"):
        observer.on_event(SyntheticRun(1).started())


@pytest.mark.parametrize("kind", ["rerun", "rerun process", "jsonl"])
def test_a_full_disk_ends_the_run(tmp_path: Path, kind: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(tmp_path), kind],
        capture_output=True,
        text=True,
        timeout=60,
        cwd=Path(__file__).parent,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
    )
    assert done.returncode == 7, done.stderr
    assert "could not be written" in done.stdout
    assert "Traceback" not in done.stderr
    if kind != "jsonl":
        with Recording.open(tmp_path / "synthetic.rrd") as recording:
            assert recording.facts["run_id"] == "synthetic"


def test_rerun_blocks_and_never_drops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = []
    waiting = threading.Event()
    plain = RecordingWriter.write

    def slow(self: RecordingWriter, event: object) -> None:
        waiting.wait(5.0)
        written.append(type(event).__name__)
        plain(self, event)  # type: ignore[arg-type]

    monkeypatch.setattr(RecordingWriter, "write", slow)
    run = SyntheticRun(10)
    told = list(run.events())
    observer = rerun.RerunObserver(rerun.Config(queue_size=4), context(tmp_path))
    passed = []

    def tell() -> None:
        for event in told:
            observer.on_event(event)
            passed.append(event)

    teller = threading.Thread(target=tell)
    teller.start()
    time.sleep(0.3)
    assert 4 <= len(passed) <= 6  # the queue's four, and what the writer holds
    waiting.set()
    teller.join(10.0)
    observer.close()
    assert written == [type(event).__name__ for event in told]


def test_rerun_flushes_while_nothing_is_told(tmp_path: Path) -> None:
    run = SyntheticRun(5)
    observer = rerun.RerunObserver(rerun.Config(flush_secs=0.2), context(tmp_path))
    observer.on_event(run.started())
    for event in run.frame_events(0):
        observer.on_event(event)
    deadline = time.monotonic() + 5.0
    frames = 0
    while frames == 0 and time.monotonic() < deadline:
        time.sleep(0.1)
        with suppress(InputError), Recording.open(tmp_path / "synthetic.rrd") as recording:
            frames = len(recording.frame_indices)
    assert frames == 1
    observer.close()


def test_what_a_killed_mission_told_is_still_written(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", TOLD, str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parent,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
    )
    assert process.stdout is not None
    with process.stdout:
        assert process.stdout.readline() == "told\n"
        process.kill()
        process.wait()
    deadline = time.monotonic() + 30.0
    frames = 0
    while frames < 40 and time.monotonic() < deadline:
        time.sleep(0.2)
        if (tmp_path / "synthetic.rrd").exists():
            with suppress(InputError), Recording.open(tmp_path / "synthetic.rrd") as recording:
                frames = len(recording.frame_indices)
    assert frames == 40


def test_a_writer_that_fails_is_heard_of_and_nobody_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: RecordingWriter, event: object) -> None:
        raise ValueError("instance ids: expected 0 to 65535")

    run = SyntheticRun(50)
    observer = rerun.RerunObserver(rerun.Config(queue_size=2), context(tmp_path))
    monkeypatch.setattr(RecordingWriter, "write", broken)
    with pytest.raises(ValueError, match="65535"):
        tell_all(observer, run)
    with pytest.raises(ValueError, match="65535"):
        observer.close()


def test_jsonl_is_the_same_twice_and_holds_the_changes(tmp_path: Path) -> None:
    texts = []
    for name in ("one", "two"):
        run = SyntheticRun(20, seed=3)
        observer = jsonl.JsonlObserver(jsonl.Config(), context(tmp_path, name))
        tell_all(observer, run)
        texts.append(Path(observer.outputs()["changes"]).read_bytes())
    assert texts[0] == texts[1]
    rows = [json.loads(line) for line in texts[0].splitlines()]
    assert [row["update"] for row in rows] == [change.update for change in run.told]
    assert {row["kind"] for row in rows} >= {"object_added", "object_merged", "edge_added"}


def test_progress_tells_plain_lines_off_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    observer = progress.ProgressObserver(progress.Config(), context(tmp_path))
    run = SyntheticRun(20)
    for event in run.events():
        observer.on_event(event)
    observer.close()
    lines = stream.getvalue().splitlines()
    assert any("phase survey begins" in line for line in lines)
    assert any("NaN in a box" in line for line in lines)
    assert f"frame 20 (4 s), 7 key frames, {len(run.live.objects)} objects" in lines[-1]
    assert len(lines) < 12
    assert "\x1b" not in stream.getvalue()


def test_progress_survives_a_closed_stderr(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    observer = progress.ProgressObserver(progress.Config(style="lines"), context(tmp_path))
    stream.close()
    for event in SyntheticRun(6).events():
        observer.on_event(event)
    observer.close()


def test_progress_shows_a_live_line_on_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    observer = progress.ProgressObserver(progress.Config(every_secs=0.2), context(tmp_path))
    for event in SyntheticRun(6).events():
        observer.on_event(event)
    observer.close()
    observer.close()
    assert "frame 6" in stream.getvalue()
