"""TensorFlow.js graph -> ONNX graph, for convolutional detectors with shapes that are known beforehand.

TensorFlow convolves with channels last, ONNX with channels first, and graphs that were translated once
already are full of transposes. So a TensorFlow tensor is held here as an ONNX tensor *and the order of its
axes*: a transpose only changes that order, and one is written only where an operation needs another order
than the tensor has. What can be computed from constants alone is computed now.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.errors import InputError
from dssmsg.models.onnx_file import OnnxGraph
from dssmsg.models.tfjs import TfGraph, TfNode

NHWC_OF_NCHW = (0, 2, 3, 1)
"""Axis order of a channels-last tensor that is held with channels first."""

Order = tuple[int, ...]
Shape = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class _Held:
    """A TensorFlow tensor of `shape`: its axis i is axis `order[i]` of the ONNX tensor `name`."""

    name: str
    shape: Shape
    order: Order

    @classmethod
    def plain(cls, name: str, shape: Shape) -> _Held:
        return cls(name, shape, tuple(range(len(shape))))


_Value = _Held | NDArray[Any]


def convert(
    graph: TfGraph,
    inputs: Mapping[str, str],
    outputs: Mapping[str, str],
    *,
    name: str,
    metadata: Mapping[str, str] | None = None,
) -> OnnxGraph:
    """The same computation as an ONNX graph, float32.

    `inputs` and `outputs` give the names of the ONNX tensors by TensorFlow's (`input_1:0`); outputs come in
    this order, and what none of them needs is left out. Raises InputError for a graph that does not have
    them, has an operation that is not known here, or is inconsistent.
    """
    return _Converter(graph, inputs, outputs, OnnxGraph(name, metadata=dict(metadata or {}))).run()


class _Converter:
    def __init__(
        self, graph: TfGraph, inputs: Mapping[str, str], outputs: Mapping[str, str], onnx: OnnxGraph
    ) -> None:
        self._tf, self._onnx = graph, onnx
        self._inputs, self._outputs = inputs, outputs
        self._nodes = {node.name: node for node in graph.nodes}
        self._values: dict[str, _Value] = {}
        self._ordered: dict[tuple[str, Order], str] = {}
        self._rules: dict[str, Callable[[TfNode], None]] = {
            "Placeholder": self._placeholder,
            "Const": self._const,
            "Identity": self._identity,
            "Transpose": self._transpose,
            "Conv2D": self._convolution,
            "MaxPool": self._max_pool,
            "Add": self._add,
            "AddV2": self._add,
            "LeakyRelu": lambda node: self._unary(node, "LeakyRelu", alpha=node.number("alpha", 0.2)),
            "Sigmoid": lambda node: self._unary(node, "Sigmoid"),
            "Pad": self._pad,
            "PadV2": self._pad,
            "ConcatV2": self._concat,
            "SplitV": self._split,
            "Reshape": self._reshape,
            "ResizeBilinear": self._resize,
            "SparseToDense": self._sparse_to_dense,
        }

    def run(self) -> OnnxGraph:
        for tensor, name in self._outputs.items():
            if _node_of(tensor) not in self._nodes:
                raise InputError(
                    f"expected an output {tensor} ({name}); it has {', '.join(self._tf.outputs)}"
                )
        for node in self._needed():
            rule = self._rules.get(node.op)
            if rule is None:
                raise InputError(
                    f"node {node.name}: no rule for {node.op}; there is one for {', '.join(self._rules)}"
                )
            try:
                rule(node)
            except (ValueError, IndexError, KeyError) as error:
                raise InputError(f"node {node.name} ({node.op}): {error}") from error
        for tensor, name in self._outputs.items():
            value = self._held(tensor)
            self._onnx.add("Identity", [self._in_order(value, _identity(value.order))], [name])
            self._onnx.outputs[name] = value.shape
        return self._onnx

    def _needed(self) -> list[TfNode]:
        """The nodes that the outputs depend on, each after its inputs."""
        sorter: TopologicalSorter[str] = TopologicalSorter()
        waiting, seen = [_node_of(tensor) for tensor in self._outputs], set[str]()
        while waiting:
            name = waiting.pop()
            if name in seen:
                continue
            seen.add(name)
            if name not in self._nodes:
                raise InputError(f"a node {name} is used but does not exist")
            sources = [_node_of(one) for one in self._nodes[name].inputs]
            sorter.add(name, *sources)
            waiting += sources
        try:
            return [self._nodes[name] for name in sorter.static_order()]
        except CycleError as error:
            raise InputError(f"the graph runs in a circle through {error.args[1][0]}") from error

    # -- values -------------------------------------------------------------------------------------------

    def _value(self, tensor: str) -> _Value:
        return self._values[tensor.removesuffix(":0")]

    def _held(self, tensor: str) -> _Held:
        value = self._value(tensor)
        if isinstance(value, np.ndarray):
            raise ValueError(f"expected a computed tensor, {tensor} is a constant")
        return value

    def _constant(self, tensor: str) -> NDArray[Any]:
        value = self._value(tensor)
        if not isinstance(value, np.ndarray):
            raise ValueError(f"expected a constant, {tensor} is computed")
        return value

    def _integers(self, tensor: str) -> list[int]:
        return [int(one) for one in self._constant(tensor).reshape(-1)]

    def _store(self, name: str, value: NDArray[Any]) -> str:
        """A constant of the ONNX graph, float32 or int64."""
        floats = value.dtype.kind == "f"
        self._onnx.constants[name] = value.astype(np.float32) if floats else value.astype(np.int64)
        return name

    def _in_order(self, value: _Held, order: Order) -> str:
        """The name of an ONNX tensor that holds `value` in `order`; transposed once where it has another."""
        if value.order == order:
            return value.name
        # Axis i of the value is axis value.order[i] of what there is and shall be axis order[i].
        permutation = [0] * len(order)
        for have, want in zip(value.order, order, strict=True):
            permutation[want] = have
        key = (value.name, tuple(permutation))
        if key not in self._ordered:
            self._ordered[key] = f"{value.name}/order_{''.join(map(str, permutation))}"
            self._onnx.add("Transpose", [value.name], [self._ordered[key]], perm=permutation)
        return self._ordered[key]

    # -- rules: one an operation --------------------------------------------------------------------------

    def _placeholder(self, node: TfNode) -> None:
        tensor = next((one for one in self._tf.inputs if _node_of(one) == node.name), None)
        name = None if tensor is None else self._inputs.get(tensor)
        if tensor is None or name is None:
            raise ValueError(f"not among the expected inputs {', '.join(self._inputs)}")
        shape = self._tf.inputs[tensor]
        self._onnx.inputs[name] = shape
        self._values[node.name] = _Held.plain(name, shape)

    def _const(self, node: TfNode) -> None:
        self._values[node.name] = self._tf.weights[node.name]

    def _identity(self, node: TfNode) -> None:
        self._values[node.name] = self._value(node.inputs[0])

    def _transpose(self, node: TfNode) -> None:
        value, axes = self._held(node.inputs[0]), self._integers(node.inputs[1])
        self._values[node.name] = _Held(
            value.name, tuple(value.shape[axis] for axis in axes), tuple(value.order[axis] for axis in axes)
        )

    def _convolution(self, node: TfNode) -> None:
        value, weights = self._held(node.inputs[0]), self._constant(node.inputs[1])
        kernel, strides, dilations = weights.shape[:2], _inner(node, "strides"), _inner(node, "dilations")
        reach = [(size - 1) * step + 1 for size, step in zip(kernel, dilations, strict=True)]
        if weights.shape[2] != value.shape[3]:
            raise ValueError(f"expected {weights.shape[2]} channels, got {value.shape[3]}")
        inputs = [
            self._in_order(value, NHWC_OF_NCHW),
            self._store(f"{node.name}/weights", weights.transpose(3, 2, 0, 1)),
        ]
        self._onnx.add("Conv", inputs, [node.name], strides=strides, dilations=dilations, kernel_shape=kernel)
        shape = _slid(value.shape, reach, strides, weights.shape[3])
        self._values[node.name] = _Held(node.name, shape, NHWC_OF_NCHW)

    def _max_pool(self, node: TfNode) -> None:
        value = self._held(node.inputs[0])
        kernel, strides = _inner(node, "ksize"), _inner(node, "strides")
        self._onnx.add(
            "MaxPool",
            [self._in_order(value, NHWC_OF_NCHW)],
            [node.name],
            kernel_shape=kernel,
            strides=strides,
        )
        shape = _slid(value.shape, kernel, strides, value.shape[3])
        self._values[node.name] = _Held(node.name, shape, NHWC_OF_NCHW)

    def _add(self, node: TfNode) -> None:
        a, b = (self._value(one) for one in node.inputs)
        if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
            self._values[node.name] = a + b
            return
        if isinstance(a, np.ndarray):
            a, b = self._held(node.inputs[1]), a
        if isinstance(b, np.ndarray):
            rank = len(a.shape)
            spread = b.reshape((1,) * (rank - b.ndim) + b.shape)
            if np.broadcast_shapes(a.shape, b.shape) != a.shape:
                raise ValueError(f"cannot add {b.shape} to {a.shape}")
            other = self._store(f"{node.name}/term", spread.transpose(np.argsort(a.order)))
        else:
            if a.shape != b.shape:
                raise ValueError(f"cannot add {b.shape} to {a.shape}")
            other = self._in_order(b, a.order)
        self._onnx.add("Add", [a.name, other], [node.name])
        self._values[node.name] = _Held(node.name, a.shape, a.order)

    def _unary(self, node: TfNode, op: str, **attributes: float) -> None:
        value = self._held(node.inputs[0])
        self._onnx.add(op, [value.name], [node.name], **attributes)
        self._values[node.name] = _Held(node.name, value.shape, value.order)

    def _pad(self, node: TfNode) -> None:
        value, paddings = self._held(node.inputs[0]), self._constant(node.inputs[1])
        if paddings.shape != (len(value.shape), 2):
            raise ValueError(f"expected paddings ({len(value.shape)}, 2), got {paddings.shape}")
        fill = float(self._constant(node.inputs[2])) if node.op == "PadV2" else 0.0
        held = paddings[np.argsort(value.order)]
        inputs = [
            value.name,
            self._store(f"{node.name}/pads", held.T.reshape(-1)),
            self._store(f"{node.name}/fill", np.array(fill)),
        ]
        self._onnx.add("Pad", inputs, [node.name])
        shape = tuple(
            size + int(before) + int(after)
            for size, (before, after) in zip(value.shape, paddings, strict=True)
        )
        self._values[node.name] = _Held(node.name, shape, value.order)

    def _concat(self, node: TfNode) -> None:
        values = [self._held(one) for one in node.inputs[:-1]]
        first = values[0]
        axis = int(self._constant(node.inputs[-1])) % len(first.shape)
        if any(_without(one.shape, axis) != _without(first.shape, axis) for one in values):
            raise ValueError(f"cannot join {', '.join(str(one.shape) for one in values)} along axis {axis}")
        names = [self._in_order(one, first.order) for one in values]
        self._onnx.add("Concat", names, [node.name], axis=first.order[axis])
        length = sum(one.shape[axis] for one in values)
        shape = (*first.shape[:axis], length, *first.shape[axis + 1 :])
        self._values[node.name] = _Held(node.name, shape, first.order)

    def _split(self, node: TfNode) -> None:
        value, sizes = self._held(node.inputs[0]), self._integers(node.inputs[1])
        axis = int(self._constant(node.inputs[2])) % len(value.shape)
        if sum(sizes) != value.shape[axis]:
            raise ValueError(f"cannot split axis {axis} of {value.shape} into {sizes}")
        names = [node.name, *(f"{node.name}:{place}" for place in range(1, len(sizes)))]
        split = self._store(f"{node.name}/sizes", np.array(sizes))
        self._onnx.add("Split", [value.name, split], names, axis=value.order[axis])
        for name, size in zip(names, sizes, strict=True):
            shape = (*value.shape[:axis], size, *value.shape[axis + 1 :])
            self._values[name] = _Held(name, shape, value.order)

    def _reshape(self, node: TfNode) -> None:
        value, sizes = self._held(node.inputs[0]), self._integers(node.inputs[1])
        # Broadcasting a single zero costs nothing and knows every rule about -1.
        shape = np.broadcast_to(np.float32(0), value.shape).reshape(sizes).shape
        source = self._in_order(value, _identity(value.order))
        self._onnx.add("Reshape", [source, self._store(f"{node.name}/shape", np.array(shape))], [node.name])
        self._values[node.name] = _Held.plain(node.name, shape)

    def _resize(self, node: TfNode) -> None:
        value, size = self._held(node.inputs[0]), self._integers(node.inputs[1])
        if node.flag("align_corners") or not node.flag("half_pixel_centers"):
            raise ValueError("expected half-pixel centres")
        rows, columns = size
        batch, channels = value.shape[0], value.shape[3]
        sizes = self._store(f"{node.name}/sizes", np.array([batch, channels, rows, columns]))
        self._onnx.add(
            "Resize",
            [self._in_order(value, NHWC_OF_NCHW), "", "", sizes],
            [node.name],
            mode="linear",
            coordinate_transformation_mode="half_pixel",
        )
        self._values[node.name] = _Held(node.name, (batch, rows, columns, channels), NHWC_OF_NCHW)

    def _sparse_to_dense(self, node: TfNode) -> None:
        indices, shape, values, default = (self._constant(one) for one in node.inputs)
        dense = np.full(tuple(int(size) for size in shape), default)
        for place, index in enumerate(indices):
            dense[tuple(np.atleast_1d(index))] = values if values.ndim == 0 else values[place]
        self._values[node.name] = dense


def _node_of(tensor: str) -> str:
    """`name:output` -> `name`."""
    return tensor.partition(":")[0]


def _identity(order: Order) -> Order:
    return tuple(range(len(order)))


def _without(shape: Shape, axis: int) -> Shape:
    return shape[:axis] + shape[axis + 1 :]


def _inner(node: TfNode, key: str) -> tuple[int, int]:
    """The two spatial numbers of a channels-last attribute, (1, 1) where it is missing."""
    if node.text("data_format") != "NHWC" or node.text("padding") != "VALID":
        raise ValueError(
            f"expected padding VALID and NHWC, got {node.text('padding')} and {node.text('data_format')}"
        )
    values = node.integers(key) or (1, 1, 1, 1)
    if len(values) != 4 or values[0] != 1 or values[3] != 1:
        raise ValueError(f"expected {key} of the form [1, y, x, 1], got {list(values)}")
    return values[1], values[2]


def _slid(shape: Shape, reach: Sequence[int], strides: Sequence[int], channels: int) -> Shape:
    """The shape after a window of `reach` (rows, columns) slid over a channels-last tensor."""
    rows, columns = (
        (size - window) // step + 1 for size, window, step in zip(shape[1:3], reach, strides, strict=True)
    )
    if rows < 1 or columns < 1:
        raise ValueError(f"a window of {list(reach)} does not fit into {shape}")
    return shape[0], rows, columns, channels
