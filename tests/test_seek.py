"""Episodes: candidates in turn, judged by sight, limits, and every end with its name."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from floor_graph import CAUSE, FloorGraph
from test_navigation import Robot

from dssmsg.events import Candidate, EpisodeEnded, NavigationChanged
from dssmsg.graph import changes as c
from dssmsg.guard import Guard
from dssmsg.interfaces import Command, Step
from dssmsg.mission.seek import EpisodeLimits, Seeker

ANSWER = {"kind": "explicit", "nodes": [{"label": "lamp"}], "edges": [], "core": 0}


class Navigation:
    """Drives 0.2 m a frame for `frames` frames, looks once, then says it is there; or ends otherwise."""

    def __init__(self, frames=1, outcomes=()):
        self.frames, self.outcomes, self.started = frames, list(outcomes), []

    def start(self, frame, goals):
        self.started.append(tuple(goals))
        self.left = self.frames
        self.outcome = self.outcomes.pop(0) if self.outcomes else "success"

    def step(self, frame):
        goal = self.started[-1][0]
        if self.left > 0:
            self.left -= 1
            return Step(Command(1.0), "drive", goal=goal)
        if self.outcome != "success":
            return Step(Command(), "stop", outcome=self.outcome, goal=goal)
        if self.left == 0:
            self.left = -1
            return Step(Command(), "look", goal=goal, at_stop=True)
        return Step(Command(), "arrived", outcome="success", goal=goal)


class World:
    """Two lamps seen from two viewpoints each; `shows` are the objects that a look observes."""

    def __init__(self, navigation, *, shows=(), answer=ANSWER, matches=None, **limits):
        self.floor, self.robot = FloorGraph(), Robot(0.0, 0.0)
        for x in range(4):
            self.floor.waypoint(x, 0)
        self.lamps = [
            self.floor.thing("lamp", 1.0, 1.0, ["viewpoint-1.1", "viewpoint-2.1"]),
            self.floor.thing("lamp", 3.0, 1.0, ["viewpoint-3.1", "viewpoint-4.1"]),
        ]
        self.shows, self.taken, self.told, self.contacts = shows, [], [], 0
        if matches is None:
            matches = [self.lamps[0], self.lamps[0], self.lamps[1], self.lamps[1]]
        candidates = tuple(
            Candidate(f"viewpoint-{i}.1", i, {"score": 1.0}, {"0": name}) for i, name in enumerate(matches, 1)
        )
        pipeline = SimpleNamespace(stage=lambda name: nullcontext(), apply_changes=lambda *a: None)
        self.guard = Guard(report=self.told.append)
        self.seeker = Seeker(
            llm=SimpleNamespace(complete=lambda *a: SimpleNamespace(value=answer)),
            grounding=SimpleNamespace(ground=lambda target: candidates),
            navigation=navigation,
            names={kind: f"{kind}/test" for kind in ("llm", "grounding", "navigation")},
            graph=self.floor.graph,
            pipeline=pipeline,
            guard=self.guard,
            bus=SimpleNamespace(tell=self.told.append),
            capture=self.capture,
            take=self.take,
            collisions=lambda: self.contacts,
            limits=EpisodeLimits(**limits),
        )

    def capture(self, command):
        self.robot.step(command)
        return self.robot.frame()

    def take(self, frame, command):
        self.taken.append(frame)
        for name in self.shows if frame.at_stop else ():
            node = self.floor.graph.objects[name]
            merged = c.ObjectMerged(
                cause=CAUSE,
                object_id=name,
                label=node.label,
                score=1.0,
                points=node.points,
                colors=np.zeros((len(node.points), 3), np.uint8),
                viewpoint_id=None,
                range_m=1.0,
            )
            self.floor.graph.apply_all([merged], frame.index, frame.sim_time)

    def seek(self):
        with self.guard:
            ended, _frame = self.seeker.seek(0, "the lamp", self.robot.frame())
        assert isinstance(ended, EpisodeEnded)
        assert (ended.outcome == "success") == (ended.reason == "")
        return ended


def states(world):
    return [event.state for event in world.told if isinstance(event, NavigationChanged)]


def test_it_ends_when_the_target_is_seen():
    world = World(Navigation(), shows=["object-1"])
    ended = world.seek()
    assert ended.outcome == "success"
    assert states(world)[-1] == "seen"
    assert [frame.at_stop for frame in world.taken] == [True]
    assert ended.values["viewpoints"] == 1.0
    assert ended.values["metres"] == pytest.approx(0.2)


def test_another_object_of_the_name_will_do():
    assert World(Navigation(), shows=["object-2"]).seek().outcome == "success"


def test_the_best_match_will_do_where_a_viewpoint_promised_none():
    navigation = Navigation()
    world = World(navigation, matches=["object-1", "object-1"])
    first, second = world.seeker.grounding.ground(None)
    found = (first, replace(second, matching={}))
    world.seeker.grounding.ground = lambda target: found
    assert world.seek().reason == "wrong match"
    take = world.seeker.take

    def late(frame, command):
        world.shows = ["object-1"] if len(navigation.started) == 4 else []
        take(frame, command)

    world.seeker.take = late
    assert world.seek().outcome == "success"
    assert navigation.started[3][0] == "viewpoint-2.1"


def test_what_is_not_there_is_looked_for_twice_then_the_next_candidate():
    navigation = Navigation()
    ended = World(navigation).seek()
    assert ended.reason == "wrong match"
    assert [goals[0] for goals in navigation.started] == [f"viewpoint-{i}.1" for i in (1, 2, 3, 4)]
    navigation = Navigation()
    assert World(navigation, matches=["object-1"] * 4).seek().reason == "wrong match"
    assert len(navigation.started) == 2


def test_no_more_candidates_than_allowed():
    navigation = Navigation()
    World(navigation, candidates=3).seek()
    assert len(navigation.started) == 3


def test_vanished_objects_come_last():
    navigation = Navigation()
    world = World(navigation)
    world.floor.add(c.ObjectChanged(cause=CAUSE, object_id="object-1", values={"state": "disappeared"}))
    world.seek()
    assert navigation.started[0][0] == "viewpoint-3.1"


@pytest.mark.parametrize("reason", ["no path", "blocked", "stuck"])
def test_the_end_of_the_drive_is_the_end_of_the_episode(reason):
    assert World(Navigation(outcomes=[reason])).seek().reason == reason


def test_after_a_look_in_vain_no_path_is_a_wrong_match():
    assert World(Navigation(outcomes=["success", "no path"])).seek().reason == "wrong match"


def test_a_touch_ends_it_whatever_is_seen():
    world = World(Navigation(frames=3), shows=["object-1"])

    def take(frame, command):
        world.contacts += 1

    world.seeker.take = take
    ended = world.seek()
    assert (ended.reason, ended.values["frames"]) == ("collision", 1.0)


def test_after_a_touch_the_next_episode_begins_by_backing_off():
    world = World(Navigation(frames=3), shows=["object-1"])

    def touch(frame, command):
        world.contacts += 1

    take, world.seeker.take = world.seeker.take, touch
    assert world.seek().reason == "collision"
    x, world.seeker.take = world.robot.x, take
    world.taken.clear()
    assert world.seek().outcome == "success"
    assert min(frame.world_from_base[0, 3] for frame in world.taken) == pytest.approx(x - 0.25, abs=0.05)
    world.taken.clear()
    here = world.robot.x
    world.seek()
    assert min(frame.world_from_base[0, 3] for frame in world.taken) >= here


def test_navigation_is_told_what_was_touched():
    navigation = Navigation(frames=3)
    world, felt = World(navigation), []
    navigation.touched = lambda frame, command: felt.append((frame.index, command.linear))

    def touch(frame, command):
        world.contacts += 1

    world.seeker.take = touch
    assert world.seek().reason == "collision"
    assert felt == [(1, 1.0)]
    assert states(world)[-1] == "touch"


@pytest.mark.parametrize(("fits", "reason"), [(2.0, ""), (1.0, "wrong match")])
def test_another_object_of_the_name_must_fit_what_else_is_said(fits, reason):
    """Asked for the lamp near the bed, the robot sees the other lamp from the first viewpoint."""
    nodes = [{"label": "lamp"}, {"label": "bed"}]
    edges = [{"source": 0, "target": 1, "relation": "near"}]
    world = World(Navigation(), shows=["object-2"], answer={**ANSWER, "nodes": nodes, "edges": edges})
    scores = {"object-1": 2.0, "object-2": fits}
    found = tuple(
        replace(one, scores={"score": scores[one.matching["0"]]})
        for one in world.seeker.grounding.ground(None)
    )
    world.seeker.grounding.ground = lambda target: found
    world.seeker.limits = EpisodeLimits(candidates=1)
    assert world.seek().reason == reason


def test_after_a_look_in_vain_the_map_is_asked_again():
    navigation = Navigation()
    world = World(navigation)
    asked, ground = [], world.seeker.grounding.ground

    def grounded(target):
        asked.append(len(navigation.started))
        found = ground(target)
        # Once it was looked for, the map has learned that only the other lamp is worth a drive.
        return found if len(asked) == 1 else found[3:]

    world.seeker.grounding.ground = grounded
    assert world.seek().reason == "wrong match"
    assert [goals[0] for goals in navigation.started] == ["viewpoint-1.1", "viewpoint-4.1"]
    assert asked == [0, 1, 2]


@pytest.mark.parametrize("limits", [{"secs": 2.0}, {"metres": 2.1}])
def test_time_and_way_are_limited(limits):
    ended = World(Navigation(frames=200), **limits).seek()
    assert ended.reason == "out of time"
    assert ended.values["frames"] == 11.0


def test_the_end_of_the_frames_is_out_of_time():
    world = World(Navigation(frames=5))
    world.seeker.capture = lambda command: None
    assert world.seek().reason == "out of time"


def test_no_target_graph_and_no_match():
    assert World(Navigation(), answer={**ANSWER, "core": 7}).seek().reason == "no target graph"
    assert World(Navigation(), matches=[]).seek().reason == "no match"


def test_a_plugin_that_fails_ends_it():
    navigation = Navigation()
    navigation.step = lambda frame: 1 / 0
    assert World(navigation).seek().reason == "navigation failed"
