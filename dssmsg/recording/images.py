"""Images and masks as bytes: exact where replay reads them, cheap where the mission waits for them.

Everything here spends its time in zlib or Pillow, which release the GIL, so that the writer's thread
costs the mission next to nothing.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dssmsg.frame import ByteArray, Float32Array, IntArray, MaskArray, depth_from_millimetres

Encoding = Literal["jpeg", "lossless"]
MEDIA_TYPES: dict[Encoding, str] = {"jpeg": "image/jpeg", "lossless": "image/png"}

_FAST = 1  # zlib level; level 6 is several times slower for little less
_MAX_PIXELS = 64_000_000
"""Of a picture, or of all masks of a frame: what a file claims beyond that is not decoded."""

Size = tuple[int, int]
"""Height and width in pixels."""


def encode_rgb(rgb: ByteArray, encoding: Encoding, quality: int = 80) -> bytes:
    """An (H, W, 3) uint8 image as JPEG of the given quality, or as PNG without loss."""
    buffer = io.BytesIO()
    image = Image.fromarray(np.ascontiguousarray(rgb))
    if encoding == "jpeg":
        image.save(buffer, "JPEG", quality=quality)
    else:
        image.save(buffer, "PNG", compress_level=_FAST)
    return buffer.getvalue()


def decode_rgb(data: bytes, size: Size | None = None) -> ByteArray:
    """The (H, W, 3) uint8 image of a JPEG or PNG. Raises ValueError or OSError as `_opened` does."""
    with _opened(data, size) as image:
        return np.asarray(image.convert("RGB"))


def encode_depth(depth: Float32Array) -> bytes:
    """Depth (H, W) in metres, whole millimetres by contract, as a 16-bit PNG: nothing is lost."""
    return encode_png16(np.rint(depth * np.float32(1000.0)).astype(np.uint16))


def decode_depth(data: bytes, size: Size | None = None) -> Float32Array:
    """Depth (H, W) float32 metres of a 16-bit millimetre PNG. Raises as `decode_png16` does."""
    return depth_from_millimetres(decode_png16(data, size))


def encode_png16(values: NDArray[np.uint16]) -> bytes:
    """A 16-bit grey PNG of an (H, W) image, with run lengths and Huffman codes alone.

    Noise leaves deflate's search for repetitions nothing to find: without it the file is
    smaller, and sooner done.
    """
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(values)).save(
        buffer, "PNG", compress_level=_FAST, compress_type=zlib.Z_RLE
    )
    return buffer.getvalue()


def decode_png16(data: bytes, size: Size | None = None) -> NDArray[np.uint16]:
    """The (H, W) uint16 image of a 16-bit grey PNG. Raises ValueError or OSError as `_opened` does."""
    with _opened(data, size) as image:
        values = np.asarray(image)
    if values.ndim != 2:
        raise ValueError(f"expected a grey image, got {values.shape}")
    return values.astype(np.uint16)


@contextmanager
def _opened(data: bytes, size: Size | None) -> Iterator[Image.Image]:
    """An image whose size was looked at before its pixels are decoded.

    Raises OSError where the bytes are no image, ValueError for another (H, W) than `size` or too
    many pixels.
    """
    try:
        image = Image.open(io.BytesIO(data))
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from error
    with image:
        width, height = image.size
        if size is not None and (height, width) != tuple(size):
            raise ValueError(f"expected an image of {size[1]}x{size[0]} pixels, got {width}x{height}")
        if width * height > _MAX_PIXELS:
            raise ValueError(f"expected at most {_MAX_PIXELS} pixels, got {width}x{height}")
        yield image


def encode_masks(masks: list[MaskArray]) -> tuple[bytes, tuple[int, int, int]]:
    """Masks (H, W) of one frame as deflated bits, and their (count, H, W)."""
    if not masks:
        return b"", (0, 0, 0)
    stack = np.stack(masks)
    count, height, width = stack.shape
    return zlib.compress(np.packbits(stack, axis=2).data, _FAST), (count, height, width)


def decode_masks(data: bytes, shape: tuple[int, int, int]) -> MaskArray:
    """The (count, H, W) bool masks of one frame. Raises ValueError or zlib.error where they are not that."""
    count, height, width = shape
    if count == 0:
        return np.zeros((0, height, width), dtype=np.bool_)
    if min(shape) < 0 or count * height * width > _MAX_PIXELS:
        raise ValueError(f"expected masks of at most {_MAX_PIXELS} pixels, got {count}x{height}x{width}")
    size = count * height * -(-width // 8)
    # A pixel more than there may be, so that a stream that goes on is noticed and not unpacked.
    packed = zlib.decompressobj().decompress(data, size + 1)
    if len(packed) != size:
        raise ValueError(
            f"expected {size} bytes of masks, got {'more' if len(packed) > size else len(packed)}"
        )
    bits = np.frombuffer(packed, dtype=np.uint8).reshape(count, height, -1)
    return np.unpackbits(bits, axis=2, count=width).astype(np.bool_)


def encode_bits(flags: Sequence[MaskArray]) -> bytes:
    """Flags (N,) of several lengths as deflated bits, one after the other."""
    return zlib.compress(np.packbits(np.concatenate(flags)).data, _FAST) if flags else b""


def decode_bits(data: bytes, sizes: Sequence[int]) -> list[MaskArray]:
    """The flags, given how many there are of each. Raises ValueError or zlib.error for other bytes."""
    if not sizes:
        return []
    total = sum(sizes)
    if min(sizes) < 0 or total > _MAX_PIXELS:
        raise ValueError(f"expected at most {_MAX_PIXELS} flags, got {total}")
    packed = zlib.decompressobj().decompress(data, -(-total // 8) + 1)
    if len(packed) != -(-total // 8):
        raise ValueError(f"expected {total} flags, got bytes for another number")
    bits = np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=total).astype(np.bool_)
    return np.split(bits, np.cumsum(sizes)[:-1])


def encode_instances(instance_ids: IntArray) -> bytes:
    """Instance ids (H, W) as a 16-bit PNG.

    Raises ValueError if an id does not fit 16 bits.
    """
    if instance_ids.size and (int(instance_ids.min()) < 0 or int(instance_ids.max()) > 65535):
        raise ValueError("instance ids: expected 0 to 65535")
    return encode_png16(instance_ids.astype(np.uint16))


def decode_instances(data: bytes, size: Size | None = None) -> IntArray:
    """Instance ids (H, W) int32 of a 16-bit PNG. Raises as `decode_png16` does."""
    return cast("NDArray[Any]", decode_png16(data, size)).astype(np.int32)
