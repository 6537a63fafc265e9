"""Images laid into a model's input and boxes taken back out: laws that hold for every size."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dssmsg.onnx.letterbox import Fit, lay_in, planes, resize
from dssmsg.onnx.masks import image_mask, sample
from dssmsg.onnx.nms import nms

LAYOUTS = ("letterbox", "square", "corner", "stretch")
sizes = st.tuples(st.integers(1, 90), st.integers(1, 90))
inputs = st.tuples(st.integers(8, 96), st.integers(8, 96))
unit = st.floats(0, 1, allow_nan=False)


def laid(image_size, input_size, layout, pad=114):
    rgb = np.zeros((*image_size, 3), np.uint8)
    return lay_in(rgb, input_size, layout, pad)


@settings(max_examples=150, deadline=None)
@given(sizes, inputs, st.sampled_from(LAYOUTS), st.tuples(unit, unit, unit, unit))
def test_there_and_back_is_where_it_was(image_size, input_size, layout, shares):
    _image, fit = laid(image_size, input_size, layout)
    height, width = image_size
    box = np.array(shares) * [width, height, width, height]
    inside = fit.to_input(box)
    assert (inside >= -1e-9).all()
    assert (inside <= np.array([input_size[1], input_size[0]] * 2) + 1e-9).all()
    np.testing.assert_allclose(fit.to_image(inside), box, atol=1e-9)
    np.testing.assert_allclose(fit.to_image(fit.to_input(box.reshape(2, 2))).ravel(), box, atol=1e-9)


@settings(max_examples=80, deadline=None)
@given(sizes, inputs, st.sampled_from(("letterbox", "corner", "stretch")))
def test_the_rim_is_all_that_the_image_does_not_cover(image_size, input_size, layout):
    image, fit = laid(image_size, input_size, layout, pad=200)
    height, width = image_size
    corners = fit.to_input(np.array([0.0, 0.0, width, height]))
    left, top, right, bottom = np.rint(corners).astype(int)
    np.testing.assert_allclose(corners, [left, top, right, bottom], atol=1e-9)
    assert image.shape == (*input_size, 3)
    expected = np.full(input_size, 200)
    expected[top:bottom, left:right] = 0
    assert np.array_equal(image[..., 0], expected)


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.integers(20, 80), st.integers(20, 80)),
    st.sampled_from(LAYOUTS),
    st.tuples(unit, unit),
)
def test_a_thing_in_the_image_is_found_where_its_box_says(image_size, layout, place):
    """The contents move as the coordinates do: a bright block's edges lie at its mapped box, to a pixel."""
    height, width = image_size
    side = 8
    top, left = int(place[0] * (height - side)), int(place[1] * (width - side))
    rgb = np.zeros((height, width, 3), np.uint8)
    rgb[top : top + side, left : left + side] = 255
    image, fit = lay_in(rgb, (128, 128), layout, 0)
    rows, columns = np.nonzero(image[..., 0] > 127)
    found = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    box = np.array([left, top, left + side, top + side])
    np.testing.assert_allclose(found, fit.to_input(box), atol=1.01)


def test_layouts_put_the_image_where_the_exporters_do():
    rgb = np.full((30, 60, 3), 255, np.uint8)
    assert laid((30, 60), (64, 64), "letterbox")[1] == Fit((30, 60), (64, 64), (32.0, 64.0), (16.0, 0.0))
    assert laid((30, 60), (64, 64), "corner")[1].offset == (0.0, 0.0)
    square, fit = lay_in(rgb, (120, 120), "square", 0)
    assert fit.offset == (30.0, 0.0)
    assert square[29:31, 60, 0].min() < square[32, 60, 0] == 255
    stretched, fit = lay_in(rgb, (64, 64), "stretch")
    assert (stretched == 255).all()
    assert fit.scale == (64 / 30, 64 / 60)


def test_boxes_are_cut_at_the_image():
    _image, fit = laid((30, 60), (64, 64), "letterbox")
    assert fit.clip(np.array([[-5.0, -5, 99, 99], [1, 2, 3, 4]])).tolist() == [[0, 0, 60, 30], [1, 2, 3, 4]]


def test_planes_are_channels_first_and_normalised():
    rgb = np.zeros((2, 3, 3), np.uint8)
    rgb[..., 1] = 255
    values = planes(rgb, (0.5, 0.5, 0.5), (0.5, 0.25, 0.5))
    assert values.shape == (1, 3, 2, 3)
    assert values[0, :, 0, 0].tolist() == [-1.0, 2.0, -1.0]
    assert resize(rgb, (2, 3)) is rgb


