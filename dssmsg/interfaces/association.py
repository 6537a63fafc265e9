"""association: observations + graph -> changes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from dssmsg.frame import Frame, Observation
from dssmsg.graph.changes import Change


@runtime_checkable
class Association(Protocol):
    """Observations + graph -> changes (paper III-A). The graph is `context.graph`."""

    def associate(
        self, frame: Frame, observations: Sequence[Observation], viewpoint_id: str | None
    ) -> Sequence[Change]:
        """Changes that bring the observations of one key frame into the graph."""
        ...

    def finish(self) -> Sequence[Change]:
        """Changes to make once a visit is over (a last merge pass, dropping the unconfirmed)."""
        ...
