"""Rows collected for a second, then sent as columns: the one way this project writes to Rerun.

One `log` call costs 70 to 900 microseconds, a row of `send_columns` 4 to 11; and one chunk a second and
entity keeps the file small and quick to open. Nothing here remembers what has been sent.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from dssmsg.recording.schema import FRAME, ROW, SIM_TIME, UPDATE, Table


class _Column:
    """A finished Arrow list column, in the form `send_columns` takes."""

    def __init__(self, descriptor: rr.ComponentDescriptor, values: pa.Array) -> None:
        self._descriptor = descriptor
        self._values = values

    def component_descriptor(self) -> rr.ComponentDescriptor:
        return self._descriptor

    def as_arrow_array(self) -> pa.Array:
        return self._values


class Stamp:
    """When something happened, on every timeline it is to be found by.

    A frame below 0 means "before the first frame" and is filed under frame 0.
    """

    __slots__ = ("frame", "row", "sim_time", "update")

    def __init__(
        self, frame: int, sim_time: float, *, update: int | None = None, row: int | None = None
    ) -> None:
        self.frame = max(frame, 0)
        self.sim_time = max(sim_time, 0.0)
        self.update = update
        self.row = row


def time_columns(stamps: Sequence[Stamp]) -> list[rr.TimeColumn]:
    """The index columns of rows; `update` and `row` only where the first row has them."""
    columns = [
        rr.TimeColumn(FRAME, sequence=[stamp.frame for stamp in stamps]),
        rr.TimeColumn(SIM_TIME, duration=np.array([stamp.sim_time for stamp in stamps], dtype=np.float64)),
    ]
    if stamps[0].update is not None:
        columns.append(rr.TimeColumn(UPDATE, sequence=[stamp.update or 0 for stamp in stamps]))
    if stamps[0].row is not None:
        columns.append(rr.TimeColumn(ROW, sequence=[stamp.row or 0 for stamp in stamps]))
    return columns


class Sheet:
    """Rows of one table that wait to be sent. A cell is a value, a sequence of values, or None."""

    def __init__(self, table: Table) -> None:
        self._table = table
        self._stamps: list[Stamp] = []
        self._cells: dict[str, list[Sequence[Any]]] = {name: [] for name in table.columns}

    def add(self, stamp: Stamp, row: Mapping[str, Any]) -> None:
        """Append a row. Raises KeyError if it lacks a column of the table."""
        for name, cells in self._cells.items():
            value = row[name]
            if value is None:
                cells.append(())
            elif isinstance(value, (str, bytes)) or not isinstance(value, (Sequence, np.ndarray)):
                cells.append((value,))
            else:
                cells.append(value)
        self._stamps.append(stamp)

    def send(self, stream: rr.RecordingStream) -> None:
        """Send what has been collected, if anything, and forget it."""
        if not self._stamps:
            return
        columns = [
            _Column(
                rr.ComponentDescriptor(self._table.component(name), archetype=self._table.archetype),
                pa.array(self._cells[name], type=pa.list_(arrow_type)),
            )
            for name, arrow_type in self._table.columns.items()
        ]
        stream.send_columns(self._table.path, time_columns(self._stamps), columns, strict=True)
        self._stamps = []
        for cells in self._cells.values():
            cells.clear()


class LookSheet:
    """Rows of one archetype that wait to be sent, one value a row and field: images, poses, texts, plots."""

    def __init__(self, path: str, archetype: Any) -> None:
        self._path = path
        self._archetype = archetype
        self._stamps: list[Stamp] = []
        self._fields: dict[str, list[Any]] = {}

    def add(self, stamp: Stamp, **fields: Any) -> None:
        """Append a row; every row of a sheet gives the same fields."""
        for name, value in fields.items():
            self._fields.setdefault(name, []).append(value)
        self._stamps.append(stamp)

    def send(self, stream: rr.RecordingStream) -> None:
        """Send what has been collected, if anything, and forget it."""
        if not self._stamps:
            return
        columns: Iterable[Any] = self._archetype.columns(**self._fields)
        stream.send_columns(self._path, time_columns(self._stamps), columns, strict=True)
        self._stamps = []
        self._fields = {}
