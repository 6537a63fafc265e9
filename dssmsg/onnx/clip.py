"""CLIP's two towers: texts and image crops into one space of unit vectors.

The text tower wants CLIP's byte-level BPE, as a rule a `tokenizer.json`. Towers come as two files or as one
with both; exporters differ in whether they normalise, so it is always done here.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.errors import ConfigError, InputError
from dssmsg.frame import ByteArray, Float32Array
from dssmsg.onnx.bpe import END, START, vocabulary_tokenizer
from dssmsg.onnx.letterbox import planes, resize
from dssmsg.onnx.matching import Binding, identify
from dssmsg.onnx.session import OnnxModel, check_sha256, file_sha256, find_file

MEAN = (0.48145466, 0.4578275, 0.40821073)
STD = (0.26862954, 0.26130258, 0.27577711)
USUAL_SIZE = 224
CONTEXT = 77
BATCH = 16
TOKENIZER = "tokenizer.json"


class ClipTokenizer:
    """CLIP's byte-level BPE from a `tokenizer.json`, or from OpenAI's `bpe_simple_vocab_16e6.txt.gz`."""

    def __init__(self, file: Path, sha256: str) -> None:
        """Raises InputError if the file is no tokenizer or not CLIP's."""
        self.path = file
        self.sha256 = sha256
        packed = file.name.endswith((".txt", ".txt.gz"))
        self._tokenizer: Any = vocabulary_tokenizer(file) if packed else _read_tokenizer(file)
        start, end = (self._tokenizer.token_to_id(token) for token in (START, END))
        if start is None or end is None:
            raise InputError(
                f"is no tokenizer of a CLIP model: it has no tokens {START} and {END}; "
                "take the tokenizer.json that lies beside the text model",
                file=file,
                key=".tokenizer",
            )
        self._start, self._end = int(start), int(end)
        self._tokenizer.no_padding()
        self._tokenizer.no_truncation()

    def ids(self, text: str, length: int = CONTEXT) -> list[int]:
        """Token numbers with start and end, at most `length`; a long text loses its tail, not its end."""
        found: list[int] = self._tokenizer.encode(text, add_special_tokens=False).ids
        return [self._start, *found[: length - 2], self._end]

    @property
    def filler(self) -> int:
        """What the rest of a fixed length is filled with: towers stop reading at the first end token."""
        return self._end


class ClipText:
    """The text tower. Built, it has encoded one word."""

    def __init__(self, binding: Binding, tokenizer: ClipTokenizer) -> None:
        """Raises InputError if tokenizer and tower do not belong together."""
        self._binding = binding
        self._tokenizer = tokenizer
        self.sha256 = binding.model.sha256
        self.tokenizer_sha256 = tokenizer.sha256
        try:
            self.dimension = len(self._encode("chair"))
        except (RuntimeError, ValueError) as error:
            raise InputError(
                f"cannot encode a text with {tokenizer.path.name}: {error}", file=self.path, key=".text"
            ) from error

    @property
    def path(self) -> Path:
        """The model file."""
        return self._binding.model.path

    def encode(self, texts: Sequence[str]) -> Float32Array:
        """(N, D) unit vectors; one text at a time, so that none depends on its company."""
        if not texts:
            return np.zeros((0, self.dimension), dtype=np.float32)
        return np.stack([self._encode(text) for text in texts])

    def _encode(self, text: str) -> Float32Array:
        binding = self._binding
        length = binding.sizes.get("L")
        ids = self._tokenizer.ids(text, length or CONTEXT)
        attention = [1] * len(ids)
        if length is not None:
            attention += [0] * (length - len(ids))
            ids = ids + [self._tokenizer.filler] * (length - len(ids))
        count = binding.ports["tokens"].size(0) or 1
        feeds = {binding.name("tokens"): np.tile(np.array(ids, dtype=np.int64), (count, 1))}
        if "attention" in binding:
            feeds[binding.name("attention")] = np.tile(np.array(attention, dtype=np.int64), (count, 1))
        if "pixels" in binding:
            side = binding.sizes.get("S", USUAL_SIZE)
            feeds[binding.name("pixels")] = np.zeros((1, 3, side, side), dtype=np.float32)
        (vectors,) = binding.model.run(feeds, [binding.name("text")])
        vector: Float32Array = _unit(vectors, count)[0]
        return vector


