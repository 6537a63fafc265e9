"""YOLO heads of every export in `contracts`: an image in, boxes with class scores (and masks) out.

One `Yolo` a file. Raw heads give a box and class scores an anchor, in the pixels of the model's input; others
give finished boxes. Whether scores are logits is seen from their range: probabilities lie in 0..1.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.errors import ConfigError, InputError
from dssmsg.frame import ByteArray, Float32Array, FloatArray, MaskArray
from dssmsg.onnx.letterbox import Fit, Layout, lay_in, planes
from dssmsg.onnx.masks import image_mask
from dssmsg.onnx.matching import Binding
from dssmsg.onnx.nms import nms
from dssmsg.onnx.scores import ScoreKind, are_probabilities, as_probabilities

DETECTOR_CONTRACTS = ("yolo", "yolo-nms", "yolo-world-text", "yolo-world-mmdet", "yolo-world-mmdet-raw")
MASK_CONTRACTS = ("yolo-seg", "yolo-seg-nms")
USUAL_SIZE = 640
STRIDE = 32
GREY = 114


@dataclass(frozen=True, slots=True)
class Limits:
    """Which boxes stay: score at least `min_score`, overlap with a better one at most `iou`, at most `most`.

    `across_classes` lets boxes of different classes suppress each other.
    """

    min_score: float
    iou: float
    most: int
    across_classes: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A box (4,) xyxy in image pixels, inside the image; class number; score 0..1; mask (H, W) or None."""

    box: FloatArray
    class_id: int
    score: float
    mask: MaskArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """What a head says: boxes (N, 4) xyxy in input pixels, best class and score (N,), mask weights (N, K)."""

    boxes: FloatArray
    classes: NDArray[np.int64]
    scores: FloatArray
    weights: Float32Array | None = None


