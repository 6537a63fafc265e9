"""Episodes of many recordings as rows that can be filtered and put in order."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from dssmsg.review.catalog import RunEntry
from dssmsg.review.episodes_where import condition, value_of

Row = dict[str, Any]

FIELDS: dict[str, str] = {
    "recording": "path of the file",
    "run_id": "id of the run",
    "name": "name of its configuration",
    "scene": "scene of the source",
    "source": "plug-in that gave the frames",
    "seed": "seed of the run",
    "episode": "number in the run, from 0",
    "goal": "what was asked for",
    "outcome": "success, or the named reason of the failure",
    "success": "true or false",
    "frame": "last frame of the episode",
    "sim_time": "seconds of the robot's clock at its end",
    "complete": "false for a run that was cut off",
    "metres": "driven in the episode",
    "seconds": "of the robot's clock that it took",
    "frames": "that it took",
    "replans": "how often the way was planned again",
    "detours": "round obstacles",
    "viewpoints": "that were looked from",
    "perception": "plug-in by name, as the next ones",
    "encoder": "",
    "llm": "",
    "association": "",
    "update": "",
    "grounding": "",
    "navigation": "",
}
"""What `--where` may name: field -> meaning. Other figures that episodes have are fields too."""

_SLOTS = ("perception", "encoder", "llm", "association", "update", "grounding", "navigation")
_COUNTS = frozenset({"frames", "replans", "detours", "viewpoints"})
_SHOWN = ("outcome", "goal", "scene", "seed", "seconds", "metres", "recording", "episode")
_LONGEST = 44


def episode_rows(runs: Mapping[Path, RunEntry], below: Path) -> Iterator[Row]:
    """A row an episode, in the order of the files; `recording` is the path from the folder `below`."""
    for path, entry in runs.items():
        for told in entry.episodes:
            success = told["outcome"] == "success"
            figures = {
                name: int(value) if name in _COUNTS and value == int(value) else value
                for name, value in told.get("values", {}).items()
                if isinstance(value, int | float) and math.isfinite(value)
            }
            plugins = entry.facts["plugins"]
            yield {
                **figures,
                **{slot: plugins.get(slot) for slot in _SLOTS},
                **{name: entry.facts[name] for name in ("run_id", "name", "scene", "source", "seed")},
                "recording": str(path.relative_to(below)),
                "episode": told["episode"],
                "goal": told["goal"],
                "outcome": told["outcome"] if success else told["reason"] or told["outcome"],
                "success": success,
                "frame": told["frame"],
                "sim_time": told["sim_time"],
                "complete": entry.complete,
            }


def chosen_rows(rows: Iterable[Row], where: str = "", worst_by: str = "") -> list[Row]:
    """The rows that `where` holds for, worst first.

    Worst: the highest `worst_by` where that is given; else failures before successes, of those the ones that
    took longest. Raises ConfigError for an expression that is not one.
    """
    listed = list(rows)
    fields = FIELDS | {name: "" for row in listed for name in row}
    if where:
        holds = condition(where, fields)
        listed = [row for row in listed if holds(row)]
    if not worst_by:
        return sorted(listed, key=lambda row: (row["success"], -_figure(row.get("seconds")), _place(row)))
    rank = value_of(worst_by, fields, "--worst-by")
    return sorted(listed, key=lambda row: (-_figure(rank(row)), _place(row)))


def _figure(value: Any) -> float:
    """A value as something to order by; none at all comes last."""
    return float(value) if isinstance(value, int | float) else -math.inf


def _place(row: Row) -> tuple[str, int]:
    return row["recording"], row["episode"]


def episodes_text(rows: Sequence[Row]) -> str:
    """A line an episode, and how many of them succeeded."""
    if not rows:
        return "no episode"
    table = [list(_SHOWN), *([_cell(row.get(name)) for name in _SHOWN] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in table
    ]
    reached = sum(row["success"] for row in rows)
    return "\n".join([*lines, f"{len(rows)} episodes, {reached} succeeded"])


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.1f}"
    text = "".join(c if c.isprintable() else "�" for c in str("-" if value is None else value))
    # The end of a path tells more than its beginning.
    return text if len(text) <= _LONGEST else f"...{text[-_LONGEST + 3 :]}"
