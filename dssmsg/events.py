"""What observers are told: frozen values, in the order in which things happened.

Every event stands for itself: an observer keeps no reference to the mission, the graph or a plug-in.
`sim_time` is seconds of the source's clock, `wall` fields are left out of anything deterministic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from dssmsg.frame import Detection, Frame, MaskArray, Observation, Truth
from dssmsg.graph.changes import Change
from dssmsg.graph.verdicts import Evidence

if TYPE_CHECKING:  # dssmsg.interfaces imports this module
    from dssmsg.interfaces.source import Command, SourceInfo


@dataclass(frozen=True, slots=True, eq=False)
class RunStarted:
    """The first event. `config` is the resolved configuration; `plugins` kind -> name, version, origin."""

    run_id: str
    name: str
    seed: int
    config: Mapping[str, Any]
    source: SourceInfo
    plugins: Mapping[str, Mapping[str, str]]
    versions: Mapping[str, str]
    parent: str | None = None
    feature_space: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PhaseStarted:
    """A phase of the mission (survey, revisit, seek) begins."""

    phase: str
    visit: int
    frame: int
    sim_time: float


@dataclass(frozen=True, slots=True, eq=False)
class FrameCaptured:
    """A frame without truth, as every plug-in sees it, and the command that led to it."""

    frame: Frame
    command: Command | None
    key_frame: bool
    viewpoint_id: str | None
    collisions: int


@dataclass(frozen=True, slots=True, eq=False)
class TruthSeen:
    """The simulator's truth of a frame; told apart from the frame so that nobody gets it by accident."""

    frame: int
    sim_time: float
    truth: Truth


@dataclass(frozen=True, slots=True, eq=False)
class Detected:
    """What perception saw in a key frame, and what could be lifted of it.

    `kept`: by the index of each observation's detection, which (V,) of the voxels of its mask are of the
    thing.
    """

    frame: int
    sim_time: float
    detections: tuple[Detection, ...]
    observations: tuple[Observation, ...]
    kept: Mapping[int, MaskArray] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class GraphChanged:
    """The stamped changes of one frame, in the order of application; told once a frame."""

    frame: int
    sim_time: float
    changes: tuple[Change, ...]


@dataclass(frozen=True, slots=True, eq=False)
class WindowEvaluated:
    """One evaluation of a viewpoint's window (ALGORITHM B)."""

    viewpoint_id: str
    frame: int
    sim_time: float
    base: tuple[int, ...]
    comparison: tuple[int, ...]
    evidence: tuple[Evidence, ...]
    verdicts: Mapping[str, str]
    threshold: int


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One ranked viewpoint of a query with its scores, the matching and the reason."""

    viewpoint_id: str
    rank: int
    scores: Mapping[str, float]
    matching: Mapping[str, str]
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """A query was grounded: every candidate, best first. `target` is the target graph as JSON values."""

    query: str
    frame: int
    sim_time: float
    target: Mapping[str, Any]
    candidates: tuple[Candidate, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LlmCalled:
    """One call of an LLM, failed ones too. `request_hash` is over the canonical request; no key is in it."""

    role: str
    provider: str
    frame: int
    sim_time: float
    prompt: str
    answer: str
    request_hash: str
    ok: bool
    error: str = ""
    tokens: int | None = None
    seconds: float = 0.0
    attempt: int = 1
    """Counts the exchanges of one question from 1: tries, the repair of an answer, the fallback."""
    fallback_for: str = ""
    """The provider that failed, where this one stood in for it."""


@dataclass(frozen=True, slots=True, eq=False)
class NavigationChanged:
    """The driver's state changed: `state` is one word (turn, drive, look, detour, replan, arrived, ...)."""

    frame: int
    sim_time: float
    state: str
    detail: str = ""
    path: tuple[str, ...] = ()
    """Waypoint ids still to visit, the goal last."""
    target_xy: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Advised:
    """In a replay: what navigation asked for before a frame, while the robot did what was recorded."""

    frame: int
    sim_time: float
    command: Command


@dataclass(frozen=True, slots=True, eq=False)
class EpisodeEnded:
    """A goal was reached or given up: outcome success, or the named reason of the failure."""

    episode: int
    goal: str
    outcome: str
    reason: str
    frame: int
    sim_time: float
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class ErrorOccurred:
    """A plug-in failed, or work was skipped; `plugin` is `kind/name`, `fatal` ends the run."""

    frame: int
    sim_time: float
    plugin: str
    message: str
    skipped: str = ""
    fatal: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class StageTimed:
    """Wall seconds by stage for one frame; never part of anything deterministic."""

    frame: int
    sim_time: float
    seconds: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Logged:
    """A line of a plug-in's or the host's logger; level as in `logging`."""

    frame: int
    sim_time: float
    logger: str
    level: str
    message: str


@dataclass(frozen=True, slots=True, eq=False)
class RunFinished:
    """The last event; `summary` is what `dssmsg run --json` prints."""

    frame: int
    sim_time: float
    summary: Mapping[str, Any]


Event = (
    RunStarted
    | PhaseStarted
    | FrameCaptured
    | TruthSeen
    | Detected
    | GraphChanged
    | WindowEvaluated
    | Matched
    | LlmCalled
    | NavigationChanged
    | Advised
    | EpisodeEnded
    | ErrorOccurred
    | StageTimed
    | Logged
    | RunFinished
)
