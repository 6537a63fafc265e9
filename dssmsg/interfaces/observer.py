"""observer: is told everything."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from dssmsg.events import Event


@runtime_checkable
class Observer(Protocol):
    """Is told every event of a run, in order, on the mission's thread."""

    def on_event(self, event: Event) -> None:
        """Take an event; may block for a moment, never drop. An observer that raises is disabled."""
        ...

    def close(self) -> None:
        """The run is over, however it ended: flush, close; safe to call twice."""
        ...

    def outputs(self) -> dict[str, str]:
        """What it leaves behind: name -> path (e.g. `{"recording": "recordings/x.rrd"}`)."""
        ...
