"""What a real depth camera adds to an exact view: noise, missing readings, blur, exposure."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy import ndimage
from scipy.special import ndtri

from dssmsg.errors import ConfigError
from dssmsg.frame import ByteArray, Float32Array, FloatArray, MaskArray, quantise_depth
from dssmsg.sim.camera import Render


class SensorNoise(BaseModel):
    """A sensor model for RGB-D views; all of it off by default except the range limits.

    Depth noise follows the law of structured-light and stereo sensors, sigma(z) = a + b z^2: disparity noise
    is constant, so depth noise grows with the square of the range (Nguyen, Izadi and Lovell, "Modeling Kinect
    Sensor Noise for Improved 3D Reconstruction and Tracking", 2012).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    depth_a: float = Field(
        0.0, ge=0, le=1, description="depth noise at range 0, standard deviation in metres"
    )
    depth_b: float = Field(0.0, ge=0, le=1, description="its growth with the range squared, per metre")
    depth_grain: int = Field(
        1,
        ge=1,
        le=16,
        description="side, in pixels, of the patches that share one error: a stereo camera matches windows, "
        "not single pixels",
    )
    min_range: float = Field(0.1, ge=0, le=100, description="no depth below this, metres")
    max_range: float = Field(10.0, gt=0, le=65, description="no depth beyond this, metres")
    edge_jump: float = Field(
        0.0,
        ge=0,
        le=10,
        description="readings go missing where neighbours differ by more than this share; 0 = off",
    )
    edge_dropout: float = Field(
        0.0, ge=0, le=1, description="share of the readings at such edges that go missing"
    )
    grazing_cos: float = Field(
        0.0,
        ge=0,
        le=1,
        description="readings go missing where the cosine of incidence is below this; 0 = off",
    )
    speckle: float = Field(
        0.0, ge=0, le=1, description="share of all readings that go missing, in small spots"
    )
    rgb_noise: float = Field(0.0, ge=0, le=64, description="colour noise, standard deviation in grey levels")
    blur: float = Field(0.0, ge=0, le=5, description="blur of the colour image, standard deviation in pixels")
    exposure: float = Field(
        0.0, ge=0, le=1, description="frame-to-frame change of brightness, standard deviation"
    )

    @property
    def depth_sigma(self) -> tuple[float, float]:
        """(a, b) of sigma(z) = a + b z^2, metres: what a source says of itself."""
        return self.depth_a, self.depth_b

    def sigma(self, depth: Any) -> Any:
        """Standard deviation in metres of a reading at `depth` metres (any shape)."""
        return self.depth_a + self.depth_b * np.square(depth)

    def apply(self, render: Render, rng: np.random.Generator) -> tuple[ByteArray, Float32Array]:
        """A sensor's reading of `render`: rgb (H, W, 3) uint8 and depth (H, W) float32 in whole millimetres.

        Draws the same number of values from `rng` for every view of a size, so frames stay independent of
        what was seen before.
        """
        return self._color(render.rgb, rng), quantise_depth(self._depth(render, rng))

    def _depth(self, render: Render, rng: np.random.Generator) -> FloatArray:
        depth = render.depth.copy()
        if self.depth_a or self.depth_b:
            grain = self.depth_grain
            noise = _patches(_normal(_patch_counts(depth.shape, grain), rng), grain, depth.shape)
            depth += noise * (self.depth_a + self.depth_b * depth * depth)
        lost: MaskArray = (render.depth < self.min_range) | (render.depth > self.max_range)
        if self.edge_jump and self.edge_dropout:
            drop = rng.random(depth.shape, dtype=np.float32) < self.edge_dropout
            lost |= drop & _edges(render.depth, self.edge_jump)
        if self.grazing_cos:
            lost |= render.cos_incidence < self.grazing_cos
        if self.speckle:
            lost |= _spots(depth.shape, self.speckle, rng)
        depth[lost] = 0.0
        return depth

    def _color(self, rgb: ByteArray, rng: np.random.Generator) -> ByteArray:
        if not (self.rgb_noise or self.blur or self.exposure):
            return rgb
        image: NDArray[np.float32] = rgb.astype(np.float32)
        if self.blur:
            for axis in (0, 1):
                image = ndimage.gaussian_filter1d(image, self.blur, axis=axis, truncate=2.0)
        if self.exposure:
            image *= np.float32(np.exp(self.exposure * rng.standard_normal()))
        if self.rgb_noise:
            image += _normal(rgb.shape, rng) * np.float32(self.rgb_noise)
        np.clip(image, 0, 255, out=image)
        return np.rint(image, out=image).astype(np.uint8)


