"""What a change must look like before any rule sees it: types, shapes, finite numbers, spelled ids.

Everything a change carries is brought into one form here (read-only arrays, plain floats, JSON values with
sorted keys), so that a change means the same live, in a log line and read back from one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from dssmsg.graph.arrays import ARRAYS
from dssmsg.graph.changes import CHANGE_TYPES, Change, Score
from dssmsg.graph.errors import GraphError
from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import NEAR, PATH, SEES
from dssmsg.graph.values import finite, json_value
from dssmsg.graph.voxels import REACH_M

_FLOATS = frozenset({"sim_time", "range_m", "heading", "tilt"})
_JSON = frozenset({"before", "after", "values", "attributes"})
_UNIT = frozenset({"text_feature", "image_feature"})
_EDGE_ENDS = {PATH: ("waypoint", "waypoint"), SEES: ("viewpoint", "object"), NEAR: ("object", "object")}


def checked(change: Change) -> Change:
    """The same change in canonical form, its arrays read-only.

    Raises GraphError naming the field for wrong types, shapes and lengths, for NaN and infinity, for
    features that are not unit vectors, for ids of another kind and edges that are not in canonical order.
    """
    if CHANGE_TYPES.get(getattr(change, "kind", "")) is not type(change):
        got = f"{type(change).__module__}.{type(change).__qualname__}"
        raise GraphError("change", "?", expected=f"one of {', '.join(CHANGE_TYPES)}", got=got)
    canonical: dict[str, Any] = {}
    try:
        for name in (field.name for field in fields(change)):
            value = getattr(change, name)
            form = _canonical(name, value)
            if form is not value:
                canonical[name] = form
    except ValueError as error:
        raise refusal(change, "well-formed fields", str(error)) from None
    change = replace(change, **canonical)
    _check_clouds(change)
    _check_edge(change)
    return change


def refusal(change: Change, expected: str, got: str) -> GraphError:
    """The error that refuses a change."""
    name = " -> ".join(map(str, change.subjects)) if hasattr(change, "edge") else str(change.subjects[0])
    return GraphError(change.kind, name, expected=expected, got=got)


def _canonical(name: str, value: Any) -> Any:
    if name in ARRAYS:
        field = ARRAYS[name]
        if value is None and field.optional:
            return None
        array = field.frozen(name, value)
        if name in _UNIT and abs(float(np.linalg.norm(array)) - 1.0) > 1e-3:
            raise ValueError(f"{name}: expected a unit vector, its length is {np.linalg.norm(array):.4f}")
        if name == "points" and array.size and np.abs(array).max() > REACH_M:
            raise ValueError(f"points: expected metres within 26 km of the origin, got {np.abs(array).max()}")
        return array
    if name in _FLOATS:
        return finite(value, name)
    if name == "score":
        number = finite(value, name)
        if not 0.0 <= number <= 1.0:
            raise ValueError(f"score: expected a number in 0..1, got {number}")
        return number
    if name in _JSON:
        if not isinstance(value, Mapping):
            raise ValueError(f"{name}: expected a mapping, got {type(value).__name__}")
        return MappingProxyType(json_value(value, name))
    if name == "scores":
        return tuple(_score(score) for score in value)
    if name == "label" and not (isinstance(value, str) and value.strip()):
        raise ValueError(f"label: expected a non-empty text, got {value!r}")
    if name in ("frame", "update", "detection"):
        return int(value)
    if name.endswith("_id") and value is not None:
        _check_id(name, value)
    return value


def _score(score: Score) -> Score:
    threshold = None if score.threshold is None else finite(score.threshold, f"score {score.name}, threshold")
    return Score(score.name, finite(score.value, f"score {score.name}"), threshold)


def _check_id(name: str, value: Any, kind: str | None = None) -> None:
    wanted = kind or ("object" if name in ("absorbed_id", "successor_id") else name.removesuffix("_id"))
    example = "viewpoint-1.1" if wanted == "viewpoint" else f"{wanted}-1"
    if not (isinstance(value, str) and id_order(value)[0] == wanted and ("." in value) is ("." in example)):
        raise ValueError(f"{name}: expected an id like {example}, got {value!r}")


def _check_clouds(change: Change) -> None:
    points, colors = getattr(change, "points", None), getattr(change, "colors", None)
    if points is not None and colors is not None and len(points) != len(colors):
        raise refusal(change, f"one colour a point ({len(points)})", f"{len(colors)} colours")


def _check_edge(change: Change) -> None:
    edge = getattr(change, "edge", None)
    if edge is None:
        return
    if edge not in _EDGE_ENDS:
        raise refusal(change, f"an edge kind of {', '.join(_EDGE_ENDS)}", repr(edge))
    try:
        for end, kind in zip(("source", "target"), _EDGE_ENDS[edge], strict=True):
            _check_id(end, getattr(change, end), kind)
    except ValueError as error:
        raise refusal(change, f"the ends of a {edge} edge", str(error)) from None
    source, target = change.subjects
    if edge != SEES and id_order(source) >= id_order(target):
        raise refusal(change, "the smaller id as source, another one as target", f"{source} -> {target}")
