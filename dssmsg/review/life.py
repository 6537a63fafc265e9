"""The life of an object, from a recording: what happened to it, in order, with the scores that decided."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dssmsg.errors import InputError
from dssmsg.events import WindowEvaluated
from dssmsg.graph.changes import (
    Change,
    EdgeAdded,
    EdgeChanged,
    EdgeRemoved,
    ObjectAdded,
    ObjectChanged,
    ObjectMerged,
    ObjectRemoved,
    ObjectReplaced,
    ObjectsJoined,
)
from dssmsg.recording.reader import Recording


@dataclass(frozen=True, slots=True)
class LifeEvent:
    """Something that happened to an object. `frames`: one, or the first and the last of several alike."""

    frames: tuple[int, ...]
    sim_time: float
    what: str
    scores: Mapping[str, tuple[float, float | None]] = field(default_factory=dict)
    """Name -> value and the threshold that it was held against, if any."""


@dataclass(frozen=True, slots=True)
class Life:
    """An object's life: its ids in order (a retired one goes on as its successor), events, its end."""

    object_id: str
    ids: tuple[str, ...]
    events: tuple[LifeEvent, ...]
    end: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "object": self.object_id,
            "ids": list(self.ids),
            "end": dict(self.end),
            "events": [
                {
                    "frames": list(event.frames),
                    "sim_time": round(event.sim_time, 3),
                    "what": event.what,
                    "scores": {
                        name: {"value": value, "threshold": threshold}
                        for name, (value, threshold) in event.scores.items()
                    },
                }
                for event in self.events
            ],
        }


_FOREVER = 2**62
_IDENTITY_KINDS = (ObjectAdded.kind, ObjectsJoined.kind, ObjectRemoved.kind)


def life_of(recording: Recording, object_id: str) -> Life:
    """The life of an object, which a former place of it (`history-2`) names too.

    Raises InputError, naming some that there are, where it never was.
    """
    graph = recording.graph_at()
    if object_id in graph.history:
        object_id = graph.history[object_id].object_id
    identities = list(recording.changes(kinds=_IDENTITY_KINDS))
    known = [c.object_id for c in identities if isinstance(c, ObjectAdded)]
    if object_id not in known:
        some = f"{known[0]} to {known[-1]}" if known else "none at all"
        raise InputError(f"there is no object '{object_id}' in the recording; it has {some}", key="--object")
    until = _ids(identities, object_id)
    ids = tuple(until)
    events = sorted(
        [
            *_told(list(recording.changes(about=ids)), ids),
            *_windows(recording.told.windows_about(ids), until),
        ],
        key=lambda event: (event.frames[0], event.frames[-1]),
    )
    last = next((i for i in reversed(ids) if i in graph.objects), None)
    end: dict[str, Any] = {"in_graph": last is not None}
    if last is not None:
        node = graph.objects[last]
        end |= {
            "id": last,
            "label": node.label,
            "status": node.status,
            "state": node.state,
            "dynamic_attribute": node.dynamic_attribute,
            "votes": {label: round(score, 3) for label, score in node.votes.items()},
            "observations": node.observations,
            "viewpoints": list(node.viewpoints),
            "center": [round(float(c), 3) for c in node.center],
            "former_places": [
                {
                    "id": place.id,
                    "center": [round(float(c), 3) for c in (place.box_min + place.box_max) / 2],
                    "from_time": place.from_time,
                    "to_time": place.to_time,
                    "from_frame": recording.frame_at_time(place.from_time),
                    "to_frame": recording.frame_at_time(place.to_time),
                }
                for place in graph.history_of(last)
            ],
        }
    return Life(object_id, ids, tuple(events), end)


def life_text(life: Life) -> str:
    """The life as lines for a reader."""
    end = life.end
    lines = []
    if end["in_graph"]:
        votes = ", ".join(
            f"{label} {score:.1f}" for label, score in sorted(end["votes"].items(), key=lambda v: -v[1])[:5]
        )
        center = ", ".join(f"{c:.2f}" for c in end["center"])
        d_a = "unknown" if end["dynamic_attribute"] is None else f"{end['dynamic_attribute']:.2f}"
        lines.append(f"{end['id']}: {end['label']}, {end['status']}, {end['state']}, at ({center}) m")
        lines.append(f"  votes {votes}; {end['observations']} observations; dynamic attribute {d_a}")
        for place in end["former_places"]:
            was = ", ".join(f"{c:.2f}" for c in place["center"])
            first = f"from frame {place['from_frame']} ({place['from_time']:.1f} s) on"
            then = f"found elsewhere in frame {place['to_frame']} ({place['to_time']:.1f} s)"
            lines.append(f"  was at ({was}) m {first}, {then} ({place['id']})")
    else:
        lines.append(f"{life.object_id}: not in the graph at the end")
    if len(life.ids) > 1:
        lines.append(f"  known as {', then '.join(life.ids)}")
    for event in life.events:
        frames = "-".join(str(frame) for frame in event.frames)
        scores = ", ".join(_score(name, *value) for name, value in event.scores.items())
        lines.append(f"frame {frames:>9}  {event.what}{f' ({scores})' if scores else ''}")
    return "\n".join(lines)


def _score(name: str, value: float, threshold: float | None) -> str:
    return f"{name} {value:.2f}" + ("" if threshold is None else f" against {threshold:g}")


