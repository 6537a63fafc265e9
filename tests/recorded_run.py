"""A synthetic run as events, for tests and benchmarks of the recording: made by rules, from a seed.

A robot goes round a room with a ring of furniture; every third frame is a key frame that sees the objects
ahead. The graph is a real `SceneGraph`: what `events` tells is what its `live` graph went through.
"""

from __future__ import annotations

import itertools
import logging
import math
import os
from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from dssmsg import events as ev
from dssmsg.frame import Camera, Detection, Frame, Truth, TruthObject, quantise_depth
from dssmsg.graph import changes as ch
from dssmsg.graph.changes import Cause, Change, Score
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.interfaces import Context
from dssmsg.interfaces.source import Command, SourceInfo

os.environ.setdefault("RERUN_STRICT", "1")  # the SDK would otherwise turn its errors into warnings

LABELS = ("chair", "table", "sofa", "lamp", "plant", "cabinet", "television", "bed", "mug", "book")
CAUSE = Cause("association/dssm", "merge")
RADIUS = 3.0


def context(run_dir: Path, run_id: str = "synthetic", base_dir: Path | None = None) -> Context:
    """The surroundings of a plug-in under test."""

    def build(kind: str, slot: Any) -> Any:
        raise AssertionError(f"no plug-in of kind {kind} is built here, not {slot}")

    return Context(
        seed=0,
        rng=np.random.default_rng(0),
        graph=SceneGraph(),
        ids=IdAllocator(),
        log=logging.getLogger("dssmsg.test"),
        base_dir=base_dir or run_dir,
        run_dir=run_dir,
        run_id=run_id,
        build=build,
    )


def record(run: SyntheticRun, path: Path, **options: Any) -> Path:
    """Write a run's events to a finished recording, in this thread."""
    from dssmsg.recording.repair import optimize
    from dssmsg.recording.writer import RecordingWriter

    writer = RecordingWriter(path, run.run_id, **options)
    for number, event in enumerate(run.events()):
        writer.write(event)
        if number % 40 == 39:
            writer.flush()
    writer.close()
    optimize(path)
    return path


