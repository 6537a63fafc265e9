"""A sentence read into things, what is said of each, and how they stand to each other (paper III-C, explicit).

One pass from left to right over the longest known phrases. A thing follows its determiner, count and
attributes; a relation leads from the thing before it to the thing after it. "and" goes on with the relation
before it, "X with Y on it" turns the relation round, "not" and "without" say of X what is not there.
What is asked for comes first, unless it is only called a place or something: then it is left open (`OPEN`),
and what it is for decides (`dssmsg.lexicon.target`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from dssmsg.lexicon.terms import Phrases, Term
from dssmsg.lexicon.words import singular

OPEN = ""
"""The label of a thing that is only called a place, something, somewhere."""
MAX_COUNT = 4
MAX_THINGS = 16
MAX_UNKNOWN_WORDS = 3
_AFTER_THIS_A_VERB = frozenset({"to", "i", "you", "we", "they", "can", "could", "must", "should", "who", "will"})
_PASSED_OVER = frozenset(
    {"fillers", "pronouns", "existence", "determiners", "conjunctions", "verbs", "structure", "parts"}
)


@dataclass(slots=True)
class Thing:
    """A thing that a sentence names. `known`: by the tables; else it is the sentence's own word."""

    label: str
    attributes: list[str] = field(default_factory=list)
    known: bool = True


@dataclass(slots=True)
class Reading:
    """What was read. `things[0]` is what is asked for; `relations` are (from, to, word) by index.

    `objects` are things that only a purpose names ("a place to wash *dishes*"), `qualities` words that
    describe an open place, `purpose` tells that one is stated.
    """

    things: list[Thing] = field(default_factory=list)
    relations: list[tuple[int, int, str]] = field(default_factory=list)
    objects: list[Thing] = field(default_factory=list)
    rooms: list[str] = field(default_factory=list)
    qualities: list[str] = field(default_factory=list)
    purpose: bool = False

    @property
    def open(self) -> bool:
        """Whether what is asked for has no name yet."""
        return bool(self.things) and self.things[0].label == OPEN


