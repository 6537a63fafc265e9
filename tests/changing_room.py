"""A robot that visits a room of boxes again and again, with an oracle's eyes."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
from box_scene import NOISE, Thing, context, look, pose_at
from dssmsg_plugins.association.dssm import DssmAssociation
from dssmsg_plugins.association.dssm import DssmConfig as AssociationConfig
from dssmsg_plugins.perception.oracle import Oracle, OracleConfig
from dssmsg_plugins.update.dssm import DssmConfig, DssmUpdate
from recorded_run import SyntheticRun

from dssmsg.events import FrameCaptured, GraphChanged, PhaseStarted
from dssmsg.graph.edges import edge_changes
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.graph.waypoints import WaypointTopology
from dssmsg.lift import Lifter
from dssmsg.mission.pipeline import object_ids_of
from dssmsg.recording.repair import optimize
from dssmsg.recording.writer import RecordingWriter

STANDS = ((-1.0, -0.8), (-0.8, 0.8))
"""Where the robot stands; it looks east, a little turned to each side, three frames each."""


@dataclasses.dataclass(frozen=True)
class Painted:
    """A thing with a colour of its own."""

    thing: Thing
    color: tuple[int, int, int] = (120, 120, 120)


class ScriptedAttribute:
    """Stands in for an LLM: one dynamic attribute for everything, or one a label."""

    def __init__(self, values: dict[str, float] | float = 0.9) -> None:
        self.values = values
        self.asked: list[str] = []

    def complete(self, role, messages, schema):
        import json

        from dssmsg.interfaces import Answer

        label = json.loads(messages[-1].content)["label"]
        self.asked.append(label)
        value = self.values if isinstance(self.values, float) else self.values.get(label, 0.9)
        return Answer({"dynamic_attribute": value}, str(value))


class ChangingRoom:
    """One graph through many visits. `visit(things)` drives past all stands and returns the verdicts."""

    def __init__(self, *, values=0.9, light=1.0, score=1.0, **config) -> None:
        self.llm = ScriptedAttribute(values)
        plain = context(noise=NOISE)
        self.context = dataclasses.replace(plain, llm=self.llm, ids=IdAllocator(), base_dir=Path())
        self.graph: SceneGraph = self.context.graph
        self.topology = WaypointTopology(self.graph, self.context.ids)
        self.association = DssmAssociation(
            AssociationConfig(paper_exact=config.get("paper_exact", False)), self.context
        )
        self.update = DssmUpdate(DssmConfig(**config), self.context)
        self.oracle = Oracle(OracleConfig(min_pixels=12, score=score), self.context)
        self.lifter = Lifter()
        self.light = light
        self.missed: set[str] = set()
        self.index = 0
        self.visits = 0
        self.windows = []
        self.changes = []
        self.events = []

    def visit(self, things, stands=STANDS, headings=(-25, 0, 25), end=True):
        """Frames at every stand; labels in `missed` are not detected. Returns verdicts by object id."""
        before = len(self.windows)
        for x, y in stands:
            for heading in headings:
                for nudge in (-5, 0, 5):
                    self._frame(things, x, y, math.radians(heading + nudge))
        if end:
            last = [*self._apply(self.association.finish()), *self._apply(self.update.finish().changes)]
            self.events.append(GraphChanged(self.index, self.index * 0.2, tuple(last)))
        self.visits += 1
        return {k: v for w in self.windows[before:] for k, v in w.verdicts.items()}

    def _frame(self, things, x, y, heading):
        pose = pose_at(x, y, heading, tilt=math.radians(-15))
        frame = look([p.thing for p in things], pose, self.index, noise=NOISE)
        palette = np.array([(90, 90, 90), *(p.color for p in things)], dtype=np.float64) * self.light
        rgb = np.clip(palette, 0, 255).astype(np.uint8)[frame.truth.instance_ids]
        base = np.eye(4)
        base[:2, 3] = x, y
        frame = dataclasses.replace(frame, rgb=rgb, world_from_base=base, visit=self.visits, at_stop=True)
        told = len(self.changes)
        viewpoint, changes = self.topology.observe(frame)
        self._apply(changes)
        detections = [d for d in self.oracle.detect(frame) if d.label not in self.missed]
        observations = self.lifter.lift(frame.without_truth(), detections).observations
        applied = self._apply(self.association.associate(frame, observations, viewpoint))
        ids = object_ids_of(observations, applied)
        seen = [i for i in ids if i is not None]
        self._apply(edge_changes(self.graph, seen, viewpoint, frame))
        result = self.update.update(frame.without_truth(), observations, ids, viewpoint)
        self._apply(result.changes)
        self.windows += result.windows
        self.events += [
            FrameCaptured(frame.without_truth(), None, True, viewpoint, 0),
            *result.windows,
            GraphChanged(self.index, frame.sim_time, tuple(self.changes[told:])),
        ]
        self.index += 1

    def _apply(self, changes):
        applied = self.graph.apply_all(tuple(changes), self.index, self.index * 0.2)
        self.changes += applied
        return applied

    def record(self, path):
        """Everything so far as a finished recording."""
        run = SyntheticRun(frames=self.index)
        writer = RecordingWriter(path, run.run_id)
        for event in (run.started(), PhaseStarted("survey", 0, 0, 0.0), *self.events, run.finished()):
            writer.write(event)
        writer.close()
        optimize(path)
        return path

    def named(self, label):
        """Believed objects of a label that are there, by id."""
        return [
            n
            for n in self.graph.objects.values()
            if n.label == label and n.status == "believed" and n.state != "disappeared"
        ]

    def one(self, label):
        """The only believed object of a label, wherever it is or was."""
        (node,) = [n for n in self.graph.objects.values() if n.label == label and n.status == "believed"]
        return node
