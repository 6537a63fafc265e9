"""TensorFlow.js graphs: reading them, and converting them to ONNX that computes the same."""

from __future__ import annotations

import copy
import json

import numpy as np
import onnxruntime
import pytest
from tfjs_graph import INPUTS, OUTPUTS, SIZE, TfjsBuilder, ints, sliding, small_model, text

from dssmsg.errors import InputError
from dssmsg.models.convert import convert
from dssmsg.models.onnx_file import OnnxGraph
from dssmsg.models.tfjs import read_tfjs


@pytest.fixture(scope="module")
def small():
    return small_model()


def converted(builder, outputs=None):
    return convert(read_tfjs(builder.json(), builder.data), INPUTS, outputs or OUTPUTS, name="small")


def session(graph):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(graph.to_bytes(), options, providers=["CPUExecutionProvider"])


# Conversion.


def test_the_converted_graph_computes_the_same(small):
    builder, compute = small
    run = session(converted(builder))
    for seed in range(3):
        image = np.random.default_rng(seed).normal(size=(1, 3, SIZE, SIZE)).astype(np.float32)
        got = run.run(["scores", "sides"], {"images": image})
        for mine, expected in zip(got, compute(image), strict=True):
            assert mine.shape == expected.shape
            np.testing.assert_allclose(mine, expected, atol=1e-5)


def test_transposes_are_carried_along_and_not_written(small):
    builder, _ = small
    graph = converted(builder)
    written = [node for node in graph.nodes if node.op == "Transpose"]
    assert sum(node["op"] == "Transpose" for node in builder.nodes) == 8
    assert len(written) == 2  # the outputs alone are asked for in another order than convolutions give


def test_what_no_output_needs_is_left_out(small):
    builder, _ = small
    graph = converted(builder, {"Identity:0": "scores"})
    assert list(graph.outputs) == ["scores"]
    assert [port.name for port in session(graph).get_outputs()] == ["scores"]


def test_the_same_graph_gives_the_same_bytes(small):
    builder, _ = small
    assert converted(builder).to_bytes() == converted(copy.deepcopy(builder)).to_bytes()


def test_the_writer_is_read_by_onnxruntime():
    graph = OnnxGraph("g", inputs={"x": (2, 300)}, outputs={"y": (2, 302)}, metadata={"names": "ä, b"})
    graph.constants["more"] = np.full((2, 2), -1.5, np.float32)
    graph.add("Concat", ["x", "more"], ["joined"], axis=-1)
    graph.add("LeakyRelu", ["joined"], ["y"], alpha=0.25)
    run = session(graph)
    x = np.linspace(-1, 1, 600, dtype=np.float32).reshape(2, 300)
    expected = np.concatenate([x, np.full((2, 2), -1.5)], axis=1)
    np.testing.assert_allclose(
        run.run(None, {"x": x})[0], np.where(expected > 0, expected, expected / 4), atol=1e-7
    )
    assert run.get_modelmeta().custom_metadata_map == {"names": "ä, b"}
    assert run.get_inputs()[0].shape == [2, 300]


def broken(change):
    builder, _ = small_model()
    change(builder)
    return builder


def node_of(builder, name):
    return next(node for node in builder.nodes if node["name"] == name)


GRAPH_FAULTS = {
    "unknown operation": (
        lambda b: node_of(b, "leaky").update(op="Elu"),
        "node leaky: no rule for Elu; there is one for Placeholder",
    ),
    "missing node": (lambda b: node_of(b, "leaky").update(input=["nobody"]), "a node nobody is used"),
    "circle": (lambda b: node_of(b, "conv").update(input=["leaky", "first"]), "runs in a circle"),
    "padding": (
        lambda b: node_of(b, "conv")["attr"].update(padding=text("SAME")),
        r"node conv \(Conv2D\): expected padding VALID and NHWC, got SAME",
    ),
    "channels": (
        lambda b: node_of(b, "conv").update(input=["padded", "first"]),
        r"node conv \(Conv2D\): expected 3 channels, got 23",
    ),
    "strides": (
        lambda b: node_of(b, "pooled")["attr"].update(strides=ints(1, 2, 2, 2)),
        r"node pooled \(MaxPool\): expected strides of the form",
    ),
    "corners": (
        lambda b: node_of(b, "larger")["attr"].update(align_corners={"b": True}),
        "expected half-pixel centres",
    ),
    "computed shape": (
        lambda b: node_of(b, "sides/flat").update(input=["split:1", "split"]),
        r"node sides/flat \(Reshape\): expected a constant, split is computed",
    ),
    "shape": (lambda b: node_of(b, "summed").update(input=["narrow", "pooled"]), "cannot add"),
    "window": (
        lambda b: node_of(b, "narrow")["attr"].update(sliding(dilations=ints(1, 9, 9, 1))),
        None,  # a window of one pixel has no reach: fine
    ),
}


