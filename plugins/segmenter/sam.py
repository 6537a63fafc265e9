"""segmenter/sam: masks by SAM, MobileSAM or EfficientSAM, in ONNX files of the user's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.errors import ConfigError
from dssmsg.frame import Float32Array, FloatArray, Frame, MaskArray
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.perception import Box
from dssmsg.onnx.matching import identify
from dssmsg.onnx.problems import problems_of
from dssmsg.onnx.sam import DECODER_OF, ENCODERS, WHOLE, Sam, check_pair, make_sam
from dssmsg.onnx.session import FilePath, Sha256, Threads, open_model

if TYPE_CHECKING:
    from dssmsg.interfaces import Context, Encoder

SAME_DEPTH = 0.25
"""How far a prompt point may lie before or behind the middle of its box, metres."""


class Config(PluginConfig):
    """Options of the segmenter `sam`; paths start from the folder of the YAML."""

    encoder: FilePath = Field(description="The image encoder (ONNX), or EfficientSAM in one file.")
    decoder: FilePath | None = Field(None, description="The mask decoder (ONNX) that belongs to it.")
    replace: bool = Field(True, description="Whether masks that the detector gave are made anew.")
    clip_to_box: bool = Field(False, description="Whether a mask is cut at the rim of its box.")
    threads: Threads = Field(1, description="Threads of the models.")
    encoder_sha256: Sha256 | None = Field(None, description="SHA-256 of the encoder; another is refused.")
    decoder_sha256: Sha256 | None = Field(None, description="SHA-256 of the decoder; another is refused.")

    def problems(self, base_dir: Path, encoder: Encoder | None) -> list[str]:
        """What is wrong with the files, one sentence each, beginning with the option."""
        return problems_of(lambda: load(self, base_dir))


class SamSegmenter:
    """Asks the model for the mask in every box; an image without boxes is not even looked at."""

    def __init__(self, config: Config, base_dir: Path) -> None:
        """Raises ConfigError or InputError if the files do not fit, here or together."""
        self._sam = load(config, base_dir)
        self._replace, self._clip = config.replace, config.clip_to_box

    def segment(self, frame: Frame, boxes: Sequence[Box]) -> Sequence[MaskArray]:
        """One mask (H, W) bool a box; empty for a box outside the image."""
        height, width = frame.depth.shape
        masks = [
            np.zeros((height, width), dtype=np.bool_) if self._replace or box.mask is None else box.mask
            for box in boxes
        ]
        corners = np.array([box.xyxy for box in boxes], dtype=np.float64).reshape(-1, 4)
        corners = np.clip(corners, 0.0, np.array([width, height, width, height]))
        asked = [
            place
            for place, box in enumerate(boxes)
            if (self._replace or box.mask is None) and np.ptp(corners[place].reshape(2, 2), axis=0).min() >= 1
        ]
        if not asked:
            return masks
        points = np.stack([prompt_points(frame.depth, corners[place]) for place in asked])
        found = self._sam.masks(frame.rgb, corners[asked], points)
        for place, mask in zip(asked, found, strict=True):
            masks[place] = _inside(mask, corners[place]) if self._clip else mask
        return masks


def prompt_points(depth: Float32Array, box: FloatArray) -> FloatArray:
    """(5, 2) points x, y on the thing in a box (4,) xyxy: its middle, and half way to each side.

    A point at another depth than the middle likely lies beside the thing: the middle stands in for it.
    """
    middle = (box[:2] + box[2:]) / 2
    reach = (box[2:] - box[:2]) / 4
    steps = np.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]], dtype=np.float64)
    points: FloatArray = middle + steps * reach
    limit = np.array(depth.shape[::-1]) - 1
    columns, rows = np.clip(np.floor(points).astype(np.int64), 0, limit).T
    found = depth[rows, columns]
    off = (found > 0) & (found[0] > 0) & (np.abs(found - found[0]) > SAME_DEPTH)
    points[off] = middle
    return points


def load(config: Config, base_dir: Path) -> Sam:
    """The model of the configured files. Raises ConfigError or InputError."""
    model = open_model(
        config.encoder,
        base_dir=base_dir,
        threads=config.threads,
        sha256=config.encoder_sha256,
        key=".encoder",
    )
    encoder = identify(model, ENCODERS, key=".encoder")
    if encoder.contract.name == WHOLE:
        if config.decoder is not None:
            raise ConfigError(
                f"{model.path.name} holds encoder and decoder; leave `decoder` out", key=".decoder"
            )
        return make_sam(encoder, None)
    wanted = DECODER_OF[encoder.contract.name]
    if config.decoder is None:
        raise ConfigError(
            f"is missing: {model.path.name} is the {encoder.contract.title} and wants its decoder",
            key=".decoder",
        )
    other = open_model(
        config.decoder,
        base_dir=base_dir,
        threads=config.threads,
        sha256=config.decoder_sha256,
        key=".decoder",
    )
    decoder = identify(other, (wanted,), key=".decoder")
    check_pair(encoder, decoder)
    return make_sam(encoder, decoder)


def _inside(mask: MaskArray, box: FloatArray) -> MaskArray:
    cut = np.zeros_like(mask)
    left, top = np.floor(box[:2]).astype(int)
    right, bottom = np.ceil(box[2:]).astype(int)
    cut[top:bottom, left:right] = mask[top:bottom, left:right]
    return cut


def make(config: Config, context: Context) -> SamSegmenter:
    """The factory."""
    return SamSegmenter(config, context.base_dir)


@hookimpl
def register_segmenter(register: Register) -> None:
    """`sam`: masks by files of the user's."""
    register("sam", make, config=Config)
