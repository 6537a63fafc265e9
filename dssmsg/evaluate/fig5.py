"""How a map's accuracy recovers, update by update (paper III-B, eq. 6-7, Fig. 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.evaluate.dynamic import full_tally
from dssmsg.evaluate.dynamic_states import Snapshot, States, claims_of, survey_claims
from dssmsg.evaluate.dynamic_truth import RunTruth

MIN_DELTA_ACC = 0.02
"""Where a home changed so little that the accuracy hardly fell, eq. 7 divides by next to nothing."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """Acc is the F1 over label, place and state. `previous`: the survey's map against the home it saw;
    `outdated`: the same map against the changed home; `updates`: the map after each valid update."""

    previous: float
    outdated: float
    updates: tuple[float, ...]

    @property
    def delta(self) -> float:
        """Delta Acc of eq. 6: what the changes cost."""
        return self.previous - self.outdated

    @property
    def measurable(self) -> bool:
        """Whether the changes cost enough for relative accuracies to mean something."""
        return abs(self.delta) >= MIN_DELTA_ACC

    @property
    def relative(self) -> tuple[float, ...]:
        """Acc_rel of eq. 7 after each update: 0 is the outdated map, 1 as good as before the changes."""
        return tuple((accuracy - self.outdated) / self.delta for accuracy in self.updates)

    @property
    def gain(self) -> float:
        """What the updates brought in all, as accuracy (Table III)."""
        return (self.updates[-1] if self.updates else self.outdated) - self.outdated


def recovery(survey: Snapshot, updates: Sequence[Snapshot], truth: RunTruth, states: States) -> Recovery:
    """The accuracies of one run."""
    start = survey_claims(survey)
    return Recovery(
        previous=full_tally(start, truth.before).f1,
        outdated=full_tally(start, truth.after).f1,
        updates=tuple(full_tally(claims_of(now, survey, states), truth.after).f1 for now in updates),
    )


def mean_curve(curves: Sequence[Sequence[float]]) -> list[tuple[float, float, int]]:
    """(mean, sample deviation, runs still updating) after update 1, 2, ...

    A run that is done keeps its last value, one without an update stays at 0.
    """
    longest = max((len(curve) for curve in curves), default=0)
    rows = []
    for index in range(longest):
        values = np.array([_at(curve, index) for curve in curves])
        spread = float(values.std(ddof=1)) if len(values) > 1 else 0.0
        rows.append((float(values.mean()), spread, sum(len(curve) > index for curve in curves)))
    return rows


def _at(curve: Sequence[float], index: int) -> float:
    return curve[min(index, len(curve) - 1)] if curve else 0.0
