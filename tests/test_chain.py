"""The chain and its simplest links, on a ray-cast room with a table and by hand-made depth."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from box_room import TABLE_MAX, TABLE_MIN, cast, look
from dssmsg_plugins.detector import components
from dssmsg_plugins.perception import chain
from dssmsg_plugins.segmenter import depth as segmenter
from dssmsg_plugins.tagger import fixed
from dssmsg_plugins.update.none import NoUpdate
from floor_graph import WordEncoder
from pydantic import ValidationError

from dssmsg.checks import CheckFailed, check_boxes, check_detections, check_masks, check_update
from dssmsg.depth_components import depth_components
from dssmsg.frame import Camera, Frame, quantise_depth
from dssmsg.geometry import back_project_world
from dssmsg.interfaces import Box, Detector, Perception, Segmenter, Tagger, Update

CAMERA = Camera(160, 120, 130.0, 130.0, 79.5, 59.5)


def frame_of(depth, rgb=None, pose=None):
    height, width = depth.shape
    return Frame(
        index=0,
        sim_time=0.0,
        rgb=np.zeros((height, width, 3), np.uint8) if rgb is None else rgb,
        depth=quantise_depth(depth),
        camera=CAMERA if (width, height) == (160, 120) else Camera(width, height, 30.0, 30.0, 9.5, 9.5),
        world_from_camera=look(0, 0, 1.0, 0, 0) if pose is None else pose,
        world_from_base=np.eye(4),
    )


@pytest.fixture(scope="module")
def room():
    """The table in front of the camera, its middle in the image's."""
    pose = look(-0.9, -0.6, 1.4, 43, -28)
    rgb, depth = cast(CAMERA, pose)
    return frame_of(depth, rgb, pose)


LINKS = {
    ("tagger", "fixed"): lambda **o: fixed.FixedTagger(fixed.Config(**o)),
    ("detector", "components"): lambda **o: components.ComponentsDetector(components.Config(**o)),
    ("segmenter", "depth"): lambda **o: segmenter.DepthSegmenter(segmenter.Config(**o)),
}


def build(kind, slot):
    return LINKS[kind, slot.use](**slot.options)


def make(encoder=None, others=None, **options):
    links = build if others is None else lambda kind, slot: others.get(kind) or build(kind, slot)
    return chain.Chain(chain.Config(**options), SimpleNamespace(build=links, encoder=encoder))


def table_pixels(frame):
    points = back_project_world(frame.depth, frame.camera, frame.world_from_camera)
    near = np.all((points > TABLE_MIN - 0.02) & (points < TABLE_MAX + 0.02), axis=1) & (points[:, 2] > 0.1)
    return near.reshape(frame.depth.shape)


def iou(a, b):
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


# Components of depth.


def test_components_part_where_depth_jumps():
    depth = np.full((6, 8), 2.0, np.float32)
    depth[:, 4:] = 2.5
    depth[2:4, 1:3] = 0.0
    labels = depth_components(depth, np.ones((6, 8), bool))
    assert (labels[depth == 2.0] == 0).all()
    assert (labels[depth == 2.5] == 1).all()
    assert (labels[depth == 0.0] == -1).all()


def test_components_follow_a_slope_and_keep_to_the_mask():
    depth = np.tile(np.linspace(1, 3, 60, dtype=np.float32), (3, 1))
    mask = np.ones((3, 60), bool)
    assert depth_components(depth, mask).max() == 0
    mask[:, 30] = False
    labels = depth_components(depth, mask)
    assert set(labels[:, :30].ravel()) == {0}
    assert set(labels[:, 31:].ravel()) == {1}
    assert set(labels[:, 30]) == {-1}


def test_nothing_has_no_components():
    assert (depth_components(np.zeros((3, 3), np.float32), np.ones((3, 3), bool)) == -1).all()
    assert (depth_components(np.ones((3, 3), np.float32), np.zeros((3, 3), bool)) == -1).all()


def test_single_row_and_column():
    line = np.array([[1, 1, 5, 5, 5]], np.float32)
    assert depth_components(line, line > 0).tolist() == [[0, 0, 1, 1, 1]]
    assert depth_components(line.T.copy(), line.T > 0).ravel().tolist() == [0, 0, 1, 1, 1]


# Links.


