# ruff: noqa: E402  (threads must be set before numpy is imported)
"""Time of waypoints, windows, update and topology a key frame: does it grow with what was seen before?

    python benchmarks/memory.py [--frames 5000] [--json]

The first 100 key frames of a survey of `rs_int`, with the oracle's detections, go through the mapping side
of the mission (no simulator, no recording): once into an empty memory, then again and again as later visits
of the same home, and as visits of other homes far away, so that frames and viewpoints pile up to
`--frames`. Then the same 100 key frames, as one more visit, are timed against the first revisit. One
thread; medians over the frames.

Exit code 1 if a frame takes more than 1.3 times as long.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
from dataclasses import replace
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported: one thread

from dssmsg.config import Slot, load_config
from dssmsg.contexts import ContextFactory
from dssmsg.events import Detected, Event, FrameCaptured, RunStarted, StageTimed
from dssmsg.frame import Detection, Frame
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.read_only import ReadOnlyGraph
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.graph.waypoints import WaypointTopology
from dssmsg.guard import Guard
from dssmsg.host import Host
from dssmsg.interfaces import SourceInfo
from dssmsg.lift import Lifter
from dssmsg.mission.bus import ObserverBus
from dssmsg.mission.keyframes import KeyFrameRule, KeyFrameSelector
from dssmsg.mission.pipeline import Pipeline, Plugins
from dssmsg.mission.run import run_mission
from dssmsg.mission.topology import TopologyKeeper
from dssmsg.navigation.grid import GridOptions, RollingGrid

MAX_GROWTH = 1.3
KEY_FRAMES = 100
FAR_M = 60.0
STAGES = ("waypoints", "update", "topology")


class Keep:
    """Keeps the first key frames of a run with their detections."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.detections: list[tuple[Detection, ...]] = []
        self.info: SourceInfo | None = None

    def on_event(self, event: Event) -> None:
        """The source, key frames and what was detected in them."""
        if isinstance(event, RunStarted):
            self.info = event.source
        elif isinstance(event, FrameCaptured) and event.key_frame and len(self.frames) < KEY_FRAMES:
            self.frames.append(event.frame)
        elif isinstance(event, Detected) and len(self.detections) < len(self.frames):
            self.detections.append(event.detections)

    def close(self) -> None:
        """Nothing to close."""

    def outputs(self) -> dict[str, str]:
        """Nothing is written."""
        return {}


class Times(Keep):
    """Seconds of these stages, a frame."""

    def __init__(self) -> None:
        super().__init__()
        self.seconds: list[float] = []

    def on_event(self, event: Event) -> None:
        """Stage times."""
        if isinstance(event, StageTimed) and "update" in event.seconds:
            self.seconds.append(sum(event.seconds.get(stage, 0.0) for stage in STAGES))


class Given:
    """Perception that knows what was detected."""

    feature_space = None

    def __init__(self) -> None:
        self.next: tuple[Detection, ...] = ()

    def detect(self, frame: Frame) -> tuple[Detection, ...]:
        """The detections set beforehand."""
        return self.next


class Memory:
    """The mapping side of a mission, fed by hand."""

    def __init__(self, info: SourceInfo) -> None:
        config = load_config(None)
        host = Host.load((), config.base_dir)
        self.graph = SceneGraph()
        contexts = ContextFactory(
            host, 0, ReadOnlyGraph(self.graph), IdAllocator(), config.base_dir, Path(), "bench", source=info
        )
        built = {
            kind: host.build(kind, Slot(use="dssm"), contexts, base_dir=config.base_dir, key=kind).plugin
            for kind in ("association", "update")
        }
        self.times = Times()
        self.perception = Given()
        guard = Guard("fail", 600.0, report=lambda event: None, on_hang=lambda: None)
        self.pipeline = Pipeline(
            Plugins(
                self.perception,
                built["association"],
                built["update"],
                "perception/given",
                "association/dssm",
                "update/dssm",
                False,
            ),
            self.graph,
            WaypointTopology(self.graph, contexts.ids),
            Lifter(),
            KeyFrameSelector(KeyFrameRule()),
            guard,
            ObserverBus([("times", self.times)], guard.watching),
            TopologyKeeper(self.graph, contexts.ids, RollingGrid(GridOptions(noise=info.depth_noise_m))),
        )
        self.index = 0
        self.visits = 0

    def visit(self, kept: Keep, shift: float = 0.0) -> list[float]:
        """One visit of the home, `shift` metres away; seconds a key frame."""
        before = len(self.times.seconds)
        for frame, detections in zip(kept.frames, kept.detections, strict=True):
            moved = []
            for pose in (frame.world_from_camera, frame.world_from_base):
                other = pose.copy()
                other[0, 3] += shift
                moved.append(other)
            self.perception.next = detections
            again = replace(
                frame,
                index=self.index,
                sim_time=self.index * 0.2,
                visit=self.visits,
                world_from_camera=moved[0],
                world_from_base=moved[1],
            )
            self.pipeline.process(again, None, 0)
            self.index += 1
        self.pipeline.finish_visit(again)
        self.visits += 1
        return self.times.seconds[before:]


def survey() -> tuple[Keep, SourceInfo]:
    """The first key frames of `rs_int` with the oracle's detections."""
    config = load_config(
        None,
        sets=[
            "perception.use=oracle",
            "update.use=none",
            "mission.phases=[survey]",
            "mission.max_frames=300",
            "recording.observers.rerun=false",
        ],
    )
    kept = Keep()
    run_mission(config, Host.load(config.plugins, config.base_dir), observers=[("keep", kept)])
    if kept.info is None:
        raise SystemExit("the survey did not start")
    return kept, kept.info


def measure(frames: int) -> dict[str, float]:
    """Milliseconds a key frame in the first revisit and after `frames` key frames, and what was stored by
    then."""
    kept, info = survey()
    memory = Memory(info)
    memory.visit(kept)
    early = memory.visit(kept)
    viewpoints = len(memory.graph.viewpoints)
    away = 1
    while memory.index + len(kept.frames) < frames:
        memory.visit(kept, shift=0.0 if memory.visits % 2 else FAR_M * away)
        away += memory.visits % 2
    late = memory.visit(kept)
    ratio = statistics.median(late) / statistics.median(early)
    return {
        "key_frames": float(len(kept.frames)),
        "early_ms": 1000 * statistics.median(early),
        "late_ms": 1000 * statistics.median(late),
        "late_mean_ms": 1000 * statistics.fmean(late),
        "viewpoints_early": float(viewpoints),
        "viewpoints_late": float(len(memory.graph.viewpoints)),
        "frames": float(memory.index),
        "growth": ratio,
    }


def main() -> int:
    """Measure, print, judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=5000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    figures = measure(options.frames)
    if options.json:
        print(json.dumps(figures))
    else:
        for name, value in figures.items():
            print(f"{name:20} {value:10.2f}")
    return 0 if figures["growth"] <= MAX_GROWTH else 1


if __name__ == "__main__":
    sys.exit(main())