@pytest.mark.parametrize("name", GRAPH_FAULTS)
def test_graphs_that_cannot_be_converted_say_why(name):
    change, message = GRAPH_FAULTS[name]
    builder = broken(change)
    if message is None:
        assert converted(builder).nodes
        return
    with pytest.raises(InputError, match=message):
        converted(builder)


def test_inputs_and_outputs_are_asked_for_by_name(small):
    builder, _ = small
    with pytest.raises(InputError, match=r"expected an output Other:0 \(x\); it has Identity:0"):
        converted(builder, {"Other:0": "x"})
    with pytest.raises(InputError, match="not among the expected inputs input_9:0"):
        convert(read_tfjs(builder.json(), builder.data), {"input_9:0": "images"}, OUTPUTS, name="small")


# Reading.


def test_weights_keep_their_values_and_shapes():
    builder = TfjsBuilder(half=False)
    builder.const("a", np.arange(6.0).reshape(2, 3))
    builder.const("b", np.int32(-7))
    builder.half = True
    builder.const("c", np.float32([0.1, 65504]))
    weights = read_tfjs(builder.json(), builder.data).weights
    np.testing.assert_array_equal(weights["a"], np.arange(6.0, dtype=np.float32).reshape(2, 3))
    assert weights["b"].shape == ()
    assert weights["b"] == -7
    np.testing.assert_array_equal(weights["c"], np.float32(np.float16([0.1, 65504])))


def edited(**changes):
    def change(model, data):
        for key, value in changes.items():
            model[key] = value
        return model, data

    return change


FILE_FAULTS = {
    "no JSON": (lambda model, data: (None, data), "not a TensorFlow.js graph model"),
    "layers model": (edited(format="layers-model"), "its format is 'layers-model'"),
    "no signature": (edited(signature=None), "not a TensorFlow.js graph model"),
    "no topology": (edited(modelTopology={}), "not a TensorFlow.js graph model"),
    "short weights": (lambda model, data: (model, data[:-1]), "ends inside"),
    "long weights": (lambda model, data: (model, data + b"x"), r"expected a weight file of \d+ bytes"),
    "no weights": (edited(weightsManifest=[{"weights": []}]), "expected a weight file of 0 bytes"),
}


@pytest.mark.parametrize("name", FILE_FAULTS)
def test_files_that_are_no_graph_model_are_refused(small, name):
    change, message = FILE_FAULTS[name]
    builder, _ = small
    model, data = change(builder.model(), builder.data)
    content = b"{]" if model is None else json.dumps(model).encode()
    with pytest.raises(InputError, match=message):
        read_tfjs(content, data)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"dtype": "complex64"}, "got complex64"),
        ({"quantization": {"dtype": "uint8", "scale": 1, "min": 0}}, "got float32 as uint8"),
    ],
)
def test_weights_of_other_kinds_are_refused(entry, message):
    builder = TfjsBuilder()
    builder.const("w", np.zeros(4, np.float32))
    builder.manifest[0].update(entry)
    with pytest.raises(InputError, match=message):
        read_tfjs(builder.json(), builder.data)


def test_a_constant_without_weights_is_refused():
    builder = TfjsBuilder()
    builder.node("lonely", "Const")
    with pytest.raises(InputError, match="nothing for the constant lonely"):
        read_tfjs(builder.json(), builder.data)
