"""A table of rows whose last writes can be taken back: what makes a batch of changes atomic."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from types import MappingProxyType
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Table(Generic[K, V]):
    """Rows by key, in order of creation. Rows are immutable values, so taking back is putting back.

    `on_write(key, old, new)` is called after each write, one that is taken back included (None = no row),
    and keeps indexes in step. A write costs the same however many rows there are.
    """

    def __init__(self, on_write: Callable[[K, V | None, V | None], None] | None = None) -> None:
        self._rows: dict[K, V] = {}
        self._ranks: dict[K, int] = {}
        self._next_rank = 0
        self._journal: list[tuple[K, V | None, int]] = []
        self._on_write = on_write
        self.rows: Mapping[K, V] = MappingProxyType(self._rows)
        """The rows as a live, read-only mapping."""

    def put(self, key: K, row: V) -> None:
        """Insert a row, or replace the one at this key in its place."""
        old = self._rows.get(key)
        self._journal.append((key, old, self._ranks.get(key, -1)))
        if old is None:
            self._ranks[key] = self._next_rank
            self._next_rank += 1
        self._write(key, old, row)

    def drop(self, key: K) -> None:
        """Remove the row at a key. Raises KeyError if there is none."""
        self._journal.append((key, self._rows[key], self._ranks.pop(key)))
        self._write(key, self._rows[key], None)

    def rank(self, key: K) -> int:
        """A number that orders keys by creation."""
        return self._ranks[key]

    def keep(self) -> None:
        """Keep what was written: it can no longer be taken back."""
        self._journal.clear()

    def take_back(self) -> None:
        """Undo every write since the last `keep`, order of rows included."""
        displaced = False
        while self._journal:
            key, row, rank = self._journal.pop()
            current = self._rows.get(key)
            displaced |= current is None  # a row that had left comes back at the end of the dict
            if row is None:
                del self._ranks[key]
            else:
                self._ranks[key] = rank
            self._write(key, current, row)
        if displaced:
            ordered = sorted(self._rows.items(), key=lambda item: self._ranks[item[0]])
            self._rows.clear()
            self._rows.update(ordered)

    def _write(self, key: K, old: V | None, new: V | None) -> None:
        if new is None:
            del self._rows[key]
        else:
            self._rows[key] = new
        if self._on_write is not None:
            self._on_write(key, old, new)
