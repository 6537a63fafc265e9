"""The stages of `verify.py` about perception: the recogniser, needs in words, the map, photographs, time.

The kitchen (posed photographs with depth, as `docs/sequences.md` says) is looked at where DSSMSG_KITCHEN
names its folder; it needs the model `coco` in the cache. Otherwise its stage says that it was left out.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from staging import ENVIRONMENT, Row, code_hash, dssmsg, run

HERE = Path(__file__).resolve().parent
KITCHEN = "DSSMSG_KITCHEN"
KNOWN, UNSEEN = "known models", "unseen models"
ASKED = {
    (KNOWN, "mask_recall@0.5"): 0.80,
    (KNOWN, "label_top1"): 0.80,
    (KNOWN, "object_top1"): 0.90,
    (UNSEEN, "object_top1"): 0.30,
    (UNSEEN, "object_top3"): 0.55,
}
MAX_FRAME_MS = 150
MIN_F1 = 0.75
MAX_RUN_S = 120


def rows_of(cwd: Path, *arguments: str) -> list[dict]:
    """The rows that `dssmsg eval ARGUMENTS` prints."""
    return json.loads(dssmsg("eval", *arguments, "--json", cwd=cwd).stdout)


def recogniser(cwd: Path) -> list[Row]:
    """The recogniser in rooms of its own: masks, labels, objects, time a frame."""
    rows = []
    for assets in ("real", "embedded"):
        figures = rows_of(cwd, "perception", "--assets", assets)
        for figure in figures:
            scene, metric, mean, n = (figure[key] for key in ("scene", "metric", "mean", "n"))
            name = f"{assets} furniture, {scene}: {metric}"
            asked = ASKED.get((scene, metric)) if assets == "real" else None
            if metric == "views":
                enough = mean >= 300 and n >= 20
                rows.append(Row(name, ">= 300 in 20", f"{mean:.0f} in {n} rooms", enough))
            elif metric == "frame_cpu_ms":
                rows.append(Row(name, f"<= {MAX_FRAME_MS} ms", f"{mean:.0f} ms", mean <= MAX_FRAME_MS))
            else:
                wanted = "reported" if asked is None else f">= {asked:.2f}"
                rows.append(Row(name, wanted, f"{mean:.3f} of {n}", None if asked is None else mean >= asked))
    return rows


def needs(cwd: Path) -> list[Row]:
    """Sentences that name a need: the right label first."""
    rows = []
    for figure in rows_of(cwd, "text"):
        if figure["metric"] != "R@1":
            continue
        right = round(figure["mean"] * figure["n"])
        must = figure["scene"] == "requests" and figure["method"].endswith("purposes")
        rows.append(
            Row(
                f"{figure['scene']}, {figure['method']}: right label first",
                ">= 27 of 30" if must else "reported",
                f"{right} of {figure['n']}",
                right >= 27 if must else None,
            )
        )
    return rows


def static_maps(cwd: Path) -> list[Row]:
    """Static objects of the map with furniture and with oracle: five seeds of both scenes."""
    rows = []
    work = Path(tempfile.gettempdir()) / f"dssmsg-maps-{code_hash()}"  # outlasts a stage that is cut
    for assets in ("auto", "embedded"):
        sets = ("--set", f"source.assets={assets}")
        figures = rows_of(cwd, "static", "--seeds", "5", *sets, "--work", str(work))
        for figure in figures:
            must = figure["metric"] == "static_f1" and figure["perception"] == "furniture"
            must = must and assets == "auto"
            rows.append(
                Row(
                    f"{figure['scene']}, assets {assets}, {figure['perception']}: {figure['metric']}",
                    f">= {MIN_F1}" if must else "reported",
                    f"{figure['mean']:.3f} +- {figure['std']:.3f}, {figure['n']} seeds",
                    figure["mean"] >= MIN_F1 if must else None,
                )
            )
    shutil.rmtree(work)
    return rows


def kitchen(cwd: Path) -> list[Row]:
    """Believed objects on photographs of a kitchen with the detector `coco`."""
    folder = os.environ.get(KITCHEN)
    if not folder:
        return [
            Row("kitchen with coco", "table, 3 chairs, cup", f"left out: {KITCHEN} names no folder", None)
        ]
    done = subprocess.run(
        [sys.executable, str(HERE / "kitchen.py"), folder, "--json"],
        cwd=cwd,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    figures = json.loads(done.stdout)
    rows = [Row(f"kitchen with coco: {name}", "met", str(met), met) for name, met in figures["met"].items()]
    counts = ", ".join(f"{count} {label}" for label, count in sorted(figures["believed"].items()))
    return [
        *rows,
        Row("... believed objects", "reported", counts, None),
        Row("... perception a key frame", "reported", f"{1000 * figures['frame_seconds']:.0f} ms", None),
    ]


def default_run(cwd: Path) -> list[Row]:
    """The default run, perception included: wall time, errors, size, memory."""
    runs = [run(cwd) for _ in range(3)]
    wall = statistics.median(one["wall"] for one in runs)
    peak = max(one["peak_mb"] for one in runs)
    frame = 1000 * statistics.median(one["seconds"]["perception"] / one["key_frames"] for one in runs)
    size = (cwd / runs[0]["recording"]).stat().st_size / 1e6
    return [
        Row("default run, wall time, median of 3", f"<= {MAX_RUN_S} s", f"{wall:.1f} s", wall <= MAX_RUN_S),
        Row("... errors", "0", str(runs[0]["errors"]), runs[0]["errors"] == 0),
        Row("... perception a key frame, wall", f"<= {MAX_FRAME_MS} ms", f"{frame:.0f} ms", None),
        Row("... size of the recording", "<= 100 MB", f"{size:.1f} MB", size <= 100),
        Row("... peak memory", "<= 1500 MB", f"{peak:.0f} MB", peak <= 1500),
    ]


STAGES: dict[str, Callable[[Path], list[Row]]] = {
    "recogniser": recogniser,
    "needs": needs,
    "static_maps": static_maps,
    "kitchen": kitchen,
    "default_run": default_run,
}
