"""The read model of a recording: `Recording.open(path)`, typed and lazy.

It works where the simulator, Open3D and onnxruntime cannot be imported. A recording that was cut off, or
that is still being written, is read from a repaired copy in a temporary folder, as far as it got; the
original is never touched. Tables of such a file may end at different times: of the changes, those are told
that can be folded (the longest beginning without a gap, with all arrays).
"""

from __future__ import annotations

import json
import logging
import shutil
import tempfile
import weakref
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dssmsg.errors import InputError
from dssmsg.frame import Camera, Detection, Frame, Truth
from dssmsg.graph import codec
from dssmsg.graph.changes import Change
from dssmsg.graph.errors import GraphError
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.interfaces.source import Command
from dssmsg.recording import schema
from dssmsg.recording.images import decode_depth, decode_instances, decode_masks, decode_rgb
from dssmsg.recording.messages import has_footer
from dssmsg.recording.repair import check_recording, repaired_copy
from dssmsg.recording.rows import detections_from_row, truth_objects
from dssmsg.recording.store import ChunkFile

log = logging.getLogger(__name__)

_RGB, _DEPTH = "EncodedImage:blob", "EncodedDepthImage:blob"

Json = dict[str, Any]


class Recording:
    """One run, read back. A context manager: on leaving, or on `close()`, a repaired copy goes."""

    def __init__(self, path: Path, file: ChunkFile, folder: Path | None = None) -> None:
        self.path = path
        self.readable_path = file.path
        """The file that other programs can read: `path`, or the repaired copy."""
        self._file = file
        # Removes the folder with the copy at the latest when this object, or the process, goes.
        self._cleanup = weakref.finalize(self, _remove, folder)

    @classmethod
    def open(cls, path: Path | str) -> Recording:
        """Open a recording, finished or not.

        Raises InputError if the file is missing, empty, foreign, of another schema version, or beyond repair.
        """
        path = Path(path)
        check_recording(path)
        if has_footer(path):
            recording = cls(path, ChunkFile(path, path))
        else:
            folder = Path(tempfile.mkdtemp(prefix="dssmsg-"))
            try:
                recording = cls(path, ChunkFile(repaired_copy(path, folder), path), folder)
            except BaseException:
                _remove(folder)
                raise
            log.warning("%s was cut off, or is still being written: reading a repaired copy", path)
        recording._check_schema()
        return recording

    @cached_property
    def complete(self) -> bool:
        """False for a run that was killed, or is not over, and for a copy that lacks a part."""
        if self.stored_summary is None or self._whole:
            return self._whole
        last = self._file.property(schema.SUMMARY_PROPERTY).get("frame", -1)
        return (
            self.changes_readable == self.changes_recorded
            and self.frames_readable == len(self.frame_indices)
            and max(self.frame_indices, default=-1) >= int(last)
        )

    @cached_property
    def _whole(self) -> bool:
        """Whether the file got its index, after the run had ended: nothing is checked for absence then."""
        return self.readable_path == self.path and self.stored_summary is not None

    @contextmanager
    def _reading(self, what: str) -> Iterator[None]:
        """Turn whatever damaged values do to a decoder into an InputError that names the file."""
        try:
            yield
        except (InputError, GraphError) as error:
            if isinstance(error, InputError) and error.file:
                raise
            raise InputError(f"{what}: {error.message}", file=self.path) from error
        except (ValueError, LookupError, TypeError, OSError, zlib.error) as error:
            raise InputError(f"{what}: damaged ({error})", file=self.path) from error

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the repaired copy, if there is one; safe to call twice."""
        self._cleanup()

    def _check_schema(self) -> None:
        version = self._file.property(schema.RUN_PROPERTY).get("schema_version")
        if self._file.application_id != schema.APPLICATION_ID or version is None:
            raise InputError(
                f"an .rrd of another program ({self._file.application_id}); expected a recording of dssmsg",
                file=self.path,
            )
        if int(version) != schema.SCHEMA_VERSION:
            raise InputError(
                f"has schema version {version}; this dssmsg reads version {schema.SCHEMA_VERSION}",
                file=self.path,
            )

    # The run.

    @cached_property
    def facts(self) -> Json:
        """Run facts: run_id, name, seed, config, plugins, versions, parent, feature_space, source, images."""
        with self._reading("the run's facts"):
            facts: Json = json.loads(self._file.property(schema.RUN_PROPERTY)["json"])
        return facts

    @property
    def seed(self) -> int:
        """The run's seed."""
        return int(self.facts["seed"])

    @property
    def config(self) -> Json:
        """The resolved configuration, without secrets."""
        config: Json = self.facts["config"]
        return config

    @cached_property
    def stored_summary(self) -> Json | None:
        """What the run said of itself at its end; None if it did not get there."""
        text = self._file.property(schema.SUMMARY_PROPERTY).get("json")
        return None if text is None else json.loads(text)

    # Frames.

    @cached_property
    def _frame_rows(self) -> dict[int, Mapping[str, Any]]:
        return {row["index"][0]: row for row in self._file.rows(schema.FRAMES)}

    @property
    def frame_indices(self) -> Sequence[int]:
        """Indices of all frames, ascending."""
        return sorted(self._frame_rows)

    @cached_property
    def readable_frame_indices(self) -> Sequence[int]:
        """Indices of the frames that have their images: all, but for a recording that was cut off."""
        if self._whole:
            return self.frame_indices
        with_images = self._file.frames_of(schema.RGB, _RGB) & self._file.frames_of(schema.DEPTH, _DEPTH)
        return sorted(with_images & self._frame_rows.keys())

    @property
    def frames_readable(self) -> int:
        """How many of the frames have their images."""
        return len(self.readable_frame_indices)

    @cached_property
    def key_frames(self) -> Sequence[int]:
        """Indices of the frames that perception ran on, ascending."""
        return [index for index in self.frame_indices if self._frame_rows[index]["key_frame"][0]]

    def frame(self, index: int, *, with_truth: bool = False) -> Frame:
        """A frame as it was captured: pose and depth exactly, colours as exactly as `images` says.

        Raises InputError if there is no such frame, or its images were cut off.
        """
        row = self._frame_rows.get(index)
        rgb = self._file.blob(schema.RGB, _RGB, index)
        depth = self._file.blob(schema.DEPTH, _DEPTH, index)
        if row is None:
            raise InputError(f"holds no frame {index}; its frames are {self._span()}", file=self.path)
        if rgb is None or depth is None:
            raise InputError(f"the images of frame {index} are missing: the file was cut off", file=self.path)
        width, height, *intrinsics = row["camera"]
        with self._reading(f"the images of frame {index}"):
            pixels, distances = decode_rgb(rgb), decode_depth(depth)
        return Frame(
            index=index,
            sim_time=row["sim_time"][0],
            rgb=pixels,
            depth=distances,
            camera=Camera(int(width), int(height), *intrinsics),
            world_from_camera=np.array(row["world_from_camera"]).reshape(4, 4),
            world_from_base=np.array(row["world_from_base"]).reshape(4, 4),
            visit=row["visit"][0],
            at_stop=row["at_stop"][0],
            truth=self.truth(index) if with_truth else None,
        )

    def frames(self) -> Iterator[Frame]:
        """All readable frames in order, decoded one at a time."""
        return (self.frame(index) for index in self.readable_frame_indices)

    def viewpoint(self, index: int) -> str | None:
        """The viewpoint that a frame belongs to, if it is a key frame of one."""
        row = self._frame_rows.get(index)
        return row["viewpoint"][0] if row and row["viewpoint"] else None

    def visit(self, index: int) -> int:
        """The pass through the scene that a frame belongs to."""
        return int(self._frame_rows[index]["visit"][0])

    def collisions(self, index: int) -> int:
        """Collisions counted up to a frame."""
        return int(self._frame_rows[index]["collisions"][0])

    def camera(self) -> Camera | None:
        """The intrinsics of the first frame; None if there is none."""
        for index in self.frame_indices[:1]:
            width, height, *intrinsics = self._frame_rows[index]["camera"]
            return Camera(int(width), int(height), *intrinsics)
        return None

    @cached_property
    def _commands(self) -> dict[int, Command]:
        return {
            frame: Command(*(row[name][0] for name in ("linear", "angular", "pan", "tilt")))
            for frame, row in self._file.rows_by_frame(schema.COMMANDS).items()
        }

    def command(self, index: int) -> Command | None:
        """The command that led to a frame; None if there was none."""
        return self._commands.get(index)

    def truth(self, index: int) -> Truth | None:
        """The simulator's truth of a frame, if there was any."""
        row = self._truth_rows.get(index)
        if row is None:
            return None
        with self._reading(f"the truth of frame {index}"):
            return Truth(decode_instances(row["instances"][0]), truth_objects(self._truth_texts[index]))

    @cached_property
    def _truth_rows(self) -> Mapping[int, Mapping[str, Any]]:
        return self._file.rows_by_frame(schema.TRUTH)

    @cached_property
    def _truth_texts(self) -> Mapping[int, str]:
        latest = "[]"
        texts: dict[int, str] = {}
        for index, row in self._truth_rows.items():
            latest = row["objects"][0] if row["objects"] else latest
            texts[index] = latest
        return texts

    # Perception.

    @cached_property
    def _detection_rows(self) -> Mapping[int, Mapping[str, Any]]:
        return self._file.rows_by_frame(schema.DETECTIONS)

    @property
    def has_detections(self) -> bool:
        """Whether perception ran on any frame."""
        return bool(self._detection_rows)

    def detections(self, index: int) -> Sequence[Detection] | None:
        """The detections of a frame, masks and features exactly; None where perception did not run."""
        row = self._detection_rows.get(index)
        if row is None:
            return None
        with self._reading(f"the detections of frame {index}"):
            count, height, width = row["mask_shape"]
            masks = decode_masks(row["masks"][0] if row["masks"] else b"", (count, height, width))
            cells = {**row, "label_scores": row["label_scores"][0]}
            return detections_from_row(cells, masks, self._blobs)

    # The graph.

    @cached_property
    def _blobs(self) -> Mapping[str, bytes]:
        return {row["hash"][0]: row["data"][0] for row in self._file.rows(schema.BLOBS)}

    @cached_property
    def changes_readable(self) -> int:
        """How many changes can be folded: from the first on, without a gap, with all their arrays."""
        table = self._file.rows(schema.GRAPH_LOG)
        if self._whole:
            return len(table)
        for number, row in enumerate(table):
            try:
                change = codec.decode(json.loads(row["json"][0]), self._blobs)
            except (InputError, ValueError, LookupError):
                return number
            if change.update != number + 1:
                return number
        return len(table)

    @cached_property
    def changes_recorded(self) -> int:
        """How many changes there were, as far as anything that is left of the recording tells."""
        rows = self._file.rows(schema.GRAPH_LOG)
        known = [self.changes_readable, len(rows), *(before for _, before in self._updates_before)]
        known += [json.loads(row["json"][0])["update"] for row in rows[-1:]]
        known.append(int(self._file.property(schema.SUMMARY_PROPERTY).get("updates", 0)))
        return max(known)

    @cached_property
    def _updates_before(self) -> Sequence[tuple[int, int]]:
        """Frames with the number of changes before each, ascending."""
        return [
            (index, int(row["updates"][0]))
            for index, row in sorted(self._frame_rows.items())
            if row["updates"]
        ]

    @cached_property
    def last_known_frame(self) -> int | None:
        """The last frame after which the graph is known; None if it is not even known after the first.

        The last frame of all, but for a recording that was cut off.
        """
        last = self.frame_indices[-1] if self.frame_indices else None
        if self.changes_readable >= self.changes_recorded:
            return last
        if self.changes_readable < len(rows := self._file.rows(schema.GRAPH_LOG)):
            cut = int(json.loads(rows[self.changes_readable]["json"][0])["frame"])
        else:
            # A frame whose successor knows of more changes has some that are lost.
            cut = last if last is not None else 0
        for (index, _), (_, after) in pairwise(self._updates_before):
            if after > self.changes_readable:
                cut = min(cut, index)
                break
        return max((index for index in self.frame_indices if index < cut), default=None)

    def changes(self) -> Iterator[Change]:
        """Every change of the graph that can be folded, in the order of application, with its arrays.

        Raises InputError where a finished recording is damaged.
        """
        with self._reading("the changes"):
            for row in self.change_rows():
                yield codec.decode(row, self._blobs)

    def change_rows(self) -> Iterator[Json]:
        """The JSON row of every such change, arrays as hashes: enough to count, search and explain."""
        with self._reading("the changes"):
            for row in islice(self._file.rows(schema.GRAPH_LOG), self.changes_readable):
                yield json.loads(row["json"][0])

    def change_counts(self) -> dict[str, int]:
        """How many changes of each kind can be folded, kinds sorted."""
        counts: dict[str, int] = {}
        for row in islice(self._file.rows(schema.GRAPH_LOG), self.changes_readable):
            counts[row["kind"][0]] = counts.get(row["kind"][0], 0) + 1
        return dict(sorted(counts.items()))

    def graph_at(self, frame: int | None = None, *, update: int | None = None) -> SceneGraph:
        """The graph after a frame (its changes included), after an update, or, with neither, at the end.

        Equal to what the live graph was then; at the end of a recording that was cut off: as far as its
        changes can be folded. Raises InputError if both are given, or the changes until then were cut off.
        """
        if frame is not None and update is not None:
            raise InputError("give a frame or an update, not both", file=self.path)
        self._check_known(frame, update)
        graph = SceneGraph()
        with self._reading("the changes do not fold"):
            for change in self.changes():
                if frame is not None and change.frame > frame:
                    break
                if update is not None and change.update > update:
                    break
                graph.apply(change)
        return graph

    def _check_known(self, frame: int | None, update: int | None) -> None:
        readable, recorded = self.changes_readable, self.changes_recorded
        if readable >= recorded or (frame is None and (update is None or update <= readable)):
            return
        known = self.last_known_frame
        if frame is not None and known is not None and frame <= known:
            return
        until = "at no frame" if known is None else f"until frame {known}"
        asked = f"frame {frame}" if frame is not None else f"update {update}"
        raise InputError(
            f"was cut off: the graph is known {until} (update {readable} of {recorded}), not at {asked}",
            file=self.path,
        )

    def cut_notes(self) -> list[str]:
        """What was cut off, a line each; nothing of a recording that is whole."""
        notes = []
        if self.changes_readable < self.changes_recorded:
            known = self.last_known_frame
            until = "at no frame" if known is None else f"until frame {known}"
            notes.append(
                f"{self.changes_readable} of at least {self.changes_recorded} changes can be read:"
                f" the graph is known {until}"
            )
        if self.frames_readable < len(self.frame_indices):
            notes.append(f"{self.frames_readable} of {len(self.frame_indices)} frames have their images")
        return notes

    def frame_of_update(self, update: int) -> int | None:
        """The frame in which an update happened; None if there was no such update."""
        return next((row["frame"] for row in self.change_rows() if row["update"] == update), None)

    def frame_at_time(self, sim_time: float) -> int:
        """The last frame at or before a sim time. Raises InputError if the run had not begun."""
        found = [index for index in self.frame_indices if self._frame_rows[index]["sim_time"][0] <= sim_time]
        if not found:
            raise InputError(
                f"holds no frame at or before {sim_time} s; its frames are {self._span()}", file=self.path
            )
        return found[-1]

    # Everything else that happened, as JSON values.

    def phases(self) -> list[Json]:
        """Phases begun: phase, visit, frame."""
        return [
            {"phase": row["phase"][0], "visit": row["visit"][0], "frame": row["index"][0]}
            for row in self._file.rows(schema.PHASES)
        ]

    def errors(self) -> list[Json]:
        """Failures: frame, plugin, message, skipped, fatal."""
        return self._json(schema.ERRORS)

    def episodes(self) -> list[Json]:
        """Episodes ended: episode, goal, outcome, reason, frame, values."""
        return self._json(schema.EPISODES)

    def windows(self) -> list[Json]:
        """Window evaluations: viewpoint, base, comparison, evidence, verdicts, threshold."""
        return self._json(schema.WINDOWS)

    def matches(self) -> list[Json]:
        """Grounded queries: query, target, candidates with scores and matching, best first."""
        return self._json(schema.MATCHES)

    def llm_calls(self) -> list[Json]:
        """LLM calls, failed ones too: role, prompt, answer, request_hash, ok, seconds."""
        return self._json(schema.LLM_CALLS)

    def navigation(self) -> list[Json]:
        """Changes of the driver's state: frame, state, detail, path."""
        return self._json(schema.NAVIGATION)

    def logs(self) -> list[Json]:
        """Log lines: logger, level, message."""
        return [
            {name: row[name][0] for name in ("logger", "level", "message")}
            for row in self._file.rows(schema.LOGS)
        ]

    def timings(self) -> dict[int, dict[str, float]]:
        """Wall seconds by stage, by frame."""
        return {
            frame: dict(zip(row["stage"], row["seconds"], strict=True))
            for frame, row in self._file.rows_by_frame(schema.TIMINGS).items()
        }

    def _json(self, table: schema.Table) -> list[Json]:
        return [json.loads(row["json"][0]) for row in self._file.rows(table)]

    def _span(self) -> str:
        indices = self.frame_indices
        return f"{indices[0]} to {indices[-1]}" if indices else "none"


def _remove(folder: Path | None) -> None:
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)


def newest(directory: Path) -> Path:
    """The newest `.rrd` file of a folder. Raises InputError if the folder has none."""
    try:
        found = [
            (path.stat().st_mtime_ns, path)
            for path in directory.glob("*.rrd")
            if path.is_file() and not path.name.startswith(".")
        ]
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=directory) from error
    if not found:
        raise InputError(
            "holds no recording (.rrd); make one with `dssmsg run`, or name a file", file=directory
        )
    return max(found)[1]
