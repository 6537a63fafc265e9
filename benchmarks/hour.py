"""What reading an hour costs: seconds and memory of each command on a recording of 18,000 frames.

    python benchmarks/hour.py [--frames 18000] [--file hour.rrd] [--object object-12]

The recording is made once, if FILE is not there: synthetic events (tests/recorded_run.py), 320x240 images at
5 Hz, every third a key frame, through the real writer. Each command runs in a process of its own; the page
cache holds the file, as it does after a run.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from recorded_run import SyntheticRun

from dssmsg import events as ev
from dssmsg.frame import Frame, Truth, quantise_depth
from dssmsg.recording.repair import optimize
from dssmsg.recording.writer import RecordingWriter

_PERIOD = 60  # frames until the synthetic robot is back where it was
_WINDOW = 8
_EPISODE_FRAMES = 600
_FEATURE_LENGTH = 512
_FLUSH_FRAMES = 25  # a second of a mission's wall time


class HourRun(SyntheticRun):
    """A synthetic run as large as a real one: smooth depth, long features, windows, queries, episodes."""

    def frame(self, index: int) -> Frame:
        """The frame of an index: the pictures of one round, again and again."""
        rgb, depth, ids = self._pictures[index % _PERIOD]
        pose = self.pose(index)
        base = np.eye(4)
        base[:2, 3] = pose[:2, 3]
        truth = Truth(ids, self._truth_objects(index)) if self.truth else None
        return Frame(
            index=index,
            sim_time=index * 0.2,
            rgb=rgb,
            depth=depth,
            camera=self.camera,
            world_from_camera=pose,
            world_from_base=base,
            visit=2 * index // self.frames,
            at_stop=index % 2 == 0,
            truth=truth,
        )

    def frame_events(self, index: int) -> Iterator[ev.Event]:
        """What is told of one frame, windows and episodes too."""
        ahead: list[int] = []
        for event in super().frame_events(index):
            yield event
            if isinstance(event, ev.Detected):
                ahead = self._ahead(index)
        if ahead:
            yield self._window(index, ahead)
        if index % _EPISODE_FRAMES == _EPISODE_FRAMES - 1:
            yield from self._episode(index)

    @cached_property
    def _pictures(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        height, width = self.camera.height, self.camera.width
        y, x = np.mgrid[:height, :width]
        pictures = []
        for index in range(_PERIOD):
            waves = np.sin(x / 23.0 + index) + np.sin(y / 17.0 - 0.5 * index)
            noise = self.rng.normal(0.0, 2.0, (height, width, 3))
            rgb = np.clip(waves[..., None] * (40, 30, 20) + 120 + noise, 0, 255).astype(np.uint8)
            depth = 2.5 + 0.4 * waves
            depth = quantise_depth(depth + self.rng.normal(0.0, 0.002, depth.shape) * depth**2 / 4)
            ids = (1 + (x // 40 + y // 60 + index) % len(self.spots)).astype(np.int32)
            pictures.append((rgb, depth, ids))
        return pictures

    def _feature(self, number: int) -> np.ndarray:
        return _unit_vector(number)

    def _window(self, index: int, ahead: Sequence[int]) -> ev.WindowEvaluated:
        frames = tuple(range(max(0, index - 3 * _WINDOW), index + 1, 3))
        evidence = tuple(
            ev.Evidence(frame, f"object-{number + 1}", "seen", {"overlap": 0.8, "behind_m": 0.02})
            for frame in frames
            for number in ahead[:6]
        )
        verdicts = {f"object-{ahead[0] + 1}": "static"} if index % 90 == 0 else {}
        return ev.WindowEvaluated(
            self._viewpoint(index), index, index * 0.2, frames[:4], frames[4:], evidence, verdicts, 3
        )

    def _episode(self, index: int) -> Iterator[ev.Event]:
        number, now = index // _EPISODE_FRAMES, index * 0.2
        goal = f"the lamp beside the sofa, {number}"
        yield ev.LlmCalled("target_graph", "lexicon", index, now, goal, "{}", f"{number:032x}", True)
        candidates = tuple(
            ev.Candidate(name, rank, {"score": 2.0 / rank, "s_node": 1.0 / rank}, {"0": "object-4"}, "a lamp")
            for rank, name in enumerate(self.live.viewpoints, 1)
        )
        target = {"kind": "explicit", "nodes": [{"label": "lamp", "attributes": []}], "edges": [], "core": 0}
        yield ev.Matched(goal, index, now, target, candidates)
        yield ev.EpisodeEnded(number, goal, "success", "", index, now, {"spl": 0.9})


@cache
def _unit_vector(number: int) -> np.ndarray:
    vector = np.random.default_rng(number).normal(size=_FEATURE_LENGTH).astype(np.float32)
    return vector / np.float32(np.linalg.norm(vector))


def make(path: Path, frames: int, objects: int, seed: int = 0) -> None:
    """Write the recording, unless it is there. Raises StorageError where it cannot be written."""
    if path.exists():
        return
    run = HourRun(frames, objects=objects, width=320, height=240, seed=seed, remember=False)
    start = time.perf_counter()
    unfinished = path.with_suffix(".part.rrd")
    unfinished.unlink(missing_ok=True)
    writer = RecordingWriter(unfinished, path.stem)
    flushed = 0
    for event in run.events():
        writer.write(replace(event, run_id=path.stem) if isinstance(event, ev.RunStarted) else event)
        if isinstance(event, ev.StageTimed) and event.frame >= flushed + _FLUSH_FRAMES:
            flushed = event.frame
            writer.flush()
    writer.close()
    optimize(unfinished)
    unfinished.rename(path)
    print(f"{path}: made in {time.perf_counter() - start:.0f} s, {run.live.updates} changes")


def measure(arguments: Sequence[str], repeats: int) -> dict[str, float]:
    """Median seconds (wall, CPU) and the most resident memory in MB of a command in a process of its own."""
    seconds, cpu, memory = [], [], []
    for _ in range(repeats):
        start = time.perf_counter()
        child = subprocess.Popen(
            [sys.executable, "-m", "dssmsg", *arguments], stdout=subprocess.DEVNULL, env={**os.environ}
        )
        _, status, usage = os.wait4(child.pid, 0)
        seconds.append(time.perf_counter() - start)
        cpu.append(usage.ru_utime + usage.ru_stime)
        memory.append(usage.ru_maxrss / 1e3)  # kB on Linux
        if status:
            raise SystemExit(f"dssmsg {' '.join(arguments)}: status {status}")
    return {
        "seconds": float(np.median(seconds)),
        "cpu_seconds": float(np.median(cpu)),
        "megabytes": max(memory),
    }


def commands(path: Path, object_id: str, frames: int) -> dict[str, list[str]]:
    """Name -> arguments of what is measured."""
    name = str(path)
    return {
        "inspect": ["inspect", name, "--json"],
        "explain --object": ["explain", name, "--object", object_id, "--json"],
        "explain --episode": ["explain", name, "--episode", str(frames // _EPISODE_FRAMES - 1), "--json"],
        "query": ["query", name, "the lamp beside the sofa", "--json"],
        "export": ["export", name],
        "diff with itself": ["diff", name, name, "--json"],
        "export --at the middle": ["export", name, "--at", f"frame={frames // 2}"],
    }


def main() -> None:
    """Make the recording if it is not there, and print a row a command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=18_000)
    parser.add_argument("--objects", type=int, default=60)
    parser.add_argument("--file", type=Path, default=Path("hour.rrd"))
    parser.add_argument("--object", default="object-12")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    make(options.file, options.frames, options.objects)
    rows = {
        name: measure(arguments, options.repeats)
        for name, arguments in commands(options.file, options.object, options.frames).items()
    }
    if options.json:
        print(json.dumps({"bytes": options.file.stat().st_size, "commands": rows}, indent=2))
        return
    print(f"{options.file}: {options.file.stat().st_size / 1e6:.0f} MB, {options.frames} frames")
    for name, row in rows.items():
        times = f"{row['seconds']:>7.2f} s{row['cpu_seconds']:>7.2f} s of CPU"
        print(f"{name:<24}{times}{row['megabytes']:>8.0f} MB")


if __name__ == "__main__":
    main()
