"""Events as rows of the tables: one pure function an event, the shape of `dssmsg.recording.schema`.

Nothing is rounded here. What a row cannot hold as a number is canonical JSON (sorted keys, no spaces).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dssmsg import events
from dssmsg.frame import Detection, Float32Array, MaskArray, Truth, TruthObject
from dssmsg.interfaces.source import Command
from dssmsg.recording.damage import json_value
from dssmsg.recording.images import decode_bits, encode_bits, encode_instances, encode_masks

Row = dict[str, Any]


def plain_json(value: Any) -> str:
    """Canonical JSON of plain values; NaN and infinity are refused (ValueError)."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, default=_plain)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, (set, frozenset)):
        return sorted(value)
    return str(value)  # a path, say: the recording shall not fail over a fact it only passes on


def feature_blob(feature: Float32Array) -> tuple[str, bytes]:
    """A feature vector's hash and its bytes (little-endian float32)."""
    data = np.ascontiguousarray(feature, dtype="<f4").tobytes()
    return hashlib.blake2b(data, digest_size=16).hexdigest(), data


def feature_of(data: bytes) -> Float32Array:
    """The feature vector of `feature_blob`'s bytes. Raises ValueError if they are none, or not finite."""
    vector = np.frombuffer(data, dtype="<f4").astype(np.float32)
    if not np.isfinite(vector).all():
        raise ValueError("expected a feature of finite numbers")
    return vector


def frame_row(event: events.FrameCaptured, updates: int) -> Row:
    """A row of `/frames`; `updates` is how many changes the graph had gone through before it."""
    frame = event.frame
    camera = frame.camera
    return {
        "index": frame.index,
        "sim_time": frame.sim_time,
        "visit": frame.visit,
        "at_stop": frame.at_stop,
        "key_frame": event.key_frame,
        "viewpoint": event.viewpoint_id,
        "collisions": event.collisions,
        "updates": updates,
        "camera": [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy],
        "world_from_camera": frame.world_from_camera.ravel(),
        "world_from_base": frame.world_from_base.ravel(),
    }


def command_row(command: Command) -> Row:
    """A row of `/commands`."""
    return {
        "linear": command.linear,
        "angular": command.angular,
        "pan": command.pan,
        "tilt": command.tilt,
    }


def detections_row(event: events.Detected) -> tuple[Row, dict[str, bytes]]:
    """A row of `/detections`, and the features it refers to, by hash."""
    blobs: dict[str, bytes] = {}

    def refer(feature: Float32Array | None) -> str:
        if feature is None:
            return ""
        name, data = feature_blob(feature)
        blobs[name] = data
        return name

    detections = event.detections
    masks, shape = encode_masks([detection.mask for detection in detections])
    kept = [event.kept.get(observation.detection_index) for observation in event.observations]
    known = [voxels for voxels in kept if voxels is not None]
    row = {
        "labels": [detection.label for detection in detections],
        "scores": [detection.score for detection in detections],
        "boxes": np.concatenate([detection.box_xyxy for detection in detections]) if detections else [],
        "mask_shape": shape,
        "masks": masks,
        "text_features": [refer(detection.text_feature) for detection in detections],
        "image_features": [refer(detection.image_feature) for detection in detections],
        "label_scores": plain_json([detection.label_scores for detection in detections]),
        "observations": plain_json(
            [
                {
                    "detection": observation.detection_index,
                    "points": len(observation.points_world),
                    "range_m": observation.range_m,
                    "box_min": observation.box_min,
                    "box_max": observation.box_max,
                }
                for observation in event.observations
            ]
        ),
        "voxels": [len(voxels) for voxels in known],  # of all, or it is of no use
        "kept": encode_bits(known) if len(known) == len(kept) else None,
    }
    return row, blobs


def kept_from_row(row: Mapping[str, Any]) -> dict[int, MaskArray] | None:
    """What was kept of each lifted detection, by its index; None where the row does not say."""
    if row["kept"] is None:
        return None
    lifted = [one["detection"] for one in json_value(row["observations"])]
    return dict(zip(lifted, decode_bits(row["kept"], row["voxels"]), strict=True))


def detections_from_row(row: Mapping[str, Any], masks: Any, features: Mapping[str, bytes]) -> list[Detection]:
    """The detections of a row of `/detections`; `masks` (count, H, W) decoded, features by hash."""

    def feature(name: str) -> Float32Array | None:
        return feature_of(features[name]) if name else None

    runners_up = json_value(row["label_scores"])
    boxes = np.asarray(row["boxes"], dtype=np.float64).reshape(-1, 4)
    return [
        Detection(
            mask=masks[index],
            box_xyxy=boxes[index],
            label=label,
            score=row["scores"][index],
            text_feature=feature(row["text_features"][index]),
            image_feature=feature(row["image_features"][index]),
            label_scores=tuple((name, score) for name, score in runners_up[index]),
        )
        for index, label in enumerate(row["labels"])
    ]


