"""The survey drives a tour in a world without obstacles, and gives up on a stop that it cannot reach."""

from __future__ import annotations

import math
from dataclasses import replace

from test_drive import Unicycle

from dssmsg.interfaces import Stop
from dssmsg.mission.keyframes import KeyFrameSelector
from dssmsg.mission.survey import Surveyor
from dssmsg.navigation.drive import Driver, wrap_angle


def drive(tour, *, blocked=False, frames=800):
    """Frames (with at_stop) and the surveyor after the tour."""
    robot, surveyor = Unicycle(), Surveyor(tour, Driver())
    seen = []
    for _ in range(frames):
        frame = robot.frame()
        step = surveyor.advance(frame)
        if step is None:
            break
        seen.append(replace(frame, at_stop=step.at_stop))
        if step.state == "done":
            break
        command = replace(step.command, linear=0.0) if blocked else step.command
        robot.step(command)
    return seen, surveyor


TOUR = (
    Stop("a", 1.0, 0.0, ((0.0, 0.0), (1.5, 0.0), (1.5, -0.4))),
    Stop("b", 1.0, 2.0, ((-2.0, 0.0), (3.0, -0.4)), via=((2.0, 0.0), (2.0, 2.0))),
)


def test_every_view_gets_three_different_looks():
    seen, surveyor = drive(TOUR)
    assert surveyor.skipped == []
    for stop in TOUR:
        for heading, tilt in stop.views:
            looks = [
                frame.heading_rad
                for frame in seen
                if frame.at_stop
                and math.hypot(frame.position[0] - stop.x, frame.position[1] - stop.y) < 0.1
                and abs(frame.tilt_rad - tilt) < 0.02
                and abs(wrap_angle(frame.heading_rad - heading)) < math.radians(8)
            ]
            offsets = sorted(round(math.degrees(wrap_angle(h - heading))) for h in looks)
            assert offsets == [-6, 0, 6], (stop.name, heading, tilt)


def test_looks_become_key_frames():
    seen, _ = drive(TOUR)
    selector = KeyFrameSelector()
    key = [frame for frame in seen if selector.is_key(frame)]
    assert sum(frame.at_stop for frame in key) == 15


def test_via_points_are_driven_through():
    seen, _ = drive(TOUR)
    for corner in TOUR[1].via:
        assert min(math.dist(frame.position[:2], corner) for frame in seen) < 0.1


def test_a_stop_out_of_reach_is_skipped_and_named():
    seen, surveyor = drive(TOUR, blocked=True)
    assert surveyor.skipped == ["a", "b"]
    assert len(seen) < 200


def test_looking_is_quick():
    """The budget of a visit is 600 frames: a view 60 degrees on costs at most 9."""
    tour = (Stop("a", 0.0, 0.0, tuple((math.radians(60 * i), 0.0) for i in range(6))),)
    seen, _ = drive(tour)
    assert len(seen) <= 6 * 9


def test_a_view_that_cannot_be_reached_is_skipped_and_named():
    tour = (Stop("a", 0.0, 0.0, ((1.0, 0.0),)), Stop("b", 0.0, 0.0, ((2.0, -9.0),)))
    seen, surveyor = drive(tour, frames=400)
    assert len(seen) < 200
    assert len(surveyor.skipped) == 3
    assert all("at b" in name for name in surveyor.skipped)
