"""A recorded frame whose colours and truth are decoded when somebody looks at them.

Most frames of a replay go by without: the map takes depth and pose of every frame, colours of key frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dssmsg.frame import ByteArray, Frame, IntArray, Truth, TruthObject, frozen_array

_COPIED = (
    "index",
    "sim_time",
    "depth",
    "camera",
    "world_from_camera",
    "world_from_base",
    "visit",
    "at_stop",
    "truth",
)


class LazyFrame(Frame):
    """A `Frame` in every respect; `rgb` is given as an image (H, W, 3) uint8 or as a function that gives it.

    Raises ValueError where a part has another shape than the camera says: of the colours, once they are read.
    """

    __slots__ = ("_image",)
    _image: ByteArray | Callable[[], ByteArray]

    def __init__(self, rgb: ByteArray | Callable[[], ByteArray], **fields: Any) -> None:
        fix = object.__setattr__
        fix(self, "_image", rgb)
        for name, value in fields.items():
            fix(self, name, value)
        size = (self.camera.height, self.camera.width)
        fix(self, "depth", frozen_array("depth", self.depth, np.float32, size, finite=True))
        for name in ("world_from_camera", "world_from_base"):
            fix(self, name, frozen_array(name, getattr(self, name), np.float64, (4, 4), finite=True))

    if not TYPE_CHECKING:  # to a type checker it is the field that it stands for

        @property
        def rgb(self) -> ByteArray:
            """The colours (H, W, 3) uint8, decoded on first use."""
            if callable(self._image):
                size = (self.camera.height, self.camera.width, 3)
                object.__setattr__(self, "_image", frozen_array("rgb", self._image(), np.uint8, size))
            return self._image

    def without_truth(self) -> Frame:
        """The same frame as seen by a plug-in that may not know the truth."""
        return self if self.truth is None else self.having(truth=None)

    def having(self, **changes: Any) -> LazyFrame:
        """The same frame with other fields; no colours are decoded for it."""
        fields = {name: getattr(self, name) for name in _COPIED}
        return LazyFrame(lambda: self.rgb, **{**fields, **changes})


class LazyTruth(Truth):
    """A `Truth` whose `instance_ids` (H, W) int32 are decoded when somebody looks at them."""

    __slots__ = ("_instances",)
    _instances: IntArray | Callable[[], IntArray]

    def __init__(self, instance_ids: Callable[[], IntArray], objects: tuple[TruthObject, ...]) -> None:
        object.__setattr__(self, "_instances", instance_ids)
        object.__setattr__(self, "objects", objects)

    if not TYPE_CHECKING:  # to a type checker it is the field that it stands for

        @property
        def instance_ids(self) -> IntArray:
            """The instance of each pixel, decoded on first use."""
            if callable(self._instances):
                object.__setattr__(self, "_instances", self._instances())
            return self._instances


def looking(frame: Frame, at_stop: bool) -> Frame:
    """The same frame with another `at_stop`."""
    if frame.at_stop == at_stop:
        return frame
    return frame.having(at_stop=at_stop) if isinstance(frame, LazyFrame) else replace(frame, at_stop=at_stop)
