"""What the viewer shows of viewpoint windows: who was seen in which frame, and the pictures of a verdict."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import rerun as rr

from dssmsg import events
from dssmsg.graph.ids import id_order
from dssmsg.graph.verdicts import MISSED, OCCLUDED, OUT_OF_RANGE, OUT_OF_VIEW, PRESENT, SEEN, UNKNOWN
from dssmsg.graph.view import GraphView
from dssmsg.recording import schema
from dssmsg.recording.sheets import SheetBook, Stamp

_LENGTH = 8
"""Frames that a viewpoint's table shows."""
_PICTURES = 3
"""Every so many frames of a viewpoint keep their picture, to be shown beside a later one."""
_WORDS = {
    SEEN: "seen",
    PRESENT: "present",
    MISSED: "**missed**",
    OCCLUDED: "hidden",
    OUT_OF_RANGE: "too far",
    OUT_OF_VIEW: "out of view",
    UNKNOWN: "unknown",
}


@dataclass(slots=True)
class _Memory:
    """What is kept of a viewpoint: evidence by frame, and some frames' pictures."""

    columns: deque[tuple[int, dict[str, str]]] = field(default_factory=lambda: deque(maxlen=_LENGTH))
    pictures: deque[tuple[int, bytes]] = field(default_factory=lambda: deque(maxlen=_LENGTH // _PICTURES + 1))
    frames: int = 0


class WindowLog:
    """Logs `/window`, a table of objects by frames, and two pictures with each verdict."""

    def __init__(self, book: SheetBook) -> None:
        self._book = book
        self._memory: dict[str, _Memory] = {}

    def add(self, event: events.WindowEvaluated, stamp: Stamp, graph: GraphView, picture: bytes) -> None:
        """Show one evaluation; `picture` is the encoded colour image of its frame."""
        memory = self._memory.setdefault(event.viewpoint_id, _Memory())
        now = {e.object_id: e.verdict for e in event.evidence if e.frame == event.frame}
        memory.columns.append((event.frame, now))
        text = self._table(event, memory, graph)
        self._book.look(schema.WINDOW_TEXT, rr.TextDocument, stamp, text=text, media_type="text/markdown")
        if event.verdicts:
            before = self._before(event, memory, graph)
            if before is None:
                self._book.log_now(schema.WINDOW_BEFORE, stamp, rr.Clear(recursive=False))
            else:
                self._book.look(schema.WINDOW_BEFORE, rr.EncodedImage, stamp, blob=before)
            self._book.look(schema.WINDOW_NOW, rr.EncodedImage, stamp, blob=picture)
        if memory.frames % _PICTURES == 0:
            memory.pictures.append((event.frame, picture))
        memory.frames += 1

    def _before(self, event: events.WindowEvaluated, memory: _Memory, graph: GraphView) -> bytes | None:
        """An earlier picture: of this viewpoint, else of the last that saw an object of the verdict."""
        for frame, blob in reversed(memory.pictures):
            if frame in event.comparison:
                return blob
        if memory.pictures:
            return memory.pictures[0][1]
        for object_id in event.verdicts:
            node = graph.objects.get(object_id)
            for viewpoint in reversed(node.viewpoints if node is not None else ()):
                other = self._memory.get(viewpoint)
                if other is not None and other.pictures:
                    return other.pictures[-1][1]
        return None

    def _table(self, event: events.WindowEvaluated, memory: _Memory, graph: GraphView) -> str:
        newest_first = list(reversed(memory.columns))  # a narrow view cuts a table at its right
        frames = [frame for frame, _ in newest_first]
        ids = sorted(
            {i for _, column in newest_first for i in column},
            key=lambda i: (self._rank(i, event, memory), id_order(i)),
        )
        lines = [f"## {event.viewpoint_id}, frame {event.frame}", ""]
        for object_id, verdict in event.verdicts.items():
            lines.append(
                f"- **{self._named(object_id, graph)}: {verdict}** ({event.threshold} frames needed)"
            )
        lines += ["", "| object | " + " | ".join(_head(frame, event) for frame in frames) + " |"]
        lines.append("|---" * (1 + len(frames)) + "|")
        for object_id in ids:
            cells = [_WORDS.get(column.get(object_id, ""), "") for _, column in newest_first]
            lines.append(f"| {self._named(object_id, graph)} | " + " | ".join(cells) + " |")
        return "\n".join(lines) + "\n"

    def _rank(self, object_id: str, event: events.WindowEvaluated, memory: _Memory) -> int:
        """What matters stands above: judged, then missed, then seen; last what could not have been seen."""
        if object_id in event.verdicts:
            return 0
        found = {column.get(object_id) for _, column in memory.columns}
        return 1 if MISSED in found else 2 if found & {SEEN, PRESENT} else 3

    def _named(self, object_id: str, graph: GraphView) -> str:
        node = graph.objects.get(object_id)
        return object_id if node is None else f"{node.label} ({object_id})"


def _head(frame: int, event: events.WindowEvaluated) -> str:
    role = "base" if frame in event.base else "comparison" if frame in event.comparison else ""
    return f"{frame} {role}".rstrip()
