"""The frames of a recording: poses, images, commands, detections, truth. Decoded one at a time."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.errors import InputError
from dssmsg.frame import (
    ByteArray,
    Camera,
    Detection,
    Float32Array,
    FloatArray,
    Frame,
    IntArray,
    MaskArray,
    Truth,
    TruthObject,
    depth_from_millimetres,
)
from dssmsg.interfaces.source import Command
from dssmsg.recording import schema
from dssmsg.recording.damage import reading
from dssmsg.recording.images import decode_depth, decode_instances, decode_masks, decode_rgb
from dssmsg.recording.lazy_frame import LazyFrame, LazyTruth
from dssmsg.recording.rows import detections_from_row, feature_of, kept_from_row, truth_objects
from dssmsg.recording.store import ChunkFile

_RGB, _DEPTH = "EncodedImage:blob", "EncodedDepthImage:blob"
_SEEN = tuple(name for name in schema.DETECTIONS.columns if name not in ("voxels", "kept"))
"""What is compared of detections: all but what follows from the rest."""


@dataclass(frozen=True, slots=True)
class FrameFacts:
    """What a frame's row says without its poses and images. `sim_time` in seconds."""

    index: int
    sim_time: float
    visit: int
    at_stop: bool
    key_frame: bool
    viewpoint: str | None
    """The viewpoint of a key frame, if it belongs to one."""
    collisions: int
    """Counted up to this frame."""
    updates: int | None
    """Changes of the graph before this frame; None where the row does not say."""


