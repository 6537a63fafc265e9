"""How long `dssmsg episodes` takes over many recordings: read for the first time, and remembered.

    python benchmarks/episodes.py [--runs 500] [--frames 6] [--folder FOLDER] [--json]

Writes small recordings (kept in FOLDER where it is given, and used again), then times the whole command in
processes of its own: cold, and with what was remembered. Wall time depends on who else works on the machine;
processor time less so.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from recorded_run import SyntheticRun, record

from dssmsg import events as ev

WHERE = "outcome == 'wrong match' and seconds > 10"


class Seeking(SyntheticRun):
    """A short run with two episodes, one of which fails in every third run."""

    def events(self) -> Iterator[ev.Event]:
        for event in super().events():
            if isinstance(event, ev.RunFinished):
                told = []
                for number in range(2):
                    failed = number == 1 and self.seed % 3 == 0
                    outcome, reason = ("failure", "wrong match") if failed else ("success", "")
                    told.append({"goal": f"goal {number}", "outcome": outcome, "reason": reason})
                    frame = event.frame - 1 + number
                    values = {"seconds": float(self.seed % 90), "metres": 4.0}
                    yield ev.EpisodeEnded(
                        number, f"goal {number}", outcome, reason, frame, 0.2 * frame, values
                    )
                event = ev.RunFinished(event.frame, event.sim_time, {**event.summary, "episodes": told})
            yield event


def make(folder: Path, runs: int, frames: int) -> None:
    """Write the recordings that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(runs):
        path = folder / f"run-{seed:04d}.rrd"
        if not path.exists():
            record(Seeking(frames, objects=4, seed=seed, run_id=path.stem), path)


def measure(folder: Path, cache: Path) -> tuple[float, float, int]:
    """(wall seconds, processor seconds, lines printed) of the command, start of Python included."""
    command = [sys.executable, "-c", "import sys; from dssmsg.cli import main; sys.exit(main())"]
    environment: Mapping[str, str] = {**os.environ, "XDG_CACHE_HOME": str(cache)}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    done = subprocess.run(
        [*command, "episodes", str(folder), "--where", WHERE],
        capture_output=True,
        text=True,
        env=environment,
        check=True,
    )
    wall = time.perf_counter() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall, used, len(done.stdout.splitlines())


def main() -> None:
    parser = argparse.ArgumentParser(description="Time of `dssmsg episodes` over many recordings.")
    parser.add_argument("--runs", type=int, default=500)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="dssmsg-episodes-") as scratch:
        folder = arguments.folder or Path(scratch) / "recordings"
        make(folder, arguments.runs, arguments.frames)
        cache = Path(scratch) / "cache"
        measured = {name: measure(folder, cache) for name in ("cold", "remembered")}
    if arguments.json:
        print(
            json.dumps(
                {name: {"seconds": wall, "cpu_seconds": used} for name, (wall, used, _) in measured.items()}
            )
        )
        return
    for name, (wall, used, lines) in measured.items():
        print(
            f"{name}: {arguments.runs} recordings in {wall:.2f} s ({used:.2f} s of processor), {lines} lines"
        )


if __name__ == "__main__":
    main()
