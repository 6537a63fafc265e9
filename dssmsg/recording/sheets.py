"""Rows collected for a second, then sent as columns: the one way this project writes to Rerun.

One `log` call costs 70 to 900 microseconds, a row of `send_columns` 4 to 11; and one chunk a second and
entity keeps the file small and quick to open. Nothing here remembers what has been sent.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from dssmsg.recording.schema import BLOBS, FRAME, PLOTS, ROW, SIM_TIME, TABLES, UPDATE, Table

_REMEMBERED_BLOBS = 8192  # a blob forgotten and met again is written twice, which harms nobody

Colour = tuple[int, int, int]


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
        self._cells: dict[str, list[Any]] = {name: [] for name in table.columns}

    def add(self, stamp: Stamp, row: Mapping[str, Any]) -> None:
        """Append a row. Raises KeyError if it lacks a column of the table."""
        for name, cells in self._cells.items():
            value = row[name]
            if value is None:
                cells.append(())
            elif isinstance(value, str | bytes) or not isinstance(value, Sequence | np.ndarray):
                cells.append((value,))
            else:
                cells.append(value)
        self._stamps.append(stamp)

    def send(self, stream: rr.RecordingStream) -> None:
        """Send what has been collected, if anything, and forget it."""
        if not self._stamps:
            return
        columns: list[Any] = [
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


class SheetBook:
    """All sheets of one recording, and the few things that are logged at once."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._sheets = {table.path: Sheet(table) for table in TABLES}
        self._looks: dict[str, LookSheet] = {}
        self._seen_blobs: OrderedDict[str, None] = OrderedDict()

    def add(self, table: Table, stamp: Stamp, row: Mapping[str, Any]) -> None:
        """Append a row to a table."""
        self._sheets[table.path].add(stamp, row)

    def add_blobs(self, stamp: Stamp, blobs: Mapping[str, bytes]) -> None:
        """Append blobs by hash, those left out that were met lately."""
        for name, data in blobs.items():
            if name in self._seen_blobs:
                self._seen_blobs.move_to_end(name)
                continue
            self._seen_blobs[name] = None
            if len(self._seen_blobs) > _REMEMBERED_BLOBS:
                self._seen_blobs.popitem(last=False)
            self.add(BLOBS, stamp, {"hash": name, "data": data})

    def look(self, path: str, archetype: Any, stamp: Stamp, **fields: Any) -> None:
        """Append a row of an archetype to an entity, for the viewer."""
        sheet = self._looks.get(path)
        if sheet is None:
            sheet = self._looks[path] = LookSheet(path, archetype)
        sheet.add(stamp, **fields)

    def text(self, path: str, stamp: Stamp, text: str, level: str, colour: Colour | None = None) -> None:
        """Append a line to a text log; without a colour in the viewer's own, which suits its theme.

        The lines of one log all have a colour, or none has.
        """
        fields = {} if colour is None else {"color": colour}
        self.look(path, rr.TextLog, stamp, text=text, level=level, **fields)

    def plot(self, name: str, stamp: Stamp, value: float) -> None:
        """Append a point to a plot, named by its path below `/plots`."""
        self.look(f"{PLOTS}/{path_part(name)}", rr.Scalars, stamp, scalars=float(value))

    def log_now(self, path: str, stamp: Stamp | None, *parts: Any) -> None:
        """Log archetypes that come seldom, or of many values; without a stamp: once and for ever."""
        if stamp is not None:
            self._stream.set_time(FRAME, sequence=stamp.frame)
            self._stream.set_time(SIM_TIME, duration=stamp.sim_time)
        self._stream.log(path, *parts, static=stamp is None, strict=True)

    def send(self) -> None:
        """Send all rows."""
        for sheet in self._sheets.values():
            sheet.send(self._stream)
        for look in self._looks.values():
            look.send(self._stream)


def path_part(text: str) -> str:
    """A text as one or more plain parts of an entity path."""
    return "".join(char if char.isalnum() or char in "_-/" else "_" for char in text) or "_"
