"""Seeded episodes of language navigation: success, SPL, re-plans, reasons of failures (ALGORITHM, Scores).

One survey a (scene, seed), then several episodes from it in the visit after: with the scene's changes, which
the robot has not seen yet, and with obstacles that appear on its way.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from dssmsg.config import RunConfig, load_config
from dssmsg.errors import InputError
from dssmsg.evaluate.missions import fingerprint
from dssmsg.evaluate.navigation_cases import Case, Home, make_case
from dssmsg.evaluate.navigation_witness import EpisodeWitness, Judged
from dssmsg.evaluate.workers import each
from dssmsg.host import Host
from dssmsg.mission.run import run_mission

TABLE = "navigation"
GENERATED = "generated"
ALL = "all"
_MAX_FRAMES = 1_000_000


@dataclass(frozen=True, slots=True)
class Episode:
    """A judged episode with where it came from. `shortest`: metres of the shortest way, None without one."""

    scene: str
    perception: str
    method: str
    seed: int
    judged: Judged
    shortest: float | None
    recording: str = ""

    @property
    def spl(self) -> float:
        """Success weighted by path length: shortest over driven, 0 for a failure."""
        if self.judged.outcome != "success":
            return 0.0
        if not self.shortest:
            return 1.0
        return self.shortest / max(self.judged.metres, self.shortest)


def scene_list(names: Sequence[str], homes: int) -> list[str]:
    """Scene names, `generated` standing for the first so many generated homes."""
    return [
        scene
        for name in names
        for scene in ([f"generated:{seed}" for seed in range(1, homes + 1)] if name == GENERATED else [name])
    ]


def evaluate_navigation(
    work: Path,
    *,
    scenes: Sequence[str],
    perception: str,
    episodes: int,
    per_survey: int = 10,
    obstacles: int = 3,
    seed: int = 0,
    config: Path | None = None,
    sets: Sequence[str] = (),
    record: bool = False,
    jobs: int = 1,
    progress: Callable[[str], None] = lambda _line: None,
) -> list[Episode]:
    """About `episodes` episodes, shared out evenly over the scenes, `per_survey` from each survey.

    `jobs` surveys are worked on at a time. Finished surveys' episodes are kept in `work` and not driven
    again; they are recognised by their resolved configuration and this package's version. Raises ConfigError
    and InputError as a run does, PluginError where a run ended its process.
    """
    surveys = _surveys(scenes, episodes, per_survey, seed)
    setup = _Setup(work, perception, obstacles, config, tuple(sets), record)
    done: dict[int, list[Episode]] = {}
    for number, batch in each(partial(_one_survey, setup), surveys, jobs):
        done[number] = batch
        scene, run_seed, _ = surveys[number]
        won = sum(one.judged.outcome == "success" for one in batch)
        progress(f"{scene}, seed {run_seed}, {perception}: {won} of {len(batch)} reached")
    return [episode for number in range(len(surveys)) for episode in done[number]]


Survey = tuple[str, int, int]
"""A scene, the seed of the run, and how many episodes follow."""


def _surveys(scenes: Sequence[str], episodes: int, per_survey: int, seed: int) -> list[Survey]:
    """Scene by scene, then the next seed, until there are enough episodes."""
    surveys: list[Survey] = []
    for number, first in enumerate(range(0, episodes, per_survey)):
        rounds, place = divmod(number, len(scenes))
        surveys.append((scenes[place], seed + rounds, min(per_survey, episodes - first)))
    return surveys


@dataclass(frozen=True, slots=True)
class _Setup:
    """What all surveys of an evaluation share."""

    work: Path
    perception: str
    obstacles: int
    config: Path | None
    sets: tuple[str, ...]
    record: bool


@cache
def _home(scene: str, assets: str) -> Home:
    return Home(scene, assets)


def _one_survey(setup: _Setup, survey: Survey) -> list[Episode]:
    """The judged episodes of a survey; driven now unless the work folder holds them."""
    scene, seed, count = survey
    plain = load_config(setup.config, sets=[f"source.scene={scene}", *setup.sets])
    home = _home(scene, str(plain.source.options.get("assets", "auto")))
    case = make_case(home, seed, count, setup.obstacles)
    run = _configuration(case, setup.perception, setup.config, setup.sets, setup.record)
    with run.naming_files():
        host = Host.load(run.plugins, run.base_dir)
        host.check(run)
    name = re.sub(r"[^A-Za-z0-9_]+", "_", Path(scene).name)
    folder = setup.work / f"navigation-{name}-{setup.perception}-{seed}-{fingerprint(run, host)}"
    finished = folder / "episodes.json"
    if finished.is_file():
        return [_episode(row) for row in json.loads(finished.read_text("utf-8"))]
    folder.mkdir(parents=True, exist_ok=True)
    placed = run.model_copy(update={"recording": run.recording.model_copy(update={"directory": str(folder)})})
    witness = EpisodeWitness([goal.targets for goal in case.goals])
    with placed.naming_files():
        result = run_mission(placed, host, observers=[("evaluation", witness)])
    if len(witness.judged) != len(case.goals):
        raise InputError(f"only {len(witness.judged)} of {len(case.goals)} episodes were driven", file=folder)
    method = f"{run.grounding.use} + {run.navigation.use}"
    recording = str(result.summary.get("recording") or "")
    batch = [
        Episode(
            scene,
            setup.perception,
            method,
            seed,
            judged,
            home.shortest(judged.start, judged.goals),
            recording,
        )
        for judged in witness.judged
    ]
    draft = finished.with_suffix(".tmp")
    draft.write_text(json.dumps([asdict(one) for one in batch], indent=1), "utf-8")
    draft.replace(finished)  # whole or not at all: it is what marks the survey as done
    return batch


def _configuration(
    case: Case, perception: str, config: Path | None, sets: Sequence[str], record: bool
) -> RunConfig:
    """A survey, then the case's goals in the next visit."""
    mission = {
        "phases": ["survey", "seek"],
        "seek_visit": "next",
        "goals": [goal.text for goal in case.goals],
        "max_frames": _MAX_FRAMES,
    }
    obstacles = [one.model_dump(mode="json", exclude_none=True) for one in case.obstacles]
    wanted = [
        f"seed={case.seed}",
        f"source.scene={case.scene}",
        f"source.obstacles={json.dumps(obstacles)}",
        f"perception={json.dumps({'use': perception})}",
        *(f"mission.{key}={json.dumps(value)}" for key, value in mission.items()),
    ]
    if not record:
        wanted.append("recording.observers.rerun=false")
    return load_config(config, sets=[*wanted, *sets])


