"""Tables and images of an `.rrd` file: the only place that reads Rerun's chunks.

Entities are loaded on first use and kept, in Arrow memory. Needs rerun-sdk and pyarrow, nothing of the
simulator.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import pyarrow as pa

from dssmsg.errors import InputError
from dssmsg.recording import schema
from dssmsg.recording.blob_column import BlobColumn, IndexedBlobs, frames_of_rows, texts_of_rows
from dssmsg.recording.chunk_index import ChunkIndex, Place
from dssmsg.recording.columns import ColumnTable, component_of
from dssmsg.recording.migrations import Migrations
from dssmsg.recording.schema import FRAME, Table

_KEPT_BLOBS_BYTES = 96_000_000
"""What the graph refers to is asked for in about the order of time, so that little needs to be kept."""


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
                raise InputError(
                    "holds no recording, at most a viewer layout, or was cut off before the run began",
                    file=shown_path,
                )
            self._store = reader.store(store=recordings[0])
        self.application_id: str = recordings[0].application_id
        self.recording_id: str = recordings[0].recording_id
        self.migrations: Migrations | None = None
        """What the tables go through as they are read; set by who knows the file's version."""
        self._tables: dict[str, ColumnTable] = {}
        self._blobs: dict[str, BlobColumn[int]] = {}

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
            self._blobs[path] = self._blobs_of(path, component)
        return self._blobs[path].get(frame)

    def _blobs_of(self, path: str, component: str) -> BlobColumn[int]:
        batches, index = partial(self._batches, path), self._index
        if index is None:
            return BlobColumn(batches, component, frames_of_rows)

        def read(places: Sequence[Place]) -> list[pa.RecordBatch]:
            with self._rerun(f"damaged: {path} does not read"):
                return index.read(places)

        return IndexedBlobs(index.places(path), component, read)

    @cached_property
    def last_frame(self) -> int | None:
        """The last frame of which there is anything; None where the file's index does not say."""
        return None if self._index is None else self._index.last_frame

    @cached_property
    def _index(self) -> ChunkIndex | None:
        return ChunkIndex.of(self.path, self._store)

    def blobs(self) -> BlobColumn[str]:
        """The bytes of `/blobs`, by hash."""
        table = schema.BLOBS
        return BlobColumn(
            partial(self._batches, table.path),
            table.component("data"),
            partial(texts_of_rows, table.component("hash")),
            keeps_bytes=_KEPT_BLOBS_BYTES,
        )

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
