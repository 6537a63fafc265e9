"""encoder/clip: texts and image crops into one space, by the two towers of a CLIP model of the user's."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.frame import ByteArray, Float32Array
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.onnx.clip import ClipText, ClipVision, check_towers, load_text, load_vision
from dssmsg.onnx.problems import problems_of
from dssmsg.onnx.session import FilePath, Sha256, Threads, open_model

if TYPE_CHECKING:
    from dssmsg.interfaces import Context, Encoder


class Config(PluginConfig):
    """Options of the encoder `clip`; paths start from the folder of the YAML."""

    text: FilePath = Field(description="The text tower (ONNX), or both towers in one file.")
    vision: FilePath | None = Field(
        None, description="The image tower (ONNX), or the same file again; none: texts only."
    )
    tokenizer: FilePath | None = Field(
        None,
        description="The tokenizer.json, or bpe_simple_vocab_16e6.txt.gz; none: tokenizer.json beside "
        "the text tower.",
    )
    template: str = Field(
        "a photo of a {}", pattern=r"\{\}", description="What a label is put into before it is encoded."
    )
    threads: Threads = Field(1, description="Threads of the models.")
    cache: int = Field(10_000, ge=1, description="Most label vectors kept in memory.")
    text_sha256: Sha256 | None = Field(None, description="SHA-256 of the text tower; another is refused.")
    vision_sha256: Sha256 | None = Field(None, description="SHA-256 of the image tower; another is refused.")
    tokenizer_sha256: Sha256 | None = Field(None, description="SHA-256 of the tokenizer; another is refused.")

    def problems(self, base_dir: Path, encoder: Encoder | None) -> list[str]:
        """What is wrong with the files, one sentence each, beginning with the option."""
        return problems_of(lambda: ClipEncoder(self, base_dir))


class ClipEncoder:
    """Labels through a template, queries as they are, crops whole; unit vectors."""

    def __init__(self, config: Config, base_dir: Path) -> None:
        """Raises ConfigError or InputError if the files do not fit, here or together."""
        self._config = config
        self._labels: OrderedDict[str, Float32Array] = OrderedDict()
        self._text: ClipText = load_text(
            open_model(
                config.text,
                base_dir=base_dir,
                threads=config.threads,
                sha256=config.text_sha256,
                key=".text",
            ),
            config.tokenizer,
            base_dir,
            sha256=config.tokenizer_sha256,
        )
        self._vision: ClipVision | None = None
        if config.vision is not None:
            self._vision = load_vision(
                open_model(
                    config.vision,
                    base_dir=base_dir,
                    threads=config.threads,
                    sha256=config.vision_sha256,
                    key=".vision",
                )
            )
            check_towers(self._text, self._vision)
        self.dimension = self._text.dimension
        # The text side makes the space: labels and queries mean the same in it with and without crops.
        digest = hashlib.sha256((self._text.sha256 + self._text.tokenizer_sha256).encode()).hexdigest()
        self.space = f"clip/{self.dimension}/{digest[:8]}"

    def encode_labels(self, labels: Sequence[str]) -> Float32Array:
        """(N, D) float32 unit vectors of object labels, through the template; cached."""
        names = [" ".join(label.replace("_", " ").lower().split()) for label in labels]
        vectors: dict[str, Float32Array] = {}
        for name in dict.fromkeys(names):
            if name not in self._labels:
                (vector,) = self._text.encode([self._config.template.replace("{}", name)])
                vector.flags.writeable = False
                self._labels[name] = vector
            self._labels.move_to_end(name)
            vectors[name] = self._labels[name]
        while len(self._labels) > self._config.cache:
            self._labels.popitem(last=False)
        if not names:
            return np.zeros((0, self.dimension), dtype=np.float32)
        return np.stack([vectors[name] for name in names])

    def encode_text(self, texts: Sequence[str]) -> Float32Array:
        """(N, D) float32 unit vectors of texts, taken as they are (up to 77 tokens)."""
        return self._text.encode(texts)

    def encode_crops(self, crops: Sequence[ByteArray]) -> Float32Array | None:
        """(N, D) float32 unit vectors of RGB crops (H, W, 3) uint8, or None without an image tower."""
        return None if self._vision is None else self._vision.encode(crops)


def make(config: Config, context: Context) -> ClipEncoder:
    """The factory."""
    return ClipEncoder(config, context.base_dir)


@hookimpl
def register_encoder(register: Register) -> None:
    """`clip`: the towers of a CLIP model."""
    register("clip", make, config=Config)
