"""A home of boxes and a robot that drives in it: a source without a simulator, and whole missions.

`mission(folder, goal, fault=...)` surveys the home, seeks a goal, and leaves a recording; faults go in as in
`dssmsg eval diagnosis`. A mission takes a few seconds.
"""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
from box_scene import Thing, look, pose_at
from pydantic import Field

from dssmsg.config import load_config
from dssmsg.evaluate.faults.host import Aim, FaultyHost
from dssmsg.evaluate.faults.kinds import FAULTS
from dssmsg.evaluate.navigation_witness import EpisodeWitness
from dssmsg.frame import Camera
from dssmsg.hookspecs import PluginConfig, hookimpl
from dssmsg.interfaces import Command, SourceInfo
from dssmsg.interfaces.source import Stop
from dssmsg.mission.run import run_mission

SEEN_FROM = Camera.from_fov(96, 72, math.radians(69.4))
PERIOD = 0.2
HOME = (
    Thing("wall", (-1.2, -4.0, 0.0), (-1.1, 1.7, 2.6)),
    Thing("wall", (-1.2, 3.7, 0.0), (-1.1, 4.0, 2.6)),
    Thing("sofa", (3.0, -1.2, 0.0), (3.9, 1.0, 0.8)),
    Thing("fridge", (3.1, 2.8, 0.0), (3.9, 3.6, 1.7)),
    Thing("desk", (0.0, -3.9, 0.0), (1.4, -3.1, 0.75)),
    Thing("plant", (3.2, -3.7, 0.0), (3.8, -3.1, 1.3)),
    Thing("bed", (-3.9, 2.0, 0.0), (-2.4, 3.9, 0.6)),
    Thing("toilet", (-3.9, -0.6, 0.0), (-3.2, 0.2, 0.8)),
    Thing("wardrobe", (-3.9, -3.6, 0.0), (-3.2, -2.2, 2.0)),
    Thing("suitcase", (-2.0, -3.9, 0.0), (-1.4, -3.3, 0.8)),
)
CARRIED = "suitcase"
"""Stands elsewhere from the second visit on, if the source's option says so."""
ELSEWHERE = Thing(CARRIED, (-3.9, 0.9, 0.0), (-3.3, 1.5, 0.8))
BARRIER = Thing("box", (-1.3, 1.5, 0.0), (-1.0, 3.8, 1.0))


def _views(*headings: float) -> tuple[tuple[float, float], ...]:
    return tuple((math.radians(heading), math.radians(-12.0)) for heading in headings)


TOUR = (
    Stop("right", 1.6, 0.2, _views(-5.0, 58.0), room="right"),
    Stop("front", 1.0, -1.4, _views(-95.0, -38.0), room="right"),
    Stop("left", -2.4, 0.8, _views(112.0, -155.0, 150.0), ((0.0, 2.6), (-2.0, 2.6)), room="left"),
    Stop("back", -2.4, -1.0, _views(-125.0, -75.0), room="left"),
)


class Config(PluginConfig):
    """Options of the home of boxes."""

    carried: bool = Field(
        False, description="Whether the suitcase stands elsewhere from the second visit on."
    )
    obstacles: tuple[dict, ...] = Field((), description="Any: the door is closed from the second visit on.")


