"""segmenter/depth: the piece of surface that a box is most likely about, from depth alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from dssmsg.depth_components import depth_components
from dssmsg.frame import Float32Array, FloatArray, Frame, MaskArray
from dssmsg.geometry import pixel_rays
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
    floor: float = Field(0.04, ge=0, description="Surface below this is floor, metres above it.")


class DepthSegmenter:
    """Inside a box: the connected piece with the most pixels around the median depth of its middle.

    What stands on the floor touches it, so floor pixels are left out where the middle is higher.
    """

    def __init__(self, config: Config) -> None:
        self._config = config

    def segment(self, frame: Frame, boxes: Sequence[Box]) -> Sequence[MaskArray]:
        """One mask (H, W) a box; the detector's own where it gave one, empty where there is no depth."""
        if all(box.mask is not None for box in boxes):
            return [box.mask for box in boxes if box.mask is not None]
        lift = frame.world_from_camera[2]
        height = (pixel_rays(frame.camera) @ lift[:3]).reshape(frame.depth.shape) * frame.depth + lift[3]
        return [self._mask(frame, height, box) if box.mask is None else box.mask for box in boxes]

    def _mask(self, frame: Frame, height: FloatArray, box: Box) -> MaskArray:
        mask = np.zeros(frame.depth.shape, dtype=np.bool_)
        x0, y0, x1, y1 = box.xyxy
        rows = slice(max(0, int(np.floor(y0))), max(0, int(np.ceil(y1))))
        columns = slice(max(0, int(np.floor(x0))), max(0, int(np.ceil(x1))))
        depth = frame.depth[rows, columns]
        usable = depth > 0
        if not usable.any():
            return mask
        core = self._middle(depth)
        core = core if (usable & core).any() else np.ones_like(core)
        if float(np.median(height[rows, columns][usable & core])) > 2 * self._config.floor:
            usable &= height[rows, columns] > self._config.floor
        parts = depth_components(depth, usable, self._config.step)
        middle = float(np.median(depth[usable & core]))
        near = (parts >= 0) & (np.abs(depth - middle) <= self._config.tolerance)
        votes = np.bincount(parts[near]) if near.any() else np.bincount(parts[parts >= 0])
        mask[rows, columns] = parts == int(np.argmax(votes))
        return mask

    def _middle(self, depth: Float32Array) -> MaskArray:
        """(H, W) bool: the part of a box around its middle."""
        margin = (1.0 - self._config.core) / 2
        edge_y, edge_x = int(margin * depth.shape[0]), int(margin * depth.shape[1])
        core = np.zeros(depth.shape, dtype=np.bool_)
        core[edge_y : depth.shape[0] - edge_y, edge_x : depth.shape[1] - edge_x] = True
        return core


@hookimpl
def register_segmenter(register: Register) -> None:
    """`depth`: connected depth inside a box."""
    register("depth", lambda config, context: DepthSegmenter(config), config=Config)
