"""The paper's tables as rows: table, scene, method, perception, metric, mean, std, n, recordings.

Means and sample deviations are over seeds, whose figures are worked out one by one; `recordings` names the
recording behind each of them. The paper's own figures are in `PAPER`, to be printed beside.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any

import numpy as np

from dssmsg.errors import StorageError
from dssmsg.evaluate.dynamic import Tally
from dssmsg.evaluate.fig5 import mean_curve
from dssmsg.evaluate.replay_score import ReplayScore, Verdicts

TABLES = ("table1", "table2", "table3", "fig5", "occlusion", "identity")
ALL = "all"
"""The scene of rows in which the objects of all scenes are taken together, as the paper's Table II does."""
COLUMNS = ("table", "scene", "method", "perception", "metric", "mean", "std", "n")
Row = dict[str, Any]

PAPER: Mapping[tuple[str, str, str, str], float] = {
    ("table1", "ihlen_1_int", "dssm", "static_f1"): 0.915,
    ("table1", "ihlen_1_int", "dssm", "dynamic_f1"): 0.824,
    ("table1", "ihlen_1_int", "conceptgraphs", "static_f1"): 0.902,
    ("table1", "ihlen_1_int", "conceptgraphs", "dynamic_f1"): 0.400,
    ("table1", "ihlen_1_int", "dovsg", "static_f1"): 0.908,
    ("table1", "ihlen_1_int", "dovsg", "dynamic_f1"): 0.750,
    ("table1", "rs_int", "dssm", "static_f1"): 0.794,
    ("table1", "rs_int", "dssm", "dynamic_f1"): 0.833,
    ("table1", "rs_int", "conceptgraphs", "static_f1"): 0.708,
    ("table1", "rs_int", "conceptgraphs", "dynamic_f1"): 0.500,
    ("table1", "rs_int", "dovsg", "static_f1"): 0.742,
    ("table1", "rs_int", "dovsg", "dynamic_f1"): 0.600,
    ("table2", ALL, "dssm", "appear_f1"): 0.666,
    ("table2", ALL, "dssm", "disappear_f1"): 0.600,
    ("table2", ALL, "dssm", "relocation_f1"): 0.889,
    ("table2", ALL, "dssm", "total_f1"): 0.709,
    ("table3", "rs_int", "dssm", "update_success"): 0.900,
    ("table3", "rs_int", "dssm", "static_retention"): 0.933,
    ("table3", "rs_int", "dssm", "accuracy_gain"): 0.089,
    ("table3", "ihlen_1_int", "dssm", "update_success"): 1.000,
    ("table3", "ihlen_1_int", "dssm", "static_retention"): 1.000,
    ("table3", "ihlen_1_int", "dssm", "accuracy_gain"): 0.050,
}
"""What the paper reports, by (table, scene, method, metric), as shares of 1."""


def table_rows(table: str, scores: Sequence[ReplayScore]) -> list[Row]:
    """The rows of one of `TABLES`."""
    rows: list[Row] = []
    for (scene, method, perception), group in _groups(scores).items():
        head = {"table": table, "scene": scene, "method": method, "perception": perception}
        names = sorted({score.recording for score in group})
        for metric, mean, std, n in _METRICS[table](group):
            row: Row = {**head, "metric": metric, "mean": mean, "std": std, "n": n}
            if (paper := PAPER.get((table, scene, method, metric))) is not None:
                row["paper"] = paper
            rows.append({**row, "recordings": names})
    return rows


def write_rows(rows: Sequence[Row], folder: Path, name: str) -> list[Path]:
    """`name`.json and `name`.csv in a folder; StorageError where they cannot be written."""
    as_json, as_csv = folder / f"{name}.json", folder / f"{name}.csv"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        as_json.write_text(json.dumps(list(rows), indent=1) + "\n", "utf-8")
        with as_csv.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([*COLUMNS, "paper", "recordings"])
            for row in rows:
                cells = [row[column] for column in COLUMNS]
                writer.writerow([*cells, row.get("paper", ""), " ".join(row["recordings"])])
    except OSError as error:
        raise StorageError(f"cannot be written ({error.strerror})", file=as_json) from error
    return [as_json, as_csv]


