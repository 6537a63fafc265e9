"""grounding: target graph + graph -> ranked viewpoints with reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from dssmsg.events import Candidate


@dataclass(frozen=True, slots=True)
class TargetNode:
    """A node of the target graph: a label text and attribute texts."""

    label: str
    attributes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TargetEdge:
    """A relation between two nodes, by index."""

    source: int
    target: int
    relation: str = "near"


@dataclass(frozen=True, slots=True)
class TargetGraph:
    """What a sentence asks for (paper III-C); `core` is the index of the target itself."""

    text: str
    nodes: tuple[TargetNode, ...]
    edges: tuple[TargetEdge, ...] = ()
    core: int = 0
    kind: str = "explicit"


@runtime_checkable
class Grounding(Protocol):
    """Target graph + graph -> ranked viewpoints. The graph is `context.graph`."""

    def ground(self, target: TargetGraph) -> Sequence[Candidate]:
        """All candidates, best first; empty if nothing can match."""
        ...
