"""perception/furniture: the shipped recogniser, for furniture models it was trained on in rooms it never saw.

Two small networks through onnxruntime on the CPU: a dense one parts things from the room and from each
other, with depth and height above the floor beside colour; a crop encoder names them, in the space of the
text encoder. It is not open-vocabulary on the image side: what it was not trained on it takes for something
similar that it knows. The measured limits are in docs/perception.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.errors import ConfigError
from dssmsg.frame import Detection, Float32Array, FloatArray, Frame, MaskArray
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

if TYPE_CHECKING:
    from dssmsg.interfaces import Context, Encoder
    from dssmsg.recogniser.recogniser import Seen

SPACE = "all-minilm-l6-v2/384"


class FurnitureConfig(PluginConfig):
    """Options of the recogniser."""

    weights: str | None = Field(
        None, description="Folder with weights.json and its networks; none: the shipped ones."
    )
    threads: int = Field(1, ge=1, le=64, description="Threads of the networks; 1 is fastest on shared cores.")
    min_score: float = Field(0.25, ge=0, le=1, description="Detections below this score are left out.")
    min_pixels: int = Field(80, ge=16, description="Masks smaller than this are left out, in pixels.")
    max_range: float = Field(
        5.0, gt=0, description="Things whose median depth is beyond are left out, metres."
    )
    max_crops: int = Field(
        24,
        ge=1,
        description="Most masks of a frame that are named, the largest first: bounds a frame's time.",
    )
    max_nothing: float = Field(
        0.5,
        gt=0,
        le=1,
        description="Masks that are likelier than this to be no thing of their own are left out.",
    )
    rim: int = Field(
        2, ge=0, le=8, description="Pixels taken off a mask's rim, where the rest stays a mask: rims leak."
    )
    vocabulary: tuple[str, ...] = Field(
        (), description="Names to choose from instead of the trained ones, through the text encoder."
    )

    def folder(self, base_dir: Path) -> Path | None:
        """Where the weights are; None for the shipped ones."""
        return None if self.weights is None else Path(base_dir, self.weights).resolve()

    def problems(self, base_dir: Path, encoder: Encoder | None) -> list[str]:
        """What `dssmsg doctor` says of the weights: files that are missing or changed."""
        from dssmsg.recogniser.networks import weights_problem

        problem = weights_problem(self.folder(base_dir))
        return [] if problem is None else [f"weights: {problem.file}: {problem.message}"]


class Furniture:
    """Masks and names of furniture; frames do not depend on each other."""

    def __init__(self, config: FurnitureConfig, context: Context) -> None:
        """Raises PluginError for weights that are missing or changed, ConfigError for a vocabulary without an
        encoder of its space."""
        from dssmsg.recogniser.recogniser import Recogniser

        self._config = config
        folder = config.folder(context.base_dir)
        self._recogniser = Recogniser(folder, threads=config.threads, max_crops=config.max_crops)
        self._encoder = context.encoder
        fits = self._encoder is not None and self._encoder.space == SPACE
        if config.vocabulary and not fits:
            raise ConfigError(
                f"a vocabulary needs an encoder of the space {SPACE}, such as minilm",
                key="perception.vocabulary",
            )
        self.feature_space: str | None = SPACE if fits else None
        self._features: dict[str, Float32Array] = {}

    def detect(self, frame: Frame) -> Sequence[Detection]:
        """The things of a key frame, the largest first; the score is the chance that both are good."""
        found = []
        for seen in self._recogniser.see(frame):
            if not self._counts(frame, seen):
                continue
            names = self._names(seen)
            score = self._recogniser.score(seen)
            if score >= self._config.min_score:
                mask = without_rim(seen.mask, self._config.rim)
                found.append(
                    Detection(
                        mask, bounds(mask), names[0][0], score, self._feature(names[0][0]),
                        seen.vector if self.feature_space else None, names,
                    )
                )  # fmt: skip
        return found

    def _counts(self, frame: Frame, seen: Seen) -> bool:
        depth = frame.depth[seen.mask]
        depth = depth[depth > 0]
        if np.count_nonzero(seen.mask) < self._config.min_pixels or len(depth) < 16:
            return False
        if seen.probabilities[-1] > self._config.max_nothing:
            return False
        return float(np.median(depth)) <= self._config.max_range

    def _names(self, seen: Seen) -> tuple[tuple[str, float], ...]:
        """The five likeliest labels, best first."""
        from dssmsg.recogniser.networks import best_labels, softmax

        if not self._config.vocabulary or self._encoder is None:
            return best_labels(seen.probabilities, self._recogniser.labels)
        cosines = self._encoder.encode_labels(self._config.vocabulary) @ seen.vector
        return best_labels(softmax(cosines, 0.07), self._config.vocabulary)

    def _feature(self, label: str) -> Float32Array | None:
        if self.feature_space is None or self._encoder is None:
            return None
        if label not in self._features:
            self._features[label] = self._encoder.encode_labels([label])[0]
        return self._features[label]


def without_rim(mask: MaskArray, pixels: int) -> MaskArray:
    """The mask (H, W) without its outermost pixels; unchanged where less than half of it would be left.

    A few pixels of wall or neighbour a view do little to a mask and much to the box of an object that
    gathers the points of all views.
    """
    for _ in range(pixels):
        inner = mask.copy()
        inner[1:] &= mask[:-1]
        inner[:-1] &= mask[1:]
        inner[:, 1:] &= mask[:, :-1]
        inner[:, :-1] &= mask[:, 1:]
        if 2 * np.count_nonzero(inner) < np.count_nonzero(mask):
            break
        mask = inner
    return mask


def bounds(mask: MaskArray) -> FloatArray:
    """The box (4,) around a mask, xyxy with exclusive right and lower edges."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], dtype=np.float64)


@hookimpl
def register_perception(register: Register) -> None:
    """Announce `furniture`."""
    register("furniture", Furniture, config=FurnitureConfig)
