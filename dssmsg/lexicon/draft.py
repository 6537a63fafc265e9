"""A target graph in the making: things and relations that are added, named and dropped, then JSON."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from dssmsg.lexicon.reading import MAX_ATTRIBUTES, Reading, Thing, is_denied

MAX_NODES = 20
MAX_EDGES = 60


class Draft:
    """A target graph in the making; thing 0 is its core."""

    def __init__(self, kind: str, reading: Reading, elsewhere: Collection[str] = ()) -> None:
        """`elsewhere`: labels that are no company for the core, as they lead to where it is not."""
        self.kind = kind
        self.things = [Thing(t.label, list(t.attributes), t.known) for t in reading.things]
        self.relations = list(reading.relations)
        self._avoided = set(reading.avoided)
        self._elsewhere = frozenset(elsewhere)

    @property
    def unwanted(self) -> set[str]:
        """Labels that are not meant or shall not be at the core."""
        return self._avoided | {
            self.things[b].label for a, b, word in self.relations if a == 0 and is_denied(word)
        }

    def add(self, label: str, relation: str, *, again: bool = False) -> None:
        """A companion of the core, unless it is there or shall not be; `relation` is its own to the core."""
        there = not again and any(thing.label == label for thing in self.things)
        if there or label in self.unwanted | self._elsewhere or len(self.things) >= MAX_NODES:
            return
        self.things.append(Thing(label))
        new = len(self.things) - 1
        self.relations.append((0, new, "near") if relation == "near" else (new, 0, relation))

    def name_core(self, thing: Thing) -> None:
        """The open core is this thing; where it stands among the others, the two become one."""
        self.things[0] = Thing(thing.label, thing.attributes or [])
        for place in range(len(self.things) - 1, 0, -1):
            if self.things[place].label == thing.label:
                self._remove(place, 0)

    def drop_core(self, heir: int) -> None:
        """The open core goes, the thing at `heir` takes its place; of a place between two things the two are
        near each other."""
        self.relations = [
            (a, b, "near") if 0 in (a, b) and not is_denied(word) else (a, b, word)
            for a, b, word in self.relations
        ]
        self.things[0] = self.things[heir]
        self._remove(heir, 0)

    def avoid(self, label: str, relations: Collection[str]) -> None:
        """What such a relation of the core leads to is what the core shall not be, rather than where."""
        if any(
            a == 0 and self.things[b].label == label and word in relations for a, b, word in self.relations
        ):
            self._avoided.add(label)
            self.drop_denied(label)

    def drop_denied(self, label: str) -> None:
        """What is sought is not there to be avoided: things of this label that a relation denies go."""
        for a, b, word in list(self.relations):
            if is_denied(word) and self.things[b].label == label:
                self.relations.remove((a, b, word))
                self._remove(b, a)
                return

    def _remove(self, gone: int, heir: int) -> None:
        """Takes a thing out; its relations pass on to another (an index after the removal)."""
        del self.things[gone]

        def moved(index: int) -> int:
            return heir if index == gone else index - (index > gone)

        relations = [(moved(a), moved(b), word) for a, b, word in self.relations]
        self.relations = [(a, b, word) for a, b, word in dict.fromkeys(relations) if a != b]

    def json(self) -> dict[str, Any]:
        """The target graph as JSON values."""
        edges: dict[tuple[int, int], str] = {}
        for source, target, word in self.relations:
            if (target, source) not in edges:
                edges.setdefault((source, target), word)
        return {
            "kind": self.kind,
            "nodes": [
                {"label": t.label, "attributes": list(dict.fromkeys(t.attributes))[:MAX_ATTRIBUTES]}
                for t in self.things
            ],
            "edges": [{"source": a, "target": b, "relation": word} for (a, b), word in edges.items()][
                :MAX_EDGES
            ],
            "core": 0,
        }
