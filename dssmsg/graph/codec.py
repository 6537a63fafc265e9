"""Changes and graphs as JSON, exactly: what goes in comes out, bit for bit.

A change becomes a *row* of JSON values and *blobs*: points, colours and features are left out of the row,
which names them by hash, dtype and shape; the same array is stored once. `canonical_json` of the rows is
the change log, byte for byte the same for the same run. A whole graph becomes one JSON object with its
arrays in base64. Both forms are described in `docs/graph.md`.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Mapping
from dataclasses import MISSING, fields
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.errors import InputError
from dssmsg.graph.arrays import ARRAYS
from dssmsg.graph.changes import CHANGE_TYPES, Cause, Change, Score
from dssmsg.graph.checks import checked
from dssmsg.graph.errors import GraphError
from dssmsg.graph.nodes import Edge, HistoryNode, ObjectNode, Viewpoint, WaypointNode
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.graph.values import canonical_json, json_value

__all__ = ["blob_hash", "canonical_json", "decode", "encode", "graph_from_json", "graph_to_json"]

GRAPH_FORMAT = "dssmsg-graph"
GRAPH_VERSION = 1
_TABLES: Mapping[str, type[Any]] = {
    "objects": ObjectNode,
    "history": HistoryNode,
    "waypoints": WaypointNode,
    "viewpoints": Viewpoint,
    "edges": Edge,
}


def encode(change: Change) -> tuple[dict[str, Any], dict[str, bytes]]:
    """A change as a JSON row, keys sorted, and the bytes of its arrays by hash.

    Raises GraphError for a change that is not well-formed.
    """
    return encode_stamped(checked(change))


def encode_stamped(change: Change) -> tuple[dict[str, Any], dict[str, bytes]]:
    """`encode` of a change that a graph has stamped, which is well-formed."""
    row: dict[str, Any] = {"kind": change.kind, "subjects": list(change.subjects)}
    blobs: dict[str, bytes] = {}
    for field in fields(change):
        value = getattr(change, field.name)
        if isinstance(value, np.ndarray) and ARRAYS[field.name].bulky:
            name = blob_hash(value)
            blobs[name] = value.tobytes()
            row[field.name] = {"blob": name, "dtype": value.dtype.str, "shape": list(value.shape)}
        elif field.name == "cause":
            row["cause"] = {"plugin": value.plugin, "rule": value.rule}
        elif field.name == "scores":
            row["scores"] = [[score.name, score.value, score.threshold] for score in value]
        else:
            row[field.name] = json_value(value, field.name)
    return {key: row[key] for key in sorted(row)}, blobs


def decode(row: Mapping[str, Any], blobs: Mapping[str, bytes]) -> Change:
    """The change of a row and its blobs.

    Raises InputError for an unknown kind, a field that is missing, unknown or malformed, and for a blob that
    is missing or is not what its hash says.
    """
    kind = row.get("kind")
    change_type = CHANGE_TYPES.get(str(kind))
    if change_type is None:
        raise InputError(f"change row: expected a kind of {', '.join(CHANGE_TYPES)}, got {kind!r}")
    place = f"change row {row.get('update', '?')} ({kind})"
    known = {field.name: field for field in fields(change_type)}
    unknown = set(row) - set(known) - {"kind", "subjects"}
    missing = {n for n, f in known.items() if f.default is MISSING and f.default_factory is MISSING} - set(
        row
    )
    if unknown or missing:
        problem = f"unknown {sorted(unknown)}" if unknown else f"no {sorted(missing)}"
        raise InputError(f"{place}: expected the fields of {change_type.__name__}, got {problem}")
    values: dict[str, Any] = {}
    try:
        for name in known.keys() & row.keys():
            values[name] = _decoded(name, row[name], blobs)
        return checked(change_type(**values))
    except (GraphError, ValueError, TypeError, KeyError, LookupError) as error:
        raise InputError(f"{place}: {error}") from None


def blob_hash(array: NDArray[Any]) -> str:
    """16 hex digits that name an array by dtype, shape and bytes."""
    digest = hashlib.sha256(f"{array.dtype.str}{list(array.shape)}".encode())
    digest.update(np.ascontiguousarray(array).data if array.size else b"")
    return digest.hexdigest()[:16]


def graph_to_json(graph: SceneGraph) -> dict[str, Any]:
    """A graph as JSON values; `graph_from_json` gives an equal graph back (`compare.same`)."""
    document: dict[str, Any] = {"format": GRAPH_FORMAT, "version": GRAPH_VERSION, "updates": graph.updates}
    for table in _TABLES:
        document[table] = [_node_row(node) for node in getattr(graph, table).values()]
    document["retired"] = [[node_id, update] for node_id, update in graph.retired.items()]
    return document


def graph_from_json(document: Mapping[str, Any]) -> SceneGraph:
    """The graph of a JSON object. Raises InputError naming what is malformed."""
    if document.get("format") != GRAPH_FORMAT or document.get("version") != GRAPH_VERSION:
        got = f"{document.get('format')!r}, version {document.get('version')!r}"
        raise InputError(f"expected a graph in format {GRAPH_FORMAT!r}, version {GRAPH_VERSION}, got {got}")
    rows: list[Any] = []
    for table, node_type in _TABLES.items():
        for index, row in enumerate(document.get(table, ())):
            try:
                rows.append(node_type(**{name: _node_value(name, value) for name, value in row.items()}))
            except (ValueError, TypeError, KeyError, AttributeError) as error:
                raise InputError(f"graph JSON, {table}[{index}]: {error}") from None
    try:
        retired = {str(node_id): int(update) for node_id, update in document["retired"]}
        return SceneGraph.restored(rows, retired, int(document["updates"]))
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f"graph JSON, retired and updates: {error}") from None


def _decoded(name: str, value: Any, blobs: Mapping[str, bytes]) -> Any:
    if name == "cause":
        return Cause(str(value["plugin"]), str(value["rule"]))
    if name == "scores":
        return tuple(Score(str(label), score, threshold) for label, score, threshold in value)
    if name in ARRAYS and ARRAYS[name].bulky and value is not None:
        blob = blobs.get(value["blob"])
        if blob is None:
            raise ValueError(f"{name}: its blob {value['blob']} is missing")
        array = np.frombuffer(blob, dtype=value["dtype"]).reshape(value["shape"])
        if blob_hash(array) != value["blob"]:
            raise ValueError(f"{name}: blob {value['blob']} is damaged, its bytes hash to {blob_hash(array)}")
        return array
    return value


def _node_row(node: Any) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for field in fields(node):
        value = getattr(node, field.name)
        if isinstance(value, np.ndarray) and ARRAYS[field.name].bulky:
            text = base64.b64encode(value.tobytes()).decode("ascii")
            row[field.name] = {"base64": text, "dtype": value.dtype.str, "shape": list(value.shape)}
        elif field.name == "votes":
            row["votes"] = [[label, score] for label, score in value.items()]  # their order breaks ties
        else:
            row[field.name] = json_value(value, field.name)
    return row


def _node_value(name: str, value: Any) -> Any:
    if name in ARRAYS:
        if value is None and ARRAYS[name].optional:
            return None
        if ARRAYS[name].bulky:
            try:
                data = base64.b64decode(value["base64"], validate=True)
            except binascii.Error as error:
                raise ValueError(f"{name}: {error}") from None
            value = np.frombuffer(data, dtype=value["dtype"]).reshape(value["shape"])
        return ARRAYS[name].frozen(name, value)
    if name == "votes":
        return MappingProxyType({str(label): float(score) for label, score in value})
    if name == "attributes":
        return MappingProxyType(json_value(value, name))
    return tuple(value) if name in ("frames", "viewpoints") else value
