"""observer `progress`: a live line on a terminal, plain lines elsewhere; always on stderr."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any, Literal, TextIO

from pydantic import Field

from dssmsg.events import (
    EpisodeEnded,
    ErrorOccurred,
    Event,
    FrameCaptured,
    GraphChanged,
    NavigationChanged,
    PhaseStarted,
    RunFinished,
    RunStarted,
)
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

if TYPE_CHECKING:
    from dssmsg.interfaces import Context


class Config(PluginConfig):
    """Options of the progress display."""

    style: Literal["auto", "bar", "lines", "off"] = Field(
        default="auto", description="auto: a live line on a terminal, plain lines elsewhere"
    )
    every_secs: float = Field(
        default=5.0, ge=0.1, le=3600.0, description="wall seconds between two plain lines"
    )


class _Tally:
    """What has been seen so far, told in one line."""

    def __init__(self) -> None:
        self.phase = "starting"
        self.frames = self.key_frames = self.changes = self.errors = 0
        self.sim_time = 0.0
        self.state = ""
        self._objects: set[str] = set()

    def take(self, event: Event) -> None:
        match event:
            case PhaseStarted():
                self.phase = event.phase if event.visit == 0 else f"{event.phase} (visit {event.visit})"
            case FrameCaptured():
                self.frames += 1
                self.key_frames += event.key_frame
                self.sim_time = event.frame.sim_time
            case GraphChanged():
                self.changes += len(event.changes)
                for change in event.changes:
                    self._count(change)
            case NavigationChanged():
                self.state = event.state
            case ErrorOccurred():
                self.errors += 1
            case _:
                pass

    def _count(self, change: Any) -> None:
        if change.kind == "object_added":
            self._objects.add(change.object_id)
        elif change.kind == "object_removed":
            self._objects.discard(change.object_id)
        elif change.kind == "objects_joined":
            self._objects.discard(change.absorbed_id)

    def line(self) -> str:
        parts = [
            f"{self.phase}: frame {self.frames} ({self.sim_time:.0f} s)",
            f"{self.key_frames} key frames",
            f"{len(self._objects)} objects",
            f"{self.changes} changes",
        ]
        if self.state:
            parts.append(self.state)
        if self.errors:
            parts.append(f"{self.errors} errors")
        return ", ".join(parts)


class ProgressObserver:
    """Says where the run is. Never fails a run: a closed stderr silences it."""

    def __init__(self, config: Config, context: Context) -> None:
        del context
        self._stream: TextIO = sys.stderr
        style = config.style
        if style == "auto":
            style = "bar" if self._stream.isatty() else "lines"
        self._style = style
        self._every_secs = config.every_secs
        self._tally = _Tally()
        self._due = time.monotonic() + config.every_secs
        self._started = time.monotonic()
        self._status: Any = None

    def on_event(self, event: Event) -> None:
        """Count an event, and show the count now and then."""
        self._tally.take(event)
        if self._style == "off":
            return
        if self._style == "bar":
            self._show_bar(event)
        elif isinstance(event, RunStarted):
            self._say(f"run {event.run_id}: {event.source.name} {event.source.scene}".rstrip())
        elif isinstance(event, PhaseStarted):
            self._say(f"phase {self._tally.phase} begins at frame {event.frame}")
        elif isinstance(event, ErrorOccurred):
            self._say(
                f"{event.plugin}: {event.message}" + (f"; skipped: {event.skipped}" if event.skipped else "")
            )
        elif isinstance(event, EpisodeEnded):
            self._say(f"episode {event.episode} “{event.goal}”: {event.outcome} {event.reason}".rstrip())
        elif isinstance(event, RunFinished) or time.monotonic() >= self._due:
            self._say(self._tally.line())

    def close(self) -> None:
        """Take the live line down; safe to call twice."""
        if self._status is not None:
            self._status.stop()
            self._status = None
            self._say(self._tally.line())

    def outputs(self) -> dict[str, str]:
        """Nothing is left behind."""
        return {}

    def _show_bar(self, event: Event) -> None:
        if self._status is None and not isinstance(event, RunFinished):
            from rich.console import Console
            from rich.status import Status

            self._status = Status("starting", console=Console(file=self._stream, stderr=True))
            self._status.start()
        if self._status is None:
            return
        if isinstance(event, ErrorOccurred):
            self._status.console.print(f"{event.plugin}: {event.message}", markup=False, highlight=False)
        if time.monotonic() >= self._due - self._every_secs + 0.2:  # five times a second is live enough
            self._due = time.monotonic() + self._every_secs
            from rich.markup import escape

            self._status.update(escape(self._tally.line()))

    def _say(self, text: str) -> None:
        self._due = time.monotonic() + self._every_secs
        seconds = time.monotonic() - self._started
        try:
            print(f"[{seconds:6.1f} s] {text}", file=self._stream, flush=True)
        except (OSError, ValueError):
            self._style = "off"


@hookimpl
def register_observer(register: Register) -> None:
    """Announce `progress`."""
    register("progress", ProgressObserver, config=Config)
