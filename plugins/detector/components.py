"""detector/components: things that stand out in depth, without any idea of what they are.

A box around every connected piece of surface between floor and ceiling. What touches a wall joins it,
and lost with it where that fills too much of the image; the label is the first one asked for, or "object".
It shows that a chain works; it is no rival to a learned detector.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field
from scipy import ndimage

from dssmsg.depth_components import depth_components
from dssmsg.frame import Frame
from dssmsg.geometry import pixel_rays
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.perception import Box

UNNAMED = "object"


class Config(PluginConfig):
    """Options of the detector `components`."""

    min_height: float = Field(0.05, description="Lowest surface that counts, metres above the floor.")
    max_height: float = Field(1.8, description="Highest surface that counts, metres above the floor.")
    max_range: float = Field(4.0, gt=0, description="Farthest depth that counts, metres.")
    min_pixels: int = Field(200, ge=1, description="Smallest piece to report, in pixels.")
    max_share: float = Field(0.4, gt=0, le=1, description="Largest piece to report, as a share of the image.")
    step: float = Field(
        0.05, gt=0, description="Neighbouring depths that differ by more are not joined, metres."
    )


class ComponentsDetector:
    """Connected pieces of surface above the floor."""

    def __init__(self, config: Config) -> None:
        self._config = config

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Sequence[Box]:
        """A box with its mask for every piece, largest first; the score is how much of the box it fills."""
        config = self._config
        depth = frame.depth
        lift = frame.world_from_camera[2]
        height = (pixel_rays(frame.camera) @ lift[:3]).reshape(depth.shape) * depth + lift[3]
        standing = (depth > 0) & (depth <= config.max_range)
        standing &= (height > config.min_height) & (height < config.max_height)
        parts = depth_components(depth, standing, config.step)
        sizes = np.bincount(parts[parts >= 0].ravel())
        largest = config.max_share * depth.size
        label = labels[0] if labels else UNNAMED
        boxes: list[tuple[int, Box]] = []
        for part, where in enumerate(ndimage.find_objects(parts + 1)):
            if where is None or not config.min_pixels <= sizes[part] <= largest:
                continue
            rows, columns = where
            mask = parts == part
            area = (rows.stop - rows.start) * (columns.stop - columns.start)
            corners = [columns.start, rows.start, columns.stop, rows.stop]
            boxes.append(
                (
                    int(sizes[part]),
                    Box(np.array(corners, dtype=np.float64), label, float(sizes[part] / area), mask),
                )
            )
        return [box for _size, box in sorted(boxes, key=lambda entry: -entry[0])]


@hookimpl
def register_detector(register: Register) -> None:
    """`components`: connected pieces of depth."""
    register("components", lambda config, context: ComponentsDetector(config), config=Config)