def _groups(scores: Sequence[ReplayScore]) -> dict[tuple[str, str, str], list[ReplayScore]]:
    """Scores by (scene, method, perception), and by (all, ...) where there are several scenes."""
    groups: dict[tuple[str, str, str], list[ReplayScore]] = {}
    for score in scores:
        groups.setdefault((score.scene, score.method, score.perception), []).append(score)
    if len({score.scene for score in scores}) > 1:
        for score in scores:
            groups.setdefault((ALL, score.method, score.perception), []).append(score)
    return groups


Figure = tuple[str, float, float, int]


def _table1(group: Sequence[ReplayScore]) -> Iterable[Figure]:
    for part, tallies in (
        ("static", [score.static for score in group]),
        ("dynamic", [score.dynamic for score in group]),
        ("dynamic_split", [score.dynamic_split for score in group]),
    ):
        yield from _prf(part, group, tallies)


def _table2(group: Sequence[ReplayScore]) -> Iterable[Figure]:
    for part, tallies in (
        ("appear", [score.appear for score in group]),
        ("disappear", [score.disappear for score in group]),
        ("relocation", [score.relocation for score in group]),
        ("total", [score.dynamic for score in group]),
    ):
        yield from _prf(part, group, tallies)


def _prf(part: str, group: Sequence[ReplayScore], tallies: Sequence[Tally]) -> Iterable[Figure]:
    """Precision, recall and F1, seed by seed: a seed's scenes are counted together."""
    by_seed: dict[int, list[Tally]] = {}
    for score, tally in zip(group, tallies, strict=True):
        by_seed.setdefault(score.seed, []).append(tally)
    pooled = [reduce(add, members) for members in by_seed.values()]
    for name in ("precision", "recall", "f1"):
        yield _figure(f"{part}_{name}", [getattr(tally, name) for tally in pooled])


def _table3(group: Sequence[ReplayScore]) -> Iterable[Figure]:
    changed = [score.update for score in group if score.update.changes]
    kept = [score.update for score in group if score.update.static]
    yield _figure("update_success", [update.updated / update.changes for update in changed])
    yield _figure("static_retention", [update.retained / update.static for update in kept])
    yield _figure("accuracy_gain", [score.recovery.gain for score in group])


def _fig5(group: Sequence[ReplayScore]) -> Iterable[Figure]:
    measurable = [score for score in group if score.recovery.measurable]
    yield _figure("relative_accuracy_first_revisit", [score.first_revisit for score in measurable])
    yield _figure("delta_acc", [score.recovery.delta for score in group])
    yield ("excluded", float(len(group) - len(measurable)), 0.0, len(group))
    curves = [score.recovery.relative for score in measurable]
    for index, (mean, std, updating) in enumerate(mean_curve(curves), 1):
        yield (f"relative_accuracy@{index}", mean, std, updating)


def _occlusion(group: Sequence[ReplayScore]) -> Iterable[Figure]:
    for name in ("hidden", "still_there"):
        verdicts: list[Verdicts] = [getattr(score, name) for score in group]
        cases = sum(verdict.cases for verdict in verdicts)
        failed = sum(len(verdict.failed) for verdict in verdicts)
        yield (f"{name}_objects", float(cases), 0.0, len(group))
        yield (f"{name}_called_disappeared", float(failed), 0.0, len(group))
        yield (f"{name}_false_disappearance_rate", failed / cases if cases else 0.0, 0.0, cases)


def _identity(group: Sequence[ReplayScore]) -> Iterable[Figure]:
    for name in ("swap", "put_back"):
        verdicts: list[Verdicts] = [getattr(score, name) for score in group]
        outcomes = [1.0] * sum(v.right for v in verdicts) + [0.0] * sum(len(v.failed) for v in verdicts)
        yield _figure(f"{name}_right", outcomes)


def _figure(metric: str, values: Sequence[float]) -> Figure:
    """Mean, sample deviation (0 for one value) and count; NaN never: no value counts as 0 of 0."""
    array = np.array(values, dtype=np.float64)
    if not len(array):
        return metric, 0.0, 0.0, 0
    return metric, float(array.mean()), float(array.std(ddof=1)) if len(array) > 1 else 0.0, len(array)


_METRICS: Mapping[str, Callable[[Sequence[ReplayScore]], Iterable[Figure]]] = {
    "table1": _table1,
    "table2": _table2,
    "table3": _table3,
    "fig5": _fig5,
    "occlusion": _occlusion,
    "identity": _identity,
}
