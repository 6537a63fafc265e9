"""The furniture recogniser: inputs, crops, grouping, rooms; the plug-in on tiny and on shipped networks."""

from __future__ import annotations

import hashlib
import json
import logging
import math
from pathlib import Path

import numpy as np
import pytest
from box_view import box_frame
from dssmsg_plugins.perception import furniture
from dssmsg_plugins.perception.furniture import Furniture, FurnitureConfig
from pydantic import ValidationError

from dssmsg.errors import ConfigError, PluginError
from dssmsg.evaluate.perception import evaluate_perception, mask_iou, visible
from dssmsg.frame import Camera, Frame
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.interfaces import Context
from dssmsg.recogniser.contract import CROP_EXTRA, CROP_FACTS, CROP_SIDE
from dssmsg.recogniser.inputs import GEOMETRY_CHANNELS
from dssmsg.recogniser.recogniser import Recogniser
from dssmsg.recogniser.shelf import Shelf
from dssmsg.recogniser.views import room_views

SPACE = "all-minilm-l6-v2/384"


class TextSide:
    """An encoder whose label vectors are a unit axis each."""

    space = SPACE
    dimension = 384

    def encode_labels(self, labels):
        return np.stack([np.eye(384, dtype=np.float32)[hash_of(label)] for label in labels])

    def encode_text(self, texts):
        return self.encode_labels(texts)

    def encode_crops(self, crops):
        return None


def hash_of(label):
    return int(hashlib.sha256(label.encode()).hexdigest(), 16) % 384


def context(encoder=None, base=Path()):
    return Context(
        seed=0, rng=np.random.default_rng(0), graph=SceneGraph(), ids=IdAllocator(),
        log=logging.getLogger("test"), base_dir=base, run_dir=base, run_id="test",
        build=lambda kind, slot: None, encoder=encoder,
    )  # fmt: skip


