"""Shared by all tests: strict Rerun, one thread, and one real run that many tests read."""

from __future__ import annotations

import os

os.environ["RERUN_STRICT"] = "1"
os.environ.setdefault("OMP_NUM_THREADS", "1")

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest


@dataclass(frozen=True)
class RealRun:
    """A run of the simulator that was made once: its summary, its recording and its change log."""

    summary: dict
    recording: Path
    change_log: Path


def real_run(folder: Path, *sets: str) -> RealRun:
    """Run the default mission in a process of its own, cut to some frames, in `folder`."""
    arguments = [sys.executable, "-m", "dssmsg", "run", "--json", "--set", "recording.observers.jsonl={}"]
    for assignment in sets:
        arguments += ["--set", assignment]
    done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    return RealRun(summary, folder / summary["recording"], folder / summary["outputs"]["changes"])


@pytest.fixture(scope="session")
def oracle_run(tmp_path_factory) -> RealRun:
    """150 frames of the default scene with `oracle`, lossless images."""
    folder = tmp_path_factory.mktemp("oracle")
    return real_run(
        folder, "perception.use=oracle", "mission.max_frames=150", "recording.observers.rerun.images=lossless"
    )
