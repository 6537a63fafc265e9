"""What a sentence wants to do, and the things that serve it (paper III-C, implicit).

A wording fits where all its words occur in the sentence, in any form and order; the one with most words wins.
Where none fits, a text encoder compares the sentence with what each need is about and what things are for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dssmsg.lexicon.tables import Need, Tables
from dssmsg.lexicon.words import stem, tokens
from dssmsg.purposes import NeedRanker, load_purposes

if TYPE_CHECKING:
    from dssmsg.frame import Float32Array
    from dssmsg.interfaces import Encoder

LEAST_COSINE = 0.35
"""A sentence that is less like every need says none of them."""
LABEL_MARGIN = 0.05
"""By how much a single thing must beat every need to be the answer by itself."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A need that a sentence states, how many words of it say so, and their stems."""

    need: Need
    words: int
    stems: frozenset[str]


class Needs:
    """The needs of the tables, searched by wording and by meaning."""

    def __init__(self, tables: Tables, encoder: Encoder | None) -> None:
        self._needs = tables.needs
        self._wordings = [
            (number, tuple(_slots(phrase)))
            for number, need in enumerate(tables.needs)
            for phrase in need.says
        ]
        self.verbs = frozenset(one for _, slots in self._wordings for one in slots[0])
        cores = {need.core for need in tables.needs}  # what a need is about is said there
        self._labels = tuple(one for one in load_purposes() if one in tables.labels and one not in cores)
        self._encoder = encoder
        self._ranker = None if encoder is None else NeedRanker(encoder)
        self._about: Float32Array | None = None

    def by_wording(self, words: Sequence[str]) -> Fit | None:
        """The need that most words of a sentence state; of equals the one with the longer words."""
        present = {stem(word) for word in words}
        best: tuple[tuple[int, int, int], Fit] | None = None
        for number, slots in self._wordings:
            stated = [slot & present for slot in slots]
            stems = frozenset[str]().union(*stated)
            if not all(stated) or len(stems) < len(slots):  # one word cannot fill two slots
                continue
            letters = sum(max(map(len, slot)) for slot in stated)
            order = (len(slots), letters, number)
            if best is None or order > best[0]:
                best = (order, Fit(self._needs[number], len(slots), stems))
        return None if best is None else best[1]

    def by_meaning(self, sentence: str) -> Need | None:
        """The need that a sentence is most like, or a need for one thing alone; None without an encoder or
        where nothing is alike."""
        if self._encoder is None or self._ranker is None:
            return None
        if self._about is None:
            self._about = self._encoder.encode_text([need.about for need in self._needs])
        wanted = self._encoder.encode_text([sentence])[0]
        alike = np.einsum("nd,d->n", self._about.astype(np.float64), wanted.astype(np.float64))
        named = self._ranker.scores(sentence, self._labels)
        need, label = int(alike.argmax()), int(named.argmax())
        if max(float(alike[need]), float(named[label])) < LEAST_COSINE:
            return None
        if float(named[label]) > float(alike[need]) + LABEL_MARGIN:
            core = self._labels[label]
            return Need(says=(core,), about=core, core=core)
        return self._needs[need]


def _slots(phrase: str) -> list[frozenset[str]]:
    """The words of a wording, each the stems of its alternatives."""
    slots = []
    for word in phrase.split():
        choices = frozenset(stem(token) for choice in word.split("|") for token in tokens(choice)[:1])
        if choices:
            slots.append(choices)
    return slots
