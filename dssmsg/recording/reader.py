"""The read model of a recording: `Recording.open(path)`, typed and lazy.

It works where the simulator, Open3D and onnxruntime cannot be imported. A recording that was cut off, or
that is still being written, is read from a repaired copy in a temporary folder, as far as it got; the
original is never touched. Tables of such a file may end at different times: of the changes, those are told
that can be folded (the longest beginning without a gap, with all arrays).

The parts: frames (`frame_table`), changes and the graph (`change_log`), all other events (`told`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from dssmsg.errors import InputError
from dssmsg.frame import ByteArray, Camera, Detection, Float32Array, FloatArray, Frame, MaskArray, Truth
from dssmsg.graph.changes import Change
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.interfaces.source import Command
from dssmsg.recording import schema
from dssmsg.recording.change_log import ChangeLog
from dssmsg.recording.damage import json_object, reading
from dssmsg.recording.frame_table import FrameFacts, FrameTable
from dssmsg.recording.messages import has_footer
from dssmsg.recording.migrations import Migrations
from dssmsg.recording.repair import RepairedCopy, check_recording
from dssmsg.recording.run_facts import checked_facts
from dssmsg.recording.store import ChunkFile
from dssmsg.recording.told import Told

Json = dict[str, Any]


class Recording:
    """One run, read back. A context manager: on leaving, or on `close()`, a repaired copy goes."""

    def __init__(self, path: Path, file: ChunkFile, copy: RepairedCopy | None = None) -> None:
        self.path = path
        self.readable_path = file.path
        """The file that other programs can read: `path`, or the repaired copy."""
        self._file = file
        self._copy = copy
        self._run = file.property(schema.RUN_PROPERTY)
        file.migrations = migrations = self._checked_version()
        self.schema_version = migrations.version
        """The version of the schema that the file was written in; it is read as if of the present one."""
        self._blobs = file.blobs()
        self._frames = FrameTable(file, path, self._blobs)
        self.told = Told(file, path, migrations)
        """What else happened, as `dssmsg.events`: phases, windows, matches, episodes, errors and so on."""

    @classmethod
    def open(cls, path: Path | str) -> Self:
        """Open a recording, finished or not.

        Raises InputError if the file is missing, empty, foreign, of a schema version that is not read, or
        beyond repair.
        """
        path = Path(path)
        check_recording(path)
        if has_footer(path):
            return cls(path, ChunkFile(path, path))
        copy = RepairedCopy.of(path)
        return cls(path, ChunkFile(copy.path, path), copy)

    @cached_property
    def complete(self) -> bool:
        """False for a run that was killed, or is not over, and for a copy that lacks a part."""
        if self.stored_summary is None or self._whole:
            return self._whole
        with reading(self.path, "the run's end"):
            last = int(self._end.get("frame", -1))
        return (
            self.changes_readable == self.changes_recorded
            and self.frames_readable == len(self.frame_indices)
            and max(self.frame_indices, default=-1) >= last
        )

    @cached_property
    def _whole(self) -> bool:
        """Whether the file got its index, after the run had ended: nothing is checked for absence then."""
        return self.readable_path == self.path and self.stored_summary is not None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the repaired copy, if there is one; safe to call twice."""
        self._copy = None

    def _checked_version(self) -> Migrations:
        version = self._run.get("schema_version")
        if self._file.application_id != schema.APPLICATION_ID or version is None:
            if self._file.application_id == schema.COMPARISON_ID:
                raise InputError(
                    "two runs side by side, made by `dssmsg diff --recording`; `dssmsg view` opens it; here"
                    " the recording of one run is expected",
                    file=self.path,
                )
            raise InputError(
                f"an .rrd of another program ({self._file.application_id}); expected a recording of dssmsg",
                file=self.path,
            )
        try:
            written_by = str(json_object(self._run.get("versions")).get("dssmsg", ""))
        except ValueError:
            written_by = ""
        return Migrations.of(version, self.path, written_by)

    # The run.

    @cached_property
    def facts(self) -> Json:
        """Run facts: run_id, name, seed, config, plugins, versions, parent, feature_space, source, images."""
        with reading(self.path, "the run's facts"):
            return checked_facts(json_object(self._run.get("json")))

    @property
    def seed(self) -> int:
        """The run's seed."""
        return int(self.facts["seed"])

    @property
    def config(self) -> Json:
        """The resolved configuration, without secrets; the plug-ins that it names are not imported."""
        config: Json = self.facts["config"]
        return config

    @cached_property
    def stored_summary(self) -> Json | None:
        """What the run said of itself at its end; None if it did not get there."""
        text = self._end.get("json")
        if text is None:
            return None
        with reading(self.path, "the run's summary"):
            return json_object(text)

    @cached_property
    def _end(self) -> Mapping[str, Any]:
        return self._file.property(schema.SUMMARY_PROPERTY)

    # Frames.

    @property
    def frame_facts(self) -> Mapping[int, FrameFacts]:
        """What each frame's row says besides poses and images, by index, ascending."""
        return self._frames.facts

    @cached_property
    def frame_indices(self) -> Sequence[int]:
        """Indices of all frames, ascending."""
        return list(self._frames.facts)

    @cached_property
    def readable_frame_indices(self) -> Sequence[int]:
        """Indices of the frames that have their images: all, but for a recording that was cut off."""
        return self.frame_indices if self._whole else self._frames.with_images

    @property
    def frames_readable(self) -> int:
        """How many of the frames have their images."""
        return len(self.readable_frame_indices)

    @cached_property
    def key_frames(self) -> Sequence[int]:
        """Indices of the frames that perception ran on, ascending."""
        return [facts.index for facts in self._frames.facts.values() if facts.key_frame]

    def frame(self, index: int, *, with_truth: bool = False, lazy: bool = False) -> Frame:
        """A frame as it was captured: pose and depth exactly, colours as exactly as `images` says.

        `lazy`: colours are decoded on first use. Raises InputError if there is no such frame, or its images
        were cut off.
        """
        return self._frames.frame(index, with_truth=with_truth, lazy=lazy)

    def decoded_frame(
        self,
        index: int,
        depth_mm: NDArray[np.uint16] | None,
        rgb: ByteArray | None,
        *,
        with_truth: bool = False,
    ) -> Frame:
        """A frame whose images somebody has decoded and checked: depth (H, W) millimetres, rgb (H, W, 3).

        What is not given, and the truth, are decoded on first use. Raises InputError if there is no such
        frame.
        """
        return self._frames.decoded_frame(index, depth_mm, rgb, with_truth=with_truth)

    def encoded_truth(self, index: int) -> tuple[bytes, tuple[int, int]] | None:
        """The instances of a frame's truth as they are stored, with their (H, W); None if there are none."""
        return self._frames.encoded_truth(index)

    def encoded_images(self, index: int) -> tuple[bytes, bytes] | None:
        """Colours and depth of a frame as they are stored; None if one of them is missing."""
        return self._frames.encoded_images(index)

    def frames(self) -> Iterator[Frame]:
        """All readable frames in order, decoded one at a time."""
        return self._frames.frames(self.readable_frame_indices)

    def poses(self, index: int) -> tuple[FloatArray, FloatArray]:
        """world_from_camera and world_from_base, (4, 4) each, of a frame; its images are not read.

        Raises InputError if there is no such frame.
        """
        return self._frames.poses(index)

    def floor_pose(self, index: int) -> tuple[float, float, float]:
        """Where the base stood at a frame: x, y (metres) and heading (radians).

        Raises InputError if there is no such frame.
        """
        self._frames.of(index)
        return self._frames.floor_poses[index]

    def sim_time(self, index: int) -> float:
        """The source's clock at a frame, in seconds. Raises InputError if there is no such frame."""
        return self._frames.of(index).sim_time

    def viewpoint(self, index: int) -> str | None:
        """The viewpoint that a frame belongs to, if it is a key frame of one."""
        facts = self._frames.facts.get(index)
        return None if facts is None else facts.viewpoint

    def visit(self, index: int) -> int:
        """The pass through the scene that a frame belongs to. Raises InputError if there is no such frame."""
        return self._frames.of(index).visit

    def collisions(self, index: int) -> int:
        """Collisions counted up to a frame. Raises InputError if there is no such frame."""
        return self._frames.of(index).collisions

    def camera(self) -> Camera | None:
        """The intrinsics of the first frame; None if there is none."""
        return self._frames.camera()

    def command(self, index: int) -> Command | None:
        """The command that led to a frame; None if there was none."""
        return self._frames.commands.get(index)

    def advice(self, index: int) -> Command | None:
        """Of a replay: the command that navigation asked for before a frame; None if it asked for none."""
        return self._frames.advice.get(index)

    def truth(self, index: int) -> Truth | None:
        """The simulator's truth of a frame, if there was any."""
        return self._frames.truth(index)

    def frame_at_time(self, sim_time: float) -> int:
        """The last frame at or before a sim time. Raises InputError if the run had not begun."""
        return self._frames.at_time(sim_time)

    # Perception.

    @property
    def has_detections(self) -> bool:
        """Whether perception ran on any frame."""
        return bool(self._frames.detected)

    def detections(self, index: int) -> Sequence[Detection] | None:
        """The detections of a frame, masks and features exactly; None where perception did not run."""
        return self._frames.detections(index)

    def kept(self, index: int) -> Mapping[int, MaskArray] | None:
        """By index of each detection that was lifted: which (V,) of the voxels of its mask are of the thing.

        None where the recording does not say.
        """
        return self._frames.kept(index)

    def detection_cells(self, index: int) -> Mapping[str, Sequence[Any]] | None:
        """The cells of a frame's row of `/detections` as they are stored; None where there is none."""
        return self._frames.detection_cells(index)

    def detection_hashes(self) -> Mapping[int, bytes]:
        """A hash of each frame's row of `/detections`, to be compared; masks stay on disk."""
        return self._frames.detection_hashes()

    def detected_names(self) -> Mapping[int, Sequence[tuple[str, float]]]:
        """Label and score of every detection, by frame, ascending; masks stay on disk."""
        return self._frames.detected_names()

    def label_vectors(self) -> Mapping[str, Float32Array]:
        """The text feature (D,), a unit vector, that each label was detected with, if any."""
        return self._frames.label_vectors

    # The graph.

    @cached_property
    def _changes(self) -> ChangeLog:
        with reading(self.path, "the run's end"):
            told = int(self._end.get("updates", 0))
        return ChangeLog(self._file, self.path, self._frames, self._blobs, whole=self._whole, told=told)

    @property
    def changes_readable(self) -> int:
        """How many changes can be folded: from the first on, without a gap, with all their arrays."""
        return self._changes.readable

    @property
    def changes_recorded(self) -> int:
        """How many changes there were, as far as anything that is left of the recording tells."""
        return self._changes.recorded

    @property
    def last_known_frame(self) -> int | None:
        """The last frame after which the graph is known; None if it is not even known after the first.

        The last frame of all, but for a recording that was cut off.
        """
        return self._changes.last_known_frame

    def changes(
        self, *, about: Collection[str] = (), kinds: Collection[str] = (), after: int = 0
    ) -> Iterator[Change]:
        """The changes that can be folded, in the order of application, with their arrays; or some of them.

        `about`: those that have one of these ids among their subjects. `kinds`: those of these kinds.
        `after`: those behind this update. Nothing is decoded of the others: of a long run, ask for what you
        need. Raises InputError where a finished recording is damaged.
        """
        return self._changes.changes(about=about, kinds=kinds, after=after)

    def change_rows(
        self, *, about: Collection[str] = (), kinds: Collection[str] = (), after: int = 0
    ) -> Iterator[Json]:
        """The JSON row of every such change, arrays as hashes: enough to count, search and explain."""
        return self._changes.rows(about=about, kinds=kinds, after=after)

    def change_texts(self) -> Iterator[str]:
        """The JSON of every change as it is stored: to tell equal ones without reading them."""
        return self._changes.texts()

    def change_counts(self) -> dict[str, int]:
        """How many changes of each kind can be folded, kinds sorted."""
        return self._changes.counts()

    def graph_at(self, frame: int | None = None, *, update: int | None = None) -> SceneGraph:
        """The graph after a frame (its changes included), after an update, or, with neither, at the end.

        Equal to what the live graph was then; at the end of a recording that was cut off: as far as its
        changes can be folded. Raises InputError if both are given, or the changes until then were cut off.
        """
        return self._changes.graph_at(frame, update=update)

    def frame_of_update(self, update: int) -> int | None:
        """The frame in which an update happened; None if there was no such update."""
        return self._changes.frame_of_update(update)

    def cut_notes(self) -> list[str]:
        """What was cut off, a line each; nothing of a recording that is whole."""
        notes = [note] if (note := self._changes.note()) else []
        if self.frames_readable < len(self.frame_indices):
            notes.append(f"{self.frames_readable} of {len(self.frame_indices)} frames have their images")
        return notes

    # Everything else that happened, as JSON values; `told` gives the same as typed values.

    def phases(self) -> list[Json]:
        """Phases begun: phase, visit, frame."""
        return [{"phase": one.phase, "visit": one.visit, "frame": one.frame} for one in self.told.phases]

    def errors(self) -> list[Json]:
        """Failures: frame, plugin, message, skipped, fatal."""
        return self.told.json(schema.ERRORS)

    def episodes(self) -> list[Json]:
        """Episodes ended: episode, goal, outcome, reason, frame, values."""
        return self.told.json(schema.EPISODES)

    def windows(self, about: Collection[str] | None = None) -> list[Json]:
        """Window evaluations: viewpoint, base, comparison, evidence, verdicts, threshold.

        `about`: only those that name one of these objects.
        """
        return self.told.json(schema.WINDOWS, about)

    def matches(self) -> list[Json]:
        """Grounded queries: query, target, candidates with scores and matching, best first."""
        return self.told.json(schema.MATCHES)

    def llm_calls(self) -> list[Json]:
        """LLM calls, failed ones too: role, prompt, answer, request_hash, ok, seconds."""
        return self.told.json(schema.LLM_CALLS)

    def navigation(self) -> list[Json]:
        """Changes of the driver's state: frame, state, detail, path."""
        return self.told.json(schema.NAVIGATION)

    def logs(self) -> list[Json]:
        """Log lines: logger, level, message."""
        return [{"logger": one.logger, "level": one.level, "message": one.message} for one in self.told.logs]

    def timings(self) -> dict[int, dict[str, float]]:
        """Wall seconds by stage, by frame."""
        return {one.frame: dict(one.seconds) for one in self.told.timings}
