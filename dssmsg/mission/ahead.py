"""The part of a replay that needs no map, done ahead of it by a process of its own.

A replay is open loop, so all its frames are known from the start: they can be decoded and checked, the
floor plan can follow them, and recorded detections can be lifted while the map still takes in earlier frames.
Everything comes out as it would in the replay itself, bit by bit: it is the same code. Where the helper
cannot go on (a damaged image, memory) it ends, and the replay does the rest on its own.
"""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, replace
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dssmsg import checks
from dssmsg.errors import InputError
from dssmsg.frame import ByteArray, Camera, Detection, Frame, MaskArray, Observation
from dssmsg.graph.topology import Point, Strip
from dssmsg.interfaces import SourceInfo
from dssmsg.lift import Lifted, Lifter
from dssmsg.mission.keyframes import KeyFrameRule, KeyFrameSelector
from dssmsg.mission.topology import FloorPlan
from dssmsg.navigation.grid import GridOptions, RollingGrid
from dssmsg.processes import collect_seldom, leave_group, start_sheltered
from dssmsg.recording.reader import Recording

_WAITING_FRAMES = 24
"""Frames that may wait for the replay, about a megabyte each."""


@dataclass(frozen=True, slots=True)
class Ready:
    """What was found out of a frame.

    depth_mm (H, W) uint16 and rgb (H, W, 3) uint8 of frames that the map looks at; `plan`: the floor plan
    after the frame; `lifted`: of a key frame with recorded detections, features left out, for they stay with
    these.
    """

    index: int
    depth_mm: NDArray[np.uint16] | None
    rgb: ByteArray | None
    plan: RollingGrid
    lifted: Lifted | None


@dataclass(frozen=True, slots=True)
class Task:
    """What the helper has to do: the file, its frames in the order of the replay, and how to treat them."""

    path: Path
    indices: Sequence[int]
    driven: frozenset[int]
    """Those that navigation sees: it wants the depth of all of them."""
    camera: Camera
    depth_noise_m: tuple[float, float]
    rule: KeyFrameRule
    lifts: bool
    """Whether the recorded detections are used again."""


class Ahead:
    """The helper, seen from the replay: `begin` its task, and ask for the frames in that order.

    It is started at once, for it takes a second until it can work: while the replay is put together. Used by
    `with`, which ends it. It imports the program's main module, which must do nothing when it is imported.
    """

    def __init__(self) -> None:
        # Not forked: Rerun holds threads.
        context = get_context("spawn")
        self._results, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs,), name="dssmsg-ahead", daemon=True)
        start_sheltered(self._process)
        theirs.close()  # only the helper holds that end now: it is told apart from a slow one when it dies
        self._latest: Ready | None = None
        self._ended = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def begin(self, task: Task) -> None:
        """Set the helper to work."""
        with suppress(OSError):  # it has ended: the replay does the work
            self._results.send(task)

    def take(self, index: int) -> Ready | None:
        """What is ready of a frame; waits for it. None from the first frame on of which there is nothing."""
        self._latest = None if self._ended else self._next()
        if self._latest is None or self._latest.index != index:
            self._latest, self._ended = None, True
        return self._latest

    def latest(self, index: int) -> Ready | None:
        """What `take` gave last, if it was of this frame."""
        return self._latest if self._latest is not None and self._latest.index == index else None

    def close(self) -> None:
        """End the helper; safe to call twice."""
        self._ended = True
        self._results.close()
        self._process.terminate()
        self._process.join()

    def _next(self) -> Ready | None:
        try:
            ready: Ready = self._results.recv()
        except (EOFError, OSError):  # it has done what it could, or was killed
            return None
        return ready


class RecordedLifter(Lifter):
    """Lifts recorded detections, with what was kept of each when they were recorded."""

    def __init__(self, recording: Recording) -> None:
        super().__init__()
        self._recording = recording

    def lift(
        self, frame: Frame, detections: Sequence[Detection], kept: Mapping[int, MaskArray] | None = None
    ) -> Lifted:
        """The observations of the recorded detections of a frame; they must be those that are given."""
        with suppress(InputError):  # damaged: it follows from what is there
            kept = self._recording.kept(frame.index)
        return super().lift(frame, detections, kept)