class Yolo:
    """A detector file at work. Built, it has been tried on a grey image once."""

    def __init__(
        self,
        binding: Binding,
        *,
        classes: int | None = None,
        size: int | None = None,
        scores: ScoreKind = "auto",
    ) -> None:
        """`classes` is how many the metadata names, which tells two layouts apart; `size` the image size
        in pixels for a graph that leaves it open (None: what the file notes, or 640).

        Raises InputError if the graph cannot be run or gives other shapes than its contract says.
        """
        self._binding = binding
        self._contract = binding.contract.name
        self.input_size = _input_size(binding, size)
        self._logits = scores == "logits"
        self._auto = scores == "auto"
        self._noted = classes
        self.class_count: int | None = None
        """How many classes the graph has, padding included; None where only finished boxes come out."""
        self._try()

    @property
    def text_dimension(self) -> int | None:
        """Length of the text vectors it takes, where the graph fixes it."""
        return self._binding.sizes.get("D")

    @property
    def text_count(self) -> int | None:
        """How many text vectors it takes at once, where the graph fixes it."""
        return self._binding.sizes.get("N")

    @property
    def takes_text(self) -> bool:
        """Whether the classes are an input rather than baked in."""
        return "text" in self._binding

    @property
    def open_padding(self) -> bool:
        """Whether the classes may end with a nameless one (AILab-CVC pads the texts)."""
        return self._contract.startswith("yolo-world-mmdet")

    def find(self, rgb: ByteArray, limits: Limits, text: Float32Array | None = None) -> list[Found]:
        """Boxes of an image (H, W, 3) uint8, best first; classes count `text` (n, D) where it takes text."""
        image, fit = lay_in(rgb, self.input_size, *_layout(self._contract))
        pixels = planes(image)
        if not self.takes_text:
            outputs = self._run(pixels, None)
            return self._finish(self._decode(outputs, None), fit, limits, outputs.get("prototypes"))
        if text is None or len(text) == 0:
            return []
        parts = []
        for start, vectors in self._batches(text):
            some = self._decode(self._run(pixels, vectors), min(len(text) - start, vectors.shape[1]))
            parts.append(Candidates(some.boxes, some.classes + start, some.scores))
        merged = Candidates(
            np.concatenate([one.boxes for one in parts]),
            np.concatenate([one.classes for one in parts]),
            np.concatenate([one.scores for one in parts]),
        )
        return self._finish(merged, fit, limits, None)

    def _batches(self, text: Float32Array) -> list[tuple[int, Float32Array]]:
        """Text vectors (n, D) as inputs (1, N, D), with the number of each one's first.

        Places left over repeat the first text: attention looks for the best matching text, so that repeats
        change nothing, which zeros would.
        """
        room = self.text_count
        if room is None:
            return [(0, text[None])]
        batches = []
        for start in range(0, len(text), room):
            some = text[start : start + room]
            filler = np.repeat(some[:1], room - len(some), axis=0)
            batches.append((start, np.concatenate([some, filler])[None]))
        return batches

    def _run(self, pixels: Float32Array, text: Float32Array | None) -> dict[str, NDArray[Any]]:
        binding = self._binding
        feeds = {binding.name("image"): pixels}
        if text is not None:
            feeds[binding.name("text")] = text
        roles = [tensor.role for tensor in binding.contract.outputs]
        return dict(zip(roles, binding.model.run(feeds, [binding.name(role) for role in roles]), strict=True))

    def _try(self) -> None:
        """Run a grey image: sizes that the graph leaves open, and the range of its scores, come out."""
        grey = planes(np.full((*self.input_size, 3), GREY, dtype=np.uint8))
        text = None
        if self.takes_text:
            count, dimension = self.text_count or 1, self.text_dimension or 512
            text = np.full((1, count, dimension), dimension**-0.5, dtype=np.float32)
        try:
            self._decode(self._run(grey, text), None if text is None else text.shape[1])
        except (RuntimeError, ValueError) as error:
            height, width = self.input_size
            raise InputError(
                f"cannot be used: tried on a grey image of {height} x {width} pixels, {error}",
                file=self._binding.model.path,
                key=".model",
            ) from error

    # Decoding: from outputs to candidates

    def _decode(self, outputs: dict[str, NDArray[Any]], texts: int | None) -> Candidates:
        """Candidates of one run; `texts` is how many of the text vectors were real, where it takes text."""
        if self._contract == "yolo-world-mmdet":
            rows = min(int(outputs["count"].reshape(-1)[0]), outputs["boxes"].shape[1])
            return Candidates(
                outputs["boxes"][0, :rows].astype(np.float64),
                outputs["labels"][0, :rows].astype(np.int64),
                as_probabilities(outputs["scores"][0, :rows]),
            )
        if self._contract == "yolo-world-mmdet-raw":
            return self._best(outputs["boxes"][0].astype(np.float64), outputs["scores"][0], None)
        table = outputs["output"]
        if table.ndim != 3 or table.shape[0] != 1:
            raise ValueError(f"expected an output (1, channels, anchors), got {table.shape}")
        masks = outputs["prototypes"].shape[1] if "prototypes" in outputs else 0
        if self._contract in ("yolo-nms", "yolo-seg-nms"):
            return _finished(table[0], masks)
        classes = (self.text_count or texts) if self.takes_text else (self.class_count or self._noted)
        rows = _anchor_rows(table[0], masks, classes)
        scores = rows[:, 4 : rows.shape[1] - masks]
        if texts is not None and scores.shape[1] < texts:
            raise ValueError(f"expected a score for each of {texts} texts, got {scores.shape[1]}")
        return self._best(
            _corners(rows[:, :4].astype(np.float64)),
            scores[:, :texts],
            rows[:, rows.shape[1] - masks :] if masks else None,
        )

    def _best(self, boxes: FloatArray, scores: NDArray[Any], weights: Float32Array | None) -> Candidates:
        if not self.takes_text:
            if self.class_count is None:
                self.class_count = scores.shape[1]
            elif scores.shape[1] != self.class_count:
                raise ValueError(f"expected {self.class_count} class scores, got {scores.shape[1]}")
        if self._auto and scores.size and not are_probabilities(scores):
            # One frame may show it and the next one not: once seen, it holds.
            self._logits = True
        classes = np.argmax(scores, axis=1).astype(np.int64)
        best = np.take_along_axis(scores, classes[:, None], axis=1)[:, 0]
        return Candidates(boxes, classes, as_probabilities(best, logits=self._logits), weights)

    def _finish(
        self, found: Candidates, fit: Fit, limits: Limits, prototypes: NDArray[Any] | None
    ) -> list[Found]:
        """Candidates that stay, in image pixels."""
        good = np.flatnonzero((found.scores >= limits.min_score) & (found.scores > 0))
        boxes = fit.clip(fit.to_image(found.boxes[good]))
        inside = np.all(boxes[:, 2:] - boxes[:, :2] >= 1.0, axis=1)
        good, boxes = good[inside], boxes[inside]
        groups = np.zeros_like(found.classes[good]) if limits.across_classes else found.classes[good]
        results = []
        for place in nms(boxes, found.scores[good], groups, limits.iou, limits.most):
            mask = None
            if prototypes is not None and found.weights is not None:
                logits = np.tensordot(found.weights[good[place]], prototypes[0], axes=1)
                mask = image_mask(logits, fit, boxes[place])
            index = good[place]
            results.append(Found(boxes[place], int(found.classes[index]), float(found.scores[index]), mask))
        return results


