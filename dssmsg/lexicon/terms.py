"""The longest known phrase at a word: what the tables say about it, of each kind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from dssmsg.lexicon.tables import Tables
from dssmsg.lexicon.words import is_number, singular, tokens

_NAMING = frozenset({"label", "room", "attribute"})
Kinds = Mapping[str, str]
"""Kind (`label`, `relation`, ...) -> the name that a phrase stands for there."""


@dataclass(frozen=True, slots=True)
class Term:
    """A phrase of a sentence: its words and what they may be; no kinds, nothing known."""

    words: tuple[str, ...]
    kinds: Kinds


class Phrases:
    """Phrases of words and what each stands for, found by the longest match."""

    def __init__(self, *, digits: bool = False) -> None:
        """`digits`: a count in digits is a known word, a `number`."""
        self._digits = digits
        self._known: dict[tuple[str, ...], dict[str, str]] = {}
        self._longest = 1

    def add(self, kind: str, phrase: str, name: str) -> None:
        """Lets `phrase` stand for `name`; a later line about the same phrase and kind replaces it."""
        words = tokens(phrase)
        if words:
            self._known.setdefault(words, {})[kind] = name
            self._longest = max(self._longest, len(words))

    def add_all(self, kind: str, phrases: Iterable[str]) -> None:
        """Phrases that stand for themselves."""
        for phrase in phrases:
            self.add(kind, phrase, phrase)

    def at(self, words: Sequence[str], place: int) -> Term | None:
        """The longest phrase that begins at `place`; the last word of a label may be a plural."""
        for length in range(min(self._longest, len(words) - place), 0, -1):
            window = tuple(words[place : place + length])
            kinds = self._known.get(window, {})
            if "label" not in kinds:
                one = self._known.get((*window[:-1], singular(window[-1])), {})
                if "label" in one:
                    kinds = {**kinds, "label": one["label"]}
            if kinds:
                return Term(window, kinds)
        word = words[place]
        return Term((word,), {"number": word}) if self._digits and is_number(word) else None

    def split_hyphens(self, words: Sequence[str]) -> tuple[str, ...]:
        """A word that nobody knows in its parts, where these name a thing: `coffee-table`, `glass-table`."""
        split: list[str] = []
        place = 0
        while place < len(words):
            term = self.at(words, place)
            length = 1 if term is None else len(term.words)
            split += words[place : place + length]
            parts = words[place].split("-")
            if term is None and len(parts) > 1 and self._names(parts):
                split[-1:] = parts
            place += length
        return tuple(split)

    def _names(self, words: Sequence[str]) -> bool:
        """Whether words are a thing's or room's name, with or without what describes it."""
        place, kinds = 0, frozenset[str]()
        while place < len(words):
            term = self.at(words, place)
            kinds = frozenset() if term is None else _NAMING & term.kinds.keys()
            if term is None or not kinds:
                return False
            place += len(term.words)
        return not kinds.isdisjoint(("label", "room"))


def vocabulary(tables: Tables) -> Phrases:
    """All phrases that may stand inside a sentence."""
    phrases = Phrases(digits=True)
    for name, others in tables.relations.items():
        for phrase in (*others, name):
            phrases.add("relation", phrase, name)
    for name, others in tables.attributes.items():
        for phrase in (*others, name):
            phrases.add("attribute", phrase, name)
    for phrase, count in tables.numbers.items():
        phrases.add("number", phrase, str(count))
    for name, room in tables.rooms.items():
        for phrase in (*room.also, name):
            phrases.add("room", phrase, name)
    for phrase, denied in tables.negations.items():
        phrases.add("negations", phrase, denied)
    for kind in ("places", "parts", "structure", "determiners", "conjunctions", "alternatives"):
        phrases.add_all(kind, getattr(tables, kind))
    for kind in ("pronouns", "existence", "purpose", "fillers", "verbs"):
        phrases.add_all(kind, getattr(tables, kind))
    for name, label in tables.labels.items():
        for phrase in label.like:
            phrases.add("label", phrase, phrase)
        for phrase in label.also:
            phrases.add("label", phrase, name)
    for name in tables.labels:  # a label's own name is never another's alias
        phrases.add("label", name, name)
    return phrases


def openings(tables: Tables) -> Phrases:
    """Phrases that may open a sentence: what is asked (`polite`, `about`), what is wanted (`wants`) or not
    (`refuses`)."""
    phrases = Phrases()
    phrases.add_all("polite", tables.frames.polite)
    phrases.add_all("about", tables.frames.about)
    phrases.add_all("wants", tables.wants)
    phrases.add_all("refuses", tables.refuses)
    return phrases
