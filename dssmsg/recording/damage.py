"""What damaged or hostile values in a recording do to whoever decodes them, as one kind of error."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import orjson

from dssmsg.errors import InputError
from dssmsg.graph.errors import GraphError

MAX_DEPTH = 64
"""Nesting of JSON values that is read; nothing of ours is nested a tenth as deeply."""


@contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Turn whatever damaged values do to a decoder into an InputError that names the file."""
    try:
        yield
    except (InputError, GraphError) as error:
        if isinstance(error, InputError) and error.file:
            raise
        raise InputError(f"{what}: {error.message}", file=path) from error
    except RecursionError as error:
        raise InputError(f"{what}: damaged (nested too deeply)", file=path) from error
    except (
        ValueError,
        LookupError,
        TypeError,
        ArithmeticError,
        AttributeError,
        OSError,
        zlib.error,
    ) as error:
        raise InputError(f"{what}: damaged ({_short(error)})", file=path) from error
    except MemoryError as error:
        raise InputError(f"{what}: damaged (claims more than fits in memory)", file=path) from error


def json_value(text: str) -> Any:
    """The value of a JSON text. Raises ValueError or RecursionError if it is none."""
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError:  # damaged, or half of a surrogate pair, which Python writes and reads
        return json.loads(text)


def json_object(text: Any) -> dict[str, Any]:
    """The JSON object of a text. Raises ValueError if it is none, or nested deeper than `MAX_DEPTH`."""
    if not isinstance(text, str):
        raise ValueError(f"expected JSON text, got {type(text).__name__}")
    value = json_value(text)
    if not isinstance(value, dict):
        raise ValueError(f"expected a JSON object, got {type(value).__name__}")
    level: list[Any] = [value]
    for _ in range(MAX_DEPTH):
        level = [
            item
            for outer in level
            for item in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(item, dict | list)
        ]
        if not level:
            return value
    raise ValueError(f"JSON nested deeper than {MAX_DEPTH}")


def _short(error: BaseException) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 200 else f"{text[:200]}..."
