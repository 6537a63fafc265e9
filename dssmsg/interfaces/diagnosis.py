"""diagnosis: read model of a recording -> evidence for a cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, Protocol, runtime_checkable

LAYERS: Mapping[str, str] = MappingProxyType(
    {
        "detector": "what was in view was not detected, or under another name",
        "association": "observations were put together wrongly: one thing in pieces, two things in one",
        "update": "the map was not brought up to date: something gone still in it, something there left out",
        "grounding": "the sentence became no target graph, or another one than it says",
        "matching": "the target graph was held against the map wrongly: the wrong viewpoint won",
        "planner": "the way was planned wrongly: none where there is one, or to another place",
        "control": "the robot did not move as it was told to",
        "environment": "the world, or what the sensors told of it: a blocked way, lost depth, a wrong pose",
    }
)
"""The layers that can be to blame, in the order in which data flows, each with what counts as its fault.
A failing language model counts as `grounding`; the source with its sensors as `environment`."""

BLAME: Mapping[str, str] = MappingProxyType(
    {
        "source": "environment",
        "perception": "detector",
        "tagger": "detector",
        "detector": "detector",
        "segmenter": "detector",
        "encoder": "matching",
        "llm": "grounding",
        "association": "association",
        "update": "update",
        "grounding": "matching",
        "navigation": "planner",
    }
)
"""Plug-in kind -> the layer that it works in."""


@dataclass(frozen=True, slots=True)
class Decision:
    """The score that decided: its value and what it was held against (a threshold, or the runner-up's)."""

    name: str
    value: float
    against: float

    @property
    def margin(self) -> float:
        """How far apart the two are; negative where the value is the smaller one."""
        return self.value - self.against


@dataclass(frozen=True, slots=True)
class Finding:
    """Evidence that a layer is to blame: from which frame on, how sure (0..1), and what was seen.

    `layer` is one of `LAYERS`. `events` is the chain from there to the failure, one line each; `focus` the
    node to look at (`object-12`); `basis` says whether the recorded truth was used, or only what the
    recording itself says does not fit together.
    """

    layer: str
    frame: int
    confidence: float
    summary: str
    events: tuple[str, ...] = ()
    focus: str = ""
    decision: Decision | None = None
    basis: Literal["recording", "truth"] = "recording"


@runtime_checkable
class Diagnosis(Protocol):
    """One rule over a recording (`dssmsg.review.episode.ReviewedRecording`)."""

    def diagnose(self, recording: Any, episode: int | None) -> Sequence[Finding]:
        """Findings, most telling first; none if the rule has nothing to say."""
        ...
