"""Topology maintenance on graphs written by hand, with a floor that says what the test wants."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from time import process_time

import numpy as np
import pytest
from floor_graph import CAUSE, FloorGraph

from dssmsg.graph import changes as c
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.paths import edge_key, shortest_path
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.graph.topology import TopologyMaintenance


@dataclass
class Strip:
    cells: int = 0
    free: float = 1.0
    fresh: float = 1.0


@dataclass
class Floor:
    """Free everywhere, but where `walls` (a box x0, y0, x1, y1 each) says otherwise; fresh as told."""

    walls: list = field(default_factory=list)
    fresh: float = 1.0

    def corridor(self, start, end, half_width):
        points = np.linspace(start, end, 50)
        hit = any(
            ((points[:, 0] > x0) & (points[:, 0] < x1) & (points[:, 1] > y0) & (points[:, 1] < y1)).any()
            for x0, y0, x1, y1 in self.walls
        )
        return Strip(int(hit), 0.0 if hit else 1.0, 0.0 if hit else self.fresh)


@pytest.fixture
def row():
    """Three waypoints in a row, 2 m apart, joined; an object seen from the last one."""
    floor = FloorGraph()
    names = [floor.waypoint(2.0 * i, 0.0) for i in range(3)]
    floor.path(names[0], names[1])
    floor.path(names[1], names[2])
    floor.thing("lamp", 4.5, 0.0, ["viewpoint-3.1"])
    return floor


def block(floor, a, b, obstacle=None):
    kind, source, target = edge_key(a, b)
    attributes = {"blocked": True} if obstacle is None else {"blocked": True, "obstacle": obstacle}
    floor.add(c.EdgeChanged(cause=CAUSE, edge=kind, source=source, target=target, attributes=attributes))


def keeper(floor, ground):
    ids = IdAllocator()
    for _ in floor.graph.waypoints:
        ids.new("waypoint")
    return TopologyMaintenance(floor.graph, ids, ground)


def watch(floor, maintenance, base, frames, closures=False, keep=None):
    """Let frames pass; all changes, applied."""
    found = []
    for frame in range(frames):
        changes = maintenance.observe(np.array([*base, 0.0]), closures=closures, keep=keep)
        found += floor.graph.apply_all(changes, frame, frame / 5)
    return found


def test_a_candidate_is_put_back_after_five_clear_frames_in_a_row(row):
    ground = Floor()
    maintenance = keeper(row, ground)
    block(row, "waypoint-1", "waypoint-2", [1.0, 0.0])
    assert shortest_path(row.graph, "waypoint-1", "waypoint-3") is None
    assert watch(row, maintenance, (0, 0), 4, keep="waypoint-1") == []
    ground.walls = [(0.8, -0.5, 1.2, 0.5)]
    assert watch(row, maintenance, (0, 0), 1, keep="waypoint-1") == []  # the count begins anew
    ground.walls = []
    assert watch(row, maintenance, (0, 0), 4, keep="waypoint-1") == []
    (change,) = watch(row, maintenance, (0, 0), 1, keep="waypoint-1")
    assert (change.cause.rule, change.scores[0].value, change.scores[0].threshold) == ("seen_clear", 5.0, 5.0)
    assert shortest_path(row.graph, "waypoint-1", "waypoint-3") is not None


def test_a_frame_that_does_not_see_the_place_says_nothing(row):
    ground = Floor(fresh=0.0)
    maintenance = keeper(row, ground)
    block(row, "waypoint-1", "waypoint-2", [1.0, 0.0])
    assert watch(row, maintenance, (0, 0), 20, keep="waypoint-1") == []
    ground.fresh = 1.0
    assert len(watch(row, maintenance, (0, 0), 5, keep="waypoint-1")) == 1


def test_an_isolated_waypoint_leaves_and_comes_back_with_what_it_saw(row):
    ground = Floor(walls=[(2.5, -0.5, 3.5, 0.5)])
    maintenance = keeper(row, ground)
    block(row, "waypoint-2", "waypoint-3", [3.0, 0.0])
    changes = watch(row, maintenance, (2, 0), 1)
    assert [(change.kind, change.subjects) for change in changes] == [("waypoint_removed", ("waypoint-3",))]
    assert "viewpoint-3.1" not in row.graph.viewpoints
    assert not list(row.graph.edges_of("object-1"))
    assert watch(row, maintenance, (2, 0), 10) == []
    ground.walls = []
    changes = watch(row, maintenance, (2, 0), 5)
    assert {change.cause.rule for change in changes} == {"put_back"}
    assert row.graph.waypoints["waypoint-4"].viewpoints == ("viewpoint-4.1",)
    assert ("sees", "viewpoint-4.1", "object-1") in row.graph.edges
    assert shortest_path(row.graph, "waypoint-1", "waypoint-4") is not None
    assert watch(row, maintenance, (2, 0), 5) == []


def test_the_waypoint_that_the_robot_is_at_stays(row):
    ground = Floor(walls=[(2.5, -0.5, 3.5, 0.5)])
    block(row, "waypoint-2", "waypoint-3", [3.0, 0.0])
    assert watch(row, keeper(row, ground), (4, 0), 3, keep="waypoint-3") == []


def test_a_loop_closes_in_free_line_of_sight_only():
    floor = FloorGraph()
    names = [floor.waypoint(x, y) for x, y in ((0, 0), (2, 0), (2, 2), (0, 2))]
    for a, b in itertools.pairwise(names):
        floor.path(a, b)
    walled = keeper(floor, Floor(walls=[(-0.5, 0.8, 0.5, 1.2), (0.9, 0.9, 1.1, 1.1)]))
    assert watch(floor, walled, (0, 0), 1, closures=True) == []
    (change,) = watch(floor, keeper(floor, Floor()), (0, 0), 1, closures=True)
    assert change.subjects == (
        "waypoint-1",
        "waypoint-4",
    )  # 2 m instead of 6 m; the diagonals gain too little
    assert change.attributes["verified"] == "seen"
    assert watch(floor, keeper(floor, Floor()), (0, 0), 3, closures=True) == []


def test_no_closure_through_an_object_that_depth_looks_under():
    floor = FloorGraph()
    floor.waypoint(0, 0)
    floor.waypoint(0, 2)
    floor.thing("table", 0.0, 1.0, ["viewpoint-1.1"])
    assert watch(floor, keeper(floor, Floor()), (0, 0), 1, closures=True) == []


def test_all_of_it_folds(row):
    ground = Floor(walls=[(2.5, -0.5, 3.5, 0.5)])
    maintenance = keeper(row, ground)
    block(row, "waypoint-2", "waypoint-3", [3.0, 0.0])
    before = row.graph.updates
    changes = watch(row, maintenance, (2, 0), 1)
    ground.walls = []
    changes += watch(row, maintenance, (2, 0), 5)
    assert [change.update for change in changes] == list(range(before + 1, row.graph.updates + 1))
    assert isinstance(row.graph, SceneGraph)


def test_a_frame_costs_the_same_however_large_the_map_is():
    def seconds(count):
        floor = FloorGraph()
        names = [floor.waypoint(1.5 * i, 0.0) for i in range(count)]
        for a, b in itertools.pairwise(names):
            floor.path(a, b)
        maintenance = keeper(floor, Floor())
        best = math.inf
        for _ in range(5):
            start = process_time()
            for _ in range(5):
                maintenance.observe(np.zeros(3), closures=True)
            best = min(best, process_time() - start)
        return best

    assert seconds(1000) < 2.0 * seconds(20)  # 50 times as many waypoints
