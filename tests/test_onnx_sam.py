"""Segmenters on tiny graphs of the SAM family: the mask is the coloured thing in the box."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import onnx_graphs as graphs
import onnx_sam_graphs as sams
import pytest
from box_scene import context
from dssmsg_plugins.segmenter import sam
from dssmsg_plugins.segmenter.sam import prompt_points

from dssmsg.checks import check_masks
from dssmsg.errors import ConfigError, InputError
from dssmsg.interfaces import Box, Segmenter

THINGS = {"red": (16, 8, 64, 56), "blue": (96, 64, 152, 112)}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sam")
    sams.sam_encoder(folder / "sam_encoder.onnx")
    sams.sam_encoder(folder / "sam_encoder_inside.onnx", inside=True)
    for masks in (1, 3, 4):
        sams.sam_decoder(folder / f"sam_decoder_{masks}.onnx", masks=masks)
    sams.sam_decoder(folder / "sam_decoder_two_points.onnx", points=2)
    sams.sam_decoder(folder / "sam_decoder_one_point.onnx", points=1)
    sams.efficient_encoder(folder / "es_encoder.onnx")
    sams.efficient_encoder(folder / "es_encoder_fixed.onnx", size=(128, 192))
    sams.efficient_decoder(folder / "es_decoder.onnx")
    sams.efficient_decoder(folder / "es_decoder_point.onnx", points=1)
    sams.efficient_decoder(folder / "es_decoder_single.onnx", queries=1, points="num_points")
    sams.efficient_decoder(folder / "es_decoder_five.onnx", queries=5)
    sams.efficient_whole(folder / "es_whole.onnx")
    sams.transformers_encoder(folder / "vision_encoder.onnx")
    sams.transformers_decoder(folder / "prompt_encoder_mask_decoder.onnx")
    return folder


LAYOUTS = {
    "sam": ("sam_encoder", "sam_decoder_4"),
    "one mask": ("sam_encoder", "sam_decoder_1"),
    "best of three": ("sam_encoder", "sam_decoder_3"),
    "two points": ("sam_encoder", "sam_decoder_two_points"),
    "preprocessing inside": ("sam_encoder_inside", "sam_decoder_4"),
    "efficient": ("es_encoder", "es_decoder"),
    "efficient, fixed size": ("es_encoder_fixed", "es_decoder"),
    "efficient, one point": ("es_encoder", "es_decoder_point"),
    "efficient, box by box": ("es_encoder", "es_decoder_single"),
    "efficient, five at once": ("es_encoder", "es_decoder_five"),
    "efficient, one file": ("es_whole", None),
    "transformers": ("vision_encoder", "prompt_encoder_mask_decoder"),
}


def options(encoder, decoder, **more):
    return sam.Config(
        encoder=f"{encoder}.onnx", decoder=None if decoder is None else f"{decoder}.onnx", **more
    )


def frame_of(things=THINGS, size=(120, 160)):
    image = graphs.picture(things.items(), size=size)
    depth = np.full(size, 2.0, np.float32)
    camera = SimpleNamespace(height=size[0], width=size[1])
    return SimpleNamespace(rgb=image, depth=depth, camera=camera)


def around(corners, rim=4.0):
    return np.array(corners, float) + np.array([-rim, -rim, rim, rim])


def iou(a, b):
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda name: name.replace(" ", "_"))
def test_every_layout_masks_the_things(files, layout):
    frame = frame_of()
    segmenter = sam.SamSegmenter(options(*LAYOUTS[layout]), files)
    boxes = [Box(around(corners), name, 0.9) for name, corners in THINGS.items()]
    masks = check_masks(frame, segmenter.segment(frame, boxes), 2)
    for (name, (x0, y0, x1, y1)), mask in zip(THINGS.items(), masks, strict=True):
        truth = np.zeros(mask.shape, bool)
        truth[y0:y1, x0:x1] = True
        assert iou(mask, truth) > 0.9, name


@pytest.mark.parametrize("layout", ["sam", "efficient, fixed size", "transformers"])
def test_images_taller_than_wide(files, layout):
    things = {"green": (16, 90, 60, 150)}
    frame = frame_of(things, size=(160, 120))
    segmenter = sam.SamSegmenter(options(*LAYOUTS[layout]), files)
    (mask,) = segmenter.segment(frame, [Box(around(things["green"]), "green", 0.9)])
    truth = np.zeros(mask.shape, bool)
    truth[90:150, 16:60] = True
    assert iou(mask, truth) > 0.88


def test_boxes_at_and_beyond_the_rim(files):
    frame = frame_of()
    segmenter = sam.SamSegmenter(options(*LAYOUTS["sam"]), files)
    corners = [[-50, -50, -10, -10], [300, 300, 400, 400], [-20, -20, 300, 300], [5, 5, 5, 5]]
    boxes = [Box(np.array(one, float), "x", 0.5) for one in corners]
    masks = check_masks(frame, segmenter.segment(frame, boxes), 4)
    assert [mask.any() for mask in masks] == [False, False, True, False]
    assert segmenter.segment(frame, []) == []


def test_a_frame_without_boxes_is_not_embedded(files, monkeypatch):
    segmenter = sam.SamSegmenter(options(*LAYOUTS["sam"]), files)
    monkeypatch.setattr(segmenter, "_sam", None)
    own = np.ones((120, 160), bool)
    assert segmenter.segment(frame_of(), []) == []
    monkeypatch.setattr(segmenter, "_replace", False)
    (mask,) = segmenter.segment(frame_of(), [Box(np.array([0.0, 0, 9, 9]), "x", 0.5, own)])
    assert mask is own


def test_masks_of_a_detector_are_made_anew_unless_told(files):
    frame = frame_of()
    own = np.zeros((120, 160), bool)
    own[:3, :3] = True
    boxes = [Box(around(THINGS["red"]), "red", 0.9, own), Box(around(THINGS["blue"]), "blue", 0.9)]
    anew = sam.SamSegmenter(options(*LAYOUTS["sam"]), files).segment(frame, boxes)
    assert not np.array_equal(anew[0], own)
    kept = sam.SamSegmenter(options(*LAYOUTS["sam"], replace=False), files).segment(frame, boxes)
    assert np.array_equal(kept[0], own)
    assert np.array_equal(kept[1], anew[1])


def test_a_mask_may_be_cut_at_its_box(files):
    """The same colour elsewhere in the image belongs to another thing."""
    frame = frame_of()
    frame.rgb[100:115, 10:40] = graphs.COLOURS["red"]
    box = Box(around(THINGS["red"], 0.0), "red", 0.9)
    (whole,) = sam.SamSegmenter(options(*LAYOUTS["sam"]), files).segment(frame, [box])
    (cut,) = sam.SamSegmenter(options(*LAYOUTS["sam"], clip_to_box=True), files).segment(frame, [box])
    assert whole[105, 25]
    assert not cut[105, 25]
    assert np.array_equal(cut[8:56, 16:64], whole[8:56, 16:64])


def test_prompt_points_keep_to_the_depth_of_the_middle():
    depth = np.full((40, 60), 2.0, np.float32)
    box = np.array([10.0, 10, 30, 30])
    points = prompt_points(depth, box)
    assert points.tolist() == [[20, 20], [15, 20], [25, 20], [20, 15], [20, 25]]
    depth[:, 24:] = 4.0
    depth[:16] = 0.0  # no reading says nothing
    assert prompt_points(depth, box).tolist() == [[20, 20], [15, 20], [20, 20], [20, 15], [20, 25]]
    assert prompt_points(depth, np.array([40.0, 20, 60, 40])).shape == (5, 2)


REFUSED = [
    ("sam_encoder", "es_decoder", ".decoder", "that is EfficientSAM mask decoder"),
    ("es_encoder", "sam_decoder_4", ".decoder", "that is SAM or MobileSAM mask decoder"),
    (
        "vision_encoder",
        "sam_decoder_4",
        ".decoder",
        "accepted here: SAM mask decoder in the transformers.js layout",
    ),
    (
        "sam_decoder_4",
        "sam_decoder_4",
        ".encoder",
        "which goes into segmenter: {use: sam, encoder: ..., decoder: FILE}",
    ),
    ("sam_encoder", "sam_encoder", ".decoder", "that is SAM or MobileSAM image encoder"),
    ("sam_encoder", None, ".decoder", "is missing: sam_encoder.onnx is the SAM or MobileSAM image encoder"),
    ("es_whole", "es_decoder", ".decoder", "holds encoder and decoder; leave `decoder` out"),
    ("sam_encoder", "sam_decoder_one_point", ".decoder", "takes 1 point, a box has two corners"),
]


@pytest.mark.parametrize(("encoder", "decoder", "key", "message"), REFUSED)
def test_files_that_do_not_belong_together(files, encoder, decoder, key, message):
    with pytest.raises(ConfigError) as error:
        sam.SamSegmenter(options(encoder, decoder), files)
    assert error.value.key == key
    assert message in error.value.message


def test_an_encoder_of_another_width(files, tmp_path):
    sams.sam_encoder(tmp_path / "narrow.onnx", channels=128)
    config = sam.Config(encoder=str(tmp_path / "narrow.onnx"), decoder="sam_decoder_4.onnx")
    with pytest.raises(
        ConfigError, match=r"takes an embedding .*256.*narrow\.onnx gives .*128.* of one model"
    ):
        sam.SamSegmenter(config, files)


def test_sam_2_is_refused_by_name(tmp_path):
    graph = graphs.Graph()
    image = graph.input("image", (1, 3, 64, 64))
    for name in ("high_res_feats_0", "high_res_feats_1", "image_embed"):
        graph.output(graph.add("Mul", image, np.float32([1.0])), name, (1, 3, 64, 64))
    graph.save(tmp_path / "sam2.onnx")
    with pytest.raises(ConfigError, match="SAM 2 is not supported; take SAM, MobileSAM or EfficientSAM"):
        sam.SamSegmenter(sam.Config(encoder="sam2.onnx"), tmp_path)


def test_a_decoder_that_fails_is_found_out_before_the_run(files, tmp_path):
    """Its contract is right; what it does inside is not."""
    graph = graphs.Graph()
    embedding = graph.input("image_embeddings", ("batch", 256, "h", "w"))
    for name, shape in (
        ("point_coords", (1, "n", 2)),
        ("point_labels", (1, "n")),
        ("mask_input", (1, 1, 256, 256)),
        ("has_mask_input", (1,)),
        ("orig_im_size", (2,)),
    ):
        graph.input(name, shape)
    odd = graph.reshape(embedding, 1, 1, 7, -1)
    graph.output(odd, "low_res_masks", (1, 1, "a", "b"))
    graph.output(graph.value(np.ones((1, 1), np.float32)), "iou_predictions", (1, 1))
    graph.save(tmp_path / "bad.onnx")
    config = sam.Config(encoder=str(files / "sam_encoder.onnx"), decoder=str(tmp_path / "bad.onnx"))
    with pytest.raises(InputError, match=r"tried on a grey image, bad\.onnx failed") as error:
        sam.SamSegmenter(config, files)
    assert error.value.key == ".decoder"
    assert error.value.file == str(tmp_path / "bad.onnx")


def test_factory_and_problems(files):
    config = sam.Config(encoder=str(files / "es_whole.onnx"))
    assert isinstance(sam.make(config, context()), Segmenter)
    assert config.problems(files, None) == []
    (text,) = sam.Config(encoder=str(files / "sam_encoder.onnx"), decoder="gone.onnx").problems(files, None)
    assert text == f"decoder: {files / 'gone.onnx'}: no such file"
    (text,) = options("sam_encoder", "sam_decoder_4", decoder_sha256="0" * 64).problems(files, None)
    assert text.startswith(
        f"decoder: {files / 'sam_decoder_4.onnx'}: expected the file with SHA-256 000000000000"
    )
    assert all(field.description for field in sam.Config.model_fields.values())
