"""Poses as text: 4x4 matrices and quaternions, checked for being rigid."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dssmsg.errors import InputError
from dssmsg.frame import FloatArray

_ORTHOGONAL_TOLERANCE = 0.02  # published poses are rounded; more than this is not a rotation


def rigid_or_none(matrix: FloatArray) -> FloatArray | None:
    """A (4, 4) pose with its rotation made exactly orthogonal, or None if it is not finite or not rigid."""
    if not np.isfinite(matrix).all() or np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        return None
    rotation = matrix[:3, :3]
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > _ORTHOGONAL_TOLERANCE or np.linalg.det(rotation) < 0:
        return None
    u, _scale, vt = np.linalg.svd(rotation)
    pose = matrix.astype(np.float64)
    pose[:3, :3] = u @ vt
    return pose


def from_quaternion(xyzw: FloatArray, position: FloatArray) -> FloatArray | None:
    """The (4, 4) pose of a unit quaternion (x, y, z, w) and a position (3,); None if it is no pose."""
    norm = float(np.linalg.norm(xyzw))
    if not (np.isfinite(norm) and np.isfinite(position).all() and abs(norm - 1.0) < 0.1):
        return None
    x, y, z, w = xyzw / norm
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = position
    return pose


def read_numbers(path: Path) -> FloatArray:
    """All numbers of a text file, in order; `inf` and `nan` are numbers.

    Raises InputError naming the file if it cannot be read or holds anything else.
    """
    return parse_numbers(read_text(path), path)


def read_text(path: Path) -> str:
    """A text file. Raises InputError naming it if it is missing or not text."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError("the file is missing", file=path) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as text ({type(error).__name__})", file=path) from None


def parse_numbers(text: str, path: Path) -> FloatArray:
    """The whitespace-separated numbers of `text`; InputError naming `path` otherwise."""
    try:
        return np.array(text.split(), dtype=np.float64)
    except ValueError as error:
        raise InputError(f"expected numbers, got other text ({error})", file=path) from None


def read_matrix(path: Path, size: int) -> FloatArray:
    """A (size, size) matrix from a text file; InputError if it holds another number of numbers."""
    numbers = read_numbers(path)
    if numbers.size != size * size:
        raise InputError(f"expected a {size}x{size} matrix, got {numbers.size} numbers", file=path)
    return numbers.reshape(size, size)


def read_pose(path: Path) -> FloatArray | None:
    """A 4x4 pose file; None if the pose is invalid or the file is missing (tracking lost)."""
    return rigid_or_none(read_matrix(path, 4)) if path.is_file() else None
