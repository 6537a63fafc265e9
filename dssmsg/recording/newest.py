"""Which recording of a folder is meant where none is named."""

from __future__ import annotations

from pathlib import Path

from dssmsg.errors import InputError
from dssmsg.recording import schema
from dssmsg.recording.messages import has_footer
from dssmsg.recording.store import ChunkFile


def newest(directory: Path) -> Path:
    """The newest recording of a run in a folder; comparisons of two runs are passed by.

    Raises InputError if the folder has none.
    """
    try:
        found = [
            (path.stat().st_mtime_ns, path)
            for path in directory.glob("*.rrd")
            if path.is_file() and not path.name.startswith(".")
        ]
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=directory) from error
    for _, path in sorted(found, reverse=True):
        if not is_comparison(path):
            return path
    raise InputError(
        "holds no recording of a run (.rrd); make one with `dssmsg run`, or name a file", file=directory
    )


def is_comparison(path: Path) -> bool:
    """Whether a file is one of `dssmsg diff --recording`; of its content just the index is read.

    False also for what does not read: the reader says why.
    """
    try:
        # A comparison is always a finished file; to read any other costs a repair.
        return has_footer(path) and ChunkFile(path, path).application_id == schema.COMPARISON_ID
    except (InputError, OSError):
        return False
