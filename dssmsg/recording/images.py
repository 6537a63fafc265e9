"""Images and masks as bytes: exact where replay reads them, cheap where the mission waits for them.

Everything here spends its time in zlib or Pillow, which release the GIL, so that the writer's thread
costs the mission next to nothing.
"""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dssmsg.frame import ByteArray, Float32Array, IntArray, MaskArray, depth_from_millimetres

Encoding = Literal["jpeg", "lossless"]
MEDIA_TYPES: dict[Encoding, str] = {"jpeg": "image/jpeg", "lossless": "image/png"}

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_FAST = 1  # zlib level; level 6 is several times slower for little less


def encode_rgb(rgb: ByteArray, encoding: Encoding, quality: int = 80) -> bytes:
    """An (H, W, 3) uint8 image as JPEG of the given quality, or as PNG without loss."""
    buffer = io.BytesIO()
    image = Image.fromarray(np.ascontiguousarray(rgb))
    if encoding == "jpeg":
        image.save(buffer, "JPEG", quality=quality)
    else:
        image.save(buffer, "PNG", compress_level=_FAST)
    return buffer.getvalue()


def decode_rgb(data: bytes) -> ByteArray:
    """The (H, W, 3) uint8 image of a JPEG or PNG."""
    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGB"))


def encode_depth(depth: Float32Array) -> bytes:
    """Depth (H, W) in metres, whole millimetres by contract, as a 16-bit PNG: nothing is lost."""
    return encode_png16(np.rint(depth * np.float32(1000.0)).astype(np.uint16))


def decode_depth(data: bytes) -> Float32Array:
    """Depth (H, W) float32 metres of a 16-bit millimetre PNG."""
    return depth_from_millimetres(decode_png16(data))


def encode_png16(values: NDArray[np.uint16]) -> bytes:
    """A 16-bit grey PNG of an (H, W) image: differences to the left, run lengths and Huffman.

    Noise leaves deflate's search for repetitions nothing to find: without it, this takes a third of the time
    of the fastest level, and a fifth less space.
    """
    height, width = values.shape
    raw = values.astype(">u2").view(np.uint8).reshape(height, 2 * width)
    rows = np.empty((height, 1 + 2 * width), dtype=np.uint8)
    rows[:, 0] = 1  # the first byte of a row names its filter: Sub
    rows[:, 1:3] = raw[:, :2]
    np.subtract(raw[:, 2:], raw[:, :-2], out=rows[:, 3:])
    deflate = zlib.compressobj(_FAST, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_RLE)
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return b"".join(
        (
            _PNG_SIGNATURE,
            _chunk(b"IHDR", header),
            _chunk(b"IDAT", deflate.compress(rows.data) + deflate.flush()),
            _chunk(b"IEND", b""),
        )
    )


def decode_png16(data: bytes) -> NDArray[np.uint16]:
    """The (H, W) uint16 image of a 16-bit grey PNG."""
    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image).astype(np.uint16)


def _chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(body, zlib.crc32(name)))


def encode_masks(masks: list[MaskArray]) -> tuple[bytes, tuple[int, int, int]]:
    """Masks (H, W) of one frame as deflated bits, and their (count, H, W)."""
    if not masks:
        return b"", (0, 0, 0)
    stack = np.stack(masks)
    count, height, width = stack.shape
    return zlib.compress(np.packbits(stack, axis=2).data, _FAST), (count, height, width)


def decode_masks(data: bytes, shape: tuple[int, int, int]) -> MaskArray:
    """The (count, H, W) bool masks of one frame."""
    count, height, width = shape
    if count == 0:
        return np.zeros((0, height, width), dtype=np.bool_)
    bits = np.frombuffer(zlib.decompress(data), dtype=np.uint8).reshape(count, height, -1)
    return np.unpackbits(bits, axis=2, count=width).astype(np.bool_)


def encode_instances(instance_ids: IntArray) -> bytes:
    """Instance ids (H, W) as a 16-bit PNG.

    Raises ValueError if an id does not fit 16 bits.
    """
    if instance_ids.size and (int(instance_ids.min()) < 0 or int(instance_ids.max()) > 65535):
        raise ValueError("instance ids: expected 0 to 65535")
    return encode_png16(instance_ids.astype(np.uint16))


def decode_instances(data: bytes) -> IntArray:
    """Instance ids (H, W) int32 of a 16-bit PNG."""
    return cast("NDArray[Any]", decode_png16(data)).astype(np.int32)
