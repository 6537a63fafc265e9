"""Recordings without an index: cut off, still growing, or just written. Made readable, the content untouched.

`RepairedCopy` leaves the original alone and reads what is whole; `optimize` finishes a recording in place.
Both let Rerun's own program compact the messages and write the index.
"""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
import tempfile
import weakref
from pathlib import Path
from typing import BinaryIO

from dssmsg.errors import InputError, StorageError
from dssmsg.recording.messages import HEADER_BYTES, MAGIC, has_footer, whole_length

log = logging.getLogger(__name__)

_OPTIMIZE_TIMEOUT_SECS = 600.0
_CHUNK_LIMITS = ("--max-size", "512KiB", "--max-rows", "256")
"""Chunks stand in the order of their first rows: small ones keep a file in the order of time, so that a copy
that was cut off has the beginning of everything. A hundredth more bytes than with Rerun's own limits."""


def check_recording(path: Path) -> None:
    """Raise InputError unless the path is a readable file that begins like an `.rrd` of this generation."""
    try:
        with path.open("rb") as file:
            start = file.read(HEADER_BYTES)
    except FileNotFoundError as error:
        raise InputError("there is no such recording", file=path) from error
    except IsADirectoryError as error:
        raise InputError("expected an .rrd file, this is a folder", file=path) from error
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from error
    if not start:
        raise InputError("the file is empty; expected a recording (.rrd)", file=path)
    if not start.startswith(MAGIC) or len(start) < HEADER_BYTES:
        raise InputError("not a recording that this version reads; expected an .rrd file", file=path)


class RepairedCopy:
    """A readable copy of a recording that is unfinished or still growing, in a temporary folder.

    The folder goes with the last who holds the copy, at the latest with the process.
    """

    def __init__(self, path: Path) -> None:
        folder = Path(tempfile.mkdtemp(prefix="dssmsg-"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.path = _repaired(path, folder)

    @classmethod
    def of(cls, path: Path) -> RepairedCopy:
        """The copy that somebody in this process holds of the file as it is now, else a new one.

        A replay reads its recording in several places: it is repaired, and that is said, once. Raises
        InputError if not even the beginning can be read, StorageError if the copy cannot be written.
        """
        state = path.stat()
        key = (path.resolve(), state.st_ino, state.st_size, state.st_mtime_ns)
        copy = _held.get(key)
        if copy is None:
            copy = _held[key] = cls(path)
            log.warning("%s was cut off, or is still being written: reading a repaired copy", path)
        return copy


_held: weakref.WeakValueDictionary[tuple[object, ...], RepairedCopy] = weakref.WeakValueDictionary()


def _repaired(path: Path, folder: Path) -> Path:
    """Write the copy into `folder`."""
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
    """Compact a recording in place and give it its index: a temporary file takes its name once it is whole.

    Raises StorageError if that failed; the recording is then as it was, and reads with a repair.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=".tmp.rrd")
    os.close(handle)
    temporary = Path(name)
    try:
        _run_optimize(path, temporary)
        shutil.copymode(path, temporary)
        temporary.replace(path)
    except (OSError, _OptimizeError) as error:
        raise StorageError(f"could not be compacted ({error}); nothing of it is lost", file=path) from error
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
    command = [str(rerun_program()), "rrd", "optimize", *_CHUNK_LIMITS, str(source), "-o", str(target)]
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
    if done.returncode != 0 or not target.exists() or not has_footer(target):
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
