# ruff: noqa: E501  (the table has a case a line)
"""Recordings that are malformed, foreign, empty, cut or hostile: every reading command ends in clear words.

Exit code 2 with one or two lines on stderr, or 0 where the command needs nothing of what is spoilt; never a
traceback, never a write to the recording or beside it, and nothing that it names is imported.
"""

from __future__ import annotations

import hashlib
import json
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pytest
import rerun as rr
from project import FAKE_RUN, project
from recorded_run import SyntheticRun, record
from spoilt_recordings import bomb, rewritten, with_json, without

from dssmsg.recording.viewer import Viewer

COMMANDS = {
    "inspect": ("inspect", "REC"),
    "inspect --json": ("inspect", "REC", "--json"),
    "explain": ("explain", "REC", "--object", "object-1"),
    "query": ("query", "REC", "a chair"),
    "export": ("export", "REC"),
    "view": ("view", "REC"),
}
ALL = frozenset(COMMANDS)
FACTS = frozenset({"inspect", "inspect --json", "query", "view"})
SUMMED = frozenset({"inspect", "inspect --json"})
RUN, SUMMARY = "/__properties/run", "/__properties/summary"
Make = Callable[[Path, Path], None]


@dataclass(frozen=True)
class Case:
    """A spoilt recording: `make(good, target)`, what stderr says, and which commands refuse it."""

    name: str
    make: Make
    says: str
    refusing: frozenset[str] = ALL


def content(data: bytes) -> Make:
    return lambda good, target: void(target.write_bytes(data))


def cells(path: str, component: str, edit: Callable[[object], object], kind: object = None) -> Make:
    return lambda good, target: rewritten(good, target, path, component, edit, kind)


def rows(path: str, archetype: str, **values: object) -> Make:
    return cells(path, f"{archetype}:json" if archetype else "json", with_json(**values))


def spoilt_bytes(edit: Callable[[bytearray], None]) -> Make:
    def make(good: Path, target: Path) -> None:
        data = bytearray(good.read_bytes())
        edit(data)
        target.write_bytes(data)

    return make


def void(_: object) -> None:
    """For lambdas that shall return nothing."""


def foreign(application: str) -> Make:
    def make(good: Path, target: Path) -> None:
        stream = rr.RecordingStream(application)
        stream.save(target)
        stream.log("text", rr.TextLog("hello"))
        stream.disconnect()

    return make


def giant_message(data: bytearray) -> None:
    struct.pack_into("<Q", data, 12 + 8, 1 << 61)


def giant_offsets(data: bytearray) -> None:
    for place in range(len(data) - 44, len(data) - 12, 8):
        struct.pack_into("<Q", data, place, 1 << 60)


def not_a_number(text: object) -> str:
    row = json.loads(str(text))
    if "world_from_camera" in row:
        row["world_from_camera"] = [[float("nan")] * 4] * 4
    return json.dumps(row)


def giant_shape(text: object) -> str:
    return re.sub(r'"shape": ?\[\d+', '"shape":[1000000000000', str(text))


