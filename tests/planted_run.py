"""A synthetic run with one planted change: what `diff` has to find, in its layer and in its first frame.

Two runs of one seed without a plant are equal. A run asks a language model, grounds a query, judges windows
and ends an episode, so that every layer has something to differ in.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from recorded_run import CAUSE, SyntheticRun

from dssmsg import events as ev
from dssmsg.frame import Frame, quantise_depth
from dssmsg.graph import changes as ch
from dssmsg.graph.changes import Cause, Change, Score
from dssmsg.graph.verdicts import Evidence

FRAMES = 36
SCORE, UPDATE, PATHS = 1.1, Cause("update/dssm", "verdict"), Cause("graph/topology", "blocked")
LAYERS = {
    "threshold": "association",
    "merge refused": "association",
    "detection dropped": "perception",
    "label changed": "perception",
    "feature changed": "perception",
    "perception failed": "perception",
    "pose shifted": "source",
    "depth changed": "source",
    "frame missing": "source",
    "key frame left out": "mission",
    "answer changed": "llm",
    "object gone": "update",
    "verdict changed": "update",
    "edge blocked": "topology",
    "rank swapped": "grounding",
    "other way": "mission",  # before seek it is the tour's
    "episode lost": "mission",
}
"""Plant -> the layer to blame."""


class PlantedRun(SyntheticRun):
    """`plant` happens once, at the first frame from `at` on that has an occasion; `planted` says where."""

    def __init__(self, plant: str = "", at: int = 0, seed: int = 0, run_id: str = "base") -> None:
        super().__init__(FRAMES, seed=seed, run_id=run_id, truth=False)
        self.plant = plant
        self.at = at
        self.planted: int | None = None
        self.extra = 100
        self.index = 0

    def _now(self, plant: str, index: int) -> bool:
        """Whether the plant happens here; it does once."""
        if self.plant != plant or self.planted is not None or index < self.at:
            return False
        self.planted = index
        return True

    def started(self) -> ev.RunStarted:
        event = super().started()
        limit = SCORE + 0.1 * (self.plant == "threshold")
        config = {"source": {"use": "synthetic"}, "association": {"use": "dssm", "delta_sim": limit}}
        plugins = {
            kind: {"name": name, "version": "1", "origin": "tests"}
            for kind, name in [("perception", "synthetic"), ("navigation", "dijkstra"), ("update", "dssm")]
        }
        return replace(event, config=config, plugins=plugins)

    def events(self) -> Iterator[ev.Event]:
        for event in super().events():
            if isinstance(event, ev.RunFinished):
                lost = self._now("episode lost", FRAMES - 1)
                yield ev.EpisodeEnded(
                    0,
                    "the mug",
                    "failure" if lost else "success",
                    "wrong match" if lost else "",
                    FRAMES - 1,
                    event.sim_time,
                    {"metres": 3.0},
                )
            yield event

    def frame_events(self, index: int) -> Iterator[ev.Event]:
        if index < FRAMES - 2 and self._now("frame missing", index):
            return
        for event in super().frame_events(index):
            if isinstance(event, ev.Detected):
                event = self._perceived(event)
            elif isinstance(event, ev.FrameCaptured) and event.key_frame:
                if self._now("key frame left out", index):
                    event = replace(event, key_frame=False, viewpoint_id=None)
            elif isinstance(event, ev.NavigationChanged) and self._now("other way", index):
                event = replace(event, state="detour")
            yield event
        if index % 6 == 0:
            yield from self._judged(index, index * 0.2)

    def _perceived(self, event: ev.Detected) -> ev.Event:
        found = list(event.detections)
        if self._now("perception failed", event.frame):
            return ev.ErrorOccurred(event.frame, event.sim_time, "perception/synthetic", "no idea", "detect")
        if found and self._now("detection dropped", event.frame):
            found.pop()
        if found and self._now("label changed", event.frame):
            found[0] = replace(found[0], label="wardrobe")
        if found and self._now("feature changed", event.frame):
            found[0] = replace(found[0], text_feature=self._feature(77))
        return replace(event, detections=tuple(found))

    def _judged(self, index: int, seconds: float) -> Iterator[ev.Event]:
        high = 0.8 if self._now("answer changed", index) else 0.2
        yield ev.LlmCalled(
            "dynamic_attribute", "lexicon", index, seconds, "how movable?", f'{{"value": {high}}}', "h", True
        )
        verdict = "disappeared" if self._now("verdict changed", index) else "static"
        yield ev.WindowEvaluated(
            self._viewpoint(index),
            index,
            seconds,
            (index,),
            (0,),
            (Evidence(index, "object-1", "seen", {"share": 0.9}),),
            {"object-1": verdict},
            3,
        )
        order = ["viewpoint-1.1", "viewpoint-2.1"]
        if self._now("rank swapped", index):
            order.reverse()
        candidates = tuple(
            ev.Candidate(name, rank, {"score": 2.0 - rank / 4}, {"0": "object-1"})
            for rank, name in enumerate(order, start=1)
        )
        yield ev.Matched("the mug", index, seconds, {"core": 0}, candidates)

    def frame(self, index: int) -> Frame:
        self.index = index
        frame = super().frame(index)
        if self._now("pose shifted", index):
            pose = frame.world_from_camera.copy()
            pose[0, 3] += 0.01
            frame = replace(frame, world_from_camera=pose)
        if index % 3 == 0 and self._now("depth changed", index):
            frame = replace(frame, depth=quantise_depth(frame.depth + 0.05))
        return frame

    def _changes(self, frame: Frame, ahead: list[int]) -> tuple[Change, ...]:
        applied = list(super()._changes(frame, ahead))
        more: list[Change] = []
        things = [one for one, node in self.live.objects.items() if node.state == "static"]
        roads = [edge for edge in self.live.edges.values() if edge.kind == "path"]
        if things and self._now("object gone", frame.index):
            more.append(
                ch.ObjectChanged(
                    cause=UPDATE,
                    object_id=things[0],
                    values=MappingProxyType({"state": "disappeared"}),
                    scores=(Score("missed", 3.0, 3.0),),
                )
            )
        if roads and self._now("edge blocked", frame.index):
            more.append(
                ch.EdgeChanged(
                    cause=PATHS,
                    edge="path",
                    source=roads[0].source,
                    target=roads[0].target,
                    attributes={"blocked": True},
                    scores=(Score("cells", 9.0, 3.0),),
                )
            )
        return tuple(applied + list(self.live.apply_all(more, frame.index, frame.sim_time)))

    def _sighting(self, number: int, name: str, viewpoint: str) -> list[Change]:
        """Merged where its score is high enough, else a new object, as an association does."""
        told = super()._sighting(number, name, viewpoint)
        first = told[0]
        if not isinstance(first, ch.ObjectMerged):
            return told
        index = self.index
        if self.plant == "depth changed" and self.planted == index:
            first = replace(first, points=first.points + np.float32(0.05))
        score = 1.12 + float(np.random.default_rng([self.seed, index, number]).random())
        limit = SCORE + 0.1 * (self.plant == "threshold")
        refused = score < limit
        if refused and self.planted is None:
            self.planted = index
        refused = refused or self._now("merge refused", index)
        scores = (Score("s_geo", 0.8), Score("s_sem", 0.95), Score("s", score, limit))
        if not refused:
            return [replace(first, scores=scores), *told[1:]]
        self.extra += 1
        seen = {
            field: getattr(first, field)
            for field in ("label", "score", "points", "colors", "viewpoint_id", "range_m", "text_feature")
        }
        return [ch.ObjectAdded(cause=CAUSE, scores=scores, object_id=f"object-{self.extra}", **seen)]


def occasions(plant: str, seed: int) -> int:
    """A frame from which a plant shall happen: from the seed, and early enough to have an occasion."""
    latest = {"rank swapped": 24, "answer changed": 24, "verdict changed": 24, "other way": 15}.get(plant, 28)
    earliest = {"edge blocked": 18, "object gone": 9, "merge refused": 6, "depth changed": 6}.get(plant, 1)
    return int(np.random.default_rng([seed, len(plant)]).integers(earliest, latest))
