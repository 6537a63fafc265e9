"""Older versions of the schema, and how a file of one is read as if it were of the present one.

A step goes from one version to the next; a file goes through all steps from its own version on. Nothing is
written: rows and columns are completed as they are read. Not every file of a version lacks all that its step
completes, for a version lasts until a reader needs to tell it from the next.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dssmsg.errors import InputError
from dssmsg.recording import schema

if TYPE_CHECKING:
    from dssmsg.recording.columns import ColumnTable, Filler
    from dssmsg.recording.store import ChunkFile

Json = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Step:
    """From a version to the next."""

    version: int
    """The version that it starts from."""
    what: str
    """What is other in the next version."""
    rows: Mapping[str, Callable[[Json], Json]] = field(default_factory=dict)
    """Path of a table -> what to do with the JSON value of its rows."""
    columns: Mapping[tuple[str, str], Callable[[ChunkFile], Filler]] = field(default_factory=dict)
    """Path of a table and column -> the cells where no row has any."""


def _updates_before(file: ChunkFile) -> Filler:
    """How many changes the graph had gone through before each frame, counted from the change log."""
    changed = sorted(file.table(schema.GRAPH_LOG).frames)
    return lambda frames: [bisect_left(changed, frame) for frame in frames]


def _filled(filler: Callable[[ChunkFile], Filler], file: ChunkFile, frames: Sequence[int]) -> Sequence[Any]:
    return filler(file)(frames)


STEPS: Sequence[Step] = (
    Step(
        1,
        "the graph is stored now and then; every frame says how many changes were before it, every LLM call"
        " which attempt it was and for whom it stood in",
        rows={schema.LLM_CALLS.path: lambda row: {"attempt": 1, "fallback_for": "", **row}},
        columns={(schema.FRAMES.path, "updates"): _updates_before},
    ),
)
"""In order, one a version from the oldest that is read."""

OLDEST = STEPS[0].version


class Migrations:
    """What a file of some version goes through."""

    def __init__(self, version: int) -> None:
        self.version = version
        """The version of the file."""
        self._steps = [step for step in STEPS if step.version >= version]

    @classmethod
    def of(cls, version: Any, path: Path, written_by: str) -> Migrations:
        """For a version as it stands in a file; `written_by` is the dssmsg version that wrote it, if known.

        Raises InputError for a version that is not read, saying what to do.
        """
        if isinstance(version, int) and OLDEST <= version <= schema.SCHEMA_VERSION:
            return cls(version)
        writer = f"dssmsg {written_by}" if written_by else "the dssmsg that wrote it"
        newer = isinstance(version, int) and version > schema.SCHEMA_VERSION
        way_out = f"read it with {writer} or a later one" if newer else f"read it with {writer}"
        raise InputError(
            f"has schema version {str(version)[:40]}; this dssmsg reads versions {OLDEST} to"
            f" {schema.SCHEMA_VERSION}: {way_out}",
            file=path,
        )

    def row(self, table: schema.Table, row: Json) -> Json:
        """The JSON value of a row, brought up to the present version."""
        for step in self._steps:
            if table.path in step.rows:
                row = step.rows[table.path](row)
        return row

    def complete(self, table: ColumnTable, path: str, file: ChunkFile) -> None:
        """Fill the columns of a table that its version did not have yet."""
        for step in self._steps:
            for (place, column), filler in step.columns.items():
                if place == path:
                    table.fill(column, partial(_filled, filler, file))
