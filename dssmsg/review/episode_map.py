"""How the map came to be, object by object, from the rows of the changes alone: no arrays are decoded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dssmsg.graph.nodes import BELIEVED, DISAPPEARED, PATH, SEES, STATIC, TENTATIVE

Json = Mapping[str, Any]
Pair = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Sighting:
    """A detection that became part of an object: where it stood in its frame, and how sure that was."""

    frame: int
    detection: int
    label: str
    terms: Sequence[Sequence[Any]]
    """As recorded: name, value and what it was held against (None: nothing)."""
    box: Sequence[float]
    """Of the object afterwards: lowest x, y, z, highest x, y, z, metres."""
    rule: str

    @property
    def scores(self) -> Mapping[str, tuple[float, float | None]]:
        """The terms by name."""
        return _scores(self.terms)


@dataclass(frozen=True, slots=True)
class Fact:
    """A fact of an object or an edge from a frame on."""

    frame: int
    name: str
    value: Any
    cause: str
    scores: Mapping[str, tuple[float, float | None]] = field(default_factory=dict)


@dataclass(slots=True)
class ObjectHistory:
    """One object's life in the map. `gone`: when it left, `successor` what it went on as, if anything."""

    id: str
    added: int
    sightings: list[Sighting] = field(default_factory=list)
    facts: list[Fact] = field(default_factory=list)
    absorbed: list[tuple[int, str]] = field(default_factory=list)
    box: Sequence[float] = ()
    gone: int | None = None
    successor: str | None = None

    def votes(self, frame: int | None = None) -> Counter[str]:
        """How often each label was seen, until a frame."""
        return Counter(s.label for s in self.sightings if frame is None or s.frame <= frame)

    def label(self, frame: int | None = None) -> str:
        """The label that was seen most often, the earlier one of equals."""
        told = self.value("label", frame)
        votes = self.votes(frame)
        return str(told) if told else max(votes, key=lambda name: votes[name], default="")

    def value(self, name: str, frame: int | None = None) -> Any:
        """The newest value of a fact, until a frame; None where nothing was said."""
        known = [f.value for f in self.facts if f.name == name and (frame is None or f.frame <= frame)]
        return known[-1] if known else None

    def is_there(self, frame: int) -> bool:
        """Whether it was in the map at a frame, believed, and not called gone."""
        return (
            self.added <= frame
            and (self.gone is None or frame < self.gone)
            and (self.value("status", frame) or TENTATIVE) == BELIEVED
            and (self.value("state", frame) or STATIC) != DISAPPEARED
        )

    @property
    def center(self) -> tuple[float, ...]:
        """The centre of its last box, metres."""
        return tuple((a + b) / 2 for a, b in zip(self.box[:3], self.box[3:], strict=True))


