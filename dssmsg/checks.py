"""What a plug-in returned, held against its contract at the boundary.

Each check returns the value (a sequence as a tuple) or raises CheckFailed, which says what was expected and
what came instead. Values that check themselves when made (Frame, Detection) are only checked here for what
they cannot know: the frame they belong to.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from dssmsg.events import Candidate, WindowEvaluated
from dssmsg.frame import Detection, Float32Array, Frame, MaskArray, Observation, depth_from_millimetres
from dssmsg.graph.changes import CHANGE_TYPES, Change
from dssmsg.graph.view import GraphView
from dssmsg.interfaces import Answer, Box, Command, Finding, SourceInfo, Step, UpdateResult
from dssmsg.interfaces.diagnosis import LAYERS

RIGID_TOLERANCE = 1e-3


class CheckFailed(ValueError):
    """A plug-in returned something that its contract does not allow."""


def check_frame(frame: Any, info: SourceInfo, previous: Frame | None = None) -> Frame | None:
    """A frame of a source, or None for the end: announced size, rigid poses, order, whole millimetres."""
    if frame is None:
        return None
    _expect(frame, Frame, "a Frame or None")
    size, announced = (frame.camera.height, frame.camera.width), (info.camera.height, info.camera.width)
    if size != announced:
        raise CheckFailed(f"frame {frame.index}: expected images of {announced} (rows, columns), got {size}")
    for name in ("world_from_camera", "world_from_base"):
        _expect_rigid(getattr(frame, name), f"frame {frame.index}: {name}")
    if not math.isfinite(frame.sim_time):
        raise CheckFailed(f"frame {frame.index}: sim_time is {frame.sim_time}")
    if previous is not None and frame.index <= previous.index:
        raise CheckFailed(f"expected a frame index above {previous.index}, got {frame.index}")
    if previous is not None and frame.sim_time < previous.sim_time:
        raise CheckFailed(
            f"frame {frame.index}: sim_time goes back from {previous.sim_time} to {frame.sim_time}"
        )
    millimetres = np.rint(np.clip(frame.depth * np.float32(1000.0), 0, 65535)).astype(np.uint16)
    if not np.array_equal(depth_from_millimetres(millimetres), frame.depth):
        raise CheckFailed(f"frame {frame.index}: depth is not in whole millimetres, see quantise_depth")
    if frame.truth is not None and frame.truth.instance_ids.shape != size:
        raise CheckFailed(
            f"frame {frame.index}: truth.instance_ids: expected {size}, got {frame.truth.instance_ids.shape}"
        )
    return frame  # type: ignore[no-any-return]


def check_count(value: Any) -> int:
    """A count: a whole number from 0 up."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise CheckFailed(f"expected a whole number from 0 up, got {value!r}")
    return value


def check_detections(frame: Frame, value: Any) -> tuple[Detection, ...]:
    """Detections of a frame: their masks have its size, their features of one kind have one length."""
    detections = _sequence(value, Detection, "detection")
    size = (frame.camera.height, frame.camera.width)
    lengths: dict[str, int] = {}
    for place, detection in enumerate(detections):
        if detection.mask.shape != size:
            raise CheckFailed(f"detection {place}: mask: expected {size}, got {detection.mask.shape}")
        if not np.isfinite(detection.box_xyxy).all():
            raise CheckFailed(f"detection {place}: box_xyxy holds NaN or infinity")
        _expect_score(detection.score, f"detection {place}: score")
        for name in ("text_feature", "image_feature"):
            feature = getattr(detection, name)
            if feature is None:
                continue
            if not np.isfinite(feature).all():
                raise CheckFailed(f"detection {place}: {name} holds NaN or infinity")
            length = lengths.setdefault(name, len(feature))
            if len(feature) != length:
                raise CheckFailed(f"detection {place}: {name}: expected ({length},), got {feature.shape}")
    return detections


