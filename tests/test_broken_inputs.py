"""The table of broken configurations and inputs: how each ends, and that nothing is overwritten.

Every row: what is broken, the files, the arguments, the exit code (2 for configuration, arguments and input
files; 1 for disk, permissions and plug-ins at run time) and what stderr must say. stderr is at most two lines
and never a traceback; every file that was there before is there afterwards, unchanged.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from project import FAKE_RUN, Outcome, Project, environment, project


def png(array: np.ndarray) -> bytes:  # type: ignore[type-arg]
    """A PNG file of an image array."""
    stream = io.BytesIO()
    Image.fromarray(array).save(stream, "PNG")
    return stream.getvalue()


POSE = "1 0 0 0\n0 0 1 0\n0 -1 0 1\n0 0 0 1\n"
COLOR, DEPTH = png(np.full((24, 32, 3), 90, np.uint8)), png(np.full((24, 32), 1000, np.uint16))


def sequence(color: bytes = COLOR, depth: bytes | None = DEPTH, pose: str = POSE) -> dict[str, str | bytes]:
    """A small posed RGB-D folder `seq` in the 7-Scenes layout, with one part replaced in every frame."""
    files: dict[str, str | bytes] = {}
    for index in range(3):
        stem = f"seq/frame-{index:06d}"
        files[f"{stem}.color.png"] = color
        files[f"{stem}.pose.txt"] = pose
        if depth is not None:
            files[f"{stem}.depth.png"] = depth
    return files


RGBD = FAKE_RUN.replace(
    "source: {use: fake}", "source: {use: rgbd, path: seq, intrinsics: [30, 30, 15.5, 11.5]}"
)
REPLAYED = FAKE_RUN.replace("source: {use: fake}", "source: {use: recording, recording: gone.rrd}")
DETECTOR = """
from fake_plugins import FakePerception
import numpy as np
from dataclasses import replace

class Raises(FakePerception):
    def detect(self, frame):
        raise RuntimeError("out of luck")

class Small(FakePerception):
    def detect(self, frame):
        return [replace(one, mask=np.ones((12, 16), bool)) for one in super().detect(frame)]

class Nan(FakePerception):
    def detect(self, frame):
        return [replace(one, box_xyxy=np.full(4, np.nan)) for one in super().detect(frame)]

class Nothing(FakePerception):
    def detect(self, frame):
        return None

class NoMethod:
    feature_space = None
    def __init__(self, config, context):
        pass
"""
CLASHING = """
from dssmsg.hookspecs import hookimpl
@hookimpl
def register_perception(register):
    register("fake", lambda config, context: None)
"""


@dataclass(frozen=True)
class Case:
    """One row of the table. The fakes' mission is `dssmsg.yaml` unless `files` brings its own."""

    name: str
    code: int
    says: tuple[str, ...]
    arguments: tuple[str, ...] = ("run",)
    files: Mapping[str, str | bytes] = field(default_factory=dict)


def config(name: str, text: str, code: int, *says: str, **files: str | bytes) -> Case:
    """A row whose `bad.yaml` is the fakes' mission with more lines below it."""
    named = {key.replace("__", "."): value for key, value in files.items()}
    return Case(
        name,
        code,
        ("bad.yaml", *says),
        ("run", "bad.yaml"),
        {"bad.yaml": "include: dssmsg.yaml\n" + text, **named},
    )


def swap(name: str, cls: str, *says: str) -> Case:
    """A row that runs a class of det.py and does not put up with errors."""
    arguments = ("run", "--set", f"perception.use=det.py:{cls}", "--set", "on_error=fail")
    return Case(name, 1, (f"det.{cls}", *says), arguments, {"det.py": DETECTOR})


def source(name: str, files: Mapping[str, str | bytes], *says: str, text: str = RGBD) -> Case:
    """A row whose posed RGB-D folder is broken."""
    return Case(name, 2, says, ("run",), {"dssmsg.yaml": text, **files})


