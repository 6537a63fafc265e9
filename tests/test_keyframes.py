"""Which frames perception runs on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dssmsg.frame import Camera, Frame
from dssmsg.mission.keyframes import KeyFrameRule, KeyFrameSelector, angle_between

CAMERA = Camera(4, 3, 4.0, 4.0, 1.5, 1.0)


def frame(
    index: int, x: float = 0.0, heading: float = 0.0, *, at_stop: bool = False, visit: int = 0
) -> Frame:
    pose = np.eye(4)
    c, s = math.cos(heading), math.sin(heading)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = [s, -c, 0], [0, 0, -1], [c, s, 0]
    pose[:3, 3] = x, 0, 0.88
    return Frame(
        index=index,
        sim_time=0.2 * index,
        rgb=np.zeros((3, 4, 3), np.uint8),
        depth=np.zeros((3, 4), np.float32),
        camera=CAMERA,
        world_from_camera=pose,
        world_from_base=np.eye(4),
        visit=visit,
        at_stop=at_stop,
    )


def keys(frames: list[Frame]) -> list[int]:
    selector = KeyFrameSelector()
    return [f.index for f in frames if selector.is_key(f)]


def test_three_a_heading_at_a_stop():
    headings = [math.radians(d) for d in (-6, 0, 6, 0, -6, 54, 60, 66, 60)]
    assert keys([frame(i, heading=h, at_stop=True) for i, h in enumerate(headings)]) == [0, 1, 2, 5, 6, 7]


def test_frames_closer_than_five_degrees_are_copies():
    headings = [math.radians(d) for d in (0, 2, 4, 6)]
    assert keys([frame(i, heading=h, at_stop=True) for i, h in enumerate(headings)]) == [0, 3]


def test_driving_gives_one_each_half_metre():
    assert keys([frame(i, x=0.1 * i) for i in range(16)]) == [0, 5, 10, 15]


def test_turning_in_place_gives_none():
    assert keys([frame(i, heading=0.3 * i) for i in range(20)]) == [0]


def test_a_turn_while_driving_gives_one_each_thirty_degrees():
    found = keys([frame(i, x=0.04 * i, heading=math.radians(10) * i) for i in range(7)])
    assert found == [0, 3, 6]


def test_each_visit_counts_anew():
    first = [frame(i, heading=math.radians(6 * i), at_stop=True) for i in range(3)]
    second = [frame(3 + i, heading=math.radians(6 * i), at_stop=True, visit=1) for i in range(3)]
    assert keys([*first, *second]) == [0, 1, 2, 3, 4, 5]


@given(st.lists(st.floats(-math.pi, math.pi), min_size=1, max_size=40))
def test_a_heading_never_gets_more_than_its_share(headings):
    """However the robot looks around, the bin of the first look gets three key frames."""
    selector = KeyFrameSelector()
    frames = [frame(i, heading=heading, at_stop=True) for i, heading in enumerate(headings)]
    taken = [f for f in frames if selector.is_key(f)]
    rule = KeyFrameRule()
    same = [f for f in taken if angle_between(f.heading_rad, taken[0].heading_rad) <= rule.heading_rad]
    assert taken[0].index == 0
    assert len(same) <= rule.per_heading


@pytest.mark.parametrize(("a", "b", "want"), [(0, math.tau, 0), (3.1, -3.1, math.tau - 6.2), (1, 2, 1)])
def test_angles_wrap(a, b, want):
    assert angle_between(a, b) == pytest.approx(want)