# -- the plug-in on networks of the contract, built here


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Weights of the contract: everything lower than 0.1 on the geometry's height channel is room, one thing
    in the middle, always called `sofa`."""
    onnx = pytest.importorskip("onnx")
    from onnx import TensorProto, helper, numpy_helper

    folder = tmp_path_factory.mktemp("weights")
    labels = ("bed", "sofa")

    def save(name, nodes, inputs, outputs, constants):
        graph = helper.make_graph(
            nodes, name,
            [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in inputs],
            [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in outputs],
            [numpy_helper.from_array(np.asarray(v, d), n) for n, v, d in constants],
        )  # fmt: skip
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        onnx.checker.check_model(model)
        onnx.save(model, folder / name)

    # thing = 20 * (0.8 z - 0.7 + 0.62): what is above 0.1 m; nothing is a centre, pieces are what touches.
    save(
        "masks.onnx",
        [
            helper.make_node("Slice", ["geometry", "one", "two", "axis"], ["height"]),
            helper.make_node("Add", ["height", "shift"], ["above"]),
            helper.make_node("Mul", ["above", "gain"], ["thing"]),
            helper.make_node("Mul", ["height", "none"], ["zero"]),
            helper.make_node("Add", ["zero", "low"], ["flat"]),
            helper.make_node("Concat", ["thing", "flat", "zero", "zero", "flat"], ["dense"], axis=1),
            helper.make_node("AveragePool", ["zero"], ["pooled"], kernel_shape=[2, 2], strides=[2, 2]),
            helper.make_node("Concat", ["pooled", "pooled", "pooled"], ["classes"], axis=1),
        ],
        [("rgb", [1, 3, None, None]), ("geometry", [1, GEOMETRY_CHANNELS, None, None])],
        [("dense", [1, 5, None, None]), ("classes", [1, 3, None, None])],
        [("one", [1], np.int64), ("two", [2], np.int64), ("axis", [1], np.int64), ("shift", [0.62], "f4"),
         ("gain", [20.0], np.float32), ("none", [0.0], np.float32), ("low", [-9.0], np.float32)],
    )  # fmt: skip
    unit = np.zeros((1, 384), np.float32)
    unit[0, hash_of("settee")] = 1
    save(
        "crops.onnx",
        [
            helper.make_node("Slice", ["facts", "start", "end", "along"], ["first"]),
            helper.make_node("Mul", ["first", "none"], ["zero"]),
            helper.make_node("Add", ["zero", "unit"], ["vectors"]),
            helper.make_node("Add", ["zero", "say"], ["logits"]),
            helper.make_node("ReduceMean", ["crops"], ["unused"], axes=[1, 2, 3], keepdims=0),
        ],
        [("crops", [None, 3 + CROP_EXTRA, CROP_SIDE, CROP_SIDE]), ("facts", [None, CROP_FACTS])],
        [("vectors", [None, 384]), ("logits", [None, 3])],
        [("start", [0], np.int64), ("end", [1], np.int64), ("along", [1], np.int64), ("none", [0.0], "f4"),
         ("unit", unit, np.float32), ("say", [[0.0, 4.0, 0.0]], np.float32)],
    )  # fmt: skip
    sums = {n: hashlib.sha256((folder / n).read_bytes()).hexdigest() for n in ("masks.onnx", "crops.onnx")}
    card = {"labels": labels, "sha256": sums, "temperature": 1.0, "context": 0.5, "joining": []}
    card["quality"] = [1, 0.5, 0, 0, 0]
    (folder / "weights.json").write_text(json.dumps(card))
    return folder


def test_a_box_becomes_one_named_detection(tiny):
    frame, hit = box_frame()
    plugin = Furniture(FurnitureConfig(weights=str(tiny)), context(TextSide()))
    assert plugin.feature_space == SPACE
    (found,) = plugin.detect(frame)
    assert found.label == "sofa"
    assert mask_iou(found.mask, hit) > 0.75  # it stands out from 0.1 m above the floor on
    assert [name for name, _ in found.label_scores] == ["sofa", "bed"]
    assert 0.5 < found.score < 1
    np.testing.assert_array_equal(found.text_feature, TextSide().encode_labels(["sofa"])[0])
    assert found.image_feature is not None
    rows, columns = np.nonzero(found.mask)
    assert found.box_xyxy.tolist() == [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]


def test_frames_do_not_depend_on_each_other(tiny):
    frame, _ = box_frame()
    other, _ = box_frame(tilt_deg=-25.0)
    plugin = Furniture(FurnitureConfig(weights=str(tiny)), context())
    first = plugin.detect(frame)
    plugin.detect(other)
    second = plugin.detect(frame)
    assert [d.score for d in first] == [d.score for d in second]
    np.testing.assert_array_equal(first[0].mask, second[0].mask)
    assert first[0].text_feature is None
    assert plugin.feature_space is None


def test_a_larger_image_gives_masks_of_its_own_size(tiny):
    frame, hit = box_frame(Camera.from_fov(640, 480, math.radians(69.4)))
    (found,) = Furniture(FurnitureConfig(weights=str(tiny)), context()).detect(frame)
    assert found.mask.shape == (480, 640)
    assert mask_iou(found.mask, hit) > 0.7


def test_a_frame_without_depth_gives_nothing(tiny):
    frame, _ = box_frame()
    blind = Frame(
        0,
        0.0,
        frame.rgb,
        np.zeros_like(frame.depth),
        frame.camera,
        frame.world_from_camera,
        frame.world_from_base,
    )
    assert Furniture(FurnitureConfig(weights=str(tiny)), context()).detect(blind) == []


def test_thresholds_leave_out(tiny):
    frame, hit = box_frame()
    for options in (
        {"min_score": 1.0},
        {"min_pixels": int(hit.sum()) + 500},
        {"max_range": 1.0},
        {"max_nothing": 1e-4},
    ):
        assert Furniture(FurnitureConfig(weights=str(tiny), **options), context()).detect(frame) == []


def test_a_vocabulary_names_through_the_text_space(tiny):
    frame, _ = box_frame()
    config = FurnitureConfig(weights=str(tiny), vocabulary=("lamp", "settee"))
    (found,) = Furniture(config, context(TextSide())).detect(frame)
    assert found.label == "settee"
    with pytest.raises(ConfigError, match="needs an encoder of the space") as error:
        Furniture(config, context())
    assert error.value.key == "perception.vocabulary"


def test_changed_missing_and_broken_weights_are_refused(tiny, tmp_path):
    def copy(name):
        folder = tmp_path / name
        folder.mkdir()
        for file in tiny.iterdir():
            (folder / file.name).write_bytes(file.read_bytes())
        return folder

    changed = copy("changed")
    (changed / "crops.onnx").write_bytes((changed / "crops.onnx").read_bytes() + b"\0")
    with pytest.raises(PluginError, match="SHA-256"):
        Furniture(FurnitureConfig(weights="changed"), context(base=tmp_path))
    missing = copy("missing")
    (missing / "masks.onnx").unlink()
    with pytest.raises(PluginError, match="missing"):
        Furniture(FurnitureConfig(weights=str(missing)), context())
    broken = copy("broken")
    (broken / "masks.onnx").write_bytes(b"no network")
    card = json.loads((broken / "weights.json").read_text())
    card["sha256"]["masks.onnx"] = hashlib.sha256(b"no network").hexdigest()
    (broken / "weights.json").write_text(json.dumps(card))
    with pytest.raises(PluginError, match="onnxruntime cannot load it"):
        Furniture(FurnitureConfig(weights=str(broken)), context())
    with pytest.raises(PluginError, match=r"weights\.json") as error:
        Furniture(FurnitureConfig(weights=str(tmp_path / "nowhere")), context())
    assert error.value.key == "perception.weights"


def test_the_doctor_hears_of_changed_weights(tiny, tmp_path):
    for name in ("weights.json", "masks.onnx", "crops.onnx"):
        (tmp_path / name).write_bytes((tiny / name).read_bytes())
    config = FurnitureConfig(weights=".")
    assert config.problems(tmp_path, None) == []
    assert FurnitureConfig().problems(tmp_path, None) == []
    (tmp_path / "masks.onnx").write_bytes(b"something else")
    (sentence,) = config.problems(tmp_path, None)
    assert sentence.startswith(f"weights: {tmp_path / 'masks.onnx'}: ")
    assert "SHA-256" in sentence
    (tmp_path / "masks.onnx").unlink()
    (sentence,) = config.problems(tmp_path, None)
    assert "missing" in sentence
    (sentence,) = FurnitureConfig(weights="nowhere").problems(tmp_path, None)
    assert "weights.json" in sentence


def test_rims_are_taken_off_as_far_as_a_mask_stays():
    mask = np.zeros((40, 40), np.bool_)
    mask[10:30, 10:30] = True
    mask[5] = True  # a line would vanish
    inner = furniture.without_rim(mask, 2)
    assert inner[12:28, 12:28].all()
    assert inner.sum() == 16 * 16
    thin = np.zeros((40, 40), np.bool_)
    thin[5:8] = True
    np.testing.assert_array_equal(furniture.without_rim(thin, 2), thin)
    np.testing.assert_array_equal(furniture.without_rim(mask, 0), mask)


@pytest.mark.parametrize("bad", [{"threads": 0}, {"min_score": 2}, {"weight": "x"}, {"max_crops": 0}])
def test_options_are_checked(bad):
    with pytest.raises(ValidationError):
        FurnitureConfig(**bad)


def test_it_registers_without_truth_and_describes_every_option():
    calls = []
    furniture.register_perception(lambda *args, **kwargs: calls.append((args, kwargs)))
    assert calls == [(("furniture", Furniture), {"config": FurnitureConfig})]
    assert all(field.description for field in FurnitureConfig.model_fields.values())


# -- the shipped weights


@pytest.fixture(scope="module")
def shipped():
    return Recogniser()


def test_the_shipped_networks_find_and_name_embedded_furniture(shipped):
    """A floor under the figures of docs/perception.md, cheap enough for every test run."""
    views = [view for seed in (1_000_000, 1_000_002) for view in room_views(Shelf("embedded"), seed, 6)]
    masks = found = names = right = 0
    for view in views:
        seen = shipped.see(view.frame)
        wanted = visible(view)
        masks += len(wanted)
        found += sum(any(mask_iou(s.mask, view.instance_ids == n) >= 0.5 for s in seen) for n in wanted)
        _, logits, opinion = shipped.opinions(view.frame, [view.instance_ids == n for n in wanted])
        said = [shipped.labels[int(np.argmax(row[:-1]))] for row in shipped.joint(logits, opinion)]
        names += len(said)
        right += sum(name == view.things[n][0] for name, n in zip(said, wanted, strict=True))
    assert masks > 20
    assert found / masks > 0.5
    assert right / names > 0.5


def test_evaluation_counts_what_it_says(shipped):
    rows = evaluate_perception(shipped, rooms=1, views=3, assets="embedded", min_views=1)
    figures = {row["metric"]: row for row in rows}
    assert figures["views"]["mean"] == 3
    assert {"mask_recall@0.5", "label_top1", "object_top1", "object_top3", "frame_cpu_ms"} <= set(figures)
    for name in ("mask_recall@0.5", "label_top1", "object_top1"):
        assert 0 <= figures[name]["mean"] <= 1
        assert figures[name]["n"] > 0
    assert figures["object_top3"]["mean"] >= figures["object_top1"]["mean"]