def test_the_table_stands_out(room):
    boxes = check_boxes(
        components.ComponentsDetector(components.Config(max_height=0.9)).detect(room, ["table"])
    )
    best = max(boxes, key=lambda box: iou(box.mask, table_pixels(room)))
    assert iou(best.mask, table_pixels(room)) > 0.9
    assert best.label == "table"
    rows, columns = np.nonzero(best.mask)
    corners = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    assert best.xyxy.tolist() == corners
    sizes = [np.count_nonzero(box.mask) for box in boxes]
    assert sizes == sorted(sizes, reverse=True)


def test_without_labels_it_is_an_object_and_the_floor_is_none(room):
    boxes = components.ComponentsDetector(components.Config()).detect(room, None)
    assert {box.label for box in boxes} <= {"object"}
    points = back_project_world(room.depth, room.camera, room.world_from_camera)
    floor = (points[:, 2] < 0.03).reshape(room.depth.shape)
    assert floor.any()
    assert not any((box.mask & floor).any() for box in boxes)


def test_pieces_too_small_or_too_large_are_left_out(room):
    def detector(**options):
        return components.ComponentsDetector(components.Config(**options)).detect(room, None)

    assert detector(min_pixels=19200) == []
    assert detector(max_share=0.001, min_pixels=20) == []


def test_segmenter_takes_the_thing_in_the_middle_of_the_box(room):
    truth = table_pixels(room)
    rows, columns = np.nonzero(truth)
    box = Box(
        np.array([columns.min() - 6, rows.min() - 6, columns.max() + 7, rows.max() + 7.0]), "table", 0.9
    )
    (mask,) = check_masks(room, segmenter.DepthSegmenter(segmenter.Config()).segment(room, [box]), 1)
    inside = np.zeros_like(truth)
    inside[max(0, rows.min() - 6) : rows.max() + 7, max(0, columns.min() - 6) : columns.max() + 7] = True
    assert iou(mask, truth) > 0.9
    assert not (mask & ~inside).any()


def test_segmenter_prefers_the_near_thing_over_a_larger_background():
    depth = np.full((20, 20), 4.0)
    depth[6:14, 6:14] = 1.5
    depth[9, 9] = 0.0
    (mask,) = segmenter.DepthSegmenter(segmenter.Config()).segment(
        frame_of(depth), [Box(np.array([3.0, 3.0, 17.0, 17.0]), "cup", 0.9)]
    )
    expected = np.isclose(depth, 1.5)
    assert np.array_equal(mask, expected)


@pytest.mark.parametrize(
    "corners", [[5, 5, 5, 5], [-50, -50, -10, -10], [30, 30, 60, 60], [2.2, 2.2, 2.4, 2.4], [-5, -5, 99, 99]]
)
def test_segmenter_survives_boxes_at_and_beyond_the_rim(corners):
    depth = np.zeros((20, 20))
    depth[:2] = 2.0
    box = Box(np.array(corners, float), "x", 0.5)
    check_masks(
        frame_of(depth), segmenter.DepthSegmenter(segmenter.Config()).segment(frame_of(depth), [box]), 1
    )


def test_segmenter_keeps_the_mask_of_a_detector():
    own = np.zeros((20, 20), bool)
    own[3:5, 3:5] = True
    box = Box(np.array([0.0, 0.0, 9.0, 9.0]), "x", 0.5, own)
    (mask,) = segmenter.DepthSegmenter(segmenter.Config()).segment(frame_of(np.ones((20, 20))), [box])
    assert np.array_equal(mask, own)


def test_fixed_tagger_needs_labels():
    assert fixed.FixedTagger(fixed.Config(labels=["mug", "sofa"])).tags(None) == ("mug", "sofa")
    for labels in ([], [""], ["  "], "mug"):
        with pytest.raises(ValidationError):
            fixed.Config(labels=labels)


# The chain.


def test_the_whole_chain(room):
    encoder = WordEncoder()
    perception = make(
        encoder,
        tagger={"use": "fixed", "labels": ["table"]},
        detector={"use": "components", "max_height": 0.9},
        segmenter={"use": "depth"},
    )
    assert perception.feature_space == encoder.space
    detections = check_detections(room, perception.detect(room))
    best = max(detections, key=lambda d: iou(d.mask, table_pixels(room)))
    assert iou(best.mask, table_pixels(room)) > 0.9
    assert best.label == "table"
    assert np.array_equal(best.text_feature, encoder.encode_labels(["table"])[0])
    assert best.image_feature is None  # this encoder cannot see