def check_observations(value: Any) -> tuple[Observation, ...]:
    """Observations: points (N, 3) finite, as many colours, a box the right way round."""
    observations = _sequence(value, Observation, "observation")
    for place, observation in enumerate(observations):
        points, name = observation.points_world, f"observation {place}"
        _expect_shape(points, (None, 3), f"{name}: points_world")
        _expect_shape(observation.colors, points.shape, f"{name}: colors")
        for corner in ("box_min", "box_max"):
            _expect_shape(getattr(observation, corner), (3,), f"{name}: {corner}")
        if (observation.box_min > observation.box_max).any():
            raise CheckFailed(f"{name}: box_min is above box_max")
        _expect_score(observation.score, f"{name}: score")
    return observations


def check_changes(value: Any) -> tuple[Change, ...]:
    """Changes of a known kind, every array in them finite; what they refer to is the graph's to check."""
    changes = _sequence(value, Change, "change")
    for place, change in enumerate(changes):
        if CHANGE_TYPES.get(change.kind) is not type(change):
            raise CheckFailed(
                f"change {place}: {type(change).__name__} is no kind of change that the graph knows"
            )
        name = f"change {place} ({change.kind})"
        for entry in fields(change):
            _expect_finite(getattr(change, entry.name), f"{name}: {entry.name}")
        for score in change.scores:
            if not math.isfinite(score.value):
                raise CheckFailed(f"{name}: score {score.name} is {score.value}")
    return changes


def check_update(value: Any) -> UpdateResult:
    """Changes and window evaluations of an update."""
    _expect(value, UpdateResult, "an UpdateResult")
    changes = check_changes(value.changes)
    windows = _sequence(value.windows, WindowEvaluated, "window")
    return UpdateResult(changes, windows)


def check_candidates(graph: GraphView, value: Any) -> tuple[Candidate, ...]:
    """Ranked viewpoints: known ones, each once, scores finite."""
    candidates = _sequence(value, Candidate, "candidate")
    seen: set[str] = set()
    for place, candidate in enumerate(candidates):
        if candidate.viewpoint_id not in graph.viewpoints:
            raise CheckFailed(f"candidate {place}: no viewpoint {candidate.viewpoint_id!r} in the graph")
        if candidate.viewpoint_id in seen:
            raise CheckFailed(f"candidate {place}: {candidate.viewpoint_id} is ranked twice")
        seen.add(candidate.viewpoint_id)
        for name, score in candidate.scores.items():
            if not math.isfinite(score):
                raise CheckFailed(f"candidate {place}: score {name} is {score}")
    return candidates


def check_command(value: Any) -> Command:
    """A command with finite speeds and angles."""
    _expect(value, Command, "a Command")
    for entry in fields(value):
        number = getattr(value, entry.name)
        if isinstance(number, bool) or not isinstance(number, (int, float, np.floating, np.integer)):
            raise CheckFailed(f"command: {entry.name}: expected a number, got {type(number).__name__}")
        if not math.isfinite(number):
            raise CheckFailed(f"command: {entry.name} is {number}")
    return Command(*(float(getattr(value, entry.name)) for entry in fields(value)))


def check_step(value: Any) -> Step:
    """A step of navigation: its command and its changes."""
    _expect(value, Step, "a Step")
    check_command(value.command)
    check_changes(value.changes)
    for name in ("state", "outcome", "detail"):
        _expect(getattr(value, name), str, f"text as {name}")
    return value  # type: ignore[no-any-return]


def check_answer(value: Any) -> Answer:
    """An answer of an LLM: a mapping that came from a text."""
    _expect(value, Answer, "an Answer")
    _expect(value.value, Mapping, "a mapping as value")
    _expect(value.text, str, "text")
    return value  # type: ignore[no-any-return]


def check_vectors(value: Any, count: int, dimension: int) -> Float32Array:
    """Vectors (count, dimension) of unit length."""
    _expect(value, np.ndarray, "an array")
    _expect_shape(value, (count, dimension), "vectors")
    lengths = np.linalg.norm(value, axis=1)
    if count and not np.abs(lengths - 1.0).max() <= 1e-3:  # NaN is no length either
        raise CheckFailed(
            f"expected unit vectors, the length of one is {lengths[np.abs(lengths - 1.0).argmax()]:.4f}"
        )
    return np.asarray(value, dtype=np.float32)


