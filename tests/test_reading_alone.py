"""Reading commands alone: without simulator, ray caster and model runtime; without a recording's name."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from project import FAKE_RUN, environment, project
from recorded_run import SyntheticRun, record

WITHOUT = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("pybullet", "open3d", "onnxruntime"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
from dssmsg.cli import main
sys.exit(main())
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(SyntheticRun(12), tmp_path_factory.mktemp("alone") / "run.rrd")


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", WITHOUT, *arguments],
        cwd=folder, env=environment(), capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["inspect"], "complete   yes"),
        (["explain", "--object", "object-1"], "first seen as chair"),
        (["export", "--format", "graphml"], "<graphml"),
    ],
)
def test_it_reads(path: Path, arguments: list[str], says: str) -> None:
    done = run(path.parent, arguments[0], str(path), *arguments[1:])
    assert done.returncode == 0, done.stderr
    assert says in done.stdout
    assert done.stderr == ""


def test_query_takes_the_recorded_vectors_and_the_lexicon_and_says_so(path: Path) -> None:
    done = run(path.parent, "query", str(path), "the chair", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["target"]["nodes"][0]["label"] == "chair"
    assert answer["candidates"][0]["matching"] == {"0": "object-1"}
    assert "onnxruntime" in done.stderr
    assert "recorded vectors" in done.stderr


@pytest.mark.parametrize(
    "words", [["inspect"], ["explain", "--object", "object-1"], ["export"], ["query", "a chair"]]
)
def test_the_newest_is_read_where_none_is_named_and_it_is_said(
    words: list[str], path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    data = path.read_bytes()
    files = {"recordings/b.rrd": data, "recordings/a.rrd": data, "recordings/c.rrd": b"older, and broken"}
    folder = project(tmp_path, {"dssmsg.yaml": FAKE_RUN, **files})
    for age, name in enumerate("abc"):
        os.utime(tmp_path / "recordings" / f"{name}.rrd", (9000 - age, 9000 - age))
    done = folder.run(*words)
    assert done.code == 0, done.err
    assert "reading recordings/a.rrd" in done.err.splitlines()
