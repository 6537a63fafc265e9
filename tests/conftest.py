"""Shared by all tests: strict Rerun, one thread, and one real run that many tests read."""

from __future__ import annotations

import os

os.environ["RERUN_STRICT"] = "1"
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # many tests start the program: its byte code is kept

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from filelock import FileLock


@dataclass(frozen=True)
class RealRun:
    """A run of the simulator that was made once: its summary, its recording and its change log."""

    summary: dict
    recording: Path
    change_log: Path

    @classmethod
    def of(cls, summary: dict, folder: Path) -> RealRun:
        """What a run in a folder left there."""
        return cls(summary, folder / summary["recording"], folder / summary["outputs"]["changes"])


def real_run(folder: Path, *sets: str) -> RealRun:
    """Run the default mission in a process of its own, cut to some frames, in `folder`."""
    arguments = [sys.executable, "-m", "dssmsg", "run", "--json", "--set", "recording.observers.jsonl={}"]
    for assignment in sets:
        arguments += ["--set", assignment]
    done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return RealRun.of(json.loads(done.stdout), folder)


@pytest.fixture(scope="session")
def oracle_run(tmp_path_factory) -> RealRun:
    """150 frames of the default scene with `oracle`, lossless images; made once for all workers."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "oracle"
    summary = folder / "summary.json"
    with FileLock(f"{folder}.lock"):
        if not summary.exists():
            folder.mkdir(exist_ok=True)
            images = "recording.observers.rerun.images=lossless"
            made = real_run(folder, "perception.use=oracle", "mission.max_frames=150", images)
            summary.write_text(json.dumps(made.summary))
    return RealRun.of(json.loads(summary.read_text()), folder)
