"""Detectors on tiny graphs of every export: the boxes of coloured things, in the image's own pixels."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import onnx
import onnx_graphs as graphs
import pytest
from box_scene import LabelEncoder, context
from dssmsg_plugins.detector import yolo_seg, yolo_world
from onnx_clip_graphs import clip_text, tokenizer
from pydantic import ValidationError

from dssmsg.checks import check_boxes
from dssmsg.errors import ConfigError, InputError
from dssmsg.interfaces import Detector
from dssmsg.onnx.matching import identify
from dssmsg.onnx.session import open_model
from dssmsg.onnx.yolo import Yolo, noted_size

THINGS = {"red": (20, 10, 60, 50), "blue": (90, 70, 150, 110)}
IMAGE = graphs.picture(THINGS.items())
SCORE = dict(zip(graphs.COLOURS, graphs.SCORES, strict=True))


def seen(image=IMAGE):
    return SimpleNamespace(rgb=image, depth=np.ones(image.shape[:2], np.float32))


def world(tmp_path, encoder=None, **options):
    config = yolo_world.Config(model="x.onnx", **options)
    return yolo_world.YoloWorld(config, tmp_path, encoder)


def assert_found(boxes, things=THINGS, score=SCORE, atol=1.6):
    """Boxes are those of the things, to about a pixel of the model's input."""
    boxes = check_boxes(boxes)
    assert [box.label for box in boxes] == sorted(things, key=lambda name: -score[name])
    for box in boxes:
        np.testing.assert_allclose(box.xyxy, things[box.label], atol=atol)
        assert box.score == pytest.approx(score[box.label], abs=2e-3)


EXPORTS = {
    "raw": {},
    "anchors first": {"channels_last": True},
    "logits": {"logits": True},
    "half": {"half": True},
    "dynamic": {"dynamic": True, "imgsz": "[96, 96]"},
    "nms": {"nms": True},
    "wide": {"size": (96, 160)},
    "other names": {"ports": ("x", "y", "z")},
}


@pytest.mark.parametrize("export", EXPORTS, ids=lambda name: name.replace(" ", "_"))
def test_every_ultralytics_export_finds_the_things(tmp_path, export):
    graphs.yolo(tmp_path / "x.onnx", **EXPORTS[export])
    assert_found(world(tmp_path).detect(seen(), None))


