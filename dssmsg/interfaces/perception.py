"""perception: frame -> detections; and the links of a chain: tagger, detector, segmenter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from dssmsg.frame import Detection, Float32Array, FloatArray, Frame, MaskArray


@runtime_checkable
class Perception(Protocol):
    """Frame -> detections."""

    feature_space: str | None
    """The encoder space its features live in (`Encoder.space`), or None if it gives no features."""

    def detect(self, frame: Frame) -> Sequence[Detection]:
        """Detections of a key frame, in any order; masks (H, W) of the frame's size."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """A detector's output: xyxy (4,) pixels, label, score 0..1; `mask` where the detector gives one.

    `label_scores` are the labels that were considered, best first, where the detector tells them.
    """

    xyxy: FloatArray
    label: str
    score: float
    mask: MaskArray | None = None
    image_feature: Float32Array | None = None
    label_scores: tuple[tuple[str, float], ...] = ()


@runtime_checkable
class Tagger(Protocol):
    """Frame -> label texts that a detector shall look for."""

    def tags(self, frame: Frame) -> Sequence[str]:
        """Label texts, most certain first."""
        ...


@runtime_checkable
class Detector(Protocol):
    """Frame + labels -> boxes."""

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Sequence[Box]:
        """Boxes for the labels; None or fixed classes: whatever the detector knows."""
        ...


@runtime_checkable
class Segmenter(Protocol):
    """Frame + boxes -> masks."""

    def segment(self, frame: Frame, boxes: Sequence[Box]) -> Sequence[MaskArray]:
        """One mask (H, W) bool a box, in the order of the boxes."""
        ...
