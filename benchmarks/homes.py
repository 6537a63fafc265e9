"""The stages of `verify.py` about homes that change: the paper's tables, hidden things, the cost of memory.

They take long (20 homes a perception): each keeps its recordings and scores in the temporary folder until it
is done, by the hash of the code, so that a stage that was cut goes on where it stopped.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

from staging import Row, code_hash, dssmsg, measured_by

METHODS = "dssm,dssm_paper_exact,conceptgraphs,dovsg"
SEEDS = "10"
SCENES = ("rs_int", "ihlen_1_int")
JOBS = str(min(2, os.cpu_count() or 1))
TABLE_3 = {"update_success": 1.0, "static_retention": 0.99, "accuracy_gain": None}
Figures = dict[tuple[str, str, str], dict]


def figures_of(cwd: Path, table: str, perception: str, work: Path, *more: str, jobs: bool = True) -> Figures:
    """Rows of `dssmsg eval TABLE` by (scene, method, metric); `jobs`: whether it can do several at a time."""
    several = ("--jobs", JOBS) if jobs else ()
    arguments = ("--perception", perception, *several, "--work", str(work), *more, "--json")
    rows = json.loads(dssmsg("eval", table, *arguments, cwd=cwd).stdout)
    return {(row["scene"], row["method"], row["metric"]): row for row in rows}


def tables(perception: str) -> Callable[[Path], list[Row]]:
    """The stage of one perception: Tables I to III and Fig. 5 over ten seeds of both scenes."""

    def stage(cwd: Path) -> list[Row]:
        work = Path(tempfile.gettempdir()) / f"dssmsg-homes-{perception}-{code_hash()}"
        same = ("--methods", METHODS, "--seeds", SEEDS)
        one, two, three, five = (
            figures_of(cwd, table, perception, work, *same)
            for table in ("table1", "table2", "table3", "fig5")
        )
        oracle = perception == "oracle"
        rows = [*_dynamic(one, perception)]
        for metric in ("appear_f1", "disappear_f1", "relocation_f1", "total_f1"):
            least = 0.95 if oracle and metric != "total_f1" else None
            rows.append(_row(f"Table II, {perception}", two["all", "dssm", metric], least))
        for scene in SCENES:
            for metric, least in TABLE_3.items():
                row = three[scene, "dssm", metric]
                rows.append(_row(f"Table III, {perception}, {scene}", row, least if oracle else None))
        last = five["all", "dssm", "relative_accuracy_first_revisit"]
        rows.append(_row(f"Fig. 5, {perception}", last, 0.95 if oracle else None))
        shutil.rmtree(work)
        return rows

    stage.__doc__ = f"Tables I to III and Fig. 5 with {perception}, ten seeds of both scenes."
    return stage


def _dynamic(table: Figures, perception: str) -> Iterable[Row]:
    for scene in SCENES:
        for metric in ("dynamic_f1", "dynamic_split_f1"):
            means = {name: table[scene, name, metric]["mean"] for name in METHODS.split(",")}
            best = max(means["conceptgraphs"], means["dovsg"])
            others = ", ".join(f"{name} {mean:.3f}" for name, mean in means.items() if name != "dssm")
            ahead = means["dssm"] > best
            name = f"Table I, {perception}, {scene}: {metric}"
            yield Row(name, "above the baselines", f"{means['dssm']:.3f} ({others})", ahead)
        least = 0.95 if perception == "oracle" else 0.70
        yield _row(f"Table I, {perception}, {scene}", table[scene, "dssm", "dynamic_f1"], least)
        yield _row(f"Table I, {perception}, {scene}", table[scene, "dssm", "static_f1"], None)


def _row(what: str, row: dict, least: float | None) -> Row:
    asked = "reported" if least is None else f">= {least:g}"
    measured = f"{row['mean']:.3f} +- {row['std']:.3f}, n {row['n']}"
    return Row(f"{what}: {row['metric']}", asked, measured, None if least is None else row["mean"] >= least)


def hidden(cwd: Path) -> list[Row]:
    """A hundred cases of things that cannot be seen: how many are called disappeared."""
    rows = []
    for perception in ("oracle", "furniture"):
        work = Path(tempfile.gettempdir()) / f"dssmsg-hidden-{perception}-{code_hash()}"
        figures = figures_of(cwd, "occlusion", perception, work, "--methods", "dssm", "--cases", "100")
        false = sum(r["mean"] for (_, _, m), r in figures.items() if m == "hidden_called_disappeared")
        asked = sum(r["mean"] for (_, _, m), r in figures.items() if m == "hidden_objects")
        must = perception == "oracle"
        rows.append(
            Row(
                f"hidden things called disappeared, {perception}, 100 cases",
                "0" if must else "reported",
                f"{false:.0f} of {asked:.0f}",
                false == 0 if must else None,
            )
        )
        shutil.rmtree(work)
    return rows


def identity(cwd: Path) -> list[Row]:
    """Two things of one kind swapped, and things put back: how many are handled right (an aim)."""
    rows = []
    for perception in ("oracle", "furniture"):
        work = Path(tempfile.gettempdir()) / f"dssmsg-identity-{perception}-{code_hash()}"
        figures = figures_of(cwd, "identity", perception, work, "--methods", "dssm", "--seeds", SEEDS)
        rows += [
            Row(
                f"{metric.replace('_', ' ')}, {perception}",
                "(aim 0.90)",
                f"{figures['all', 'dssm', metric]['mean']:.2f} of {figures['all', 'dssm', metric]['n']}",
                None,
            )
            for metric in ("swap_right", "put_back_right")
        ]
        shutil.rmtree(work)
    return rows


def noise(cwd: Path) -> list[Row]:
    """What realistic sensor noise costs: dynamic F1 with furniture, without noise and with it (an aim)."""
    means: dict[str, dict[str, float]] = {}
    for kind in ("none", "realistic"):
        work = Path(tempfile.gettempdir()) / f"dssmsg-noise-{kind}-{code_hash()}"
        same = ("--methods", "dssm", "--seeds", SEEDS, "--set", f"source.noise={kind}")
        figures = figures_of(cwd, "table1", "furniture", work, *same)
        means[kind] = {scene: figures[scene, "dssm", "dynamic_f1"]["mean"] for scene in SCENES}
        shutil.rmtree(work)
    return [
        Row(
            f"dynamic F1 with realistic noise, {scene}",
            "(aim: at most 0.03 less)",
            f"{means['realistic'][scene]:.3f}, without {means['none'][scene]:.3f}",
            None,
        )
        for scene in SCENES
    ]


def memory(cwd: Path) -> list[Row]:
    """Windows and update a key frame: 5,000 frames against 100."""
    figures = measured_by("memory.py", cwd)
    ratio = figures["growth"]
    seen = f"{figures['viewpoints_late']:.0f} viewpoints"
    return [
        Row(
            "windows and update, 5,000 frames against 100", "<= 1.3 x", f"{ratio:.2f} x, {seen}", ratio <= 1.3
        ),
        Row("... time a key frame", "reported", f"{figures['late_ms']:.1f} ms", None),
    ]


STAGES: dict[str, Callable[[Path], list[Row]]] = {
    "memory": memory,
    "homes_oracle": tables("oracle"),
    "homes_furniture": tables("furniture"),
    "hidden": hidden,
    "identity": identity,
    "noise": noise,
}
