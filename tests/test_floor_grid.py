"""The rolling floor plan, ways over costs, and ways round what stands in the plan."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_navigation import Robot, wall

from dssmsg.graph.outlines import outline
from dssmsg.navigation.astar import cheapest_way
from dssmsg.navigation.detour import find_detour, is_clear
from dssmsg.navigation.grid import RollingGrid
from dssmsg.navigation.seen_floor import FreeWayOptions, SeenFloor


def look(grid, robot, times=2):
    for _ in range(times):
        grid.observe(robot.frame())
    return grid


def test_a_post_is_seen_and_the_floor_before_it_is_free():
    robot = Robot(0.0, 0.0)
    robot.tilt, robot.posts = -0.35, [(2.0, 0.0)]
    grid = look(RollingGrid(), robot)
    strip = grid.corridor((0.0, 0.0), (2.5, 0.0), 0.15)
    assert strip.obstacle == pytest.approx((1.9, 0.0), abs=0.15)
    assert grid.corridor((1.0, 0.0), (1.7, 0.0), 0.15).free > 0.95
    assert grid.corridor((1.0, 1.0), (1.7, 1.0), 0.15).obstacle is None


def test_what_is_too_near_to_be_seen_is_remembered():
    robot = Robot(0.0, 0.0)
    robot.tilt, robot.posts = -0.35, [(2.0, 0.0)]
    grid = look(RollingGrid(), robot)
    robot.x, robot.heading = 1.5, math.pi
    look(grid, robot, 5)
    assert grid.corridor((1.5, 0.0), (2.2, 0.0), 0.15).obstacle is not None


def test_what_went_away_is_seen_through():
    robot = Robot(0.0, 0.0)
    robot.tilt, robot.posts = -0.35, [(2.0, 0.0)]
    grid = look(RollingGrid(), robot, 3)
    robot.posts = []
    look(grid, robot, 6)
    strip = grid.corridor((1.0, 0.0), (2.5, 0.0), 0.15)
    assert (strip.obstacle, strip.fresh > 0.9) == (None, True)


def test_the_plan_forgets_what_leaves_it():
    robot = Robot(0.0, 0.0)
    robot.tilt, robot.posts = -0.35, [(2.0, 0.0)]
    grid = look(RollingGrid(), robot)
    robot.x = 20.0
    look(grid, robot)
    assert grid.cell((2.0, 0.0)) is None
    robot.x, robot.posts = 0.0, []
    look(grid, robot)
    assert not grid.occupied.any()


@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_cheapest_way_costs_no_more_than_relaxation_finds(data):
    """Against Bellman-Ford over the same neighbourhood."""
    size = 6
    cells = data.draw(st.lists(st.sampled_from([1.0, 2.0, 5.0, math.inf]), min_size=36, max_size=36))
    cost = np.array(cells).reshape(size, size)
    cost[0, 0] = cost[5, 5] = 1.0
    best = np.full((size, size), math.inf)
    best[0, 0] = 0.0
    steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]

    def price(x, y, i, j):
        if not (0 <= x + i < size and 0 <= y + j < size):
            return math.inf
        if i and j and math.inf in (cost[x, y + j], cost[x + i, y]):
            return math.inf
        return math.hypot(i, j) * cost[x + i, y + j]

    for _ in range(size * size):
        for x, y in np.ndindex(size, size):
            for i, j in steps:
                step = price(x, y, i, j)
                if step < math.inf and best[x, y] + step < best[x + i, y + j] - 1e-12:
                    best[x + i, y + j] = best[x, y] + step
    way = cheapest_way(cost, (0, 0), (5, 5))
    if way is None:
        assert best[5, 5] == math.inf
        return
    total = sum(price(*a, b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(way))
    assert total == pytest.approx(best[5, 5])


def test_cheapest_way_refuses_ends_outside():
    with pytest.raises(IndexError, match="outside"):
        cheapest_way(np.ones((3, 3)), (0, 0), (3, 0))


def test_a_detour_rejoins_behind_the_obstacle_and_keeps_clear():
    robot = Robot(0.0, 0.0)
    robot.tilt, robot.posts = -0.35, [(1.5, 0.0)]
    grid = look(RollingGrid(), robot)
    detour = find_detour(grid, (0.0, 0.0), [(3.0, 0.0), (3.0, 2.0)])
    assert detour is not None
    assert is_clear(grid, (0.0, 0.0), detour.corners, 0.18)
    assert detour.leg == 0
    assert is_clear(grid, detour.corners[-1], [(3.0, 0.0)], 0.18)


def test_a_wall_leaves_no_detour():
    robot = Robot(0.0, 0.0)
    robot.tilt, robot.posts = -0.35, wall(1.5, -3.2, 3.2)
    grid = RollingGrid()
    for heading in np.arange(-1.2, 1.21, 0.3):
        robot.heading = float(heading)
        look(grid, robot)
    assert find_detour(grid, (0.0, 0.0), [(3.0, 0.0)]) is None


def test_a_detour_does_not_rejoin_before_what_stands_behind_a_narrow_place():
    """A door jamb close to the way, and right behind it a post on the next leg."""
    grid, robot = RollingGrid(), Robot(0.0, 0.0)
    robot.tilt, robot.posts = -0.35, [(0.9, -0.3), (1.7, 0.0)]
    look(grid, robot)
    way = [(1.2, 0.0), (2.6, 0.0)]
    detour = find_detour(grid, (0.0, 0.0), way)
    assert detour is not None
    assert detour.leg == 1
    assert is_clear(grid, (0.0, 0.0), [*detour.corners, way[1]], 0.18)


def test_what_was_touched_stays_whatever_is_seen_and_wherever_the_plan_goes():
    robot = Robot(0.0, 0.0)
    robot.tilt = -0.35
    grid = look(RollingGrid(), robot, 3)
    assert grid.corridor((0.5, 0.0), (1.5, 0.0), 0.15).obstacle is None
    grid.touch([(1.0, 0.0)])
    assert grid.corridor((0.5, 0.0), (1.5, 0.0), 0.15).obstacle == pytest.approx((1.0, 0.0), abs=0.05)
    look(grid, robot, 8)
    robot.x = 20.0
    look(grid, robot)
    robot.x = 0.0
    look(grid, robot, 3)
    assert grid.corridor((0.5, 0.0), (1.5, 0.0), 0.15).obstacle is not None
    grid.forget()
    look(grid, robot, 3)
    assert grid.corridor((0.5, 0.0), (1.5, 0.0), 0.15).obstacle is None


@given(
    turn=st.floats(-math.pi, math.pi),
    sides=st.tuples(st.floats(0.1, 2.0), st.floats(0.1, 2.0)),
    shift=st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
)
def test_the_outline_of_a_turned_rectangle_is_the_rectangle(turn, sides, shift):
    rng = np.random.default_rng(0)
    local = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], *rng.uniform(-1, 1, (50, 2))]) * np.array(sides) / 2
    cos, sin = math.cos(turn), math.sin(turn)
    points = local @ np.array([[cos, sin], [-sin, cos]]) + shift
    corners = outline(points)
    lengths = [math.dist(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    assert sorted(lengths) == pytest.approx(sorted([*sides, *sides]), abs=1e-6)
    assert all(min(math.dist(c, p) for p in points[:4]) < 1e-6 for c in corners)


def test_outlines_of_few_points_have_no_width():
    assert outline(np.array([[1.0, 2.0, 0.3]])).tolist() == [[1.0, 2.0]] * 4
    line = outline(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]))
    assert sorted(map(tuple, np.round(line, 9).tolist()))[::3] == [(0.0, 0.0), (2.0, 2.0)]
    with pytest.raises(ValueError, match="at least one point"):
        outline(np.zeros((0, 2)))


def test_outlines_are_kept_off_only_where_that_is_asked_for():
    robot = Robot(0.0, 0.0)
    robot.tilt = -0.35
    grid = look(RollingGrid(), robot)
    grid.outline([np.array([[1.0, -0.2], [1.4, -0.2], [1.4, 0.2], [1.0, 0.2]])])
    plain, outlined = (
        grid.corridor((0.5, 0.0), (2.0, 0.0), 0.15, outlined=told).obstacle for told in (False, True)
    )
    assert plain is None
    assert outlined == pytest.approx((1.0, 0.0), abs=0.2)
    cell = grid.cell((1.2, 0.0))
    assert grid.clearance(outlined=True)[cell] == 0.0
    assert grid.clearance()[cell] > 0.5
    grid.outline([])
    assert grid.clearance(outlined=True)[cell] > 0.5


def seen_round(*places, posts=()):
    """A floor plan of what a robot saw that turned on each place, and where it looked from last."""
    robot, grid, plan = Robot(0.0, 0.0), RollingGrid(), SeenFloor()
    robot.tilt, robot.posts = -0.5, list(posts)
    for robot.x, robot.y in places:
        for turn in range(12):
            robot.heading = turn * math.pi / 6
            look(grid, robot)
            plan.take(grid)
    return plan


def test_the_floor_plan_keeps_what_the_grid_has_left():
    posts = [*wall(4.0, -0.6, 9.0)]
    plan = seen_round((0, 0), (3, 0), (5, -2), (7, 1), posts=posts)
    way = plan.way((0.0, 1.0), (7.0, 1.0))
    assert way is not None
    assert way[-1] == (7.0, 1.0)
    legs = list(itertools.pairwise([(0.0, 1.0), *way]))
    samples = [np.linspace(a, b, 60) for a, b in legs]
    assert min(math.dist(p, post) for leg in samples for p in leg for post in posts) > 0.28


def test_no_way_over_floor_that_was_never_seen_unless_it_is_dear():
    plan = seen_round((0, 0), (9, 0))
    assert plan.way((0.0, 0.0), (9.0, 0.0)) is None
    assert plan.way((0.0, 0.0), (9.0, 0.0), FreeWayOptions(unknown_cost=4.0)) is not None
    assert plan.way((0.0, 0.0), (40.0, 0.0)) is None
    assert SeenFloor().way((0.0, 0.0), (1.0, 0.0)) is None


def test_a_free_way_keeps_off_outlines():
    plan = seen_round((0, 0), (2, 0))
    box = np.array([[0.8, -0.5], [1.2, -0.5], [1.2, 0.5], [0.8, 0.5]])
    straight, round_it = plan.way((0.0, 0.0), (2.0, 0.0)), plan.way((0.0, 0.0), (2.0, 0.0), None, [box])
    assert straight == ((2.0, 0.0),)
    assert max(abs(y) for _x, y in round_it) > 0.68


def test_something_on_the_end_has_a_place_near_it_stand_in():
    plan = seen_round((0, 0), (2, 0.9), posts=[(2.0, 0.0)])
    end = plan.way((0.0, 0.0), (2.0, 0.0))[-1]
    assert 0.28 < math.dist(end, (2.0, 0.0)) <= 0.6
