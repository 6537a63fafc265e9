"""Files told apart by names, ranks and sizes; what fits nothing is refused, with what would fit."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import onnx
import onnx_clip_graphs as clips
import onnx_graphs as graphs
import onnx_sam_graphs as sams
import pytest
from onnx import helper

from dssmsg.errors import ConfigError, InputError
from dssmsg.onnx.contracts import CONTRACTS
from dssmsg.onnx.matching import anchors, candidates, identify
from dssmsg.onnx.report import check_model
from dssmsg.onnx.session import file_sha256, open_model


def sentences(path):
    graph = graphs.Graph()
    for name in ("input_ids", "attention_mask", "token_type_ids"):
        graph.input(name, ("batch", "length"), graphs.LONG)
    states = graph.add("Unsqueeze", graph.add("Cast", "input_ids", to=graphs.FLOAT), np.array([2]))
    graph.output(
        graph.add("Expand", states, np.array([1, 1, 6])), "last_hidden_state", ("batch", "length", 6)
    )
    return graph.save(path)


def nanodet(path):
    graph = graphs.Graph()
    image = graph.input("images", (1, 3, 416, 416))
    zero = graph.add("Mul", graph.add("ReduceMean", image, keepdims=0), np.float32([0.0]))
    for stride in (8, 16, 32):
        for part, width in (("cls", 80), ("reg", 44)):
            shape = (1, (416 // stride) ** 2, width)
            graph.output(graph.add("Add", np.zeros(shape, np.float32), zero), f"{part}_{stride}", shape)
    return graph.save(path)


def sam_2(path):
    graph = graphs.Graph()
    image = graph.input("image", (1, 3, 64, 64))
    for name in ("high_res_feats_0", "high_res_feats_1", "image_embed"):
        graph.output(graph.add("Mul", image, np.float32([1.0])), name, (1, 3, 64, 64))
    return graph.save(path)


FILES = {
    "yolo": graphs.yolo,
    "yolo-nms": lambda path: graphs.yolo(path, nms=True),
    "yolo-seg": lambda path: graphs.yolo(path, masks=True),
    "yolo-seg-nms": lambda path: graphs.yolo(path, masks=True, nms=True),
    "yolo-world-text": graphs.yolo_text,
    "yolo-world-mmdet": graphs.mmdet,
    "yolo-world-mmdet-raw": lambda path: graphs.mmdet(path, nms=False),
    "yolo-world-maps": graphs.feature_maps,
    "nanodet": nanodet,
    "sam-encoder": sams.sam_encoder,
    "sam-encoder-image": lambda path: sams.sam_encoder(path, inside=True),
    "sam-decoder": sams.sam_decoder,
    "efficient-sam-encoder": sams.efficient_encoder,
    "efficient-sam-decoder": sams.efficient_decoder,
    "efficient-sam": sams.efficient_whole,
    "transformers-sam-encoder": sams.transformers_encoder,
    "transformers-sam-decoder": sams.transformers_decoder,
    "sam2-encoder": sam_2,
    "clip": lambda path: clips.clip_whole(path, clips.tokenizer(path.parent / "t.json")),
    "clip-vision": clips.clip_vision,
    "clip-text": lambda path: clips.clip_text(path, clips.tokenizer(path.parent / "t.json")),
    "sentences": sentences,
    "ram": graphs.ram,
}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    return {name: make(folder / f"{name}.onnx") for name, make in FILES.items()}


def test_there_is_a_file_for_every_contract():
    assert set(FILES) == {one.name for one in CONTRACTS}


@pytest.mark.parametrize("name", FILES)
def test_every_file_is_known_by_its_names(files, name):
    report = check_model(files[name])
    assert report.contract == name
    assert report.also == ()
    assert report.sha256 == file_sha256(files[name])
    assert bool(report.use) != bool(report.refusal)
    assert json.loads(json.dumps(report.as_dict()))["contract"] == name
    assert any(report.refusal in line if report.refusal else report.use in line for line in report.lines())


def renamed(path, target):
    """The same graph with tensors that nobody has heard of."""
    model = onnx.load(str(path))
    new = {port.name: f"t{n}" for n, port in enumerate([*model.graph.input, *model.graph.output])}
    for port in [*model.graph.input, *model.graph.output]:
        port.name = new[port.name]
    for node in model.graph.node:
        for names in (node.input, node.output):
            for place, name in enumerate(names):
                names[place] = new.get(name, name)
    onnx.save(model, str(target))
    return target


TELLING = [
    "yolo",
    "yolo-nms",
    "yolo-seg",
    "yolo-seg-nms",
    "yolo-world-text",
    "yolo-world-mmdet",
    "yolo-world-mmdet-raw",
    "clip-vision",
    "clip-text",
    "ram",
]


@pytest.mark.parametrize("name", TELLING)
def test_without_known_names_shapes_must_do(files, tmp_path, name):
    """For the plug-in that is asked to take the file: alone, some shapes allow more than one reading."""
    model = open_model(renamed(files[name], tmp_path / "x.onnx"))
    accepted = [name] if name in ("clip-vision", "ram") else [one.name for one in CONTRACTS]
    binding = identify(model, accepted)
    assert binding.contract.name == name
    assert binding.named == 0
    assert set(binding.ports) >= {tensor.role for tensor in binding.contract.outputs}


def test_readings_by_shape_alone_are_all_told(files, tmp_path):
    report = check_model(renamed(files["clip-vision"], tmp_path / "x.onnx"))
    assert {report.contract, *report.also} >= {"ram", "CLIP image tower"} or report.also
    assert any("by its shapes it could also be" in line for line in report.lines())


def test_names_outweigh_shapes(files):
    """By shape a CLIP image tower could be a tagger; its names say otherwise."""
    model = open_model(files["clip-vision"])
    with pytest.raises(ConfigError, match="that is CLIP image tower") as error:
        identify(model, ("ram",), key=".model")
    assert error.value.key == ".model"


def one_output(path, shape, name="output0", image=(1, 3, 96, 96)):
    graph = graphs.Graph()
    pixels = graph.input("images", image)
    zero = graph.add("Mul", graph.add("ReduceMean", pixels, keepdims=0), np.float32([0.0]))
    fixed = [size if isinstance(size, int) else 3 for size in shape]
    graph.output(graph.add("Add", np.zeros(fixed, np.float32), zero), name, fixed)
    return graph.save(path)


@pytest.mark.parametrize(
    ("shape", "contract"),
    [
        ((1, 6, 189), "yolo"),
        ((1, 189, 6), "yolo"),  # as many rows as a head of 96 x 96 has anchors: two classes
        ((1, 300, 6), "yolo-nms"),
        ((1, 84, 189), "yolo"),
        ((1, 189, 84), "yolo"),
    ],
)
def test_two_classes_or_finished_boxes(tmp_path, shape, contract):
    assert anchors(96, 96) == 189
    assert anchors(640, 640) == 8400
    assert check_model(one_output(tmp_path / "x.onnx", shape)).contract == contract


REFUSED = [
    (
        lambda path: one_output(path, (1, 1000)),
        ["output0 (1, 1000) float", "it could be RAM", "output0: expected the shape"],
    ),
    (
        lambda path: one_output(path, (4, 84, 189), image=(4, 3, 96, 96)),
        ["expected 1 on axis 0", "(4, 3, 96, 96)"],
    ),
    (lambda path: one_output(path, (1, 84, 189), image=(1, 1, 96, 96)), ["expected 3 on axis 1"]),
    (lambda path: one_output(path, (1, 4, 189)), ["expected at least 5 channels, has 4"]),
]


@pytest.mark.parametrize(("make", "parts"), REFUSED, ids=["classifier", "batch", "grey", "no classes"])
def test_what_fits_nothing_is_refused_with_reasons(tmp_path, make, parts):
    path = make(tmp_path / "x.onnx")
    model = open_model(path)
    accepted = ("yolo", "yolo-nms")
    with pytest.raises(ConfigError) as error:
        identify(model, accepted, key=".model")
    assert error.value.file == str(path)
    for part in (*parts, "accepted here: Ultralytics export of YOLO-World"):
        assert part in error.value.message


def test_nobodys_graph(tmp_path):
    graph = graphs.Graph()
    graph.output(graph.add("Mul", graph.input("x", (3,)), np.float32([2.0])), "y", (3,))
    with pytest.raises(
        InputError, match=r"fits no known contract: it takes x \(3\) float; gives y \(3\) float"
    ):
        check_model(graph.save(tmp_path / "x.onnx"))


def test_refusals_say_what_to_do_instead(files):
    with pytest.raises(
        ConfigError, match=r"raw feature maps of a YOLO head: .* export it again without --model-only"
    ):
        identify(open_model(files["yolo-world-maps"]), ("yolo",))
    with pytest.raises(ConfigError, match=r"encoder: {use: minilm} brings its own files"):
        identify(open_model(files["sentences"]), ("clip-text",))
    with pytest.raises(ConfigError, match=r"NanoDet .* goes into detector: {use: coco}"):
        identify(open_model(files["nanodet"]), ("yolo",))


def test_integers_are_no_pictures(tmp_path):
    graph = graphs.Graph()
    image = graph.input("images", (1, 3, 96, 96), onnx.TensorProto.UINT8)
    flat = graph.add("Cast", graph.reshape(image, 1, 144, 192), to=graphs.FLOAT)
    graph.output(flat, "output0", (1, 144, 192))
    model = open_model(graph.save(tmp_path / "x.onnx"))
    assert candidates(model) == ()
    with pytest.raises(ConfigError, match="images: expected floating point numbers, has uint8"):
        identify(model, ("yolo",))


# Opening files


def test_files_that_cannot_be_opened(tmp_path):
    (tmp_path / "text.onnx").write_text("not a model")
    (tmp_path / "empty.onnx").write_bytes(b"")
    for name, message in (
        ("gone.onnx", "no such file"),
        (".", "is a folder; expected a file"),
        ("text.onnx", r"expected an ONNX model that onnxruntime [\d.]+ can load"),
        ("empty.onnx", r"expected an ONNX model"),
    ):
        with pytest.raises(InputError, match=message) as error:
            open_model(name, base_dir=tmp_path, key=".model")
        assert error.value.key == ".model"
        assert str(tmp_path) in error.value.file


def test_a_pinned_file_must_be_that_file(tmp_path):
    path = graphs.yolo(tmp_path / "x.onnx")
    digest = file_sha256(path)
    assert open_model(path, sha256=digest.upper()).sha256 == digest
    graphs.yolo(path, names=("a", "b", "c"))
    with pytest.raises(ConfigError, match=f"expected the file with SHA-256 {digest[:12]}"):
        open_model(path, sha256=digest)


def test_relative_paths_start_at_the_yaml(tmp_path, monkeypatch):
    graphs.yolo(tmp_path / "x.onnx")
    monkeypatch.setenv("HOME", str(tmp_path))
    for path in ("x.onnx", "../" + tmp_path.name + "/x.onnx", "~/x.onnx", str(tmp_path / "x.onnx")):
        assert open_model(path, base_dir=tmp_path).metadata["names"] == "{0: 'red', 1: 'green', 2: 'blue'}"


def test_numbers_are_cast_to_what_the_graph_takes(tmp_path):
    graph = graphs.Graph()
    half = graph.input("half", (2,), graphs.HALF)
    whole = graph.input("whole", (2,), onnx.TensorProto.INT32)
    graph.output(graph.add("Add", half, graph.add("Cast", whole, to=graphs.FLOAT)), "sum", (2,), graphs.HALF)
    model = open_model(graph.save(tmp_path / "x.onnx"))
    feeds = {"half": np.array([0.5, 1.5]), "whole": np.array([1, 2], np.int64)}
    (total,) = model.run(feeds, ["sum"])
    assert total.dtype == np.float32
    assert total.tolist() == [1.5, 3.5]
    assert str(model.inputs[0]) == "half (2) float16"
    with pytest.raises(RuntimeError, match=r"x\.onnx failed: .*"):
        model.run({**feeds, "half": np.zeros(3)}, ["sum"])
    with pytest.raises(ValueError, match=r"x\.onnx: output sum holds NaN or infinity"):
        model.run({**feeds, "half": np.array([np.inf, 0])}, ["sum"])


def test_foreign_number_types_are_named(tmp_path):
    value = helper.make_tensor_value_info("x", onnx.TensorProto.BFLOAT16, (1, 3, 8, 8))
    node = helper.make_node("Identity", ["x"], ["y"])
    out = helper.make_tensor_value_info("y", onnx.TensorProto.BFLOAT16, (1, 3, 8, 8))
    made = helper.make_model(
        helper.make_graph([node], "g", [value], [out]),
        opset_imports=[helper.make_opsetid("", 17)],
        ir_version=8,
    )
    onnx.save(made, str(tmp_path / "x.onnx"))
    with pytest.raises(InputError, match=r"x \(1, 3, 8, 8\) bfloat16"):
        check_model(tmp_path / "x.onnx")


def test_listing_plugins_opens_no_runtime():
    code = (
        "import sys;"
        "from dssmsg_plugins.detector import yolo_seg, yolo_world;"
        "from dssmsg_plugins.encoder import clip;"
        "from dssmsg_plugins.segmenter import sam;"
        "from dssmsg_plugins.tagger import ram;"
        "yolo_world.Config(model='x.onnx'), sam.Config(encoder='x.onnx'), clip.Config(text='x.onnx');"
        "bad = [n for n in sys.modules if n.split('.')[0] in ('onnxruntime', 'tokenizers', 'PIL', 'onnx')];"
        "assert not bad, bad"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
