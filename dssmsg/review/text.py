"""The summary of a run as lines for a terminal, whether it just ended or is read from its recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

MAX_ERRORS = 20


def summary_text(summary: Mapping[str, Any], errors: Sequence[Mapping[str, Any]] = ()) -> str:
    """One fact a line; `errors` are told one a line. What a summary does not hold is left out."""
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
        (
            "objects",
            f"{summary['objects']} ({summary['tentative']} more tentative)"
            + (f": {states}" if states else ""),
        ),
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
    rows += [("", _error(error)) for error in errors[:MAX_ERRORS]]
    if len(errors) > MAX_ERRORS:
        rows.append(("", f"... and {len(errors) - MAX_ERRORS} more"))
    seconds = ", ".join(f"{stage} {value:.1f}" for stage, value in summary["seconds"].items())
    rows.append(("seconds", seconds or "not timed"))
    return "\n".join(f"{name:<11}{value}" for name, value in rows)


def _episode(episode: Mapping[str, Any]) -> str:
    reason = f" ({episode['reason']})" if episode.get("reason") else ""
    return f"{episode['goal']}: {episode['outcome']}{reason}"


def _error(error: Mapping[str, Any]) -> str:
    skipped = f"; skipped: {error['skipped']}" if error["skipped"] else ""
    return f"frame {error['frame']}: {error['plugin']}: {error['message']}{skipped}"
