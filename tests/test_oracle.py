import dataclasses
import functools

import numpy as np
import pytest
from box_scene import LabelEncoder, Thing, context, look, pose_at
from dssmsg_plugins.perception import oracle
from dssmsg_plugins.perception.oracle import Oracle, OracleConfig
from pydantic import ValidationError

from dssmsg.errors import ConfigError

THINGS = [
    Thing("table", (1.5, -0.6, 0.3), (2.0, 0.0, 0.7)),
    Thing("vase", (1.6, -0.4, 0.7), (1.8, -0.2, 1.1)),
    Thing("chair", (1.5, 0.3, 0.3), (2.0, 0.8, 1.1)),
]


def make(*, encoder=None, seed=0, **config):
    return Oracle(OracleConfig(**{"min_pixels": 20, **config}), context(encoder=encoder, seed=seed))


@functools.cache
def frames(count=40):
    return [look(THINGS, pose_at(0, 0, 0.01 * i, -0.1), i) for i in range(count)]


def test_without_faults_it_reports_the_truth():
    frame = frames(1)[0]
    detections = make().detect(frame)
    assert [d.label for d in detections] == ["table", "vase", "chair"]
    for number, detection in enumerate(detections, start=1):
        np.testing.assert_array_equal(detection.mask, frame.truth.instance_ids == number)
        v, u = np.nonzero(detection.mask)
        assert detection.box_xyxy.tolist() == [u.min(), v.min(), u.max() + 1, v.max() + 1]
        assert detection.score == 1.0
        assert detection.text_feature is None


def test_features_live_in_the_encoders_space():
    encoder = LabelEncoder()
    perception = make(encoder=encoder)
    assert perception.feature_space == encoder.space
    for detection in perception.detect(frames(1)[0]):
        np.testing.assert_array_equal(detection.text_feature, encoder.encode_labels([detection.label])[0])
    assert make().feature_space is None


def test_small_and_far_things_are_left_out():
    frame = frames(1)[0]
    sizes = {d.label: int(d.mask.sum()) for d in make().detect(frame)}
    assert {d.label for d in make(min_pixels=sizes["vase"] + 1).detect(frame)} == {"table", "chair"}
    assert make(max_range=1.0).detect(frame) == []


def test_a_source_without_truth_is_refused_with_a_way_out():
    with pytest.raises(ConfigError, match="oracle needs a simulator's truth; source rgbd has none") as error:
        Oracle(OracleConfig(), context(has_truth=False, name="rgbd"))
    assert error.value.key == "perception.use"


def test_a_frame_without_truth_is_an_error():
    with pytest.raises(ValueError, match="frame 0 comes without truth"):
        make().detect(frames(1)[0].without_truth())


def test_missed_share_is_as_dialled():
    seen = sum(len(make(miss_rate=0.3).detect(frame)) for frame in frames())
    assert 0.55 < seen / 120 < 0.85


def test_split_masks_are_two_parts_of_the_whole():
    frame = frames(1)[0]
    whole, parts = make().detect(frame), make(split_rate=1.0).detect(frame)
    assert len(parts) == 6
    for index, detection in enumerate(whole):
        first, second = parts[2 * index].mask, parts[2 * index + 1].mask
        assert not (first & second).any()
        np.testing.assert_array_equal(first | second, detection.mask)


def test_merged_masks_take_in_a_neighbour():
    frame = frames(1)[0]
    merged = make(merge_rate=1.0).detect(frame)
    whole = make().detect(frame)
    assert len(merged) == 2  # table and vase touch in the image, the chair stands alone
    assert sum(int(d.mask.sum()) for d in merged) == sum(int(d.mask.sum()) for d in whole)


def test_wrong_labels_come_from_the_confusion_or_the_scene():
    labels = [d.label for frame in frames() for d in make(wrong_label_rate=0.5).detect(frame)]
    assert set(labels) == {"table", "vase", "chair"}
    wrong = sum(label != true for label, true in zip(labels, ["table", "vase", "chair"] * 40, strict=True))
    assert 0.35 < wrong / 120 < 0.65
    confused = make(wrong_label_rate=1.0, confusion={"vase": ["jug"]}).detect(frames(1)[0])
    assert confused[1].label == "jug"
    assert confused[0].label in {"vase", "chair"}


def test_mask_errors_move_the_rim_and_drops_punch_holes():
    frame = frames(1)[0]
    clean = make().detect(frame)[2].mask
    rim = make(mask_error_px=3, seed=1).detect(frame)[2].mask
    assert 0 < np.count_nonzero(rim ^ clean) < np.count_nonzero(clean)
    holes = make(depth_drop_rate=0.4).detect(frame)[2].mask
    assert not (holes & ~clean).any()
    assert 0.5 < np.count_nonzero(holes) / np.count_nonzero(clean) < 0.7


def test_faults_depend_on_seed_frame_and_instance_only():
    """The order of frames, and other dials, leave a fault's draws alone."""

    def labels(order, **config):
        perception = make(miss_rate=0.4, **config)
        return {i: [d.label for d in perception.detect(frames()[i])] for i in order}

    forward, backward = labels(range(10)), labels(reversed(range(10)))
    assert forward == backward
    assert labels(range(10), seed=1) != forward
    boxes = [d.box_xyxy.tolist() for f in frames(10) for d in make(miss_rate=0.4).detect(f)]
    wrong = [
        d.box_xyxy.tolist() for f in frames(10) for d in make(miss_rate=0.4, wrong_label_rate=1).detect(f)
    ]
    assert boxes == wrong


def test_it_registers_as_one_that_needs_truth():
    calls = []
    oracle.register_perception(lambda *args, **kwargs: calls.append((args, kwargs)))
    ((name, factory), options) = calls[0]
    assert name == "oracle"
    assert options == {"config": OracleConfig, "needs_truth": True}
    assert factory(OracleConfig(), dataclasses.replace(context())).detect(frames(1)[0])


@pytest.mark.parametrize("bad", [{"miss_rate": 1.5}, {"min_pixels": 0}, {"mis_rate": 0.1}, {"score": 0}])
def test_options_are_checked(bad):
    with pytest.raises(ValidationError):
        OracleConfig(**bad)


def test_every_option_is_described():
    assert all(field.description for field in OracleConfig.model_fields.values())
