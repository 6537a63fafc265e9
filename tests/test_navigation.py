"""Ways over the topology, and `dijkstra` driving a unicycle along them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from dssmsg_plugins.navigation.dijkstra import Config, Dijkstra
from floor_graph import CAUSE, FloorGraph, camera_pose, context
from hypothesis import given, settings
from hypothesis import strategies as st

from dssmsg.checks import check_step
from dssmsg.frame import Camera, Frame, quantise_depth
from dssmsg.graph import changes as c
from dssmsg.graph.paths import edge_key, nearest_waypoints, path_length, shortest_path
from dssmsg.interfaces import Command

CAMERA = Camera.from_fov(160, 120, math.radians(69.4))


class Robot:
    """A unicycle that follows commands at once, and sees a post of 0.1 m radius where one is put."""

    def __init__(self, x, y, heading=0.0):
        self.x, self.y, self.heading, self.pan, self.tilt = x, y, heading, 0.0, 0.0
        self.posts, self.index, self.trail = [], 0, [(x, y)]
        self.gazes = []

    def step(self, command):
        for _ in range(20):
            self.heading += command.angular * 0.01
            self.x += command.linear * 0.01 * math.cos(self.heading)
            self.y += command.linear * 0.01 * math.sin(self.heading)
        self.pan, self.tilt = command.pan, command.tilt
        self.trail.append((self.x, self.y))
        self.index += 1

    def frame(self):
        pose = camera_pose(self.x, self.y, self.heading + self.pan, self.tilt)
        self.gazes.append((self.heading + self.pan, self.tilt))
        base = np.eye(4)
        base[:2, :2] = [
            [math.cos(self.heading), -math.sin(self.heading)],
            [math.sin(self.heading), math.cos(self.heading)],
        ]
        base[:2, 3] = self.x, self.y
        return Frame(
            index=self.index,
            sim_time=self.index / 5,
            rgb=np.zeros((120, 160, 3), np.uint8),
            depth=quantise_depth(self._depth(pose)),
            camera=CAMERA,
            world_from_camera=pose,
            world_from_base=base,
        )

    def _depth(self, pose):
        u, v = np.meshgrid(np.arange(160), np.arange(120))
        rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones((120, 160))], -1)
        d, o = rays @ pose[:3, :3].T, pose[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(d[..., 2] < 0, -o[2] / d[..., 2], 9.0)
            for x, y in self.posts:
                a = d[..., 0] ** 2 + d[..., 1] ** 2
                b = (o[0] - x) * d[..., 0] + (o[1] - y) * d[..., 1]
                root = b * b - a * ((o[0] - x) ** 2 + (o[1] - y) ** 2 - 0.01)
                t = (-b - np.sqrt(root)) / a
                height = o[2] + t * d[..., 2]
                hit = (root > 0) & (t > 0) & (t < depth) & (height > 0) & (height < 0.8)
                depth = np.where(hit, t, depth)
        return np.minimum(depth, 9.0)


def wall(x, low, high):
    """Posts that leave no gap, from (x, low) to (x, high)."""
    return [(x, float(y)) for y in np.arange(low, high + 0.01, 0.15)]


def seek(floor, robot, goals, limit=600, **options):
    """Drive an episode as the mission does; returns the last step and all of them."""
    navigation = Dijkstra(Config(**options), context(floor.graph))
    navigation.start(robot.frame(), goals)
    robot.gazes.clear()
    steps = []
    while len(steps) < limit:
        step = check_step(navigation.step(robot.frame()))
        steps.append(step)
        if step.changes:
            floor.graph.apply_all(step.changes, robot.index, robot.index / 5)
        if step.outcome:
            return step, steps
        robot.step(step.command)
    raise AssertionError("the episode does not end")


@pytest.fixture
def square():
    """Four waypoints round a block: 1-2-3 is 3 m + 2 m, 1-4-3 is 2 m + 3 m and a bit more."""
    floor = FloorGraph()
    for x, y, heading in ((0, 0, 0.0), (3, 0, 0.0), (3, 2, 2.5), (0, 2.2, 0.0)):
        floor.waypoint(x, y, heading, -0.3)
    for a, b in ((1, 2), (2, 3), (1, 4), (3, 4)):
        floor.path(f"waypoint-{a}", f"waypoint-{b}")
    return floor


def test_shortest_path_by_length(square):
    assert shortest_path(square.graph, "waypoint-1", "waypoint-3") == (
        "waypoint-1",
        "waypoint-2",
        "waypoint-3",
    )
    assert shortest_path(square.graph, "waypoint-2", "waypoint-2") == ("waypoint-2",)
    assert path_length(square.graph, ("waypoint-1", "waypoint-2", "waypoint-3")) == pytest.approx(5.0)


def test_blocked_edges_are_no_way(square):
    _kind, source, end = edge_key("waypoint-2", "waypoint-1")
    square.add(
        c.EdgeChanged(cause=CAUSE, edge="path", source=source, target=end, attributes={"blocked": True})
    )
    assert shortest_path(square.graph, "waypoint-1", "waypoint-3") == (
        "waypoint-1",
        "waypoint-4",
        "waypoint-3",
    )


def test_no_way_to_an_island_or_from_nowhere(square):
    square.waypoint(9, 9)
    assert shortest_path(square.graph, "waypoint-1", "waypoint-5") is None
    assert shortest_path(square.graph, "waypoint-1", "waypoint-77") is None
    assert nearest_waypoints(square.graph, 8.0, 8.0, 2) == ("waypoint-5", "waypoint-3")
    assert nearest_waypoints(FloorGraph().graph, 0.0, 0.0, 1) == ()


@settings(max_examples=40, deadline=None)
@given(data=st.data(), count=st.integers(2, 6))
def test_shortest_path_against_all_ways(data, count):
    floor = FloorGraph()
    names = [floor.waypoint(i, 0) for i in range(count)]
    for a, b in itertools.combinations(names, 2):
        if data.draw(st.booleans()):
            floor.path(a, b, data.draw(st.integers(1, 9)), data.draw(st.sampled_from([False, False, True])))
    graph = floor.graph

    def length(way):
        edges = [graph.edges.get(edge_key(a, b)) for a, b in itertools.pairwise(way)]
        if any(edge is None or edge.attributes["blocked"] for edge in edges):
            return math.inf
        return path_length(graph, way)

    between = names[1:-1]
    ways = [
        (names[0], *some, names[-1])
        for n in range(len(between) + 1)
        for some in itertools.permutations(between, n)
    ]
    found = shortest_path(graph, names[0], names[-1])
    assert (math.inf if found is None else length(found)) == min(map(length, ways))


def test_drives_to_the_viewpoint_and_looks_its_way(square):
    robot = Robot(0.1, 0.05, 1.0)
    last, steps = seek(square, robot, ["viewpoint-3.1"])
    assert (last.outcome, last.state, last.goal) == ("success", "arrived", "viewpoint-3.1")
    assert math.dist((robot.x, robot.y), (3, 2)) < 0.06
    looks = [gaze for step, gaze in zip(steps, robot.gazes, strict=False) if step.at_stop]
    assert looks[0] == pytest.approx((2.5, -0.3), abs=math.radians(1))
    assert len(looks) == len(Config().look_around)
    assert {"drive", "turn", "look"} <= {step.state for step in steps}
    assert steps[0].path[-1] == "waypoint-3"
    assert not any(step.changes for step in steps)


def test_an_obstacle_is_driven_round(square):
    robot = Robot(0.0, 0.0)
    robot.posts = [(2.0, 0.0)]
    last, steps = seek(square, robot, ["viewpoint-3.1"])
    assert last.outcome == "success"
    assert "detour" in {step.state for step in steps}
    assert not any(step.changes for step in steps)
    assert 0.28 < min(math.dist(xy, (2, 0)) for xy in robot.trail) < 0.6  # a post of 0.1 m, a robot of 0.18 m
    assert min(math.dist(xy, (3, 0)) for xy in robot.trail) < 0.4


def test_no_way_round_blocks_the_edge_and_another_way_is_driven():
    square = FloorGraph()
    for x, y in ((0, 0), (3, 0), (3, 4), (0, 4.2)):
        square.waypoint(x, y)
    for a, b in ((1, 2), (2, 3), (1, 4), (3, 4)):
        square.path(f"waypoint-{a}", f"waypoint-{b}")
    robot = Robot(0.0, 0.0)
    robot.posts = wall(2.0, -4.0, 3.2)
    last, steps = seek(square, robot, ["viewpoint-3.1"])
    assert last.outcome == "success"
    assert [step.state for step in steps].count("replan") == 1
    assert sum(step.at_stop for step in steps if step.state in ("inspect", "replan")) == 3
    change = next(step.changes[0] for step in steps if step.changes)
    assert (change.edge, change.subjects) == ("path", ("waypoint-1", "waypoint-2"))
    assert change.scores[0].value >= change.scores[0].threshold == 1.0
    assert change.attributes["obstacle"] == pytest.approx([1.9, 0.0], abs=0.15)
    assert square.graph.edges["path", "waypoint-1", "waypoint-2"].attributes["blocked"] is True
    assert min(math.dist(xy, post) for xy in robot.trail for post in robot.posts) > 0.28


def test_a_post_behind_the_goal_or_beside_the_way_blocks_nothing(square):
    robot = Robot(0.0, 0.0)
    robot.posts = [(3.5, 0.0), (1.5, 0.5)]
    last, steps = seek(square, robot, ["viewpoint-2.1"])
    assert last.outcome == "success"
    assert not {"replan", "detour"} & {step.state for step in steps}


def test_a_way_that_passes_closely_is_given_a_berth_where_there_is_room(square):
    """The post's side is 0.16 m off the edge: a driven way may be as narrow, the robot is not."""
    robot = Robot(0.0, 0.0)
    robot.posts = [(1.5, 0.26)]
    last, steps = seek(square, robot, ["viewpoint-2.1"])
    assert last.outcome == "success"
    assert not any(step.changes for step in steps)
    assert min(math.dist(xy, robot.posts[0]) for xy in robot.trail) > 0.28


