"""Tables and images of an `.rrd` file as Python values: the only place that reads Rerun's chunks.

Entities are loaded on first use and kept. Needs rerun-sdk and pyarrow, nothing of the simulator.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from dssmsg.errors import InputError
from dssmsg.recording.schema import FRAME, Table

_ROW_ID = "rerun.controls.RowId"


class ChunkFile:
    """A finished recording. Raises InputError where the file does not read."""

    def __init__(self, path: Path, shown_path: Path) -> None:
        from rerun.chunk import RrdReader

        self.path = path
        self._shown_path = shown_path
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # Rerun warns of what its exceptions say anyway
                reader = RrdReader(path)
                recordings = reader.recordings()
                if not recordings:
                    raise InputError("holds no recording, at most a viewer layout", file=shown_path)
                self._store = reader.store(store=recordings[0])
        except RuntimeError as error:
            raise InputError(f"not a recording that this version reads ({error})", file=shown_path) from error
        self.application_id: str = recordings[0].application_id
        self.recording_id: str = recordings[0].recording_id
        self._rows: dict[str, list[tuple[int, dict[str, Any]]]] = {}
        self._blobs: dict[str, _BlobColumn] = {}

    def rows(self, table: Table) -> Sequence[Mapping[str, Any]]:
        """The rows of a table in the order of writing: column -> list of values, empty where missing."""
        return [row for _, row in self._framed_rows(table)]

    def rows_by_frame(self, table: Table) -> Mapping[int, Mapping[str, Any]]:
        """The last row of each frame, in the order of frames."""
        return dict(sorted(dict(self._framed_rows(table)).items()))

    def _framed_rows(self, table: Table) -> list[tuple[int, dict[str, Any]]]:
        if table.path not in self._rows:
            found = sorted(self._read(table), key=lambda item: item[0])
            self._rows[table.path] = [(frame, row) for _, frame, row in found]
        return self._rows[table.path]

    def property(self, name: str) -> Mapping[str, Any]:
        """A group of run properties: name -> value (the first, if several); empty if there is none."""
        values: dict[str, Any] = {}
        for batch in self._batches(f"/__properties/{name}"):
            for field, column in zip(batch.schema, batch.columns, strict=True):
                component = _component(field)
                if component and batch.num_rows:
                    cell = column[batch.num_rows - 1].as_py()
                    if cell:
                        values[component] = cell[0]
        return values

    def blob(self, path: str, component: str, frame: int) -> bytes | None:
        """The bytes that an entity's component holds at exactly this frame; None if there are none."""
        if path not in self._blobs:
            self._blobs[path] = _BlobColumn(list(self._batches(path)), component)
        return self._blobs[path].get(frame)

    def frames_of(self, path: str, component: str) -> frozenset[int]:
        """The frames at which an entity's component has a row; nothing is kept in memory."""
        frames: set[int] = set()
        for batch in self._batches(path):
            column = batch.schema.get_field_index(FRAME)
            if column >= 0 and component in [_component(field) for field in batch.schema]:
                frames.update(batch.column(column).to_pylist())
        return frozenset(frames)

    def _read(self, table: Table) -> Iterator[tuple[bytes, int, dict[str, Any]]]:
        components = {table.component(name): name for name in table.columns}
        for batch in self._batches(table.path):
            places = [batch.schema.get_field_index(name) for name in (_ROW_ID, FRAME)]
            if min(places) < 0:
                raise InputError(f"damaged: {table.path} has rows without a time", file=self._shown_path)
            ids, frames = (batch.column(place).to_pylist() for place in places)
            cells: dict[str, list[Any]] = {name: [[]] * batch.num_rows for name in table.columns}
            for field, column in zip(batch.schema, batch.columns, strict=True):
                name = components.get(_component(field) or "")
                if name is not None:
                    cells[name] = [cell or [] for cell in column.to_pylist()]
            for number, (row_id, frame) in enumerate(zip(ids, frames, strict=True)):
                yield row_id, frame, {name: column[number] for name, column in cells.items()}

    def _batches(self, path: str) -> Iterator[pa.RecordBatch]:
        try:
            for chunk in self._store.stream().filter(content=path):
                yield chunk.to_record_batch()
        except RuntimeError as error:
            raise InputError(f"damaged: {path} does not read ({error})", file=self._shown_path) from error


class _BlobColumn:
    """One binary value a frame, in Arrow memory; found by frame index."""

    def __init__(self, batches: Sequence[pa.RecordBatch], component: str) -> None:
        self._columns: list[pa.ListArray] = []
        self._places: dict[int, tuple[int, int]] = {}
        for batch in batches:
            names = [_component(field) for field in batch.schema]
            frames = batch.schema.get_field_index(FRAME)
            if component not in names or frames < 0:
                continue
            number = len(self._columns)
            self._columns.append(batch.column(names.index(component)))
            for row, frame in enumerate(batch.column(frames).to_pylist()):
                self._places[frame] = (number, row)

    def get(self, frame: int) -> bytes | None:
        place = self._places.get(frame)
        if place is None:
            return None
        cell = self._columns[place[0]][place[1]].values
        if cell is None or len(cell) == 0:
            return None
        first = cell[0]
        if isinstance(first, (pa.BinaryScalar, pa.LargeBinaryScalar)):
            data: bytes = first.as_py()
            return data
        return bytes(first.values.to_numpy(zero_copy_only=True))


def _component(field: pa.Field) -> str | None:
    metadata = field.metadata or {}
    name = metadata.get(b"rerun:component")
    return None if name is None else name.decode()
