"""Stage `proposals`: what the trained mask network draws in the training views, and what that is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dssmsg.recogniser.grouping import GroupingRule, candidates
from dssmsg.recogniser.inputs import geometry_channels, half_geometry, normalised_rgb
from dssmsg.recogniser.networks import MaskNetwork, read_card
from dssmsg.recogniser.shelf import all_labels
from dssmsg.recogniser.views import CAMERA
from training.render import load, shards

RIGHT_IOU, WRONG_IOU = 0.5, 0.3
"""From here on a mask is the thing; below, it is no thing of its own. Between the two nobody can say."""
PART_SHARE = 0.15
"""A thing that others hide in part shows in parts: one with this share of its pixels names it as well, as the
back of a chair does behind its table."""


@dataclass(frozen=True, slots=True)
class Proposals:
    """Masks of a shard's views: view (N,), label (N,), the last label + 1 = nothing; bits (N, H * W / 8)."""

    view: NDArray[np.int32]
    label: NDArray[np.int32]
    bits: NDArray[np.uint8]

    def mask(self, index: int) -> NDArray[np.bool_]:
        """Mask (H, W) of a proposal."""
        return np.unpackbits(self.bits[index]).reshape(CAMERA.height, CAMERA.width).astype(np.bool_)


def propose(folder: Path, weights: Path, out: Path) -> None:
    """One file a shard, written once, so that the stage can be stopped and resumed."""
    out.mkdir(parents=True, exist_ok=True)
    card, place = read_card(weights)
    network = MaskNetwork(place, card, 1)
    rule = GroupingRule(join=card.joining)
    for path in shards(folder):
        target = out / path.name
        if target.exists():
            continue
        shard = load(path)
        rows: list[tuple[int, int, NDArray[np.uint8]]] = []
        for view in range(len(shard.rgb)):
            depth = shard.depth_mm[view].astype(np.float32) / np.float32(1000)
            geometry = half_geometry(depth, CAMERA, shard.poses[view], 0.0)
            dense, classes = network.run(normalised_rgb(shard.rgb[view]), geometry_channels(geometry))
            for one in candidates(dense, classes, depth, geometry, rule):
                label = name_of(one.mask, shard.ids[view], shard.label)
                if label is not None:
                    rows.append((view, label, np.packbits(one.mask)))
        temporary = target.with_suffix(".part")
        with temporary.open("wb") as file:
            np.savez(
                file,
                view=np.array([row[0] for row in rows], np.int32),
                label=np.array([row[1] for row in rows], np.int32),
                bits=np.array([row[2] for row in rows], np.uint8),
            )
        temporary.replace(target)


def name_of(mask: NDArray[np.bool_], ids: NDArray[np.uint8], label: NDArray[np.int16]) -> int | None:
    """The label of what a mask shows, `len(all_labels())` for nothing, None where it is hard to say."""
    counts = np.bincount(ids[mask], minlength=len(label))
    number = int(np.argmax(counts[1:])) + 1 if len(counts) > 1 else 0
    whole = ids == number
    if not number:
        return len(all_labels())
    iou = _iou(mask, whole)
    if iou >= RIGHT_IOU or _best_part(mask, whole) >= RIGHT_IOU:
        return int(label[number])
    return len(all_labels()) if iou < WRONG_IOU else None


def _iou(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    return float((one & other).sum() / max((one | other).sum(), 1))


def _best_part(mask: NDArray[np.bool_], whole: NDArray[np.bool_]) -> float:
    """The best IoU of a mask (H, W) with a part of a thing that is apart from its others in the image."""
    parts, _count = ndimage.label(whole)
    sizes = np.bincount(parts.ravel())
    large = np.flatnonzero(sizes[1:] >= PART_SHARE * whole.sum()) + 1
    return max((_iou(mask, parts == part) for part in large), default=0.0)


def load_proposals(path: Path) -> Proposals:
    """The proposals of a shard."""
    with np.load(path) as data:
        return Proposals(data["view"], data["label"], data["bits"])
