"""Recordings made wrong on purpose: a good one with some values replaced, or without some entities."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
from rerun.chunk import Chunk, ChunkStore, RrdReader

Cell = Callable[[Any], Any]


def rewritten(source: Path, target: Path, path: str, component: str, edit: Cell, kind: Any = None) -> None:
    """A finished recording like `source`, each value of a component edited; `kind`: of another Arrow type."""
    reader = RrdReader(source)
    (entry,) = reader.recordings()
    chunks: list[Chunk] = []
    for chunk in reader.store(store=entry).stream():
        batch = chunk.to_record_batch() if chunk.entity_path == path else None
        names = (
            [] if batch is None else [(f.metadata or {}).get(b"rerun:component", b"") for f in batch.schema]
        )
        if batch is None or component.encode() not in names:
            chunks.append(chunk)
            continue
        place = names.index(component.encode())
        field = batch.schema.field(place)
        cells = [
            None if cell is None else [edit(one) for one in cell] for cell in batch.column(place).to_pylist()
        ]
        values = pa.array(cells, type=field.type if kind is None else pa.list_(kind))
        schema = batch.schema.set(place, pa.field(field.name, values.type, metadata=field.metadata))
        columns = [values if number == place else batch.column(number) for number in range(batch.num_columns)]
        edited = pa.RecordBatch.from_arrays(columns, schema=schema)
        chunks += Chunk.from_record_batch(edited)
    ChunkStore.from_chunks(chunks).write_rrd(
        target, application_id=entry.application_id, recording_id=entry.recording_id
    )


def without(source: Path, target: Path, *paths: str) -> None:
    """A finished recording like `source` that lacks some entities."""
    reader = RrdReader(source)
    (entry,) = reader.recordings()
    stream = reader.store(store=entry).stream().drop(content=list(paths))
    stream.write_rrd(target, application_id=entry.application_id, recording_id=entry.recording_id)


def with_json(**values: Any) -> Cell:
    """Edits a JSON object: these keys get these values; one that is `...` is taken away."""

    def edit(text: str) -> str:
        row = {**json.loads(text), **values}
        return json.dumps({name: value for name, value in row.items() if value is not ...})

    return edit


def bomb(depth: int = 100_000) -> str:
    """JSON nested far too deeply, in a few bytes a level."""
    return '{"a":' * depth + "1" + "}" * depth
