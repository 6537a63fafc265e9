"""A sweep: many configurations x scenes x seeds, resumable, one table at the end."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dssmsg.errors import StorageError
from dssmsg.evaluate.sweep_engines import Engine
from dssmsg.evaluate.sweep_matrix import Run
from dssmsg.evaluate.sweep_run import Result, failed, kept

TABLE, FAILED = "sweep", "failed"
Progress = Callable[[int, int, str], None]
"""Told how many runs are done, of how many, and a line on the latest."""


def sweep(
    runs: Sequence[Run], engine: Engine, *, jobs: int, progress: Progress = lambda _d, _n, _line: None
) -> list[Result]:
    """The result of every run, in order; those that are not finished yet are carried out now.

    A run that fails or whose process ends has a result that says so; it is begun again by the next sweep.
    """
    found: dict[Path, Result] = {}
    for run in runs:
        result = kept(run)
        if result is not None:
            found[run.folder] = result
    if found:
        progress(len(found), len(runs), f"{len(found)} of {len(runs)} runs were done before")
    missing = [run for run in {run.folder: run for run in runs}.values() if run.folder not in found]
    _make_folders(missing)
    if missing:
        for run, reason in engine(missing, jobs):
            result = found[run.folder] = kept(run) or failed(run, reason)
            progress(len(found), len(runs), f"{len(found)} of {len(runs)}: {_line(run, result)}")
    return [found[run.folder] for run in runs]


def _make_folders(runs: Sequence[Run]) -> None:
    for folder in {run.folder.parent for run in runs}:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"cannot be made ({error.strerror})", file=folder) from error


def _line(run: Run, result: Result) -> str:
    if result.error:
        return f"{run.name}: failed: {result.error}"
    shown = [f"{name} {_figure(value)}" for name, value in result.metrics.items() if name in _HEADLINE]
    return f"{run.name}: {', '.join(shown)}, {result.seconds:.0f} s"


_HEADLINE = ("frames", "objects", "errors", "success", "static_f1")


def sweep_rows(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Mean and standard deviation over the seeds, a row a configuration, scene and metric; `n` runs each.

    The deviation is that of the sample (n - 1), 0 for one run. `failed`: the share of those that did not end.
    """
    groups: dict[tuple[str, str], list[Result]] = {}
    for result in sorted(results, key=lambda one: one.scene):
        groups.setdefault((result.configuration, result.scene), []).append(result)
    order = list(dict.fromkeys(result.configuration for result in results))
    rows = []
    for (configuration, scene), members in sorted(groups.items(), key=lambda item: order.index(item[0][0])):
        ended = [one for one in members if not one.error]
        values: dict[str, list[float]] = {FAILED: [float(bool(one.error)) for one in members]}
        for one in ended:
            for metric, value in one.metrics.items():
                values.setdefault(metric, []).append(value)
        for metric, of in values.items():
            rows.append({
                "table": TABLE, "scene": scene, "configuration": configuration, "metric": metric,
                "mean": float(np.mean(of)), "std": float(np.std(of, ddof=1)) if len(of) > 1 else 0.0,
                "n": len(of),
            })  # fmt: skip
    return rows


def rows_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows of equal keys as CSV, with a line of names."""
    out = io.StringIO()
    if rows:
        writer = csv.DictWriter(
            out, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n"
        )
        writer.writeheader()
        writer.writerows(rows)
    return out.getvalue()


def run_rows(results: Sequence[Result], work: Path) -> list[dict[str, Any]]:
    """A row a run: configuration, scene, seed, its metrics, and the path of its recording below `work`."""
    names = list(dict.fromkeys(name for result in results for name in result.metrics))
    return [
        {
            "configuration": result.configuration,
            "scene": result.scene,
            "seed": result.seed,
            **{name: result.metrics.get(name) for name in names},
            "recording": f"runs/{result.folder}/{result.recording}" if result.recording else "",
            "error": result.error,
        }
        for result in results
    ]


def sweep_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a table for a reader: a line a configuration and scene, a column a metric, mean +- std."""
    metrics = list(dict.fromkeys(row["metric"] for row in rows))
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows:
        spread = f" ±{_figure(row['std'])}" if row["n"] > 1 else ""
        line = cells.setdefault((row["configuration"], row["scene"]), {})
        line[row["metric"]] = f"{_figure(row['mean'])}{spread}"
        if row["metric"] == FAILED:
            line["runs"] = str(row["n"])
    shown = ["runs", *metrics]
    table = [
        ["configuration", "scene", *(name.replace("_", " ") for name in shown)],
        *([*key, *(line.get(name, "-") for name in shown)] for key, line in cells.items()),
    ]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in table
    )


def _figure(value: float) -> str:
    return f"{value:.0f}" if float(value).is_integer() else f"{value:.3f}"
