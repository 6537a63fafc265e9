"""Small plug-ins of the kinds that `fake_plugins.py` lacks or only stubs; docs/plugins.md shows them all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dssmsg.events import Candidate
from dssmsg.frame import Frame, Observation
from dssmsg.graph.changes import Cause, ObjectChanged
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces import Box, Command, Context, Finding, Step, TargetGraph, UpdateResult


class HourTagger:
    """Rooms have chairs; after ten minutes, look for cups too."""

    def __init__(self, config: PluginConfig, context: Context) -> None:
        pass

    def tags(self, frame: Frame) -> Sequence[str]:
        return ["chair"] if frame.sim_time < 600 else ["chair", "cup"]


class NearDetector:
    """One box around everything nearer than 3 m, called by the first label that was asked for."""

    def __init__(self, config: PluginConfig, context: Context) -> None:
        pass

    def detect(self, frame: Frame, labels: Sequence[str] | None) -> Sequence[Box]:
        rows, columns = np.nonzero((frame.depth > 0) & (frame.depth < 3.0))
        if len(rows) == 0:
            return []
        xyxy = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], float)
        return [Box(xyxy, labels[0] if labels else "thing", 0.7)]


class NearSegmenter:
    """Of each box, the pixels within half a metre of its nearest one."""

    def __init__(self, config: PluginConfig, context: Context) -> None:
        pass

    def segment(self, frame: Frame, boxes: Sequence[Box]) -> Sequence[Any]:
        masks = []
        for box in boxes:
            x0, y0, x1, y1 = np.rint(box.xyxy).astype(int).clip(0)
            inside = np.zeros(frame.depth.shape, bool)
            inside[y0:y1, x0:x1] = True
            inside &= frame.depth > 0
            nearest = frame.depth[inside].min() if inside.any() else 0.0
            masks.append(inside & (frame.depth < nearest + 0.5))
        return masks


class BelievingUpdate:
    """Whatever was seen once is believed."""

    def __init__(self, config: PluginConfig, context: Context) -> None:
        self._graph = context.graph

    def update(
        self,
        frame: Frame,
        observations: Sequence[Observation],
        object_ids: Sequence[str | None],
        viewpoint_id: str | None,
    ) -> UpdateResult:
        seen = [one for one in dict.fromkeys(object_ids) if one is not None]
        return UpdateResult(
            tuple(
                ObjectChanged(
                    cause=Cause("update/example", "seen"), object_id=one, values={"status": "believed"}
                )
                for one in seen
                if self._graph.objects[one].status != "believed"
            )
        )

    def finish(self) -> UpdateResult:
        return UpdateResult()


class LabelGrounding:
    """Viewpoints that saw an object of exactly the wanted label, the nearest look first."""

    def __init__(self, config: PluginConfig, context: Context) -> None:
        self._graph = context.graph

    def ground(self, target: TargetGraph) -> Sequence[Candidate]:
        wanted = target.nodes[target.core].label
        looks: dict[str, tuple[float, str]] = {}
        for node in self._graph.objects.values():
            if node.label == wanted:
                for edge in self._graph.edges_of(node.id, "sees"):
                    look = (float(edge.attributes["distance"]), node.id)
                    looks[edge.source] = min(look, looks.get(edge.source, look))
        return [
            Candidate(viewpoint, rank, {"distance": look[0]}, {str(target.core): look[1]}, f"sees {look[1]}")
            for rank, (viewpoint, look) in enumerate(sorted(looks.items(), key=lambda item: item[1]), 1)
        ]


class StraightNavigation:
    """Turns to the best viewpoint and drives there in a straight line, whatever stands in the way."""

    def __init__(self, config: PluginConfig, context: Context) -> None:
        self._graph = context.graph

    def start(self, frame: Frame, goals: Sequence[str]) -> None:
        self._goal = goals[0]

    def step(self, frame: Frame) -> Step:
        goal = self._graph.viewpoints[self._goal].world_from_camera[:, 3]
        x, y = (np.linalg.inv(frame.world_from_base) @ goal)[:2]  # metres ahead and to the left
        angle = math.atan2(y, x)
        if math.hypot(x, y) < 0.3:
            return Step(Command(), "arrived", outcome="success")
        if abs(angle) > 0.2:
            return Step(Command(angular=math.copysign(0.6, angle)), "turn")
        return Step(Command(linear=0.4, angular=angle), "drive")


class BlindDiagnosis:
    """Blames perception where key frames in a row showed nothing."""

    def __init__(self, config: PluginConfig, context: Context) -> None:
        pass

    def diagnose(self, recording: Any, episode: int | None) -> Sequence[Finding]:
        blind = [frame for frame in recording.key_frames if not recording.detections(frame)]
        if len(blind) < 2:
            return []
        share = len(blind) / len(recording.key_frames)
        return [Finding("detector", blind[0], share, f"nothing seen in {len(blind)} key frames")]


@hookimpl
def register_tagger(register: Register) -> None:
    register("example", HourTagger)


@hookimpl
def register_detector(register: Register) -> None:
    register("example", NearDetector)


@hookimpl
def register_segmenter(register: Register) -> None:
    register("example", NearSegmenter)


@hookimpl
def register_update(register: Register) -> None:
    register("example", BelievingUpdate)


@hookimpl
def register_grounding(register: Register) -> None:
    register("example", LabelGrounding)


@hookimpl
def register_navigation(register: Register) -> None:
    register("example", StraightNavigation)


@hookimpl
def register_diagnosis(register: Register) -> None:
    register("example", BlindDiagnosis)