def _layout(contract: str) -> tuple[Layout, int]:
    """How an exporter's own code lays an image into the model's input, and with what it fills the rest."""
    if contract == "yolo-world-text":
        return "stretch", GREY
    if contract.startswith("yolo-world-mmdet"):
        return "square", 0
    return "letterbox", GREY


def _input_size(binding: Binding, size: int | None) -> tuple[int, int]:
    """(height, width) pixels of the model's input."""
    noted = (size, size) if size is not None else noted_size(binding.model.metadata.get("imgsz", ""))
    height, width = noted or (USUAL_SIZE, USUAL_SIZE)
    fixed = binding.sizes.get("H", height), binding.sizes.get("W", width)
    if size is not None and fixed != (size, size):
        raise ConfigError(
            f"the file takes images of {fixed[0]} x {fixed[1]} pixels only; leave `size` out",
            file=binding.model.path,
            key=".size",
        )
    return fixed


def noted_size(text: str) -> tuple[int, int] | None:
    """(height, width) from Ultralytics' note `[640, 640]` or `640`; None if it is no such text."""
    if not 0 < len(text) < 40:
        return None
    try:
        value = ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return None
    sides = [value, value] if isinstance(value, int) else value
    fits = isinstance(sides, (list, tuple)) and len(sides) == 2
    if not fits or not all(isinstance(one, int) and 0 < one <= 4096 and one % STRIDE == 0 for one in sides):
        return None
    return int(sides[0]), int(sides[1])


def _anchor_rows(table: NDArray[Any], masks: int, classes: int | None) -> NDArray[Any]:
    """(anchors, channels) of either layout: the number of classes decides, else channels are the fewer."""
    channels = 0 if classes is None else 4 + classes + masks
    if channels in table.shape and table.shape[0] != table.shape[1]:
        first = table.shape[0] == channels
    else:
        first = table.shape[0] <= table.shape[1]
    rows = table.T if first else table
    if rows.shape[1] < 5 + masks:
        raise ValueError(f"expected at least {5 + masks} channels, got an output {table.shape}")
    return rows


def _finished(rows: NDArray[Any], masks: int) -> Candidates:
    """Rows x1, y1, x2, y2, score, class and mask weights; rows that only fill the table have score 0."""
    if rows.shape[1] != 6 + masks:
        raise ValueError(f"expected rows of {6 + masks} numbers, got {rows.shape[1]}")
    rows = rows[rows[:, 4] > 0]
    classes = np.rint(rows[:, 5]).astype(np.int64)
    weights = np.ascontiguousarray(rows[:, 6:], dtype=np.float32) if masks else None
    return Candidates(rows[:, :4].astype(np.float64), classes, as_probabilities(rows[:, 4]), weights)


def _corners(boxes: FloatArray) -> FloatArray:
    """xyxy of boxes given by centre, width and height."""
    half = boxes[:, 2:] / 2
    return np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], axis=1)


def check_class_ids(found: Sequence[Found], count: int, *, padding: bool) -> list[Found]:
    """The boxes whose class has a name; a padding class (number `count`) is dropped.

    Raises ValueError for a class that cannot be.
    """
    for one in found:
        if not 0 <= one.class_id < count + padding:
            raise ValueError(f"the model gives class {one.class_id}, but has {count} classes")
    return [one for one in found if one.class_id < count]
