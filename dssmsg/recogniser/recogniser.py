"""Frame -> things: dense network, grouping, crop encoder, and one opinion of the two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dssmsg.frame import Float32Array, Frame, MaskArray
from dssmsg.recogniser.crops import CropImages, cut
from dssmsg.recogniser.grouping import Group, GroupingRule, candidates, chosen, limited, pooled
from dssmsg.recogniser.inputs import (
    HalfGeometry,
    geometry_channels,
    half_geometry,
    normalised_rgb,
)
from dssmsg.recogniser.networks import CropNetwork, MaskNetwork, read_card, softmax
from dssmsg.recogniser.working import WorkingFrame

_TINY = np.float32(1e-6)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A thing in a frame: mask (H, W), probabilities (C + 1,) of the labels and, last, of "no thing of
    its own"; unit vector (D,) in the text space; `thing` and `peak` of the grouping; working pixels."""

    mask: MaskArray
    probabilities: Float32Array
    vector: Float32Array
    thing: float
    peak: float
    pixels: int

    @property
    def evidence(self) -> Float32Array:
        """What the score is calibrated on: (5,) label and thing as log-odds, peak, size, and 1."""
        named = self.probabilities[:-1]
        best = float(np.clip(named.max(), 1e-4, 1 - 1e-4))
        thing = float(np.clip(self.thing, 1e-4, 1 - 1e-4))
        odds = [np.log(value / (1 - value)) for value in (best, thing)]
        return np.array([*odds, self.peak, np.log(max(self.pixels, 1)) - 6.0, 1.0], np.float32)


class Recogniser:
    """The shipped networks as one: holds no state between frames."""

    def __init__(
        self,
        weights: Path | None = None,
        *,
        threads: int = 1,
        rule: GroupingRule | None = None,
        max_crops: int = 24,
    ) -> None:
        """Raises PluginError where the weights are missing or changed."""
        self.card, place = read_card(weights)
        self._masks = MaskNetwork(place, self.card, threads)
        self._crops = CropNetwork(place, self.card, threads)
        self._rule = rule or GroupingRule(join=self.card.joining)
        self._max_crops = max_crops

    @property
    def labels(self) -> tuple[str, ...]:
        """What it can name."""
        return self.card.labels

    def see(self, frame: Frame) -> list[Seen]:
        """The things of a frame, the largest first; none overlaps another."""
        working, groups, seen = self.consider(frame)
        return [
            replace(seen[i], mask=working.enlarged(seen[i].mask))
            for i in chosen(groups, [self.score(one) for one in seen])
        ]

    def score(self, seen: Seen) -> float:
        """The chance that mask and best label are both right, 0..1."""
        weights = np.asarray(self.card.quality, np.float32)
        return float(1 / (1 + np.exp(-float(weights @ seen.evidence))))

    def consider(self, frame: Frame) -> tuple[WorkingFrame, list[Group], list[Seen]]:
        """Everything that may be a thing, each with its names; masks at working size."""
        working = WorkingFrame.of(frame)
        geometry = self._geometry(frame, working)
        maps = self._dense(working, geometry)
        groups = limited(candidates(*maps, working.depth, geometry, self._rule), self._max_crops)
        if not groups:
            return working, [], []
        vectors, logits = self._crops.run(
            *cut(CropImages.of(working.rgb, geometry), [one.mask for one in groups])
        )
        probabilities = self.joint(logits, np.stack([one.labels for one in groups]))
        seen = [
            Seen(one.mask, p, v, one.thing, one.peak, one.pixels)
            for one, p, v in zip(groups, probabilities, vectors, strict=True)
        ]
        return working, groups, seen

    def opinions(
        self, frame: Frame, masks: Sequence[MaskArray]
    ) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Of given masks (H, W), none empty: the crop encoder's vectors (N, D) and logits (N, C + 1), and the
        dense network's label probabilities (N, C + 1)."""
        working = WorkingFrame.of(frame)
        geometry = self._geometry(frame, working)
        small = [working.reduced(mask) for mask in masks]
        _dense, classes = self._dense(working, geometry)
        labels = softmax(classes.transpose(1, 2, 0)).transpose(2, 0, 1)
        vectors, logits = self._crops.run(*cut(CropImages.of(working.rgb, geometry), small))
        return vectors, logits, np.stack([pooled(labels, mask[::2, ::2]) for mask in small])

    def joint(self, logits: Float32Array, context: Float32Array) -> Float32Array:
        """Label probabilities (N, C + 1) of both networks together, by the card's calibration."""
        crop = np.log(softmax(logits, self.card.temperature) + _TINY)
        return softmax(crop + np.float32(self.card.context) * np.log(context + _TINY))

    def _geometry(self, frame: Frame, working: WorkingFrame) -> HalfGeometry:
        floor = float(frame.world_from_base[2, 3])
        return half_geometry(working.depth, working.camera, frame.world_from_camera, floor)

    def _dense(self, working: WorkingFrame, geometry: HalfGeometry) -> tuple[Float32Array, Float32Array]:
        return self._masks.run(normalised_rgb(working.rgb), geometry_channels(geometry))
