"""perception/chain: tagger -> detector -> segmenter -> encoder, each a plug-in by name.

Every link can be swapped in the YAML; a link left out is skipped (no tagger: the detector looks for whatever
it knows; no segmenter: the detector's own masks, else whole boxes).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.checks import check_boxes, check_masks, check_tags
from dssmsg.config import Slot
from dssmsg.frame import Detection, Float32Array, Frame, MaskArray
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.perception import Box, Detector, Segmenter, Tagger

if TYPE_CHECKING:
    from dssmsg.interfaces import Context, Encoder


class Config(PluginConfig):
    """Options of `perception: {use: chain}`."""

    tagger: Slot | None = Field(
        None, description="Names what to look for; none: whatever the detector knows."
    )
    detector: Slot = Field(Slot(use="components"), description="Finds boxes.")
    segmenter: Slot | None = Field(
        Slot(use="depth"),
        description="Finds the mask in a box; none: the detector's masks, else whole boxes.",
    )
    encoder: Slot | None = Field(
        None, description="Gives features to labels and crops; none: the run's encoder."
    )
    crops: bool = Field(True, description="Whether image crops are encoded too, where the encoder can see.")
    min_score: float = Field(0.0, ge=0, le=1, description="Boxes below this score are left out.")
    min_pixels: int = Field(16, ge=1, description="Masks smaller than this are left out, in pixels.")


class Chain:
    """Runs its links one after the other; what a link returns is checked before the next one sees it."""

    def __init__(self, config: Config, context: Context) -> None:
        self._config = config
        self._tagger: Tagger | None = context.build("tagger", config.tagger) if config.tagger else None
        self._detector: Detector = context.build("detector", config.detector)
        self._segmenter: Segmenter | None = (
            context.build("segmenter", config.segmenter) if config.segmenter else None
        )
        self._encoder: Encoder | None = (
            context.build("encoder", config.encoder) if config.encoder else context.encoder
        )
        self.feature_space: str | None = None if self._encoder is None else self._encoder.space

    def detect(self, frame: Frame) -> Sequence[Detection]:
        """Detections of a key frame, in the detector's order."""
        labels = check_tags(self._tagger.tags(frame)) if self._tagger is not None else None
        found = check_boxes(self._detector.detect(frame, labels))
        boxes = [box for box in found if box.score >= self._config.min_score]
        kept = [
            (box, mask)
            for box, mask in zip(boxes, self._masks(frame, boxes), strict=True)
            if np.count_nonzero(mask) >= self._config.min_pixels
        ]
        texts = self._text_features([box.label for box, _mask in kept])
        images = self._image_features(frame, [box for box, _mask in kept])
        return [
            Detection(mask, _bounds(mask), box.label, float(box.score), text, image, box.label_scores)
            for (box, mask), text, image in zip(kept, texts, images, strict=True)
        ]

    def _masks(self, frame: Frame, boxes: Sequence[Box]) -> Sequence[MaskArray]:
        if self._segmenter is not None:
            return check_masks(frame, self._segmenter.segment(frame, boxes), len(boxes))
        return [_filled(frame, box) if box.mask is None else box.mask for box in boxes]

    def _text_features(self, labels: Sequence[str]) -> Sequence[Float32Array | None]:
        if self._encoder is None or not labels:
            return [None] * len(labels)
        return list(self._encoder.encode_labels(labels))

    def _image_features(self, frame: Frame, boxes: Sequence[Box]) -> Sequence[Float32Array | None]:
        own = [box.image_feature for box in boxes]
        if self._encoder is None or not boxes or not self._config.crops or any(f is not None for f in own):
            return own
        vectors = self._encoder.encode_crops([_crop(frame, box) for box in boxes])
        return own if vectors is None else list(vectors)


def _window(frame: Frame, box: Box) -> tuple[slice, slice]:
    """Rows and columns of a box inside the image, at least one pixel each."""
    x0, y0, x1, y1 = box.xyxy
    height, width = frame.depth.shape
    top, left = min(max(int(y0), 0), height - 1), min(max(int(x0), 0), width - 1)
    return slice(top, max(top + 1, min(int(np.ceil(y1)), height))), slice(
        left, max(left + 1, min(int(np.ceil(x1)), width))
    )


def _crop(frame: Frame, box: Box) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    return np.ascontiguousarray(frame.rgb[_window(frame, box)])


def _filled(frame: Frame, box: Box) -> MaskArray:
    mask = np.zeros(frame.depth.shape, dtype=np.bool_)
    mask[_window(frame, box)] = True
    return mask


def _bounds(mask: MaskArray) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """The box (4,) around a mask, xyxy with exclusive right and lower edges."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], dtype=np.float64)


@hookimpl
def register_perception(register: Register) -> None:
    """`chain`: tagger, detector, segmenter, encoder by name."""
    register("chain", Chain, config=Config)
