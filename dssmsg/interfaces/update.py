"""update: windows, dynamics, re-navigation update -> changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from dssmsg.events import WindowEvaluated
from dssmsg.frame import Frame, Observation
from dssmsg.graph.changes import Change


@dataclass(frozen=True, slots=True, eq=False)
class UpdateResult:
    """Changes to apply and the window evaluations behind them."""

    changes: tuple[Change, ...] = ()
    windows: tuple[WindowEvaluated, ...] = ()


@runtime_checkable
class Update(Protocol):
    """Windows, dynamics and re-navigation (paper III-A end, III-B). The graph is `context.graph`."""

    def update(
        self,
        frame: Frame,
        observations: Sequence[Observation],
        object_ids: Sequence[str | None],
        viewpoint_id: str | None,
    ) -> UpdateResult:
        """After association of one key frame; `object_ids` says what each observation became."""
        ...

    def finish(self) -> UpdateResult:
        """Once a visit is over."""
        ...