def truth_objects_json(objects: Sequence[TruthObject]) -> str:
    """The objects of a truth as JSON, in their order."""
    return plain_json(
        [
            {
                "instance_id": thing.instance_id,
                "name": thing.name,
                "label": thing.label,
                "box_min": thing.box_min,
                "box_max": thing.box_max,
                "room": thing.room,
                "movable": thing.movable,
                "state": thing.state,
            }
            for thing in objects
        ]
    )


def truth_objects(text: str) -> tuple[TruthObject, ...]:
    """The objects of a truth from their JSON."""
    return tuple(
        TruthObject(
            **{
                **thing,
                "box_min": np.array(thing["box_min"], dtype=np.float64),
                "box_max": np.array(thing["box_max"], dtype=np.float64),
            }
        )
        for thing in json_value(text)
    )


def truth_row(truth: Truth, objects: str | None, stored: tuple[bytes, tuple[int, int]] | None = None) -> Row:
    """A row of `/truth`; `objects` is their JSON where it changed, else None.

    `stored`: the instances of the same frame as bytes, with their (H, W), where a recording has them.
    """
    data, shape = stored or (encode_instances(truth.instance_ids), truth.instance_ids.shape)
    return {
        "instances": data,
        "instances_shape": shape,
        "objects": objects,
    }


def window_row(event: events.WindowEvaluated) -> Row:
    """A row of `/windows`."""
    return {
        "viewpoint": event.viewpoint_id,
        "verdicts": ", ".join(f"{name} {verdict}" for name, verdict in sorted(event.verdicts.items())),
        "json": plain_json(
            {
                "viewpoint": event.viewpoint_id,
                "frame": event.frame,
                "sim_time": event.sim_time,
                "base": event.base,
                "comparison": event.comparison,
                "evidence": [
                    {
                        "frame": evidence.frame,
                        "object": evidence.object_id,
                        "verdict": evidence.verdict,
                        "values": evidence.values,
                    }
                    for evidence in event.evidence
                ],
                "verdicts": event.verdicts,
                "threshold": event.threshold,
            }
        ),
    }


def match_row(event: events.Matched) -> Row:
    """A row of `/match`: the query, its target graph and every candidate."""
    return {
        "query": event.query,
        "json": plain_json(
            {
                "query": event.query,
                "frame": event.frame,
                "sim_time": event.sim_time,
                "target": event.target,
                "candidates": [
                    {
                        "viewpoint": candidate.viewpoint_id,
                        "rank": candidate.rank,
                        "scores": candidate.scores,
                        "matching": candidate.matching,
                        "reason": candidate.reason,
                    }
                    for candidate in event.candidates
                ],
            }
        ),
    }


def candidate_row(query: str, candidate: events.Candidate) -> Row:
    """A row of `/match/candidates`, for tables in the viewer; ranked by `score`, else by the first."""
    scores = candidate.scores
    best = scores.get("score", next(iter(scores.values()), None))
    return {
        "query": query,
        "rank": candidate.rank,
        "viewpoint": candidate.viewpoint_id,
        "score": best,
        "scores": " · ".join(f"{name} {value:.3f}" for name, value in scores.items()),
        "matching": ", ".join(f"{target} = {found}" for target, found in candidate.matching.items()),
    }


def llm_row(event: events.LlmCalled) -> Row:
    """A row of `/llm`."""
    return {
        "role": event.role,
        "ok": event.ok,
        "json": plain_json(
            {
                "role": event.role,
                "provider": event.provider,
                "frame": event.frame,
                "sim_time": event.sim_time,
                "prompt": event.prompt,
                "answer": event.answer,
                "request_hash": event.request_hash,
                "ok": event.ok,
                "error": event.error,
                "tokens": event.tokens,
                "seconds": event.seconds,
                "attempt": event.attempt,
                "fallback_for": event.fallback_for,
            }
        ),
    }


def navigation_row(event: events.NavigationChanged) -> Row:
    """A row of `/nav/events`."""
    return {
        "state": event.state,
        "detail": event.detail,
        "json": plain_json(
            {
                "frame": event.frame,
                "sim_time": event.sim_time,
                "state": event.state,
                "detail": event.detail,
                "path": event.path,
                "target_xy": event.target_xy,
            }
        ),
    }


def episode_row(event: events.EpisodeEnded) -> Row:
    """A row of `/episodes`."""
    return {
        "goal": event.goal,
        "outcome": event.outcome,
        "json": plain_json(
            {
                "episode": event.episode,
                "goal": event.goal,
                "outcome": event.outcome,
                "reason": event.reason,
                "frame": event.frame,
                "sim_time": event.sim_time,
                "values": event.values,
            }
        ),
    }


def error_row(event: events.ErrorOccurred) -> Row:
    """A row of `/errors`."""
    return {
        "plugin": event.plugin,
        "message": event.message,
        "json": plain_json(
            {
                "frame": event.frame,
                "sim_time": event.sim_time,
                "plugin": event.plugin,
                "message": event.message,
                "skipped": event.skipped,
                "fatal": event.fatal,
            }
        ),
    }
