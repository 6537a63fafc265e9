"""The relations of a target graph as a tree that hangs from its core target, and what bears them out.

A sentence relates things in chains: the mug on the desk next to the window. From the core outwards every node
hangs from the one that it was related to first; an edge that closes a circle is not checked twice. The best
witnesses of a tree are found exactly, leaf by leaf: each candidate of a node is worth its own likeness times
how well the relation holds, and what the best ones below it are worth. Nodes that hang from the same one get
different things; a relation with "not" or "without" is worth what its best witness leaves of 1.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from dssmsg.frame import FloatArray

Holds = Callable[[str, int, int], float]
"""`holds(word, a, b)`: how well "a <word> b" is true of two things, 0..1."""


@dataclass(frozen=True, slots=True)
class Link:
    """`node` hangs from `parent`: "parent <word> node" if `outward`, else "node <word> parent".

    `weight`, 0..1: how much it counts; less than 1 for one that nobody named.
    """

    node: int
    parent: int
    word: str
    outward: bool
    negated: bool
    weight: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Witnessed:
    """How well the relations hold for one core, 0..1 on average, and the thing found for each node."""

    score: float
    witnesses: Mapping[int, int]


class TargetTree:
    """The links that hang from `core`; `edges` are (source, target, word) of nodes, with a weight each."""

    def __init__(
        self, edges: Sequence[tuple[int, int, str]], core: int, weights: Sequence[float] | None = None
    ) -> None:
        self.core = core
        self.links: list[Link] = []
        reached, queue = {core}, deque([core])
        while queue:
            parent = queue.popleft()
            for (source, target, word), weight in zip(edges, weights or [1.0] * len(edges), strict=True):
                for node, end, outward in ((target, source, True), (source, target, False)):
                    if end == parent and node not in reached:
                        reached.add(node)
                        queue.append(node)
                        plain, negated = _plain(word)
                        self.links.append(Link(node, parent, plain, outward, negated, weight))

    def unwanted(self) -> frozenset[int]:
        """Nodes that should not be there: at the end of a negated link, or hanging from one that is."""
        found: set[int] = set()
        for link in self.links:  # from the core outwards
            if link.negated or link.parent in found:
                found.add(link.node)
        return frozenset(found)

    def below(self, node: int) -> list[Link]:
        """The links that hang from a node."""
        return [link for link in self.links if link.parent == node]


class Witnesses:
    """Looks for what bears a tree out; what hangs from a thing is worked out once, whatever the core.

    likeness (T, N): how well each thing may stand for each node, 0 where it may not.
    """

    def __init__(self, tree: TargetTree, likeness: FloatArray, holds: Holds) -> None:
        self._tree = tree
        self._likeness = likeness
        self._holds = holds
        self._known: dict[tuple[int, int], tuple[float, dict[int, int]]] = {}

    def of(self, core: int) -> Witnessed:
        """The best witnesses where the thing `core` is the core target."""
        worth, found = self._below(self._tree.core, core)
        return Witnessed(worth / max(1, len(self._tree.links)), found)

    def _below(self, node: int, thing: int) -> tuple[float, dict[int, int]]:
        """The worth of all that hangs from a node which is `thing`, and the witnesses."""
        if (node, thing) not in self._known:
            self._known[node, thing] = self._weigh(node, thing)
        return self._known[node, thing]

    def _weigh(self, node: int, thing: int) -> tuple[float, dict[int, int]]:
        links = self._tree.below(node)
        if not links:
            return 0.0, {}
        worth = np.array([self._worths(link, thing) for link in links])
        total, found = 0.0, {}
        for row in range(len(links)):
            if not links[row].negated:
                continue
            total += links[row].weight * max(0.0, 1.0 - float(worth[row].max()))
            worth[row] = 0.0
        rows, columns = linear_sum_assignment(worth, maximize=True)
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            if worth[row, column] > 0:
                total += float(worth[row, column])
                found[links[row].node] = column
                found.update(self._below(links[row].node, column)[1])
        return total, found

    def _worths(self, link: Link, thing: int) -> FloatArray:
        """(N,) what each thing is worth as the node at the end of a link, with all that hangs from it."""
        worth = np.zeros(self._likeness.shape[1])
        for other in np.flatnonzero(self._likeness[link.node] > 0).tolist():
            if other == thing:
                continue
            pair = (thing, other) if link.outward else (other, thing)
            worth[other] = self._likeness[link.node, other] * self._holds(link.word, *pair)
            if not link.negated:
                worth[other] *= link.weight
            if not link.negated:
                worth[other] += self._below(link.node, other)[0]
        return worth


def _plain(word: str) -> tuple[str, bool]:
    """A relation without its negation, and whether it had one."""
    word = " ".join(word.lower().split())
    for negation in ("not", "no", "without"):
        if word == negation or word.startswith(f"{negation} "):
            return word.removeprefix(negation).strip() or "near", True
    return word, False


def target_degrees(count: int, edges: Sequence[tuple[int, int]]) -> NDArray[np.int64]:
    """(T,) how many other nodes each node of the target graph is joined to, either way."""
    joined = np.zeros((count, count), np.int64)
    for source, target in edges:
        if source != target:
            joined[source, target] = joined[target, source] = 1
    degrees: NDArray[np.int64] = joined.sum(axis=0)
    return degrees
