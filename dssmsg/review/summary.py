"""What happened in a run, from its recording alone: the object that `dssmsg inspect --json` prints."""

from __future__ import annotations

from collections import Counter
from typing import Any

from dssmsg.graph.nodes import BELIEVED
from dssmsg.recording import schema
from dssmsg.recording.reader import Recording


def summarize(recording: Recording) -> dict[str, Any]:
    """The summary of a run, in the shape of `run --json`, with `schema_version` and `complete`.

    A finished run is told in its own words; of one that was killed or cut off, what its recording says is
    counted: the graph as far as its changes can be folded, `changes_readable` of `changes_recorded`.
    """
    stored = (recording.stored_summary or {}) if recording.complete else {}
    notes = recording.cut_notes()
    return {
        **count(recording),
        **stored,
        **({"notes": notes} if notes else {}),
        "recording": str(recording.path),
        "changes_readable": recording.changes_readable,
        "changes_recorded": recording.changes_recorded,
        "frames_readable": recording.frames_readable,
        "schema_version": schema.SCHEMA_VERSION,
        "complete": recording.complete,
    }


def count(recording: Recording) -> dict[str, Any]:
    """The summary as counted from the recording's rows."""
    facts = recording.facts
    graph = recording.graph_at()
    believed = [node for node in graph.objects.values() if node.status == BELIEVED]
    indices = recording.frame_indices
    seconds: Counter[str] = Counter()
    for stages in recording.timings().values():
        seconds.update(stages)
    return {
        "name": facts["name"],
        "run_id": facts["run_id"],
        "seed": facts["seed"],
        "source": facts["source"]["name"],
        "scene": facts["source"]["scene"],
        "parent": facts["parent"],
        "frames": len(indices),
        "key_frames": len(recording.key_frames),
        "objects": len(believed),
        "tentative": len(graph.objects) - len(believed),
        "states": dict(sorted(Counter(node.state for node in believed).items())),
        "waypoints": len(graph.waypoints),
        "viewpoints": len(graph.viewpoints),
        "changes": recording.change_counts(),
        "phases": recording.phases(),
        "episodes": [
            {name: episode[name] for name in ("goal", "outcome", "reason")}
            for episode in recording.episodes()
        ],
        "errors": len(recording.errors()),
        "collisions": recording.collisions(indices[-1]) if indices else 0,
        "seconds": {stage: round(value, 3) for stage, value in sorted(seconds.items())},
    }
