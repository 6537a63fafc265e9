"""Where two runs part: the first thing that came out differently, and which layer made it so.

Everything is compared in the order of causes. Within a frame: what the source gave, which frames the mission
chose, what perception saw, what a language model answered to the same question, which plug-in failed, each
change of the graph in the order of application, windows, matches, the driver, episodes. All that stands
before the first difference is equal, so its maker got the same input in both runs.

A *trace* is a difference without consequence: a score or a threshold that moved while the decision stayed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

from dssmsg.errors import InputError
from dssmsg.recording import schema
from dssmsg.recording.damage import json_object
from dssmsg.recording.describe import change_line
from dssmsg.recording.reader import Recording
from dssmsg.review.diff_frames import (
    detection_divergence,
    image_divergence,
    key_frame_divergence,
    source_divergence,
)
from dssmsg.review.divergence import Divergence, Term, parted, plugin_of

Json = dict[str, Any]

_NEVER = 2**62


@dataclass(slots=True)
class _Found:
    """What has been found so far: the earliest by frame, then by the order of causes."""

    best: Divergence | None = None
    rank: tuple[int, int] = (_NEVER, 0)
    traces: list[Divergence] = field(default_factory=list)

    def offer(self, order: int, divergence: Divergence | None) -> None:
        if divergence is not None and (divergence.frame, order) < self.rank:
            self.best, self.rank = divergence, (divergence.frame, order)


def first_divergence(a: Recording, b: Recording) -> tuple[Divergence | None, tuple[Divergence, ...]]:
    """The first difference of consequence, None where there is none; and the traces before it."""
    found = _Found()
    found.offer(0, source_divergence(a, b))
    found.offer(1, key_frame_divergence(a, b))
    found.offer(3, _answers(a, b))
    found.offer(4, _failures(a, b))
    change, trace = _changes(a, b)
    found.offer(5, change)
    update, grounding = plugin_of(a, "update"), plugin_of(a, "grounding")
    found.offer(6, _rows(a, b, schema.WINDOWS, "update", update, "a window", "viewpoint"))
    found.offer(7, _rows(a, b, schema.MATCHES, "grounding", grounding, "a match", "query"))
    found.offer(8, _driver(a, b))
    found.offer(9, _rows(a, b, schema.EPISODES, "mission", "mission", "an episode", "goal"))
    # Perception is dear to compare, so only as far as anything else is equal.
    found.offer(2, detection_divergence(a, b, found.rank[0]))
    if found.best is not None:
        found.offer(0, image_divergence(a, b, found.rank[0]))
    traces = [one for one in (trace,) if one is not None and one.frame <= found.rank[0]]
    return found.best, tuple(traces)


def _answers(a: Recording, b: Recording) -> Divergence | None:
    """The first question that both asked and that was answered otherwise; another question is a follow-up."""
    for ours, theirs in zip(_ends(a.llm_calls()), _ends(b.llm_calls()), strict=False):
        if ours["request_hash"] != theirs["request_hash"]:
            return None
        if ours["ok"] != theirs["ok"] or (ours["ok"] and not _same_json(ours["answer"], theirs["answer"])):
            said = [one["answer"] if one["ok"] else f"failed: {one['error']}" for one in (ours, theirs)]
            return parted(
                max(0, min(ours["frame"], theirs["frame"])),
                "llm",
                f"llm/{theirs['provider']}",
                f"the same {ours['role']} question was answered differently",
                said,
                fields=("answer",),
            )
    return None


def _ends(calls: Sequence[Json]) -> Iterator[Json]:
    """The last exchange of each question: the one that counted."""
    for call, then in zip_longest(calls, calls[1:]):
        if then is None or then.get("attempt", 1) == 1 or then["request_hash"] != call["request_hash"]:
            yield call


def _same_json(a: str, b: str) -> bool:
    try:
        return bool(json.loads(a) == json.loads(b))
    except ValueError:
        return a == b


def _failures(a: Recording, b: Recording) -> Divergence | None:
    def told(row: Json) -> tuple[Any, ...]:
        return row["frame"], row["plugin"], row["skipped"]

    for ours, theirs in zip_longest(a.errors(), b.errors()):
        if ours is not None and theirs is not None and told(ours) == told(theirs):
            continue
        row = min((one for one in (ours, theirs) if one is not None), key=lambda one: one["frame"])
        sides = [
            one["message"] if one is not None and told(one) == told(row) else "no failure"
            for one in (ours, theirs)
        ]
        layer = row["plugin"].partition("/")[0]
        return parted(
            max(0, row["frame"]),
            layer,
            row["plugin"],
            "a failure in one run alone",
            sides,
            fields=("failure",),
        )
    return None


# The graph.


def _changes(a: Recording, b: Recording) -> tuple[Divergence | None, Divergence | None]:
    """The first change that came out differently, and the first trace before it."""
    trace: Divergence | None = None
    for texts in zip_longest(a.change_texts(), b.change_texts()):
        if texts[0] == texts[1]:
            continue
        ours, theirs = (
            None if text is None else _read(recording, schema.GRAPH_LOG, text)
            for recording, text in zip((a, b), texts, strict=True)
        )
        if ours == theirs:
            continue
        if ours is not None and theirs is not None and _outcome(ours) == _outcome(theirs):
            if trace is None and ours["scores"] != theirs["scores"]:
                trace = _change(a, b, ours, theirs, consequence=False)
            continue
        return _change(a, b, ours, theirs, consequence=True), trace
    return None, trace


def _outcome(row: Json) -> Json:
    return {name: value for name, value in row.items() if name not in ("scores", "cause")}


def _change(
    a: Recording, b: Recording, ours: Json | None, theirs: Json | None, *, consequence: bool
) -> Divergence:
    rows = [one for one in (ours, theirs) if one is not None]
    # The log that says less for now has nothing to say of this frame.
    frame = min(int(row["frame"]) for row in rows)
    here = [row if row is not None and row["frame"] == frame else None for row in (ours, theirs)]
    first = next(row for row in here if row is not None)
    cause = first["cause"]
    plugin = str(cause["plugin"])
    fields: tuple[str, ...] = ("change",)
    if here[0] is not None and here[1] is not None and here[0]["subjects"] == here[1]["subjects"]:
        names = dict.fromkeys([*here[0], *here[1]])
        fields = tuple(name for name in names if here[0].get(name) != here[1].get(name))
    lines = [
        _line(recording, row) if row is not None else "no such change"
        for recording, row in zip((a, b), here, strict=True)
    ]
    what = f"{cause['rule']}: " + ("another change" if consequence else "the same decision by other numbers")
    return parted(frame, _layer(plugin), plugin, what, lines, fields, _terms(here[0], here[1]), consequence)


def _line(recording: Recording, row: Json) -> str:
    return next((change_line(one) for one in recording.changes(after=row["update"] - 1)), "")


def _terms(ours: Json | None, theirs: Json | None) -> tuple[Term, ...]:
    scores = [
        {} if row is None else {name: (value, limit) for name, value, limit in row["scores"]}
        for row in (ours, theirs)
    ]
    nothing = (None, None)
    terms = []
    for name in dict.fromkeys([*scores[0], *scores[1]]):
        (value_a, limit_a), (value_b, limit_b) = (side.get(name, nothing) for side in scores)
        terms.append(Term(name, value_a, value_b, limit_a, limit_b))
    return tuple(terms)


def _layer(plugin: str) -> str:
    """`association/dssm` -> association; the graph's own rules by their name: `graph/edges` -> edges."""
    kind, _, name = plugin.partition("/")
    return name if kind == "graph" and name else kind


