"""Writes ONNX files. The few message types that a plain float graph needs, in protobuf's wire format.

Our own, so that the same graph gives the same bytes with any version of any library: the SHA-256 of a
converted model can be pinned. Field numbers are those of onnx.proto (IR version 8).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

IR_VERSION = 8
OPSET = 17
_FLOAT, _INT64 = 1, 7
"""TensorProto.DataType."""

Attribute = int | float | str | Sequence[int]
Tensor = NDArray[np.float32] | NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class OnnxNode:
    """One operation of the default domain; tensors by name."""

    op: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: Mapping[str, Attribute]


@dataclass(slots=True)
class OnnxGraph:
    """A graph in the making. `inputs` and `outputs` are float32 tensors, name -> shape."""

    name: str
    inputs: dict[str, tuple[int, ...]] = field(default_factory=dict)
    outputs: dict[str, tuple[int, ...]] = field(default_factory=dict)
    nodes: list[OnnxNode] = field(default_factory=list)
    constants: dict[str, Tensor] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)

    def add(self, op: str, inputs: Sequence[str], outputs: Sequence[str], **attributes: Attribute) -> None:
        """Append a node; nodes must be added in an order in which they can run."""
        self.nodes.append(OnnxNode(op, tuple(inputs), tuple(outputs), attributes))

    def to_bytes(self) -> bytes:
        """The file: a ModelProto. Same graph, same bytes."""
        graph = b"".join(
            [
                *(_message(1, _node(node)) for node in self.nodes),
                _text(2, self.name),
                *(_message(5, _tensor(name, value)) for name, value in self.constants.items()),
                *(_message(11, _value(name, shape)) for name, shape in self.inputs.items()),
                *(_message(12, _value(name, shape)) for name, shape in self.outputs.items()),
            ]
        )
        return b"".join(
            [
                _integer(1, IR_VERSION),
                _text(2, "dssmsg"),
                _message(7, graph),
                _message(8, _integer(2, OPSET)),
                *(
                    _message(14, _text(1, key) + _text(2, value))
                    for key, value in sorted(self.metadata.items())
                ),
            ]
        )


def _node(node: OnnxNode) -> bytes:
    return b"".join(
        [
            *(_text(1, name) for name in node.inputs),
            *(_text(2, name) for name in node.outputs),
            _text(3, node.outputs[0]),
            _text(4, node.op),
            *(_message(5, _attribute(name, value)) for name, value in sorted(node.attributes.items())),
        ]
    )


def _attribute(name: str, value: Attribute) -> bytes:
    """AttributeProto; its `type` is 1 FLOAT, 2 INT, 3 STRING or 7 INTS."""
    head = _text(1, name)
    if isinstance(value, float):
        return head + _key(2, 5) + struct.pack("<f", value) + _integer(20, 1)
    if isinstance(value, int):
        return head + _integer(3, value) + _integer(20, 2)
    if isinstance(value, str):
        return head + _text(4, value) + _integer(20, 3)
    return head + b"".join(_integer(8, one) for one in value) + _integer(20, 7)


def _tensor(name: str, value: Tensor) -> bytes:
    kind, dtype = (_FLOAT, "<f4") if value.dtype == np.float32 else (_INT64, "<i8")
    return b"".join(
        [
            *(_integer(1, size) for size in value.shape),
            _integer(2, kind),
            _text(8, name),
            _message(9, np.ascontiguousarray(value, dtype=dtype).tobytes()),
        ]
    )


def _value(name: str, shape: tuple[int, ...]) -> bytes:
    dimensions = b"".join(_message(1, _integer(1, size)) for size in shape)
    tensor = _integer(1, _FLOAT) + _message(2, dimensions)
    return _text(1, name) + _message(2, _message(1, tensor))


def _text(number: int, text: str) -> bytes:
    return _message(number, text.encode("utf-8"))


def _message(number: int, content: bytes) -> bytes:
    return _key(number, 2) + _varint(len(content)) + content


def _integer(number: int, value: int) -> bytes:
    # Negative numbers are written as their 64-bit two's complement.
    return _key(number, 0) + _varint(int(value) & 0xFFFF_FFFF_FFFF_FFFF)


def _key(number: int, wire_type: int) -> bytes:
    return _varint(number << 3 | wire_type)


def _varint(value: int) -> bytes:
    parts = bytearray()
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    parts.append(value)
    return bytes(parts)
