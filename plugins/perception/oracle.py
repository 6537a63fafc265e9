"""perception/oracle: detections from the simulator's truth, with faults on dials.

For tests, ablations and for telling which layer is to blame: whatever goes wrong with a faultless oracle is
not the detector's doing. Every fault is drawn from (seed, frame, instance), so that turning one dial
leaves the draws of the others as they were.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field
from scipy import ndimage

from dssmsg.errors import ConfigError
from dssmsg.frame import Detection, Float32Array, Frame, MaskArray
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

if TYPE_CHECKING:
    from dssmsg.interfaces import Context


class OracleConfig(PluginConfig):
    """Options of the oracle; every fault is off by default."""

    min_pixels: int = Field(100, ge=1, description="Smallest mask to report, in pixels.")
    max_range: float = Field(5.0, gt=0, description="Farthest median depth to report, in metres.")
    score: float = Field(1.0, gt=0, le=1, description="Score of every detection.")
    miss_rate: float = Field(0.0, ge=0, le=1, description="Share of visible objects left out of a frame.")
    split_rate: float = Field(
        0.0, ge=0, le=1, description="Share of masks cut in two across their longer side."
    )
    merge_rate: float = Field(
        0.0, ge=0, le=1, description="Share of masks swallowed by a neighbour that they touch in the image."
    )
    wrong_label_rate: float = Field(0.0, ge=0, le=1, description="Share of detections with a wrong label.")
    confusion: dict[str, list[str]] = Field(
        default_factory=dict,
        description="Wrong labels to draw from, by true label; no entry: any other label of the truth.",
    )
    mask_error_px: int = Field(
        0, ge=0, le=20, description="Masks are grown or shrunk by up to this many pixels, drawn a mask."
    )
    depth_drop_rate: float = Field(
        0.0, ge=0, le=1, description="Share of each mask's pixels left out at random, as where depth fails."
    )


@dataclass(frozen=True, slots=True)
class _Piece:
    """A mask on its way to a detection; `part` counts the halves of a split one."""

    instance_id: int
    part: int
    label: str
    mask: MaskArray


class Oracle:
    """Reads masks and labels off the truth of a frame."""

    def __init__(self, config: OracleConfig, context: Context) -> None:
        """Raises ConfigError if the source has no truth to read."""
        source = context.source
        if source is None or not source.has_truth:
            name = "none" if source is None else source.name
            message = f"oracle needs a simulator's truth; source {name} has none; use segments or chain"
            raise ConfigError(message, key="perception.use")
        self.feature_space: str | None = None if context.encoder is None else context.encoder.space
        self._config = config
        self._encoder = context.encoder
        self._seed = context.seed

    def detect(self, frame: Frame) -> Sequence[Detection]:
        """One detection a visible object (faults aside), in order of instance id.

        Raises ValueError if the frame comes without truth.
        """
        truth = frame.truth
        if truth is None:
            raise ValueError(f"frame {frame.index} comes without truth")
        labels = {item.instance_id: item.label for item in truth.objects}
        pieces = self._merge(frame, self._visible(frame, truth.instance_ids, labels))
        detections = []
        for piece in self._split(frame, pieces):
            mask = self._damage(frame, piece)
            if np.count_nonzero(mask) < self._config.min_pixels:
                continue
            label = self._label(frame, piece, labels)
            rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
            box = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], dtype=np.float64)
            detections.append((mask, box, label))
        features = self._features([label for _, _, label in detections])
        return [
            Detection(mask, box, label, self._config.score, text_feature=features.get(label))
            for mask, box, label in detections
        ]

    def _visible(self, frame: Frame, instance_ids: np.ndarray, labels: Mapping[int, str]) -> list[_Piece]:
        """Masks that are large and near enough and not missed."""
        pieces = []
        slices = ndimage.find_objects(instance_ids)
        for instance_id, window in enumerate(slices, start=1):
            if window is None or instance_id not in labels:
                continue
            inside = instance_ids[window] == instance_id
            if np.count_nonzero(inside) < self._config.min_pixels:
                continue
            depth = frame.depth[window][inside]
            depth = depth[depth > 0]
            if len(depth) == 0 or float(np.median(depth)) > self._config.max_range:
                continue
            if self._draw("miss", frame, instance_id).random() < self._config.miss_rate:
                continue
            mask = np.zeros(instance_ids.shape, dtype=np.bool_)
            mask[window] = inside
            pieces.append(_Piece(instance_id, 0, labels[instance_id], mask))
        return pieces

    def _merge(self, frame: Frame, pieces: list[_Piece]) -> list[_Piece]:
        """Let some masks be swallowed by the neighbour with the longest common border."""
        if self._config.merge_rate == 0:
            return pieces
        masks = {piece.instance_id: piece.mask for piece in pieces}
        swallowed: set[int] = set()
        for piece in pieces:
            if self._draw("merge", frame, piece.instance_id).random() >= self._config.merge_rate:
                continue
            around = ndimage.binary_dilation(masks[piece.instance_id])
            borders = {
                other: int(np.count_nonzero(around & mask))
                for other, mask in masks.items()
                if other != piece.instance_id and other not in swallowed
            }
            host = max(borders, key=lambda other: (borders[other], -other), default=0)
            if host and borders[host]:
                masks[host] = masks[host] | masks[piece.instance_id]
                swallowed.add(piece.instance_id)
        return [
            _Piece(piece.instance_id, 0, piece.label, masks[piece.instance_id])
            for piece in pieces
            if piece.instance_id not in swallowed
        ]

    def _split(self, frame: Frame, pieces: list[_Piece]) -> list[_Piece]:
        """Cut some masks in two at the median pixel of their longer side."""
        parts = []
        for piece in pieces:
            if self._draw("split", frame, piece.instance_id).random() >= self._config.split_rate:
                parts.append(piece)
                continue
            v, u = np.nonzero(piece.mask)
            along = u if np.ptp(u) >= np.ptp(v) else v
            first = along <= np.median(along)
            for part, chosen in enumerate((first, ~first)):
                mask = np.zeros_like(piece.mask)
                mask[v[chosen], u[chosen]] = True
                parts.append(_Piece(piece.instance_id, part, piece.label, mask))
        return parts

    def _damage(self, frame: Frame, piece: _Piece) -> MaskArray:
        """Grow or shrink a mask, and punch holes into it."""
        mask = piece.mask
        if self._config.mask_error_px:
            limit = self._config.mask_error_px
            pixels = int(self._draw("edge", frame, piece.instance_id, piece.part).integers(-limit, limit + 1))
            if pixels > 0:
                mask = ndimage.binary_dilation(mask, iterations=pixels)
            elif pixels < 0:
                mask = ndimage.binary_erosion(mask, iterations=-pixels)
        if self._config.depth_drop_rate:
            draw = self._draw("drop", frame, piece.instance_id, piece.part)
            mask = mask & (draw.random(mask.shape) >= self._config.depth_drop_rate)
        return mask

    def _label(self, frame: Frame, piece: _Piece, labels: Mapping[int, str]) -> str:
        """The true label, or a wrong one."""
        draw = self._draw("label", frame, piece.instance_id, piece.part)
        if draw.random() >= self._config.wrong_label_rate:
            return piece.label
        choices = self._config.confusion.get(piece.label) or sorted(set(labels.values()) - {piece.label})
        return choices[int(draw.integers(len(choices)))] if choices else piece.label

    def _features(self, labels: Sequence[str]) -> dict[str, Float32Array]:
        """Text vectors by label; empty without an encoder."""
        distinct = sorted(set(labels))
        if self._encoder is None or not distinct:
            return {}
        return dict(zip(distinct, self._encoder.encode_labels(distinct), strict=True))

    def _draw(self, fault: str, frame: Frame, instance_id: int, part: int = 0) -> np.random.Generator:
        """A generator of its own for each fault of each mask of each frame."""
        return np.random.default_rng((self._seed, zlib.crc32(fault.encode()), frame.index, instance_id, part))


@hookimpl
def register_perception(register: Register) -> None:
    """Announce `oracle`."""
    register("oracle", Oracle, config=OracleConfig, needs_truth=True)
