"""A sentence cut into chunks: things with what describes them, and the words that connect them.

    "two red mugs that are on the old table"  ->  thing(mug, red, 2)  relation(on)  thing(table, old)

Kinds of chunks: `thing` (text = label), `open` (a place, something: not named), `room`, `relation`, `join`
(and, comma), `or`, `not`, `exists` (there is), `it`, `purpose` (what follows is what it is for).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dssmsg.lexicon.description import Description
from dssmsg.lexicon.terms import Kinds, Phrases, Term
from dssmsg.lexicon.words import singular

MAX_UNKNOWN_WORDS = 3
_BEFORE_VERBS = frozenset({"to", "i", "you", "we", "they", "can", "could", "must", "should", "who", "will"})


@dataclass(frozen=True, slots=True)
class Chunk:
    """A piece of a sentence; `attributes` and `count` are of things, `known` tells a table's word."""

    kind: str
    text: str = ""
    attributes: tuple[str, ...] = ()
    count: int = 1
    known: bool = True


class Chunker:
    """Cuts the words of one sentence; see the module."""

    def __init__(
        self, phrases: Phrases, words: Sequence[str], *, noun_due: bool = False, verb_due: bool = False
    ) -> None:
        """`noun_due`: the sentence asks for a thing by its name, so that a word nobody knows is one;
        `verb_due`: it begins with what somebody wants to do."""
        self._phrases = phrases
        self._words = words
        self._chunks: list[Chunk] = []
        self._said = Description()
        self._count = 1
        self._noun_due = noun_due
        self._verb_due = verb_due
        self._of = False
        self._thing_end = -1

    def chunks(self) -> list[Chunk]:
        """All chunks in the order of the sentence."""
        place = 0
        while place < len(self._words):
            term = self._phrases.at(self._words, place)
            if term is None:
                place = self._unknown(place)
                continue
            self._take(term, place)
            place += len(term.words)
        self._describe_last()
        return self._chunks

    def _take(self, term: Term, place: int) -> None:
        kinds, after = term.kinds, place + len(term.words)
        verb = "verbs" in kinds and (self._words[place - 1] in _BEFORE_VERBS if place > 0 else self._verb_due)
        if verb:
            self._forget()
        elif "attribute" in kinds and ("label" not in kinds or self._noun_follows(after)):
            self._describe(kinds["attribute"])
        elif "relation" in kinds:
            self._connect("relation", kinds["relation"])
        elif "label" in kinds:
            self._thing(kinds["label"], place, after)
        elif "room" in kinds:
            self._room(kinds["room"], place, after)
        elif "number" in kinds:
            self._number(int(kinds["number"]))
        elif "places" in kinds:
            self._chunks.append(Chunk("open", term.words[-1], self._said.attributes))
            self._forget()
        elif "determiners" in kinds:
            self._said.deny(False)
            self._noun_due = True
        elif "negations" in kinds and ("conjunctions" not in kinds or self._excepts(after)):
            self._negate(kinds["negations"], term.words)
        elif "conjunctions" in kinds or "alternatives" in kinds:
            self._join(kinds)
        elif "purpose" in kinds:
            self._connect("purpose", "")
        elif "existence" in kinds:
            self._connect("exists", "")
        elif "pronouns" in kinds:
            self._connect("it", term.words[-1])
        elif "parts" in kinds:
            self._part()
        elif "structure" in kinds:
            self._drop_relation()
            self._forget()
        elif term.words == ("of",):
            self._of = True

    def _connect(self, kind: str, text: str) -> None:
        self._describe_last()
        self._chunks.append(Chunk(kind, text))
        if kind == "relation":
            self._noun_due = True

    def _describe(self, attribute: str) -> None:
        """An attribute; a "not" right before it denies it and nothing else."""
        if self._said.denied and self._chunks and self._chunks[-1].kind == "not":
            self._chunks.pop()
        self._said.add(attribute)
        self._noun_due = True

    def _number(self, count: int) -> None:
        self._said.deny(False)
        self._count, self._noun_due = max(1, count), True

    def _join(self, kinds: Kinds) -> None:
        """ "Black and white" goes on with what describes one thing; elsewhere another one comes."""
        either = "alternatives" in kinds
        if not self._said:
            self._connect("or" if either else "join", "")
            return
        self._said.join(either=either)
        if "negations" in kinds:  # "not red but blue"
            self._said.deny(False)

    def _negate(self, relation: str, words: Sequence[str]) -> None:
        """A word that denies `relation`, or where that is empty what comes next."""
        self._describe_last()
        self._chunks.append(Chunk("not"))
        if relation:
            self._chunks.append(Chunk("relation", relation))
        else:
            self._said.deny()
        self._noun_due = words[-1] not in _BEFORE_VERBS

    def _excepts(self, after: int) -> bool:
        """Whether a "but" leaves out what comes next: "anything but beds", "any seat but the sofa". Where
        something was denied before, it comes back to what is meant: "not a chair but a stool"."""
        if self._said or not self._chunks or any(chunk.kind == "not" for chunk in self._chunks):
            return False
        term = self._phrases.at(self._words, after) if after < len(self._words) else None
        return self._chunks[-1].kind == "open" or (term is not None and "determiners" in term.kinds)

    # Things

    def _close_row(self) -> None:
        """ "The chair that is red and the table": what was said is of the thing before."""
        if self._said.joined and any(chunk.kind == "thing" for chunk in self._chunks):
            count = self._count
            self._connect("or" if self._said.either else "join", "")
            self._count = count

    def _thing(self, label: str, place: int, after: int) -> None:
        self._close_row()
        last = self._chunks[-1] if self._chunks else None
        thing = Chunk("thing", label, self._said.attributes, self._count)
        if self._of and last is not None and last.kind == "thing":
            if (
                not last.known
            ):  # "a stack of books"; of a known thing ("a bowl of fruit") the first word counts
                self._chunks[-1] = Chunk("thing", label, last.attributes + thing.attributes, last.count)
        elif self._thing_end == place and last is not None and last.kind == "thing":
            self._chunks[-1] = Chunk("thing", label, last.attributes, last.count)  # "a shoe box" is a box
        else:
            self._chunks.append(thing)
        self._forget()
        self._thing_end = after

    def _room(self, name: str, place: int, after: int) -> None:
        """A room; `known` where a relation leads to it ("in the gym", not "after the gym")."""
        if place > 0 and self._words[place - 1] == "to":  # "to study"; a room would have its article
            self._forget()
            return
        led = bool(self._chunks) and self._chunks[-1].kind == "relation"
        if self._noun_follows(after):  # "under the bathroom mirror": the relation leads to the mirror
            self._chunks.insert(len(self._chunks) - led, Chunk("room", name, known=led))
            self._noun_due = True
            return
        if self._drop_relation():
            self._chunks.append(Chunk("not"))
        self._chunks.append(Chunk("room", name, known=led))
        self._forget()

    def _unknown(self, place: int) -> int:
        """Words that nobody knows: a thing's name where one is due, else passed over. The next place."""
        end = place
        while (
            end < min(len(self._words), place + MAX_UNKNOWN_WORDS)
            and self._phrases.at(self._words, end) is None
        ):
            end += 1
        if not self._noun_due:
            return end
        following = self._phrases.at(self._words, end) if end < len(self._words) else None
        names_more = following is not None and not {"label", "attribute", "room", "places"}.isdisjoint(
            following.kinds
        )
        if names_more and not (following is not None and "relation" in following.kinds):
            return end  # "my favourite mug"
        words = self._words[place:end]
        if self._of and self._chunks and self._chunks[-1].kind == "thing":
            self._forget()
            return end
        self._close_row()
        label = " ".join((*words[:-1], singular(words[-1])))[:80]
        self._chunks.append(Chunk("thing", label, self._said.attributes, self._count, known=False))
        self._forget()
        return end

    def _noun_follows(self, place: int) -> bool:
        """Whether a thing comes after attributes alone: `glass` in "a glass table" is no thing."""
        while place < len(self._words):
            term = self._phrases.at(self._words, place)
            if term is None or ("attribute" not in term.kinds and "label" not in term.kinds):
                return False
            if "label" in term.kinds:
                return True
            place += len(term.words)
        return False

    # What is left over

    def _part(self) -> None:
        """ "a mug with a blue handle": what describes a part describes the thing, if it has that part."""
        if self._drop_relation():
            self._forget()
        self._describe_last()

    def _drop_relation(self) -> bool:
        """A relation to what is never in a graph leads nowhere; whether it was denied."""
        denied = False
        while self._chunks and self._chunks[-1].kind in ("relation", "not"):
            denied = self._chunks.pop().kind == "not" or denied
        return denied

    def _describe_last(self) -> None:
        """Attributes that no thing came after are of the one before: "the chair that is red"."""
        for place in range(len(self._chunks) - 1, -1, -1):
            chunk = self._chunks[place]
            if chunk.kind == "thing" and self._said:
                said = (*chunk.attributes, *self._said.attributes)
                self._chunks[place] = Chunk("thing", chunk.text, said, chunk.count, chunk.known)
                break
        self._forget()

    def _forget(self) -> None:
        self._said = Description()
        self._count = 1
        self._noun_due = False
        self._of = False
