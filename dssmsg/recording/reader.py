"""The read model of a recording: `Recording.open(path)`, typed and lazy.

It works where the simulator, Open3D and onnxruntime cannot be imported. A recording that was cut off, or
that is still being written, is read from a repaired copy in a temporary folder, as far as it got; the
original is never touched.
"""

from __future__ import annotations

import json
import logging
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dssmsg.errors import InputError
from dssmsg.frame import Camera, Detection, Frame, Truth
from dssmsg.graph import codec
from dssmsg.graph.changes import Change
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.interfaces.source import Command
from dssmsg.recording import schema
from dssmsg.recording.images import decode_depth, decode_instances, decode_masks, decode_rgb
from dssmsg.recording.messages import has_footer
from dssmsg.recording.repair import check_recording, repaired_copy
from dssmsg.recording.rows import detections_from_row, truth_objects
from dssmsg.recording.store import ChunkFile

log = logging.getLogger(__name__)

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

    @property
    def complete(self) -> bool:
        """False for a run that was killed, or is not over."""
        return self.stored_summary is not None

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
    def key_frames(self) -> Sequence[int]:
        """Indices of the frames that perception ran on, ascending."""
        return [index for index in self.frame_indices if self._frame_rows[index]["key_frame"][0]]

    def frame(self, index: int, *, with_truth: bool = False) -> Frame:
        """A frame as it was captured: pose and depth exactly, colours as exactly as `images` says.

        Raises InputError if there is no such frame.
        """
        row = self._frame_rows.get(index)
        rgb = self._file.blob(schema.RGB, "EncodedImage:blob", index)
        depth = self._file.blob(schema.DEPTH, "EncodedDepthImage:blob", index)
        if row is None or rgb is None or depth is None:
            raise InputError(f"holds no frame {index}; its frames are {self._span()}", file=self.path)
        width, height, *intrinsics = row["camera"]
        return Frame(
            index=index,
            sim_time=row["sim_time"][0],
            rgb=decode_rgb(rgb),
            depth=decode_depth(depth),
            camera=Camera(int(width), int(height), *intrinsics),
            world_from_camera=np.array(row["world_from_camera"]).reshape(4, 4),
            world_from_base=np.array(row["world_from_base"]).reshape(4, 4),
            visit=row["visit"][0],
            at_stop=row["at_stop"][0],
            truth=self.truth(index) if with_truth else None,
        )

    def frames(self) -> Iterator[Frame]:
        """All frames in order, decoded one at a time."""
        return (self.frame(index) for index in self.frame_indices)

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
        count, height, width = row["mask_shape"]
        masks = decode_masks(row["masks"][0] if row["masks"] else b"", (count, height, width))
        cells = {**row, "label_scores": row["label_scores"][0]}
        return detections_from_row(cells, masks, self._blobs)

    # The graph.

    @cached_property
    def _blobs(self) -> Mapping[str, bytes]:
        return {row["hash"][0]: row["data"][0] for row in self._file.rows(schema.BLOBS)}

    def changes(self) -> Iterator[Change]:
        """Every change of the graph, in the order of application, with its arrays."""
        for row in self._file.rows(schema.GRAPH_LOG):
            yield codec.decode(json.loads(row["json"][0]), self._blobs)

    def change_rows(self) -> Iterator[Json]:
        """The JSON row of every change, arrays as hashes: enough to count, search and explain."""
        for row in self._file.rows(schema.GRAPH_LOG):
            yield json.loads(row["json"][0])

    def change_counts(self) -> dict[str, int]:
        """How many changes of each kind there were, kinds sorted."""
        counts: dict[str, int] = {}
        for row in self._file.rows(schema.GRAPH_LOG):
            counts[row["kind"][0]] = counts.get(row["kind"][0], 0) + 1
        return dict(sorted(counts.items()))

    def graph_at(self, frame: int | None = None, *, update: int | None = None) -> SceneGraph:
        """The graph after a frame (its changes included), after an update, or, with neither, at the end.

        Equal to what the live graph was then. Raises InputError if both are given.
        """
        if frame is not None and update is not None:
            raise InputError("give a frame or an update, not both", file=self.path)
        graph = SceneGraph()
        for change in self.changes():
            if frame is not None and change.frame > frame:
                break
            if update is not None and change.update > update:
                break
            graph.apply(change)
        return graph

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
