"""Class names: those an exporter noted in the file, and those a user writes down or keeps in a text file."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

from pydantic import Field

from dssmsg.errors import ConfigError, InputError
from dssmsg.onnx.session import FilePath, OnnxModel, find_file

MOST_TEXT = 2_000_000
MOST_NAMES = 50_000
LONGEST_NAME = 200

Name = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME, pattern=r"\S")]
NameList = tuple[Name, ...] | FilePath
"""Names as a list, or the path of a text file with one a line."""


def noted_names(model: OnnxModel, *, key: str | None = None) -> tuple[str, ...] | None:
    """The class names in a file's metadata (`names`, a Python literal), by number; None if there are none.

    Raises InputError if there is something else, or numbers are missing.
    """
    text = model.metadata.get("names")
    if text is None:
        return None
    if len(text) > MOST_TEXT:
        raise InputError(
            f"its class names take {len(text)} characters; at most {MOST_TEXT} are read",
            file=model.path,
            key=key,
        )
    try:
        value = ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError) as error:
        raise InputError(
            "its metadata `names` should be like {0: 'sofa', 1: 'table'}, it is " + repr(text[:60]),
            file=model.path,
            key=key,
        ) from error
    if isinstance(value, Mapping) and set(value) == set(range(len(value))):
        value = [value[number] for number in range(len(value))]
    if not isinstance(value, (list, tuple)) or not all(isinstance(one, str) for one in value):
        raise InputError(
            "its metadata `names` should name the classes 0, 1, 2, ... by texts, it is " + repr(text[:60]),
            file=model.path,
            key=key,
        )
    if len(value) > MOST_NAMES or any(len(one) > LONGEST_NAME for one in value):
        raise InputError(
            f"its metadata `names` should hold at most {MOST_NAMES} names of {LONGEST_NAME} characters",
            file=model.path,
            key=key,
        )
    return tuple(value)


def given_names(value: NameList, base_dir: Path, *, key: str) -> tuple[str, ...]:
    """Names from an option: the list, or the lines of the text file. Raises InputError for a bad file."""
    if not isinstance(value, str):
        return value
    file = find_file(value, base_dir, key=key)
    lines = read_lines(file, key=key)
    if len(lines) > MOST_NAMES or any(len(line) > LONGEST_NAME for line in lines):
        raise InputError(
            f"expected at most {MOST_NAMES} names of at most {LONGEST_NAME} characters, one a line",
            file=file,
            key=key,
        )
    return lines


def read_lines(file: Path, *, key: str) -> tuple[str, ...]:
    """The lines of a small UTF-8 text file, trimmed, empty ones at its end left out."""
    try:
        if file.stat().st_size > MOST_TEXT:
            raise InputError(f"expected a text file of at most {MOST_TEXT} bytes", file=file, key=key)
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("expected a text file in UTF-8", file=file, key=key) from error
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=file, key=key) from error
    lines = [line.strip() for line in text.splitlines()]
    while lines and not lines[-1]:
        lines.pop()
    if not lines or not all(lines):
        raise InputError("expected a text file with one name a line, no line empty", file=file, key=key)
    return tuple(lines)


def baked_names(
    model: OnnxModel,
    count: int | None,
    value: NameList | None,
    base_dir: Path,
    *,
    key: str = ".classes",
    padding: bool = False,
) -> tuple[str, ...]:
    """The names of a graph's `count` classes (None: the graph does not say how many), from file and option.

    Where both name them they must agree: a graph answers for the classes it was exported with, whatever the
    option says. `padding` allows for one more, nameless class at the end. Raises ConfigError.
    """
    noted = noted_names(model, key=".model")
    given = None if value is None else given_names(value, base_dir, key=key)
    if noted is not None and count is not None and len(noted) != count:
        raise InputError(
            f"its metadata names {len(noted)} classes, its output has {count}", file=model.path, key=".model"
        )
    if (
        noted is not None
        and given is not None
        and [_plain(one) for one in noted] != [_plain(one) for one in given]
    ):
        raise ConfigError(
            f"the file was exported with other classes: {summary(noted)}; asked for: {summary(given)}; "
            "export it again with these (set_classes), or leave `classes` out",
            file=model.path,
            key=key,
        )
    names = noted or given
    if names is None:
        many = "" if count is None else f" {count}"
        raise ConfigError(
            f"the file does not name its{many} classes; write them down in their order, "
            "as a list or as the path of a text file with one a line",
            file=model.path,
            key=key,
        )
    if count is not None and len(names) not in ((count, count - 1) if padding else (count,)):
        raise ConfigError(
            f"expected {count} names, one for each class of the file, got {summary(names)}",
            file=model.path,
            key=key,
        )
    return names


def summary(names: Sequence[str], shown: int = 5) -> str:
    """`3 (sofa, table, mug)`, the first few of many."""
    dots = ", ..." if len(names) > shown else ""
    return f"{len(names)} ({', '.join(names[:shown])}{dots})"


def _plain(name: str) -> str:
    return " ".join(name.lower().replace("_", " ").split())
