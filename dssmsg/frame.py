"""The values that flow from a source through perception: Camera, Frame, Truth, Detection, Observation.

Frames and units: world is z up, metres, radians; cameras use OpenCV axes (x right, y down, z forward);
`world_from_camera` maps camera coordinates to world coordinates. All arrays are read-only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
ByteArray = NDArray[np.uint8]
IntArray = NDArray[np.int32]
MaskArray = NDArray[np.bool_]


def frozen_array(
    name: str, value: Any, dtype: type[np.generic], shape: tuple[int | None, ...], *, finite: bool = False
) -> NDArray[Any]:
    """Return `value` as a read-only array after checking its shape (None = any length).

    Raises ValueError saying what was expected and what was got.
    """
    array = np.asarray(value)
    if array.dtype != dtype:
        if array.dtype.kind not in "biuf":
            raise ValueError(f"{name}: expected {np.dtype(dtype).name} numbers, got {array.dtype}")
        array = array.astype(dtype)
    fits = array.ndim == len(shape) and all(
        want is None or want == got for want, got in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = "(" + ", ".join("N" if n is None else str(n) for n in shape) + ")"
        raise ValueError(f"{name}: expected shape {wanted}, got {array.shape}")
    if finite and not np.isfinite(array).all():
        raise ValueError(f"{name}: holds NaN or infinity")
    if array.flags.writeable:
        array = array.copy() if array.base is not None or array is value else array
        array.flags.writeable = False
    return array


@dataclass(frozen=True, slots=True)
class Camera:
    """Pinhole intrinsics in pixels; a pixel's centre is at its integer coordinates (OpenCV)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def from_fov(cls, width: int, height: int, horizontal_fov_rad: float) -> Camera:
        """A camera with square pixels and the principal point in the image centre."""
        focal = width / 2 / math.tan(horizontal_fov_rad / 2)
        return cls(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    @property
    def matrix(self) -> FloatArray:
        """The (3, 3) intrinsic matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class TruthObject:
    """What the simulator knows of one object. Box corners (3,) in world metres, axis aligned."""

    instance_id: int
    name: str
    label: str
    box_min: FloatArray
    box_max: FloatArray
    room: str = ""
    movable: bool = False
    state: str = "static"
    """static, appeared, disappeared or moved, since the first visit began."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Simulator truth of one frame. `instance_ids` (H, W) int32; 0 = no object (walls, floor, doors)."""

    instance_ids: IntArray
    objects: tuple[TruthObject, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One RGB-D frame with its pose.

    rgb (H, W, 3) uint8; depth (H, W) float32 metres along the optical axis, **in whole millimetres**,
    0 = no reading; world_from_camera (4, 4) float64; world_from_base (4, 4) float64, the robot's base
    on the floor (for hand-held sequences: below the camera); sim_time seconds.
    `visit` counts passes through the scene from 0; `at_stop` is True while the robot stands and looks (for
    hand-held sequences: always).
    """

    index: int
    sim_time: float
    rgb: ByteArray
    depth: Float32Array
    camera: Camera
    world_from_camera: FloatArray
    world_from_base: FloatArray
    visit: int = 0
    at_stop: bool = False
    truth: Truth | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        fix = object.__setattr__
        fix(self, "rgb", frozen_array("rgb", self.rgb, np.uint8, (*size, 3)))
        fix(self, "depth", frozen_array("depth", self.depth, np.float32, size, finite=True))
        for name in ("world_from_camera", "world_from_base"):
            fix(self, name, frozen_array(name, getattr(self, name), np.float64, (4, 4), finite=True))

    def without_truth(self) -> Frame:
        """The same frame as seen by a plug-in that may not know the truth."""
        return self if self.truth is None else replace(self, truth=None)

    @property
    def position(self) -> FloatArray:
        """Camera centre (3,) in the world."""
        return self.world_from_camera[:3, 3]

    @property
    def heading_rad(self) -> float:
        """Direction of the optical axis on the floor, counter-clockwise from world x, in (-pi, pi]."""
        forward = self.world_from_camera[:3, 2]
        if math.hypot(forward[0], forward[1]) < 1e-6:  # straight up or down: use the image's upward axis
            forward = -self.world_from_camera[:3, 1] * math.copysign(1.0, -forward[2])
        return math.atan2(forward[1], forward[0])

    @property
    def tilt_rad(self) -> float:
        """Elevation of the optical axis: 0 level, negative looking down."""
        return math.asin(max(-1.0, min(1.0, float(self.world_from_camera[2, 2]))))


def quantise_depth(depth: Any) -> Float32Array:
    """Depth in metres as every source must hand it out: whole millimetres, 0 where there is no reading.

    The same float32 comes back from a 16-bit millimetre image, so a recording loses nothing.
    """
    depth = np.asarray(depth, dtype=np.float64)
    millimetres = np.rint(np.where(np.isfinite(depth) & (depth > 0), depth, 0.0) * 1000.0)
    millimetres[millimetres > 65534] = 0  # 65535 is "invalid" in common 16-bit formats
    return depth_from_millimetres(millimetres.astype(np.uint16))


def depth_from_millimetres(millimetres: NDArray[np.uint16]) -> Float32Array:
    """float32 metres from a 16-bit millimetre image."""
    return millimetres.astype(np.float32) / np.float32(1000.0)


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """One thing a perception plug-in saw.

    mask (H, W) bool; box_xyxy (4,) pixels; score 0..1; features are unit vectors (D,) of the space that
    the perception plug-in declares, or None; `label_scores` are the runners-up, best first.
    """

    mask: MaskArray
    box_xyxy: FloatArray
    label: str
    score: float
    text_feature: Float32Array | None = None
    image_feature: Float32Array | None = None
    label_scores: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        fix = object.__setattr__
        fix(self, "mask", frozen_array("mask", self.mask, np.bool_, (None, None)))
        fix(self, "box_xyxy", frozen_array("box_xyxy", self.box_xyxy, np.float64, (4,), finite=True))
        if not (isinstance(self.label, str) and self.label.strip()):
            raise ValueError(f"label: expected a non-empty text, got {self.label!r}")
        if not (math.isfinite(self.score) and 0.0 <= self.score <= 1.0):
            raise ValueError(f"score: expected a number in 0..1, got {self.score}")
        for name in ("text_feature", "image_feature"):
            value = getattr(self, name)
            if value is None:
                continue
            vector = frozen_array(name, value, np.float32, (None,), finite=True)
            if abs(float(np.linalg.norm(vector)) - 1.0) > 1e-3:
                raise ValueError(f"{name}: expected a unit vector, got length {np.linalg.norm(vector):.4f}")
            fix(self, name, vector)


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A detection lifted into the world (ALGORITHM A.1).

    points_world (N, 3) float32 metres, one a voxel; colors (N, 3) uint8; box corners (3,) of the visible
    surface; `range_m` the median depth; `detection_index` its place in the frame's detections.
    """

    detection_index: int
    label: str
    score: float
    points_world: Float32Array
    colors: ByteArray
    box_min: FloatArray
    box_max: FloatArray
    range_m: float
    text_feature: Float32Array | None = None
    image_feature: Float32Array | None = None
