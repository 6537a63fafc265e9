"""The report of many runs: how often the goal was reached, every episode, and the worst runs in full."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dssmsg.errors import DssmsgError
from dssmsg.recording.reader import Recording
from dssmsg.review import report_markup as html
from dssmsg.review.catalog import RunEntry
from dssmsg.review.episodes import Row, chosen_rows, episode_rows
from dssmsg.review.report import chip, run_sections
from dssmsg.review.report_markup import Markup, tag
from dssmsg.review.summary import summarize

MAX_RUNS, MAX_EPISODES = 12, 500
"""Runs told in full (each with its pictures, about 1 MB), and episodes listed."""

Explain = Callable[[Recording], Mapping[int, str]]
"""What there is to say on the episodes of a recording, by number."""
Progress = Callable[[int, int, str], None]


def folder_page(
    folder: Path,
    runs: Mapping[Path, RunEntry],
    explain: Explain = lambda _recording: {},
    progress: Progress = lambda _done, _of, _line: None,
) -> str:
    """The page of a folder's recordings; a file that does not read is named in it, with the reason."""
    rows = chosen_rows(episode_rows(runs, folder))
    readable = [path for path, entry in runs.items() if not entry.problem]
    worst = dict.fromkeys(folder / row["recording"] for row in rows)
    told = list(dict.fromkeys([*worst, *readable]))[:MAX_RUNS]
    parts = []
    for number, path in enumerate(told, 1):
        parts.append(_run(path, folder, explain, opened=len(told) == 1))
        progress(number, len(told), "")
    left = len(readable) - len(told)
    note = tag("p", f"the {len(told)} worst of {len(readable)} runs", class_="note") if left > 0 else ""
    title = f"{len(readable)} runs in {folder.name or folder}"
    return html.page(
        title,
        tag("h1", title),
        tag("p", folder, class_="lead"),
        html.section("How often it worked", _groups(rows)),
        html.section("Episodes, worst first", _episodes(rows)),
        html.section("Not read", _problems(runs, folder)),
        html.section("Runs", note, *parts),
    )


def _groups(rows: Sequence[Row]) -> Markup:
    """Share of success by configuration, scene and perception."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["name"], row["scene"], row["perception"]), []).append(row)
    lines = []
    for key, members in sorted(groups.items(), key=lambda item: tuple(map(str, item[0]))):
        reached = sum(row["success"] for row in members)
        share = reached / len(members)
        why: dict[str, int] = {}
        for row in members:
            if not row["success"]:
                why[row["outcome"]] = why.get(row["outcome"], 0) + 1
        reasons = ", ".join(
            f"{reason} {count}" for reason, count in sorted(why.items(), key=lambda one: -one[1])
        )
        lines.append((*key, len(members), f"{share:.0%}", _bar(share), reasons))
    if not lines:
        return tag("p", "no episode in these recordings", class_="note")
    head = ("configuration", "scene", "perception", "episodes", "success", "", "failures")
    return html.table(head, lines, numbers=("episodes", "success"))


def _bar(share: float) -> Markup:
    """A share as a bar."""
    parts = [
        tag("rect", x=0, y=0, width=120, height=12, rx=3, fill="#f3d4d2"),
        tag("rect", x=0, y=0, width=f"{120 * share:.1f}", height=12, rx=3, fill="#1f9254"),
    ]
    return tag("svg", *parts, viewBox="0 0 120 12", style="width:120px")


def _episodes(rows: Sequence[Row]) -> Markup:
    lines = [
        (
            chip("success" if row["success"] else "failure", row["outcome"]),
            html.text(row["goal"], 200),
            row["scene"],
            row["seed"],
            _one(row.get("seconds")),
            _one(row.get("metres")),
            row["recording"],
        )
        for row in rows[:MAX_EPISODES]
    ]
    if not lines:
        return Markup("")
    head = ("outcome", "goal", "scene", "seed", "seconds", "metres", "recording")
    more = len(rows) - MAX_EPISODES
    note = tag("p", f"... and {more} more", class_="note") if more > 0 else ""
    return html.joined((html.table(head, lines, numbers=("seed", "seconds", "metres")), note))


def _one(value: Any) -> str:
    return f"{value:.1f}" if isinstance(value, int | float) else ""


def _problems(runs: Mapping[Path, RunEntry], folder: Path) -> Markup:
    rows = [(str(path.relative_to(folder)), entry.problem) for path, entry in runs.items() if entry.problem]
    return html.table(("file", "why"), rows) if rows else Markup("")


def _run(path: Path, folder: Path, explain: Explain, *, opened: bool) -> Markup:
    """One run, folded away under its name and outcome."""
    try:
        with Recording.open(path) as recording:
            summary = summarize(recording)
            sections = run_sections(recording, summary, explain(recording))
    except DssmsgError as error:
        return tag("p", f"{path.relative_to(folder)}: {error.message}", class_="note")
    outcomes = " ".join(chip(one["outcome"], one.get("reason", "")) for one in summary["episodes"])
    name = f"{path.relative_to(folder)}: {summary['name']}, {summary['scene']}, seed {summary['seed']} "
    return html.folded(html.joined((name, Markup(outcomes))), *sections, open_=opened)
