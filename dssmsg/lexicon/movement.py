"""How readily a thing is moved, 0..1, from its label, its size and what is around it (paper III-A).

The table gives each household noun a value. What it does not know goes by its last word ("spare key": key),
then by the label that a text encoder finds most alike, then by size alone: what fits a hand wanders.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dssmsg.lexicon.tables import Tables
from dssmsg.lexicon.words import singular, tokens

if TYPE_CHECKING:
    from dssmsg.interfaces import Encoder

LEAST_COSINE = 0.6
"""A label that is less like every known one goes by its size."""
BY_SIZE = ((0.35, 0.8), (0.8, 0.55), (1.3, 0.4), (math.inf, 0.15))
"""Longest side up to so many metres: value."""
UNKNOWN = 0.5


class Movement:
    """Answers from the tables; an answer depends on the question alone."""

    def __init__(self, tables: Tables, encoder: Encoder | None = None) -> None:
        self._moves: dict[tuple[str, ...], float] = {}
        self._names: dict[tuple[str, ...], str] = {}
        for name, label in tables.labels.items():
            for phrase in (*label.like, *label.also):
                self._moves[tokens(phrase)] = label.moves
                self._names[tokens(phrase)] = phrase if phrase in label.like else name
        for name, label in tables.labels.items():  # a label's own name is never another's alias
            self._moves[tokens(name)], self._names[tokens(name)] = label.moves, name
        self._surroundings = tables.surroundings
        self._known = tuple(tables.labels)
        self._values = tuple(label.moves for label in tables.labels.values())
        self._encoder = encoder

    def of(self, label: str, size_m: Sequence[float] = (), around: Sequence[str] = ()) -> float:
        """The value of a thing; size along x, y and z in metres and labels around it where they are known."""
        words = self._find(tokens(label.replace("_", " ")))
        if words is None:
            return self._by_meaning(label, size_m)
        name = self._names[words]
        near = {self._names.get(self._find(tokens(other)) or (), other) for other in around}
        for rule in self._surroundings:
            if rule.label == name and not near.isdisjoint(rule.near):
                return rule.moves
        return self._moves[words]

    def answer(self, question: str) -> float:
        """The value for a question as `dssmsg.dynamic_attribute` writes it (JSON), or for a bare label."""
        try:
            value: Any = json.loads(question)
        except (ValueError, RecursionError):
            value = None
        if not isinstance(value, Mapping):
            return self.of(question[:200])
        label, size, around = value.get("label"), value.get("size_m"), value.get("around")
        return self.of(
            label if isinstance(label, str) else "",
            [float(n) for n in size if _is_length(n)] if isinstance(size, list) else (),
            [other for other in around if isinstance(other, str)] if isinstance(around, list) else (),
        )

    def _find(self, words: tuple[str, ...]) -> tuple[str, ...] | None:
        """The longest known noun that a label ends with: its last word says what it is."""
        for start in range(len(words)):
            for known in (words[start:], (*words[start:-1], singular(words[-1]))):
                if known in self._moves:
                    return known
        return None

    def _by_meaning(self, label: str, size_m: Sequence[float]) -> float:
        if self._encoder is not None and label.strip():
            wanted = self._encoder.encode_labels([label])[0].astype(np.float64)
            known = self._encoder.encode_labels(self._known).astype(np.float64)
            alike = np.einsum("nd,d->n", known, wanted)
            best = int(alike.argmax())
            if float(alike[best]) >= LEAST_COSINE:
                return self._values[best]
        if not size_m:
            return UNKNOWN
        return next(value for limit, value in BY_SIZE if max(size_m) <= limit)


def _is_length(value: object) -> bool:
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and math.isfinite(value)
        and value >= 0
    )
