"""Frame -> things: dense network, grouping, crop encoder, and one opinion of the two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dssmsg.frame import Float32Array, Frame, MaskArray
from dssmsg.recogniser.crops import CropImages, cut
from dssmsg.recogniser.grouping import GroupingRule, group
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
        max_things: int = 14,
    ) -> None:
        """Raises PluginError where the weights are missing or changed."""
        self.card, place = read_card(weights)
        self._masks = MaskNetwork(place, self.card, threads)
        self._crops = CropNetwork(place, self.card, threads)
        self._rule = rule or GroupingRule()
        self._max_things = max_things

    @property
    def labels(self) -> tuple[str, ...]:
        """What it can name."""
        return self.card.labels

    def see(self, frame: Frame) -> list[Seen]:
        """The things of a frame, the largest first, at most `max_things`."""
        working = WorkingFrame.of(frame)
        geometry = self._geometry(frame, working)
        dense, classes = self._dense(working, geometry)
        groups = group(dense, classes, working.depth, geometry.depth, self._rule)[: self._max_things]
        if not groups:
            return []
        vectors, logits = self._crops.run(
            *cut(CropImages.of(working.rgb, geometry), [one.mask for one in groups])
        )
        probabilities = self.joint(logits, np.stack([one.labels for one in groups]))
        return [
            Seen(working.enlarged(one.mask), p, v, one.thing, one.peak, int(np.count_nonzero(one.mask)))
            for one, p, v in zip(groups, probabilities, vectors, strict=True)
        ]

    def opinions(
        self, frame: Frame, masks: Sequence[MaskArray]
    ) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Of given masks (H, W), none empty: the crop encoder's vectors (N, D) and logits (N, C + 1), and the
        dense network's label probabilities (N, C + 1)."""
        working = WorkingFrame.of(frame)
        geometry = self._geometry(frame, working)
        small = [working.reduced(mask) for mask in masks]
        _dense, classes = self._dense(working, geometry)
        views = softmax(classes.transpose(1, 2, 0))
        vectors, logits = self._crops.run(*cut(CropImages.of(working.rgb, geometry), small))
        return vectors, logits, np.stack([_pooled(views, mask) for mask in small])

    def joint(self, logits: Float32Array, context: Float32Array) -> Float32Array:
        """Label probabilities (N, C + 1) of both networks together, by the card's calibration."""
        crop = np.log(softmax(logits, self.card.temperature) + _TINY)
        return softmax(crop + np.float32(self.card.context) * np.log(context + _TINY))

    def _geometry(self, frame: Frame, working: WorkingFrame) -> HalfGeometry:
        floor = float(frame.world_from_base[2, 3])
        return half_geometry(working.depth, working.camera, frame.world_from_camera, floor)

    def _dense(self, working: WorkingFrame, geometry: HalfGeometry) -> tuple[Float32Array, Float32Array]:
        return self._masks.run(normalised_rgb(working.rgb), geometry_channels(geometry))


def _pooled(views: Float32Array, mask: MaskArray) -> Float32Array:
    """Mean label probabilities (C + 1,) of views (h, w, C + 1) over a mask (4h, 4w)."""
    there = mask[::4, ::4][: views.shape[0], : views.shape[1]]
    mean: Float32Array = views[there].mean(axis=0) if there.any() else views.mean(axis=(0, 1))
    return mean
