"""A small TensorFlow.js graph model with every operation that NanoDet has, and what it computes, in numpy."""

from __future__ import annotations

import base64
import io
import json
import tarfile
from dataclasses import dataclass, field

import numpy as np

DTYPES = {"float32": "DT_FLOAT", "int32": "DT_INT32"}


@dataclass
class TfjsBuilder:
    """Collects nodes and weights; `half` stores float weights as float16."""

    half: bool = True
    nodes: list = field(default_factory=list)
    manifest: list = field(default_factory=list)
    data: bytes = b""
    inputs: dict = field(default_factory=dict)
    outputs: dict = field(default_factory=dict)

    def node(self, name, op, *inputs, **attributes):
        self.nodes.append({"name": name, "op": op, "input": list(inputs), "attr": attributes})
        return name

    def const(self, name, value):
        value = np.asarray(value)
        dtype = "float32" if value.dtype.kind == "f" else "int32"
        entry = {"name": name, "shape": list(value.shape), "dtype": dtype}
        stored = value.astype(dtype)
        if dtype == "float32" and self.half:
            entry["quantization"] = {"dtype": "float16", "original_dtype": "float32"}
            stored = value.astype(np.float16)
        self.manifest.append(entry)
        self.data += stored.tobytes()
        return self.node(name, "Const", dtype={"type": DTYPES[dtype]})

    def input(self, name, shape):
        self.inputs[f"{name}:0"] = signature(f"{name}:0", shape)
        return self.node(name, "Placeholder")

    def output(self, name, source, shape):
        self.outputs[f"{name}:0"] = signature(f"{name}:0", shape)
        return self.node(name, "Identity", source)

    def model(self):
        """The content of model.json as a value."""
        return {
            "format": "graph-model",
            "signature": {"inputs": self.inputs, "outputs": self.outputs},
            "modelTopology": {"node": self.nodes},
            "weightsManifest": [{"paths": ["model.bin"], "weights": self.manifest}],
        }

    def json(self):
        return json.dumps(self.model()).encode()


def signature(name, shape):
    return {"name": name, "dtype": "DT_FLOAT", "tensorShape": {"dim": [{"size": str(n)} for n in shape]}}


def text(value):
    return {"s": base64.b64encode(value.encode()).decode()}


def ints(*values):
    return {"list": {"i": [str(value) for value in values]}}


def sliding(stride=1, **more):
    return {
        "padding": text("VALID"),
        "data_format": text("NHWC"),
        "strides": ints(1, stride, stride, 1),
        **more,
    }


NHWC, NCHW = [0, 2, 3, 1], [0, 3, 1, 2]
SIZE = 22
INPUTS, OUTPUTS = {"input_1:0": "images"}, {"Identity:0": "scores", "Identity_1:0": "sides"}