class ClipVision:
    """The image tower. Built, it has looked at one grey square."""

    def __init__(self, binding: Binding) -> None:
        """Raises InputError if the graph cannot be run."""
        self._binding = binding
        self.sha256 = binding.model.sha256
        self._side = binding.sizes.get("S", USUAL_SIZE)
        try:
            self.dimension = self._encode([np.full((8, 8, 3), 128, dtype=np.uint8)]).shape[1]
        except (RuntimeError, ValueError) as error:
            raise InputError(f"cannot encode an image: {error}", file=self.path, key=".vision") from error

    @property
    def path(self) -> Path:
        """The model file."""
        return self._binding.model.path

    def encode(self, crops: Sequence[ByteArray]) -> Float32Array:
        """(N, D) unit vectors of RGB crops (H, W, 3) uint8, whole crops: squared by a rim, not cut."""
        if not crops:
            return np.zeros((0, self.dimension), dtype=np.float32)
        fixed = self._binding.ports["pixels"].size(0)
        step = BATCH if fixed is None else fixed
        parts = []
        for start in range(0, len(crops), step):
            some = list(crops[start : start + step])
            filler = [] if fixed is None else [some[0]] * (fixed - len(some))
            parts.append(self._encode(some + filler)[: len(some)])
        return np.concatenate(parts)

    def _encode(self, crops: Sequence[ByteArray]) -> Float32Array:
        binding = self._binding
        count = binding.ports["pixels"].size(0) or len(crops)
        pixels = np.concatenate([planes(_square(crop, self._side), MEAN, STD) for crop in crops])
        pixels = np.concatenate([pixels, np.repeat(pixels[:1], count - len(crops), axis=0)])
        feeds: dict[str, NDArray[Any]] = {binding.name("pixels"): pixels}
        if "tokens" in binding:
            length = binding.sizes.get("L", 2)
            feeds[binding.name("tokens")] = np.zeros((1, length), dtype=np.int64)
            if "attention" in binding:
                feeds[binding.name("attention")] = np.ones((1, length), dtype=np.int64)
        (vectors,) = binding.model.run(feeds, [binding.name("image")])
        return _unit(vectors, count)


def load_text(
    model: OnnxModel, tokenizer: str | None, base_dir: Path, *, sha256: str | None = None
) -> ClipText:
    """The text tower in an opened file, option `text`; without `tokenizer` the one beside the file is taken.

    Raises ConfigError or InputError.
    """
    binding = identify(model, ("clip-text", "clip"), key=".text")
    file = (
        _tokenizer_beside(model.path)
        if tokenizer is None
        else find_file(tokenizer, base_dir, key=".tokenizer")
    )
    found = file_sha256(file)
    check_sha256(file, found, sha256, key=".tokenizer_sha256")
    return ClipText(binding, ClipTokenizer(file, found))


def load_vision(model: OnnxModel) -> ClipVision:
    """The image tower in an opened file, option `vision`. Raises ConfigError or InputError."""
    return ClipVision(identify(model, ("clip-vision", "clip"), key=".vision"))


def check_towers(text: ClipText, vision: ClipVision) -> None:
    """Raise ConfigError if the towers' vectors cannot be compared."""
    if text.dimension != vision.dimension:
        raise ConfigError(
            f"its vectors have {vision.dimension} numbers, those of the text tower {text.path.name} "
            f"{text.dimension}; take both towers of one model, exported with their projections",
            file=vision.path,
            key=".vision",
        )


def _read_tokenizer(file: Path) -> Any:
    from tokenizers import Tokenizer

    try:
        return Tokenizer.from_file(str(file))
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(
            f"expected the tokenizer.json of a CLIP model: {reason}", file=file, key=".tokenizer"
        ) from error


def _tokenizer_beside(model: Path) -> Path:
    """`tokenizer.json` in the model's folder or, as transformers.js lays files out, in the one above."""
    for folder in (model.parent, model.parent.parent):
        if (folder / TOKENIZER).is_file():
            return folder / TOKENIZER
    raise ConfigError(
        f"is missing, and no {TOKENIZER} lies beside {model.name}; give the tokenizer.json of the model",
        file=model,
        key=".tokenizer",
    )


def _square(crop: ByteArray, side: int) -> ByteArray:
    """(side, side, 3): the crop in the middle of a square filled with the colour that becomes zero."""
    height, width = crop.shape[:2]
    edge = max(height, width)
    square = np.empty((edge, edge, 3), dtype=np.uint8)
    square[:] = np.rint(np.array(MEAN) * 255).astype(np.uint8)
    top, left = (edge - height) // 2, (edge - width) // 2
    square[top : top + height, left : left + width] = crop
    return resize(square, (side, side), bicubic=True)


def _unit(vectors: NDArray[Any], count: int) -> Float32Array:
    if vectors.ndim != 2 or vectors.shape[0] != count:
        raise ValueError(f"expected vectors ({count}, D), got {vectors.shape}")
    lengths = np.linalg.norm(vectors.astype(np.float64), axis=1, keepdims=True)
    if not (lengths > 0).all():
        raise ValueError("it gives a vector of length 0")
    return np.asarray(vectors / lengths, dtype=np.float32)
