"""Episodes with one known fault each, explained: is the right layer named, with and without truth?

An episode counts only if it succeeds without the fault and fails with it, both by the truth; its seed is
tried with other homes until it does. The same recording is explained twice, with its truth and as if it had
none. Healthy episodes are the twins without a fault: no fault may be claimed of them.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from dssmsg.config import RunConfig, load_config
from dssmsg.errors import ConfigError, PluginError
from dssmsg.evaluate.diagnosis_cases import ASSETS, FaultCase, fault_of, image_size, make_case
from dssmsg.evaluate.diagnosis_rules import build_rules
from dssmsg.evaluate.diagnosis_views import opened_views
from dssmsg.evaluate.faults.host import FaultyHost, Injection
from dssmsg.evaluate.navigation_witness import EpisodeWitness
from dssmsg.evaluate.workers import each
from dssmsg.host import Host
from dssmsg.mission.run import run_mission
from dssmsg.review.diagnosis import CANNOT_TELL, FAULT, NO_FAULT, NOT_BEGUN, diagnose
from dssmsg.review.episode import ReviewedRecording
from dssmsg.sim.scenario_views import TourViews

TABLE = "diagnosis"
HEALTHY = "healthy"
ATTEMPTS = 20
"""So many homes are tried for a seed."""
SUCCESS = "success"


@dataclass(frozen=True, slots=True)
class Pair:
    """An episode with its fault and its twin without, both recorded. `attempts`: homes that were tried.

    `passed_over` says why the earlier ones made no episode that counts; `faulty` is empty where none did.
    """

    seed: int
    fault: str
    layer: str
    goal: str
    attempts: int
    twin: str = ""
    faulty: str = ""
    reason: str = ""
    passed_over: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Explained:
    """What was said of one recording: a layer, `cannot tell` or `no fault`; `true` is the layer at fault."""

    seed: int
    fault: str
    true: str
    with_truth: bool
    said: str
    confidence: float
    rule: str
    frame: int
    summary: str = ""


def evaluate_diagnosis(
    work: Path,
    *,
    seeds: Sequence[int],
    healthy: int,
    config: Path | None = None,
    sets: Sequence[str] = (),
    jobs: int = 1,
    progress: Callable[[str], None] = lambda _line: None,
) -> list[Explained]:
    """Make the episodes of the seeds, and explain each and the first `healthy` twins, with truth and without.

    What the work folder holds already is not driven again; explanations are always made anew. Raises
    ConfigError and InputError as a run does, PluginError where a run ended its process.
    """
    rules_config = load_config(config, sets=sets)
    rules = build_rules(rules_config, Host.load(rules_config.plugins, rules_config.base_dir))
    found: list[Explained] = []
    healthy_left = healthy
    for pair in _pairs(work, seeds, sets_of(sets), config, jobs, progress):
        if not pair.faulty:
            continue
        found += _explain(work / pair.faulty, pair, pair.layer, rules)
        if healthy_left > 0:
            healthy_left -= 1
            found += _explain(work / pair.twin, pair, HEALTHY, rules)
        told = {one.with_truth: one.said for one in found if one.seed == pair.seed and one.true == pair.layer}
        progress(
            f"seed {pair.seed}, {pair.fault} ({pair.layer}; {pair.reason or 'mistaken'}): with truth"
            f" {told[True]}, without {told[False]}"
        )
    return found


def sets_of(sets: Sequence[str]) -> tuple[str, ...]:
    """The settings that runs share with the explanations: all but those of the rules."""
    return tuple(one for one in sets if not one.startswith("diagnosis"))


def _pairs(
    work: Path,
    seeds: Sequence[int],
    sets: tuple[str, ...],
    config: Path | None,
    jobs: int,
    progress: Callable[[str], None],
) -> list[Pair]:
    """The episodes of the seeds, in their order; several are made at a time, each in a process of its own."""
    made: dict[int, Pair] = {}
    for number, pair in each(partial(make_pair, work, config=config, sets=sets), seeds, jobs):
        made[seeds[number]] = pair
        progress(_made(pair))
    return [made[seed] for seed in seeds]


def _made(pair: Pair) -> str:
    over = f" (passed over: {', '.join(pair.passed_over)})" if pair.passed_over else ""
    if not pair.faulty:
        return f"seed {pair.seed}, {pair.fault}: no episode that counts in {pair.attempts} tries{over}"
    reason = pair.reason or "mistaken"
    return f"seed {pair.seed}, {pair.fault}: made in {pair.attempts} tries, {pair.goal!r}: {reason}{over}"


def make_pair(work: Path, seed: int, config: Path | None, sets: Sequence[str]) -> Pair:
    """The episode of a seed and its twin; what is there already is read."""
    fault = fault_of(seed)
    name = f"{seed:04d}-{fault.name.replace(' ', '_')}"
    folder = work / f"{name}-{metadata.version('dssmsg')}"
    done = folder / "pair.json"
    if done.is_file():
        kept = json.loads(done.read_text("utf-8"))
        return Pair(**{**kept, "passed_over": tuple(kept.get("passed_over", ()))})
    if folder.exists():  # what a run that was cut left behind
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    pair = Pair(seed, fault.name, fault.layer, "", ATTEMPTS)
    passed_over: list[str] = []
    with opened_views() as views:
        for attempt in range(ATTEMPTS):
            tried = _try(work, folder, seed, attempt, views, config, sets)
            if isinstance(tried, Pair):
                pair = tried
                break
            passed_over.append(tried)
    pair = replace(pair, passed_over=tuple(passed_over))
    draft = done.with_suffix(".tmp")
    draft.write_text(json.dumps(asdict(pair), indent=1), "utf-8")
    draft.replace(done)  # whole or not at all: it is what marks the episode as done
    return pair


def _try(
    work: Path,
    folder: Path,
    seed: int,
    attempt: int,
    views: TourViews,
    config: Path | None,
    sets: Sequence[str],
) -> Pair | str:
    """An episode that counts; or why there is none in this home, and then nothing of it is left."""
    place = folder / f"try-{attempt}"
    place.mkdir()
    case = make_case(work, place, seed, attempt, views)
    tried = "no such goal" if case is None else _tried(work, place, case, attempt, config, sets)
    if isinstance(tried, str):
        shutil.rmtree(place)
    return tried


def _tried(
    work: Path, place: Path, case: FaultCase, attempt: int, config: Path | None, sets: Sequence[str]
) -> Pair | str:
    twin = _run(case, place / "twin", config, sets, None)
    if twin is None or twin[0] != SUCCESS:
        return f"twin {'cannot run' if twin is None else 'failed: ' + (twin[1] or 'mistaken')}"
    injection = case.fault.injection(case.aim)
    faulty = _run(case, place / "faulty", config, sets, injection)
    if faulty is None or faulty[0] != "failure":
        return f"faulty {'cannot run' if faulty is None else 'succeeded'}"
    assert injection.carried
    return Pair(
        case.seed,
        case.fault.name,
        case.fault.layer,
        case.goal.text,
        attempt + 1,
        str(twin[2].relative_to(work)),
        str(faulty[2].relative_to(work)),
        faulty[1],
    )


def _run(
    case: FaultCase, folder: Path, config: Path | None, sets: Sequence[str], injection: Injection | None
) -> tuple[str, str, Path] | None:
    """Outcome and reason by the truth, and the recording of a run; None where it cannot be made."""
    run = _configuration(case, folder, config, sets)
    witness = EpisodeWitness([case.goal.targets])
    try:
        with run.naming_files():
            result = run_mission(run, FaultyHost.loaded(run, injection), observers=[("evaluation", witness)])
    except ConfigError:  # a barrier that does not fit into its door
        return None
    recording = result.summary.get("recording")
    if not witness.judged or not recording:
        return None
    judged = witness.judged[0]
    return judged.outcome, judged.reason, Path(recording)


def _configuration(case: FaultCase, folder: Path, config: Path | None, sets: Sequence[str]) -> RunConfig:
    """A survey of the small home (and a revisit, where things move), then the goal."""
    mission: Mapping[str, Any] = {
        "phases": list(case.phases),
        "seek_visit": "same" if case.fault.changes else "next",
        "goals": [case.goal.text],
        "max_frames": 3000,
        "candidates": 1,
        "episode_secs": 90.0,
    }
    width, height = image_size(case.fault)
    wanted = [
        f"seed={case.seed}",
        f"source.scene={json.dumps(str(case.scene.resolve()))}",
        f"source.assets={ASSETS}",
        f"source.width={width}",
        f"source.height={height}",
        "mission.views_per_heading=2",
        'perception={"use": "oracle", "miss_rate": 0.03, "mask_error_px": 1}',
        *(f"mission.{key}={json.dumps(value)}" for key, value in mission.items()),
        f"recording.directory={json.dumps(str(folder))}",
    ]
    return load_config(config, sets=[*wanted, *sets])


def _explain(path: Path, pair: Pair, true: str, rules: Sequence[tuple[str, Any]]) -> list[Explained]:
    """What is said of the recording's episode, with its truth and without."""
    told = []
    for with_truth in (True, False):
        with ReviewedRecording.open(path) as recording:
            recording.hides_truth = not with_truth
            found = diagnose(recording, 0, rules)
        if found.problems:
            raise PluginError("; ".join(found.problems), plugin="diagnosis", file=path)
        lead = found.findings[0] if found.verdict == FAULT else None
        told.append(
            Explained(
                pair.seed,
                pair.fault,
                true,
                with_truth,
                found.layer if found.verdict == FAULT else found.verdict,
                0.0 if lead is None else lead.finding.confidence,
                "" if lead is None else lead.rule,
                -1 if lead is None else lead.finding.frame,
                "" if lead is None else lead.finding.summary,
            )
        )
    return told


