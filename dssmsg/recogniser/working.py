"""Frames of any size brought to the size that the networks were trained at, and masks brought back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dssmsg.frame import ByteArray, Camera, Float32Array, Frame, MaskArray

WORKING_WIDTH = 320
_MULTIPLE = 4


@dataclass(frozen=True, slots=True, eq=False)
class WorkingFrame:
    """rgb (h, w, 3) uint8, depth (h, w) metres and camera, thinned by `factor`; h and w are multiples of 4.

    What does not fill a multiple is left out at the right and the bottom; `full` is the frame's own (H, W).
    """

    rgb: ByteArray
    depth: Float32Array
    camera: Camera
    factor: int
    full: tuple[int, int]

    @classmethod
    def of(cls, frame: Frame) -> WorkingFrame:
        """Thin a frame to about WORKING_WIDTH pixels in width; smaller frames stay as they are.

        Raises ValueError for an image of less than 32 pixels a side.
        """
        height, width = frame.depth.shape
        if min(height, width) < 32:
            raise ValueError(f"frame: expected an image of at least 32 x 32 pixels, got {width} x {height}")
        factor = max(1, round(width / WORKING_WIDTH))
        rows, columns = (side // factor // _MULTIPLE * _MULTIPLE for side in (height, width))
        rgb, depth = frame.rgb, frame.depth
        if factor > 1:
            parts = rgb[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor, 3)
            rgb = np.rint(parts.mean(axis=(1, 3), dtype=np.float32)).astype(np.uint8)
            # The middle reading of each patch: means across an edge would float between the surfaces.
            depth = depth[factor // 2 :: factor, factor // 2 :: factor]
        shift = factor // 2
        camera = frame.camera
        small = Camera(
            columns, rows, camera.fx / factor, camera.fy / factor,
            (camera.cx - shift) / factor, (camera.cy - shift) / factor,
        )  # fmt: skip
        return cls(rgb[:rows, :columns], depth[:rows, :columns], small, factor, (height, width))

    def enlarged(self, mask: MaskArray) -> MaskArray:
        """A mask (h, w) at the frame's own size (H, W)."""
        if self.factor == 1 and mask.shape == self.full:
            return mask
        big = mask.repeat(self.factor, axis=0).repeat(self.factor, axis=1)
        return np.pad(big, [(0, full - side) for full, side in zip(self.full, big.shape, strict=True)])

    def reduced(self, mask: MaskArray) -> MaskArray:
        """A mask (H, W) of the frame's own size at the working size (h, w)."""
        rows, columns = self.depth.shape
        start = self.factor // 2
        return mask[start :: self.factor, start :: self.factor][:rows, :columns]