@functools.cache
def _quantiles() -> Float32Array:
    """65,536 equally likely values of the standard normal distribution."""
    return ndtri((np.arange(65536) + 0.5) / 65536).astype(np.float32)


def _normal(shape: tuple[int, ...], rng: np.random.Generator) -> Float32Array:
    """Standard normal values; looking them up by 16 random bits takes a third of the time of drawing them."""
    count = int(np.prod(shape))
    return _quantiles().take(np.frombuffer(rng.bytes(2 * count), np.uint16)).reshape(shape)


def _edges(depth: FloatArray, jump: float) -> MaskArray:
    """Pixels (H, W) on either side of a step in depth larger than the share `jump` of the nearer side."""
    edges = np.zeros(depth.shape, np.bool_)
    for axis in (0, 1):
        near = depth[:-1] if axis == 0 else depth[:, :-1]
        far = depth[1:] if axis == 0 else depth[:, 1:]
        step = np.abs(far - near) > jump * np.minimum(near, far)
        if axis == 0:
            edges[:-1] |= step
            edges[1:] |= step
        else:
            edges[:, :-1] |= step
            edges[:, 1:] |= step
    return edges


def _spots(shape: tuple[int, ...], share: float, rng: np.random.Generator) -> MaskArray:
    """A mask (H, W) of 2 x 2 pixel spots that cover about `share` of the image."""
    return _patches(rng.random(_patch_counts(shape, 2), dtype=np.float32) < share, 2, shape)


def _patch_counts(shape: tuple[int, ...], side: int) -> tuple[int, int]:
    """How many patches of `side` pixels cover an image (H, W), by rows and columns."""
    return -(-shape[0] // side), -(-shape[1] // side)


def _patches(values: NDArray[Any], side: int, shape: tuple[int, ...]) -> NDArray[Any]:
    """An image of `shape` (H, W) in which each value fills a patch of `side` x `side` pixels."""
    if side == 1:
        return values
    return values.repeat(side, axis=0).repeat(side, axis=1)[: shape[0], : shape[1]]


PRESETS: dict[str, SensorNoise] = {
    "none": SensorNoise(),
    # RealSense D435: its data sheet promises 2 % at 2 m at worst; on matt surfaces indoors the spread is
    # near 1 cm there, which a and b give.
    "realistic": SensorNoise(
        depth_a=0.001, depth_b=0.002, depth_grain=2, edge_jump=0.05, edge_dropout=0.5, grazing_cos=0.1,
        speckle=0.002, rgb_noise=2.0, blur=0.4, exposure=0.02,
    ),
}  # fmt: skip


def make_noise(value: str | SensorNoise | Mapping[str, Any]) -> SensorNoise:
    """The sensor model for `source.noise`: a preset's name, or a mapping of `SensorNoise` fields.

    Raises ConfigError for an unknown preset or wrong fields.
    """
    if isinstance(value, SensorNoise):
        return value
    if isinstance(value, str):
        if value not in PRESETS:
            known = ", ".join(PRESETS)
            raise ConfigError(
                f"unknown preset {value!r}; accepted: {known}, or a mapping", key="source.noise"
            )
        return PRESETS[value]
    try:
        return SensorNoise(**value)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(["source.noise", *(str(part) for part in first["loc"])])
        known = ", ".join(SensorNoise.model_fields)
        raise ConfigError(f"{first['msg']}; accepted fields: {known}", key=key) from None
