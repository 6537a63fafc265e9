"""Viewpoint fusion and waypoint topology on drives that are written down as poses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dssmsg.frame import Camera, Frame
from dssmsg.graph import changes as c
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.graph.waypoints import WaypointTopology

CAMERA = Camera.from_fov(4, 3, 1.2)
AHEAD = 0.047  # of the robot's axis, as the camera is mounted


def frame(
    x: float, y: float, heading_deg: float, tilt_deg: float = -20, visit: int = 0, stop: bool = False
) -> Frame:
    """A frame with the robot's base at (x, y), looking somewhere."""
    heading, tilt = math.radians(heading_deg), math.radians(tilt_deg)
    forward = np.array(
        [math.cos(heading) * math.cos(tilt), math.sin(heading) * math.cos(tilt), math.sin(tilt)]
    )
    right = np.array([math.sin(heading), -math.cos(heading), 0.0])
    world_from_camera, world_from_base = np.eye(4), np.eye(4)
    world_from_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    world_from_base[:3, 3] = x, y, 0.0
    world_from_camera[:3, 3] = x + AHEAD * math.cos(heading), y + AHEAD * math.sin(heading), 0.88
    image, depth = np.zeros((3, 4, 3), np.uint8), np.zeros((3, 4), np.float32)
    return Frame(0, 0.0, image, depth, CAMERA, world_from_camera, world_from_base, visit, stop)


class Drive:
    """A graph, its topology, and what each key frame became."""

    def __init__(self) -> None:
        self.graph = SceneGraph()
        self.topology = WaypointTopology(self.graph, IdAllocator())

    def see(self, *frames: Frame) -> list[str | None]:
        """Observe key frames; the viewpoint of each."""
        viewpoints = []
        for index, key_frame in enumerate(frames):
            viewpoint, changes = self.topology.observe(key_frame)
            self.graph.apply_all(changes, index, index / 5)
            viewpoints.append(viewpoint)
        return viewpoints

    def paths(self) -> set[tuple[str, str]]:
        """The path edges, by numbers of their waypoints."""
        ends = (key[1:] for key in self.graph.edges if key[0] == "path")
        return {(a.removeprefix("waypoint-"), b.removeprefix("waypoint-")) for a, b in ends}


def looks(x: float, y: float, headings: Sequence[float], tilt: float = 0, **more: object) -> list[Frame]:
    """Three key frames a heading at a stop, at -6, 0 and +6 degrees."""
    return [frame(x, y, h + d, tilt, stop=True, **more) for h in headings for d in (-6, 0, 6)]  # type: ignore[arg-type]


@pytest.mark.parametrize("step", [24, 30, 40, 45, 60, 90])
def test_three_key_frames_of_a_heading_share_a_viewpoint_and_each_heading_has_its_own(step: int) -> None:
    headings = range(170, 170 + 360, step) if 360 % step == 0 else range(170, 170 + 360 - step, step)
    drive = Drive()
    seen = drive.see(*looks(1.0, 2.0, list(headings)))
    groups = [seen[i : i + 3] for i in range(0, len(seen), 3)]
    assert all(len(set(group)) == 1 and group[0] for group in groups)
    assert len({group[0] for group in groups}) == len(groups)
    assert len(drive.graph.waypoints) == 1
    assert drive.graph.waypoints["waypoint-1"].position.tolist() == [1.0, 2.0, 0.0]
    again = drive.see(*looks(1.03, 1.98, list(headings), visit=1))
    assert again == seen
    assert drive.graph.viewpoints["viewpoint-1.1"].observations == 6


def test_a_tilt_has_viewpoints_of_its_own() -> None:
    drive = Drive()
    level, down = drive.see(frame(0, 0, 0, 0, stop=True), frame(0, 0, 0, -25, stop=True))
    assert level != down
    assert drive.see(frame(0, 0, 3, -20), frame(0, 0, 0, 5)) == [down, level]
    assert drive.see(frame(0, 0, 0, -12)) == ["viewpoint-1.3"]


def test_driving_makes_viewpoints_by_distance_and_turning() -> None:
    drive = Drive()
    seen = drive.see(*(frame(x / 10, 0, 0) for x in range(16)))
    assert [seen.index(f"viewpoint-{n}.1") for n in (1, 2, 3)] == [0, 6, 12]
    assert None not in seen
    assert drive.paths() == {("1", "2"), ("2", "3")}
    turned = drive.see(frame(1.5, 0, 19), frame(1.5, 0, 25), frame(1.5, 0, 31))
    assert turned[0] == seen[-1]
    assert turned[1] is None
    assert turned[2] not in {*seen, None}