def small_model():
    """The builder, and a function from an image (1, 3, 22, 22) to the two outputs."""
    rng = np.random.default_rng(7)

    def weights(*shape):
        return rng.normal(size=shape).astype(np.float16).astype(np.float32) / 4

    first, bias = weights(3, 3, 3, 8), weights(8)
    second, other = weights(1, 1, 8, 4), weights(1, 4, 1, 1)
    b = TfjsBuilder()
    # Out of order on purpose: a file need not list nodes in the order in which they run.
    b.output("Identity", "scores", (1, 25, 3))
    b.output("Identity_1", "sides", (1, 25, 5))
    b.const("to_nhwc", NHWC)
    b.const("to_nchw", NCHW)
    b.input("input_1", (1, 3, SIZE, SIZE))
    b.const("around", [[0, 0], [0, 0], [1, 0], [0, 1]])
    b.node("padded", "Pad", "input_1", "around")
    b.node("padded/nhwc", "Transpose", "padded", "to_nhwc")
    b.const("first", first)
    b.node("conv", "Conv2D", "padded/nhwc", "first", **sliding(2, dilations=ints(1, 1, 1, 1)))
    b.const("bias", bias)
    b.node("biased", "Add", "bias", "conv")
    b.node("biased/nchw", "Transpose", "biased", "to_nchw")
    b.node("leaky", "LeakyRelu", "biased/nchw", alpha={"f": 0.1})
    b.const("least", np.float32(-1000.0))
    b.const("around/1", [[0, 0], [0, 0], [1, 1], [1, 1]])
    b.node("bordered", "PadV2", "leaky", "around/1", "least")
    b.node("bordered/nhwc", "Transpose", "bordered", "to_nhwc")
    b.node("pooled", "MaxPool", "bordered/nhwc", **sliding(2, ksize=ints(1, 3, 3, 1)))
    b.const("twice", [9, 9])
    b.node("larger", "ResizeBilinear", "pooled", "twice", **resizing())
    b.const("back", [5, 5])
    b.node("smaller", "ResizeBilinear", "larger", "back", **resizing())
    b.const("second", second)
    b.node("narrow", "Conv2D", "smaller", "second", **sliding(1, dilations=ints(1, 1, 1, 1)))
    b.const("second/1", second)
    b.node("narrow/1", "Conv2D", "pooled/cut", "second/1", **sliding(1, dilations=ints(1, 1, 1, 1)))
    b.node("pooled/cut", "ResizeBilinear", "pooled", "back", **resizing())
    b.node("narrow/nchw", "Transpose", "narrow", "to_nchw")
    b.node("narrow/nhwc", "Transpose", "narrow/nchw", "to_nhwc")
    b.node("summed", "AddV2", "narrow/1", "narrow/nhwc")
    b.node("summed/nchw", "Transpose", "summed", "to_nchw")
    b.const("other", other)
    b.node("shifted", "AddV2", "summed/nchw", "other")
    b.const("axis", np.int32(-3))
    b.node("joined", "ConcatV2", "shifted", "summed/nchw", "axis")
    b.const("parts", [3, 5])
    b.const("axis/1", np.int32(1))
    b.node("split", "SplitV", "joined", "parts", "axis/1", num_split={"i": "2"})
    b.node("sigmoid", "Sigmoid", "split")
    b.const("nowhere", np.zeros((0, 1), np.int32))
    b.const("three", [3])
    b.const("nothing", np.zeros(0, np.int32))
    b.const("zero", np.int32(0))
    b.node("zeros", "SparseToDense", "nowhere", "three", "nothing", "zero")
    b.const("flat", [1, 3, -1])
    b.node("flat/shape", "AddV2", "flat", "zeros")
    b.node("scores/flat", "Reshape", "sigmoid", "flat/shape")
    b.const("swap", [0, 2, 1])
    b.node("scores", "Transpose", "scores/flat", "swap")
    b.const("flat/1", [1, 5, 25])
    b.node("sides/flat", "Reshape", "split:1", "flat/1")
    b.node("sides", "Transpose", "sides/flat", "swap")

    def compute(image):
        x = np.pad(image, ((0, 0), (0, 0), (1, 0), (0, 1))).transpose(NHWC)
        x = conv(x, first, 2) + bias
        x = np.where(x > 0, x, np.float32(0.1) * x)
        x = np.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)), constant_values=-1000.0)
        pooled = windows(x, 3, 2).max(axis=(4, 5))
        left = conv(resize(resize(pooled, 9), 5), second, 1)
        summed = (conv(resize(pooled, 5), second, 1) + left).transpose(NCHW)
        joined = np.concatenate([summed + other, summed], axis=1).reshape(1, 8, 25)
        scores = 1 / (1 + np.exp(-joined[:, :3]))
        return scores.transpose(0, 2, 1), joined[:, 3:].transpose(0, 2, 1)

    return b, compute


def resizing():
    return {"half_pixel_centers": {"b": True}, "align_corners": {"b": False}}


def windows(x, size, stride):
    """(1, rows, columns, channels, size, size) of (1, H, W, channels)."""
    return np.lib.stride_tricks.sliding_window_view(x, (size, size), axis=(1, 2))[:, ::stride, ::stride]


def conv(x, weights, stride):
    return np.einsum("brcikl,klio->brco", windows(x, weights.shape[0], stride), weights)


def resize(x, side):
    """Bilinear with half-pixel centres, clamped, of (1, H, W, channels)."""
    for axis in (1, 2):
        count = x.shape[axis]
        place = np.clip((np.arange(side) + 0.5) * count / side - 0.5, 0, count - 1)
        low = np.floor(place).astype(int)
        high = np.minimum(low + 1, count - 1)
        shape = [1] * 4
        shape[axis] = side
        share = (place - low).reshape(shape)
        x = np.take(x, low, axis) * (1 - share) + np.take(x, high, axis) * share
    return x


def tarball(files, folder="package"):
    """A package's tarball as npm makes it."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as archive:
        for path, content in files.items():
            member = tarfile.TarInfo(f"{folder}/{path}")
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return buffer.getvalue()
