"""What vanished and what arrived, and which of them are one thing that moved (paper III-A; ALGORITHM B)."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from dssmsg.graph.ids import id_order
from dssmsg.graph.movement import MoveScore, move_score, pair_moves
from dssmsg.graph.nodes import BELIEVED, DISAPPEARED, ObjectNode
from dssmsg.graph.view import GraphView


@dataclass(frozen=True, slots=True)
class PairingRule:
    """delta_move, delta_sem of eq. 1-2; `unseen_margin` is added where the new place was never seen."""

    delta_move: float
    delta_sem: float
    unseen_margin: float
    paper_exact: bool = False


@dataclass(frozen=True, slots=True)
class Gone:
    """What an object was before it vanished, and the last frame that may have shown it in its place."""

    state: str
    last_frame: int


@dataclass(frozen=True, slots=True)
class Pair:
    """`old` was found again as `new`; `needed` is what s_move was held against."""

    old: ObjectNode
    new: ObjectNode
    score: MoveScore
    needed: float


class Pairing:
    """The two open lists, and the pairs that they give."""

    def __init__(self, graph: GraphView, rule: PairingRule) -> None:
        self._graph = graph
        self._rule = rule
        self._vanished: dict[str, Gone] = {}
        self._arrived: dict[str, bool] = {}
        self._not_it: set[tuple[str, str]] = set()

    def vanish(self, node: ObjectNode, last_frame: int) -> None:
        """An object was found gone; `last_frame` is the last that may have shown it in its place."""
        self._vanished[node.id] = Gone(node.state, last_frame)
        self._arrived.pop(node.id, None)

    def arrive(self, object_id: str, *, free_before: bool) -> None:
        """A new object, that may be a thing which vanished; `free_before`: its place was shown free."""
        self._arrived[object_id] = free_before

    def is_open(self, object_id: str) -> bool:
        """Whether an object has arrived, and nobody knows where from."""
        return object_id in self._arrived

    def tell_apart(self, old_id: str, new_id: str) -> None:
        """Colours say that these two are not one thing."""
        self._not_it.add((old_id, new_id))

    def close(self, pair: Pair) -> Gone:
        """The two are one; returns what the old one was."""
        self._arrived.pop(pair.new.id, None)
        return self._vanished.pop(pair.old.id)

    def drop(self, object_id: str) -> None:
        """An object left the graph for good."""
        self._vanished.pop(object_id, None)
        self._arrived.pop(object_id, None)

    def clear(self) -> None:
        """Begin anew."""
        self._vanished.clear()
        self._arrived.clear()
        self._not_it.clear()

    def gone(self) -> Iterator[ObjectNode]:
        """What vanished and was not found again."""
        for object_id in self._vanished:
            node = self._graph.objects.get(object_id)
            if node is not None and node.state == DISAPPEARED:
                yield node

    def pairs(self, seen_this_visit: Collection[str], *, at_end: bool) -> list[Pair]:
        """Pairs one-to-one by eq. 1-2, the best in sum.

        A thing cannot arrive before it was last seen in its old place. In mid-visit pairs have no rival:
        neither end fits another, and every other believed object of the kind has been seen in its place in
        this visit. The rest is decided at the end.
        """
        news = [node for node in map(self._graph.objects.get, self._arrived) if node is not None]
        news = [node for node in news if node.status == BELIEVED and node.state != DISAPPEARED]
        fitting: dict[tuple[str, str], Pair] = {}
        for old in self.gone() if news else ():
            for new in news:
                if (old.id, new.id) in self._not_it or new.frames[0] <= self._vanished[old.id].last_frame:
                    continue
                score = move_score(old, new, self._rule.delta_sem, paper_exact=self._rule.paper_exact)
                needed = self._rule.delta_move
                needed += 0.0 if self._arrived[new.id] else self._rule.unseen_margin
                if score.s_move >= needed:
                    fitting[old.id, new.id] = Pair(old, new, score, needed)
        order = sorted({i for ends in fitting for i in ends}, key=id_order)
        chosen = pair_moves({ends: pair.score for ends, pair in fitting.items()}, 0.0, order)
        return [
            fitting[ends]
            for ends in chosen
            if at_end or not (_has_rival(ends, fitting) or self._may_be_another(ends[0], seen_this_visit))
        ]

    def _may_be_another(self, old_id: str, seen_this_visit: Collection[str]) -> bool:
        """Whether a thing of the same kind, not seen in this visit yet, may be what was found instead."""
        label = self._graph.objects[old_id].label
        return any(
            node.label == label
            and node.id != old_id
            and node.status == BELIEVED
            and node.state != DISAPPEARED
            and node.id not in seen_this_visit
            for node in self._graph.objects.values()
        )


def _has_rival(ends: tuple[str, str], fitting: Mapping[tuple[str, str], Pair]) -> bool:
    return any((old == ends[0]) != (new == ends[1]) for old, new in fitting)
