"""The shipped networks: found, checked against the model card's sums, and run through onnxruntime."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from dssmsg.errors import PluginError
from dssmsg.frame import Float32Array
from dssmsg.recogniser.contract import CROP_EXTRA, CROP_FACTS, CROP_SIDE
from dssmsg.recogniser.inputs import GEOMETRY_CHANNELS

PLUGIN = "perception/furniture"
CARD = "weights.json"
NETWORKS = ("masks.onnx", "crops.onnx")


@dataclass(frozen=True, slots=True)
class Card:
    """What belongs to the weights: labels in the order of the classifiers, SHA-256 by file, calibration.

    `temperature` divides the classifier's logits; `context` is the weight of the dense network's opinion;
    `quality` are the weights of a detection's score, `joining` those of pieces that touch.
    """

    labels: tuple[str, ...]
    sums: dict[str, str]
    temperature: float
    context: float
    quality: tuple[float, ...]
    joining: tuple[float, ...]


def read_card(folder: Path | None = None) -> tuple[Card, Path]:
    """The card of the weights in `folder` (default: the packaged ones) and where they are.

    Raises PluginError for a folder without a card that can be read.
    """
    place = Path(str(resources.files("dssmsg").joinpath("data/weights"))) if folder is None else folder
    try:
        row = json.loads((place / CARD).read_text("utf-8"))
        card = Card(
            tuple(row["labels"]), dict(row["sha256"]), float(row["temperature"]), float(row["context"]),
            tuple(float(value) for value in row["quality"]),
            tuple(float(value) for value in row["joining"]),
        )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PluginError(
            f"expected a folder with {CARD} and the two networks it names ({error})",
            plugin=PLUGIN, file=place, key="perception.weights",
        ) from None  # fmt: skip
    return card, place


def checked_content(path: Path, sha256: str) -> bytes:
    """The content of a file; raises PluginError where it is missing or not the one that the card names."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PluginError(
            f"the network is missing or cannot be read: {error.strerror or error}",
            plugin=PLUGIN, file=path, key="perception.weights",
        ) from None  # fmt: skip
    found = hashlib.sha256(content).hexdigest()
    if found != sha256:
        raise PluginError(
            f"expected the network with SHA-256 {sha256[:12]}..., got {found[:12]}...",
            plugin=PLUGIN, file=path, key="perception.weights",
        )  # fmt: skip
    return content


def weights_problem(folder: Path | None) -> PluginError | None:
    """What is wrong with the card or the files of the weights, without loading them; None if nothing is."""
    try:
        card, place = read_card(folder)
        for name in NETWORKS:
            checked_content(place / name, card.sums.get(name, ""))
    except PluginError as error:
        return error
    return None


def open_session(place: Path, name: str, sha256: str, threads: int) -> Any:
    """An onnxruntime session of a file whose content is the one that the card names.

    Raises PluginError for a file that is missing, changed, or not a network.
    """
    import onnxruntime

    path = place / name
    content = checked_content(path, sha256)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has no common exception of its own
        raise PluginError(
            f"onnxruntime cannot load it: {error}", plugin=PLUGIN, file=path, key="perception.weights"
        ) from None


class MaskNetwork:
    """rgb and geometry of a frame -> dense maps."""

    def __init__(self, place: Path, card: Card, threads: int) -> None:
        self._session = open_session(place, "masks.onnx", card.sums["masks.onnx"], threads)

    def run(self, rgb: Float32Array, geometry: Float32Array) -> tuple[Float32Array, Float32Array]:
        """rgb (3, H, W), geometry (G, H/2, W/2) -> dense (5, H/2, W/2), classes (C + 1, H/4, W/4); logits."""
        if geometry.shape[0] != GEOMETRY_CHANNELS:
            raise ValueError(f"geometry: expected {GEOMETRY_CHANNELS} channels, got {geometry.shape[0]}")
        dense, classes = self._session.run(None, {"rgb": rgb[None], "geometry": geometry[None]})
        return dense[0], classes[0]


class CropNetwork:
    """Crops and facts -> vectors in the text space, and logits of the labels."""

    def __init__(self, place: Path, card: Card, threads: int) -> None:
        self._session = open_session(place, "crops.onnx", card.sums["crops.onnx"], threads)

    def run(self, crops: Float32Array, facts: Float32Array) -> tuple[Float32Array, Float32Array]:
        """crops (N, 3 + CROP_EXTRA, S, S), facts (N, CROP_FACTS) -> vectors (N, D), logits (N, C + 1)."""
        wanted = (3 + CROP_EXTRA, CROP_SIDE, CROP_SIDE)
        if crops.shape[1:] != wanted or facts.shape[1:] != (CROP_FACTS,):
            raise ValueError(f"crops: expected (N, {wanted}), got {crops.shape}, facts {facts.shape}")
        vectors, logits = self._session.run(None, {"crops": crops, "facts": facts})
        return vectors, logits


def softmax(logits: Float32Array, temperature: float = 1.0) -> Float32Array:
    """Probabilities over the last axis."""
    scaled = logits / np.float32(temperature)
    e = np.exp(scaled - scaled.max(axis=-1, keepdims=True))
    result: Float32Array = (e / e.sum(axis=-1, keepdims=True)).astype(np.float32)
    return result


def best_labels(
    probabilities: Float32Array, labels: Sequence[str], count: int = 5
) -> tuple[tuple[str, float], ...]:
    """The `count` most probable labels with their probabilities, best first."""
    order = np.argsort(-probabilities[: len(labels)], kind="stable")[:count]
    return tuple((labels[int(i)], float(probabilities[int(i)])) for i in order)