def test_a_narrow_way_without_room_beside_it_is_driven_as_before(square):
    robot = Robot(0.0, 0.0)
    robot.posts = [*wall(1.5, 0.3, 3.0), *wall(1.5, -3.0, -0.3)]  # a door of 0.4 m
    last, steps = seek(square, robot, ["viewpoint-2.1"])
    assert last.outcome == "success"
    assert max(abs(y) for x, y in robot.trail if 1.3 < x < 1.7) < 0.03
    assert not {"replan", "inspect"} & {step.state for step in steps}


def test_back_onto_the_way_from_beside_it_must_be_as_wide_as_the_robot():
    floor = FloorGraph()
    for x, y in ((0, 0), (2, 0), (4, 0)):
        floor.waypoint(x, y)
    floor.path("waypoint-1", "waypoint-2")
    floor.path("waypoint-2", "waypoint-3")
    robot = Robot(0.5, 0.8)  # beside the edge; the straight way to waypoint 2 passes the post at 0.27 m
    robot.posts = [(1.3, 0.7)]
    last, _steps = seek(floor, robot, ["viewpoint-3.1"])
    assert last.outcome == "success"
    assert min(math.dist(xy, robot.posts[0]) for xy in robot.trail) > 0.28


def test_what_was_given_up_is_hoped_for_once_more_before_there_is_no_path():
    """A wall right across the only way."""
    floor = FloorGraph()
    for x in (0, 3):
        floor.waypoint(x, 0)
    floor.path("waypoint-1", "waypoint-2")
    robot = Robot(0.0, 0.0)
    robot.posts = wall(1.6, -9.0, 9.0)
    last, steps = seek(floor, robot, ["viewpoint-2.1"])
    assert (last.outcome, sum(len(step.changes) for step in steps)) == ("no path", 2)
    assert min(math.dist(xy, post) for xy in robot.trail for post in robot.posts) > 0.28


