"""Faults of the update: something is called gone that is there, or stays in the map though it is gone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dssmsg.evaluate.faults.host import Aim
from dssmsg.frame import Frame, Observation
from dssmsg.graph.changes import (
    Cause,
    Change,
    ObjectChanged,
    ObjectRemoved,
    ObjectReplaced,
    ObjectsJoined,
    Score,
)
from dssmsg.graph.nodes import BELIEVED, DISAPPEARED
from dssmsg.interfaces import Context, Update, UpdateResult


@dataclass(slots=True)
class CalledGone:
    """At the end of the survey everything of the target's label is called gone, and stays so."""

    inner: Update
    context: Context
    aim: Aim
    _struck: bool = False

    def update(
        self,
        frame: Frame,
        observations: Sequence[Observation],
        object_ids: Sequence[str | None],
        viewpoint_id: str | None,
    ) -> UpdateResult:
        """The inner one's result, the target's objects gone."""
        result = self.inner.update(frame, observations, object_ids, viewpoint_id)
        return self._gone(result) if self._struck else result

    def finish(self) -> UpdateResult:
        """The end of a visit: from the first one on it strikes."""
        result = self.inner.finish()
        self._struck = True
        return self._gone(result)

    def _gone(self, result: UpdateResult) -> UpdateResult:
        mine = _of_label(self.context, self.aim)
        kept = [
            change for change in result.changes if not (_is_verdict(change) and mine & set(change.subjects))
        ]
        struck = [
            ObjectChanged(
                cause=Cause("update/dssm", "disappeared"),
                scores=(Score("consistent_frames", 3.0, 3.0),),
                object_id=name,
                values={"state": DISAPPEARED},
            )
            for name in sorted(mine)
            if self.context.graph.objects[name].state != DISAPPEARED
            and self.context.graph.objects[name].status == BELIEVED
        ]
        return replace(result, changes=(*kept, *struck))


@dataclass(slots=True)
class NeverGone:
    """No verdict on anything of the target's label ever becomes a change of the map."""

    inner: Update
    context: Context
    aim: Aim

    def update(
        self,
        frame: Frame,
        observations: Sequence[Observation],
        object_ids: Sequence[str | None],
        viewpoint_id: str | None,
    ) -> UpdateResult:
        """The inner one's result without verdicts on the target."""
        return self._left(self.inner.update(frame, observations, object_ids, viewpoint_id))

    def finish(self) -> UpdateResult:
        """The inner one's result without verdicts on the target."""
        return self._left(self.inner.finish())

    def _left(self, result: UpdateResult) -> UpdateResult:
        mine = _of_label(self.context, self.aim)
        kept = tuple(c for c in result.changes if not (_is_verdict(c) and mine & set(c.subjects)))
        windows = tuple(
            replace(
                window, verdicts={name: said for name, said in window.verdicts.items() if name not in mine}
            )
            for window in result.windows
        )
        return UpdateResult(kept, windows)


def _of_label(context: Context, aim: Aim) -> set[str]:
    return {node.id for node in context.graph.objects.values() if node.label == aim.label}


def _is_verdict(change: Change) -> bool:
    if isinstance(change, ObjectChanged):
        return "state" in change.values
    return isinstance(change, ObjectReplaced | ObjectRemoved | ObjectsJoined)
