"""Faults of the matching: other weights, the wrong order, another thing than the target graph names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from dssmsg.evaluate.faults.host import Aim
from dssmsg.events import Candidate
from dssmsg.interfaces import Context, Grounding, TargetGraph, TargetNode

_WEIGHTS: tuple[Mapping[str, float], ...] = (
    {"s_graph": 1.0, "s_core": -3.0, "s_view": 0.3},
    {"s_graph": -1.0, "s_core": 0.0, "s_view": 0.3},
    {"s_graph": 0.2, "s_core": 0.0, "s_view": -2.0},
)


@dataclass(slots=True)
class WrongWeights:
    """The terms of the candidates are added up with other weights, some of them of the wrong sign."""

    inner: Grounding
    context: Context
    aim: Aim

    def ground(self, target: TargetGraph) -> Sequence[Candidate]:
        """The inner ones with their new scores, the highest first."""
        weights = _WEIGHTS[self.aim.seed % len(_WEIGHTS)]
        scored = [
            (sum(weight * one.scores.get(term, 0.0) for term, weight in weights.items()), one)
            for one in self.inner.ground(target)
        ]
        scored.sort(key=lambda pair: -pair[0])
        return tuple(
            replace(one, rank=rank, scores={**one.scores, "score": score})
            for rank, (score, one) in enumerate(scored, 1)
        )


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