def test_an_edge_says_how_it_is_known() -> None:
    drive = Drive()
    drive.see(frame(0, 0, 90), frame(0, 0.6, 90))
    (edge,) = [edge for edge in drive.graph.edges.values() if edge.kind == "path"]
    assert (edge.source, edge.target) == ("waypoint-1", "waypoint-2")
    assert dict(edge.attributes) == {"length": pytest.approx(0.6), "verified": "driven", "blocked": False}
    blocked = {"edge": "path", "source": "waypoint-1", "target": "waypoint-2"}
    change = c.EdgeChanged(
        cause=c.Cause("t", "t"), **blocked, attributes={"blocked": True, "verified": "seen"}
    )
    drive.graph.apply(change)
    drive.see(frame(0, 0, 90), frame(0, 0.6, 90))
    assert drive.graph.edges["path", "waypoint-1", "waypoint-2"].attributes["blocked"] is True
    drive.graph.apply(
        c.EdgeChanged(cause=c.Cause("t", "t"), **blocked, attributes={"blocked": False, "verified": "seen"})
    )
    drive.see(frame(0, 0, 90))
    assert drive.graph.edges["path", "waypoint-1", "waypoint-2"].attributes["verified"] == "driven"


def test_the_way_back_reuses_waypoints_with_new_viewpoints() -> None:
    drive = Drive()
    drive.see(*(frame(x * 0.6, 0, 0) for x in range(4)))
    there = set(drive.paths())
    back = drive.see(*(frame(x * 0.6, 0.1, 180) for x in reversed(range(4))))
    assert len(set(back)) == 4
    assert all(viewpoint.endswith(".2") for viewpoint in back if viewpoint)
    assert drive.paths() == there
    assert len(drive.graph.waypoints) == 4


def test_a_later_visit_beside_known_places_stays_connected() -> None:
    drive = Drive()
    drive.see(*(frame(x * 0.6, 0, 0) for x in range(5)))
    drive.see(*(frame(x * 0.6, 0.4, 0, visit=1) for x in range(5)), frame(2.4, 1.0, 90, visit=1))
    assert len(drive.graph.waypoints) == 6
    assert ("5", "6") in drive.paths()


def test_a_robot_that_was_carried_leaves_no_path() -> None:
    drive = Drive()
    drive.see(frame(0, 0, 0), frame(0.6, 0, 0))
    drive.see(frame(5, 0, 0, visit=1), frame(5.6, 0, 0, visit=1))
    assert drive.paths() == {("1", "2"), ("3", "4")}
    drive.see(frame(5.6, 0, 90, visit=2), frame(5.6, 0.6, 90, visit=2))  # continuous: it was driven on
    assert ("4", "5") in drive.paths()
    drive.see(frame(9.0, 0.6, 90, visit=2), frame(9.0, 1.2, 90, visit=2))  # frames are missing
    assert ("6", "7") in drive.paths()
    assert ("5", "6") not in drive.paths()


def test_every_visit_begins_with_a_viewpoint() -> None:
    drive = Drive()
    drive.see(frame(0, 0, 0))
    assert drive.see(frame(0, 0, 25)) == [None]
    assert drive.see(frame(0, 0, 25, visit=1)) == ["viewpoint-1.2"]


def test_a_place_that_left_the_graph_is_not_driven_from() -> None:
    drive = Drive()
    drive.see(frame(0, 0, 0))
    drive.graph.apply(c.WaypointRemoved(cause=c.Cause("t", "t"), waypoint_id="waypoint-1"))
    assert drive.see(frame(0.6, 0, 0)) == ["viewpoint-2.1"]
    assert drive.paths() == set()


def test_looking_straight_down_has_a_heading_too() -> None:
    assert Drive().see(frame(0, 0, 0, -90), frame(0, 0, 3, -90)) == ["viewpoint-1.1"] * 2


def test_scores_say_what_decided() -> None:
    drive = Drive()
    drive.see(frame(0, 0, 0))
    _, (seen,) = drive.topology.observe(frame(0.3, 0, 5))
    values = {score.name: (score.value, score.threshold) for score in seen.scores}
    assert values["distance_m"] == (pytest.approx(0.3, abs=1e-3), 0.5)
    assert values["heading_rad"] == (pytest.approx(math.radians(5)), pytest.approx(math.radians(20)))


legs = st.lists(st.tuples(st.sampled_from(range(0, 360, 45)), st.integers(1, 6), st.booleans()), max_size=12)


@settings(max_examples=50, deadline=None)
@given(legs, st.floats(0.05, 0.25))
def test_whatever_is_driven_is_connected_and_waypoints_keep_apart(
    legs: list[tuple[int, int, bool]], step: float
) -> None:
    drive = Drive()
    x = y = 0.0
    drive.see(frame(x, y, 0))
    for heading, steps, stops in legs:
        drive.see(frame(x, y, heading))
        for _ in range(2 * steps):
            x += step * math.cos(math.radians(heading))
            y += step * math.sin(math.radians(heading))
            drive.see(frame(x, y, heading))
        if stops:
            drive.see(*looks(x, y, [heading, heading + 90]))
    topology = networkx.Graph()
    topology.add_nodes_from(drive.graph.waypoints)
    topology.add_edges_from(key[1:] for key in drive.graph.edges if key[0] == "path")
    assert networkx.is_connected(topology)
    places = [waypoint.position for waypoint in drive.graph.waypoints.values()]
    assert all(math.dist(a, b) > 0.25 for i, a in enumerate(places) for b in places[:i])
    assert all(edge.attributes["length"] <= 1.6 for edge in drive.graph.edges.values())
    assert all(waypoint.viewpoints for waypoint in drive.graph.waypoints.values())
