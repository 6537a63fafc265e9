"""Replay: the frames of a recording through other plug-ins, faster than real time and without a simulator.

Open loop: the robot does what it did. Everything that follows from what it saw is done anew: key frames,
viewpoints, topology, windows, grounding, the state machine of the episodes with navigation's changes of the
graph. Recorded are the commands, the looks on purpose (`at_stop`) and the driver's states before seek, since
the tour is not in the recording. What navigation asks for now is told as advice.

With the plug-ins that were recorded, on lossless images, the change log is the same, byte for byte.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any

from dssmsg import checks
from dssmsg.config import RunConfig
from dssmsg.errors import InputError
from dssmsg.events import Advised, ErrorOccurred, NavigationChanged, RunStarted
from dssmsg.frame import Frame
from dssmsg.guard import LastWords, say_on_stderr
from dssmsg.host import Host
from dssmsg.interfaces import Command, Observer
from dssmsg.lift import Lifter
from dssmsg.mission.ahead import Ahead, AheadFloor, AheadLifter, RecordedLifter, Task
from dssmsg.mission.keyframes import key_frame_rule
from dssmsg.mission.run import Mission, RunResult
from dssmsg.mission.topology import FloorPlan
from dssmsg.recording.lazy_frame import looking
from dssmsg.recording.reader import Recording

DRIVE_OVER = "recorded drive over"
"""Why an episode ends whose robot, in the recording, drove no further."""
_SEEK = "seek"


def replay_mission(
    config: RunConfig,
    host: Host,
    recording: Recording,
    *,
    observers: Sequence[tuple[str, Observer]] = (),
    last_words: LastWords = say_on_stderr,
    ahead: Ahead | None = None,
) -> RunResult:
    """Carry out a replay that `plan_replay` put together; raises what `run_mission` raises.

    `ahead`: a second process that does what needs no map; for the caller to close.
    """
    task = None if ahead is None else _task(config, recording)
    if ahead is not None and task is not None:
        ahead.begin(task)
    with config.naming_files():
        helper = None if task is None else ahead
        return Replay(config, host, recording, observers, last_words, helper).run()


@dataclass(frozen=True, slots=True)
class _Part:
    """A phase as it was recorded: frames from `first` to before `end`."""

    phase: str
    visit: int
    first: int
    end: float


class Replay(Mission):
    """A mission whose frames, commands and looks are those of a recording."""

    def __init__(
        self,
        config: RunConfig,
        host: Host,
        recording: Recording,
        observers: Sequence[tuple[str, Observer]] = (),
        last_words: LastWords = say_on_stderr,
        ahead: Ahead | None = None,
    ) -> None:
        if not recording.readable_frame_indices:
            raise InputError("holds no frame to replay", file=recording.path)
        self._parent = recording
        self._parent_hash = _in_background(partial(file_hash, recording.path))  # while the plug-ins are built
        self._ahead = ahead
        lifter: Lifter | None = None
        if _reuses_detections(config, recording):
            lifter = RecordedLifter(recording) if ahead is None else AheadLifter(recording, ahead)
        super().__init__(config, host, observers, last_words, lifter)
        self._waiting = deque(_in_order(recording))
        self._visits = sorted({recording.visit(index) for index in self._waiting})
        self._parts = _parts(recording)
        self._ended = [one for one in recording.episodes() if one["reason"] != "not begun"]
        self._told: dict[int, list[NavigationChanged]] = {}
        for row in recording.navigation():
            if row["target_xy"] is None:
                continue  # of an episode: told anew
            self._told.setdefault(row["frame"], []).append(_navigation_changed(row))
        self._end: float = 0.0
        self._seeking = False
        self._looked = False

    def parent_facts(self) -> dict[str, str]:
        """What names the parent: its recording id, file name and SHA-256."""
        path = self._parent.path
        return {
            "parent": str(self._parent.facts["run_id"]),
            "parent_file": path.name,
            "parent_sha256": self._parent_hash.result(),
        }

    def _start_event(self) -> RunStarted:
        event = super()._start_event()
        facts = {**event.source.facts, **self.parent_facts()}
        return replace(event, source=replace(event.source, facts=facts))

    # Phases

    def _phases(self) -> None:
        for part in self._parts:
            if self._is_out_of_frames():
                break
            self._begin(part.phase, part.visit)
            self._end, self._seeking = part.end, part.phase == _SEEK
            if self._seeking:
                self._seek()
            self._play_on()
            self._tell_skips(part)
            self._end_visit()
        if self._frame is None:
            raise InputError("gave no frame", file=self._parent.path)

    def _start_visit(self, visit: int) -> None:
        # The source counts the visits that have frames.
        if visit in self._visits:
            super()._start_visit(self._visits.index(visit))

    def _play_on(self) -> None:
        """Take what is left of the phase or the episode."""
        while (frame := self._capture(None)) is not None:
            self._take(frame, None)
            for event in () if self._seeking else self._told.get(frame.index, ()):
                self._bus.tell(event)

    def _seek(self) -> None:
        seeker, end = self._seeker(), self._end
        frame = self._frame or self._advance(Command())
        for goal in self._config.mission.goals:
            if frame is None or self._is_out_of_frames():
                break
            number = len(self._episodes)
            was: Mapping[str, Any] | None = self._ended[number] if number < len(self._ended) else None
            self._end = end if was is None else min(end, was["frame"] + 1)
            timed_out = was is None or was["reason"] == "out of time"
            seeker.out_of_frames = "out of time" if timed_out else DRIVE_OVER
            ended, frame = seeker.seek(number, goal, frame)
            self._episodes.append(ended)
            last = self._frame
            self._play_on()
            if self._frame is not last:  # the robot went on where this replay's episode was over
                frame = self._frame
        self._end = end

    def _tell_skips(self, part: _Part) -> None:
        """What the recorded tour could not reach: that is of the drive, not of the plug-ins."""
        for error in self._parent.errors():
            if error["plugin"] == "mission" and part.first <= error["frame"] < part.end and not self._seeking:
                self._bus.tell(
                    ErrorOccurred(*self._now(), error["plugin"], error["message"], error["skipped"])
                )
                self._skipped_stops.append(str(error["skipped"]).removeprefix("stop "))

    # Frames

    def _capture(self, command: Command | None) -> Frame | None:
        """The next frame of the phase or episode; a drivable source says nothing of looks."""
        if not self._waiting or self._waiting[0] >= self._end:
            return None
        frame = super()._capture(command)
        if frame is None:
            return None
        self._waiting.popleft()
        self._looked = frame.at_stop
        return looking(frame, False) if self._seeking else frame

    def _step(self, command: Command | None) -> Frame | None:
        """The frame out of the parent, not out of the source, which would open and decode it once more."""
        index, recording, has_truth = self._waiting[0], self._parent, self._info.has_truth
        ready = None if self._ahead is None else self._ahead.take(index)
        if ready is not None:  # and checked
            return recording.decoded_frame(index, ready.depth_mm, ready.rgb, with_truth=has_truth)
        frame: Frame = self._guard.call(
            self._source_id,
            "step",
            lambda: recording.frame(index, with_truth=has_truth, lazy=True),
            check=lambda value: checks.check_frame(value, self._info, self._frame),
        )
        return frame

    def _count_collisions(self) -> int:
        return self._parent.collisions(self._frame.index) if self._frame else 0

    def _floor_plan(self) -> FloorPlan:
        own = super()._floor_plan()
        return own if self._ahead is None else AheadFloor(self._ahead, own)

    def _take(self, frame: Frame, command: Command | None) -> None:
        if self._seeking and command is not None:
            self._bus.tell(Advised(frame.index, frame.sim_time, command))
        super()._take(looking(frame, self._looked), self._parent.command(frame.index))

    def _summary(self) -> dict[str, Any]:
        recorded = self._parent.stored_summary or {}
        seconds = recorded.get("seconds", {}).get("total")
        return {
            **super()._summary(),
            "parent": self._parent.facts["run_id"],
            "recorded_seconds": seconds,
            "faster": None if not seconds else round(seconds / (perf_counter() - self._started), 1),
        }


def _in_order(recording: Recording) -> list[int]:
    """The frames that can be read, visit by visit."""
    return sorted(recording.readable_frame_indices, key=lambda index: (recording.visit(index), index))


def _task(config: RunConfig, recording: Recording) -> Task | None:
    """What there is to do ahead."""
    camera, noise = recording.camera(), recording.facts["source"]["depth_noise_m"]
    indices = _in_order(recording)[: config.mission.max_frames]
    if camera is None:
        return None
    driven = frozenset(
        index
        for part in _parts(recording)
        for index in indices
        if part.phase == _SEEK and part.first <= index < part.end
    )
    rule, reused = key_frame_rule(config.mission), _reuses_detections(config, recording)
    return Task(recording.readable_path, indices, driven, camera, (noise[0], noise[1]), rule, reused)


def _reuses_detections(config: RunConfig, recording: Recording) -> bool:
    """Whether perception gives the detections of this very recording."""
    slot, path = config.perception, config.perception.options.get("recording")
    named = slot.use == "recorded" and isinstance(path, str)
    return named and (config.base_dir / str(path)).resolve() == recording.path.resolve()


def _parts(recording: Recording) -> list[_Part]:
    phases = recording.phases() or [
        {"phase": "survey", "visit": 0, "frame": recording.readable_frame_indices[0]}
    ]
    ends = [float(later["frame"]) for _, later in pairwise(phases)] + [float("inf")]
    return [
        _Part(row["phase"], row["visit"], row["frame"], end) for row, end in zip(phases, ends, strict=True)
    ]


def _navigation_changed(row: Mapping[str, Any]) -> NavigationChanged:
    x, y = row["target_xy"]
    return NavigationChanged(
        row["frame"], row["sim_time"], row["state"], row["detail"], tuple(row["path"]), (float(x), float(y))
    )


def _in_background(work: Callable[[], str]) -> Future[str]:
    """What a piece of work comes to, begun now in a thread of its own."""
    pool = ThreadPoolExecutor(1, "dssmsg-hash")
    future = pool.submit(work)
    pool.shutdown(wait=False)
    return future


def file_hash(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
