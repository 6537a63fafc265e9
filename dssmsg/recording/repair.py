"""Recordings that were cut off: made readable in a copy, the original untouched. And compaction.

An `.rrd` file is a 12-byte header and then messages, each with 16 bytes that give its kind and length; a
finished one ends in a footer. After `kill -9` the footer is missing, and the last message may be cut short.
Dropping that last piece leaves a stream that reads; compacting the stream gives it its footer back.
"""

from __future__ import annotations

import logging
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import BinaryIO

from dssmsg.errors import InputError, StorageError

log = logging.getLogger(__name__)

_MAGIC = b"RRF2"
_HEADER_BYTES = 12
_MESSAGE = struct.Struct("<QQ")  # kind, length of the payload
_FOOTER_MAGIC = b"RRF2FOOT"
_FOOTER_TAIL_BYTES = 12  # the magic, and four bytes behind it
_KINDS = frozenset(range(16))  # few kinds exist; anything far above is not a message header
_OPTIMIZE_TIMEOUT_SECS = 600.0


def is_finished(path: Path) -> bool:
    """Whether a recording was closed properly: it ends in a footer. Raises InputError if it is none."""
    check_recording(path)
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _FOOTER_TAIL_BYTES))
        return file.read().startswith(_FOOTER_MAGIC)


def check_recording(path: Path) -> None:
    """Raise InputError unless the path is a readable file that begins like an `.rrd` of this generation."""
    try:
        with path.open("rb") as file:
            start = file.read(_HEADER_BYTES)
    except FileNotFoundError as error:
        raise InputError("there is no such recording", file=path) from error
    except IsADirectoryError as error:
        raise InputError("expected an .rrd file, this is a folder", file=path) from error
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from error
    if not start:
        raise InputError("the file is empty; expected a recording (.rrd)", file=path)
    if not start.startswith(_MAGIC) or len(start) < _HEADER_BYTES:
        raise InputError("not a recording that this version reads; expected an .rrd file", file=path)


def whole_length(path: Path) -> int:
    """The length in bytes of the header and all whole messages, from the start of the file."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        position = _HEADER_BYTES
        while position + _MESSAGE.size <= size:
            file.seek(position)
            kind, length = _MESSAGE.unpack(file.read(_MESSAGE.size))
            end = position + _MESSAGE.size + length
            if kind not in _KINDS or end > size:
                break
            position = end
        return min(position, size)


def repaired_copy(path: Path, folder: Path) -> Path:
    """A readable copy, in `folder`, of a recording that is unfinished or still growing.

    Raises InputError if not even the beginning can be read, StorageError if the copy cannot be written.
    """
    check_recording(path)
    whole = folder / f"{path.stem}.whole.rrd"
    copy = folder / path.name
    try:
        length = whole_length(path)
        with path.open("rb") as source, whole.open("xb") as target:
            _copy_bytes(source, target, length)
        _run_optimize(whole, copy)
        whole.unlink()
    except OSError as error:
        raise StorageError(f"no room for a readable copy ({error.strerror})", file=folder) from error
    except _OptimizeError as error:
        raise InputError(f"damaged from the start on, nothing can be read ({error})", file=path) from error
    return copy


def optimize(path: Path) -> None:
    """Compact a finished recording in place: a temporary file beside it takes its name once it is complete.

    Raises StorageError if that failed; the recording is then as it was.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=".tmp.rrd")
    os.close(handle)
    temporary = Path(name)
    try:
        _run_optimize(path, temporary)
        shutil.copymode(path, temporary)
        temporary.replace(path)
    except (OSError, _OptimizeError) as error:
        raise StorageError(f"could not be compacted ({error}); it is complete as it is", file=path) from error
    finally:
        temporary.unlink(missing_ok=True)


def rerun_program() -> Path:
    """Rerun's own program. Not the `rerun` script: that one does not pass signals on."""
    import rerun_cli  # type: ignore[import-untyped]

    folder = Path(rerun_cli.__file__).parent
    return folder / ("rerun.exe" if sys.platform == "win32" else "rerun")


def viewer_environment() -> dict[str, str]:
    """Environment variables for Rerun's program: it works for this one, and greets nobody."""
    return {"RERUN_APP_ONLY": "true"}


class _OptimizeError(Exception):
    pass


def _run_optimize(source: Path, target: Path) -> None:
    """Write `source`, compacted and with a footer, to `target`; in a process of its own, for the memory."""
    command = [str(rerun_program()), "rrd", "optimize", str(source), "-o", str(target)]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=_OPTIMIZE_TIMEOUT_SECS,
            stdin=subprocess.DEVNULL,
            env={**os.environ, **viewer_environment()},
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise _OptimizeError(f"no result after {_OPTIMIZE_TIMEOUT_SECS:.0f} s") from error
    if done.returncode != 0 or not target.exists() or not is_finished(target):
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        raise _OptimizeError(lines[-1].strip() if lines else f"exit code {done.returncode}")


def _copy_bytes(source: BinaryIO, target: BinaryIO, length: int) -> None:
    remaining = length
    while remaining:
        piece = source.read(min(remaining, 1 << 20))
        if not piece:
            return
        target.write(piece)
        remaining -= len(piece)