def _episode(row: Mapping[str, Any]) -> Episode:
    """An episode as it was kept."""
    told = dict(row["judged"])
    for name in ("start", "end"):
        told[name] = tuple(told[name])
    told["goals"] = tuple(tuple(place) for place in told["goals"])
    return Episode(**{**row, "judged": Judged(**told)})


def navigation_rows(episodes: Sequence[Episode]) -> list[dict[str, Any]]:
    """Rows `table`, `scene`, `method`, `perception`, `metric`, `mean`, `std`, `n`, by scene and over all.

    Void episodes count for nothing but `void`. Generated homes are one scene. `failed:<reason>` is the share
    of all counted episodes that failed for that reason; `collisions` that of those which touched something.
    """
    groups: dict[tuple[str, str, str], list[Episode]] = {}
    for one in episodes:
        scene = GENERATED if one.scene.startswith(GENERATED) else one.scene
        for name in (scene, ALL):
            groups.setdefault((name, one.method, one.perception), []).append(one)
    rows = []
    for (scene, method, perception), group in sorted(
        groups.items(), key=lambda item: (item[0][0] == ALL, item[0])
    ):
        for metric, values in _metrics(group).items():
            rows.append(
                {
                    "table": TABLE,
                    "scene": scene,
                    "method": method,
                    "perception": perception,
                    "metric": metric,
                    "mean": float(np.mean(values)) if values else float("nan"),
                    "std": float(np.std(values)) if values else float("nan"),
                    "n": len(values),
                }
            )
    return rows


def _metrics(group: Sequence[Episode]) -> dict[str, list[float]]:
    counted = [one for one in group if one.judged.outcome != "void"]
    reasons = Counter(one.judged.reason for one in counted if one.judged.outcome == "failure")
    metrics = {
        "success": [float(one.judged.outcome == "success") for one in counted],
        "spl": [one.spl for one in counted],
        "replans": [float(one.judged.replans) for one in counted],
        "detours": [float(one.judged.detours) for one in counted],
        "metres": [one.judged.metres for one in counted],
        "collisions": [float(one.judged.collisions > 0) for one in counted],
        "void": [float(one.judged.outcome == "void") for one in group],
    }
    for reason in sorted(reasons):
        metrics[f"failed:{reason}"] = [
            float(one.judged.outcome == "failure" and one.judged.reason == reason) for one in counted
        ]
    return metrics