@pytest.mark.parametrize("size", [(120, 160), (160, 120), (96, 96), (37, 211)])
def test_the_letterbox_is_undone_for_images_of_every_shape(tmp_path, size):
    things = {"green": (3, 5, size[1] // 2, size[0] // 2)}
    graphs.yolo(tmp_path / "x.onnx")
    boxes = world(tmp_path).detect(seen(graphs.picture(things.items(), size=size)), None)
    assert_found(boxes, things, atol=1.01 * max(1.0, max(size) / 96))


def test_nothing_to_see_gives_no_boxes(tmp_path):
    graphs.yolo(tmp_path / "x.onnx")
    assert list(world(tmp_path).detect(seen(graphs.picture([])), None)) == []


def test_baked_classes_ignore_what_a_tagger_says(tmp_path):
    graphs.yolo(tmp_path / "x.onnx")
    assert_found(world(tmp_path).detect(seen(), ["piano"]))


def test_limits(tmp_path):
    boxes = [((10, 10, 50, 50), 0, 0.9), ((11, 11, 50, 50), 0, 0.8), ((10, 10, 50, 51), 1, 0.6)]
    graphs.fixed_boxes(tmp_path / "x.onnx", boxes, ["sofa", "couch"])
    frame = seen(np.zeros((96, 96, 3), np.uint8))
    labels = lambda **options: [box.label for box in world(tmp_path, **options).detect(frame, None)]  # noqa: E731
    assert labels() == ["sofa", "couch"]
    assert labels(iou=1.0) == ["sofa", "sofa", "couch"]
    assert labels(min_score=0.7) == ["sofa"]
    assert labels(across_classes=True) == ["sofa"]
    assert labels(limit=1) == ["sofa"]


def test_logits_may_be_dialled(tmp_path):
    """A graph whose logits all lie in 0..1 cannot be told from one that gives probabilities."""
    graphs.fixed_boxes(tmp_path / "x.onnx", [((10, 10, 50, 50), 0, 0.5)], ["sofa"])
    frame = seen(np.zeros((96, 96, 3), np.uint8))
    (box,) = world(tmp_path, scores="auto").detect(frame, None)
    assert box.score == 0.5
    assert world(tmp_path, scores="logits", min_score=0.6).detect(frame, None)[0].score == pytest.approx(
        0.62246, abs=1e-4
    )
    graphs.yolo(tmp_path / "x.onnx", logits=True)
    with pytest.raises(InputError, match=r"scores in 0\.\.1, got -5\.\."):
        world(tmp_path, scores="probabilities")


def test_once_logits_always_logits(tmp_path):
    """The grey trial image shows it; a later frame whose scores lie in 0..1 is read the same way."""
    graphs.yolo(tmp_path / "x.onnx", logits=True)
    assert_found(world(tmp_path).detect(seen(), None))


# AILab-CVC


@pytest.mark.parametrize("nms", [True, False])
def test_ailab_exports_want_the_class_names(tmp_path, nms):
    graphs.mmdet(tmp_path / "x.onnx", nms=nms)
    assert_found(world(tmp_path, classes=["red", "green", "blue"]).detect(seen(), None), atol=1.7)
    with pytest.raises(ConfigError, match=r"does not name its.* classes") as error:
        world(tmp_path)
    assert error.value.key == ".classes"
    assert error.value.file == str(tmp_path / "x.onnx")


@pytest.mark.parametrize("nms", [True, False])
def test_a_nameless_padding_class_is_dropped(tmp_path, nms):
    graphs.mmdet(tmp_path / "x.onnx", nms=nms, padding=True)
    things = {"red": THINGS["red"]} if nms else THINGS  # with NMS, blue is the padding class in that graph
    assert_found(world(tmp_path, classes=["red", "green", "blue"]).detect(seen(), None), things, atol=1.7)


def test_names_may_stand_in_a_text_file(tmp_path):
    graphs.mmdet(tmp_path / "x.onnx")
    (tmp_path / "names.txt").write_text("red\ngreen\nblue\n\n")
    assert_found(world(tmp_path, classes="names.txt").detect(seen(), None), atol=1.7)


def test_a_class_that_cannot_be_is_an_error_of_the_frame(tmp_path):
    graphs.mmdet(tmp_path / "x.onnx")
    with pytest.raises(ValueError, match="gives class 2, but has 1 classes"):
        world(tmp_path, classes=["red"]).detect(seen(), None)


# Text as input


@pytest.fixture(scope="module")
def tower(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tower")
    return clip_text(folder / "text.onnx", tokenizer(folder / "tokenizer.json"))


@pytest.mark.parametrize(
    "export", [{}, {"logits": True}, {"dynamic": True, "logits": True}, {"texts": 1}, {"texts": 9}], ids=str
)
def test_text_features_find_what_is_asked(tmp_path, tower, export):
    graphs.yolo_text(tmp_path / "x.onnx", **export)
    options = {"size": 96} if export.get("dynamic") else {}
    detector = world(tmp_path, text=str(tower), min_score=0.3, **options)
    assert_found(detector.detect(seen(), ["blue", "green", "red"]))
    assert [box.label for box in detector.detect(seen(), ["chair", "Blue"])] == ["Blue"]
    assert list(detector.detect(seen(), [])) == []


def test_more_texts_than_places_are_asked_in_turns(tmp_path, tower):
    graphs.yolo_text(tmp_path / "x.onnx", texts=2)
    asked = ["chair", "photo", "of", "red", "a", "blue", "red"]
    assert_found(world(tmp_path, text=str(tower), min_score=0.3).detect(seen(), asked))


def test_without_a_tagger_the_classes_are_asked(tmp_path, tower):
    graphs.yolo_text(tmp_path / "x.onnx")
    detector = world(tmp_path, text=str(tower), classes=["blue"], min_score=0.3)
    assert [box.label for box in detector.detect(seen(), None)] == ["blue"]
    assert [box.label for box in detector.detect(seen(), ["red"])] == ["red"]
    with pytest.raises(ConfigError, match="given none; name them in `classes` or add a tagger"):
        world(tmp_path, text=str(tower)).detect(seen(), None)


def test_the_runs_encoder_serves_if_it_is_clip(tmp_path):
    graphs.yolo_text(tmp_path / "x.onnx")
    axes = {"red": 0, "green": 1, "blue": 2}

    class Clip(LabelEncoder):
        space, dimension = "clip/8/12345678", 8

        def encode_text(self, texts):
            return np.eye(8, dtype=np.float32)[[axes.get(text, 7) for text in texts]]

    assert_found(world(tmp_path, Clip(), min_score=0.3).detect(seen(), ["red", "blue"]))
    with pytest.raises(ConfigError, match=r"the run's encoder is of the space test/32.*encoder: {use: clip}"):
        world(tmp_path, LabelEncoder())
    Clip.dimension = 16
    with pytest.raises(ConfigError, match=r"text features of 8 numbers, the run's encoder .* gives 16"):
        world(tmp_path, Clip())


def test_a_text_tower_of_another_size_is_refused(tmp_path, tower):
    graphs.yolo_text(tmp_path / "x.onnx", dimension=16)
    with pytest.raises(ConfigError, match=r"takes text features of 16 numbers, text\.onnx gives 8"):
        world(tmp_path, text=str(tower))


# Masks


def ellipse(centre, radii, size=(120, 160)):
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    return ((x - centre[0]) / radii[0]) ** 2 + ((y - centre[1]) / radii[1]) ** 2 <= 1


@pytest.mark.parametrize(
    "export", [{}, {"nms": True}, {"channels_last": True}, {"dynamic": True}, {"half": True}], ids=str
)
def test_segmentation_gives_the_shape_of_the_thing(tmp_path, export):
    size = (192, 192)
    graphs.yolo(tmp_path / "x.onnx", masks=True, size=size, **export)
    red, blue = ellipse((50, 40), (35, 20)), ellipse((110, 80), (18, 30))
    image = graphs.picture([])
    image[red], image[blue] = graphs.COLOURS["red"], graphs.COLOURS["blue"]
    options = {"size": 192} if export.get("dynamic") else {}
    detector = yolo_seg.YoloSeg(yolo_seg.Config(model="x.onnx", **options), tmp_path)
    boxes = check_boxes(detector.detect(seen(image), ["ignored"]))
    assert [box.label for box in boxes] == ["red", "blue"]
    for box, truth in zip(boxes, (red, blue), strict=True):
        assert box.mask.shape == truth.shape
        assert np.count_nonzero(box.mask & truth) / np.count_nonzero(box.mask | truth) > 0.93
        rows, columns = np.nonzero(truth)
        np.testing.assert_allclose(
            box.xyxy, [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], atol=1.6
        )


def test_detectors_and_mask_detectors_are_not_mistaken(tmp_path):
    graphs.yolo(tmp_path / "x.onnx", masks=True)
    with pytest.raises(
        ConfigError, match=r"YOLOE-seg, which goes into detector: {use: yolo-seg, model: FILE}"
    ):
        world(tmp_path)
    graphs.yolo(tmp_path / "x.onnx")
    with pytest.raises(ConfigError, match=r"which goes into detector: {use: yolo-world, model: FILE}"):
        yolo_seg.YoloSeg(yolo_seg.Config(model="x.onnx"), tmp_path)


# Names and sizes


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("{0: 'red', 1: 'green'}", "metadata names 2 classes, its output has 3"),
        ("__import__('os').getcwd()", "its metadata `names` should be like"),
        ("[" * 5000, "its metadata `names` should be like"),
        ("{0: 'red', 2: 'green', 3: 'blue'}", "should name the classes 0, 1, 2"),
        ("{0: 1, 1: 2, 2: 3}", "by texts"),
        ("{0: '" + "x" * 300 + "', 1: 'b', 2: 'c'}", "of 200 characters"),
        ("'" + "x" * 2_100_000 + "'", "at most 2000000 are read"),
    ],
)
def test_bad_notes_are_refused(tmp_path, names, message):
    path = graphs.yolo(tmp_path / "x.onnx", names=None)
    model = onnx.load(str(path))
    onnx.helper.set_model_props(model, {"names": names})
    onnx.save(model, str(path))
    with pytest.raises(InputError, match=message) as error:
        world(tmp_path)
    assert error.value.file == str(path)


def test_names_of_the_option_must_be_those_of_the_file(tmp_path):
    graphs.yolo(tmp_path / "x.onnx", names=("Red", "green_thing", "blue"))
    assert_found(
        world(tmp_path, classes=["red", "green thing", "blue"], min_score=0.85).detect(seen(), None),
        {"Red": THINGS["red"]},
        {"Red": 0.9},
    )
    with pytest.raises(
        ConfigError, match=r"exported with other classes: 3 \(Red.*asked for: 2 \(sofa, bed\).*set_classes"
    ):
        world(tmp_path, classes=["sofa", "bed"])
    graphs.yolo(tmp_path / "x.onnx", names=None)
    with pytest.raises(ConfigError, match="expected 3 names, one for each class of the file, got 2"):
        world(tmp_path, classes=["sofa", "bed"])


def test_image_size_of_an_open_graph(tmp_path):
    path = graphs.yolo(tmp_path / "x.onnx", dynamic=True)

    def size(**options):
        return Yolo(identify(open_model(path), ("yolo",)), **options).input_size

    assert size(size=96) == (96, 96)
    graphs.yolo(path, dynamic=True, imgsz="[96, 96]")
    assert size() == (96, 96)
    graphs.yolo(path)
    with pytest.raises(ConfigError, match="takes images of 96 x 96 pixels only"):
        size(size=128)
    assert [noted_size(text) for text in ("640", "[384, 640]", "", "x", "[1,2,3]", "[7, 7]", "9" * 99)] == [
        (640, 640),
        (384, 640),
        *[None] * 5,
    ]


def test_a_graph_that_cannot_run_is_refused_before_the_run(tmp_path):
    """Open sizes are only wrong once they are tried."""
    graphs.yolo(tmp_path / "x.onnx", dynamic=True)
    with pytest.raises(
        InputError, match=r"tried on a grey image of 640 x 640 pixels, x\.onnx failed"
    ) as error:
        world(tmp_path)
    assert error.value.key == ".model"


def test_nan_is_an_error_of_the_frame(tmp_path):
    graph = graphs.Graph()
    image = graph.input("images", (1, 3, 96, 96))
    mean = graph.add("ReduceMean", image, keepdims=0)
    # log(mean - 0.3): fine for the grey trial image, not a number for a black one
    level = graph.add("Log", graph.add("Sub", mean, np.float32([0.3])))
    table = graph.add("Mul", np.zeros((1, 5, 189), np.float32), level)
    graph.output(table, "output0", (1, 5, 189))
    graph.save(tmp_path / "x.onnx", names="{0: 'sofa'}")
    detector = world(tmp_path)
    with pytest.raises(ValueError, match=r"x\.onnx: output output0 holds NaN"):
        detector.detect(seen(np.zeros((96, 96, 3), np.uint8)), None)


def test_options_are_checked_without_a_model():
    for options in ({}, {"model": ""}, {"model": "x", "min_score": 2}, {"model": "x", "size": 100}):
        with pytest.raises(ValidationError):
            yolo_world.Config(**options)
    with pytest.raises(ValidationError):
        yolo_seg.Config(model="x", sha256="abc")
    for model in (yolo_world.Config, yolo_seg.Config):
        assert all(field.description for field in model.model_fields.values())


def test_factories_and_problems(tmp_path):
    graphs.yolo(tmp_path / "x.onnx")
    config = yolo_world.Config(model=str(tmp_path / "x.onnx"))
    assert isinstance(yolo_world.make(config, context()), Detector)
    assert config.problems(tmp_path, None) == []
    (text,) = yolo_world.Config(model="none.onnx").problems(tmp_path, None)
    assert text == f"model: {tmp_path / 'none.onnx'}: no such file"
    graphs.yolo(tmp_path / "x.onnx", masks=True)
    config = yolo_seg.Config(model=str(tmp_path / "x.onnx"))
    assert isinstance(yolo_seg.make(config, context()), Detector)
    assert config.problems(tmp_path, None) == []
