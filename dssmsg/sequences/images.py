"""Reading colour and depth images, with errors that name the file."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from dssmsg.errors import InputError
from dssmsg.frame import ByteArray, FloatArray

MAX_PIXELS = 64_000_000
_INVALID_16_BIT = 65535


def read_rgb(path: Path) -> ByteArray:
    """A colour image as (H, W, 3) uint8. Raises InputError naming the file."""
    with _opened(path) as image:
        return np.asarray(image.convert("RGB"))


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) of an image file from its header. Raises InputError naming the file."""
    with _opened(path) as image:
        return image.size


def read_depth(path: Path, depth_scale: float, raw_size: tuple[int, int] | None = None) -> FloatArray:
    """A depth image as (H, W) float64 metres, 0 where there is no reading (0, 65535, negative, NaN, inf).

    16-bit images are divided by `depth_scale`; float arrays (`.npy`, `.depth` of `raw_size` (width, height))
    hold metres. Raises InputError naming the file.
    """
    if path.suffix == ".npy":
        depth = _read_npy(path)
    elif path.suffix == ".depth":
        depth = _read_raw(path, raw_size)
    else:
        with _opened(path) as image:
            values = np.asarray(image)
        if values.ndim != 2 or values.dtype == np.uint8 or values.dtype == np.bool_:
            shape = "x".join(map(str, values.shape))
            raise InputError(f"expected a 16-bit depth image, got {values.dtype} {shape}", file=path)
        depth = values.astype(np.float64)
        if values.dtype.kind in "iu":
            depth[values >= _INVALID_16_BIT] = 0.0
        depth /= depth_scale
    depth[~(np.isfinite(depth) & (depth > 0))] = 0.0
    return depth


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """An image file, header read; whatever goes wrong with it inside is an InputError that names it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # bounded below, before decoding
            image = Image.open(path)
        with image:
            if image.width * image.height > MAX_PIXELS:
                raise InputError(f"{image.width}x{image.height} pixels are more than {MAX_PIXELS}", file=path)
            yield image
    except FileNotFoundError:
        raise InputError("the image is missing", file=path) from None
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"cannot be read as an image ({type(error).__name__})", file=path) from None


def _read_npy(path: Path) -> FloatArray:
    try:
        values = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"cannot be read as an array ({type(error).__name__})", file=path) from None
    if values.ndim != 2 or values.dtype.kind != "f":
        raise InputError(f"expected (H, W) float metres, got {values.dtype} {values.shape}", file=path)
    return np.asarray(values, dtype=np.float64).copy()


def _read_raw(path: Path, size: tuple[int, int] | None) -> FloatArray:
    """Bare float32, or the same packed with LZFSE, as Record3D writes it."""
    if size is None:
        raise InputError("a .depth file needs its size: dw and dh in the metadata", file=path)
    width, height = size
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    if data[:3] == b"bvx":
        data = _unpack_lzfse(data, path)
    if len(data) != width * height * 4:
        raise InputError(f"expected {width}x{height} float32 values, got {len(data)} bytes", file=path)
    return np.frombuffer(data, dtype="<f4").astype(np.float64).reshape(height, width)


def _unpack_lzfse(data: bytes, path: Path) -> bytes:
    try:
        import liblzfse  # type: ignore[import-not-found]  # optional, for Record3D alone
    except ImportError:
        raise InputError(
            "is packed with LZFSE: `pip install pyliblzfse`, or save the depth as .npy beside it", file=path
        ) from None
    try:
        return bytes(liblzfse.decompress(data))
    except Exception as error:  # the binding raises its own type, which cannot be named without it
        raise InputError(f"cannot be unpacked ({type(error).__name__})", file=path) from None
