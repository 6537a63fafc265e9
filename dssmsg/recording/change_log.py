"""The change log of a recording: the changes of the graph, and the graph folded from them at any time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

from dssmsg.errors import InputError
from dssmsg.graph import codec
from dssmsg.graph.changes import Change
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.recording import schema, snapshots
from dssmsg.recording.damage import json_value, reading
from dssmsg.recording.frame_table import FrameTable
from dssmsg.recording.store import ChunkFile

Json = dict[str, Any]


class ChangeLog:
    """Changes by their numbers, from 1. Raises InputError, naming the file, where one is damaged."""

    def __init__(
        self,
        file: ChunkFile,
        path: Path,
        frames: FrameTable,
        blobs: Mapping[str, bytes],
        *,
        whole: bool,
        told: int,
    ) -> None:
        self._table = file.table(schema.GRAPH_LOG)
        self._file = file
        self._path = path
        self._frames = frames
        self._blobs = blobs
        self._whole = whole
        self._told = told

    @cached_property
    def readable(self) -> int:
        """How many changes can be folded: from the first on, without a gap, with all their arrays."""
        if self._whole:
            return len(self._table)
        for number, text in enumerate(self._table.stream("json")):
            try:
                change = codec.decode(json_value(text), self._blobs)
            except (InputError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
                return number
            if change.update != number + 1:
                return number
        return len(self._table)

    @cached_property
    def recorded(self) -> int:
        """How many changes there were, as far as anything that is left of the recording tells."""
        if self._whole:
            return self.readable
        known = [self.readable, len(self._table), self._told, *(before for _, before in self._updates_before)]
        if len(self._table):
            with reading(self._path, "the changes"):
                known.append(int(self._row(len(self._table) - 1)["update"]))
        return max(known)

    @cached_property
    def last_known_frame(self) -> int | None:
        """The last frame after which the graph is known; None if it is not even known after the first.

        The last frame of all, but for a recording that was cut off.
        """
        indices = list(self._frames.facts)
        last = indices[-1] if indices else None
        if self.readable >= self.recorded:
            return last
        if self.readable < len(self._table):
            with reading(self._path, "the changes"):
                cut = int(self._row(self.readable)["frame"])
        else:
            # A frame whose successor knows of more changes has some that are lost.
            cut = last if last is not None else 0
        for (index, _), (_, after) in pairwise(self._updates_before):
            if after > self.readable:
                cut = min(cut, index)
                break
        return max((index for index in indices if index < cut), default=None)

    def rows(
        self, *, about: Collection[str] = (), kinds: Collection[str] = (), after: int = 0
    ) -> Iterator[Json]:
        """The JSON rows of changes, arrays as hashes; see `changes` for what is chosen."""
        with reading(self._path, "the changes"):
            if not (about or kinds or after):
                yield from (json_value(text) for text in self.texts())
                return
            for place in self._chosen(about, kinds, after):
                yield self._row(place)

    def texts(self) -> Iterator[str]:
        """The JSON of every change that can be folded, as it is stored."""
        return islice(self._table.stream("json"), self.readable)

    def changes(
        self, *, about: Collection[str] = (), kinds: Collection[str] = (), after: int = 0
    ) -> Iterator[Change]:
        """Changes in the order of application, with their arrays; all, or only some of them.

        `about`: those that have one of these ids among their subjects. `kinds`: those of these kinds.
        `after`: those with a greater number. Nothing is decoded of the others.
        """
        with reading(self._path, "the changes"):
            for row in self.rows(about=about, kinds=kinds, after=after):
                yield codec.decode(row, self._blobs)

    def counts(self) -> dict[str, int]:
        """How many changes of each kind can be folded, kinds sorted."""
        return dict(sorted(Counter(self._kinds[: self.readable]).items()))

    def graph_at(self, frame: int | None = None, *, update: int | None = None) -> SceneGraph:
        """The graph after a frame (its changes included), after an update, or, with neither, at the end.

        Folded from the last snapshot before, if there is one. Raises InputError if both are given, or the
        changes until then were cut off.
        """
        if frame is not None and update is not None:
            raise InputError("give a frame or an update, not both", file=self._path)
        self._check_known(frame, update)
        with reading(self._path, "a stored graph"):
            stored = self._file.chunks(schema.SNAPSHOTS)
            graph = snapshots.latest(stored, frame=frame, update=update, readable=self.readable)
        graph = graph or SceneGraph()
        with reading(self._path, "the changes do not fold"):
            for change in self.changes(after=graph.updates):
                if frame is not None and change.frame > frame:
                    break
                if update is not None and change.update > update:
                    break
                graph.apply(change)
        return graph

    def frame_of_update(self, update: int) -> int | None:
        """The frame in which an update happened; None if there was no such update."""
        if not 1 <= update <= self.readable:
            return None
        with reading(self._path, "the changes"):
            return int(self._row(update - 1)["frame"])

    def note(self) -> str | None:
        """What of the changes was cut off, in words; None if nothing was."""
        if self.readable >= self.recorded:
            return None
        count = f"{self.readable} of at least {self.recorded} changes can be read"
        return f"{count}: the graph is known {self._until}"

    @property
    def _until(self) -> str:
        known = self.last_known_frame
        return "at no frame" if known is None else f"until frame {known}"

    def _check_known(self, frame: int | None, update: int | None) -> None:
        if self.readable >= self.recorded or (frame is None and (update is None or update <= self.readable)):
            return
        known = self.last_known_frame
        if frame is not None and known is not None and frame <= known:
            return
        asked = f"frame {frame}" if frame is not None else f"update {update}"
        raise InputError(
            f"was cut off: the graph is known {self._until} (update {self.readable} of {self.recorded}),"
            f" not at {asked}",
            file=self._path,
        )

    # Columns.

    @cached_property
    def _kinds(self) -> Sequence[str]:
        return self._table.values("kind")

    @cached_property
    def _subjects(self) -> Sequence[str]:
        return self._table.values("subjects")

    @cached_property
    def _updates_before(self) -> Sequence[tuple[int, int]]:
        """Frames with the number of changes before each, ascending; those that say it."""
        return [
            (facts.index, facts.updates) for facts in self._frames.facts.values() if facts.updates is not None
        ]

    def _row(self, place: int) -> Json:
        row: Json = json_value(self._table.value("json", place))
        return row

    def _chosen(self, about: Collection[str], kinds: Collection[str], after: int) -> Iterator[int]:
        """Places of rows, ascending."""
        if not about and not kinds:
            yield from range(max(after, 0), self.readable)
            return
        for place in range(max(after, 0), self.readable):
            if kinds and self._kinds[place] not in kinds:
                continue
            if about:
                subjects = self._subjects[place]
                if not any(one in subjects for one in about) or not set(about) & set(subjects.split(", ")):
                    continue
            yield place