TABLE = [
    # The file
    Case("missing file", 2, ("none.yaml", "no such file"), ("run", "none.yaml")),
    Case("a folder", 2, ("sub", "is a folder"), ("run", "sub"), {"sub/x": ""}),
    Case("not YAML", 2, ("b.yaml: line 1: not valid YAML",), ("run", "b.yaml"), {"b.yaml": "a: [1"}),
    Case("not text", 2, ("b.yaml", "UTF-8"), ("run", "b.yaml"), {"b.yaml": b"\xff\xfe\x00"}),
    Case("a list", 2, ("b.yaml", "expected `key: value`"), ("run", "b.yaml"), {"b.yaml": "- a\n"}),
    Case("too large", 2, ("b.yaml", "larger than"), ("run", "b.yaml"), {"b.yaml": "#" * 1_000_001}),
    config("key twice", "seed: 1\nseed: 2\n", 2, "line 3: the key 'seed' is written twice"),
    config("python tag", "seed: !!python/name:os.system\n", 2, "tag"),
    Case(
        "cyclic include",
        2,
        ("include: ", "circle: a.yaml -> b.yaml -> a.yaml"),
        ("run", "a.yaml"),
        {"a.yaml": "include: b.yaml", "b.yaml": "include: a.yaml"},
    ),
    Case(
        "missing include",
        2,
        ("a.yaml: include: ", "gone.yaml"),
        ("run", "a.yaml"),
        {"a.yaml": "include: gone.yaml"},
    ),
    # Keys and values
    config("unknown key", "sead: 1\n", 2, "sead", "did you mean 'seed'"),
    config("wrong type", "seed: many\n", 2, "seed", "a whole number, got 'many'"),
    config("out of range", "timeout_secs: 0\n", 2, "timeout_secs", "> 0"),
    config(
        "unknown phase",
        "mission: {phases: [survey, fly]}\n",
        2,
        "mission.phases[1]",
        "survey, revisit or seek",
    ),
    config("seek without goal", "mission: {phases: [seek]}\n", 2, "mission", "--goal"),
    config("slot without braces", "perception: fake\n", 2, "perception", "{use: fake}"),
    config("secret", "llm: {use: fake, api_key: hunter2}\n", 2, "llm.api_key", "environment variable"),
    config("bad name", "name: ../../etc\n", 2, "name"),
    Case("bad --set", 2, ("--set", "key=value"), ("run", "--set", "seed")),
    Case("bad --set value", 2, ("--set: seed",), ("run", "--set", "seed=x")),
    Case("unknown option", 2, ("--sed",), ("run", "--sed", "3")),
    # Plug-ins
    config("unknown plug-in", "perception: {use: fakr}\n", 2, "perception.use", "did you mean 'fake'"),
    config(
        "unknown option of a plug-in", "source: {framez: 3}\n", 2, "source.framez", "did you mean 'frames'"
    ),
    config("missing plug-in file", "plugins: [gone.py]\n", 2, "plugins[0]", "gone.py does not exist"),
    config("missing class file", "perception: {use: 'gone.py:X'}\n", 2, "perception.use", "no such file"),
    config(
        "missing class",
        "perception: {use: 'det.py:Raisez'}\n",
        2,
        "perception.use",
        "did you mean 'Raises'",
        det__py=DETECTOR,
    ),
    Case(
        "plug-in that raises on import",
        1,
        ("perception/mine", "bad.py", "OSError: gone"),
        ("run", "--set", "perception.use=mine"),
        {
            "dssmsg.yaml": FAKE_RUN.replace("plugins: [", "plugins: [bad.py, "),
            "bad.py": "raise OSError('gone')",
        },
    ),
    Case(
        "name registered twice",
        2,
        ("clash.py", "perception 'fake' is already registered by", "fake_plugins.py"),
        ("run",),
        {"dssmsg.yaml": FAKE_RUN.replace("plugins: [", "plugins: [clash.py, "), "clash.py": CLASHING},
    ),
    swap("plug-in without its method", "NoMethod", "NoMethod has no method detect(frame)"),
    swap("plug-in that raises", "Raises", "RuntimeError: out of luck", "det.py:8"),
    swap("wrong shape", "Small", "mask: expected (24, 32), got (12, 16)"),
    swap("NaN", "Nan", "box_xyxy"),
    swap("nothing returned", "Nothing", "expected a list of Detection, got nothing"),
    Case(
        "source with another size than announced",
        1,
        ("source/fake", "expected images of (24, 32)"),
        ("run", "--set", "source.width=16"),
    ),
    Case("source without a frame", 2, ("source", "gave no frame"), ("run", "--set", "source.frames=0")),
    # Input folders
    source("missing folder", {}, "seq", "source.path"),
    source("empty folder", {"seq/readme.txt": "nothing here"}, "seq"),
    source("missing depth", sequence(depth=None), "seq", "depth"),
    source("unreadable image", sequence(color=b"not a picture"), "seq"),
    source(
        "depth of another size",
        sequence() | {"seq/frame-000001.depth.png": png(np.full((12, 16), 1000, np.uint16))},
        "frame-000001.depth.png",
        "expected 32x24 pixels, got 16x12",
    ),
    source(
        "no finite number in any pose",
        sequence(pose="inf inf inf inf\n" * 4),
        "seq",
        "no finite, rigid poses",
    ),
    source("non-finite poses", sequence(pose=POSE.replace("1 0 0 0", "nan 0 0 0")), "seq", "pose"),
    source(
        "unknown layout",
        sequence(),
        "source.layout",
        text=RGBD.replace("path: seq", "path: seq, layout: foo"),
    ),
    source(
        "oracle without truth",
        sequence(),
        "perception",
        "truth",
        text=RGBD.replace("perception: {use: fake}", "perception: {use: oracle}"),
    ),
    # The simulator
    Case(
        "unknown scene",
        2,
        ("source.scene", "rs_in", "rs_int"),
        ("run", "--set", "source={use: pybullet, scene: rs_in}"),
    ),
    Case(
        "wrong assets",
        2,
        ("source.assets", "'reel'", "real"),
        ("run", "--set", "source={use: pybullet, assets: reel}"),
    ),
    # Recordings
    Case("missing recording", 2, ("none.rrd",), ("inspect", "none.rrd")),
    Case("no recording yet", 2, ("recordings",), ("inspect",)),
    Case("empty recording", 2, ("a.rrd",), ("inspect", "a.rrd"), {"a.rrd": b""}),
    Case("not a recording", 2, ("a.rrd",), ("inspect", "a.rrd"), {"a.rrd": b"hello" * 100}),
    Case("export of nothing", 2, ("none.rrd",), ("export", "none.rrd", "-o", "out.json")),
    Case("unknown format", 2, ("--format",), ("export", "none.rrd", "--format", "doc")),
    Case(
        "recording directory is a file",
        2,
        ("recording.directory", "taken is a file"),
        ("run", "--set", "recording.directory=taken"),
        {"taken": "mine"},
    ),
    source("recorded source is missing", {}, "gone.rrd", "there is no such recording", text=REPLAYED),
    source(
        "recorded source is foreign",
        {"gone.rrd": b"hello" * 100},
        "gone.rrd",
        "not a recording",
        text=REPLAYED,
    ),
    source("recorded source is an empty folder", {"gone.rrd/x.txt": ""}, "gone.rrd", text=REPLAYED),
    Case("init over a file", 1, ("dssmsg.yaml", "already there"), ("init",)),
]


