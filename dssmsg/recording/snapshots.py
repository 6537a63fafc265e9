"""The whole graph, stored now and then, so that a question about a late time need not fold from the start.

A snapshot is nothing but the fold of all changes before it (`SceneGraph.fold`), which stays the truth: tests
compare the two, and a recording without snapshots says the same, only later.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import Any

from dssmsg.graph import codec
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.recording.columns import ColumnTable
from dssmsg.recording.damage import json_object

EVERY_UPDATES = 4000
"""Changes between two snapshots: they fold in a second, and fill ten times a snapshot."""

_LEVEL = 1  # of zlib; points hardly shrink further
_MAX_BYTES = 1_000_000_000


class SnapshotKeeper:
    """Decides when a graph is due to be stored."""

    def __init__(self) -> None:
        self._last = 0
        self._frame = 0

    def row(self, graph: SceneGraph, frame: int) -> dict[str, Any] | None:
        """A row of `/graph_snapshots` after the changes of a frame, if one is due; else None."""
        self._frame = max(self._frame, frame)
        if graph.updates - self._last < EVERY_UPDATES:
            return None
        self._last = graph.updates
        text = codec.canonical_json(codec.graph_to_json(graph))
        return {
            "updates": graph.updates,
            "frame": self._frame,
            "graph": zlib.compress(text.encode(), _LEVEL),
        }


def latest(
    chunks: Iterable[ColumnTable], *, frame: int | None, update: int | None, readable: int
) -> SceneGraph | None:
    """The last stored graph that is not later than a frame, an update and what can be read; None without one.

    `chunks` of the table come one at a time, for a graph has megabytes. Raises ValueError, zlib.error or
    InputError for one that is damaged.
    """
    limit = readable if update is None else min(update, readable)
    best, packed = 0, b""
    for table in chunks:
        for row, (number, last) in enumerate(
            zip(table.values("updates"), table.values("frame"), strict=True)
        ):
            if best < number <= limit and (frame is None or last <= frame):
                best, packed = number, table.value("graph", row)
    if not best:
        return None
    unpack = zlib.decompressobj()
    data = unpack.decompress(packed, _MAX_BYTES)
    if unpack.unconsumed_tail:
        raise ValueError(f"expected a graph of at most {_MAX_BYTES} bytes")
    graph = codec.graph_from_json(json_object(data.decode()))
    if graph.updates != best:
        raise ValueError(f"expected the graph of update {best}, got that of {graph.updates}")
    return graph
