"""What the truth says of detections and of objects in the map; every question decodes a few frames only."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.frame import FloatArray, IntArray, TruthObject
from dssmsg.geometry import back_project_world
from dssmsg.review.episode import MAX_RANGE_M, MIN_PIXELS, EpisodeCase, ReviewedRecording
from dssmsg.review.episode_map import ObjectHistory

MOST_FRAMES = 150
"""More key frames than these are not decoded for one question; they are spread evenly."""


@dataclass(frozen=True, slots=True)
class TrueSight:
    """A key frame that truly shows an answer. `names`: labels that detections gave to it; empty if missed."""

    frame: int
    instance: int
    names: tuple[str, ...]


def spread(frames: Sequence[int], most: int = MOST_FRAMES) -> list[int]:
    """At most so many of the frames, evenly spread, the first and the last among them."""
    if len(frames) <= most:
        return list(frames)
    return [frames[i] for i in sorted({round(x) for x in np.linspace(0, len(frames) - 1, most)})]


def true_sights(case: EpisodeCase) -> list[TrueSight]:
    """The key frames that show an answer well, with what the detector called it there."""
    recording, answers = case.recording, {thing.instance_id for thing in case.answers}
    found = []
    frames = [frame for frame in recording.key_frames if frame <= case.last]
    for frame in spread(frames) if answers else ():
        truth = recording.truth(frame)
        if truth is None or not _shown(truth.instance_ids, answers):
            continue  # its depth need not be decoded
        depth = recording.frame(frame).depth
        near = np.where((depth > 0) & (depth < MAX_RANGE_M), truth.instance_ids, 0)
        counts = np.bincount(near.ravel(), minlength=1)
        visible = _shown(near, answers)
        if not visible:
            continue
        names: dict[int, list[str]] = {i: [] for i in visible}
        for detection in recording.detections(frame) or ():
            shown = np.bincount(truth.instance_ids[detection.mask], minlength=1)
            for i in visible:
                if i < len(shown) and shown[i] >= 0.5 * shown.sum() and shown[i] >= 0.3 * counts[i]:
                    names[i].append(detection.label)
        found += [TrueSight(frame, i, tuple(names[i])) for i in visible]
    return found


def _shown(instance_ids: IntArray, wanted: Iterable[int]) -> list[int]:
    """Which of the wanted instances have enough pixels (H, W)."""
    counts = np.bincount(instance_ids.ravel(), minlength=1)
    return [i for i in wanted if i < len(counts) and counts[i] >= MIN_PIXELS]


def true_parts(recording: ReviewedRecording, thing: ObjectHistory, most: int = 30) -> Counter[str]:
    """Names of the true things that an object's sightings showed, by number of sightings."""
    parts: Counter[str] = Counter()
    sightings = spread(range(len(thing.sightings)), most)
    for sighting in (thing.sightings[i] for i in sightings):
        name = true_name(recording, sighting.frame, sighting.detection)
        if name:
            parts[name] += 1
    return parts


def true_name(recording: ReviewedRecording, frame: int, detection: int) -> str:
    """The name of the true thing under a detection's mask; empty where none has half of it."""
    truth, detections = recording.truth(frame), recording.detections(frame)
    if truth is None or detections is None or not 0 <= detection < len(detections):
        return ""
    shown = np.bincount(truth.instance_ids[detections[detection].mask], minlength=1)
    if not len(shown) or not shown.sum() or shown.argmax() == 0 or shown.max() < 0.5 * shown.sum():
        return ""
    instance = int(shown.argmax())
    return next((t.name for t in truth.objects if t.instance_id == instance), "")


def by_name(things: Iterable[TruthObject]) -> Mapping[str, TruthObject]:
    """True things by name."""
    return {thing.name: thing for thing in things}


def gap_to(thing: TruthObject, box: Sequence[float]) -> float:
    """Metres between a true thing's box and another; 0 where they touch."""
    low, high = np.asarray(box[:3]), np.asarray(box[3:])
    apart: FloatArray = np.maximum(0.0, np.maximum(thing.box_min - high, low - thing.box_max))
    return float(np.linalg.norm(apart))


def inside_share(recording: ReviewedRecording, frame: int, slack: float = 0.15) -> float | None:
    """Share of the pixels of true things that the frame's pose and depth put into these things' boxes.

    None where too little of anything is in view to tell.
    """
    truth = recording.truth(frame)
    if truth is None:
        return None
    image = recording.frame(frame)
    ids = np.where((image.depth > 0) & (image.depth < MAX_RANGE_M), truth.instance_ids, 0)
    counts = np.bincount(ids.ravel(), minlength=max((t.instance_id for t in truth.objects), default=0) + 1)
    inside = total = 0
    for thing in truth.objects:
        if counts[thing.instance_id] >= MIN_PIXELS:
            mask = ids == thing.instance_id
            own = back_project_world(image.depth, image.camera, image.world_from_camera, mask)
            within = (own >= thing.box_min - slack) & (own <= thing.box_max + slack)
            inside += int(np.count_nonzero(within.all(axis=1)))
            total += len(own)
    return inside / total if total else None
