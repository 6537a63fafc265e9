"""A sentence read into things, what is said of each, and how they stand to each other (paper III-C).

A relation leads from the thing before it to the thing after it; "and" goes on with the relation before it,
"X with Y on it" turns it round, "not" and "without" say of X what is not there. What is asked for comes
first, unless it is only called a place or something: then it is left open (`OPEN`), and what it is for
decides (`dssmsg.lexicon.target`). Of "this or that" this is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from dssmsg.lexicon.chunks import Chunk

OPEN = ""
"""The label of a thing that is only called a place, something, somewhere."""
MAX_COUNT = 4
MAX_THINGS = 16
MAX_ATTRIBUTES = 8
_SOMETHING = frozenset({"something", "anything", "thing", "object", "item", "one", "furniture", "container"})


def _denied(relation: str) -> str:
    """A relation that says that there is none such."""
    return "without" if relation == "with" else f"not {relation}"


def is_denied(relation: str) -> bool:
    """Whether a relation leads to what is not there."""
    return relation == "without" or relation.startswith("not ")


@dataclass(slots=True)
class Thing:
    """A thing that a sentence names. `known`: by the tables; else it is the sentence's own word."""

    label: str
    attributes: list[str] = field(default_factory=list)
    known: bool = True


@dataclass(slots=True)
class Reading:
    """What was read. `things[0]` is what is asked for; `relations` are (from, to, word) by index.

    A relation `without` or `not ...` leads to what shall not be there. `objects` are things that only a
    purpose names ("a place to wash *dishes*"), `avoided` things and rooms that are not meant ("anything but
    the *sofa*"), `missing` what somebody says that there is none of ("there is no *light* here").
    """

    things: list[Thing] = field(default_factory=list)
    relations: list[tuple[int, int, str]] = field(default_factory=list)
    objects: list[Thing] = field(default_factory=list)
    rooms: list[str] = field(default_factory=list)
    avoided: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    @property
    def denies(self) -> bool:
        """Whether it says of anything that it is not there or not meant."""
        return bool(self.avoided) or any(is_denied(word) for _a, _b, word in self.relations)

    @property
    def open(self) -> bool:
        """Whether what is asked for has no name yet."""
        return bool(self.things) and self.things[0].label == OPEN


