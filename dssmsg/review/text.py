"""The summary of a run as lines for a terminal, whether it just ended or is read from its recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

MAX_ERRORS = 20
MAX_SPANS = 8


def summary_text(summary: Mapping[str, Any], errors: Sequence[Mapping[str, Any]] = ()) -> str:
    """One fact a line, equal `errors` together in one. What a summary does not hold is left out."""
    rows: list[tuple[str, Any]] = [
        ("recording", summary.get("recording") or "none (no observer wrote one)"),
        (
            "run",
            f"{summary['name']}, seed {summary['seed']}, {summary['source']} {summary['scene']}".rstrip(),
        ),
        *(("", note) for note in summary.get("notes", ())),
    ]
    if "complete" in summary:
        rows.append(("complete", "yes" if summary["complete"] else "no: the run was cut off, or is not over"))
    if summary.get("out_of_frames"):
        rows.append(("cut short", "mission.max_frames was used up"))
    if "phases" in summary:
        phases = ", ".join(f"{phase['phase']} from frame {phase['frame']}" for phase in summary["phases"])
        rows.append(("phases", phases or "none"))
    states = "".join(f", {number} {state}" for state, number in summary.get("states", {}).items())
    rows += [
        ("frames", f"{summary['frames']} ({summary['key_frames']} key frames)"),
        ("objects", f"{summary['objects']} ({summary['tentative']} more tentative){states}"),
        ("waypoints", f"{summary['waypoints']} with {summary['viewpoints']} viewpoints"),
        ("changes", ", ".join(f"{kind} {number}" for kind, number in summary["changes"].items()) or "none"),
        *(("episode", _episode(episode)) for episode in summary["episodes"]),
    ]
    if summary.get("collisions"):
        rows.append(("collisions", summary["collisions"]))
    if summary.get("skipped_stops"):
        rows.append(("skipped", ", ".join(summary["skipped_stops"])))
    failures = "".join(f", {plugin} failed {n} times" for plugin, n in summary.get("failures", {}).items())
    rows.append(("errors", f"{summary['errors']}{failures}"))
    lines = _error_lines(errors)
    rows += [("", line) for line in lines[:MAX_ERRORS]]
    if len(lines) > MAX_ERRORS:
        rows.append(("", f"... and {len(lines) - MAX_ERRORS} more"))
    seconds = ", ".join(f"{stage} {value:.1f}" for stage, value in summary["seconds"].items())
    rows.append(("seconds", seconds or "not timed"))
    return "\n".join(f"{name:<11}{value}" for name, value in rows)


def _episode(episode: Mapping[str, Any]) -> str:
    reason = f" ({episode['reason']})" if episode.get("reason") else ""
    return f"{episode['goal']}: {episode['outcome']}{reason}"


def _error_lines(errors: Sequence[Mapping[str, Any]]) -> list[str]:
    """`frames 0-3, 5: perception/x: ...`: a line for each failure of its own, by its first frame."""
    frames: dict[str, list[int]] = {}
    for error in errors:
        skipped = f"; skipped: {error['skipped']}" if error["skipped"] else ""
        frames.setdefault(f"{error['plugin']}: {error['message']}{skipped}", []).append(error["frame"])
    return [f"{_frames(found)}: {text}" for text, found in frames.items()]


def _frames(indices: Sequence[int]) -> str:
    """`frame 3`, `frames 0-3, 5` and so on, the last of many spans left out."""
    spans: list[list[int]] = []
    for index in sorted(set(indices)):
        if spans and index == spans[-1][1] + 1:
            spans[-1][1] = index
        else:
            spans.append([index, index])
    words = [f"{first}-{last}" if last > first else f"{first}" for first, last in spans]
    more = f" and {len(words) - MAX_SPANS} more spans" if len(words) > MAX_SPANS else ""
    times = f" ({len(indices)} times)" if len(indices) > 1 else ""
    return f"frame{'s' if len(set(indices)) > 1 else ''} {', '.join(words[:MAX_SPANS])}{more}{times}"
