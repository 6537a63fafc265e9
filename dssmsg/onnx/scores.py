"""Scores of a model: probabilities, or logits that want a sigmoid; exporters do either."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import FloatArray

OUT_OF_RANGE = 1e-3
"""How far a probability may leave 0..1 by rounding (half precision)."""

ScoreKind = Literal["auto", "probabilities", "logits"]
"""auto: probabilities, until a score lies outside 0..1."""


def are_probabilities(scores: NDArray[Any]) -> bool:
    """Whether all scores lie in 0..1, rounding aside; logits of many classes do not."""
    if scores.size == 0:
        return True
    return bool(scores.min() >= -OUT_OF_RANGE and scores.max() <= 1.0 + OUT_OF_RANGE)


def as_probabilities(scores: NDArray[Any], *, logits: bool = False) -> FloatArray:
    """Scores as float64 in 0..1. Raises ValueError where they should be probabilities and are not."""
    values = scores.astype(np.float64)
    if logits:
        sigmoid: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(values, -60.0, 60.0)))
        return sigmoid
    if not are_probabilities(scores):
        raise ValueError(f"expected scores in 0..1, got {values.min():.3g}..{values.max():.3g}")
    return np.clip(values, 0.0, 1.0)
