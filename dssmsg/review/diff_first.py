"""Where two runs part: the first thing that came out differently, and which layer made it so.

Everything is compared in the order of causes. Within a frame: what the source gave, which frames the mission
chose, what perception saw, what a language model answered to the same question, which plug-in failed, each
change of the graph in the order of application, windows, matches, the driver, episodes. All that stands
before the first difference is equal, so its maker got the same input in both runs.

A *trace* is a difference without consequence: a score, a threshold or a stored colour that is another while
the decision is the same (`diff_decision`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

from dssmsg.recording import schema
from dssmsg.recording.damage import json_object, json_value, reading
from dssmsg.recording.describe import change_line
from dssmsg.recording.reader import Recording
from dssmsg.review.diff_decision import (
    KIND_OF_TRACE,
    NUMBERS,
    change_decision,
    differing,
    match_decision,
    told_apart,
    whole,
    window_decision,
)
from dssmsg.review.diff_frames import (
    detection_divergence,
    image_divergence,
    key_frame_divergence,
    source_divergence,
)
from dssmsg.review.divergence import Divergence, Term, parted, plugin_of

Json = dict[str, Any]

Traces = dict[str, Divergence]
"""The first trace of each kind."""

_NEVER = 2**62


@dataclass(slots=True)
class _Found:
    """What has been found so far: the earliest by frame, then by the order of causes.

    `first_traces` are the first one of numbers, and the first one of appearance.
    """

    best: Divergence | None = None
    rank: tuple[int, int] = (_NEVER, 0)
    first_traces: dict[str, tuple[tuple[int, int], Divergence]] = field(default_factory=dict)

    def offer(self, order: int, divergence: Divergence | None) -> None:
        if divergence is not None and (divergence.frame, order) < self.rank:
            self.best, self.rank = divergence, (divergence.frame, order)

    def note(self, order: int, traces: Traces) -> None:
        """Keep the earlier trace of each kind."""
        for kind, trace in traces.items():
            rank = trace.frame, order
            if kind not in self.first_traces or rank < self.first_traces[kind][0]:
                self.first_traces[kind] = rank, trace

    @property
    def traces(self) -> tuple[Divergence, ...]:
        """The traces up to the divergence, in order; one may be the first of both kinds."""
        told = sorted(self.first_traces.values(), key=lambda one: one[0])
        return tuple(dict.fromkeys(trace for (frame, _), trace in told if frame <= self.rank[0]))


def first_divergence(a: Recording, b: Recording) -> tuple[Divergence | None, tuple[Divergence, ...]]:
    """The first difference of consequence, None where there is none; and the traces before it."""
    found = _Found()
    found.offer(0, source_divergence(a, b))
    found.offer(1, key_frame_divergence(a, b))
    found.offer(3, _answers(a, b))
    found.offer(4, _failures(a, b))
    change, traces = _changes(a, b)
    found.offer(5, change)
    found.note(5, traces)
    rows = (
        (
            6,
            _Rows(schema.WINDOWS, "update", plugin_of(a, "update"), "a window", "viewpoint", window_decision),
        ),
        (
            7,
            _Rows(schema.MATCHES, "grounding", plugin_of(a, "grounding"), "a match", "query", match_decision),
        ),
        (9, _Rows(schema.EPISODES, "mission", "mission", "an episode", "goal", whole)),
    )
    for order, table in rows:
        row, traces = _first_row(a, b, table)
        found.offer(order, row)
        found.note(order, traces)
    found.offer(8, _driver(a, b))
    # Perception is dear to compare, so only as far as anything else is equal.
    found.offer(2, detection_divergence(a, b, found.rank[0]))
    if found.best is not None:
        found.offer(0, image_divergence(a, b, found.rank[0]))
    return found.best, found.traces


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
        return bool(json_value(a) == json_value(b))
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


Decision = Callable[[Json], Json]


def _differing_rows(
    a: Recording,
    b: Recording,
    table: schema.Table,
    texts: tuple[Iterable[str], Iterable[str]],
    decision: Decision,
) -> Iterator[tuple[Json | None, Json | None, bool]]:
    """Rows that are not the same, place by place, and whether the decision is; None past the end of a run.

    Equal texts are not read: an hour's windows are large.
    """
    for pair in zip_longest(*texts):
        if pair[0] == pair[1]:
            continue
        rows: list[Json | None] = []
        decided: list[Json | None] = []
        for recording, text in zip((a, b), pair, strict=True):
            with reading(recording.path, f"a row of {table.path}"):
                rows.append(None if text is None else json_object(text))
                decided.append(None if rows[-1] is None else decision(rows[-1]))
        if rows[0] != rows[1]:
            yield rows[0], rows[1], decided[0] == decided[1]


# The graph.


def _changes(a: Recording, b: Recording) -> tuple[Divergence | None, Traces]:
    """The first change that came out differently, and the first traces before it."""
    traces: Traces = {}
    texts = a.change_texts(), b.change_texts()
    for ours, theirs, same in _differing_rows(a, b, schema.GRAPH_LOG, texts, change_decision):
        if ours is None or theirs is None or not same:
            return _change(a, b, ours, theirs, consequence=True), traces
        fields = differing(ours, theirs)
        kinds = {KIND_OF_TRACE[name] for name in fields if name in KIND_OF_TRACE}
        if new := sorted(kinds - traces.keys()):
            traces |= dict.fromkeys(new, _change(a, b, ours, theirs, consequence=False))
    return None, traces


def _change(
    a: Recording, b: Recording, ours: Json | None, theirs: Json | None, *, consequence: bool
) -> Divergence:
    rows = [one for one in (ours, theirs) if one is not None]
    # The log that says less for now has nothing to say of this frame.
    frame = min(int(row["frame"]) for row in rows)
    here = [row if row is not None and row["frame"] == frame else None for row in (ours, theirs)]
    cause = next(row for row in here if row is not None)["cause"]
    plugin = str(cause["plugin"])
    lines = [
        _line(recording, row) if row is not None else "no such change"
        for recording, row in zip((a, b), here, strict=True)
    ]
    what = f"{cause['rule']}: " + ("another change" if consequence else "the same decision")
    fields: tuple[str, ...] = ("change",)
    one, other = here
    if one is not None and other is not None and one["subjects"] == other["subjects"]:
        fields = differing(one, other)
        decided = differing(change_decision(one), change_decision(other))
        what += f", other {', '.join(decided or [name for name in fields if name != 'cause'])}"
        if lines[0] == lines[1]:
            lines = list(told_apart(one, other))
    return parted(frame, _layer(plugin), plugin, what, lines, fields, _terms(one, other), consequence)


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


@dataclass(frozen=True, slots=True)
class _Rows:
    """A table whose rows are compared in order: whose it is, how a row is called, what in it is decided."""

    table: schema.Table
    layer: str
    plugin: str
    noun: str
    key: str
    decision: Decision


def _first_row(a: Recording, b: Recording, rows: _Rows) -> tuple[Divergence | None, Traces]:
    """The first row that came out differently, and the first trace before it."""
    traces: Traces = {}
    texts = a.told.texts(rows.table), b.told.texts(rows.table)
    for one, other, same in _differing_rows(a, b, rows.table, texts, rows.decision):
        if not same:
            return _other_goal(a, b, rows, one, other) or _row_divergence(rows, one, other), traces
        if NUMBERS not in traces:
            traces[NUMBERS] = _row_divergence(rows, one, other)
    return None, traces


def _other_goal(
    a: Recording, b: Recording, rows: _Rows, one: Json | None, other: Json | None
) -> Divergence | None:
    """Where the rows are about the first goals in which the missions differ: no layer decided that."""
    goals = next((pair for pair in zip_longest(_goals(a), _goals(b)) if pair[0] != pair[1]), None)
    if goals is None or goals != tuple(None if row is None else row[rows.key] for row in (one, other)):
        return None
    frame = min(int(row["frame"]) for row in (one, other) if row is not None)
    sides = ("no goal" if goal is None else str(goal) for goal in goals)
    return parted(max(0, frame), "mission", "mission", "another goal is sought", sides, fields=("goal",))


def _goals(recording: Recording) -> Sequence[Any]:
    """The sentences that a run was to seek."""
    mission = recording.config.get("mission")
    if not isinstance(mission, Mapping) or "seek" not in (mission.get("phases") or ()):
        return ()
    goals = mission.get("goals")
    return goals if isinstance(goals, list) else ()


def _row_divergence(rows: _Rows, one: Json | None, other: Json | None) -> Divergence:
    first = min((row for row in (one, other) if row is not None), key=lambda row: int(row["frame"]))
    fields: tuple[str, ...] = (rows.key,)
    consequence = True
    if one is None or other is None:
        ours, theirs = ("none" if row is None else str(row[rows.key]) for row in (one, other))
    else:
        decided = rows.decision(one), rows.decision(other)
        consequence = decided[0] != decided[1]
        told = decided if consequence else (one, other)
        fields = differing(*told)
        ours, theirs = told_apart(*told)
    names = ", ".join(fields)
    differs = f"differs: {first[rows.key]} ({names})"
    what = differs if consequence else f"of {first[rows.key]}: the same decision, other {names}"
    frame = max(0, int(first["frame"]))
    return Divergence(
        frame,
        rows.layer,
        rows.plugin,
        f"{rows.noun} {what}",
        ours,
        theirs,
        fields,
        consequence=consequence,
    )


def _driver(a: Recording, b: Recording) -> Divergence | None:
    seeks = [phase["frame"] for phase in a.phases() if phase["phase"] == "seek"]
    rows = _Rows(schema.NAVIGATION, "navigation", "", "the driver", "state", whole)
    found, _ = _first_row(a, b, rows)
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
