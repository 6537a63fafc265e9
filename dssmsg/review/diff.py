"""What differs between two runs, from their recordings alone: in settings, in results, and from where on.

Nothing of the simulator is needed. Two runs may be a recording and its replay, two replays of one recording,
or two runs of their own.
"""

from __future__ import annotations

import json
from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import zip_longest
from statistics import fmean
from typing import Any

from dssmsg.recording.damage import json_value, reading
from dssmsg.recording.reader import Recording
from dssmsg.review.diff_first import first_divergence
from dssmsg.review.diff_objects import ObjectDifference, compare_objects, placed
from dssmsg.review.divergence import Divergence

Json = dict[str, Any]

_OWN = frozenset({"name", "recording", "plugins"})
"""Parts of a configuration that name a run, or say where it is written: no reason for anything."""
_TOP = 3
"""So many of the best candidates of a query are compared."""


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two runs. `relation` says what it is to the other: "", parent or replay.

    `images` is how colours are kept: jpeg or lossless.
    """

    recording: str
    run_id: str
    scene: str
    seed: int
    frames: int
    changes: int
    parent: str | None
    relation: str = ""
    images: str = ""


@dataclass(frozen=True, slots=True)
class Setting:
    """A value of the configuration, or a plug-in or package with its version, that is not the same."""

    key: str
    a: Any
    b: Any


@dataclass(frozen=True, slots=True)
class Rule:
    """What a rule of a plug-in decided: how often, with which mean score and which smallest margin.

    The margin is the distance between a score and the threshold it was held against.
    """

    rule: str
    score: str
    count_a: int
    count_b: int
    mean_a: float | None
    mean_b: float | None
    margin_a: float | None
    margin_b: float | None


@dataclass(frozen=True, slots=True)
class Query:
    """A sentence that was grounded in one or both runs: the best viewpoints, and what was asked for.

    `best_a_in_b` is the rank of A's winner among B's candidates, None where it is none of them. `only_in`
    is the side (a, b) that alone was asked; empty where both were.
    """

    query: str
    target_same: bool
    top_a: tuple[tuple[str, float | None], ...]
    top_b: tuple[tuple[str, float | None], ...]
    best_a_in_b: int | None
    best_b_in_a: int | None
    only_in: str = ""


@dataclass(frozen=True, slots=True)
class Episode:
    """An episode in both runs: outcome with its reason, and the values that differ."""

    episode: int
    goal: str
    a: str
    b: str
    values: Mapping[str, tuple[float | None, float | None]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Difference:
    """Everything that `dssmsg diff` tells. `seconds`: stage -> wall milliseconds a frame in A and in B.

    `because` are the settings under the slot of the plug-in that parted first: the likely reason.
    """

    a: Side
    b: Side
    settings: tuple[Setting, ...]
    divergence: Divergence | None
    because: tuple[Setting, ...]
    traces: tuple[Divergence, ...]
    objects: ObjectDifference
    changes: Mapping[str, tuple[int, int]]
    rules: tuple[Rule, ...]
    queries: tuple[Query, ...]
    episodes: tuple[Episode, ...]
    errors: tuple[int, int]
    milliseconds: Mapping[str, tuple[float | None, float | None]]

    @property
    def same(self) -> bool:
        """Whether the two runs came out the same."""
        return self.divergence is None

    def to_json(self) -> Json:
        """JSON values."""
        return {"same": self.same, **asdict(self)}


def compare(a: Recording, b: Recording) -> Difference:
    """Compare two recordings. Raises InputError where one of them is damaged."""
    divergence, traces = first_divergence(a, b)
    settings = compare_settings(a, b)
    return Difference(
        a=_side(a, b),
        b=_side(b, a),
        settings=settings,
        divergence=divergence,
        because=() if divergence is None else _because(divergence, settings),
        traces=traces,
        objects=compare_objects(placed(a.graph_at()), placed(b.graph_at())),
        changes=_both(a.change_counts(), b.change_counts()),
        rules=_rules(a, b),
        queries=_queries(a.matches(), b.matches()),
        episodes=_episodes(a.episodes(), b.episodes()),
        errors=(len(a.errors()), len(b.errors())),
        milliseconds=_milliseconds(a, b),
    )


def _side(recording: Recording, other: Recording) -> Side:
    facts = recording.facts
    own, others = facts["run_id"], other.facts["run_id"]
    relation = "replay" if facts.get("parent") == others else ""
    relation = relation or ("parent" if other.facts.get("parent") == own else "")
    return Side(
        recording=str(recording.path),
        run_id=own,
        scene=facts["source"]["scene"],
        seed=recording.seed,
        frames=len(recording.frame_indices),
        changes=recording.changes_readable,
        parent=facts.get("parent"),
        relation=relation,
        images=str(facts.get("images", "")),
    )


# Settings.


def compare_settings(a: Recording, b: Recording) -> tuple[Setting, ...]:
    """Where configuration, plug-ins and package versions of two runs differ.

    A replay that uses recorded frames, detections or answers has the settings of its parent there.
    """
    found = [
        Setting(key, one, other)
        for key, one, other in _differences(_effective(a, b), _effective(b, a))
        if key.partition(".")[0] not in _OWN
    ]
    for key, one, other in _differences(_versions(a), _versions(b)):
        found.append(Setting(key, one, other))
    return tuple(found)


def _effective(recording: Recording, other: Recording) -> Json:
    """A configuration in which slots that read from the other recording look as they did there."""
    config = dict(recording.config)
    if recording.facts.get("parent") == other.facts["run_id"]:
        for kind in ("source", "perception", "llm"):
            slot = config.get(kind)
            if isinstance(slot, Mapping) and slot.get("use") in ("recorded", "recording"):
                config[kind] = other.config.get(kind)
    return {key: value for key, value in config.items() if key not in _OWN}


def _versions(recording: Recording) -> Json:
    facts = recording.facts
    plugins = facts.get("plugins")
    made = plugins if isinstance(plugins, Mapping) else {}
    return {
        "versions": facts.get("versions"),
        "plugin": {
            key: one.get("version")
            for key, one in made.items()
            if isinstance(one, Mapping) and "." not in key
        },
    }


def _differences(a: Any, b: Any, key: str = "") -> Iterable[tuple[str, Any, Any]]:
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        if a.get("use") != b.get("use"):  # the other options belong to two plug-ins
            yield f"{key}.use", a.get("use"), b.get("use")
            return
        for name in dict.fromkeys([*a, *b]):
            yield from _differences(a.get(name), b.get(name), f"{key}.{name}" if key else str(name))
    elif json.dumps(a, sort_keys=True, default=str) != json.dumps(b, sort_keys=True, default=str):
        yield key, a, b


_SLOTS_OF_LAYER: Mapping[str, tuple[str, ...]] = {
    "source": ("source",),
    "perception": ("perception", "encoder"),
    "association": ("association", "encoder"),
    "update": ("update", "llm"),
    "grounding": ("grounding", "encoder", "llm"),
    "navigation": ("navigation", "mission"),
    "llm": ("llm",),
    "mission": ("mission",),
}


def _because(divergence: Divergence, settings: Sequence[Setting]) -> tuple[Setting, ...]:
    """The settings of the layer that parted; where it has none of its own, any that makes a difference."""
    slots = _SLOTS_OF_LAYER.get(divergence.layer, ())
    own = tuple(one for one in settings if one.key.partition(".")[0] in slots)
    general = ("seed", "versions", "plugin")
    return own or tuple(one for one in settings if one.key.partition(".")[0] in general)


# Results.


def _both(a: Mapping[str, int], b: Mapping[str, int]) -> dict[str, tuple[int, int]]:
    return {kind: (a.get(kind, 0), b.get(kind, 0)) for kind in sorted({*a, *b})}


@dataclass(slots=True)
class _Scores:
    """The values of a score that a rule gave, and their distances to the threshold."""

    values: array[float] = field(default_factory=lambda: array("d"))
    margins: array[float] = field(default_factory=lambda: array("d"))


_RuleTable = dict[tuple[str, str], _Scores]


def _rules(a: Recording, b: Recording) -> tuple[Rule, ...]:
    """The rules whose figures differ, by the name of their plug-in."""
    tables = _rule_tables(a, b)
    found = []
    for key in sorted({*tables[0], *tables[1]}):
        ours, theirs = (table.get(key, _Scores()) for table in tables)
        if ours == theirs:
            continue
        found.append(
            Rule(
                *key,
                len(ours.values),
                len(theirs.values),
                *(round(fmean(one.values), 4) if one.values else None for one in (ours, theirs)),
                *(round(min(one.margins), 4) if one.margins else None for one in (ours, theirs)),
            )
        )
    return tuple(found)


def _rule_tables(a: Recording, b: Recording) -> tuple[_RuleTable, _RuleTable]:
    """(plug-in and rule, score) -> what was decided by it, in either run."""
    tables: tuple[_RuleTable, _RuleTable] = {}, {}
    for texts in zip_longest(a.change_texts(), b.change_texts()):
        row: Json = {}
        for place, (recording, text) in enumerate(zip((a, b), texts, strict=True)):
            if text is None:
                continue
            with reading(recording.path, "the changes"):
                if place == 0 or text != texts[0]:  # most changes of two runs are the same
                    row = json_value(text)
                _add_scores(tables[place], row)
    return tables


def _add_scores(table: _RuleTable, row: Json) -> None:
    cause = row["cause"]
    for name, value, limit in row["scores"]:
        scores = table.setdefault((f"{cause['plugin']}: {cause['rule']}", name), _Scores())
        scores.values.append(value)
        if limit is not None:
            scores.margins.append(abs(value - limit))


def _queries(ours: Sequence[Json], theirs: Sequence[Json]) -> tuple[Query, ...]:
    """The last grounding of every sentence, in the order of asking."""
    by_query: list[dict[str, Json]] = [{row["query"]: row for row in rows} for rows in (ours, theirs)]
    found = []
    for query in dict.fromkeys([*by_query[0], *by_query[1]]):
        one, other = (side.get(query) for side in by_query)
        lists = [[] if row is None else row["candidates"] for row in (one, other)]
        tops = [tuple((c["viewpoint"], _score(c)) for c in candidates[:_TOP]) for candidates in lists]
        found.append(
            Query(
                query,
                one is not None and other is not None and one["target"] == other["target"],
                tops[0],
                tops[1],
                _rank(lists[0], lists[1]),
                _rank(lists[1], lists[0]),
                "a" if other is None else "b" if one is None else "",
            )
        )
    return tuple(found)


def _score(candidate: Json) -> float | None:
    scores = candidate["scores"]
    value = scores.get("score", next(iter(scores.values()), None))
    return None if value is None else round(float(value), 4)


def _rank(winner_of: Sequence[Json], among: Sequence[Json]) -> int | None:
    if not winner_of:
        return None
    winner = winner_of[0]["viewpoint"]
    return next((int(one["rank"]) for one in among if one["viewpoint"] == winner), None)


def _episodes(ours: Sequence[Json], theirs: Sequence[Json]) -> tuple[Episode, ...]:
    """Every episode of either run; one of another goal is another episode, whatever its number."""
    sides: list[dict[tuple[int, str], Json]] = [
        {(row["episode"], row["goal"]): row for row in rows} for rows in (ours, theirs)
    ]
    found = []
    for number, goal in sorted({**sides[0], **sides[1]}, key=lambda key: key[0]):
        one, other = (side.get((number, goal)) for side in sides)
        values = [{} if row is None else row["values"] for row in (one, other)]
        differing = {
            name: (values[0].get(name), values[1].get(name))
            for name in dict.fromkeys([*values[0], *values[1]])
            if values[0].get(name) != values[1].get(name)
        }
        found.append(Episode(number, goal, _outcome(one), _outcome(other), differing))
    return tuple(found)


def _outcome(row: Json | None) -> str:
    if row is None:
        return "not run"
    return f"{row['outcome']} ({row['reason']})" if row["reason"] else str(row["outcome"])


def _milliseconds(a: Recording, b: Recording) -> dict[str, tuple[float | None, float | None]]:
    """Wall milliseconds a frame, by stage; None where a run had no such stage."""
    means: list[dict[str, float]] = []
    for recording in (a, b):
        seconds: Counter[str] = Counter()
        for stages in recording.timings().values():
            seconds.update(stages)
        frames = max(1, len(recording.frame_indices))
        means.append({stage: round(1000.0 * value / frames, 3) for stage, value in seconds.items()})
    return {
        stage: (means[0].get(stage), means[1].get(stage)) for stage in dict.fromkeys([*means[0], *means[1]])
    }
