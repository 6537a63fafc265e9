"""One binary value a row of an entity, found by the row's key: images by frame, arrays by hash."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import Generic, TypeVar

import pyarrow as pa

from dssmsg.errors import InputError
from dssmsg.recording.chunk_index import Place
from dssmsg.recording.columns import component_of
from dssmsg.recording.schema import FRAME

KEPT_BYTES = 256_000_000
_AHEAD_BYTES = 4_000_000
"""Of the file, read at once where a file is gone through."""

K = TypeVar("K", bound=Hashable)


def frames_of_rows(batch: pa.RecordBatch) -> Sequence[int]:
    """The frame of each row; nothing of a chunk without them."""
    place = batch.schema.get_field_index(FRAME)
    return [] if place < 0 else batch.column(place).to_pylist()


def texts_of_rows(component: str, batch: pa.RecordBatch) -> Sequence[str]:
    """The text that a component holds in each row, "" where there is none; nothing of a chunk without it."""
    names = [component_of(field) for field in batch.schema]
    if component not in names:
        return []
    cells = batch.column(names.index(component)).to_pylist()
    return [str(cell[0]) if cell else "" for cell in cells]


class BlobColumn(Mapping[K, bytes], Generic[K]):
    """The values of one component by the keys of their rows.

    Chunks are read in the order of the file, which is about that of time, and as many of the latest kept as
    fit `keeps_bytes`: a run of minutes is in memory once, of an hour's images only what was asked for lately.
    """

    def __init__(
        self,
        batches: Callable[[], Iterator[pa.RecordBatch]],
        component: str,
        keys: Callable[[pa.RecordBatch], Sequence[K]],
        keeps_bytes: int | None = None,
    ) -> None:
        self._batches = batches
        self._component = component
        self._keys = keys
        self._keeps_bytes = KEPT_BYTES if keeps_bytes is None else keeps_bytes
        self._kept: OrderedDict[int, tuple[dict[K, int], pa.ListArray]] = OrderedDict()
        self._kept_bytes = 0
        self._chunk_of: dict[K, int] = {}  # of every key met so far, those too whose chunk is forgotten
        self._all_met = False
        self._restart()

    def __getitem__(self, key: K) -> bytes:
        number = self._chunk_of.get(key)
        if number not in self._kept:
            number = self._read(key)
        found = None if number is None else self._bytes(number, key)
        if found is None:
            raise KeyError(key)
        return found

    def __iter__(self) -> Iterator[K]:
        self._meet_all()
        return iter(self._chunk_of)

    def __len__(self) -> int:
        self._meet_all()
        return len(self._chunk_of)

    def _meet_all(self) -> None:
        if not self._all_met:
            for batch in self._rest:
                self._keep(self._next, batch)
                self._next += 1
            self._all_met = True
            self._restart()

    def _restart(self) -> None:
        self._rest = self._batches()
        self._next = 0

    def _read(self, key: K) -> int | None:
        """Get the chunk of a key into memory; its number, None if there is none."""
        number = self._chunk_of.get(key)
        if number is None and self._all_met:
            return None
        if number is not None and number < self._next:
            self._restart()
        return self._read_on(key)

    def _read_on(self, key: K) -> int | None:
        """Read until the chunk of a key comes; its number, None if it does not."""
        for batch in self._rest:
            number = self._next
            self._next += 1
            if key in self._keep(number, batch):
                return number
        self._all_met = True
        self._restart()
        return None

    def _keep(self, number: int, batch: pa.RecordBatch) -> Mapping[K, int]:
        names = [component_of(field) for field in batch.schema]
        if self._component not in names:
            return {}
        rows = {key: row for row, key in enumerate(self._keys(batch))}
        if not rows:
            return {}
        self._chunk_of |= dict.fromkeys(rows, number)
        column = batch.column(names.index(self._component))
        if number not in self._kept:
            self._kept_bytes += column.nbytes
        self._kept[number] = (rows, column)
        while self._kept_bytes > self._keeps_bytes and len(self._kept) > 1:
            self._kept_bytes -= self._kept.popitem(last=False)[1][1].nbytes
        return rows

    def _bytes(self, number: int, key: K) -> bytes | None:
        self._kept.move_to_end(number)
        rows, column = self._kept[number]
        cell = column[rows[key]].values
        if cell is None or len(cell) == 0:
            return None
        first = cell[0]
        if isinstance(first, (pa.BinaryScalar, pa.LargeBinaryScalar)):
            data: bytes = first.as_py()
            return data
        buffer = first.values.buffers()[1]
        return bytes(memoryview(buffer)[first.values.offset : first.values.offset + len(first.values)])


class IndexedBlobs(BlobColumn[int]):
    """The values of an entity's component by frame, where the file's index says which chunk has them.

    `read` gives the rows of chunks. Whoever goes through a file is given the next ones beforehand.
    """

    def __init__(
        self,
        places: Sequence[Place],
        component: str,
        read: Callable[[Sequence[Place]], list[pa.RecordBatch]],
    ) -> None:
        super().__init__(lambda: iter(()), component, frames_of_rows)
        self._places = places
        self._read_places = read
        self._order = {place.number: order for order, place in enumerate(places)}
        self._latest = -2

    def _read(self, key: int) -> int | None:
        holding = [place for place in self._places if place.first <= key <= place.last]
        for place in sorted(holding, key=lambda place: place.last - place.first):  # the likeliest first
            if key in self._rows_of(place):
                return place.number
        return None

    def _meet_all(self) -> None:
        if not self._all_met:
            for place in self._places:
                if place.number not in self._kept:
                    self._rows_of(place)
            self._all_met = True

    def _rows_of(self, place: Place) -> Mapping[int, int]:
        asked = self._with_next(place)
        try:
            batches = self._read_places(asked)
        except InputError:
            if len(asked) == 1:
                raise
            asked = [place]  # what is damaged may be one that nobody asked for
            batches = self._read_places(asked)
        for batch in batches:
            frames = self._keys(batch)
            # A chunk bears no number: it is known by its frames, and by these alone where only one was read.
            span = (min(frames), max(frames)) if frames else None
            found = [one for one in asked if (one.first, one.last) == span] if len(asked) > 1 else asked
            if len(found) == 1:
                self._keep(found[0].number, batch)
        if place.number not in self._kept and len(asked) > 1:
            for batch in self._read_places([place]):
                self._keep(place.number, batch)
        return self._kept[place.number][0] if place.number in self._kept else {}

    def _with_next(self, place: Place) -> list[Place]:
        """A chunk, and those after it if the one before was the latest that was read."""
        order = self._order[place.number]
        asked, size = [place], place.size
        if order == self._latest + 1:
            for one in self._places[order + 1 :]:
                size += one.size
                if one.number in self._kept or size > min(_AHEAD_BYTES, self._keeps_bytes):
                    break
                asked.append(one)
        self._latest = order + len(asked) - 1
        return asked
