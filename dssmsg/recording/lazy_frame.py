"""A recorded frame whose images and truth are decoded when somebody looks at them.

Most frames of a replay go by without: the map takes images of key frames, and of others depth at most.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dssmsg.frame import ByteArray, Float32Array, Frame, IntArray, Truth, TruthObject, frozen_array

_COPIED = (
    "index",
    "sim_time",
    "camera",
    "world_from_camera",
    "world_from_base",
    "visit",
    "at_stop",
    "truth",
)


class LazyFrame(Frame):
    """A `Frame` in every respect; `rgb` (H, W, 3) uint8 and `depth` (H, W) float32 metres are given as images
    or as functions that give them.

    Raises ValueError where a part has another shape than the camera says: of an image that a function gives,
    once it is looked at.
    """

    __slots__ = ("_distances", "_image")
    _image: ByteArray | Callable[[], ByteArray]
    _distances: Float32Array | Callable[[], Float32Array]

    def __init__(
        self,
        rgb: ByteArray | Callable[[], ByteArray],
        depth: Float32Array | Callable[[], Float32Array],
        **fields: Any,
    ) -> None:
        fix = object.__setattr__
        for name, value in fields.items():
            fix(self, name, value)
        fix(self, "_image", rgb)
        fix(self, "_distances", depth if callable(depth) else self._checked(depth))
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

        @property
        def depth(self) -> Float32Array:
            """Depth (H, W) float32 metres, decoded on first use."""
            if callable(self._distances):
                object.__setattr__(self, "_distances", self._checked(self._distances()))
            return self._distances

    def _checked(self, depth: Float32Array) -> Float32Array:
        size = (self.camera.height, self.camera.width)
        return frozen_array("depth", depth, np.float32, size, finite=True)

    def without_truth(self) -> Frame:
        """The same frame as seen by a plug-in that may not know the truth."""
        return self if self.truth is None else self.having(truth=None)

    def having(self, **changes: Any) -> LazyFrame:
        """The same frame with other fields; no image is decoded for it."""
        return LazyFrame.like(self, rgb=lambda: self.rgb, depth=lambda: self.depth, **changes)

    @classmethod
    def like(
        cls, frame: Frame, *, rgb: Callable[[], ByteArray], depth: Callable[[], Float32Array], **changes: Any
    ) -> LazyFrame:
        """A frame with the given images, and otherwise like another but for the `changes`."""
        return cls(rgb, depth, **{**{name: getattr(frame, name) for name in _COPIED}, **changes})

    def __reduce__(self) -> tuple[Any, ...]:
        rgb = self._image if isinstance(self._image, Elsewhere) else self.rgb
        depth = self._distances if isinstance(self._distances, Elsewhere) else self.depth
        return _made, (rgb, depth, {name: getattr(self, name) for name in _COPIED})


class Elsewhere:
    """Stands for an image that is not sent along to another process."""

    def __call__(self) -> Any:
        """Raises ValueError: it is not here."""
        raise ValueError("the image is in another process")


def _made(rgb: Any, depth: Any, fields: dict[str, Any]) -> LazyFrame:
    return LazyFrame(rgb, depth, **fields)


class LazyTruth(Truth):
    """A `Truth` whose `instance_ids` (H, W) int32 are decoded when somebody looks at them."""

    __slots__ = ("_instances",)
    _instances: IntArray | Callable[[], IntArray]

    def __init__(self, instance_ids: Callable[[], IntArray], objects: tuple[TruthObject, ...]) -> None:
        object.__setattr__(self, "_instances", instance_ids)
        object.__setattr__(self, "objects", objects)

    def __reduce__(self) -> tuple[Any, ...]:
        if isinstance(self._instances, Elsewhere):
            return LazyTruth, (self._instances, self.objects)
        return Truth, (self.instance_ids, self.objects)

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
