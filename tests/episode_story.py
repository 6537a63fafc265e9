"""An episode as a recording would tell it, made of plain values: for tests of rules of diagnosis.

A robot stands at the origin, has seen a sofa and a bed from two viewpoints, is asked for the sofa, drives
three metres east, and sees it. Tests take the story and spoil one thing.
"""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np

from dssmsg.frame import Camera, Detection, Frame, Truth, TruthObject, quantise_depth
from dssmsg.interfaces import Command
from dssmsg.review.episode import ReviewedRecording

SOFA, BED = ("sofa", (4.0, -0.5, 0.0, 5.0, 0.5, 0.8)), ("bed", (-1.0, 4.0, 0.0, 1.0, 5.0, 0.6))
CAMERA = Camera.from_fov(64, 48, 1.2)
WEIGHTS = {
    "core_weight": 1.0,
    "relation_weight": 1.0,
    "attribute_weight": 0.5,
    "view_weight": 0.3,
    "guessed": 0.5,
}
SURVEY, LAST = 12, 29
STEP_M = 0.2


class Story(ReviewedRecording):
    """`story.rows`, `.matched`, `.drive`, `.ended`, `.poses_xy`, `.commands`, `.found` may be changed."""

    path = Path("story.rrd")

    def __init__(self) -> None:
        self.options = {"grounding": {"use": "dssm", **WEIGHTS}}
        self.goal = "the sofa"
        self.indices = list(range(LAST + 1))
        self.rows = [
            *_waypoint(1, 0.0, 0.0),
            *_waypoint(2, 3.0, 0.0),
            *_object(1, SOFA, [1, 2, 3], "viewpoint-2.1"),
            *_object(2, BED, [4, 5, 6], "viewpoint-1.1"),
            _row(
                "edge_added",
                7,
                edge="path",
                source="waypoint-1",
                target="waypoint-2",
                attributes={"length": 3.0},
            ),
        ]
        self.found = {frame: ["sofa", "bed"] for frame in (1, 2, 3, 4, 5, 6)}
        self.found |= {frame: ["sofa"] for frame in (28, 29)}
        self.matched = {
            "query": self.goal,
            "frame": SURVEY - 1,
            "target": {
                "core": 0,
                "kind": "explicit",
                "edges": [],
                "nodes": [{"label": "sofa", "attributes": []}],
            },
            "candidates": [
                _candidate(1, "viewpoint-2.1", "object-1", core=1.0),
                _candidate(2, "viewpoint-1.1", "object-2", core=0.4),
            ],
        }
        way = ["waypoint-2"]
        self.drive = [
            step(SURVEY - 1, "drive", "to waypoint-2", way),
            step(28, "look", "along viewpoint-2.1"),
            step(LAST, "seen", "object-1 (sofa) from viewpoint-2.1"),
        ]
        self.ended = {"episode": 0, "frame": LAST, "goal": self.goal, "outcome": "success", "reason": ""}
        self.told_errors: list[dict] = []
        self.calls = [
            {
                "role": "target_graph",
                "frame": SURVEY - 1,
                "ok": True,
                "prompt": f"user: {self.goal}",
                "answer": "{}",
                "provider": "lexicon",
                "error": "",
            }
        ]
        self.told_windows: list[dict] = []
        self.commands = {i: Command(linear=1.0 if SURVEY <= i < SURVEY + 15 else 0.0) for i in self.indices}
        self.poses_xy = {i: (min(max(i - SURVEY + 1, 0), 15) * STEP_M, 0.0, 0.0) for i in self.indices}
        self.things: list[tuple[str, tuple[float, ...], str]] = []
        self.depth = 2.0

    def with_truth(self) -> Story:
        """The same with the truth, which bears it out."""
        self.things = [(label, box, "static") for label, box in (SOFA, BED)]
        return self

    def spoilt(self, **episode: str) -> Story:
        """A copy whose episode ended otherwise."""
        other = copy.deepcopy(self)
        other.ended |= {"outcome": "failure", "reason": "wrong match", **episode}
        return other

    # What `Recording` tells.

    config = property(lambda self: self.options)
    frame_indices = property(lambda self: self.indices)
    key_frames = property(lambda self: sorted(self.found))

    def change_rows(self, **_):
        return iter(self.rows)

    def errors(self):
        return self.told_errors

    def episodes(self):
        return [self.ended]

    def phases(self):
        return [{"phase": "survey", "visit": 0, "frame": 0}, {"phase": "seek", "visit": 1, "frame": SURVEY}]

    def matches(self):
        return [] if self.matched is None else [self.matched]

    def llm_calls(self):
        return self.calls

    def navigation(self):
        return self.drive

    def windows(self, about=None):
        return self.told_windows

    def command(self, index):
        return self.commands.get(index)

    def visit(self, index):
        return int(index >= SURVEY - 1)

    def sim_time(self, index):
        return 0.2 * index

    def collisions(self, index):
        return 0

    def camera(self):
        return CAMERA

    def floor_pose(self, index):
        return self.poses_xy[index]

    def poses(self, index):
        x, y, heading = self.poses_xy[index]
        base = np.eye(4)
        base[:2, :2] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
        base[:2, 3] = x, y
        pose = np.eye(4)
        pose[:3, :3] = base[:3, :3] @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        pose[:3, 3] = x, y, 0.8
        return pose, base

    def frame(self, index, **_):
        pose, base = self.poses(index)
        depth = np.full((CAMERA.height, CAMERA.width), self.depth)
        rgb = np.zeros((CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
        return Frame(
            index=index, sim_time=0.2 * index, rgb=rgb, depth=quantise_depth(depth), camera=CAMERA,
            world_from_camera=pose, world_from_base=base, visit=self.visit(index),
        )  # fmt: skip

    def detection_cells(self, index):
        labels = self.found.get(index)
        return None if labels is None else {"labels": labels, "scores": [0.9] * len(labels)}

    def detected_names(self):
        return {index: [(label, 0.9) for label in self.found[index]] for index in sorted(self.found)}

    def detections(self, index):
        labels = self.found.get(index)
        return None if labels is None else [_detection(place, label) for place, label in enumerate(labels)]

    def truth(self, index):
        """The left half of every image shows the sofa, the right one the bed."""
        if self.hides_truth or not self.things:
            return None
        ids = np.zeros((CAMERA.height, CAMERA.width), dtype=np.int32)
        for place in range(len(self.things[:2])):
            ids[_half(place)] = place + 1
        objects = tuple(
            TruthObject(i, f"{label}-{i}", label, np.array(box[:3]), np.array(box[3:]), state=state)
            for i, (label, box, state) in enumerate(self.things, 1)
        )
        return Truth(ids, objects)


def _half(place):
    middle = CAMERA.width // 2
    return (slice(None), slice(0, middle) if place == 0 else slice(middle, None))


def _detection(place, label):
    mask = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    mask[_half(place)] = True
    return Detection(mask, np.array([0.0, 0.0, 10.0, 10.0]), label, 0.9)


def _row(kind, frame, rule="rule", plugin="test/plugin", scores=(), after=None, **values):
    cause = {"plugin": plugin, "rule": rule}
    return {
        "kind": kind,
        "frame": frame,
        "cause": cause,
        "scores": list(scores),
        "after": after or {},
        **values,
    }


def _waypoint(number, x, y):
    pose = np.eye(4)
    pose[:2, 3] = x, y
    name = f"waypoint-{number}"
    yield _row("waypoint_added", 0, waypoint_id=name, position=[x, y, 0.0])
    yield _row(
        "viewpoint_added",
        0,
        viewpoint_id=f"viewpoint-{number}.1",
        waypoint_id=name,
        world_from_camera=pose.tolist(),
    )


def _object(number, thing, frames, viewpoint):
    label, box = thing
    name = f"object-{number}"
    place = {"sofa": 0, "bed": 1}[label]
    for frame in frames:
        first = frame == frames[0]
        yield sighting(name, label, frame, place, box, first=first)
    yield changed(name, frames[-1], status="believed")
    yield _row("edge_added", frames[-1], edge="sees", source=viewpoint, target=name, attributes={})


def sighting(name, label, frame, place, box, *, first=False):
    """A detection that became part of an object."""
    kind, rule = ("object_added", "new") if first else ("object_merged", "merge")
    return _row(
        kind, frame, rule, "association/dssm", [["s", 1.9, 1.1]], {"box": list(box), "status": "tentative"},
        object_id=name, detection=place, label=label,
    )  # fmt: skip


def changed(name, frame, **values):
    """Facts of an object that change."""
    return _row("object_changed", frame, "verdict", "update/dssm", object_id=name, values=values)


def evidence(name, verdicts):
    """Windows that say something of an object: frame -> verdict."""
    return [
        {"frame": frame, "viewpoint": "viewpoint-2.1", "verdicts": {},
         "evidence": [{"frame": frame, "object": name, "verdict": verdict, "values": {}}]}
        for frame, verdict in verdicts.items()
    ]  # fmt: skip


def _candidate(rank, viewpoint, core_object, core):
    terms = {
        "s_graph": 2.0,
        "s_node": 1.0,
        "s_top": 1.0,
        "s_core": core,
        "s_relation": 0.0,
        "s_attribute": 1.0,
        "s_view": 1.0,
    }
    score = 2.0 + core + 0.5 + 0.3
    scores = {**terms, "score": score, "similarity": core}
    return {
        "rank": rank,
        "viewpoint": viewpoint,
        "scores": scores,
        "matching": {"0": core_object},
        "reason": "told",
    }


def step(frame, state, detail, path=()):
    return {"frame": frame, "sim_time": 0.2 * frame, "state": state, "detail": detail, "path": list(path)}
