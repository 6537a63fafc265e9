"""Homes that change, recorded once and replayed through every method on identical frames and detections.

What is done stays in a work folder: recordings, and a score a method. An evaluation that was cut goes on
where it stopped; a run that was killed is repeated.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import metadata
from pathlib import Path
from time import perf_counter
from typing import Any

from dssmsg.config import RunConfig, load_config
from dssmsg.errors import ConfigError
from dssmsg.evaluate.dynamic_states import GraphWatch, States
from dssmsg.evaluate.dynamic_truth import RunTruth, run_truth
from dssmsg.evaluate.missions import recorded_mission
from dssmsg.evaluate.replay_score import ReplayScore, score_replay
from dssmsg.evaluate.workers import each
from dssmsg.frame import Detection, Frame, MaskArray
from dssmsg.host import Host
from dssmsg.lift import Lifted, Lifter
from dssmsg.mission.replay_config import recorded_slot
from dssmsg.mission.run import Mission
from dssmsg.recording.reader import Recording

FRAMES_A_VISIT = 700
"""More than any tour of a visit takes: no run ends by its budget."""
SCORES_VERSION = 1
"""Counts up where the same replay would be scored differently: older results are then made again."""


@dataclass(frozen=True, slots=True)
class Method:
    """A way of keeping the map: an association and an update, and where its objects' states come from."""

    name: str
    association: Mapping[str, Any]
    update: Mapping[str, Any]
    states: States = "derived"


METHODS = {
    method.name: method
    for method in (
        Method("dssm", {"use": "dssm"}, {"use": "dssm"}, "graph"),
        Method(
            "dssm_paper_exact",
            {"use": "dssm", "paper_exact": True},
            {"use": "dssm", "paper_exact": True},
            "graph",
        ),
        Method("conceptgraphs", {"use": "conceptgraphs"}, {"use": "none"}),
        Method("dovsg", {"use": "dovsg"}, {"use": "dovsg"}),
        Method("none", {"use": "dssm"}, {"use": "none"}),
    )
}


@dataclass(frozen=True, slots=True)
class Case:
    """One home that changes: a scene, and what the seed makes happen in it between `visits` visits.

    Without `counts` the scene's own script happens; `file` is a scene file to take instead of `scene`, which
    then only names it.
    """

    scene: str
    seed: int
    perception: str
    counts: Mapping[str, int] = field(default_factory=dict)
    visits: int = 2
    file: Path | None = None

    @property
    def name(self) -> str:
        """For files and people; cases that differ in counts alone differ in their fingerprint."""
        return f"{self.scene.replace(':', '_').replace('/', '_')}-{self.perception}-{self.seed}"


@dataclass(frozen=True, slots=True)
class Setup:
    """Where the work is kept, and the configuration that everything else is taken from."""

    work: Path
    config: Path | None = None
    sets: tuple[str, ...] = ()


class KeptLifter(Lifter):
    """Lifts each frame once: the methods are shown the same detections, so what is lifted is the same."""

    def __init__(self) -> None:
        super().__init__()
        self._kept: dict[int, Lifted] = {}

    def lift(
        self, frame: Frame, detections: Sequence[Detection], kept: Mapping[int, MaskArray] | None = None
    ) -> Lifted:
        """What the first call for the frame gave."""
        if frame.index not in self._kept:
            self._kept[frame.index] = super().lift(frame, detections, kept)
        return self._kept[frame.index]


Progress = Callable[[str], None]


def methods_named(names: Sequence[str]) -> list[Method]:
    """The methods of these names; ConfigError for an unknown one."""
    for name in names:
        if name not in METHODS:
            raise ConfigError(f"unknown method {name!r}; known: {', '.join(METHODS)}", key="--methods")
    return [METHODS[name] for name in dict.fromkeys(names)]


def replay_cases(
    setup: Setup,
    cases: Sequence[Case],
    methods: Sequence[Method],
    *,
    jobs: int = 1,
    progress: Progress = lambda _line: None,
) -> list[ReplayScore]:
    """Every method's score on every case, cases in order; what the work folder does not hold yet is made now.

    `jobs` is how many cases are worked on at a time, each in a process of its own. Raises ConfigError before
    anything is run where a configuration is wrong, PluginError where a plug-in ended its process.
    """
    for case in cases:
        _check(setup, case, methods)
    setup.work.mkdir(parents=True, exist_ok=True)
    found: dict[int, list[ReplayScore]] = {}
    for number, scores in each(partial(replay_case, setup, methods=methods), cases, jobs):
        found[number] = scores
        progress(_line(len(found), len(cases), cases[number], scores))
    return [score for number in range(len(cases)) for score in found[number]]


