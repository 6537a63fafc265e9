"""An observer plug-in for measurements: resident memory and wall time every so many frames, as JSON lines.

plugins: [benchmarks/probe.py]
recording: {observers: {probe: {path: memory.jsonl}}}
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

from pydantic import Field

from dssmsg.events import Event, FrameCaptured
from dssmsg.hookspecs import PluginConfig, Register, hookimpl


class Config(PluginConfig):
    """Where to write and how often."""

    path: str = Field(description="file to write to; replaced")
    every: int = Field(50, ge=1, description="frames between two lines")


class Probe:
    """Writes one line every `every` frames."""

    def __init__(self, config: Config, _context: object) -> None:
        self._path = Path(config.path)
        self._every = config.every
        self._file = self._path.open("w", encoding="utf-8")

    def on_event(self, event: Event) -> None:
        """Look at frames only."""
        if isinstance(event, FrameCaptured) and event.frame.index % self._every == 0:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
            line = {
                "frame": event.frame.index,
                "mb": round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 2),
                "wall": round(time.monotonic(), 3),
            }
            self._file.write(json.dumps(line) + "\n")
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def outputs(self) -> dict[str, str]:
        """The file."""
        return {"probe": str(self._path)}


@hookimpl
def register_observer(register: Register) -> None:
    """Announce `probe`."""
    register("probe", Probe, config=Config)
