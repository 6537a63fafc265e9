"""diagnosis: read model of a recording -> evidence for a cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable


@dataclass(frozen=True, slots=True)
class Finding:
    """Evidence that a layer is to blame: from which frame on, how sure (0..1), and what was seen."""

    layer: str
    frame: int
    confidence: float
    summary: str
    events: tuple[str, ...] = ()


@runtime_checkable
class Diagnosis(Protocol):
    """One rule over a recording (`dssmsg.recording.reader.Recording`)."""

    def diagnose(self, recording: Any, episode: int | None) -> Sequence[Finding]:
        """Findings, most telling first; none if the rule has nothing to say."""
        ...
