"""A grounded sentence as JSON values, and as lines for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dssmsg.events import Candidate
from dssmsg.graph.view import GraphView

_TERMS = ("score", "s_graph", "s_node", "s_top", "s_core", "s_relation", "s_attribute", "s_view")
"""Scores that get a column, in this order, where any candidate has them."""


def query_json(
    sentence: str,
    recording: str,
    moment: Mapping[str, int | None],
    target: Mapping[str, Any],
    candidates: Sequence[Candidate],
    graph: GraphView,
) -> dict[str, Any]:
    """What `dssmsg query --json` prints: the target graph and every candidate, best first."""
    return {
        "query": sentence,
        "recording": recording,
        **{name: value for name, value in moment.items() if value is not None},
        "target": dict(target),
        "candidates": [
            {
                "rank": one.rank,
                "viewpoint": one.viewpoint_id,
                "waypoint": graph.viewpoints[one.viewpoint_id].waypoint_id,
                "scores": dict(one.scores),
                "matching": dict(one.matching),
                "reason": one.reason,
            }
            for one in candidates
        ],
    }


def query_text(answer: Mapping[str, Any], top: int) -> str:
    """How the sentence was read, and the first `top` waypoints, each by its best viewpoint.

    Views of one waypoint are one place to go to, as in Table IV; ranks are those among all viewpoints.
    """
    target = answer["target"]
    nodes = [" ".join((*node["attributes"], node["label"])) for node in target["nodes"]]
    lines = [f"{answer['query']}: {target['kind']}, looking for {nodes[target['core']]}"]
    lines += [f"  {nodes[e['source']]} {e['relation']} {nodes[e['target']]}" for e in target["edges"]]
    places: dict[str, Mapping[str, Any]] = {}
    for one in answer["candidates"]:
        places.setdefault(one["waypoint"], one)
    shown = list(places.values())[:top]
    if not shown:
        return "\n".join([*lines, "nothing in the map matches"])
    terms = [term for term in _TERMS if any(term in one["scores"] for one in shown)]
    cells = [("", "viewpoint", "waypoint", *terms)]
    for one in shown:
        scores = [f"{one['scores'][term]:.3f}" if term in one["scores"] else "-" for term in terms]
        cells.append((str(one["rank"]), one["viewpoint"], one["waypoint"], *scores))
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for row, line in enumerate(cells):
        lines.append("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())
        if row:
            lines.append(f"{'':{widths[0]}}  {shown[row - 1]['reason']}")
    if len(places) > top:
        lines.append(f"... and {len(places) - top} more waypoints; --json tells every viewpoint")
    return "\n".join(lines)