@dataclass(slots=True)
class MapHistory:
    """All objects that ever were, the waypoints, and when which way counted as blocked."""

    objects: dict[str, ObjectHistory] = field(default_factory=dict)
    viewpoints: dict[str, str] = field(default_factory=dict)
    """Viewpoint -> its waypoint."""
    poses: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Viewpoint -> where it stands on the floor, metres."""
    places: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Waypoint -> where it lies on the floor, metres."""
    ways: dict[Pair, list[Fact]] = field(default_factory=dict)
    """Path edge -> blocked or not, from which frame on."""
    sees: dict[Pair, list[Fact]] = field(default_factory=dict)
    """(viewpoint, object) -> linked or not, from which frame on."""

    @classmethod
    def of(cls, rows: Iterable[Json]) -> MapHistory:
        """Read the rows of `Recording.change_rows`, in order."""
        history = cls()
        for row in rows:
            history._take(row)
        return history

    def named(self, labels: Iterable[str]) -> Iterator[ObjectHistory]:
        """The objects with one of the labels, in order of first sight; absorbed ones too."""
        wanted = set(labels)
        return (thing for thing in self.objects.values() if thing.label() in wanted)

    def last(self, object_id: str) -> ObjectHistory | None:
        """The object that an id ended up as."""
        seen: set[str] = set()
        while (
            (thing := self.objects.get(object_id)) is not None and thing.successor and object_id not in seen
        ):
            seen.add(object_id)
            object_id = thing.successor
        return thing

    def seen_from(self, object_id: str, frame: int) -> list[str]:
        """Viewpoints that were linked at a frame to an object, or to one that it had absorbed; sorted."""
        ids, left = {object_id}, [object_id]
        while left:
            known = self.objects.get(left.pop())
            fresh = {one for at, one in known.absorbed if at <= frame} - ids if known else set()
            ids |= fresh
            left += fresh
        return sorted(
            viewpoint
            for (viewpoint, thing), facts in self.sees.items()
            if thing in ids
            and (known_facts := [f for f in facts if f.frame <= frame])
            and known_facts[-1].value
        )

    def open_ways(self, frame: int) -> Iterator[Pair]:
        """Path edges that counted as free at a frame."""
        for ends, facts in self.ways.items():
            known = [fact for fact in facts if fact.frame <= frame]
            if known and known[-1].value is False:
                yield ends

    def connected(self, start: str, end: str, frame: int) -> bool:
        """Whether free path edges led from one waypoint to another at a frame."""
        links: dict[str, set[str]] = {}
        for a, b in self.open_ways(frame):
            links.setdefault(a, set()).add(b)
            links.setdefault(b, set()).add(a)
        reached, left = {start}, [start]
        while left:
            fresh = links.get(left.pop(), set()) - reached
            reached |= fresh
            left += fresh
        return end in reached

    def _take(self, row: Json) -> None:
        match row["kind"]:
            case "object_added" | "object_merged":
                self._sight(row)
            case "object_changed":
                thing = self.objects.get(row["object_id"])
                if thing is not None:
                    for name, value in row["values"].items():
                        thing.facts.append(_fact(row, name, value))
            case "object_replaced":
                thing = self.objects.get(row["object_id"])
                if thing is not None:
                    thing.facts.append(_fact(row, "place", row["after"].get("box")))
                    thing.box = row["after"].get("box", thing.box)
            case "objects_joined":
                self._join(row)
            case "object_removed":
                thing = self.objects.get(row["object_id"])
                if thing is not None:
                    thing.gone, thing.successor = row["frame"], row.get("successor_id")
            case "waypoint_added":
                self.places[row["waypoint_id"]] = (row["position"][0], row["position"][1])
            case "viewpoint_added":
                self.viewpoints[row["viewpoint_id"]] = row["waypoint_id"]
                pose = row["world_from_camera"]
                self.poses[row["viewpoint_id"]] = (pose[0][3], pose[1][3])
            case "edge_added" | "edge_changed" | "edge_removed":
                self._link(row)
            case _:
                pass

    def _sight(self, row: Json) -> None:
        thing = self.objects.setdefault(row["object_id"], ObjectHistory(row["object_id"], row["frame"]))
        thing.box = row["after"].get("box", thing.box)
        if row["kind"] == "object_added":
            thing.facts.append(_fact(row, "status", row["after"].get("status", TENTATIVE)))
        thing.sightings.append(
            Sighting(
                row["frame"], row["detection"], row["label"], row["scores"], thing.box, row["cause"]["rule"]
            )
        )

    def _join(self, row: Json) -> None:
        kept, gone = self.objects.get(row["object_id"]), self.objects.get(row["absorbed_id"])
        if kept is None or gone is None:
            return
        gone.gone, gone.successor = row["frame"], kept.id
        kept.absorbed.append((row["frame"], gone.id))
        kept.sightings = sorted([*kept.sightings, *gone.sightings], key=lambda s: s.frame)
        kept.box = row["after"].get("box", kept.box)
        for name in ("status", "state"):
            if name in row["after"]:
                kept.facts.append(_fact(row, name, row["after"][name]))

    def _link(self, row: Json) -> None:
        ends = (row["source"], row["target"])
        if row["edge"] == SEES:
            if row["kind"] != "edge_changed":
                added = row["kind"] == "edge_added"
                self.sees.setdefault(ends, []).append(_fact(row, "sees", added))
        elif row["edge"] == PATH:
            removed = row["kind"] == "edge_removed"
            blocked = None if removed else row["attributes"].get("blocked", None)
            if blocked is None and not removed:
                if row["kind"] == "edge_changed":
                    return
                blocked = False
            value = None if removed else bool(blocked)
            self.ways.setdefault(ends, []).append(_fact(row, "blocked", value))


def _fact(row: Json, name: str, value: Any) -> Fact:
    cause = f"{row['cause']['plugin']}: {row['cause']['rule']}"
    return Fact(row["frame"], name, value, cause, _scores(row["scores"]))


def _scores(terms: Iterable[Sequence[Any]]) -> dict[str, tuple[float, float | None]]:
    return {name: (value, threshold) for name, value, threshold in terms}