TABLE = [
    Case("missing", lambda good, target: None, "no such recording"),
    Case("a folder", lambda good, target: target.mkdir(), "folder"),
    Case("empty", content(b""), "empty"),
    Case("text", content(b"hello, world " * 50), "not a recording"),
    Case("magic and nothing", content(b"RRF2" + bytes(8)), "nothing can be read"),
    Case("magic and noise", content(b"RRF2\x00)\x00\x00\x01\x02\x00\x00" + b"\xa5" * 4000), "recording"),
    Case("cut in its beginning", lambda g, t: void(t.write_bytes(g.read_bytes()[:4000])), "recording"),
    Case("foreign", foreign("another_program"), "another program"),
    Case("ours by name only", foreign("dssmsg"), "another program"),
    Case("a message of 2^61 bytes, read past by the index", spoilt_bytes(giant_message), "", frozenset()),
    Case("an index that points nowhere", spoilt_bytes(giant_offsets), ""),
    Case("newer schema", cells(RUN, "schema_version", lambda _: 99), "schema version 99"),
    Case("schema before all", cells(RUN, "schema_version", lambda _: 0), "schema version 0"),
    Case("schema in words", cells(RUN, "schema_version", lambda _: "two", pa.string()), "schema version two"),
    Case("facts are no JSON", cells(RUN, "json", lambda _: "{"), "facts", FACTS),
    Case("facts are a bomb", cells(RUN, "json", lambda _: bomb()), "facts", FACTS),
    Case("facts of other types", rows(RUN, "", seed=[1]), "seed", FACTS),
    Case("summary is a bomb", cells(SUMMARY, "json", lambda _: bomb()), "summary"),
    Case("summary is a list", cells(SUMMARY, "json", lambda _: "[]"), "summary"),
    Case("changes are no JSON", cells("/graph_log", "GraphChange:json", lambda _: "{]"), "the changes"),
    Case("a change is a bomb", cells("/graph_log", "GraphChange:json", lambda _: bomb()), "the changes"),
    Case("changes are numbers", cells("/graph_log", "GraphChange:json", lambda _: b"\xff", pa.binary()), "/graph_log"),
    Case("poses that are not numbers", cells("/graph_log", "GraphChange:json", not_a_number), "changes"),
    Case("changes claim a terabyte", cells("/graph_log", "GraphChange:json", giant_shape), "changes"),
    Case("changes of an unknown kind", rows("/graph_log", "GraphChange", kind="object_melted"), "object_melted"),
    Case("no arrays", lambda good, target: without(good, target, "/blobs"), "missing"),
    Case("other arrays", cells("/blobs", "Blob:data", lambda data: bytes(data)[::-1]), "damaged"),
    Case("frames of other types", cells("/frames", "Frame:index", lambda _: "x", pa.string()), "/frames"),
    Case("episodes without an outcome", rows("/errors", "Error", plugin=...), "/errors", SUMMED),
    Case("plug-ins of its own", rows(RUN, "", config={"plugins": ["evil.py"], "source": {"use": "evil.py:Evil"}}), "", frozenset()),
    Case("names that climb", rows(RUN, "", run_id="../../up", name="../../../up"), "", frozenset()),
    Case("a summary of other types", rows(SUMMARY, "", changes=[1], seconds="long", episodes=[3], objects={}), "", frozenset()),
    Case("pose of another size", cells("/frames", "Frame:camera", lambda _: float("nan")), "camera", frozenset({"query"})),
]  # fmt: skip  # one case a line: a table


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(SyntheticRun(9), tmp_path_factory.mktemp("good") / "good.rrd")


@pytest.fixture(autouse=True)
def no_window(monkeypatch: pytest.MonkeyPatch) -> None:
    """`view` opens nothing: what it does before is what is tested."""

    class Closed:
        def show(self, layout: object = None, frame: int | None = None) -> None: ...
        def wait(self) -> None: ...
        def stop(self) -> None: ...

    monkeypatch.setattr(Viewer, "start", lambda *_args, **_names: Closed())


def state(folder: Path) -> dict[str, tuple[str, int]]:
    return {
        str(path.relative_to(folder)): (
            hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "",
            path.stat().st_mtime_ns,
        )
        for path in sorted(folder.rglob("*"))
        if "__pycache__" not in path.parts
    }


def test_there_are_twenty_cases_and_more() -> None:
    assert len({case.name for case in TABLE}) == len(TABLE) >= 20


@pytest.mark.parametrize("case", TABLE, ids=lambda case: case.name)
def test_every_reading_command_ends_in_clear_words(
    case: Case, good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    folder = project(
        tmp_path / "home",
        {"dssmsg.yaml": FAKE_RUN, "evil.py": "open('sentinel', 'w').close()\nclass Evil: pass\n"},
    )
    path = folder.path / "bad.rrd"
    case.make(good, path)
    before = state(tmp_path)
    for name, words in COMMANDS.items():
        done = folder.run(*(str(path) if word == "REC" else word for word in words))
        lines = done.err.splitlines()
        assert "Traceback" not in done.err + done.out, f"{name}: {done.err}"
        assert done.code == (2 if name in case.refusing else 0), f"{name}: {done.err or done.out}"
        if name in case.refusing:
            assert 1 <= len(lines) <= 2, done.err
            assert lines[-1].startswith("error: ")
            assert str(path) in lines[-1]
            assert case.says in lines[-1]
            assert max(map(len, lines)) < 600
        assert state(tmp_path) == before, name
    printed = capfd.readouterr()
    assert "panicked" not in printed.err
    assert not (folder.path / "sentinel").exists()
