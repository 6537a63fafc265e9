"""Ids: `object-12`, `history-4`, `waypoint-3`, `viewpoint-3.2`. They never hold labels."""

from __future__ import annotations

import re
from collections import Counter
from functools import lru_cache

_ID = re.compile(r"(object|history|waypoint|viewpoint)-(\d+)(?:\.(\d+))?")


@lru_cache(maxsize=1 << 16)  # sorting asks for the same few ids again and again
def id_order(node_id: str) -> tuple[str, int, int]:
    """Sort key that orders ids by kind, then by number: `object-2` before `object-12`.

    Raises ValueError for what is not an id.
    """
    match = _ID.fullmatch(node_id)
    if match is None:
        raise ValueError(f"{node_id!r} is not an id like object-12 or viewpoint-3.2")
    return match[1], int(match[2]), int(match[3] or 0)


class IdAllocator:
    """Hands out fresh ids, counting from 1 a kind; an id is never used again."""

    def __init__(self) -> None:
        self._last: Counter[str] = Counter()

    def new(self, kind: str) -> str:
        """A fresh id of kind object, history or waypoint."""
        self._last[kind] += 1
        return f"{kind}-{self._last[kind]}"

    def new_viewpoint(self, waypoint_id: str) -> str:
        """A fresh id of a viewpoint of a waypoint: `viewpoint-3.2` is the second of `waypoint-3`."""
        self._last[waypoint_id] += 1
        return f"viewpoint-{waypoint_id.removeprefix('waypoint-')}.{self._last[waypoint_id]}"
