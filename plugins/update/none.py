"""update/none: no memory of its own; the graph is what association makes of it."""

from __future__ import annotations

from collections.abc import Sequence

from dssmsg.frame import Frame, Observation
from dssmsg.hookspecs import Register, hookimpl
from dssmsg.interfaces.update import UpdateResult


class NoUpdate:
    """Changes nothing: the baseline that every update is measured against."""

    def update(
        self,
        frame: Frame,
        observations: Sequence[Observation],
        object_ids: Sequence[str | None],
        viewpoint_id: str | None,
    ) -> UpdateResult:
        """No changes, no windows."""
        return UpdateResult()

    def finish(self) -> UpdateResult:
        """No changes, no windows."""
        return UpdateResult()


@hookimpl
def register_update(register: Register) -> None:
    """`none`: changes nothing."""
    register("none", lambda config, context: NoUpdate())
