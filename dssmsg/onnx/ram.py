"""RAM and RAM++ taggers: an image in, the names of what is in it out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dssmsg.errors import ConfigError, InputError
from dssmsg.frame import ByteArray, FloatArray
from dssmsg.onnx.letterbox import planes, resize
from dssmsg.onnx.matching import Binding
from dssmsg.onnx.names import read_lines
from dssmsg.onnx.scores import ScoreKind, are_probabilities, as_probabilities
from dssmsg.onnx.session import find_file

MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)
USUAL_SIZE = 384


class Ram:
    """A tagger file at work. Built, it has been tried on a grey image once."""

    def __init__(self, binding: Binding, scores: ScoreKind = "auto") -> None:
        """Raises InputError if the graph cannot be run."""
        self._binding = binding
        self._side = binding.sizes.get("S", USUAL_SIZE)
        self._auto, self._logits = scores == "auto", scores == "logits"
        try:
            self.tag_count = len(self.scores(np.full((8, 8, 3), 114, dtype=np.uint8)))
        except (RuntimeError, ValueError) as error:
            raise InputError(
                f"cannot tag an image: {error}", file=binding.model.path, key=".model"
            ) from error

    def scores(self, rgb: ByteArray) -> FloatArray:
        """(T,) of an image (H, W, 3) uint8: 0..1 a tag; 0 and 1 where the thresholds lie inside the graph."""
        binding = self._binding
        image = planes(resize(rgb, (self._side, self._side)), MEAN, STD)
        (tags,) = binding.model.run({binding.name("image"): image}, [binding.name("tags")])
        if tags.ndim != 2 or tags.shape[0] != 1:
            raise ValueError(f"expected tags (1, T), got {tags.shape}")
        if self._auto and not are_probabilities(tags):
            # One image may show it and the next one not: once seen, it holds.
            self._logits = True
        return as_probabilities(tags[0], logits=self._logits)


def read_thresholds(value: float | str, count: int, base_dir: Path) -> FloatArray:
    """(T,) thresholds: one number for all, or a text file with one a line; ConfigError or InputError."""
    if not isinstance(value, str):
        return np.full(count, value)
    file = find_file(value, base_dir, key=".threshold")
    lines = read_lines(file, key=".threshold")
    try:
        numbers = np.array([float(line) for line in lines])
    except ValueError as error:
        raise InputError("expected a number on each line", file=file, key=".threshold") from error
    if not ((numbers >= 0) & (numbers <= 1)).all():
        raise InputError("expected numbers in 0..1", file=file, key=".threshold")
    if len(numbers) != count:
        raise ConfigError(
            f"expected {count} thresholds, one for each tag of the model, got {len(numbers)}",
            file=file,
            key=".threshold",
        )
    return numbers
