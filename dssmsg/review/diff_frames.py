"""Where two runs part by their frames: what the source gave, what was looked at, what perception saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dssmsg.frame import FloatArray
from dssmsg.recording.reader import Recording
from dssmsg.review.divergence import Divergence, parted, plugin_of

IMAGES_BEFORE = 50
"""So many frames before the first difference have their images compared too: depth acts through the floor
plan, which remembers."""


def source_divergence(a: Recording, b: Recording) -> Divergence | None:
    """The first frame that is missing in one, was taken elsewhere or came about by another command."""
    for index in sorted({*a.frame_indices, *b.frame_indices}):
        if index not in a.frame_facts or index not in b.frame_facts:
            lacks = "A" if index not in a.frame_facts else "B"
            return parted(index, "source", "source", f"{lacks} has no frame {index}", fields=("frame",))
        ours, theirs = a.frame_facts[index], b.frame_facts[index]
        poses = list(zip(a.poses(index), b.poses(index), strict=True))
        if not all(np.array_equal(one, other) for one, other in poses):
            return _pose(a, b, index, poses[0])
        for name in ("visit", "at_stop", "collisions"):
            values = getattr(ours, name), getattr(theirs, name)
            if values[0] != values[1]:
                return parted(index, "source", "source", f"{name} differs", map(str, values), fields=(name,))
    return None


def _pose(a: Recording, b: Recording, index: int, poses: tuple[FloatArray, FloatArray]) -> Divergence:
    commands = a.command(index), b.command(index)
    driver = "mission" if commands[0] != commands[1] else "source"
    moved = float(np.linalg.norm(poses[0][:3, 3] - poses[1][:3, 3]))
    turn = float(np.clip((np.trace(poses[0][:3, :3].T @ poses[1][:3, :3]) - 1) / 2, -1.0, 1.0))
    what = f"the camera stands {moved:.4f} m and {np.degrees(np.arccos(turn)):.3f} degrees apart"
    if driver == "mission":
        return parted(
            index, driver, driver, what, (f"command {one}" for one in commands), fields=("command", "pose")
        )
    return parted(
        index, driver, plugin_of(a, "source"), what, (_spot(pose) for pose in poses), fields=("pose",)
    )


def _spot(pose: FloatArray) -> str:
    return "at (" + ", ".join(f"{value:.4f}" for value in pose[:3, 3]) + ") m"


def image_divergence(a: Recording, b: Recording, until: int) -> Divergence | None:
    """The first frame shortly before `until` whose images differ, where both store them alike."""
    if a.facts.get("images") != b.facts.get("images"):
        return None
    both = [i for i in a.frame_indices if until - IMAGES_BEFORE <= i <= until and i in b.frame_facts]
    for index in both:
        ours, theirs = a.encoded_images(index), b.encoded_images(index)
        if ours is None or theirs is None or ours == theirs:
            continue
        names = tuple(
            name for name, one, other in zip(("colours", "depth"), ours, theirs, strict=True) if one != other
        )
        what = f"the images differ: {' and '.join(names)}"
        return parted(index, "source", plugin_of(a, "source"), what, fields=names)
    return None


def key_frame_divergence(a: Recording, b: Recording) -> Divergence | None:
    """The first frame that is a key frame of one run alone."""
    for index in a.frame_indices:
        if index not in b.frame_facts:
            return None
        ours, theirs = a.frame_facts[index], b.frame_facts[index]
        if ours.key_frame != theirs.key_frame:
            words = [f"{'a' if one.key_frame else 'no'} key frame" for one in (ours, theirs)]
            return parted(
                index, "mission", "mission", "another choice of key frames", words, fields=("key_frame",)
            )
    return None


def detection_divergence(a: Recording, b: Recording, until: int) -> Divergence | None:
    """The first frame up to `until` in which perception, or lifting, had something else to say."""
    plugin = plugin_of(a, "perception")
    hashes = a.detection_hashes(), b.detection_hashes()
    for index in a.key_frames:
        if index > until or index not in b.frame_facts:
            return None
        if hashes[0].get(index) == hashes[1].get(index):
            continue
        ours, theirs = a.detection_cells(index), b.detection_cells(index)
        if ours == theirs:
            continue
        if ours is None or theirs is None:
            sides = ["no detections were told" if one is None else _listed(one) for one in (ours, theirs)]
            return parted(
                index, "perception", plugin, "perception failed in one run", sides, fields=("detections",)
            )
        names = tuple(name for name in ours if name != "observations" and ours[name] != theirs[name])
        if names:
            return parted(
                index,
                "perception",
                plugin,
                _seen(ours, theirs, names),
                (_listed(ours), _listed(theirs)),
                names,
            )
        return parted(
            index, "lift", "lift", "the same detections were lifted differently", fields=("observations",)
        )
    return None


def _seen(ours: Mapping[str, Any], theirs: Mapping[str, Any], names: Sequence[str]) -> str:
    """What is other about the detections of a frame, in words."""
    labels = list(ours["labels"]), list(theirs["labels"])
    if len(labels[0]) != len(labels[1]):
        more, fewer = (labels[0], labels[1]) if len(labels[0]) > len(labels[1]) else (labels[1], labels[0])
        extra = list(more)
        for label in fewer:
            if label in extra:
                extra.remove(label)
        alone = "A" if more is labels[0] else "B"
        return (
            f"{len(labels[0])} detections in A, {len(labels[1])} in B; only {alone} saw: {', '.join(extra)}"
        )
    changed = [
        f"detection {place}: {one} -> {other}"
        for place, (one, other) in enumerate(zip(*labels, strict=True))
        if one != other
    ]
    return "; ".join(changed) if changed else f"the same labels, other {', '.join(names)}"


def _listed(cells: Mapping[str, Any]) -> str:
    found = [f"{label} {score:.2f}" for label, score in zip(cells["labels"], cells["scores"], strict=False)]
    return ", ".join(found) or "nothing"