def _ids(changes: Iterable[Change], object_id: str) -> dict[str, int]:
    """The id, and those that it went on as after it was absorbed or retired; each with its last frame."""
    until: dict[str, int] = {}
    current = object_id
    for change in changes:
        if isinstance(change, ObjectsJoined) and change.absorbed_id == current:
            until[current], current = change.frame, change.object_id
        elif isinstance(change, ObjectRemoved) and change.object_id == current and change.successor_id:
            until[current], current = change.frame, change.successor_id
    return {**until, current: _FOREVER}


def _told(changes: Sequence[Change], ids: Sequence[str]) -> Iterator[LifeEvent]:
    """The changes of the object as events; merges in a row and edges of a frame are told together."""
    merges: list[ObjectMerged] = []
    edges: Counter[tuple[int, float, str, str]] = Counter()
    place = 0
    for change in changes:
        current = ids[place]
        if isinstance(change, EdgeAdded | EdgeRemoved | EdgeChanged):
            if current in change.subjects and not isinstance(change, EdgeChanged):
                edges[change.frame, change.sim_time, change.kind, change.edge] += 1
            continue
        if current not in change.subjects:
            continue
        if isinstance(change, ObjectMerged):
            merges.append(change)
            continue
        yield from _merged(merges)
        merges = []
        yield LifeEvent((change.frame,), change.sim_time, _what(change, current), _scores(change))
        if place + 1 < len(ids) and ids[place + 1] in change.subjects and _ends(change, current):
            place += 1
    yield from _merged(merges)
    for (frame, sim_time, kind, edge), count in edges.items():
        word = "gained" if kind == EdgeAdded.kind else "lost"
        yield LifeEvent((frame,), sim_time, f"{word} {count} {edge} edge{'s' if count > 1 else ''}")


def _ends(change: Change, object_id: str) -> bool:
    if isinstance(change, ObjectsJoined):
        return change.absorbed_id == object_id
    return isinstance(change, ObjectRemoved) and change.object_id == object_id


def _merged(merges: Sequence[ObjectMerged]) -> Iterator[LifeEvent]:
    if not merges:
        return
    labels = Counter(merge.label for merge in merges)
    values = [score.value for merge in merges for score in merge.scores if score.name == "s"]
    threshold = next((s.threshold for s in merges[0].scores if s.name == "s"), None)
    named = ", ".join(f"{label} x {count}" for label, count in labels.most_common())
    frames = (merges[0].frame,) if len(merges) == 1 else (merges[0].frame, merges[-1].frame)
    scores = {"lowest s": (min(values), threshold)} if values else {}
    yield LifeEvent(frames, merges[0].sim_time, f"seen again as {named}", scores)


def _what(change: Change, object_id: str) -> str:
    rule = f"[{change.cause.plugin}: {change.cause.rule}]"
    if isinstance(change, ObjectAdded):
        where = f" from {change.viewpoint_id}" if change.viewpoint_id else ""
        return f"first seen as {change.label} with score {change.score:.2f}{where} {rule}"
    if isinstance(change, ObjectsJoined):
        if change.absorbed_id == object_id:
            return f"turned out to be {change.object_id} {rule}"
        return f"took over {change.absorbed_id} {rule}"
    if isinstance(change, ObjectReplaced):
        if change.history_id:
            return f"is at another place now; the former one is kept as {change.history_id} {rule}"
        return f"has another shape now: {len(change.points)} points {rule}"
    if isinstance(change, ObjectRemoved):
        return f"left the graph {rule}"
    if isinstance(change, ObjectChanged):
        facts = ", ".join(f"{name} {value}" for name, value in change.values.items())
        return f"{facts} {rule}"
    return f"{change.kind} {rule}"


def _scores(change: Change) -> dict[str, tuple[float, float | None]]:
    return {score.name: (score.value, score.threshold) for score in change.scores}


def _windows(windows: Iterable[WindowEvaluated], until: Mapping[str, int]) -> Iterator[LifeEvent]:
    """What the viewpoints' windows said: evidence in a row told together, verdicts by themselves.

    `until`: the ids in order with their last frames. In that frame the next one has taken over already.
    """
    row: list[tuple[int, float, str]] = []
    for window in windows:
        current = next(name for name, last in until.items() if window.frame < last)
        said = [
            (evidence.frame, window.sim_time, evidence.verdict)
            for evidence in window.evidence
            if evidence.object_id == current and evidence.frame == window.frame
        ]
        for item in said:
            if row and row[-1][2] != item[2]:
                yield _evidence(row)
                row = []
            row.append(item)
        for object_id, verdict in window.verdicts.items():
            if object_id == current:
                base = ", ".join(map(str, window.base))
                yield LifeEvent(
                    (window.frame,),
                    window.sim_time,
                    f"verdict of {window.viewpoint_id}: {verdict}"
                    f" (window: base frames {base}; {window.threshold} consistent frames are needed)",
                )
    if row:
        yield _evidence(row)


def _evidence(row: Sequence[tuple[int, float, str]]) -> LifeEvent:
    frames = (row[0][0],) if len(row) == 1 else (row[0][0], row[-1][0])
    word = row[0][2].replace("_", " ")
    return LifeEvent(
        frames, row[0][1], f"evidence: {word}{f' in {len(row)} key frames' if len(row) > 1 else ''}"
    )
