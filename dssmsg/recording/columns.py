"""A table of a recording as Arrow columns: Python values are made only of what is asked for.

An hour's change log is 80 MB of JSON, of which most questions need a row in a hundred.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from dssmsg.errors import InputError
from dssmsg.recording.schema import FRAME, SIM_TIME, Table

_ROW_ID = "rerun.controls.RowId"

Filler = Callable[[Sequence[int]], Sequence[Any]]
"""The cells that a column has where an older file has none, from the frames of the rows."""


class ColumnTable:
    """The rows of one table, in the order of writing. A cell is a list: one value, several, or none."""

    def __init__(self, table: Table, batches: Sequence[pa.RecordBatch], shown_path: Path) -> None:
        self._table = table
        self._path = shown_path
        self._columns: dict[str, list[pa.ListArray]] = {name: [] for name in table.columns}
        self._filled: dict[str, list[list[Any]]] = {}
        self._batches = batches
        self._starts = [0]
        for batch in batches:
            if min(batch.schema.get_field_index(name) for name in (_ROW_ID, FRAME)) < 0:
                raise InputError(f"damaged: {table.path} has rows without a time", file=shown_path)
            self._starts.append(self._starts[-1] + batch.num_rows)
            found = {component_of(field): column for field, column in zip(batch.schema, batch, strict=True)}
            for name, kind in table.columns.items():
                self._columns[name].append(self._typed(name, found.get(table.component(name)), kind, batch))

    def __len__(self) -> int:
        return self._starts[-1]

    def cells(self, name: str) -> list[list[Any]]:
        """A whole column, each cell as a list."""
        if name in self._filled:
            return self._filled[name]
        found: list[list[Any]] = []
        for column in self._columns[name]:
            values, lengths = _flat(column)
            ends = accumulate(lengths)
            found += [values[end - length : end] for end, length in zip(ends, lengths, strict=True)]
        return self._ordered(found)

    def values(self, name: str) -> list[Any]:
        """The first value of each cell of a column, None where there is none."""
        if name in self._filled:
            return [cell[0] if cell else None for cell in self._filled[name]]
        found: list[Any] = []
        for column in self._columns[name]:
            values, lengths = _flat(column)
            ends = accumulate(lengths)
            found += [values[end - n] if n else None for end, n in zip(ends, lengths, strict=True)]
        return self._ordered(found)

    def stream(self, name: str) -> Iterator[Any]:
        """What `values` gives, one after the other: no more than a chunk of them is in Python's memory."""
        if name in self._filled or self._order is not None:
            yield from (self.value(name, row) for row in range(len(self)))
            return
        for column in self._columns[name]:
            values, lengths = _flat(column)
            for end, length in zip(accumulate(lengths), lengths, strict=True):
                yield values[end - length] if length else None

    def cell(self, name: str, row: int) -> list[Any]:
        """One cell of a row counted from 0."""
        if name in self._filled:
            return self._filled[name][row]
        place = row if self._order is None else self._order[row]
        number = bisect_right(self._starts, place) - 1
        cell: list[Any] | None = self._columns[name][number][place - self._starts[number]].as_py()
        return cell or []

    def value(self, name: str, row: int) -> Any:
        """The first value of a cell; None if it has none."""
        cell = self.cell(name, row)
        return cell[0] if cell else None

    def fill(self, name: str, filler: Filler) -> None:
        """Give a column of which no cell holds anything other cells, one a row."""
        if len(self) and not any(len(column.flatten()) for column in self._columns[name]):
            self._filled[name] = [[value] for value in filler(self.frames)]

    @cached_property
    def frames(self) -> Sequence[int]:
        """The frame of each row."""
        return self._ordered([frame for batch in self._batches for frame in batch.column(FRAME).to_pylist()])

    @cached_property
    def sim_times(self) -> Sequence[float]:
        """The sim time of each row, in seconds; NaN where the file does not say."""
        return self._ordered([second for batch in self._batches for second in _seconds(batch)])

    @cached_property
    def last_of_frame(self) -> Mapping[int, int]:
        """The last row of each frame, in the order of frames."""
        return dict(sorted({frame: row for row, frame in enumerate(self.frames)}.items()))

    @cached_property
    def _order(self) -> list[int] | None:
        """Places of the rows as they were written; None if they stand so. Chunks may overlap in time."""
        ids = [batch.column(_ROW_ID) for batch in self._batches if batch.num_rows]
        ends = [(column[0].as_py(), column[-1].as_py()) for column in ids]
        if all(before[1] <= after[0] for before, after in pairwise(ends)):
            return None  # within a chunk Rerun keeps them in order
        known = [row_id for column in ids for row_id in column.to_pylist()]
        return sorted(range(len(known)), key=known.__getitem__)

    def _ordered(self, found: list[Any]) -> list[Any]:
        return found if self._order is None else [found[place] for place in self._order]

    def _typed(self, name: str, column: Any, kind: Any, batch: pa.RecordBatch) -> pa.ListArray:
        wanted = pa.list_(kind)
        if column is None:
            return pa.nulls(batch.num_rows, wanted)
        if column.type == wanted:
            return column
        try:
            return column.cast(wanted)
        except pa.ArrowException as error:
            raise InputError(
                f"damaged: {self._table.path}, column {name}: expected {wanted}, got {column.type}",
                file=self._path,
            ) from error


def component_of(field: pa.Field) -> str | None:
    """The Rerun component identifier of a column; None for its times and ids."""
    name = (field.metadata or {}).get(b"rerun:component")
    return None if name is None else name.decode()


def _seconds(batch: pa.RecordBatch) -> list[float]:
    place = batch.schema.get_field_index(SIM_TIME)
    if place < 0 or not pa.types.is_duration(batch.column(place).type):
        return [math.nan] * batch.num_rows
    nanoseconds = batch.column(place).cast(pa.duration("ns")).cast(pa.int64())
    return [math.nan if value is None else value / 1e9 for value in nanoseconds.to_pylist()]


def _flat(column: pa.ListArray) -> tuple[list[Any], list[int]]:
    """All values of a list column in a row, and how many each cell has."""
    # Not pc.fill_null: making a scalar of 0 makes pyarrow import pandas, half a second.
    lengths = [length or 0 for length in pc.list_value_length(column).to_pylist()]
    return column.flatten().to_pylist(), lengths
