"""Where in a finished file the chunks of an entity lie: one is read without those before it.

Rerun's own stream reads an entity from its first chunk on; of an hour's depth images that is a gigabyte
before the first late one. Its index knows better, but it has no public way to read a single chunk: so the
chunk's message is copied into a small file of its own, which Rerun reads.
"""

from __future__ import annotations

import tempfile
import threading
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import pyarrow as pa

from dssmsg.recording.messages import MessagePicker
from dssmsg.recording.schema import FRAME

_COLUMNS = ("chunk_entity_path", "chunk_byte_offset", "chunk_byte_size", f"{FRAME}:start", f"{FRAME}:end")

_ONE_AT_A_TIME = threading.Lock()
"""Filters of warnings are the process's: a replay and its writer must not change them at once."""


@dataclass(frozen=True, slots=True)
class Place:
    """A chunk: its number in the index, where its message is, and the frames between which its rows lie."""

    number: int
    offset: int
    size: int
    first: int
    last: int


class ChunkIndex:
    """The chunks of a file by entity."""

    def __init__(self, path: Path, batch: pa.RecordBatch) -> None:
        paths, offsets, sizes, firsts, lasts = (batch.column(name).to_pylist() for name in _COLUMNS)
        self._picker = MessagePicker(path, min(offsets))
        self._places: dict[str, list[Place]] = {}
        rows = zip(paths, offsets, sizes, firsts, lasts, strict=True)
        for number, (entity, offset, size, first, last) in enumerate(rows):
            if first is not None and last is not None:
                self._places.setdefault(entity, []).append(Place(number, offset, size, first, last))

    @classmethod
    def of(cls, path: Path, store: Any) -> Self | None:
        """The index of a file; None where this version of Rerun does not tell it."""
        try:
            batch = store._chunk_index().to_arrow()
        except AttributeError:
            return None
        whole = set(batch.schema.names).issuperset(_COLUMNS)
        return cls(path, batch) if whole and batch.num_rows else None

    @property
    def last_frame(self) -> int | None:
        """The last frame of any chunk."""
        return max((place.last for places in self._places.values() for place in places), default=None)

    def places(self, entity: str) -> Sequence[Place]:
        """The chunks of an entity that have times."""
        return self._places.get(entity, ())

    def read(self, places: Sequence[Place]) -> list[pa.RecordBatch]:
        """The rows of chunks, in any order, without those that are there no more. Raises what Rerun raises.

        A small file for several costs little more than for one.
        """
        alone = chunks_alone(self._picker, [(place.offset, place.size) for place in places])
        return [chunk.to_record_batch() for chunk in alone]


def chunks_alone(picker: MessagePicker, spans: Sequence[tuple[int, int]]) -> list[Any]:
    """The chunks (Rerun's) of single messages of a file, in any order. Raises what Rerun raises."""
    from rerun.chunk import RrdReader

    with tempfile.TemporaryDirectory(prefix="dssmsg-") as folder:
        file = Path(folder) / "chunks.rrd"
        file.write_bytes(picker.alone(spans))
        with _ONE_AT_A_TIME, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that the small file has no index
            reader = RrdReader(file)
        return list(reader.stream())
