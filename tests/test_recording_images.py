"""Images and masks come back exactly, whatever they hold."""

from __future__ import annotations

import io
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from dssmsg.frame import quantise_depth
from dssmsg.recording import images

SIZES = hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=24)


@given(hnp.arrays(np.uint16, SIZES))
@settings(max_examples=60, deadline=None)
def test_png16_is_exact_for_us_and_for_pillow(values: np.ndarray) -> None:
    data = images.encode_png16(values)
    assert np.array_equal(images.decode_png16(data), values)
    with Image.open(io.BytesIO(data)) as image:
        image.verify()  # checks every chunk's checksum


@given(hnp.arrays(np.float64, SIZES, elements=st.floats(-1.0, 70.0, allow_nan=False)))
@settings(max_examples=60, deadline=None)
def test_depth_of_whole_millimetres_is_exact(metres: np.ndarray) -> None:
    depth = quantise_depth(metres)
    back = images.decode_depth(images.encode_depth(depth))
    assert back.dtype == np.float32
    assert np.array_equal(back, depth)


@given(st.integers(0, 5), SIZES, st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_masks_are_exact(count: int, size: tuple[int, int], seed: int) -> None:
    masks = np.random.default_rng(seed).random((count, *size)) < 0.5
    data, shape = images.encode_masks(list(masks))
    back = images.decode_masks(data, shape)
    assert back.dtype == np.bool_
    assert back.shape == (masks.shape if count else (0, 0, 0))
    assert np.array_equal(back.reshape(-1), masks.reshape(-1))


def test_masks_of_a_frame_are_small() -> None:
    mask = np.zeros((240, 320), dtype=bool)
    mask[40:90, 100:180] = True
    data, _ = images.encode_masks([mask] * 12)
    assert len(data) < 4000


def test_png_colours_are_exact_and_jpeg_colours_near() -> None:
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    rgb = np.stack([x * 3, y * 4, x + y], axis=2).astype(np.uint8)
    assert np.array_equal(images.decode_rgb(images.encode_rgb(rgb, "lossless")), rgb)
    lossy = images.decode_rgb(images.encode_rgb(rgb, "jpeg", 80)).astype(int)
    assert 0 < np.abs(lossy - rgb).mean() < 4


def test_instance_ids_beyond_16_bits_are_refused() -> None:
    ids = np.zeros((4, 4), dtype=np.int32)
    ids[1, 2] = 65535
    assert np.array_equal(images.decode_instances(images.encode_instances(ids)), ids)
    ids[1, 2] = 65536
    with pytest.raises(ValueError, match="65535"):
        images.encode_instances(ids)
    with pytest.raises(ValueError, match="65535"):
        images.encode_instances(ids - 65537)


def test_noisy_depth_takes_less_than_its_raw_bits() -> None:
    rng = np.random.default_rng(0)
    slope = np.linspace(1.0, 4.0, 320)[None] + np.zeros((240, 1))
    depth = quantise_depth(slope + rng.normal(0.0, 0.004, slope.shape))
    size = len(images.encode_depth(depth))
    plain = len(zlib.compress((depth * 1000).astype(np.uint16).tobytes(), 1))
    assert size < 0.9 * plain