def test_where_all_edges_are_blocked_floor_that_was_seen_leads_there():
    """The only edge goes through a wall with a door beside it, which the survey saw but never drove."""
    floor = FloorGraph()
    for x in (0, 4):
        floor.waypoint(x, 0)
    floor.path("waypoint-1", "waypoint-2", blocked=True)
    robot = Robot(0.0, 0.0)
    robot.posts = [*wall(2.0, -1.8, 3.0), *wall(2.0, -6.0, -2.8)]
    navigation = Dijkstra(Config(), context(floor.graph))

    def watch(*places):
        for robot.x, robot.y in places:
            for turn in range(12):
                robot.heading, robot.tilt, robot.index = turn * math.pi / 6, -0.5, robot.index + 1
                navigation.watch(robot.frame())

    watch((4.0, 0.0), (3.0, -2.0), (1.0, -2.0), (0.0, 0.0))
    robot.trail, robot.tilt = [], 0.0
    navigation.start(robot.frame(), ["viewpoint-2.1"])
    for _ in range(400):
        step = check_step(navigation.step(robot.frame()))
        if step.outcome:
            break
        robot.step(step.command)
    assert step.outcome == "success"
    assert math.dist((robot.x, robot.y), (4, 0)) < 0.06
    assert min(math.dist(xy, post) for xy in robot.trail for post in robot.posts) > 0.28
    assert min(y for _x, y in robot.trail) < -1.9


def test_what_was_touched_is_driven_round_though_nobody_sees_it():
    floor = FloorGraph()
    for x in (0, 3):
        floor.waypoint(x, 0)
    floor.path("waypoint-1", "waypoint-2")
    robot = Robot(1.0, 0.0)
    navigation = Dijkstra(Config(), context(floor.graph))
    navigation.touched(robot.frame(), Command(linear=0.4))
    robot.x, robot.index, robot.trail = 0.75, 1, []  # it has backed off
    navigation.start(robot.frame(), ["viewpoint-2.1"])
    for _ in range(300):
        step = navigation.step(robot.frame())
        if step.outcome:
            break
        robot.step(step.command)
    assert step.outcome == "success"
    assert min(math.dist(xy, (1.2, 0.0)) for xy in robot.trail) > 0.18


