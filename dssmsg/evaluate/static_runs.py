"""Whole missions scored against the truth: static objects of the map, by scene, perception and seed.

One run a scene, perception and seed, each with the configuration as it is otherwise; the truth is read from
the finished recording. What is done stays in a folder, so that a sweep that was cut goes on where it stopped.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dssmsg.config import RunConfig, load_config
from dssmsg.errors import ConfigError
from dssmsg.evaluate.missions import fingerprint, recorded_mission
from dssmsg.evaluate.recorded import score_recording
from dssmsg.host import Host
from dssmsg.recording.reader import Recording

TABLE = "static"


@dataclass(frozen=True, slots=True)
class StaticRun:
    """One finished run and its score; `recording` is relative to the folder of the sweep.

    `missed` and `wrong` name the truth and the objects behind the false negatives and positives; `seconds`
    is the wall time of the run.
    """

    scene: str
    perception: str
    method: str
    seed: int
    recording: str
    precision: float
    recall: float
    f1: float
    right: int
    ignored: int
    missed: tuple[str, ...]
    wrong: tuple[str, ...]
    seconds: float


def evaluate_static(
    work: Path,
    *,
    scenes: Sequence[str],
    perceptions: Sequence[str],
    seeds: Sequence[int],
    config: Path | None = None,
    sets: Sequence[str] = (),
    progress: Callable[[str], None] = lambda _line: None,
) -> list[StaticRun]:
    """Run and score every combination that `work` does not hold yet; all of them come back, in order.

    Finished ones are recognised by their resolved configuration and the version of this package, not by the
    code: use a new folder after changing that. Raises ConfigError before the first run where one of the
    configurations is wrong, or does not record with `rerun`.
    """
    host_of = _Hosts()
    wanted = []
    for scene, perception, seed in _combinations(scenes, perceptions, seeds):
        own = (*sets, f"source.scene={scene}", f"perception.use={perception}")
        resolved = load_config(config, sets=own, seed=seed)
        with resolved.naming_files():
            host = host_of(resolved)
            host.check(resolved)
        if "rerun" not in {slot.use for slot in resolved.recording.observers.values()}:
            raise ConfigError("needs the observer rerun: scores are read from the recording", key="recording")
        wanted.append((f"{scene}-{perception}-{seed}", resolved, host, (scene, perception)))
    done = []
    for number, (name, resolved, host, which) in enumerate(wanted, 1):
        kept = work / f"{name}-{fingerprint(resolved, host)}.json"
        if kept.exists():
            run = _read(kept)
        else:
            run = _carry_out(work, name, resolved, host, which)
            _write(kept, run)
        done.append(run)
        progress(
            f"{number} of {len(wanted)}: {run.scene}, {run.perception}, seed {run.seed}: F1 {run.f1:.3f} "
            f"({run.right} right, {len(run.wrong)} wrong, {len(run.missed)} missed)"
        )
    return done


def static_rows(runs: Sequence[StaticRun]) -> list[dict[str, Any]]:
    """Mean and standard deviation over the seeds, a row a scene, perception and metric; `n` runs each.

    The deviation is that of the sample (n - 1), 0 for one run.
    """
    groups: dict[tuple[str, str, str], list[StaticRun]] = {}
    for run in runs:
        groups.setdefault((run.scene, run.method, run.perception), []).append(run)
    rows = []
    for (scene, method, perception), members in groups.items():
        for metric in ("f1", "precision", "recall"):
            values = np.array([getattr(run, metric) for run in members])
            rows.append({
                "table": TABLE, "scene": scene, "method": method, "perception": perception,
                "metric": f"static_{metric}", "mean": float(values.mean()),
                "std": float(values.std(ddof=1)) if len(values) > 1 else 0.0, "n": len(values),
            })  # fmt: skip
    return rows


def _combinations(
    scenes: Sequence[str], perceptions: Sequence[str], seeds: Sequence[int]
) -> Iterator[tuple[str, str, int]]:
    """Seed by seed, so that a sweep that is cut early has every scene and perception."""
    for seed in seeds:
        for scene in scenes:
            for perception in perceptions:
                yield scene, perception, seed


class _Hosts:
    """One host for all configurations with the same plug-ins: they are loaded once."""

    def __init__(self) -> None:
        self._hosts: dict[tuple[Any, ...], Host] = {}

    def __call__(self, config: RunConfig) -> Host:
        key = (*config.plugins, config.base_dir)
        if key not in self._hosts:
            self._hosts[key] = Host.load(config.plugins, config.base_dir)
        return self._hosts[key]


def _carry_out(work: Path, name: str, config: RunConfig, host: Host, which: tuple[str, str]) -> StaticRun:
    """Run and score one combination; its recording stays in a folder of its own."""
    recording = recorded_mission(work, name, config, host)[0].resolve()
    score = score_recording(recording).score
    with Recording.open(recording) as reader:
        summary = reader.stored_summary
    assert summary is not None  # a mission that ended has told it
    return StaticRun(
        scene=which[0],
        perception=which[1],
        method=config.association.use,
        seed=config.seed,
        recording=str(recording.relative_to(work.resolve())),
        precision=score.precision,
        recall=score.recall,
        f1=score.f1,
        right=score.true_positives,
        ignored=score.ignored,
        missed=score.missed,
        wrong=score.wrong,
        seconds=float(summary["seconds"]["total"]),
    )


def _read(file: Path) -> StaticRun:
    """A kept result; raises ConfigError where the file is not one."""
    try:
        stored = json.loads(file.read_text("utf-8"))
        stored |= {key: tuple(stored[key]) for key in ("missed", "wrong")}
        return StaticRun(**stored)
    except (ValueError, TypeError, KeyError) as error:
        raise ConfigError("is no result of this evaluation; remove it", file=file) from error


def _write(file: Path, run: StaticRun) -> None:
    """Whole or not at all: a result is what marks a run as done."""
    draft = file.with_suffix(".tmp")
    draft.write_text(json.dumps(asdict(run), indent=1) + "\n", "utf-8")
    draft.replace(file)