def test_an_encoder_that_sees_gets_crops_of_the_boxes(room):
    class Seeing(WordEncoder):
        sizes = ()

        def encode_crops(self, crops):
            self.sizes = [crop.shape for crop in crops]
            return self.encode_labels(["seen"] * len(crops))

    encoder = Seeing()
    detections = make(encoder).detect(room)
    assert len(detections) == len(encoder.sizes) > 0
    for detection, (height, width, channels) in zip(detections, encoder.sizes, strict=True):
        x0, y0, x1, y1 = detection.box_xyxy
        assert (width, height, channels) == (x1 - x0, y1 - y0, 3)
        assert detection.image_feature[encoder._axis("seen")] == 1.0
    assert make(encoder, crops=False).detect(room)[0].image_feature is None


def test_without_an_encoder_there_are_no_features(room):
    perception = make()
    assert perception.feature_space is None
    assert all(d.text_feature is None for d in perception.detect(room))


class Boxes:
    """A detector that finds what it was told, and remembers what it was asked."""

    def __init__(self, *boxes):
        self.boxes, self.asked = boxes, "nothing yet"

    def detect(self, frame, labels):
        self.asked = labels
        return self.boxes


def test_links_left_out_are_skipped(room):
    detector = Boxes(
        Box(np.array([10.0, 20.0, 30.0, 50.0]), "cup", 0.9),
        Box(np.array([-5.0, 0.0, 500.0, 9.0]), "rug", 0.2),
    )
    detections = make(others={"detector": detector}, segmenter=None, min_score=0.5).detect(room)
    assert detector.asked is None
    assert [(d.label, np.count_nonzero(d.mask)) for d in detections] == [("cup", 600)]
    assert detections[0].box_xyxy.tolist() == [10, 20, 30, 50]
    both = make(others={"detector": detector}, segmenter=None).detect(room)
    assert both[1].box_xyxy.tolist() == [0, 0, 160, 9]


def test_runners_up_of_a_box_reach_its_detection(room):
    considered = (("cup", 0.9), ("bowl", 0.05))
    detector = Boxes(Box(np.array([10.0, 20.0, 30.0, 50.0]), "cup", 0.9, label_scores=considered))
    (found,) = make(others={"detector": detector}, segmenter=None).detect(room)
    assert found.label_scores == considered


def test_labels_of_the_tagger_reach_the_detector(room):
    detector = Boxes()
    assert (
        make(others={"detector": detector}, tagger={"use": "fixed", "labels": ["a", "b"]}).detect(room) == []
    )
    assert detector.asked == ("a", "b")


def test_faults_of_a_link_are_named_before_the_next_one_sees_them(room):
    bad = Boxes(Box(np.array([30.0, 0.0, 10.0, 5.0]), "cup", 0.9))
    with pytest.raises(CheckFailed, match="box 0: expected x0 <= x1"):
        make(others={"detector": bad}).detect(room)
    one = SimpleNamespace(segment=lambda frame, boxes: [])
    good = Boxes(Box(np.array([1.0, 1.0, 9.0, 9.0]), "cup", 0.9))
    with pytest.raises(CheckFailed, match="expected 1 masks"):
        make(others={"detector": good, "segmenter": one}).detect(room)
    empty = SimpleNamespace(tags=lambda frame: [" "])
    with pytest.raises(CheckFailed, match="tag 0 is empty"):
        make(others={"tagger": empty}, tagger={"use": "fixed", "labels": ["x"]}).detect(room)


def test_plugins_satisfy_their_protocols():
    assert isinstance(make(), Perception)
    assert isinstance(build("tagger", SimpleNamespace(use="fixed", options={"labels": ["x"]})), Tagger)
    assert isinstance(build("detector", SimpleNamespace(use="components", options={})), Detector)
    assert isinstance(build("segmenter", SimpleNamespace(use="depth", options={})), Segmenter)
    update = NoUpdate()
    assert isinstance(update, Update)
    result = check_update(update.update(None, (), (), None))
    assert (result.changes, result.windows) == ((), ())
    assert check_update(update.finish()).changes == ()