def check_tags(value: Any) -> tuple[str, ...]:
    """Label texts of a tagger."""
    tags = _sequence(value, str, "tag")
    for place, tag in enumerate(tags):
        if not tag.strip():
            raise CheckFailed(f"tag {place} is empty")
    return tags


def check_boxes(value: Any) -> tuple[Box, ...]:
    """Boxes of a detector: finite, the right way round."""
    boxes = _sequence(value, Box, "box")
    for place, box in enumerate(boxes):
        _expect_shape(np.asarray(box.xyxy), (4,), f"box {place}: xyxy")
        if box.xyxy[0] > box.xyxy[2] or box.xyxy[1] > box.xyxy[3]:
            raise CheckFailed(f"box {place}: expected x0 <= x1 and y0 <= y1, got {list(box.xyxy)}")
        _expect_score(box.score, f"box {place}: score")
    return boxes


def check_masks(frame: Frame, value: Any, count: int) -> tuple[MaskArray, ...]:
    """Masks of a segmenter: one a box, of the frame's size, bool."""
    masks = _sequence(value, np.ndarray, "mask")
    size = (frame.camera.height, frame.camera.width)
    if len(masks) != count:
        raise CheckFailed(f"expected {count} masks, one a box, got {len(masks)}")
    for place, mask in enumerate(masks):
        if mask.dtype != np.bool_:
            raise CheckFailed(f"mask {place}: expected bool, got {mask.dtype}")
        _expect_shape(mask, size, f"mask {place}")
    return masks


def check_findings(value: Any) -> tuple[Finding, ...]:
    """Findings of a diagnosis: a layer that there is, how sure in 0..1."""
    findings = _sequence(value, Finding, "finding")
    for place, finding in enumerate(findings):
        if finding.layer not in LAYERS:
            known = ", ".join(LAYERS)
            raise CheckFailed(f"finding {place}: expected a layer of {known}, got {finding.layer!r}")
        _expect_score(finding.confidence, f"finding {place}: confidence")
    return findings


def _sequence(value: Any, kind: type, name: str) -> tuple[Any, ...]:
    if not isinstance(value, Sequence) or isinstance(value, (str, bytes)):
        raise CheckFailed(f"expected a list of {kind.__name__}, got {_type(value)}")
    for place, one in enumerate(value):
        if not isinstance(one, kind):
            raise CheckFailed(f"{name} {place}: expected {kind.__name__}, got {_type(one)}")
    return tuple(value)


def _expect(value: Any, kind: type, name: str) -> None:
    if not isinstance(value, kind):
        raise CheckFailed(f"expected {name}, got {_type(value)}")


def _expect_score(value: Any, name: str) -> None:
    if not (isinstance(value, (int, float, np.floating)) and 0.0 <= value <= 1.0):
        raise CheckFailed(f"{name}: expected a number in 0..1, got {value!r}")


def _expect_shape(array: Any, shape: tuple[int | None, ...], name: str) -> None:
    got = getattr(array, "shape", None)
    fits = (
        got is not None
        and len(got) == len(shape)
        and all(want is None or want == have for want, have in zip(shape, got, strict=True))
    )
    if not fits:
        wanted = "(" + ", ".join("N" if one is None else str(one) for one in shape) + ")"
        raise CheckFailed(f"{name}: expected {wanted}, got {_type(array) if got is None else got}")
    _expect_finite(array, name)


def _expect_finite(value: Any, name: str) -> None:
    if isinstance(value, np.ndarray) and value.dtype.kind == "f" and not np.isfinite(value).all():
        raise CheckFailed(f"{name} holds NaN or infinity")
    if isinstance(value, float) and not math.isfinite(value):
        raise CheckFailed(f"{name} is {value}")


def _expect_rigid(pose: Any, name: str) -> None:
    rotation = pose[:3, :3]
    square = np.abs(rotation @ rotation.T - np.eye(3)).max() < RIGID_TOLERANCE
    if not (
        square and np.linalg.det(rotation) > 0 and np.abs(pose[3] - [0, 0, 0, 1]).max() < RIGID_TOLERANCE
    ):
        raise CheckFailed(f"{name} is not a rigid transform (rotation, translation, last row 0 0 0 1)")


def _type(value: Any) -> str:
    return "nothing" if value is None else type(value).__name__