class SyntheticRun:
    """Events of a run of `frames` frames over a map of `objects` objects."""

    def __init__(
        self,
        frames: int = 30,
        *,
        objects: int = 12,
        width: int = 64,
        height: int = 48,
        seed: int = 0,
        truth: bool = True,
        run_id: str = "synthetic",
        remember: bool = True,
    ) -> None:
        self.run_id = run_id
        self.frames = frames
        self.live = SceneGraph()
        self.rng = np.random.default_rng(seed)
        self.seed = seed
        self.truth = truth
        self.camera = Camera.from_fov(width, height, 1.2)
        self.spots = [
            (RADIUS * math.cos(angle), RADIUS * math.sin(angle), 0.4)
            for angle in np.linspace(0.0, 2 * math.pi, objects, endpoint=False)
        ]
        self.remember = remember
        self.told: list[Change] = []
        self._near: set[tuple[str, str]] = set()
        self._sees: set[tuple[str, str]] = set()

    def events(self) -> Iterator[ev.Event]:
        """All events, first to last."""
        yield self.started()
        yield ev.PhaseStarted("survey", 0, 0, 0.0)
        for index in range(self.frames):
            if index == self.frames // 2:
                yield ev.PhaseStarted("revisit", 1, index, index * 0.2)
            yield from self.frame_events(index)
        yield self.finished()

    def started(self) -> ev.RunStarted:
        """The first event."""
        info = SourceInfo(
            name="synthetic",
            camera=self.camera,
            drivable=True,
            has_truth=self.truth,
            visits=2,
            scene="ring",
            credits=("furniture: nobody",),
        )
        return ev.RunStarted(
            run_id=self.run_id,
            name="synthetic",
            seed=self.seed,
            config={"name": "synthetic", "source": {"use": "synthetic"}},
            source=info,
            plugins={"perception": {"name": "synthetic", "version": "1", "origin": "tests"}},
            versions={"dssmsg": "0"},
            feature_space="toy/8",
        )

    def finished(self) -> ev.RunFinished:
        """The last event."""
        last = self.frames - 1
        return ev.RunFinished(last, last * 0.2, {"seed": self.seed, "frames": self.frames, "errors": 0})

    def frame_events(self, index: int) -> Iterator[ev.Event]:
        """What is told of one frame."""
        frame = self.frame(index)
        key = index % 3 == 0
        ahead = self._ahead(index) if key else []
        detections = tuple(self._detection(number, slot) for slot, number in enumerate(ahead))
        applied = self._changes(frame, ahead) if key else ()
        viewpoint = self._viewpoint(index) if key else None
        yield ev.FrameCaptured(
            frame.without_truth(), Command(0.3, 0.1, 0.0, -0.2), key, viewpoint, index // 10
        )
        if frame.truth is not None:
            yield ev.TruthSeen(index, frame.sim_time, frame.truth)
        if key:
            yield ev.Detected(index, frame.sim_time, detections, ())
        if applied:
            if self.remember:
                self.told += applied
            yield ev.GraphChanged(index, frame.sim_time, applied)
        if index % 15 == 0:
            state = ("drive", "look", "turn")[index // 15 % 3]
            yield ev.NavigationChanged(index, frame.sim_time, state, f"stop {index // 15}")
        if index == 4:
            yield ev.ErrorOccurred(
                index, frame.sim_time, "perception/synthetic", "NaN in a box", "1 detection"
            )
        yield ev.Logged(index, frame.sim_time, "dssmsg.mission", "INFO", f"frame {index}")
        yield ev.StageTimed(index, frame.sim_time, {"source": 0.02, "perception": 0.01 * key})

    def frame(self, index: int) -> Frame:
        """The frame of an index."""
        height, width = self.camera.height, self.camera.width
        rgb = self.rng.integers(0, 40, (height, width, 3), dtype=np.uint8)
        rgb[:, :, 0] += (np.arange(width) * 200 // width).astype(np.uint8)
        rgb[:, :, 1] += np.uint8(index * 7 % 200)
        depth = quantise_depth(1.0 + 2.0 * self.rng.random((height, width)))
        pose = self.pose(index)
        base = np.eye(4)
        base[:2, 3] = pose[:2, 3]
        ids = np.zeros((height, width), dtype=np.int32)
        ids[height // 4 : height // 2, width // 4 : width // 2] = 1 + index % len(self.spots)
        truth = Truth(ids, self._truth_objects(index)) if self.truth else None
        return Frame(
            index=index,
            sim_time=index * 0.2,
            rgb=rgb,
            depth=depth,
            camera=self.camera,
            world_from_camera=pose,
            world_from_base=base,
            visit=0 if index < self.frames // 2 else 1,
            at_stop=index % 2 == 0,
            truth=truth,
        )

    def pose(self, index: int) -> np.ndarray:
        """world_from_camera (4, 4) of a frame: on a circle, looking outwards."""
        angle = 2 * math.pi * index / 60
        forward = np.array([math.cos(angle), math.sin(angle), 0.0])
        right = np.array([math.sin(angle), -math.cos(angle), 0.0])
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.array([0.0, 0.0, -1.0]), forward], axis=1)
        pose[:3, 3] = 0.8 * forward + (0.0, 0.0, 0.88)
        return pose

    def _truth_objects(self, index: int) -> tuple[TruthObject, ...]:
        return tuple(
            TruthObject(
                instance_id=number + 1,
                name=f"thing {number}",
                label=LABELS[number % len(LABELS)],
                box_min=np.array(spot) - 0.2,
                box_max=np.array(spot) + 0.2,
                state="appeared" if number == 0 and index >= self.frames // 2 else "static",
            )
            for number, spot in enumerate(self.spots)
        )

    def _ahead(self, index: int) -> list[int]:
        angle = 2 * math.pi * index / 60
        headings = [abs(math.remainder(math.atan2(y, x) - angle, 2 * math.pi)) for x, y, _ in self.spots]
        return [number for number, off in enumerate(headings) if off < 0.7]

    def _detection(self, number: int, slot: int) -> Detection:
        height, width = self.camera.height, self.camera.width
        mask = np.zeros((height, width), dtype=bool)
        x = min(2 + slot * 9, width - 8)
        mask[10:30, x : x + 7] = True
        mask[11, x + 1] = False
        return Detection(
            mask=mask,
            box_xyxy=np.array([x, 10.0, x + 7, 30.0]),
            label=LABELS[number % len(LABELS)],
            score=0.5 + 0.04 * (number % 10),
            text_feature=self._feature(number % len(LABELS)),
            image_feature=None if number % 2 else self._feature(100 + number),
            label_scores=(("thing", 0.25),),
        )

    def _feature(self, number: int) -> np.ndarray:
        vector = np.random.default_rng(number).normal(size=8).astype(np.float32)
        return vector / np.float32(np.linalg.norm(vector))

    def _viewpoint(self, index: int) -> str:
        return f"viewpoint-{1 + index // 15 % 4}.1"

    def _changes(self, frame: Frame, ahead: list[int]) -> tuple[Change, ...]:
        viewpoint = self._viewpoint(frame.index)
        waypoint = viewpoint.replace("viewpoint", "waypoint").removesuffix(".1")
        changes: list[Change] = []
        place = Cause("graph/waypoints", "place")
        if waypoint not in self.live.waypoints:
            before = list(self.live.waypoints)
            position = frame.world_from_base[:3, 3]
            changes.append(ch.WaypointAdded(cause=place, waypoint_id=waypoint, position=position))
            if before:
                changes.append(
                    ch.EdgeAdded(
                        cause=place,
                        edge="path",
                        source=before[-1],
                        target=waypoint,
                        attributes={"length": 0.8, "verified": "driven", "blocked": False},
                    )
                )
        if viewpoint not in self.live.viewpoints:
            changes.append(
                ch.ViewpointAdded(
                    cause=place,
                    viewpoint_id=viewpoint,
                    waypoint_id=waypoint,
                    world_from_camera=frame.world_from_camera,
                    heading=frame.heading_rad,
                    tilt=frame.tilt_rad,
                )
            )
        else:
            changes.append(ch.ViewpointSeen(cause=place, viewpoint_id=viewpoint))
        names = [f"object-{number + 1}" for number in ahead]
        for number, name in zip(ahead, names, strict=True):
            changes += self._sighting(number, name, viewpoint)
        applied = list(self.live.apply_all(changes, frame.index, frame.sim_time))
        edges: list[Change] = []
        seen = Cause("graph/edges", "seen together")
        for name in names:
            if (viewpoint, name) not in self._sees:
                self._sees.add((viewpoint, name))
                edges.append(
                    ch.EdgeAdded(
                        cause=seen, edge="sees", source=viewpoint, target=name, attributes={"distance": 2.2}
                    )
                )
        for first, second in itertools.pairwise(names):
            pair = (first, second) if int(first[7:]) < int(second[7:]) else (second, first)
            if pair not in self._near:
                self._near.add(pair)
                edges.append(
                    ch.EdgeAdded(
                        cause=seen,
                        edge="near",
                        source=pair[0],
                        target=pair[1],
                        attributes={"distance": 0.4, "relation": "next to"},
                    )
                )
        applied += self.live.apply_all(edges, frame.index, frame.sim_time)
        return tuple(applied)

    def _sighting(self, number: int, name: str, viewpoint: str) -> list[Change]:
        cloud = (self.rng.random((60, 3)) - 0.5) * (0.5, 0.5, 0.6) + self.spots[number]
        seen = {
            "object_id": name,
            "label": LABELS[number % len(LABELS)],
            "score": 0.9,
            "points": cloud.astype(np.float32),
            "colors": self.rng.integers(0, 255, (60, 3), dtype=np.uint8),
            "viewpoint_id": viewpoint,
            "range_m": 2.2,
            "text_feature": self._feature(number % len(LABELS)),
        }
        scores = (Score("s_geo", 0.8), Score("s_sem", 0.95), Score("s", 1.75, 1.1))
        thing = self.live.objects.get(name)
        if thing is None:
            return [ch.ObjectAdded(cause=CAUSE, scores=scores[:2], **seen)]
        changes: list[Change] = [ch.ObjectMerged(cause=CAUSE, scores=scores, **seen)]
        if thing.status == "tentative" and thing.observations >= 2:
            changes.append(
                ch.ObjectChanged(
                    cause=Cause("association/dssm", "believe"),
                    object_id=name,
                    values=MappingProxyType({"status": "believed"}),
                )
            )
        return changes
