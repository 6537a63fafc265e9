"""Tables and images of an `.rrd` file: the only place that reads Rerun's chunks.

Entities are loaded on first use and kept, in Arrow memory. Needs rerun-sdk and pyarrow, nothing of the
simulator.
"""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa

from dssmsg.errors import InputError
from dssmsg.recording.columns import ColumnTable, component_of
from dssmsg.recording.migrations import Migrations
from dssmsg.recording.schema import FRAME, Table

_KEPT_BYTES = 256_000_000


class ChunkFile:
    """A finished recording. Raises InputError where the file does not read."""

    def __init__(self, path: Path, shown_path: Path) -> None:
        from rerun.chunk import RrdReader

        self.path = path
        self._shown_path = shown_path
        with self._rerun("not a recording that this version reads"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Rerun warns of what its exceptions say anyway
            reader = RrdReader(path)
            recordings = reader.recordings()
            if not recordings:
                raise InputError("holds no recording, at most a viewer layout", file=shown_path)
            self._store = reader.store(store=recordings[0])
        self.application_id: str = recordings[0].application_id
        self.recording_id: str = recordings[0].recording_id
        self.migrations: Migrations | None = None
        """What the tables go through as they are read; set by who knows the file's version."""
        self._tables: dict[str, ColumnTable] = {}
        self._blobs: dict[str, _BlobColumn] = {}

    def table(self, table: Table) -> ColumnTable:
        """The rows of a table; without rows where the file has none of it."""
        if table.path not in self._tables:
            read = ColumnTable(table, list(self._batches(table.path)), self._shown_path)
            if self.migrations is not None:
                self.migrations.complete(read, table.path, self)
            self._tables[table.path] = read
        return self._tables[table.path]

    def chunks(self, table: Table) -> Iterator[ColumnTable]:
        """The rows of a table chunk by chunk, in the order of the file; nothing is kept in memory."""
        for batch in self._batches(table.path):
            yield ColumnTable(table, [batch], self._shown_path)

    def property(self, name: str) -> Mapping[str, Any]:
        """A group of run properties: name -> value (the first, if several); empty if there is none."""
        values: dict[str, Any] = {}
        for batch in self._batches(f"/__properties/{name}"):
            for field, column in zip(batch.schema, batch.columns, strict=True):
                component = component_of(field)
                if component and batch.num_rows:
                    cell = column[batch.num_rows - 1].as_py()
                    if isinstance(cell, list) and cell:
                        values[component] = cell[0]
        return values

    def blob(self, path: str, component: str, frame: int) -> bytes | None:
        """The bytes that an entity's component holds at exactly this frame; None if there are none."""
        if path not in self._blobs:
            self._blobs[path] = _BlobColumn(partial(self._batches, path), component)
        return self._blobs[path].get(frame)

    def frames_of(self, path: str, component: str) -> frozenset[int]:
        """The frames at which an entity's component has a row; nothing is kept in memory."""
        frames: set[int] = set()
        for batch in self._batches(path):
            column = batch.schema.get_field_index(FRAME)
            if column >= 0 and component in [component_of(field) for field in batch.schema]:
                frames.update(batch.column(column).to_pylist())
        return frozenset(frames)

    def _batches(self, path: str) -> Iterator[pa.RecordBatch]:
        with self._rerun(f"damaged: {path} does not read"):
            for chunk in self._store.stream().filter(content=path):
                yield chunk.to_record_batch()

    @contextmanager
    def _rerun(self, problem: str) -> Iterator[None]:
        """Turn what Rerun's reader raises over damaged bytes into an InputError that names the file."""
        try:
            yield
        except (RuntimeError, ValueError, OSError, pa.ArrowException) as error:
            raise InputError(f"{problem} ({error})", file=self._shown_path) from error
        except BaseException as error:
            # A Rust panic is no Exception; the reader may be in any state after it, this process is not.
            if type(error).__name__ != "PanicException":
                raise
            raise InputError(f"{problem} ({error})", file=self._shown_path) from None


class _BlobColumn:
    """One binary value a frame, found by frame index.

    Chunks are read in the order of the file, which is about that of time, and as many of the latest kept as
    fit `_KEPT_BYTES`: a run of minutes is in memory once, of an hour's images only what was asked for lately.
    """

    def __init__(self, batches: Callable[[], Iterator[pa.RecordBatch]], component: str) -> None:
        self._batches = batches
        self._component = component
        self._kept: OrderedDict[int, tuple[dict[int, int], pa.ListArray]] = OrderedDict()
        self._kept_bytes = 0
        self._chunk_of: dict[int, int] = {}  # of every frame met so far, those too whose chunk is forgotten
        self._all_met = False
        self._restart()

    def get(self, frame: int) -> bytes | None:
        """The bytes of a frame; None if it has none."""
        number = self._chunk_of.get(frame)
        if number not in self._kept:
            if number is None and self._all_met:
                return None
            if number is not None and number < self._next:
                self._restart()
            number = self._read_on(frame)
        return None if number is None else self._bytes(number, frame)

    def _restart(self) -> None:
        self._rest = self._batches()
        self._next = 0

    def _read_on(self, frame: int) -> int | None:
        """Read until the chunk of a frame comes; its number, None if it does not."""
        for batch in self._rest:
            number = self._next
            self._next += 1
            if frame in self._keep(number, batch):
                return number
        self._all_met = True
        self._restart()
        return None

    def _keep(self, number: int, batch: pa.RecordBatch) -> Mapping[int, int]:
        names = [component_of(field) for field in batch.schema]
        times = batch.schema.get_field_index(FRAME)
        if self._component not in names or times < 0:
            return {}
        rows = {frame: row for row, frame in enumerate(batch.column(times).to_pylist())}
        self._chunk_of |= dict.fromkeys(rows, number)
        column = batch.column(names.index(self._component))
        if number not in self._kept:
            self._kept_bytes += column.nbytes
        self._kept[number] = (rows, column)
        while self._kept_bytes > _KEPT_BYTES and len(self._kept) > 1:
            self._kept_bytes -= self._kept.popitem(last=False)[1][1].nbytes
        return rows

    def _bytes(self, number: int, frame: int) -> bytes | None:
        self._kept.move_to_end(number)
        rows, column = self._kept[number]
        cell = column[rows[frame]].values
        if cell is None or len(cell) == 0:
            return None
        first = cell[0]
        if isinstance(first, (pa.BinaryScalar, pa.LargeBinaryScalar)):
            data: bytes = first.as_py()
            return data
        return bytes(first.values.to_numpy(zero_copy_only=True))
