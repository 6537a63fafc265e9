"""Models of a user's in a whole run: three lines of the YAML, on the real simulator, with tiny graphs."""

from __future__ import annotations

import json

import numpy as np
import onnx_clip_graphs as clips
import onnx_graphs as graphs
import onnx_sam_graphs as sams
import pytest
from conftest import real_run
from dssmsg_plugins.encoder import clip
from dssmsg_plugins.perception import chain
from project import FAKES, project

from dssmsg.checks import check_detections
from dssmsg.config import load_config
from dssmsg.contexts import ContextFactory
from dssmsg.frame import Camera, Frame, quantise_depth
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.host import Host
from dssmsg.recording.reader import Recording
from dssmsg.slot_problems import slot_problems

YAML = """
perception: {use: chain, detector: {use: yolo-world, model: models/x.onnx},
             segmenter: {use: sam, encoder: models/a.onnx, decoder: models/b.onnx}}
encoder: {use: clip, vision: models/v.onnx, text: models/t.onnx, tokenizer: models/tokenizer.json}
"""
# The middle of a frame of 320 x 240 in a letterbox of 96 x 96, and a corner of it.
BOXES = [((38, 40, 58, 60), 0, 0.9), ((2, 64, 20, 82), 1, 0.6)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("user")
    models = folder / "models"
    models.mkdir()
    graphs.fixed_boxes(models / "x.onnx", BOXES, ["red chair", "blue photo"])
    sams.sam_encoder(models / "a.onnx")
    sams.sam_decoder(models / "b.onnx")
    tokens = clips.tokenizer(models / "tokenizer.json")
    clips.clip_text(models / "t.onnx", tokens)
    clips.clip_vision(models / "v.onnx")
    (folder / "dssmsg.yaml").write_text(YAML)
    return folder


def test_three_lines_swap_the_eyes(folder):
    run = real_run(folder, "mission.max_frames=6")
    assert run.summary["errors"] == 0
    assert run.summary["frames"] == 6
    rows = [json.loads(line) for line in run.change_log.read_text().splitlines()]
    added = [row for row in rows if row["kind"] == "object_added"]
    assert added
    assert {row["label"] for row in added} <= {"red chair", "blue photo"}
    with Recording.open(run.recording) as recording:
        space = recording.facts["feature_space"]
        assert space.startswith("clip/8/")
        seen = [frame.index for frame in recording.frames() if recording.detections(frame.index)]
        assert seen
        for detection in recording.detections(seen[0]):
            assert detection.score == pytest.approx(
                {"red chair": 0.9, "blue photo": 0.6}[detection.label], abs=1e-6
            )


def changed(folder, tmp_path, old, new):
    text = (folder / "dssmsg.yaml").read_text().replace("models/", f"{folder}/models/")
    assert old in text
    return project(tmp_path, {"dssmsg.yaml": text.replace(old, new)})


def test_doctor_is_content_with_files_that_fit(folder, tmp_path):
    outcome = changed(folder, tmp_path, "use: chain", "use: chain").run("doctor", "--json")
    models = [row for row in outcome.json if row["check"] == "models"]
    assert [row["status"] for row in models] == ["ok"], models
    assert models[0]["detail"].startswith("encoder clip: clip/8/")


SWAPS = [
    ("models/x.onnx", "models/gone.onnx", "perception.detector.model", "no such file"),
    ("models/x.onnx", "models/a.onnx", "perception.detector.model", "that is SAM or MobileSAM image encoder"),
    ("models/b.onnx", "models/t.onnx", "perception.segmenter.decoder", "that is CLIP text tower, which goes"),
    (
        "models/x.onnx}",
        "models/x.onnx, classes: [sofa, bed]}",
        "perception.detector.classes",
        "exported with other classes: 2 (red chair, blue photo); asked for: 2 (sofa, bed)",
    ),
    ("models/v.onnx", "models/v16.onnx", "encoder.vision", "16 numbers, those of the text tower t.onnx 8"),
    ("use: yolo-world", "use: yolo-wold", "perception.detector.use", "did you mean 'yolo-world'?"),
    ("models/x.onnx", "models/text16.onnx", "perception.detector.text", "of 16 numbers, the run's encoder"),
]


@pytest.mark.parametrize(("old", "new", "key", "message"), SWAPS)
def test_a_run_ends_before_it_begins(folder, tmp_path, old, new, key, message):
    """With the key and the file, the same words as `problems` has for the doctor; nothing is recorded."""
    clips.clip_vision(folder / "models" / "v16.onnx", dimension=16)
    graphs.yolo_text(folder / "models" / "text16.onnx", dimension=16)
    mine = changed(folder, tmp_path, old, new)
    ran = mine.run("run", "--json", "--set", "source={use: fake}", "--set", f"plugins=[{FAKES}]")
    assert ran.code == 2
    assert ran.json["error"]["key"] == key
    assert message in ran.json["error"]["message"]
    assert list(tmp_path.rglob("*.rrd")) == []
    config = load_config(tmp_path / "dssmsg.yaml")
    host = Host.load()
    factory = ContextFactory(host, 0, SceneGraph(), IdAllocator(), tmp_path, tmp_path, "test")
    built = None
    if not key.startswith("encoder."):
        built = host.build("encoder", config.encoder, factory, base_dir=tmp_path).plugin
    (problem,) = slot_problems(host, config, built)
    assert key in problem
    assert message in problem


def test_doctor_says_so_too(folder, tmp_path):
    outcome = changed(folder, tmp_path, "models/b.onnx", "models/a.onnx").run("doctor", "--json")
    assert outcome.code == 1
    (found,) = [row for row in outcome.json if row["status"] == "fail"]
    assert found["check"] == "models"
    assert found["detail"].startswith(
        f"perception.segmenter.decoder: {folder / 'models' / 'a.onnx'}: does not fit"
    )


def test_a_tagger_names_what_a_detector_with_text_input_looks_for(folder, tmp_path):
    """The whole chain of the paper: RAM, YOLO-World, SAM, CLIP, on a picture with a red and a blue thing."""

    models = folder / "models"
    graphs.ram(models / "ram.onnx")
    graphs.yolo_text(models / "text.onnx")
    host = Host.load()
    factory = ContextFactory(host, 0, SceneGraph(), IdAllocator(), models, tmp_path, "test")
    encoder = host.build("encoder", {"use": "clip", "text": "t.onnx", "vision": "v.onnx"}, factory).plugin
    factory.encoder = encoder
    slot = {
        "use": "chain",
        "tagger": {"use": "ram", "model": "ram.onnx", "tags": ["red", "green", "blue", "room"]},
        "detector": {"use": "yolo-world", "model": "text.onnx", "min_score": 0.3},
        "segmenter": {"use": "sam", "encoder": "a.onnx", "decoder": "b.onnx"},
    }
    made = host.build("perception", slot, factory)
    assert isinstance(made.plugin, chain.Chain)
    assert isinstance(encoder, clip.ClipEncoder)
    things = {"red": (16, 8, 64, 56), "blue": (96, 64, 152, 112)}
    frame = Frame(
        0,
        0.0,
        graphs.picture(things.items()),
        quantise_depth(np.full((120, 160), 2.0)),
        Camera.from_fov(160, 120, 1.2),
        np.eye(4),
        np.eye(4),
    )
    detections = check_detections(frame, made.plugin.detect(frame))
    assert [one.label for one in detections] == ["red", "blue"]
    for one in detections:
        np.testing.assert_allclose(one.box_xyxy, things[one.label], atol=2.5)
        axis = {"red": 0, "blue": 2}[one.label]
        assert one.text_feature.argmax() == one.image_feature.argmax() == axis
    again = host.build("perception", slot, factory).plugin.detect(frame)
    for one, other in zip(detections, again, strict=True):
        assert one.image_feature.tobytes() == other.image_feature.tobytes()
        assert np.array_equal(one.mask, other.mask)