def replay_case(setup: Setup, case: Case, methods: Sequence[Method]) -> list[ReplayScore]:
    """Record one case, replay the methods on it, and score them; what is there already is read."""
    config = _case_config(setup, case)
    host = _host(config)
    path, made = recorded_mission(setup.work, case.name, config, host)
    folder = path.parent
    scores: list[ReplayScore] = []
    truth: RunTruth | None = None
    lifter = KeptLifter()
    for method in methods:
        replay = _replay_config(setup, case, method, path)
        host = _host(replay)
        kept = folder / f"{method.name}-{_fingerprint(replay, host)}.json"
        if kept.is_file() and not made:
            scores.append(ReplayScore.read(kept))
            continue
        if truth is None:
            with Recording.open(path) as recording:
                truth = run_truth(recording)
        began = perf_counter()
        watch = GraphWatch()
        with replay.naming_files():
            mission = Mission(replay, host, [("scores", watch)], lifter=lifter)
            watch.graph = mission.graph
            summary = mission.run().summary
        score = score_replay(
            watch,
            truth,
            method.states,
            scene=case.scene,
            seed=case.seed,
            perception=case.perception,
            method=method.name,
            recording=str(path.relative_to(setup.work)),
            seconds=round(perf_counter() - began, 2),
            errors=int(summary["errors"]),
        )
        score.write(kept)
        scores.append(score)
    return scores


def _line(done: int, of: int, case: Case, scores: Sequence[ReplayScore]) -> str:
    figures = ", ".join(f"{score.method} {score.dynamic.f1:.2f}" for score in scores)
    errors = sum(score.errors for score in scores)
    told = f"; {errors} errors" if errors else ""
    return f"{done} of {of}: {case.scene}, seed {case.seed}: dynamic F1 {figures}{told}"


def _check(setup: Setup, case: Case, methods: Sequence[Method]) -> None:
    """Refuse a wrong configuration before the first run."""
    config = _case_config(setup, case)
    if config.source.use != "pybullet":
        raise ConfigError("changing homes need the source pybullet", key="source.use")
    _host(config).check(config)
    for method in methods:
        sets = (
            *setup.sets,
            *_slot_sets("association", method.association),
            *_slot_sets("update", method.update),
        )
        own = load_config(setup.config, sets=sets)
        with own.naming_files():
            _host(own).check(own)


def _case_config(setup: Setup, case: Case) -> RunConfig:
    phases = ["survey", *["revisit"] * (case.visits - 1)]
    sets = [
        *setup.sets,
        f"source.scene={case.scene if case.file is None else json.dumps(str(case.file.resolve()))}",
        f"source.visits={case.visits}",
        f"perception.use={case.perception}",
        f"mission.phases={_flow(phases)}",
        f"mission.max_frames={FRAMES_A_VISIT * case.visits}",
    ]
    if case.counts:
        sets += [f"source.changes=generated:{case.seed}", f"source.change_counts={_flow(dict(case.counts))}"]
    return load_config(setup.config, sets=sets, seed=case.seed)


def _replay_config(setup: Setup, case: Case, method: Method, recording: Path) -> RunConfig:
    sets = [
        *setup.sets,
        f"source={_flow(recorded_slot(recording, 'recording', key_frames=True))}",
        f"perception={_flow(recorded_slot(recording))}",
        *_slot_sets("association", method.association),
        *_slot_sets("update", method.update),
        f"mission.max_frames={FRAMES_A_VISIT * case.visits}",
        "recording.observers.rerun=false",
    ]
    return load_config(setup.config, sets=sets, seed=case.seed)


def _slot_sets(kind: str, options: Mapping[str, Any]) -> list[str]:
    return [f"{kind}.{key}={_flow(value)}" for key, value in options.items()]


def _flow(value: Any) -> str:
    """A value as one line of YAML, of which JSON is a part."""
    return json.dumps(value)


def _host(config: RunConfig) -> Host:
    with config.naming_files():
        return Host.load(config.plugins, config.base_dir)


def _fingerprint(config: RunConfig, host: Host) -> str:
    """What a score depends on, but for the code: the method's slots and how scores are counted."""
    resolved = host.resolved(config)
    slots = {kind: resolved[kind] for kind in ("association", "update", "encoder", "llm")}
    text = json.dumps([metadata.version("dssmsg"), SCORES_VERSION, slots], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:10]
