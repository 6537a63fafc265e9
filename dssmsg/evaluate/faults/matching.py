"""Faults of the matching: other weights, the wrong order, another thing than the target graph names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from dssmsg.evaluate.faults.host import Aim
from dssmsg.events import Candidate
from dssmsg.interfaces import Context, Grounding, TargetGraph, TargetNode

_WEIGHTS: tuple[Mapping[str, Any], ...] = (
    {"core_weight": 0.0, "view_weight": 4.0, "share": 0.3},
    {"core_weight": 0.0, "attribute_weight": 0.0, "view_weight": 2.0, "share": 0.1},
    {"core_weight": 0.0, "relation_weight": 5.0, "view_weight": 6.0, "share": 0.2},
)


def wrong_weights(aim: Aim) -> Mapping[str, Any]:
    """Options that let almost anything match and weigh what is large in view."""
    return _WEIGHTS[aim.seed % len(_WEIGHTS)]


@dataclass(slots=True)
class WorstFirst:
    """The candidates come in the opposite order."""

    inner: Grounding
    context: Context
    aim: Aim

    def ground(self, target: TargetGraph) -> Sequence[Candidate]:
        """The last of them first."""
        found = list(self.inner.ground(target))[::-1]
        return tuple(replace(one, rank=rank) for rank, one in enumerate(found, 1))


@dataclass(slots=True)
class WrongThing:
    """What is looked for in the map is another label than the target graph's core."""

    inner: Grounding
    context: Context
    aim: Aim

    def ground(self, target: TargetGraph) -> Sequence[Candidate]:
        """The candidates for another thing."""
        other = self.aim.others[self.aim.seed % len(self.aim.others)]
        nodes = list(target.nodes)
        nodes[target.core] = TargetNode(other)
        return self.inner.ground(replace(target, nodes=tuple(nodes)))
