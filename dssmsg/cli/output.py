"""stdout carries the result alone: what plug-ins and libraries print goes to stderr.

Names come from recordings and models of strangers: what is printed here cannot steer the terminal.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

_STEERING = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Control characters but line feed and tab, signs that turn the direction of writing, and halves of
characters, which cannot be encoded."""


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


def plain(text: str) -> str:
    """A text in which control characters are spelt out (`\\x1b`) instead of obeyed; lines and tabs stay."""
    return _STEERING.sub(lambda found: found.group().encode("unicode_escape").decode("ascii"), text)


def show(text: str) -> None:
    """A result for the human, on stdout."""
    print(plain(text))


def print_json(value: Any) -> None:
    """One JSON value on stdout."""
    text = json.dumps(value, ensure_ascii=False, indent=2)
    print(_STEERING.sub(lambda found: f"\\u{ord(found.group()):04x}", text))


def error_json(kind: str, message: str, file: str | None = None, key: str | None = None) -> str:
    """A failure as the one JSON object that `--json` promises."""
    return json.dumps({"error": {"kind": kind, "message": message, "file": file, "key": key}})


def note(message: str) -> None:
    """A line for the human, on stderr."""
    print(plain(message), file=sys.stderr)