def test_the_outline_of_a_known_thing_is_kept_off_where_there_is_room(square):
    """Depth shows nothing of it; only the map says that it reaches to 0.1 m beside the edge."""
    robot = Robot(0.0, 0.0)
    square.thing("armchair", 1.5, 0.5, ["viewpoint-1.1"], size=(0.8, 0.8, 0.8), z=0.4)
    last, _steps = seek(square, robot, ["viewpoint-2.1"])
    assert last.outcome == "success"
    aside = [max(abs(x - 1.5) - 0.4, 0.0, abs(y - 0.5) - 0.4) for x, y in robot.trail]
    assert min(aside) > 0.18
    assert min(y for _x, y in robot.trail) > -0.6


def test_rugs_and_what_has_gone_have_no_outline(square):
    square.thing("rug", 1.5, 0.5, ["viewpoint-1.1"], size=(0.8, 0.8, 0.04), z=0.03)
    gone = square.thing("armchair", 1.5, 0.5, ["viewpoint-1.1"], size=(0.8, 0.8, 0.8), z=0.4)
    square.add(c.ObjectChanged(cause=CAUSE, object_id=gone, values={"state": "disappeared"}))
    robot = Robot(0.0, 0.0)
    _last, _steps = seek(square, robot, ["viewpoint-2.1"])
    assert max(abs(y) for x, y in robot.trail if x < 2.9) < 0.03


def test_every_way_blocked_ends_without_a_path(square):
    robot = Robot(0.0, 0.0)
    robot.posts = [(1.5, 0.0), (0.0, 1.2)]
    last, steps = seek(square, robot, ["viewpoint-3.1"], detour=False)
    assert last.outcome == "no path"
    assert "after 2 blocked edges" in last.detail
    assert sum(len(step.changes) for step in steps) == 2


def test_on_the_way_to_the_first_waypoint_there_is_no_edge_to_blame():
    floor = FloorGraph()
    floor.waypoint(0, 0)
    robot = Robot(-2.0, 0.0)
    robot.posts = [(-1.0, 0.0)]
    last, steps = seek(floor, robot, ["viewpoint-1.1"], detour=False)
    assert last.outcome == "blocked"
    assert not any(step.changes for step in steps)
    assert seek(floor, robot, ["viewpoint-1.1"])[0].outcome == "success"


def test_something_on_the_goal_itself_is_approached(square):
    robot = Robot(0.0, 0.0)
    robot.posts = [(3.0, 0.0)]
    last, _steps = seek(square, robot, ["viewpoint-2.1"])
    assert last.outcome == "success"
    assert 0.28 < math.dist((robot.x, robot.y), (3, 0)) < 0.9


def test_standing_on_an_edge_it_does_not_go_back(square):
    robot = Robot(1.0, 0.02)
    _last, steps = seek(square, robot, ["viewpoint-2.1"])
    assert steps[0].path == ("waypoint-2",)
    assert min(x for x, _y in robot.trail) > 0.95


def test_alternatives_only_where_allowed(square):
    square.waypoint(9, 9)
    last, _steps = seek(square, Robot(0, 0), ["viewpoint-5.1", "viewpoint-2.1"], alternatives=1)
    assert last.outcome == "no path"
    last, _steps = seek(square, Robot(0, 0), ["viewpoint-5.1", "viewpoint-2.1"])
    assert (last.outcome, last.detail) == ("success", "at viewpoint-2.1")


def test_a_robot_that_does_not_move_is_stuck(square):
    robot = Robot(0.0, 0.0)
    robot.step = lambda command: setattr(robot, "index", robot.index + 1)
    last, steps = seek(square, robot, ["viewpoint-2.1"], stuck_frames=6)
    assert last.outcome == "stuck"
    assert len(steps) == 7


def test_unknown_and_missing_goals_have_no_path(square):
    for goals in ((), ("viewpoint-9.9",)):
        assert seek(square, Robot(0, 0), goals)[0].outcome == "no path"


def test_an_empty_map_has_no_path():
    assert seek(FloorGraph(), Robot(0, 0), ["viewpoint-1.1"])[0].outcome == "no path"


def test_a_second_episode_starts_afresh(square):
    robot = Robot(0.0, 0.0)
    navigation = Dijkstra(Config(), context(square.graph))
    for goal, place in (("viewpoint-2.1", (3, 0)), ("viewpoint-4.1", (0, 2.2))):
        navigation.start(robot.frame(), [goal])
        for _ in range(400):
            step = navigation.step(robot.frame())
            if step.outcome:
                break
            robot.step(step.command)
        assert step.outcome == "success"
        assert math.dist((robot.x, robot.y), place) < 0.06
