"""What the stages of `verify.py` share: a row of its table, and running the program as a user does."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = {**os.environ, "RERUN_STRICT": "1", "OMP_WAIT_POLICY": "PASSIVE"}


@dataclass(frozen=True)
class Row:
    """One promise: what was asked, what was measured, whether it holds (None: reported only)."""

    what: str
    asked: str
    measured: str
    holds: bool | None


def dssmsg(*arguments: str, cwd: Path, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Run the program as a user does."""
    done = subprocess.run(
        [sys.executable, "-m", "dssmsg", *arguments],
        cwd=cwd,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
    )
    if check and done.returncode != 0:
        raise SystemExit(f"dssmsg {' '.join(arguments)} ended with {done.returncode}:\n{done.stderr[-2000:]}")
    return done


def run(cwd: Path, *sets: str, seed: int = 0) -> dict:
    """One run; its JSON summary with the wall time and the peak memory of the process (MB) added."""
    arguments = [sys.executable, "-m", "dssmsg", "run", "--json", "--seed", str(seed)]
    for assignment in sets:
        arguments += ["--set", assignment]
    start = time.monotonic()
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = subprocess.Popen(arguments, cwd=cwd, env=ENVIRONMENT, stdout=out, stderr=err)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        if process.returncode != 0:
            raise SystemExit(f"{' '.join(arguments)} ended with {process.returncode}:\n{err.read()[-2000:]}")
        summary = json.loads(out.read())
    return {**summary, "wall": time.monotonic() - start, "peak_mb": usage.ru_maxrss / 1000}


def measured_by(script: str, cwd: Path) -> dict:
    """What a benchmark of this folder prints as JSON, on one thread, whatever it thinks of its figures."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / script), "--json"],
        cwd=cwd,
        env={**ENVIRONMENT, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    figures: dict = json.loads(done.stdout)
    return figures


def recording_of(summary: dict, cwd: Path) -> Path:
    """Where the recording of a summary lies."""
    return (cwd / summary["recording"]).resolve()


def code_hash() -> str:
    """A hash of everything that a figure can depend on in this checkout."""
    digest = hashlib.sha256()
    for folder in ("dssmsg", "plugins", "benchmarks"):
        for file in sorted((ROOT / folder).rglob("*")):
            if file.is_file() and not {"__pycache__", "results"} & set(file.parts):
                digest.update(str(file.relative_to(ROOT)).encode() + file.read_bytes())
    return digest.hexdigest()[:16]
