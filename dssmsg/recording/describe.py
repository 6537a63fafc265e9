"""One change of the graph as one line that a person reads: what, and by which numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dssmsg.graph import changes as ch
from dssmsg.graph.changes import Change, Score

_PLAIN = ("relation", "verified")  # attributes whose value says enough
_UNTOLD = ("offset",)  # three numbers that no reader of a log wants; they are in the change


def scores_text(scores: tuple[Score, ...]) -> str:
    """`s_geo 0.93 · s_sem 0.98 · s 1.91 (>= 1.10)`: each term with the threshold it was held against."""
    return " · ".join(
        f"{score.name} {score.value:.3g}"
        if score.threshold is None
        else f"{score.name} {score.value:.3g} ({'>=' if score.value >= score.threshold else '<'}"
        f" {score.threshold:.3g})"
        for score in scores
    )


def change_text(change: Change) -> str:
    """The line of a change, without its scores: `object-12 merged a chair (0.91) seen from viewpoint-3.2`."""
    what = _what(change)
    where = getattr(change, "viewpoint_id", None)
    if where and isinstance(change, (ch.ObjectAdded, ch.ObjectMerged)):
        what += f" from {where}"
    return what


def change_line(change: Change) -> str:
    """The full line: what, who by which rule, and the scores."""
    parts = (change_text(change), f"[{change.cause.plugin}: {change.cause.rule}]", scores_text(change.scores))
    return "  ".join(part for part in parts if part)


def _what(change: Change) -> str:
    match change:
        case ch.ObjectAdded():
            return f"{change.object_id} new: {change.label} {change.score:.2f}, {len(change.points)} points"
        case ch.ObjectMerged():
            return (
                f"{change.object_id} merged: {change.label} {change.score:.2f}, +{len(change.points)} points"
            )
        case ch.ObjectsJoined():
            return f"{change.object_id} took over {change.absorbed_id}"
        case ch.ObjectChanged():
            return f"{change.object_id} {_values(change.values, change.before)}"
        case ch.ObjectReplaced():
            former = f", former place kept as {change.history_id}" if change.history_id else ""
            return f"{change.object_id} has a new place or extent, {len(change.points)} points{former}"
        case ch.ObjectRemoved():
            kept = f", last place kept as {change.history_id}" if change.history_id else ""
            same = f", is {change.successor_id}" if change.successor_id else ""
            return f"{change.object_id} removed{kept}{same}"
        case ch.WaypointAdded():
            return f"{change.waypoint_id} new at ({change.position[0]:.2f}, {change.position[1]:.2f})"
        case ch.WaypointRemoved():
            return f"{change.waypoint_id} removed"
        case ch.ViewpointAdded():
            return f"{change.viewpoint_id} new"
        case ch.ViewpointSeen():
            return f"{change.viewpoint_id} seen again"
        case ch.EdgeAdded():
            return f"{change.source} -{change.edge}- {change.target} new{_attributes(change)}"
        case ch.EdgeChanged():
            return f"{change.source} -{change.edge}- {change.target}{_attributes(change)}"
        case ch.EdgeRemoved():
            return f"{change.source} -{change.edge}- {change.target} removed"
    return f"{change.kind} {' '.join(change.subjects)}"


def _values(values: Mapping[str, Any], before: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name}: {_short(before[name])} -> {_short(value)}" if name in before else f"{name}: {_short(value)}"
        for name, value in sorted(values.items())
    )


def _attributes(change: ch.EdgeAdded | ch.EdgeChanged) -> str:
    """What an edge says of itself: `(next to)`. Not what the scores say, nor what is not so."""
    told = {score.name.split("_")[0] for score in change.scores}
    shown = [
        value if name in _PLAIN else name if value is True else f"{name} {_short(value)}"
        for name, value in sorted(change.attributes.items())
        if name not in told and name not in _UNTOLD and value is not False and value is not None
    ]
    return f" ({', '.join(shown)})" if shown else ""


def _short(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return f"{value:.3g}"
    if isinstance(value, list | tuple | np.ndarray):
        return "(" + ", ".join(map(_short, value)) + ")"
    return str(value)
