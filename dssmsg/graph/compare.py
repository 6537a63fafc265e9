"""Exact equality of graphs, and where two of them differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from dssmsg.graph.scene_graph import SceneGraph

_TABLES = ("objects", "history", "waypoints", "viewpoints", "edges", "retired")


def same(a: SceneGraph, b: SceneGraph) -> bool:
    """Whether two graphs are equal: rows, their order, every number, arrays bit by bit."""
    return first_difference(a, b) is None


def first_difference(a: SceneGraph, b: SceneGraph) -> str | None:
    """The first place where two graphs differ, or None: `objects.object-3.votes.chair: 0.5 != 0.25`."""
    for name in _TABLES:
        found = _difference(name, getattr(a, name), getattr(b, name))
        if found is not None:
            return found
    return _difference("updates", a.updates, b.updates)


def _difference(place: str, a: Any, b: Any) -> str | None:
    if type(a) is not type(b):
        return f"{place}: {type(a).__name__} {a!r} != {type(b).__name__} {b!r}"
    if isinstance(a, np.ndarray):
        return _array_difference(place, a, b)
    if isinstance(a, Mapping):
        if list(a) != list(b):
            return f"{place}: keys {_first_unequal(list(a), list(b))}"
        return _first(_difference(f"{place}.{_spelled(key)}", a[key], b[key]) for key in a)
    if isinstance(a, tuple | list):
        if len(a) != len(b):
            return f"{place}: {len(a)} items != {len(b)} items"
        return _first(_difference(f"{place}[{i}]", x, y) for i, (x, y) in enumerate(zip(a, b, strict=True)))
    if is_dataclass(a):
        return _first(
            _difference(f"{place}.{f.name}", getattr(a, f.name), getattr(b, f.name)) for f in fields(a)
        )
    return None if repr(a) == repr(b) else f"{place}: {a!r} != {b!r}"  # repr tells -0.0 from 0.0


def _array_difference(place: str, a: Any, b: Any) -> str | None:
    if (a.dtype, a.shape) != (b.dtype, b.shape):
        return f"{place}: {a.dtype} {a.shape} != {b.dtype} {b.shape}"
    if a.tobytes() == b.tobytes():
        return None
    where = np.argwhere(a != b)
    index = tuple(where[0].tolist()) if len(where) else ()
    return f"{place}{list(index)}: {a[index]!r} != {b[index]!r}"


def _first_unequal(a: list[Any], b: list[Any]) -> str:
    for x, y in zip(a, b, strict=False):
        if x != y:
            return f"{_spelled(x)} != {_spelled(y)}"
    rest = a[len(b) :] or b[len(a) :]
    return f"{len(a)} != {len(b)} of them, from {_spelled(rest[0])}"


def _spelled(key: Any) -> str:
    return "/".join(key) if isinstance(key, tuple) else str(key)


def _first(found: Any) -> str | None:
    return next((item for item in found if item is not None), None)