class BoxHouse:
    """`dssmsg.interfaces.Source`: the robot does at once what it is told."""

    def __init__(self, config, context) -> None:
        self._config = config
        self._visit = 0
        self._index = 0
        first = TOUR[0]
        self._pose = [first.x, first.y, first.views[0][0]]
        self.info = SourceInfo(
            name="boxhouse",
            camera=SEEN_FROM,
            drivable=True,
            has_truth=True,
            visits=3,
            scene="boxhouse",
            tours=(TOUR, TOUR, TOUR),
            depth_noise_m=(0.001, 0.002),
            accelerations=(50.0, 50.0),
        )

    def start_visit(self, visit):
        self._visit = visit

    def step(self, command):
        command = command or Command()
        x, y, heading = self._pose
        middle = heading + command.angular * PERIOD / 2
        x += command.linear * PERIOD * math.cos(middle)
        y += command.linear * PERIOD * math.sin(middle)
        if self._is_free(x, y):
            self._pose[:2] = [x, y]
        self._pose[2] = math.remainder(heading + command.angular * PERIOD, math.tau)
        x, y, heading = self._pose
        pose = pose_at(x, y, heading + command.pan, command.tilt)
        frame = look(list(self._things()), pose, self._index, camera=SEEN_FROM, noise=(0.001, 0.002))
        base = np.eye(4)
        base[:2, :2] = [[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]]
        base[:2, 3] = x, y
        self._index += 1
        return _with(frame, world_from_base=base, visit=self._visit, sim_time=self._index * PERIOD)

    def _things(self):
        later = self._visit > 0
        for thing in HOME:
            yield ELSEWHERE if thing.label == CARRIED and later and self._config.carried else thing
        if later and self._config.obstacles:
            yield BARRIER

    def _is_free(self, x, y):
        return not any(
            t.low[0] - 0.1 < x < t.high[0] + 0.1 and t.low[1] - 0.1 < y < t.high[1] + 0.1
            for t in self._things()
        )

    def collisions(self):
        return 0

    def close(self):
        pass


def _with(frame, **values):
    import dataclasses

    return dataclasses.replace(frame, **values)


class Letters:
    """A text encoder without a model: labels are alike as far as they share pairs of letters."""

    space = "letters/64"
    dimension = 64

    def encode_labels(self, labels):
        return np.stack([self._vector(label) for label in labels])

    encode_text = encode_labels

    def encode_crops(self, crops):
        return None

    def _vector(self, label):
        vector = np.full(64, 0.05, dtype=np.float64)
        for a, b in pairwise(label):
            vector[(ord(a) * 31 + ord(b)) % 64] += 1.0
        return (vector / np.linalg.norm(vector)).astype(np.float32)


@hookimpl
def register_source(register):
    register("boxhouse", BoxHouse, config=Config)


@hookimpl
def register_encoder(register):
    register("letters", lambda config, context: Letters())


FILE = f"""
name: boxes
plugins: [{Path(__file__).resolve()}]
source: {{use: boxhouse}}
perception: {{use: oracle, min_pixels: 30}}
encoder: {{use: letters}}
llm: {{use: lexicon, encoder: false}}
mission: {{phases: [survey, seek], seek_visit: next, candidates: 1, episode_secs: 60, max_frames: 2000}}
"""


def mission(folder, goal, fault=None, *, label=None, seed=0):
    """Survey the home of boxes and seek a goal; (path of the recording, how the truth judges the episode)."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "boxes.yaml"
    file.write_text(FILE, "utf-8")
    label = label or goal.removeprefix("the ")
    kind = next((one for one in FAULTS if one.name == fault), None)
    changes = fault == "stale object" or goal == f"the {CARRIED}"
    sets = [f"mission.goals=['{goal}']", f"recording.directory={folder}", f"seed={seed}"]
    if changes:
        sets += ["source.carried=true", "mission.phases=[survey, revisit, seek]", "mission.seek_visit=same"]
    config = load_config(file, sets=sets)
    others = tuple(sorted({t.label for t in HOME if t.label not in ("wall", label)}))
    injection = None if kind is None else kind.injection(Aim(label, others, seed, 1, ({"door": "closed"},)))
    names = tuple(f"{t.label}-{i}" for i, t in enumerate(HOME, 1) if t.label == label)
    witness = EpisodeWitness([names])
    result = run_mission(config, FaultyHost.loaded(config, injection), observers=[("witness", witness)])
    assert injection is None or injection.carried
    return Path(result.summary["recording"]), witness.judged[0]
