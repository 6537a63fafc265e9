"""The static scorer on cases worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from dssmsg.evaluate.static import score_static
from dssmsg.evaluate.visible import Place, VisibleTruth
from dssmsg.frame import Camera, Frame, Truth, TruthObject
from dssmsg.graph.nodes import ObjectNode


def box(x, size=1.0):
    return np.array([x, 0.0, 0.0]), np.array([x + size, size, size])


def node(number, label, x, *, size=1.0, status="believed"):
    low, high = box(x, size)
    return ObjectNode(
        id=f"object-{number}",
        label=label,
        votes={label: 1.0},
        status=status,
        state="static",
        dynamic_attribute=None,
        points=np.zeros((0, 3), np.float32),
        colors=np.zeros((0, 3), np.uint8),
        box_min=low,
        box_max=high,
        observations=3,
        frames=(),
        viewpoints=(),
        first_seen=0.0,
        last_seen=0.0,
    )


def place(name, label, x, *, frames=5, state="static", size=1.0):
    low, high = box(x, size)
    return Place(name, label, state, frames, low, high, low, high)


def test_all_right():
    score = score_static([node(1, "sofa", 0)], [place("sofa-1", "sofa", 0)])
    assert (score.precision, score.recall, score.f1) == (1.0, 1.0, 1.0)
    assert score.median_centre_error_m == 0.0


def test_wrong_label_costs_both():
    score = score_static([node(1, "bed", 0)], [place("sofa-1", "sofa", 0)])
    assert (score.precision, score.recall) == (0.0, 0.0)
    assert score.missed == ("sofa-1",)
    assert score.wrong == ("object-1 (bed)",)


def test_a_split_object_is_one_right_and_one_wrong():
    score = score_static([node(1, "sofa", 0.0), node(2, "sofa", 0.2)], [place("sofa-1", "sofa", 0)])
    assert (score.true_positives, score.false_positives, score.false_negatives) == (1, 1, 0)
    assert score.wrong == ("object-2 (sofa)",)


def test_the_centre_rule_is_capped_by_half_the_diagonal():
    """A cup of 8 cm at 10 cm distance: 0.3 m would accept it, half its diagonal (6.9 cm) does not."""
    score = score_static([node(1, "cup", 0.1, size=0.08)], [place("cup-1", "cup", 0.0, size=0.08)])
    assert score.true_positives == 0
    near = score_static([node(1, "cup", 0.06, size=0.08)], [place("cup-1", "cup", 0.0, size=0.08)])
    assert near.true_positives == 1


def test_below_the_bar_is_ignored():
    truth = [place("sofa-1", "sofa", 0, frames=2), place("mug-1", "mug", 5, state="moved")]
    score = score_static([node(1, "sofa", 0), node(2, "mug", 5), node(3, "mug", 9)], truth)
    assert (score.true_positives, score.false_positives, score.false_negatives) == (0, 1, 0)
    assert score.ignored == 2


def test_tentative_objects_do_not_count():
    score = score_static([node(1, "sofa", 0, status="tentative")], [place("sofa-1", "sofa", 0)])
    assert (score.true_positives, score.false_positives, score.false_negatives) == (0, 0, 1)


@pytest.mark.parametrize(("pixels", "distance", "seen"), [(200, 2.0, 1), (199, 2.0, 0), (400, 4.5, 0)])
def test_visible_means_200_pixels_within_4_metres(pixels, distance, seen):
    camera = Camera(40, 30, 40.0, 40.0, 19.5, 14.5)
    ids = np.zeros((30, 40), np.int32)
    ids.reshape(-1)[:pixels] = 7
    depth = np.full((30, 40), distance, np.float32)
    pose = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1], [0, 0, 0, 1]], float)
    frame = Frame(0, 0.0, np.zeros((30, 40, 3), np.uint8), depth, camera, pose, np.eye(4))
    known = TruthObject(7, "sofa-1", "sofa", np.array([1.0, -3, 0]), np.array([5.0, 3, 3]))
    visible = VisibleTruth()
    visible.add(frame, Truth(ids, (known,)))
    (only,) = visible.places()
    assert only.frames == seen
    if seen:
        assert only.surface_min is not None
        assert only.surface_min[0] == pytest.approx(distance)