class Reader:
    """Links the chunks of one sentence."""

    def __init__(self, *, wanted: bool = False, refused: bool = False) -> None:
        """`wanted`: the sentence says what somebody wants to do, so that what serves it is open; `refused`:
        it begins with what nobody wants."""
        self.reading = Reading()
        self._purpose = self._wish = wanted
        self._first: list[int] = []
        self._last: list[int] = []
        self._link: tuple[list[int], str, list[int]] | None = None
        self._relation = ""
        self._anchor: list[int] = []
        self._joined = False
        self._negated = refused
        self._other = False
        self._either = False
        self._aside = False  # a second purpose ("while sitting on the sofa") says what is about, not where
        if wanted:
            self._add(Chunk("open"))

    def read(self, chunks: Sequence[Chunk]) -> Reading:
        """The reading of a sentence's chunks."""
        ordered = _subject_first(chunks)
        for place, chunk in enumerate(ordered):
            following = ordered[place + 1] if place + 1 < len(ordered) else None
            self._take(chunk, following)
        return self.reading

    def _take(self, chunk: Chunk, following: Chunk | None) -> None:
        if chunk.kind == "thing":
            self._name(chunk)
        elif chunk.kind == "open":
            if not self.reading.things:
                self._add(chunk)
            self._wish = False
            self._other = self._negated  # "not the one in the kitchen"
            self._relation, self._negated = "", False
        elif chunk.kind == "room":
            self._enter(chunk)
        elif chunk.kind == "relation":
            self._relate(chunk.text, following)
            self._either = False  # "a chair or stool near the bed"
        elif chunk.kind == "exists" and self._last:
            self._relation, self._anchor = "with", self._last
        elif chunk.kind == "join":
            self._joined, self._relation, self._other = True, "", False
        elif chunk.kind == "or":
            self._choose()
        elif chunk.kind == "not":
            self._negated = True
        elif chunk.kind == "purpose":
            self._aside = self._purpose
            self._purpose, self._relation, self._negated = True, "", False
            self._other = self._either = False

    def _enter(self, chunk: Chunk) -> None:
        """A room: what is sought is in it, or it is one of those that are not meant."""
        named = chunk.known or not self._purpose
        if self._negated:
            self.reading.avoided.append(chunk.text)
        elif named and chunk.text not in self.reading.rooms and not (self._other or self._either):
            self.reading.rooms.append(chunk.text)
        self._relation, self._negated, self._either = "", False, False

    def _choose(self) -> None:
        """ "Or": what is not there is none of both; else the first will do, and what is said of the second
        is passed over."""
        if self._link is not None and is_denied(self._link[1]):
            self._joined, self._relation = True, ""
            return
        reading = self.reading
        self._relation = ""
        self._other = self._other or self._link is not None or bool(reading.rooms)
        self._either = bool(reading.objects) or (bool(reading.things) and not reading.open)

    def _relate(self, word: str, following: Chunk | None) -> None:
        names_nothing = following is None or following.kind in ("it", "relation", "join", "exists")
        if names_nothing and word != "with" and self._link is not None and self._link[1] == "with":
            anchor, _, linked = self._link  # "a table with a lamp on it": the lamp is on the table
            old = {(source, target, "with") for source in anchor for target in linked}
            self.reading.relations = [r for r in self.reading.relations if r not in old]
            whole = self._first if following is not None and following.kind == "it" else anchor
            self.reading.relations += [(target, source, word) for source in whole for target in linked]
            self._link, self._last = None, anchor
            return
        goes_back = self._link is not None and (self._joined or self._link[1] == "with")
        self._anchor = self._link[0] if goes_back and self._link is not None else self._last
        self._relation = "near" if self._aside and word != "with" else word
        self._joined = False

    def _name(self, chunk: Chunk) -> None:
        hints = not chunk.known and self._relation and (self._purpose or self.reading.open)
        if self._other or self._either or hints:  # "without distraction", "on a Sunday": no things
            pass
        elif self._negated or self._denies_on():
            self._deny(chunk)
        elif (self._purpose or self.reading.open) and self.reading.things and not self._goes_on():
            attributes = list(chunk.attributes)
            self.reading.objects.append(Thing(chunk.text, attributes, chunk.known))
        else:
            self._add(chunk)
        self._relation, self._joined, self._negated, self._either = "", False, False, False

    def _goes_on(self) -> bool:
        """Whether a relation leads on, or "and" continues one: else it is a thing that a purpose names."""
        return bool(self._relation) or (self._joined and self._link is not None and not self.reading.objects)

    def _denies_on(self) -> bool:
        """Whether "and", "or" or "nor" goes on with what is not there; ", not the desk" does not."""
        denied = self._link is not None and is_denied(self._link[1])
        return denied and not self._relation and self._joined != self._negated

    def _deny(self, chunk: Chunk) -> None:
        """What is not there is a thing too, at the end of a relation that says so. Where none leads to it, it
        is not meant: "the dining table, not the coffee table"."""
        things = self.reading.things
        anchor, word, before = self._anchor or self._last, _denied(self._relation), list[int]()
        if self._link is not None and self._denies_on():
            anchor, word, before = self._link
        elif not self._relation or not things:
            self.reading.avoided.append(chunk.text)
            self._other = self._joined and chunk.known  # ", not the lamp on the desk"
            return
        if len(things) >= MAX_THINGS:
            return
        things.append(Thing(chunk.text, list(chunk.attributes), chunk.known))
        new = len(things) - 1
        self.reading.relations += [(source, new, word) for source in anchor]
        self._link = (anchor, word, [*before, new])
        if self._wish and word == "without":
            self.reading.missing.append(chunk.text)

    def _add(self, chunk: Chunk) -> None:
        things = self.reading.things
        label = OPEN if chunk.kind == "open" else chunk.text
        count = min(chunk.count, MAX_COUNT, MAX_THINGS - len(things))
        new = list(range(len(things), len(things) + count))
        described = chunk.kind == "thing" or chunk.text in _SOMETHING  # a dark place to sleep: no dark bed
        attributes = chunk.attributes if described else ()
        things += [Thing(label, list(attributes), chunk.known) for _ in new]
        if not new:
            return
        linked = list(new)
        if self._relation and self._anchor:
            anchor, word = self._anchor, self._relation
        elif self._joined and self._link is not None:
            anchor, word, before = self._link
            linked = [*before, *new]
        elif new[0] > 0:
            anchor, word = [0], "near"
        else:
            self._first = self._last = new
            return
        self.reading.relations += [(source, target, word) for source in anchor for target in new]
        self._link, self._last = (anchor, word, linked), new


def _subject_first(chunks: Sequence[Chunk]) -> Sequence[Chunk]:
    """ "On the table next to the bed, the mug" as "the mug on the table next to the bed".

    Where a sentence begins with a relation, the first thing that no relation leads to is what it is about.
    """
    if not chunks or chunks[0].kind != "relation":
        return chunks
    led = 0  # things that the last relation still leads to; "between" leads to two
    for place, chunk in enumerate(chunks):
        if chunk.kind == "relation":
            led = 2 if chunk.text == "between" else 1
        elif chunk.kind in ("thing", "open"):
            if not led and not (chunks[place - 1].kind in ("join", "or") and _is_list(chunks, place)):
                return (chunk, *chunks[:place], *chunks[place + 1 :])
            led = max(0, led - 1)
    return chunks


def _is_list(chunks: Sequence[Chunk], place: int) -> bool:
    """Whether the thing at `place` belongs to a list ("between the bed and the desk"): a later one has no
    relation either."""
    return any(
        chunk.kind in ("thing", "open") and chunks[after - 1].kind != "relation"
        for after, chunk in enumerate(chunks[place + 1 :], start=place + 1)
    )
