"""segmenter/depth: the piece of surface that a box is most likely about, from depth alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from dssmsg.depth_components import depth_components
from dssmsg.frame import Frame, MaskArray
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.perception import Box


class Config(PluginConfig):
    """Options of the segmenter `depth`."""

    step: float = Field(
        0.05, gt=0, description="Neighbouring depths that differ by more are not joined, metres."
    )
    core: float = Field(
        0.5,
        gt=0,
        le=1,
        description="Share of the box's width and height, around its middle, that sets the depth.",
    )
    tolerance: float = Field(
        0.25, gt=0, description="How far a pixel may lie from that depth to speak for its piece, metres."
    )


class DepthSegmenter:
    """Inside a box: the connected piece with the most pixels around the median depth of its middle."""

    def __init__(self, config: Config) -> None:
        self._config = config

    def segment(self, frame: Frame, boxes: Sequence[Box]) -> Sequence[MaskArray]:
        """One mask (H, W) a box; the detector's own where it gave one, empty where there is no depth."""
        return [self._mask(frame, box) if box.mask is None else box.mask for box in boxes]

    def _mask(self, frame: Frame, box: Box) -> MaskArray:
        height, width = frame.depth.shape
        mask = np.zeros((height, width), dtype=np.bool_)
        x0, y0, x1, y1 = box.xyxy
        rows = slice(max(0, int(np.floor(y0))), min(height, int(np.ceil(y1))))
        columns = slice(max(0, int(np.floor(x0))), min(width, int(np.ceil(x1))))
        depth = frame.depth[rows, columns]
        if depth.size == 0 or not (depth > 0).any():
            return mask
        margin = (1.0 - self._config.core) / 2
        edge_y, edge_x = int(margin * depth.shape[0]), int(margin * depth.shape[1])
        middle = depth[edge_y : depth.shape[0] - edge_y, edge_x : depth.shape[1] - edge_x]
        readings = middle[middle > 0] if (middle > 0).any() else depth[depth > 0]
        parts = depth_components(depth, np.ones(depth.shape, dtype=np.bool_), self._config.step)
        near = (parts >= 0) & (np.abs(depth - np.median(readings)) <= self._config.tolerance)
        votes = np.bincount(parts[near]) if near.any() else np.bincount(parts[parts >= 0])
        mask[rows, columns] = parts == int(np.argmax(votes))
        return mask


@hookimpl
def register_segmenter(register: Register) -> None:
    """`depth`: connected depth inside a box."""
    register("depth", lambda config, context: DepthSegmenter(config), config=Config)
