"""Faults of the association: one thing in pieces, two things in one object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dssmsg.evaluate.faults.host import Aim
from dssmsg.frame import Frame, Observation
from dssmsg.graph.changes import Change, ObjectAdded, ObjectChanged, ObjectMerged, ObjectsJoined, Score
from dssmsg.graph.nodes import DISAPPEARED
from dssmsg.interfaces import Association, Context


@dataclass(slots=True)
class SplitObject:
    """Every detection of the target's label becomes an object of its own, and none are ever joined."""

    inner: Association
    context: Context
    aim: Aim

    def associate(
        self, frame: Frame, observations: Sequence[Observation], viewpoint_id: str | None
    ) -> Sequence[Change]:
        """The inner one's changes, merges of the target made new objects."""
        seen = {one.detection_index: one for one in observations}
        return [
            made
            for change in self.inner.associate(frame, observations, viewpoint_id)
            if (made := self._apart(change, seen)) is not None
        ]

    def finish(self) -> Sequence[Change]:
        """The inner one's, without joins of the target."""
        return [change for change in self.inner.finish() if not self._joins(change)]

    def _apart(self, change: Change, seen: dict[int, Observation]) -> Change | None:
        if self._joins(change) or self._believes(change):
            return None
        if not isinstance(change, ObjectMerged) or change.label != self.aim.label:
            return change
        one = seen.get(change.detection)
        if one is None:
            return change
        return ObjectAdded(
            cause=replace(change.cause, rule="new"),
            scores=(Score("s", 0.0, _threshold(change.scores)),),
            object_id=self.context.ids.new("object"),
            label=change.label,
            score=change.score,
            points=one.points_world,
            colors=one.colors,
            viewpoint_id=change.viewpoint_id,
            range_m=change.range_m,
            detection=change.detection,
            text_feature=change.text_feature,
            image_feature=change.image_feature,
        )

    def _believes(self, change: Change) -> bool:
        """Whether it calls a piece believed, for merges that did not come to be."""
        if not isinstance(change, ObjectChanged) or "status" not in change.values:
            return False
        node = self.context.graph.objects.get(change.object_id)
        return node is not None and node.label == self.aim.label

    def _joins(self, change: Change) -> bool:
        if not isinstance(change, ObjectsJoined):
            return False
        ends = (self.context.graph.objects.get(name) for name in (change.object_id, change.absorbed_id))
        return any(end is not None and end.label == self.aim.label for end in ends)


@dataclass(slots=True)
class WrongMerge:
    """Detections of the target's label are put into the nearest object of another label."""

    inner: Association
    context: Context
    aim: Aim
    _hosts: dict[tuple[int, int, int], str] = field(default_factory=dict)

    def associate(
        self, frame: Frame, observations: Sequence[Observation], viewpoint_id: str | None
    ) -> Sequence[Change]:
        """The inner one's changes, new objects of the target's label merged into others."""
        made: list[Change] = []
        never: set[str] = set()
        for change in self.inner.associate(frame, observations, viewpoint_id):
            if isinstance(change, ObjectAdded) and change.label == self.aim.label:
                host = self._host(change)
                if host is not None:
                    never.add(change.object_id)
                    made.append(_merged(change, host))
                    continue
            if not never & set(change.subjects):
                made.append(change)
        return made

    def finish(self) -> Sequence[Change]:
        """The inner one's."""
        return self.inner.finish()

    def _host(self, change: ObjectAdded) -> str | None:
        """The object that it is put into; the same one for the same place."""
        center = np.asarray(change.points).mean(axis=0)
        cell = (round(float(center[0])), round(float(center[1])), round(float(center[2])))
        host = self._hosts.get(cell)
        if host is not None and host in self.context.graph.objects:
            return host
        others = [
            node
            for node in self.context.graph.objects.values()
            if node.label != self.aim.label and node.state != DISAPPEARED
        ]
        if not others:
            return None
        nearest = min(others, key=lambda node: float(np.linalg.norm(node.center - center)))
        self._hosts[cell] = nearest.id
        return nearest.id


def _merged(change: ObjectAdded, host: str) -> ObjectMerged:
    """The observation as if the host had won it, with scores as of a merge that is rightly believed."""
    threshold = _threshold(change.scores)
    return ObjectMerged(
        cause=replace(change.cause, rule="merge"),
        scores=(
            Score("s", threshold + 0.35, threshold),
            Score("s_geo", threshold - 0.55, None),
            Score("s_sem", 0.9, 0.9),
        ),
        object_id=host,
        label=change.label,
        score=change.score,
        points=change.points,
        colors=change.colors,
        viewpoint_id=change.viewpoint_id,
        range_m=change.range_m,
        detection=change.detection,
        text_feature=change.text_feature,
        image_feature=change.image_feature,
    )


def _threshold(scores: Sequence[Score]) -> float:
    return next((s.threshold for s in scores if s.name == "s" and s.threshold is not None), 1.1)
