"""The tables as pictures: bars a metric and method, and the curve of Fig. 5; needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dssmsg.errors import ConfigError, StorageError
from dssmsg.evaluate.tables import Row

SHOWN = {
    "table1": ("static_f1", "dynamic_f1", "dynamic_split_f1"),
    "table2": ("appear_f1", "disappear_f1", "relocation_f1", "total_f1"),
    "table3": ("update_success", "static_retention", "accuracy_gain"),
    "occlusion": ("hidden_false_disappearance_rate", "still_there_false_disappearance_rate"),
    "identity": ("swap_right", "put_back_right"),
}
_CURVE = "relative_accuracy@"


def draw_figure(table: str, rows: Sequence[Row], file: Path) -> None:
    """A PNG of a table's rows, one panel a scene, the paper's figures as dashes.

    Raises ConfigError where matplotlib is not installed, StorageError where the file cannot be written.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ConfigError(
            "figures need matplotlib: pip install 'dssmsg[figures]', or leave the figure out (--no-figure)",
            key="--figure",
        ) from error
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    figure = Figure(figsize=(4.6 * max(1, len(scenes)) + 1.8, 3.6), layout="constrained")
    drawn: dict[str, Any] = {}
    for index, scene in enumerate(scenes):
        axes = figure.add_subplot(1, len(scenes), index + 1)
        own = [row for row in rows if row["scene"] == scene]
        if table == "fig5":
            drawn |= _curves(axes, own, methods)
        else:
            drawn |= _bars(axes, own, SHOWN[table], methods)
        axes.set_title(scene)
        axes.set_axisbelow(True)
        axes.grid(axis="y", alpha=0.3)
    if drawn:
        figure.legend(list(drawn.values()), list(drawn), loc="outside right upper", fontsize=7)
    perceptions = ", ".join(dict.fromkeys(row["perception"] for row in rows))
    figure.suptitle(f"{table}, perception {perceptions}")
    try:
        figure.savefig(file, dpi=150)
    except OSError as error:
        raise StorageError(f"cannot be written ({error.strerror})", file=file) from error


def _bars(axes: Any, rows: Sequence[Row], metrics: Sequence[str], methods: Sequence[str]) -> dict[str, Any]:
    """Bars, a colour a method; what stands for each method in the legend."""
    drawn = {}
    width = 0.8 / max(1, len(methods))
    for number, method in enumerate(methods):
        for place, metric in enumerate(metrics):
            row = next((r for r in rows if r["method"] == method and r["metric"] == metric), None)
            if row is None:
                continue
            x = place + (number - (len(methods) - 1) / 2) * width
            bars = axes.bar(x, row["mean"], width, yerr=row["std"], capsize=2, color=f"C{number}")
            drawn[method] = bars
            if row.get("paper") is not None:
                axes.hlines(row["paper"], x - width / 2, x + width / 2, colors="black", linestyles="dashed")
    axes.set_xticks(range(len(metrics)), [metric.replace("_", "\n") for metric in metrics], fontsize=7)
    return drawn


def _curves(axes: Any, rows: Sequence[Row], methods: Sequence[str]) -> dict[str, Any]:
    """Means with a band of one deviation, a colour a method; what stands for each in the legend."""
    drawn = {}
    for number, method in enumerate(methods):
        points = [
            (int(row["metric"].removeprefix(_CURVE)), row["mean"], row["std"])
            for row in rows
            if row["method"] == method and row["metric"].startswith(_CURVE)
        ]
        if not points:
            continue
        updates, means, spreads = zip(*points, strict=True)
        (drawn[method],) = axes.plot(updates, means, color=f"C{number}")
        low = [mean - spread for mean, spread in zip(means, spreads, strict=True)]
        high = [mean + spread for mean, spread in zip(means, spreads, strict=True)]
        axes.fill_between(updates, low, high, color=f"C{number}", alpha=0.15)
    axes.set_xlabel("valid update")
    axes.set_ylabel("relative accuracy")
    return drawn
