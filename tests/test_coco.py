"""detector/coco on a tiny NanoDet of the same contract: known boxes, scores, names."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from box_scene import Thing, look, pose_at
from dssmsg_plugins.detector import coco
from dssmsg_plugins.perception import chain
from dssmsg_plugins.segmenter import depth as segmenter
from hypothesis import given
from hypothesis import strategies as st
from project import FAKE_RUN, project
from pydantic import ValidationError

from dssmsg.checks import check_boxes, check_detections
from dssmsg.config import load_config
from dssmsg.errors import ConfigError, InputError
from dssmsg.frame import Camera
from dssmsg.host import Host
from dssmsg.interfaces import Detector
from dssmsg.models.catalogue import coco_names
from dssmsg.models.onnx_file import OnnxGraph

BINS = 11
NAMES = coco_names()
CHAIR, CUP, TABLE, TRAIN, MOUSE = (
    NAMES.index(name) for name in ("chair", "cup", "dining table", "train", "mouse")
)


def outputs(*found):
    """Raw outputs in which each (stride, row, column, class, score, distances in strides) is found."""
    raw = {}
    for stride in coco.STRIDES:
        count = (coco.SIDE // stride) ** 2
        raw[f"cls_{stride}"] = np.full((1, count, len(NAMES)), 0.01, np.float32)
        raw[f"reg_{stride}"] = np.zeros((1, count, 4 * BINS), np.float32)
    for stride, row, column, number, score, distances in found:
        cell = row * (coco.SIDE // stride) + column
        raw[f"cls_{stride}"][0, cell, number] = score
        raw[f"reg_{stride}"][0, cell] = np.concatenate([spread(one) for one in distances])
    return raw


def spread(distance):
    """Logits of a distribution over 0 .. 10 with this expectation, on the two bins around it."""
    low = min(int(distance), BINS - 2)
    chances = np.full(BINS, 1e-30)
    chances[low], chances[low + 1] = 1 - (distance - low), distance - low
    return np.log(np.maximum(chances, 1e-30)).astype(np.float32)


def detector_of(raw, monkeypatch, tmp_path, names=NAMES, **options):
    """The plug-in over a model that answers every image with `raw`."""
    graph = OnnxGraph("tiny", metadata={"names": json.dumps(names)})
    graph.inputs["images"] = (1, 3, coco.SIDE, coco.SIDE)
    for name, value in raw.items():
        graph.constants[f"{name}/value"] = value
        graph.add("Identity", [f"{name}/value"], [name])
        graph.outputs[name] = value.shape
    path = tmp_path / "tiny.onnx"
    path.write_bytes(graph.to_bytes())
    monkeypatch.setattr("dssmsg.models.cache.checked_path", lambda model, given, key: path)
    return coco.CocoDetector(coco.Config(**options))


@pytest.fixture
def detect(monkeypatch, tmp_path):
    """Boxes of a plain 208 x 104 image for raw outputs and options."""
    frame = SimpleNamespace(rgb=np.zeros((104, 208, 3), np.uint8), depth=np.zeros((104, 208)))

    def run(*found, tags=None, **options):
        plugin = detector_of(outputs(*found), monkeypatch, tmp_path, **options)
        assert isinstance(plugin, Detector)
        return check_boxes(plugin.detect(frame, tags))

    return run


# Decoding.


def test_a_box_comes_from_the_expected_distances():
    raw = outputs((16, 10, 5, CUP, 0.8, (1.5, 2.0, 3.25, 0.5)))
    corners, scores, classes, _ = coco.decode(raw, np.ones(80, bool), 0.35)
    x, y = (5 + 0.5) * 16, (10 + 0.5) * 16
    np.testing.assert_allclose(corners, [[x - 24, y - 32, x + 52, y + 8]], atol=1e-3)
    np.testing.assert_allclose(scores, [0.8], atol=1e-6)
    assert classes.tolist() == [CUP]


@given(
    st.sampled_from(coco.STRIDES),
    st.floats(0, 1, exclude_max=True),
    st.floats(0, 1, exclude_max=True),
    st.tuples(*[st.floats(0, BINS - 1)] * 4),
)
def test_every_cell_of_every_grid_speaks_for_its_own_place(stride, along, down, distances):
    side = coco.SIDE // stride
    row, column = int(down * side), int(along * side)
    corners, *_ = coco.decode(outputs((stride, row, column, CHAIR, 0.9, distances)), np.ones(80, bool), 0.35)
    left, top, right, bottom = (stride * one for one in distances)
    x, y = (column + 0.5) * stride, (row + 0.5) * stride
    np.testing.assert_allclose(corners[0], [x - left, y - top, x + right, y + bottom], atol=0.02)


def test_a_cell_speaks_for_the_best_of_the_wanted_classes():
    raw = outputs((32, 3, 3, TRAIN, 0.9, (2, 2, 2, 2)))
    raw["cls_32"][0, 3 * 13 + 3, CHAIR] = 0.5
    _, scores, classes, _ = coco.decode(raw, np.ones(80, bool), 0.35)
    assert (classes.tolist(), scores.round(3).tolist()) == ([TRAIN], [0.9])
    wanted = np.ones(80, bool)
    wanted[TRAIN] = False
    _, scores, classes, _ = coco.decode(raw, wanted, 0.35)
    assert (classes.tolist(), scores.round(3).tolist()) == ([CHAIR], [0.5])
    *_, chances = coco.decode(raw, np.ones(80, bool), 0.35)
    assert (chances[0, TRAIN], chances[0, CHAIR]) == (np.float32(0.9), np.float32(0.5))  # the runner-up


def test_nothing_found_is_no_box():
    corners, scores, classes, _ = coco.decode(outputs(), np.ones(80, bool), 0.35)
    assert (corners.shape, scores.shape, classes.shape) == ((0, 4), (0,), (0,))


def test_the_model_sees_blue_first_stretched_and_normalised():
    image = np.zeros((100, 300, 3), np.uint8)
    image[..., 0], image[..., 2] = 255, 10
    image[:, 150:] = 0
    seen = coco.model_input(image)
    assert (seen.shape, seen.dtype) == ((1, 3, 416, 416), np.float32)
    left, right = seen[0, :, 200, 20], seen[0, :, 200, 400]
    np.testing.assert_allclose(left, (np.array([10, 0, 255]) - coco.MEAN_BGR) / coco.SCALE_BGR, atol=1e-5)
    np.testing.assert_allclose(right, -coco.MEAN_BGR / coco.SCALE_BGR, atol=1e-5)
    assert (seen[0, 0, :, 100] == seen[0, 0, 0, 100]).all()  # no rim: pulled to size


# The plug-in.


def test_boxes_come_back_in_pixels_of_the_frame_cut_at_its_rim(detect):
    (box,) = detect((32, 0, 12, CHAIR, 0.6, (3, 3, 3, 3)))
    x, y = 12.5 * 32 / 2, 0.5 * 32 / 4  # the frame is 208 x 104, half and a quarter of the model's side
    np.testing.assert_allclose(box.xyxy, [x - 48, 0, 208, y + 24], atol=1e-3)
    assert (box.label, round(box.score, 3), box.mask) == ("chair", 0.6, None)


def test_scores_below_the_least_are_left_out(detect):
    found = [(32, 3, 3, CHAIR, 0.5, (1, 1, 1, 1)), (32, 9, 9, CUP, 0.4, (1, 1, 1, 1))]
    assert [box.label for box in detect(*found)] == ["chair", "cup"]
    assert [box.label for box in detect(*found, score=0.45)] == ["chair"]
    assert [box.label for box in detect(*found, max_boxes=1)] == ["chair"]


def test_one_thing_gets_one_box_and_one_name(detect):
    large = (5, 5, 5, 5)
    near = [(32, 6, 6, CHAIR, 0.5, large), (32, 6, 7, CHAIR, 0.6, large)]
    assert [round(box.score, 3) for box in detect(*near)] == [0.6]
    assert len(detect(*near, nms_iou=1.0, same_place_iou=1.0, nested=1.0)) == 2
    both = [(32, 6, 6, CHAIR, 0.5, large), (16, 12, 12, TABLE, 0.6, (9, 9, 9, 9))]
    assert [box.label for box in detect(*both)] == ["dining table"]
    assert len(detect(*both, same_place_iou=0.95)) == 2


def test_of_nested_boxes_of_a_class_the_better_one_stays(detect):
    whole, back = (32, 6, 6, CHAIR, 0.5, (4, 4, 4, 4)), (32, 5, 6, CHAIR, 0.6, (3, 2, 3, 2))
    assert [round(box.score, 3) for box in detect(whole, back)] == [0.6]
    assert [round(box.score, 3) for box in detect((*whole[:4], 0.7, whole[5]), back)] == [0.7]
    assert len(detect(whole, back, nested=1.0)) == 2
    on_table = (32, 6, 6, TABLE, 0.5, (6, 6, 6, 6))
    assert [box.label for box in detect(on_table, (32, 6, 6 + 1, CUP, 0.6, (1, 1, 1, 1)))] == [
        "cup",
        "dining table",
    ]


def test_which_classes_are_reported(detect):
    found = [
        (32, 2, 2, TRAIN, 0.9, (1, 1, 1, 1)),
        (32, 6, 6, MOUSE, 0.8, (1, 1, 1, 1)),
        (32, 9, 9, CUP, 0.7, (1, 1, 1, 1)),
    ]

    def labels(**options):
        return [box.label for box in detect(*found, **options)]

    assert labels() == ["computer mouse", "cup"]
    assert labels(labels="all") == ["train", "computer mouse", "cup"]
    assert labels(labels=["Cup", "train"]) == ["train", "cup"]
    assert labels(labels=["mouse"]) == labels(labels=["computer mouse"]) == ["computer mouse"]
    assert labels(rename={"cup": "mug"}) == ["mouse", "mug"]


def test_a_tagger_narrows_it_down(detect):
    found = [(32, 6, 6, MOUSE, 0.8, (1, 1, 1, 1)), (32, 9, 9, CUP, 0.7, (1, 1, 1, 1))]
    assert [box.label for box in detect(*found, tags=["cup", "unicorn"])] == ["cup"]
    assert [box.label for box in detect(*found, tags=["Computer_Mouse"])] == ["computer mouse"]
    assert detect(*found, tags=["unicorn"]) == ()


def test_labels_that_the_model_does_not_know_are_refused(monkeypatch, tmp_path):
    with pytest.raises(ConfigError, match=r"does not know sofa, unicorn; it knows .*couch"):
        detector_of(outputs(), monkeypatch, tmp_path, labels=["cup", "unicorn", "sofa"])


def test_options_are_checked():
    for bad in ({"score": 0}, {"nms_iou": 0}, {"labels": "outdoor"}, {"threads": 0}, {"labels": [" "]}):
        with pytest.raises(ValidationError):
            coco.Config(**bad)


def test_a_model_that_is_missing_or_another_one_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(InputError, match="get it once with: dssmsg models get coco"):
        coco.CocoDetector(coco.Config())
    (tmp_path / "mine.onnx").write_bytes(b"not it")
    with pytest.raises(InputError, match=r"mine.onnx: .model: is not the model coco"):
        coco.CocoDetector(coco.Config(model="mine.onnx"), tmp_path)


def test_a_run_without_the_model_ends_before_it_begins(tmp_path):
    text = FAKE_RUN.replace("perception: {use: fake}", "perception: {use: chain, detector: {use: coco}}")
    folder = project(tmp_path, {"dssmsg.yaml": text})
    done = folder.run("run", env={"XDG_CACHE_HOME": str(tmp_path / "cache")})
    assert done.code == 2
    assert "perception.detector.model: the model coco is not in the cache" in done.err
    assert "dssmsg models get coco" in done.err
    assert not list(tmp_path.glob("recordings/*"))
    doctor = folder.run("doctor", "--config", "dssmsg.yaml", env={"XDG_CACHE_HOME": str(tmp_path / "cache")})
    assert doctor.code == 1
    assert re.search(r"fail +models +perception.detector.model: .*dssmsg models get coco", doctor.out)


def test_in_a_chain_its_boxes_become_detections_with_masks(monkeypatch, tmp_path):
    camera = Camera.from_fov(320, 240, 1.2)
    table = Thing("table", (1.0, -0.6, 0.0), (2.0, 0.6, 0.5))
    frame = look([table], pose_at(-0.5, 0.0, 0.0, -0.2), camera=camera)
    rows, columns = np.nonzero(frame.truth.instance_ids == 1)
    x0, x1 = columns.min() / 320 * 416, (columns.max() + 1) / 320 * 416
    y0, y1 = rows.min() / 240 * 416, (rows.max() + 1) / 240 * 416
    column, row = int((x0 + x1) / 64), int((y0 + y1) / 64)
    x, y = (column + 0.5) * 32, (row + 0.5) * 32
    sides = ((x - x0) / 32, (y - y0) / 32, (x1 - x) / 32, (y1 - y) / 32)
    plugin = detector_of(outputs((32, row, column, TABLE, 0.8, sides)), monkeypatch, tmp_path)
    links = {"detector": plugin, "segmenter": segmenter.DepthSegmenter(segmenter.Config())}
    context = SimpleNamespace(build=lambda kind, slot: links[kind], encoder=None)
    (found,) = check_detections(frame, chain.Chain(chain.Config(), context).detect(frame.without_truth()))
    truth = frame.truth.instance_ids == 1
    assert found.label == "dining table"
    assert (found.mask & truth).sum() / (found.mask | truth).sum() > 0.8


def test_the_example_configuration_is_valid():
    config = load_config(Path(__file__).parents[1] / "docs/examples/kitchen.yaml")
    with config.naming_files():
        Host.load(config.plugins, config.base_dir).check(config)
    options = dict(config.perception.options)
    coco.Config(**{key: value for key, value in options["detector"].items() if key != "use"})
    segmenter.Config(**{key: value for key, value in options["segmenter"].items() if key != "use"})