def diagnosis_rows(explained: Sequence[Explained]) -> list[dict[str, Any]]:
    """Rows `table`, `scene` (development, reported), `method`, `perception`, `metric`, `mean`, `std`, `n`.

    Of faulty episodes: `layer_accuracy_*` (the right layer), `wrong_*` (another one), `cannot_tell_*` (none),
    each `with_truth` and `without_truth`, and the accuracy of each layer; of healthy ones `healthy_silent_*`.
    """
    rows = []
    for half, parity in (("development", 0), ("reported", 1)):
        own = [one for one in explained if one.seed % 2 == parity]
        for metric, values in _metrics(own).items():
            rows.append(
                {
                    "table": TABLE,
                    "scene": half,
                    "method": "dssmsg",
                    "perception": "oracle",
                    "metric": metric,
                    "mean": float(np.mean(values)),
                    "std": float(np.std(values)),
                    "n": len(values),
                }
            )
    return rows


def _metrics(own: Sequence[Explained]) -> dict[str, list[float]]:
    metrics: dict[str, list[float]] = {}
    for with_truth, ending in ((True, "with_truth"), (False, "without_truth")):
        faulty = [one for one in own if one.with_truth == with_truth and one.true != HEALTHY]
        healthy = [one for one in own if one.with_truth == with_truth and one.true == HEALTHY]
        if faulty:
            right = [float(one.said == one.true) for one in faulty]
            none = [float(one.said in (CANNOT_TELL, NO_FAULT, NOT_BEGUN)) for one in faulty]
            metrics[f"layer_accuracy_{ending}"] = right
            metrics[f"wrong_{ending}"] = [1.0 - a - b for a, b in zip(right, none, strict=True)]
            metrics[f"cannot_tell_{ending}"] = none
            for layer in dict.fromkeys(one.true for one in faulty):
                metrics[f"{layer}_{ending}"] = [float(o.said == layer) for o in faulty if o.true == layer]
        if healthy:
            metrics[f"healthy_silent_{ending}"] = [float(one.said == NO_FAULT) for one in healthy]
    return metrics


def confusion(explained: Sequence[Explained], *, with_truth: bool) -> dict[str, dict[str, int]]:
    """True layer (or healthy) -> what was said -> how often."""
    table: dict[str, dict[str, int]] = {}
    for one in explained:
        if one.with_truth == with_truth:
            row = table.setdefault(one.true, {})
            row[one.said] = row.get(one.said, 0) + 1
    return table
