"""detector/yolo-world: boxes by a YOLO-World file of the user's, or by any other YOLO with the same outputs.

Most exports have their classes baked in; then what a tagger names is not asked for. An export that takes text
features looks for what the tagger names, or for `classes`, through a CLIP text tower.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.errors import ConfigError
from dssmsg.frame import Float32Array, Frame
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.perception import Box
from dssmsg.onnx.clip import ClipText, load_text
from dssmsg.onnx.matching import identify
from dssmsg.onnx.names import NameList, baked_names, given_names, noted_names
from dssmsg.onnx.problems import problems_of
from dssmsg.onnx.scores import ScoreKind
from dssmsg.onnx.session import FilePath, Sha256, Threads, open_model
from dssmsg.onnx.yolo import DETECTOR_CONTRACTS, Limits, Yolo, check_class_ids

if TYPE_CHECKING:
    from dssmsg.interfaces import Context, Encoder


class Config(PluginConfig):
    """Options of the detector `yolo-world`; paths start from the folder of the YAML."""

    model: FilePath = Field(description="The ONNX file.")
    classes: NameList | None = Field(
        None,
        description="Class names, or a text file with one a line. Baked classes: in their order, needed "
        "where the file does not name them. Text as input: what to look for without a tagger.",
    )
    text: FilePath | None = Field(
        None,
        description="CLIP text tower (ONNX) for a file that takes text features; none: the run's encoder, "
        "if it is clip.",
    )
    tokenizer: FilePath | None = Field(
        None,
        description="Its tokenizer.json, or bpe_simple_vocab_16e6.txt.gz; none: tokenizer.json beside it.",
    )
    template: str = Field("{}", pattern=r"\{\}", description="What a class is put into before it is encoded.")
    min_score: float = Field(0.1, ge=0, le=1, description="Boxes below this score are left out.")
    iou: float = Field(
        0.6, ge=0, le=1, description="A box that overlaps a better one of its class by more is left out."
    )
    across_classes: bool = Field(
        False, description="Boxes of different classes suppress each other too: one name a thing."
    )
    limit: int = Field(100, ge=1, le=1000, description="Most boxes a frame.")
    size: int | None = Field(
        None,
        ge=32,
        le=4096,
        multiple_of=32,
        description="Image size for a file that leaves it open; none: what the file notes, else 640.",
    )
    scores: ScoreKind = Field(
        "auto", description="What the class scores are; auto: logits if one lies outside 0..1."
    )
    threads: Threads = Field(1, description="Threads of the model.")
    sha256: Sha256 | None = Field(None, description="SHA-256 of the file; another file is refused.")

    def problems(self, base_dir: Path, encoder: Encoder | None) -> list[str]:
        """What is wrong with the files, one sentence each, beginning with the option."""
        return problems_of(lambda: YoloWorld(self, base_dir, encoder))


class YoloWorld:
    """Looks for its baked classes, or for the words it is given."""

    def __init__(self, config: Config, base_dir: Path, encoder: Encoder | None) -> None:
        """Raises ConfigError or InputError if the files do not fit, here or together."""
        self._limits = Limits(config.min_score, config.iou, config.limit, config.across_classes)
        model = open_model(
            config.model, base_dir=base_dir, threads=config.threads, sha256=config.sha256, key=".model"
        )
        binding = identify(model, DETECTOR_CONTRACTS, key=".model")
        noted = noted_names(model, key=".model")
        self._yolo = Yolo(
            binding, classes=None if noted is None else len(noted), size=config.size, scores=config.scores
        )
        self._words: Words | None = None
        self._names: tuple[str, ...] | None
        if self._yolo.takes_text:
            self._words = Words(config, base_dir, encoder, self._yolo.text_dimension, model.path)
            given = config.classes
            self._names = None if given is None else given_names(given, base_dir, key=".classes")
        else:
            self._names = baked_names(
                model, self._yolo.class_count, config.classes, base_dir, padding=self._yolo.open_padding
            )

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Sequence[Box]:
        """Boxes, best score first; `labels` are what to look for where the classes are an input."""
        if self._words is None:
            names = self._names or ()
            found = self._yolo.find(frame.rgb, self._limits)
        else:
            names = tuple(dict.fromkeys(labels if labels is not None else self._names or ()))
            if labels is None and not names:
                raise ConfigError(
                    "the detector takes texts and was given none; name them in `classes` or add a tagger",
                    key="perception.detector.classes",
                )
            found = self._yolo.find(frame.rgb, self._limits, self._words.encode(names))
        kept = check_class_ids(found, len(names), padding=self._yolo.open_padding)
        return [Box(one.box, names[one.class_id], one.score) for one in kept]


class Words:
    """Class names as text features, each encoded once."""

    def __init__(
        self, config: Config, base_dir: Path, encoder: Encoder | None, dimension: int | None, model: Path
    ) -> None:
        """Raises ConfigError if no CLIP text tower of the right size is at hand."""
        self._template = config.template
        self._features: dict[str, Float32Array] = {}
        self._encoder: ClipText | Encoder
        if config.text is not None:
            tower = open_model(config.text, base_dir=base_dir, threads=config.threads, key=".text")
            self._encoder = load_text(tower, config.tokenizer, base_dir)
            source, key = self._encoder.path.name, ".text"
        elif encoder is not None and encoder.space.startswith("clip/"):
            self._encoder = encoder
            source, key = f"the run's encoder ({encoder.space})", ".text"
        else:
            other = "" if encoder is None else f" (the run's encoder is of the space {encoder.space})"
            raise ConfigError(
                f"takes text features, which want a CLIP text tower{other}; give `text` and `tokenizer`, "
                "or the same as encoder: {use: clip}",
                file=model,
                key=".text",
            )
        if dimension is not None and self._encoder.dimension != dimension:
            raise ConfigError(
                f"takes text features of {dimension} numbers, {source} gives {self._encoder.dimension}; "
                "take the text tower that the detector was trained with (CLIP ViT-B/32 for YOLO-World)",
                file=model,
                key=key,
            )

    def encode(self, names: Sequence[str]) -> Float32Array:
        """(N, D) unit vectors of the names."""
        new = [name for name in names if name not in self._features]
        if new:
            texts = [self._template.replace("{}", name.replace("_", " ").strip().lower()) for name in new]
            encoder = self._encoder
            vectors = encoder.encode(texts) if isinstance(encoder, ClipText) else encoder.encode_text(texts)
            self._features.update(zip(new, vectors, strict=True))
        if not names:
            return np.zeros((0, self._encoder.dimension), dtype=np.float32)
        return np.stack([self._features[name] for name in names])


def make(config: Config, context: Context) -> YoloWorld:
    """The factory."""
    return YoloWorld(config, context.base_dir, context.encoder)


@hookimpl
def register_detector(register: Register) -> None:
    """`yolo-world`: boxes by a file of the user's."""
    register("yolo-world", make, config=Config)
