"""What the viewer shows of a grounded query: what it asks for, what matches, and the candidates' scores."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr

from dssmsg import events
from dssmsg.graph.nodes import STATIC
from dssmsg.graph.view import GraphView
from dssmsg.recording import palette, schema
from dssmsg.recording.sheets import SheetBook, Stamp, path_part

_LONGEST = 40
"""Characters of a sentence that go into its path."""
_LISTED = 12
"""Candidates on the page."""
_THING_COLOUR = palette.OBJECT_CLASSES[STATIC][2]  # not white: a page in the browser may be bright


class MatchLog:
    """Logs `/scores/<query>` (a bar a candidate, best first) and `/matrix/<query>` (candidate x score).

    Besides, for the latest query: `/target`, the target graph, `/world/matched`, what the best candidate
    matched it with, and `/match_text`, the best candidates as a page.

    A query's path is its number and its words. What the one before it left in the views is cleared, so that a
    view shows the latest up to the cursor.
    """

    def __init__(self, book: SheetBook) -> None:
        self._book = book
        self._queries = 0
        self._shown = ""

    def add(self, event: events.Matched, stamp: Stamp, graph: GraphView) -> None:
        """Show a query and its candidates in the map as it is now."""
        self._book.log_now(schema.TARGET, stamp, *target_look(event.target))
        self._book.log_now(schema.MATCHED, stamp, matched_look(event, graph))
        self._book.look(
            schema.MATCH_TEXT, rr.TextDocument, stamp, text=match_page(event), media_type="text/markdown"
        )
        if self._shown:
            for root in (schema.SCORES, schema.MATRIX):
                self._book.log_now(f"{root}/{self._shown}", stamp, rr.Clear(recursive=False))
            self._shown = ""
        self._queries += 1
        if not event.candidates:
            return
        words = path_part(event.query.replace("/", " "))[:_LONGEST].strip("_")
        self._shown = f"{self._queries:03d}_{words}"
        names = list(dict.fromkeys(name for one in event.candidates for name in one.scores))
        table = np.array(
            [[one.scores.get(name, np.nan) for name in names] for one in event.candidates], dtype=np.float64
        )
        if not table.size:
            return
        ranked_by = names.index("score") if "score" in names else 0
        bars = np.nan_to_num(table[:, ranked_by])
        self._book.log_now(f"{schema.SCORES}/{self._shown}", stamp, rr.BarChart(bars))
        matrix = rr.Tensor(np.nan_to_num(table).astype(np.float32), dim_names=("candidate", " ".join(names)))
        self._book.log_now(f"{schema.MATRIX}/{self._shown}", stamp, matrix)


def target_look(target: Mapping[str, Any]) -> tuple[rr.GraphNodes, rr.GraphEdges]:
    """A target graph: a node a thing, the core larger, and a small one a relation between two of them."""
    things = target.get("nodes", ())
    relations = target.get("edges", ())
    names = [", ".join([str(thing["label"]), *map(str, thing.get("attributes", ()))]) for thing in things]
    ids = [f"{number}" for number in range(len(things))]
    joints = [f"relation {number}" for number in range(len(relations))]
    core = target.get("core")
    nodes = rr.GraphNodes(
        [*ids, *joints],
        labels=[*names, *(str(relation["relation"]) for relation in relations)],
        colors=[
            *(palette.GOAL_COLOUR if number == core else _THING_COLOUR for number in range(len(things))),
            *(palette.EDGE_COLOURS["near"] for _ in relations),
        ],
        radii=[
            *(16.0 if number == core else 11.0 for number in range(len(things))),
            *(4.0 for _ in relations),
        ],
    )
    ends = [
        pair
        for joint, relation in zip(joints, relations, strict=True)
        for pair in ((f"{relation['source']}", joint), (joint, f"{relation['target']}"))
    ]
    return nodes, rr.GraphEdges(ends, graph_type="directed")


def matched_look(event: events.Matched, graph: GraphView) -> rr.Boxes3D:
    """A bright box round each object that the best candidate matched, named by what it stands for."""
    if not event.candidates:
        return rr.Boxes3D(half_sizes=[], centers=[])
    wanted = event.target.get("nodes", ())
    boxes, labels = [], []
    for number, object_id in event.candidates[0].matching.items():
        node = graph.objects.get(object_id)
        if node is None:
            continue
        boxes.append((node.center, (node.box_max - node.box_min) / 2 + 0.04))
        asked = wanted[int(number)]["label"] if number.isdecimal() and int(number) < len(wanted) else number
        labels.append(asked if asked == node.label else f"{asked}: {node.label}")
    return rr.Boxes3D(
        centers=np.array([center for center, _ in boxes], np.float32).reshape(-1, 3),
        half_sizes=np.array([half for _, half in boxes], np.float32).reshape(-1, 3),
        labels=labels,
        show_labels=True,
        colors=palette.GOAL_COLOUR,
        radii=rr.Radius.ui_points(2.0),
        fill_mode=rr.components.FillMode.MajorWireframe,
    )


def match_page(event: events.Matched) -> str:
    """The best candidates with their scores and matched objects, in Markdown."""
    if not event.candidates:
        return f"## “{event.query}”\n\nNothing in the map matches.\n"
    shown = event.candidates[:_LISTED]
    names = [name for name in dict.fromkeys(n for one in shown for n in one.scores) if name != "score"]
    # The reason above the table: that is long, and the first lines are what is seen.
    lines = [f"## “{event.query}”", "", f"**Why the first:** {event.candidates[0].reason}", ""]
    lines += ["| | viewpoint | score | " + " | ".join(names) + " | matched |"]
    lines.append("|---" * (len(names) + 4) + "|")
    for one in shown:
        figures = [f"{one.scores[name]:.3g}" if name in one.scores else "" for name in ("score", *names)]
        matched = ", ".join(object_id.removeprefix("object-") for object_id in one.matching.values())
        lines.append(f"| {one.rank} | {one.viewpoint_id} | {' | '.join(figures)} | {matched} |")
    if len(event.candidates) > len(shown):
        lines += ["", f"and {len(event.candidates) - len(shown)} more"]
    return "\n".join(lines) + "\n"