class AheadLifter(RecordedLifter):
    """Gives what the helper lifted; lifts itself where it has nothing."""

    def __init__(self, recording: Recording, ahead: Ahead) -> None:
        super().__init__(recording)
        self._ahead = ahead

    def lift(
        self, frame: Frame, detections: Sequence[Detection], kept: Mapping[int, MaskArray] | None = None
    ) -> Lifted:
        """The observations of the recorded detections of a frame; they must be those that are given."""
        ready = self._ahead.latest(frame.index)
        if ready is None or ready.lifted is None:
            return super().lift(frame, detections, kept)
        return replace(
            ready.lifted,
            observations=tuple(
                _with_features(one, detections[one.detection_index]) for one in ready.lifted.observations
            ),
        )


class AheadFloor:
    """The floor plan that the helper made; follows the frames itself from where the helper ended."""

    def __init__(self, ahead: Ahead, own: FloorPlan) -> None:
        self._ahead = ahead
        self._plan = own

    def forget(self) -> None:
        """Begin with an empty floor plan."""
        self._plan.forget()

    def observe(self, frame: Frame) -> None:
        """Take in a frame."""
        ready = self._ahead.latest(frame.index)
        if ready is None:
            self._plan.observe(frame)
        else:
            self._plan = ready.plan

    def corridor(self, start: Point, end: Point, half_width: float) -> Strip:
        """What is known of the strip of `half_width` metres along a straight leg."""
        return self._plan.corridor(start, end, half_width)


def _with_features(observation: Observation, detection: Detection) -> Observation:
    """An observation as the lifter gives it: read-only, with the features of its detection."""
    for name in ("points_world", "colors", "box_min", "box_max"):
        getattr(observation, name).flags.writeable = False
    return replace(observation, text_feature=detection.text_feature, image_feature=detection.image_feature)


# The helper's side.


def _work(results: Connection) -> None:
    leave_group()
    collect_seldom()
    _keep_freed_memory()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        task: Task = results.recv()
    except (EOFError, OSError):  # closed before there was anything to do
        return
    waiting: queue.Queue[Ready | None] = queue.Queue(_WAITING_FRAMES)
    sender = threading.Thread(target=_send, args=(waiting, results), daemon=True)
    sender.start()
    with suppress(Exception):  # the replay meets the same, in its place
        _go_through(task, waiting)
    waiting.put(None)
    sender.join()


def _keep_freed_memory() -> None:
    """Let freed memory stay with the process: a frame's arrays come and go, and a fifth of the time went into
    pages. The C library of Linux keeps twice what the largest block was that it has seen freed."""
    np.empty(24 << 20, np.uint8)


def _send(waiting: queue.Queue[Ready | None], results: Connection) -> None:
    """Sending waits for the replay; the work goes on meanwhile."""
    with suppress(OSError):  # nobody listens any more
        while (ready := waiting.get()) is not None:
            results.send(ready)
    results.close()


def _end_with_parent() -> None:
    """End this process with the replay, also where that was killed: nobody would take what it makes."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _go_through(task: Task, waiting: queue.Queue[Ready | None]) -> None:
    info = SourceInfo("recording", task.camera, drivable=False, has_truth=False)
    selector = KeyFrameSelector(task.rule)
    plan = RollingGrid(GridOptions(noise=task.depth_noise_m))
    before: Frame | None = None
    with Recording.open(task.path) as recording:
        lifter = RecordedLifter(recording)
        for index in task.indices:
            frame = recording.frame(index, lazy=True)
            checks.check_frame(frame, info, before)
            if before is None or frame.visit != before.visit:
                plan.forget()
            plan.observe(frame)
            rgb, lifted, key = None, None, selector.is_key(frame)
            if key:
                rgb = frame.rgb
                detections = recording.detections(index) if task.lifts else None
                if detections is not None:
                    lifted = lifter.lift(frame, checks.check_detections(frame, detections))
                    lifted = replace(lifted, observations=tuple(map(_bare, lifted.observations)))
            millimetres = None
            if key or index in task.driven:
                millimetres = np.rint(frame.depth * np.float32(1000.0)).astype(np.uint16)
            # A copy: the plan goes on while this one waits to be sent.
            waiting.put(Ready(index, millimetres, rgb, deepcopy(plan), lifted))
            before = frame


def _bare(observation: Observation) -> Observation:
    return replace(observation, text_feature=None, image_feature=None)