class _Reader:
    """The state between two words."""

    def __init__(self, phrases: Phrases, words: Sequence[str], wanted: bool, about: bool) -> None:
        self._phrases = phrases
        self._words = words
        self.reading = Reading()
        self._about = about
        self._last: list[int] = []
        self._link: tuple[list[int], str] | None = None  # from whom the last relation led, and its word
        self._linked: list[int] = []
        self._leading: list[tuple[int, str]] = []  # "on the table, the mug"
        self._clear()
        self._relation = ""
        self._anchor: list[int] = []
        self._joined = False
        if wanted:
            self._open_thing()
            self.reading.purpose = True

    def _clear(self) -> None:
        """Forgets what was said before a thing that did not come."""
        self._attributes: list[str] = []
        self._count = 1
        self._noun_due = False
        self._negated = False

    def read(self) -> Reading:
        place = 0
        while place < len(self._words):
            term = self._phrases.at(self._words, place)
            if term is None:
                place += self._unknown(place)
                continue
            self._take(term, place)
            place += len(term.words)
        self._describe_last()
        self._settle_leading()
        return self.reading

    # One phrase

    def _take(self, term: Term, place: int) -> None:
        kinds, after = term.kinds, place + len(term.words)
        if "attribute" in kinds and ("label" not in kinds or self._noun_follows(after)):
            self._attributes.append(kinds["attribute"])
            self._noun_due = True
        elif "relation" in kinds and not ("purpose" in kinds and self.reading.open):
            self._relate(kinds["relation"], after)
        elif "negations" in kinds:
            self._negate(term.words)
        elif "label" in kinds and not self._is_verb(kinds, place):
            self._name(kinds["label"], place)
        elif "room" in kinds and not self._is_verb({"verbs": ""}, place):
            self._enter(kinds["room"])
        elif "number" in kinds:
            self._count = min(int(kinds["number"]), MAX_COUNT)
            self._noun_due = True
        elif "places" in kinds:
            self._place_word(after)
        elif "purpose" in kinds:
            self._describe_last()
            self.reading.purpose = True
        elif "conjunctions" in kinds:
            self._joined = True
            self._relation = ""
        elif "determiners" in kinds:
            self._noun_due = True
        elif "parts" in kinds or "structure" in kinds:
            self._pass_over(kinds)
        elif "existence" in kinds and self._last and not self._joined and not self._leading:
            self._relation, self._anchor = "with", self._last

    def _is_verb(self, kinds: object, place: int) -> bool:
        """Whether a word that may be a verb is one here."""
        return (
            isinstance(kinds, dict)
            and "verbs" in kinds
            and place > 0
            and self._words[place - 1] in _AFTER_THIS_A_VERB
        )

    def _noun_follows(self, place: int) -> bool:
        """Whether a thing comes after attributes alone: `glass` in "a glass table" is no thing."""
        while place < len(self._words):
            term = self._phrases.at(self._words, place)
            if term is None:
                return False
            if "label" in term.kinds:
                return True
            if "attribute" not in term.kinds:
                return False
            place += len(term.words)
        return False

    # Things

    def _name(self, label: str, place: int) -> None:
        if self._negated:
            self._deny(label)
            return
        if self._after_of(place):
            if self._last and not self.reading.things[self._last[0]].known:
                for index in self._last:  # "a stack of books"
                    self.reading.things[index] = Thing(label, self.reading.things[index].attributes)
            self._clear()
            return
        if self._compound(place):
            for index in self._last:  # "a shoe box" is a box
                self.reading.things[index].label = label
                self.reading.things[index].known = True
            self._clear()
            return
        self._add(label, known=True)

    def _after_of(self, place: int) -> bool:
        before = place - 1
        while before > 0 and self._words[before] not in {"of"} and self._skipped(self._words[before]):
            before -= 1
        return before > 0 and self._words[before] == "of" and not self._relation

    def _skipped(self, word: str) -> bool:
        term = self._phrases.at((word,), 0)
        return term is not None and not {"determiners", "attribute", "number"}.isdisjoint(term.kinds)

    def _compound(self, place: int) -> bool:
        """Whether the word before this one was the last thing itself."""
        return bool(
            place > 0
            and self._last
            and not self._relation
            and not self._joined
            and not self._noun_due
            and self._end_of_last == place
        )

    _end_of_last = -1

    def _add(self, label: str, *, known: bool) -> None:
        reading = self.reading
        if reading.purpose and not self._relation and not self._joined and reading.things:
            reading.objects.append(Thing(label, self._attributes, known))
            self._clear()
            return
        if reading.purpose and self._joined and reading.objects and not self._relation:
            reading.objects.append(Thing(label, self._attributes, known))
            self._clear()
            self._joined = False
            return
        room_left = max(0, MAX_THINGS - len(reading.things))
        new = []
        for _ in range(min(self._count, room_left)):
            reading.things.append(Thing(label, list(self._attributes), known))
            new.append(len(reading.things) - 1)
        if new:
            self._connect(new)
            self._last = new
        self._clear()
        self._relation = ""
        self._joined = False

    def _connect(self, new: list[int]) -> None:
        """The relations that lead to new things."""
        reading = self.reading
        if self._relation and self._anchor:
            anchor, word = self._anchor, self._relation
        elif self._relation:  # the sentence begins with a relation: the thing it is about comes later
            self._leading += [(index, self._relation) for index in new]
            self._link = None
            return
        elif self._joined and self._link is not None:
            anchor, word = self._link
        elif self._leading and self._joined and self._last == [self._leading[-1][0]] and False:
            return
        elif self._leading and all(self._is_leading(i) for i in range(new[0])):
            self._settle(new)
            return
        elif new[0] > 0:
            anchor, word = [0], "near"
        else:
            return
        for source in anchor:
            reading.relations += [(source, index, word) for index in new]
        self._link, self._linked = (anchor, word), new

    def _is_leading(self, index: int) -> bool:
        return any(index == one for one, _ in self._leading)

    def _settle(self, core: list[int]) -> None:
        """"On the table, the mug": what was named first stands behind the thing that it is about."""
        for index in core:
            self.reading.relations += [(index, other, word) for other, word in self._leading]
        self._leading = []
        first = core[0]
        order = [*core, *(i for i in range(len(self.reading.things)) if i not in core)]
        moved = {old: new for new, old in enumerate(order)}
        self.reading.things = [self.reading.things[old] for old in order]
        self.reading.relations = [(moved[a], moved[b], word) for a, b, word in self.reading.relations]
        self._link = None
        core[:] = [moved[index] for index in core]
        assert core[0] == moved[first]
