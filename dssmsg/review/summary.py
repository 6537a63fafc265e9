"""What happened in a run, from its recording alone: the object that `dssmsg inspect --json` prints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from dssmsg.graph.nodes import BELIEVED
from dssmsg.recording.reader import Recording


def summarize(recording: Recording) -> dict[str, Any]:
    """The summary of a run, in the shape of `run --json`, with `schema_version` and `complete`.

    A finished run is told in its own words; of one that was killed or cut off, what its recording says is
    counted: the graph as far as its changes can be folded, `changes_readable` of `changes_recorded`.
    """
    stored = (recording.stored_summary or {}) if recording.complete else {}
    counted = count(recording)
    notes = recording.cut_notes()
    return {
        **counted,
        **{name: value for name, value in stored.items() if _alike(value, counted.get(name))},
        **({"notes": notes} if notes else {}),
        "recording": str(recording.path),
        "changes_readable": recording.changes_readable,
        "changes_recorded": recording.changes_recorded,
        "frames_readable": recording.frames_readable,
        "schema_version": recording.schema_version,
        "complete": recording.complete,
    }


def _alike(value: Any, counted: Any) -> bool:
    """Whether a stored value has the type of the counted one, down to its items: files may say anything."""
    if counted is None or value is None:
        return True
    if isinstance(counted, Mapping):
        number = isinstance(value, Mapping) and all(isinstance(item, int | float) for item in value.values())
        return number and all(isinstance(name, str) for name in value)
    if isinstance(counted, list):
        return isinstance(value, list) and all(isinstance(item, dict) for item in value)
    return isinstance(value, int | float) if isinstance(counted, int) else isinstance(value, type(counted))


def count(recording: Recording) -> dict[str, Any]:
    """The summary as counted from the recording's rows."""
    facts = recording.facts
    graph = recording.graph_at()
    believed = [node for node in graph.objects.values() if node.status == BELIEVED]
    indices = recording.frame_indices
    seconds: Counter[str] = Counter()
    for timed in recording.told.timings:
        seconds.update(timed.seconds)
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
            {"goal": one.goal, "outcome": one.outcome, "reason": one.reason}
            for one in recording.told.episodes
        ],
        "errors": len(recording.told.errors),
        "collisions": recording.collisions(indices[-1]) if indices else 0,
        "seconds": {stage: round(value, 3) for stage, value in sorted(seconds.items())},
    }
