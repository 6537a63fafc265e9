"""What a map says of its objects: snapshots of a live graph, and the states that they come to.

Methods that keep states in the graph (`update: dssm`) are taken at their word. The others (ConceptGraphs,
DovSG, no update at all) have none; theirs follow from which objects are believed at the end of the survey and
later: there only later is appeared, there only at the end of the survey is disappeared (at its place then),
everything else is static; a move is never claimed, because nothing in them says so. An object that took
another one in carries on that one's life.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from dssmsg.evaluate.dynamic import Box, Claim
from dssmsg.events import Event, GraphChanged, PhaseStarted
from dssmsg.graph.changes import Change, ObjectRemoved, ObjectsJoined
from dssmsg.graph.nodes import APPEARED, BELIEVED, DISAPPEARED, MOVED, STATIC
from dssmsg.graph.scene_graph import SceneGraph

States = Literal["graph", "derived"]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A believed object in a snapshot; `first_place` is the earliest of its former places."""

    label: str
    state: str
    box: Box
    first_place: Box | None


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """The believed objects of a graph after a frame, by id; `heirs`: which id one that left went into."""

    frame: int
    objects: Mapping[str, Seen]
    heirs: Mapping[str, str]

    @property
    def gist(self) -> tuple[tuple[str, str, bool], ...]:
        """What a valid update changes: which objects there are, their states, whether they moved."""
        return tuple(
            (name, seen.state, seen.first_place is not None) for name, seen in sorted(self.objects.items())
        )


class GraphWatch:
    """An observer that takes snapshots: at the end of the survey, and at each valid update after it.

    A valid update is a frame after which other objects are believed than before it, or with other states.
    """

    def __init__(self) -> None:
        self.graph = SceneGraph()
        """The live graph, to be set before the run begins."""
        self.survey: Snapshot | None = None
        self.updates: list[Snapshot] = []
        self.visit_ends: list[int] = []
        """How many updates there were when each visit after the survey ended, but for the last."""
        self._heirs: dict[str, str] = {}
        self._visit = 0

    def on_event(self, event: Event) -> None:
        """Called by the mission."""
        if isinstance(event, PhaseStarted) and event.visit != self._visit:
            if self._visit == 0:
                self.survey = self._snapshot(event.frame - 1)
            else:
                self.visit_ends.append(len(self.updates))
            self._visit = event.visit
        elif isinstance(event, GraphChanged):
            self._heirs |= dict(_heirs(event.changes))
            if self.survey is not None:
                now = self._snapshot(event.frame)
                last = self.updates[-1] if self.updates else self.survey
                if now.gist != last.gist:
                    self.updates.append(now)
                elif self.updates:
                    self.updates[-1] = now  # the same update, with boxes as they have become

    def close(self) -> None:
        """Nothing to release."""

    def outputs(self) -> dict[str, str]:
        """Leaves no file."""
        return {}

    def _snapshot(self, frame: int) -> Snapshot:
        objects = {}
        for node in self.graph.objects.values():
            if node.status != BELIEVED:
                continue
            first = next(self.graph.history_of(node.id), None)
            place = None if first is None else (first.box_min, first.box_max)
            objects[node.id] = Seen(node.label, node.state, (node.box_min, node.box_max), place)
        return Snapshot(frame, objects, dict(self._heirs))


def claims_of(now: Snapshot, survey: Snapshot, states: States) -> list[Claim]:
    """The claims of a graph, with the states of its nodes or those derived from the survey's snapshot."""
    if states == "graph":
        return [_own_claim(name, seen, survey) for name, seen in now.objects.items()]
    known = {_heir(name, now.heirs) for name in survey.objects}
    claims = [
        Claim(name, seen.label, STATIC if name in known else APPEARED, seen.box)
        for name, seen in now.objects.items()
    ]
    for name, seen in survey.objects.items():
        if _heir(name, now.heirs) not in now.objects:
            claims.append(Claim(name, seen.label, DISAPPEARED, seen.box))
    return claims


def survey_claims(survey: Snapshot) -> list[Claim]:
    """The claims of the survey's graph: everything is as it was found."""
    return [Claim(name, seen.label, STATIC, seen.box) for name, seen in survey.objects.items()]


def _own_claim(name: str, seen: Seen, survey: Snapshot) -> Claim:
    former = None
    if seen.state == MOVED:
        before = survey.objects.get(name)
        former = seen.first_place if before is None else before.box
    return Claim(name, seen.label, seen.state, seen.box, former)


def _heir(name: str, heirs: Mapping[str, str]) -> str:
    seen = {name}
    while name in heirs and heirs[name] not in seen:
        name = heirs[name]
        seen.add(name)
    return name


def _heirs(changes: Sequence[Change]) -> Iterator[tuple[str, str]]:
    for change in changes:
        if isinstance(change, ObjectsJoined):
            yield change.absorbed_id, change.object_id
        elif isinstance(change, ObjectRemoved) and change.successor_id is not None:
            yield change.object_id, change.successor_id
