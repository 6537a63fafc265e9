"""stdout carries the result alone: what plug-ins and libraries print goes to stderr."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any


@contextmanager
def stdout_to_stderr() -> Iterator[int | None]:
    """Everything written to stdout inside, by Python or by a C library, comes out on stderr.

    Yields the descriptor of the real stdout, for last words; None where stdout is closed.
    """
    sys.stdout.flush()
    with redirect_stdout(sys.stderr):
        try:
            saved = os.dup(1)
        except OSError:  # stdout is closed
            yield None
            return
        try:
            os.dup2(2, 1)
            yield saved
        finally:
            sys.stderr.flush()
            os.dup2(saved, 1)
            os.close(saved)


def print_json(value: Any) -> None:
    """One JSON value on stdout."""
    print(json.dumps(value, ensure_ascii=False, indent=2))


def error_json(kind: str, message: str, file: str | None = None, key: str | None = None) -> str:
    """A failure as the one JSON object that `--json` promises."""
    return json.dumps({"error": {"kind": kind, "message": message, "file": file, "key": key}})


def note(message: str) -> None:
    """A line for the human, on stderr."""
    print(message, file=sys.stderr)
