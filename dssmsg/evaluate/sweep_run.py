"""One run of a sweep: carried out by whichever process it is given to, its result kept in the run's folder.

A result is written last, and whole or not at all: it is what marks a run as done. Two processes that are
given the same run (the one before was cut off and is still dying) take turns by a lock that the system lifts
when its holder ends.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import chdir, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from dssmsg.errors import DssmsgError, InputError
from dssmsg.evaluate.static import score_static
from dssmsg.evaluate.sweep_matrix import Run
from dssmsg.evaluate.visible import VisibleTruth
from dssmsg.events import Event, FrameCaptured, TruthSeen
from dssmsg.frame import Frame

RESULT, FAILURE = "result.json", "failure.json"


@dataclass(frozen=True, slots=True)
class Result:
    """What a run came to. `recording` stands in the run's folder; "" where nothing was recorded.

    `metrics` are figures that the same configuration, scene and seed always give; `seconds` is wall time.
    `error` says why a run did not end; such a run is carried out again by the next sweep.
    """

    configuration: str
    scene: str
    seed: int
    folder: str
    recording: str
    metrics: Mapping[str, float]
    episodes: tuple[Mapping[str, str], ...]
    seconds: float
    error: str = ""


def kept(run: Run) -> Result | None:
    """The result of a finished run; None if it is not finished. Raises InputError for a damaged file."""
    file = run.folder / RESULT
    try:
        found = Result(**json.loads(file.read_text("utf-8")))
    except FileNotFoundError:
        return None
    except (ValueError, TypeError) as error:
        raise InputError("is no result of a sweep; remove it to repeat the run", file=file) from error
    # Two configurations may come to the same run.
    return replace(
        found,
        configuration=run.configuration,
        scene=run.scene,
        seed=run.seed,
        episodes=tuple(found.episodes),
    )


def failed(run: Run, reason: str = "") -> Result:
    """The result of a run that did not finish: what it left behind, else `reason`, says why."""
    with suppress(OSError, ValueError, KeyError):
        reason = json.loads((run.folder / FAILURE).read_text("utf-8"))["error"]
    return Result(run.configuration, run.scene, run.seed, run.folder.name, "", {}, (), 0.0, reason or "ended")


def carry_out(run: Run) -> None:
    """Carry out a run unless it is finished. An error that a user can cause is left in its folder."""
    with _alone(run.folder):
        if kept(run) is not None:
            return
        shutil.rmtree(run.folder, ignore_errors=True)  # what an attempt that was cut off left behind
        run.folder.mkdir(parents=True)
        try:
            with chdir(run.cwd):
                result = _mission(run)
        except DssmsgError as error:
            _write(run.folder / FAILURE, {"error": str(error)})
            return
        _write(run.folder / RESULT, asdict(result))


def _mission(run: Run) -> Result:
    from dssmsg.mission.run import run_mission

    config, host = run.load()
    witness = _Witness()
    with config.naming_files():
        done = run_mission(config, host, observers=[("sweep", witness)])
    summary = done.summary
    recording = summary.get("recording")
    episodes = tuple(
        {name: str(e[name]) for name in ("goal", "outcome", "reason")} for e in summary["episodes"]
    )
    metrics = _counts(summary)
    if witness.places is not None:
        score = score_static(done.graph.objects.values(), witness.places.places())
        for name in ("precision", "recall", "f1"):
            metrics[f"static_{name}"] = float(getattr(score, name))
    return Result(
        run.configuration,
        run.scene,
        run.seed,
        run.folder.name,
        Path(recording).name if recording else "",
        metrics,
        episodes,
        round(float(summary["seconds"]["total"]), 3),
        "" if done.exit_code == 0 else "an observer failed",
    )


def _counts(summary: Mapping[str, Any]) -> dict[str, float]:
    """Figures of the summary that do not depend on the clock."""
    episodes = summary["episodes"]
    metrics = {
        "frames": summary["frames"],
        "objects": summary["objects"],
        "changes": sum(summary["changes"].values()),
        "errors": summary["errors"],
        "collisions": summary["collisions"],
        "distance_m": summary["distance_m"],
    }
    if episodes:
        metrics["success"] = sum(e["outcome"] == "success" for e in episodes) / len(episodes)
    return {name: float(value) for name, value in metrics.items()}


class _Witness:
    """An observer that collects what of the truth was visible; `places` is None where there is no truth."""

    def __init__(self) -> None:
        self.places: VisibleTruth | None = None
        self._frame: Frame | None = None

    def on_event(self, event: Event) -> None:
        if isinstance(event, FrameCaptured):
            self._frame = event.frame
        elif isinstance(event, TruthSeen) and self._frame is not None:
            self.places = self.places or VisibleTruth()
            self.places.add(self._frame, event.truth)

    def close(self) -> None:
        """Nothing to release."""

    def outputs(self) -> dict[str, str]:
        """Leaves no file."""
        return {}


def _write(file: Path, value: Mapping[str, Any]) -> None:
    draft = file.with_suffix(".tmp")
    draft.write_text(json.dumps(value, indent=1, ensure_ascii=False) + "\n", "utf-8")
    draft.replace(file)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait until no other process carries out the run of this folder."""
    import fcntl

    folder.parent.mkdir(parents=True, exist_ok=True)
    with (folder.parent / f".{folder.name}.lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
