"""TensorFlow.js graph models (`model.json` and its weight file) as plain values.

Only what the format says; what the nodes mean is the business of `dssmsg.models.convert`.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.errors import InputError

_DTYPES = {"float32": np.dtype("<f4"), "int32": np.dtype("<i4"), "bool": np.dtype("?")}
_STORED = {"float16": np.dtype("<f2")}
MAX_NODES = 20_000


@dataclass(frozen=True, slots=True)
class TfNode:
    """One operation: its inputs by name (`name` or `name:output`), its attributes as the file writes them."""

    name: str
    op: str
    inputs: tuple[str, ...]
    attributes: Mapping[str, Any]

    def text(self, key: str) -> str:
        """A bytes attribute (base64 in the file) as text; "" where it is missing."""
        return base64.b64decode(self.attributes.get(key, {}).get("s", "")).decode("ascii")

    def integers(self, key: str) -> tuple[int, ...]:
        """A list of integers; () where it is missing."""
        values = self.attributes.get(key, {}).get("list", {}).get("i", ())
        return tuple(int(value) for value in values)

    def number(self, key: str, default: float) -> float:
        """A float attribute."""
        return float(self.attributes.get(key, {}).get("f", default))

    def flag(self, key: str) -> bool:
        """A boolean attribute, False where it is missing."""
        return bool(self.attributes.get(key, {}).get("b", False))


@dataclass(frozen=True, slots=True, eq=False)
class TfGraph:
    """A graph: nodes in the file's order, constants by node name, shapes of inputs and outputs by tensor."""

    nodes: tuple[TfNode, ...]
    weights: Mapping[str, NDArray[Any]]
    inputs: Mapping[str, tuple[int, ...]]
    outputs: Mapping[str, tuple[int, ...]]


def read_tfjs(model_json: bytes, weights_bin: bytes, name: str = "model.json") -> TfGraph:
    """The graph of a `model.json` with one weight file; `name` is what messages call it.

    Weights may be stored as they are or as float16. Raises InputError for anything else, and where sizes,
    names or shapes disagree.
    """
    try:
        model = json.loads(model_json)
        if model.get("format") != "graph-model":
            raise InputError(
                f"expected a TensorFlow.js graph model, its format is {model.get('format')!r}", file=name
            )
        nodes = tuple(_node(entry) for entry in model["modelTopology"]["node"])
        if len(nodes) > MAX_NODES:
            raise InputError(f"expected at most {MAX_NODES} nodes, got {len(nodes)}", file=name)
        entries = [entry for group in model["weightsManifest"] for entry in group["weights"]]
        weights = _weights(entries, weights_bin, name)
        signature = model["signature"]
        inputs, outputs = _tensors(signature["inputs"]), _tensors(signature["outputs"])
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"not a TensorFlow.js graph model ({type(error).__name__}: {error})", file=name
        ) from error
    missing = [node.name for node in nodes if node.op == "Const" and node.name not in weights]
    if missing:
        raise InputError(f"the weight file holds nothing for the constant {missing[0]}", file=name)
    return TfGraph(nodes, weights, inputs, outputs)


def _node(entry: Mapping[str, Any]) -> TfNode:
    # ^name is a control dependency: an order of execution that a pure graph does not need.
    inputs = tuple(one for one in entry.get("input", ()) if not one.startswith("^"))
    return TfNode(str(entry["name"]), str(entry["op"]), inputs, entry.get("attr", {}))


def _tensors(entries: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
    return {
        str(entry.get("name", key)): tuple(int(dim["size"]) for dim in entry["tensorShape"].get("dim", ()))
        for key, entry in entries.items()
    }


def _weights(entries: list[Mapping[str, Any]], data: bytes, name: str) -> dict[str, NDArray[Any]]:
    """Arrays by name, laid one after the other in the file, in the manifest's order."""
    weights: dict[str, NDArray[Any]] = {}
    start = 0
    for entry in entries:
        dtype = _DTYPES.get(entry["dtype"])
        quantised = entry.get("quantization")
        stored = dtype if quantised is None else _STORED.get(quantised["dtype"])
        if dtype is None or stored is None:
            kind = entry["dtype"] if quantised is None else f"{entry['dtype']} as {quantised['dtype']}"
            raise InputError(
                f"weight {entry['name']}: expected {', '.join(_DTYPES)}, or float32 stored as float16, "
                f"got {kind}",
                file=name,
            )
        shape = tuple(int(size) for size in entry["shape"])
        count = int(np.prod(shape, dtype=np.int64))
        end = start + count * stored.itemsize
        if end > len(data):
            raise InputError(f"the weight file ends inside {entry['name']}", file=name)
        values = np.frombuffer(data, stored, count, start)
        weights[entry["name"]] = values.astype(dtype).reshape(shape)
        start = end
    if start != len(data):
        raise InputError(f"expected a weight file of {start} bytes, got {len(data)}", file=name)
    return weights