def check(case: Case, done: Outcome, folder: Project, before: Mapping[str, bytes]) -> None:
    assert done.code == case.code, done.err + done.out
    assert "Traceback" not in done.err + done.out
    errors = [line for line in done.err.splitlines() if not line.startswith("[")]  # plain progress lines
    assert 1 <= len(errors) <= 2, done.err
    assert errors[-1].startswith("error: ")
    for words in case.says:
        assert words in errors[-1]
    assert "hunter2" not in done.err
    after = folder.snapshot()
    assert {name: after.get(name) for name in before} == before
    made = {name for name in set(after) - set(before) if not name.startswith("recordings/")}
    assert not made


def test_table_is_long_enough_and_states_every_code() -> None:
    assert len(TABLE) >= 25
    assert len({case.name for case in TABLE}) == len(TABLE)
    assert {case.code for case in TABLE} == {1, 2}


@pytest.mark.parametrize("case", TABLE, ids=lambda case: case.name)
def test_broken_input_ends_in_clear_words(
    tmp_path: Path, case: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    folder = project(tmp_path, {"dssmsg.yaml": FAKE_RUN, **case.files})
    before = folder.snapshot()
    check(case, folder.run(*case.arguments), folder, before)


@pytest.mark.parametrize("name", ["unknown key", "unknown plug-in", "wrong shape", "missing recording"])
def test_json_says_the_same(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    (case,) = (one for one in TABLE if one.name == name)
    folder = project(tmp_path, {"dssmsg.yaml": FAKE_RUN, **case.files})
    done = folder.run(*case.arguments, "--json")
    error = json.loads(done.out)["error"]
    assert set(error) == {"kind", "message", "file", "key"}
    assert done.code == case.code
    assert error["message"] in done.err


def test_a_real_process_ends_the_same(tmp_path: Path) -> None:
    folder = project(tmp_path, {"dssmsg.yaml": "sead: 1\n"})
    done = folder.run_process("run")
    assert (done.code, done.out) == (2, "")
    assert done.err == "error: dssmsg.yaml: sead: unknown key; did you mean 'seed'?\n"


@contextmanager
def mounted(place: Path, options: str) -> Iterator[Path]:
    """A small file system of its own at `place`; needs root."""
    place.mkdir()
    if os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("mounting a small file system needs root")
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)], capture_output=True)
    if done.returncode != 0:
        pytest.skip("a small file system cannot be mounted here")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True)


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 kB: less than a recording begins with."""
    with mounted(tmp_path / "small", "size=64k") as place:
        yield place


LIMITED = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write over the limit is then an error (EFBIG), not the end
resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))
from dssmsg.cli import main
sys.exit(main())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limits on file sizes")
@pytest.mark.parametrize("observer", ["rerun: {}", "rerun: false, jsonl: {}"])
def test_a_write_that_fails_midway_ends_the_run_with_1(tmp_path: Path, observer: str) -> None:
    """As on a full disk, without mounting one: no file may grow beyond 8 kB."""
    folder = project(
        tmp_path, {"dssmsg.yaml": FAKE_RUN.replace("rerun: false, fake: {}", observer), "mine.txt": "kept"}
    )
    done = subprocess.run(
        [sys.executable, "-B", "-c", LIMITED, "run", "--set", "source.frames=60"],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    last = done.stderr.splitlines()[-1]
    assert last.startswith("error: recordings/")
    assert "File too large" in last or "disk full" in last
    assert folder.snapshot()["mine.txt"] == b"kept"


@pytest.fixture
def closed_directory(tmp_path: Path) -> Iterator[Path]:
    """A directory that cannot be written to, not even by root."""
    place = tmp_path / "closed"
    if os.geteuid() == 0:
        with mounted(place, "ro") as closed:
            yield closed
    else:
        place.mkdir(mode=0o555)
        yield place


def test_full_disk_ends_the_run_with_1(tmp_path: Path, full_disk: Path) -> None:
    folder = project(tmp_path, {"dssmsg.yaml": FAKE_RUN.replace("rerun: false, fake: {}", "rerun: {}")})
    done = folder.run_process("run", "--set", "recording.directory=small", "--set", "source.frames=60")
    assert done.code == 1, done.err
    assert "Traceback" not in done.err
    last = done.err.splitlines()[-1]
    assert last.startswith("error: small/")
    assert "disk full" in last or "No space left" in last


def test_read_only_directory_ends_the_run_with_1(tmp_path: Path, closed_directory: Path) -> None:
    for observers in ("rerun: false, fake: {}", "rerun: {}"):
        folder = project(tmp_path, {"dssmsg.yaml": FAKE_RUN.replace("rerun: false, fake: {}", observers)})
        done = folder.run("run", "--set", "recording.directory=closed/in")
        assert done.code == 1
        assert "Traceback" not in done.err
        assert "closed" in done.err.splitlines()[-1]


class StandingClock(datetime):
    """It is always noon on the first of January 2026."""

    @classmethod
    def now(cls, tz: object = None) -> StandingClock:  # type: ignore[override]
        return cls(2026, 1, 1, 12)


@pytest.mark.parametrize("observer", ["rerun: {}", "rerun: false, jsonl: {}", "rerun: false, fake: {}"])
def test_an_existing_recording_is_not_overwritten(
    tmp_path: Path, observer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run of the same second and name takes the next number."""
    monkeypatch.setattr("dssmsg.mission.identity.datetime", StandingClock)
    stem = "recordings/20260101-120000-fake"
    taken = {f"{stem}.rrd": "mine", f"{stem}.changes.jsonl": "mine", f"{stem}-2.txt": "mine"}
    yaml = FAKE_RUN.replace("rerun: false, fake: {}", observer)
    folder = project(tmp_path, {"dssmsg.yaml": yaml, **taken})
    before = folder.snapshot()
    done = folder.run("run")
    assert done.code == 0, done.err
    after = folder.snapshot()
    assert {name: after[name] for name in before} == before
    assert {name.split(".")[0] for name in set(after) - set(before)} == {f"{stem}-3"}


@pytest.mark.parametrize("observer", ["rerun: {}", "rerun: false, jsonl: {}"])
def test_a_recording_that_appears_meanwhile_is_not_overwritten(
    tmp_path: Path, observer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two processes chose one name: the second ends with 1."""
    monkeypatch.setattr("dssmsg.mission.run.new_run_id", lambda config: "taken")
    taken = {"recordings/taken.rrd": "mine", "recordings/taken.changes.jsonl": "mine"}
    yaml = FAKE_RUN.replace("rerun: false, fake: {}", observer)
    folder = project(tmp_path, {"dssmsg.yaml": yaml, **taken})
    before = folder.snapshot()
    done = folder.run("run")
    assert done.code == 1, done.err
    assert "Traceback" not in done.err
    assert "exists already and is not overwritten" in done.err.splitlines()[-1]
    assert folder.snapshot() == before


def test_environment_of_the_tests_is_clean() -> None:
    assert not [name for name in environment() if name.startswith("DSSMSG")]