class FrameTable:
    """Frames by index. Raises InputError, naming the file, where a value is damaged."""

    def __init__(self, file: ChunkFile, path: Path, blobs: Mapping[str, bytes]) -> None:
        self._file = file
        self._path = path
        self._blobs = blobs
        self._latest_objects: tuple[str, tuple[TruthObject, ...]] = ("[]", ())

    @cached_property
    def facts(self) -> Mapping[int, FrameFacts]:
        """The facts of every frame by its index, ascending."""
        table = self._file.table(schema.FRAMES)
        names = ("index", "sim_time", "visit", "at_stop", "key_frame", "viewpoint", "collisions", "updates")
        with reading(self._path, "the frames"):
            rows = [
                FrameFacts(
                    int(index), float(sim_time), int(visit), bool(stop), bool(key),
                    viewpoint or None, int(collisions), None if updates is None else int(updates),
                )
                for index, sim_time, visit, stop, key, viewpoint, collisions, updates in zip(
                    *(table.values(name) for name in names), strict=True
                )
            ]  # fmt: skip
        return {row.index: row for row in sorted(rows, key=lambda row: row.index)}

    @cached_property
    def _rows(self) -> Mapping[int, int]:
        """Index -> row of the table."""
        return {index: row for row, index in enumerate(self._file.table(schema.FRAMES).values("index"))}

    @cached_property
    def with_images(self) -> Sequence[int]:
        """Indices of the frames that have both images, ascending."""
        found = self._file.frames_of(schema.RGB, _RGB) & self._file.frames_of(schema.DEPTH, _DEPTH)
        return sorted(found & self.facts.keys())

    def span(self) -> str:
        """The first and the last index, in words."""
        indices = list(self.facts)
        return f"{indices[0]} to {indices[-1]}" if indices else "none"

    def at_time(self, sim_time: float) -> int:
        """The last frame at or before a sim time in seconds. Raises InputError if the run had not begun."""
        found = [facts.index for facts in self.facts.values() if facts.sim_time <= sim_time]
        if not found:
            raise InputError(
                f"holds no frame at or before {sim_time} s; its frames are {self.span()}", file=self._path
            )
        return found[-1]

    def of(self, index: int) -> FrameFacts:
        """The facts of a frame. Raises InputError if there is none."""
        facts = self.facts.get(index)
        if facts is None:
            raise InputError(f"holds no frame {index}; its frames are {self.span()}", file=self._path)
        return facts

    def encoded_images(self, index: int) -> tuple[bytes, bytes] | None:
        """Colours and depth of a frame as they are stored; None if one of them is missing."""
        rgb = self._file.blob(schema.RGB, _RGB, index)
        depth = self._file.blob(schema.DEPTH, _DEPTH, index)
        return None if rgb is None or depth is None else (rgb, depth)

    def frame(self, index: int, *, with_truth: bool = False, lazy: bool = False) -> Frame:
        """A frame as it was captured: pose and depth exactly, colours as exactly as they were stored.

        `lazy`: colours and truth are decoded on first use. Raises InputError if there is no such frame, or
        its images were cut off or are damaged.
        """
        self.of(index)
        camera = self._camera(index)
        distances = self._distances(index, camera)
        if not (lazy or self.encoded_images(index)):
            raise self._cut_off(index)
        fields = self._fields(index, camera, with_truth, lazy)
        colours = partial(self._colours, index, camera)
        if lazy:
            return LazyFrame(colours, distances, **fields)
        return Frame(rgb=colours(), depth=distances, **fields)

    def decoded_frame(
        self,
        index: int,
        depth_mm: NDArray[np.uint16] | None,
        rgb: ByteArray | None,
        *,
        with_truth: bool = False,
    ) -> Frame:
        """A frame whose images somebody looked at: depth (H, W) and colours (H, W, 3), where they are given.

        The rest is lazy.
        """
        self.of(index)
        camera = self._camera(index)
        return LazyFrame(
            partial(self._colours, index, camera) if rgb is None else rgb,
            partial(self._distances, index, camera)
            if depth_mm is None
            else partial(depth_from_millimetres, depth_mm),
            **self._fields(index, camera, with_truth, lazy=True),
        )

    def _fields(self, index: int, camera: Camera, with_truth: bool, lazy: bool) -> dict[str, Any]:
        facts = self.of(index)
        return {
            "index": index,
            "sim_time": facts.sim_time,
            "camera": camera,
            "world_from_camera": self._pose(index, "world_from_camera"),
            "world_from_base": self._pose(index, "world_from_base"),
            "visit": facts.visit,
            "at_stop": facts.at_stop,
            "truth": self.truth(index, lazy=lazy) if with_truth else None,
        }

    def _distances(self, index: int, camera: Camera) -> Float32Array:
        stored = self._file.blob(schema.DEPTH, _DEPTH, index)
        if stored is None:
            raise self._cut_off(index)
        with reading(self._path, f"the images of frame {index}"):
            return decode_depth(stored, (camera.height, camera.width))

    def _cut_off(self, index: int) -> InputError:
        return InputError(f"the images of frame {index} are missing: the file was cut off", file=self._path)

    def _colours(self, index: int, camera: Camera) -> ByteArray:
        data = self._file.blob(schema.RGB, _RGB, index)
        with reading(self._path, f"the images of frame {index}"):
            if data is None:
                raise ValueError("they are missing")
            return decode_rgb(data, (camera.height, camera.width))

    def frames(self, indices: Sequence[int]) -> Iterator[Frame]:
        """Frames in the order of `indices`, decoded one at a time."""
        return (self.frame(index) for index in indices)

    def poses(self, index: int) -> tuple[FloatArray, FloatArray]:
        """world_from_camera and world_from_base (4, 4) of a frame, without its images.

        Raises InputError if there is no such frame.
        """
        self.of(index)
        return self._pose(index, "world_from_camera"), self._pose(index, "world_from_base")

    @cached_property
    def floor_poses(self) -> Mapping[int, tuple[float, float, float]]:
        """Where the base stood in every frame: x, y (metres) and heading (radians), by index."""
        with reading(self._path, "world_from_base of the frames"):
            cells = self._file.table(schema.FRAMES).cells("world_from_base")
            poses = np.array(cells, dtype=np.float64).reshape(-1, 4, 4)
            if not np.isfinite(poses).all():
                raise ValueError("expected 16 finite numbers a frame")
            headings = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
            places = np.column_stack([poses[:, 0, 3], poses[:, 1, 3], headings]).tolist()
        return {index: tuple(places[row]) for index, row in self._rows.items()}

    def camera(self) -> Camera | None:
        """The intrinsics of the first frame; None if there is none."""
        return next((self._camera(index) for index in self.facts), None)

    def _camera(self, index: int) -> Camera:
        with reading(self._path, f"the camera of frame {index}"):
            width, height, *rest = self._file.table(schema.FRAMES).cell("camera", self._rows[index])
            if len(rest) != 4 or not np.isfinite([width, height, *rest]).all() or min(width, height) < 1:
                raise ValueError("expected width, height, fx, fy, cx, cy")
            return Camera(int(width), int(height), *rest)

    def _pose(self, index: int, name: str) -> FloatArray:
        with reading(self._path, f"{name} of frame {index}"):
            pose: FloatArray = np.array(
                self._file.table(schema.FRAMES).cell(name, self._rows[index]), dtype=np.float64
            )
            if not np.isfinite(pose).all():
                raise ValueError("expected 16 finite numbers")
            return pose.reshape(4, 4)

    # Commands.

    @cached_property
    def commands(self) -> Mapping[int, Command]:
        """The command that led to a frame, by frame."""
        return self._commands_of(schema.COMMANDS)

    @cached_property
    def advice(self) -> Mapping[int, Command]:
        """Of a replay: the command that navigation asked for before a frame, by frame."""
        return self._commands_of(schema.ADVICE)

    def _commands_of(self, place: schema.Table) -> Mapping[int, Command]:
        table = self._file.table(place)
        with reading(self._path, "the commands"):
            columns = [table.values(name) for name in ("linear", "angular", "pan", "tilt")]
            return {
                frame: Command(*(float(column[row]) for column in columns))
                for frame, row in table.last_of_frame.items()
            }

    # Perception.

    @property
    def detected(self) -> Sequence[int]:
        """Indices of the frames that perception ran on, ascending."""
        return list(self._file.table(schema.DETECTIONS).last_of_frame)

    def detections(self, index: int) -> Sequence[Detection] | None:
        """The detections of a frame, masks and features exactly; None where perception did not run."""
        table = self._file.table(schema.DETECTIONS)
        row = table.last_of_frame.get(index)
        if row is None:
            return None
        with reading(self._path, f"the detections of frame {index}"):
            count, height, width = table.cell("mask_shape", row)
            masks = decode_masks(table.value("masks", row) or b"", (count, height, width))
            names = ("labels", "scores", "boxes", "text_features", "image_features")
            cells: dict[str, Any] = {name: table.cell(name, row) for name in names}
            cells["label_scores"] = table.value("label_scores", row)
            return detections_from_row(cells, masks, self._blobs)

    def kept(self, index: int) -> Mapping[int, MaskArray] | None:
        """Which voxels of its mask were kept of each lifted detection; None where the file does not say."""
        table = self._file.table(schema.DETECTIONS)
        row = table.last_of_frame.get(index)
        if row is None:
            return None
        with reading(self._path, f"what was lifted of frame {index}"):
            cells = {"voxels": table.cell("voxels", row)}
            return kept_from_row(cells | {name: table.value(name, row) for name in ("observations", "kept")})

    def detection_cells(self, index: int) -> Mapping[str, Sequence[Any]] | None:
        """The detections of a frame as they are stored, to be compared without decoding a mask."""
        table = self._file.table(schema.DETECTIONS)
        row = table.last_of_frame.get(index)
        if row is None:
            return None
        with reading(self._path, f"the detections of frame {index}"):
            return {name: table.cell(name, row) for name in _SEEN}

    def detection_hashes(self) -> Mapping[int, bytes]:
        """A hash of each frame's detections as they are stored; chunk by chunk, nothing is kept."""
        found = {}
        with reading(self._path, "the detections"):
            for table in self._file.chunks(schema.DETECTIONS):
                cells = zip(*(table.cells(name) for name in _SEEN), strict=True)
                for frame, row in zip(table.frames, cells, strict=True):
                    found[frame] = hashlib.blake2b(repr(row).encode(), digest_size=16).digest()
        return found

    def detected_names(self) -> Mapping[int, Sequence[tuple[str, float]]]:
        """Label and score of every detection, by frame, ascending."""
        found: dict[int, Sequence[tuple[str, float]]] = {}
        with reading(self._path, "the detections"):
            for table in self._file.chunks(schema.DETECTIONS):
                columns = table.cells("labels"), table.cells("scores")
                for frame, labels, scores in zip(table.frames, *columns, strict=True):
                    found[frame] = list(zip(labels, scores, strict=True))
        return dict(sorted(found.items()))

    @cached_property
    def label_vectors(self) -> Mapping[str, Float32Array]:
        """Label -> the text feature (D,) that it was first detected with; labels without one are left out."""
        table = self._file.table(schema.DETECTIONS)
        names: dict[str, str] = {}
        for labels, hashes in zip(table.cells("labels"), table.cells("text_features"), strict=True):
            for label, name in zip(labels, hashes, strict=False):
                if name and label not in names:
                    names[label] = name
        with reading(self._path, "the features of labels"):
            return {label: feature_of(self._blobs[name]) for label, name in names.items()}

    # Truth.

    @property
    def with_truth(self) -> Sequence[int]:
        """Indices of the frames whose truth is recorded, ascending."""
        return list(self._truths)

    def truth(self, index: int, *, lazy: bool = False) -> Truth | None:
        """The simulator's truth of a frame, if there was any; `lazy`: instances are decoded on first use."""
        if index not in self._truths:
            return None

        def instances() -> IntArray:
            stored = self.encoded_truth(index)
            with reading(self._path, f"the truth of frame {index}"):
                if stored is None:
                    raise ValueError("its instances are missing")
                return decode_instances(*stored)

        with reading(self._path, f"the truth of frame {index}"):
            objects = self._objects_of(self._truths[index][0])
        return LazyTruth(instances, objects) if lazy else Truth(instances(), objects)

    def encoded_truth(self, index: int) -> tuple[bytes, tuple[int, int]] | None:
        """The instances of a frame's truth as they are stored, with their (H, W); None if there are none."""
        data = self._file.blob(schema.TRUTH.path, schema.TRUTH.component("instances"), index)
        if data is None or index not in self._truths:
            return None
        with reading(self._path, f"the truth of frame {index}"):
            height, width = self._truths[index][1]
            return data, (int(height), int(width))

    def _objects_of(self, text: str) -> tuple[TruthObject, ...]:
        """The objects of a text; the latest are kept, for most frames say nothing new."""
        if self._latest_objects[0] != text:
            self._latest_objects = (text, truth_objects(text))
        return self._latest_objects[1]

    @cached_property
    def _truths(self) -> Mapping[int, tuple[str, Sequence[Any]]]:
        """The JSON of the truth's objects and the (H, W) of its instances, by frame, ascending.

        A row says the objects only where they changed; the instances, which are large, stay on disk.
        """
        rows: dict[int, tuple[str | None, Sequence[Any]]] = {}
        with reading(self._path, "the truth"):
            for table in self._file.chunks(schema.TRUTH):
                cells = table.values("objects"), table.cells("instances_shape")
                rows |= {
                    frame: (text, shape) for frame, text, shape in zip(table.frames, *cells, strict=True)
                }
        latest = "[]"
        found = {}
        for frame, (text, shape) in sorted(rows.items()):
            latest = text or latest
            found[frame] = latest, shape
        return found
