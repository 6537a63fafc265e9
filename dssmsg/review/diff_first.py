"""Where two runs part: the first thing that came out differently, and which layer made it so.

Everything is compared in the order of causes. Within a frame: what the source gave, which frames the mission
chose, what perception saw, what a language model answered to the same question, which plug-in failed, each
change of the graph in the order of application, windows, matches, the driver, episodes. All that stands
before the first difference is equal, so its maker got the same input in both runs.

A *trace* is a difference without consequence: a score or a threshold that moved while the decision stayed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

import numpy as np

from dssmsg.errors import InputError
from dssmsg.frame import FloatArray
from dssmsg.recording import schema
from dssmsg.recording.damage import json_object
from dssmsg.recording.describe import change_line
from dssmsg.recording.reader import Recording

Json = dict[str, Any]

IMAGES_BEFORE = 50
"""So many frames before the first difference have their images compared too: depth acts through the floor
plan, which remembers."""
_NEVER = 2**62


@dataclass(frozen=True, slots=True)
class Term:
    """A score that both sides of a divergence have, with the threshold that it was held against, if any."""

    name: str
    a: float | None
    b: float | None
    threshold_a: float | None
    threshold_b: float | None


@dataclass(frozen=True, slots=True)
class Divergence:
    """The first difference: in which frame, of which layer and plug-in, and both sides of it in words.

    `fields` names what differs; `scores` are the terms of the two decisions; `consequence` is False for a
    trace.
    """

    frame: int
    layer: str
    plugin: str
    what: str
    a: str = ""
    b: str = ""
    fields: tuple[str, ...] = ()
    scores: tuple[Term, ...] = ()
    consequence: bool = True


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
    found.offer(0, _source(a, b))
    found.offer(1, _key_frames(a, b))
    found.offer(3, _answers(a, b))
    found.offer(4, _failures(a, b))
    change, trace = _changes(a, b)
    found.offer(5, change)
    update, grounding = _plugin(a, "update"), _plugin(a, "grounding")
    found.offer(6, _rows(a, b, schema.WINDOWS, "update", update, "a window", "viewpoint"))
    found.offer(7, _rows(a, b, schema.MATCHES, "grounding", grounding, "a match", "query"))
    found.offer(8, _driver(a, b))
    found.offer(9, _rows(a, b, schema.EPISODES, "mission", "mission", "an episode", "goal"))
    # Perception is dear to compare, so only as far as anything else is equal.
    found.offer(2, _detections(a, b, found.rank[0]))
    if found.best is not None:
        found.offer(0, _images(a, b, found.rank[0]))
    traces = [one for one in (trace,) if one is not None and one.frame <= found.rank[0]]
    return found.best, tuple(traces)


# What the source gave, and what the mission made of it.


def _parted(
    frame: int,
    layer: str,
    plugin: str,
    what: str,
    sides: Iterable[str] = ("", ""),
    fields: Sequence[str] = (),
    scores: Sequence[Term] = (),
    consequence: bool = True,
) -> Divergence:
    ours, theirs = sides
    return Divergence(frame, layer, plugin, what, ours, theirs, tuple(fields), tuple(scores), consequence)


def _source(a: Recording, b: Recording) -> Divergence | None:
    """The first frame that is missing in one, was taken elsewhere or came about by another command."""
    for index in sorted({*a.frame_indices, *b.frame_indices}):
        if index not in a.frame_facts or index not in b.frame_facts:
            lacks = "A" if index not in a.frame_facts else "B"
            return _parted(index, "source", "source", f"{lacks} has no frame {index}", fields=("frame",))
        ours, theirs = a.frame_facts[index], b.frame_facts[index]
        poses = list(zip(a.poses(index), b.poses(index), strict=True))
        if not all(np.array_equal(one, other) for one, other in poses):
            return _pose(a, b, index, poses[0])
        for name in ("visit", "at_stop", "collisions"):
            values = getattr(ours, name), getattr(theirs, name)
            if values[0] != values[1]:
                return _parted(index, "source", "source", f"{name} differs", map(str, values), fields=(name,))
    return None


def _pose(a: Recording, b: Recording, index: int, poses: tuple[FloatArray, FloatArray]) -> Divergence:
    commands = a.command(index), b.command(index)
    driver = "mission" if commands[0] != commands[1] else "source"
    moved = float(np.linalg.norm(poses[0][:3, 3] - poses[1][:3, 3]))
    turn = float(np.clip((np.trace(poses[0][:3, :3].T @ poses[1][:3, :3]) - 1) / 2, -1.0, 1.0))
    what = f"the camera stands {moved:.4f} m and {np.degrees(np.arccos(turn)):.3f} degrees apart"
    if driver == "mission":
        return _parted(
            index, driver, driver, what, (f"command {one}" for one in commands), fields=("command", "pose")
        )
    return _parted(
        index, driver, _plugin(a, "source"), what, (_spot(pose) for pose in poses), fields=("pose",)
    )


def _spot(pose: FloatArray) -> str:
    return "at (" + ", ".join(f"{value:.4f}" for value in pose[:3, 3]) + ") m"


def _images(a: Recording, b: Recording, until: int) -> Divergence | None:
    """The first frame shortly before `until` whose images differ, where both store them alike."""
    if a.facts.get("images") != b.facts.get("images"):
        return None
    both = [i for i in a.frame_indices if until - IMAGES_BEFORE <= i <= until and i in b.frame_facts]
    for index in both:
        ours, theirs = a.encoded_images(index), b.encoded_images(index)
        if ours is None or theirs is None or ours == theirs:
            continue
        names = tuple(
            name for name, one, other in zip(("colours", "depth"), ours, theirs, strict=True) if one != other
        )
        what = f"the images differ: {' and '.join(names)}"
        return _parted(index, "source", _plugin(a, "source"), what, fields=names)
    return None


def _key_frames(a: Recording, b: Recording) -> Divergence | None:
    for index in a.frame_indices:
        if index not in b.frame_facts:
            return None
        ours, theirs = a.frame_facts[index], b.frame_facts[index]
        if ours.key_frame != theirs.key_frame:
            words = [f"{'a' if one.key_frame else 'no'} key frame" for one in (ours, theirs)]
            return _parted(
                index, "mission", "mission", "another choice of key frames", words, fields=("key_frame",)
            )
    return None


# Perception and the language model.


def _detections(a: Recording, b: Recording, until: int) -> Divergence | None:
    plugin = _plugin(a, "perception")
    for index in a.key_frames:
        if index > until or index not in b.frame_facts:
            return None
        ours, theirs = a.detection_cells(index), b.detection_cells(index)
        if ours == theirs:
            continue
        if ours is None or theirs is None:
            sides = ["no detections were told" if one is None else _listed(one) for one in (ours, theirs)]
            return _parted(
                index, "perception", plugin, "perception failed in one run", sides, fields=("detections",)
            )
        names = tuple(name for name in ours if name != "observations" and ours[name] != theirs[name])
        if names:
            return _parted(
                index,
                "perception",
                plugin,
                _seen(ours, theirs, names),
                (_listed(ours), _listed(theirs)),
                names,
            )
        return _parted(
            index, "lift", "lift", "the same detections were lifted differently", fields=("observations",)
        )
    return None


def _seen(ours: Mapping[str, Any], theirs: Mapping[str, Any], names: Sequence[str]) -> str:
    """What is other about the detections of a frame, in words."""
    labels = list(ours["labels"]), list(theirs["labels"])
    if len(labels[0]) != len(labels[1]):
        more, fewer = (labels[0], labels[1]) if len(labels[0]) > len(labels[1]) else (labels[1], labels[0])
        extra = list(more)
        for label in fewer:
            if label in extra:
                extra.remove(label)
        alone = "A" if more is labels[0] else "B"
        return (
            f"{len(labels[0])} detections in A, {len(labels[1])} in B; only {alone} saw: {', '.join(extra)}"
        )
    changed = [
        f"detection {place}: {one} -> {other}"
        for place, (one, other) in enumerate(zip(*labels, strict=True))
        if one != other
    ]
    return "; ".join(changed) if changed else f"the same labels, other {', '.join(names)}"


def _listed(cells: Mapping[str, Any]) -> str:
    found = [f"{label} {score:.2f}" for label, score in zip(cells["labels"], cells["scores"], strict=False)]
    return ", ".join(found) or "nothing"


def _answers(a: Recording, b: Recording) -> Divergence | None:
    """The first question that both asked and that was answered otherwise; another question is a follow-up."""
    for ours, theirs in zip(_ends(a.llm_calls()), _ends(b.llm_calls()), strict=False):
        if ours["request_hash"] != theirs["request_hash"]:
            return None
        if ours["ok"] != theirs["ok"] or (ours["ok"] and not _same_json(ours["answer"], theirs["answer"])):
            said = [one["answer"] if one["ok"] else f"failed: {one['error']}" for one in (ours, theirs)]
            return _parted(
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
        return _parted(
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
    for ours, theirs in zip_longest(a.change_rows(), b.change_rows()):
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
    return _parted(frame, _layer(plugin), plugin, what, lines, fields, _terms(here[0], here[1]), consequence)


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
        return _parted(max(0, int(first["frame"])), layer, plugin, what, sides, fields=fields)
    return None


def _read(recording: Recording, table: schema.Table, text: str) -> Json:
    try:
        return json_object(text)
    except ValueError as error:
        raise InputError(f"a row of {table.path} is damaged ({error})", file=recording.path) from error


def _driver(a: Recording, b: Recording) -> Divergence | None:
    seeks = [phase["frame"] for phase in a.phases() if phase["phase"] == "seek"]
    found = _rows(a, b, schema.NAVIGATION, "navigation", "", "the driver", "state")
    if found is None:
        return None
    driven = bool(seeks) and found.frame >= min(seeks) - 1
    plugin = _plugin(a, "navigation") if driven else "mission"
    return _parted(
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


def _plugin(recording: Recording, kind: str) -> str:
    made: Callable[[str], Any] = recording.facts.get("plugins", {}).get
    return f"{kind}/{(made(kind) or {}).get('name', '?')}"