# The rest.


def _rows(
    a: Recording, b: Recording, table: schema.Table, layer: str, plugin: str, noun: str, key: str
) -> Divergence | None:
    """The first row of a table that differs. Equal texts are not read: an hour's windows are large."""
    for texts in zip_longest(a.told.texts(table), b.told.texts(table)):
        if texts[0] == texts[1]:
            continue
        one, other = (
            None if text is None else _read(recording, table, text)
            for recording, text in zip((a, b), texts, strict=True)
        )
        if one == other:
            continue
        rows = [row for row in (one, other) if row is not None]
        first = min(rows, key=lambda row: int(row["frame"]))
        fields: tuple[str, ...] = (key,)
        if one is not None and other is not None:
            fields = tuple(name for name in dict.fromkeys([*one, *other]) if one.get(name) != other.get(name))
        sides = ["none" if row is None else _short(row, fields) for row in (one, other)]
        what = f"{noun} differs: {first[key]} ({', '.join(fields)})"
        return parted(max(0, int(first["frame"])), layer, plugin, what, sides, fields=fields)
    return None


def _read(recording: Recording, table: schema.Table, text: str) -> Json:
    try:
        return json_object(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"a row of {table.path} is damaged ({error})", file=recording.path) from error


def _driver(a: Recording, b: Recording) -> Divergence | None:
    seeks = [phase["frame"] for phase in a.phases() if phase["phase"] == "seek"]
    found = _rows(a, b, schema.NAVIGATION, "navigation", "", "the driver", "state")
    if found is None:
        return None
    driven = bool(seeks) and found.frame >= min(seeks) - 1
    plugin = plugin_of(a, "navigation") if driven else "mission"
    return parted(
        found.frame,
        "navigation" if driven else "mission",
        plugin,
        found.what,
        (found.a, found.b),
        found.fields,
    )


def _short(row: Json, fields: Sequence[str], limit: int = 160) -> str:
    text = ", ".join(f"{name} {json.dumps(row.get(name), sort_keys=True)}" for name in fields)
    return text if len(text) <= limit else text[: limit - 3] + "..."
