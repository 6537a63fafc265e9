"""The stages of `verify.py` about the inspector: diagnosis, replay, diff, and what reading costs.

The episodes of the diagnosis are kept in the temporary folder until the stage is done, by the hash of the
code, so that a stage that was cut goes on where it stopped.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from homes import JOBS
from staging import ENVIRONMENT, Row, code_hash, dssmsg, recording_of, run

HERE = Path(__file__).resolve().parent
EPISODES, HEALTHY = 60, 30
"""Of 120 seeds the odd half, on which no rule was developed."""
ACCURACY = {"with_truth": 0.80, "without_truth": 0.60}
MAX_WRONG = 0.10
MIN_FASTER = 5.0
HOUR = {"inspect": 5, "explain --object": 5, "explain --episode": 5, "diff with itself": 15}
MAX_MB = 1000
LOSSLESS = "recording.observers.rerun.images=lossless"


def diagnosis(cwd: Path) -> list[Row]:
    """Known faults, the unseen half: does `explain` name the right layer?"""
    work = Path(tempfile.gettempdir()) / f"dssmsg-diagnosis-{code_hash()}"
    asked = ("--half", "reported", "--episodes", str(EPISODES), "--healthy", str(HEALTHY))
    done = dssmsg("eval", "diagnosis", *asked, "--jobs", JOBS, "--work", str(work), "--json", cwd=cwd)
    figures = {row["metric"]: row for row in json.loads(done.stdout)}
    rows = []
    for basis, least in ACCURACY.items():
        right, wrong = figures[f"layer_accuracy_{basis}"], figures[f"wrong_{basis}"]
        silent = figures[f"healthy_silent_{basis}"]
        words = basis.replace("_", " ")
        rows += [
            Row(
                f"right layer, {words}",
                f">= {least:.2f}",
                f"{right['mean']:.2f} of {right['n']}",
                right["mean"] >= least,
            ),
            Row(
                f"... wrong layer, {words}",
                f"<= {MAX_WRONG:.2f}",
                f"{wrong['mean']:.2f}",
                wrong["mean"] <= MAX_WRONG,
            ),
            Row(
                f"... healthy episodes without a claim, {words}",
                "all of 30",
                f"{silent['mean']:.2f} of {silent['n']}",
                silent["mean"] == 1.0 and silent["n"] >= HEALTHY,
            ),
        ]
    shutil.rmtree(work)
    return rows


def replaying(cwd: Path) -> list[Row]:
    """The default run on lossless images and its replay, in turn: time and change log."""
    faster, parts = [], []
    for _ in range(3):
        made = run(cwd, LOSSLESS)
        path = str(recording_of(made, cwd))
        again = json.loads(dssmsg("replay", path, "--json", cwd=cwd).stdout)
        faster.append(made["seconds"]["total"] / again["seconds"]["total"])
        found = json.loads(dssmsg("diff", path, str(recording_of(again, cwd)), "--json", cwd=cwd).stdout)
        parts.append("nowhere" if found["same"] and not found["traces"] else "somewhere")
    middle = statistics.median(faster)
    each = ", ".join(f"{one:.1f}" for one in faster)
    return [
        Row(
            "replay of a lossless recording: parts from it",
            "nowhere",
            ", ".join(parts),
            set(parts) == {"nowhere"},
        ),
        Row(
            "... against the run, median of 3",
            ">= 5 x (aim 20)",
            f"{middle:.1f} x ({each})",
            middle >= MIN_FASTER,
        ),
    ]


def hour(cwd: Path) -> list[Row]:
    """What reading an hour costs: wall time and memory of each command."""
    done = subprocess.run(
        [sys.executable, str(HERE / "hour.py"), "--file", str(cwd / "hour.rrd"), "--json"],
        cwd=cwd,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    figures = json.loads(done.stdout[done.stdout.index("{") :])["commands"]
    return [
        Row(
            f"18,000 frames: {name}",
            "reported" if name not in HOUR else f"<= {HOUR[name]} s, {MAX_MB} MB",
            f"{row['seconds']:.1f} s, {row['megabytes']:.0f} MB",
            None if name not in HOUR else row["seconds"] <= HOUR[name] and row["megabytes"] <= MAX_MB,
        )
        for name, row in figures.items()
    ]


def many(cwd: Path) -> list[Row]:
    """500 recordings searched: read for the first time, and remembered."""
    done = subprocess.run(
        [sys.executable, str(HERE / "episodes.py"), "--json"],
        cwd=cwd,
        env={**os.environ, **ENVIRONMENT},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return [
        Row(f"episodes of 500 recordings, {name}", "<= 5 s", f"{row['seconds']:.1f} s", row["seconds"] <= 5)
        for name, row in json.loads(done.stdout).items()
    ]


STAGES: dict[str, Callable[[Path], list[Row]]] = {
    "replaying": replaying,
    "hour": hour,
    "many": many,
    "diagnosis": diagnosis,
}