# Masks from small maps.


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.integers(20, 90), st.integers(20, 90)),
    st.sampled_from(("letterbox", "corner", "stretch")),
    st.floats(0.2, 0.8),
    st.floats(0.2, 0.8),
)
def test_a_mask_comes_back_from_the_models_frame(image_size, layout, share_x, share_y):
    """A map whose logits change sign along a line gives a mask that ends at that line of the image."""
    _image, fit = laid(image_size, (128, 128), layout)
    height, width = image_size
    edge_x, edge_y = share_x * width, share_y * height
    at_x, at_y = fit.to_input(np.array([edge_x, edge_y]))
    cells = (np.arange(32) + 0.5) * 4
    for logits, expected in (
        (np.tile(at_x - cells, (32, 1)), np.tile(np.arange(width) + 0.5 < edge_x, (height, 1))),
        (np.tile(at_y - cells, (32, 1)).T, np.tile(np.arange(height) + 0.5 < edge_y, (width, 1)).T),
    ):
        mask = image_mask(logits, fit)
        assert mask.shape == image_size
        assert (mask != expected).mean() <= 1.01 / min(image_size)


def test_a_mask_keeps_to_its_box():
    _image, fit = laid((20, 40), (64, 64), "letterbox")
    mask = image_mask(np.ones((16, 16)), fit, np.array([3.2, 4.0, 9.0, 8.6]))
    rows, columns = np.nonzero(mask)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (4, 8, 3, 8)
    for box in ([50.0, 5, 60, 9], [3.0, 3, 3, 3], [-9.0, 0, -1, 5]):
        assert not image_mask(np.ones((16, 16)), fit, np.array(box)).any()


def test_sampling_is_linear_and_stops_at_the_rim():
    values = np.array([[0.0, 1.0], [2.0, 3.0]], np.float32)
    assert sample(values, np.array([0.5]), np.array([0.5])).tolist() == [[1.5]]
    assert sample(values, np.array([-3.0, 9.0]), np.array([-3.0, 9.0])).tolist() == [[0, 1], [2, 3]]
    assert sample(values[:1, :1], np.array([0.7]), np.array([0.0])).tolist() == [[0.0]]


# Suppression.


def iou(a, b):
    low, high = np.maximum(a[:2], b[:2]), np.minimum(a[2:], b[2:])
    shared = np.prod(np.clip(high - low, 0, None))
    union = np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - shared
    return shared / union if union > 0 else 0.0


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 2**31), st.integers(0, 25), st.floats(0, 0.9), st.integers(1, 30))
def test_what_stays_is_far_apart_and_what_goes_was_near_a_better_one(seed, count, limit_iou, most):
    draw = np.random.default_rng(seed)
    low = draw.uniform(0, 50, (count, 2))
    boxes = np.concatenate([low, low + draw.uniform(0, 40, (count, 2))], axis=1)
    scores = draw.choice([0.1, 0.5, 0.9], count)
    classes = draw.integers(0, 2, count)
    kept = nms(boxes, scores, classes, limit_iou, most).tolist()
    assert len(kept) <= most
    assert all(scores[a] >= scores[b] for a, b in pairwise(kept))
    for place, a in enumerate(kept):
        for b in kept[:place]:
            assert classes[a] != classes[b] or iou(boxes[a], boxes[b]) <= limit_iou + 1e-12
    if len(kept) < most:
        for gone in set(range(count)) - set(kept):
            assert any(
                classes[one] == classes[gone]
                and scores[one] >= scores[gone]
                and iou(boxes[one], boxes[gone]) > limit_iou
                for one in kept
            )


def test_a_flood_of_boxes_is_cut():
    boxes = np.tile(np.arange(20_000.0)[:, None] * 10, (1, 4)) + np.array([0, 0, 5, 5])
    assert len(nms(boxes, np.ones(20_000), np.zeros(20_000), 0.5, 50)) == 50


@pytest.mark.parametrize("box", [[5.0, 5, 5, 5], [9.0, 9, 3, 3]])
def test_a_box_without_area_suppresses_nothing(box):
    boxes = np.array([box, [0.0, 0, 10, 10]])
    assert nms(boxes, np.array([0.9, 0.8]), np.zeros(2), 0.0, 9).tolist() == [0, 1]
