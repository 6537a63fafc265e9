"""A sentence as a target graph: what it names, and what serves what it only hints at (paper III-C).

Things that the sentence names make an explicit target. Where it only says what somebody wants to do, the
need's core and its company make an implicit one; a thing named for that purpose ("sit on the sofa") is the
core. A room is told by what stands in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dssmsg.lexicon.chunks import Chunker
from dssmsg.lexicon.draft import Draft
from dssmsg.lexicon.needs import Fit, Needs
from dssmsg.lexicon.opening import Openings
from dssmsg.lexicon.reading import MAX_ATTRIBUTES, OPEN, Reader, Reading, Thing, is_denied
from dssmsg.lexicon.tables import Need, Tables
from dssmsg.lexicon.terms import vocabulary
from dssmsg.lexicon.words import stem, tokens

if TYPE_CHECKING:
    from dssmsg.interfaces import Encoder

FORMERLY = "formerly"
"""The attribute of a core that is asked for as it was: "where was the mug before?"."""
LANDMARKS_BESIDE = 2
"""How many landmarks of a room are looked for beside a thing that is in it."""
_AT = frozenset({"on", "in", "near", "next to"})
_HINT = "(English only; another llm understands more: docs/llm.md)"
_NOT_AT = frozenset({"not on", "not in"})
_STATES = frozenset(
    {"is", "are", "must", "should", "need", "needs", "have", "has", "am", "want", "wants", "be"}
)


class NoTarget(ValueError):
    """A sentence that names no thing, no purpose and no room that is known."""


def _only_denies(sentence: str) -> NoTarget:
    return NoTarget(
        f"no object, purpose or room in {sentence!r:.80}: "
        "it only says what should not be there; name what is sought"
    )


def _emptied(reading: Reading) -> Reading:
    """A place without a name in the rooms of a reading."""
    return Reading([Thing(OPEN)], rooms=reading.rooms, avoided=reading.avoided)


class Targets:
    """Turns sentences into target graphs as JSON values (`dssmsg.mission.goal.TARGET_GRAPH_SCHEMA`)."""

    def __init__(self, tables: Tables, encoder: Encoder | None = None) -> None:
        self._tables = tables
        self._phrases = vocabulary(tables)
        self._openings = Openings(tables)
        self._past = [tokens(phrase) for phrase in tables.past]
        self._needs = Needs(tables, encoder)

    def of(self, sentence: str) -> dict[str, Any]:
        """The target graph of a sentence. Raises NoTarget where it says nothing that is known."""
        words = tokens(sentence)
        past, words = self._split_past(words)
        opening = self._openings.of(words)
        rest = self._phrases.split_hyphens(opening.rest)
        if not rest:
            raise NoTarget(f"no object, purpose or room in {sentence!r:.80} {_HINT}")
        fit = self._needs.by_wording(opening.rest)
        wanted = opening.wanted or self._says_a_need(rest, fit, opening.asked)
        chunks = Chunker(self._phrases, rest, noun_due=opening.asked, verb_due=wanted).chunks()
        reading = Reader(wanted=wanted, refused=opening.refused).read(chunks)
        if opening.refused and not reading.denies:
            raise _only_denies(sentence)  # "I don't want to sleep"
        graph = None
        if reading.things and not reading.open:
            graph = self._named(reading)
        elif not reading.things and reading.rooms:
            graph = self._for_room(_emptied(reading), sentence)
        if fit is not None and reading.things and not any(thing.known for thing in reading.things):
            graph = None  # "I need a nap"
        if graph is None:
            graph = self._serving(reading, fit, sentence, rest)
        if past:
            attributes = graph["nodes"][graph["core"]]["attributes"]
            graph["nodes"][graph["core"]]["attributes"] = [FORMERLY, *attributes][:MAX_ATTRIBUTES]
        return graph

    # What a sentence is about

    def _says_a_need(self, words: Sequence[str], fit: Fit | None, asked: bool) -> bool:
        """Whether a sentence tells what to do ("wash the dishes"), what is the matter ("my clothes are
        dirty") or where something is done ("where one showers"), though it may name things."""
        if fit is None:
            return False
        if words[0] == "where":
            return words[-1] not in _STATES
        if asked:
            return False
        term = self._phrases.at(words, 0)
        names = term is not None and not {"label", "determiners", "attribute", "places", "room"}.isdisjoint(
            term.kinds
        )
        if not names:
            return stem(words[0]) in fit.stems or not _STATES.isdisjoint(words)
        return fit.words > 1 and not _STATES.isdisjoint(words)

    def _split_past(self, words: tuple[str, ...]) -> tuple[bool, tuple[str, ...]]:
        """Whether a sentence asks for what was, and its words without a closing "before"."""
        past = any(
            words[place : place + len(phrase)] == phrase
            for phrase in self._past
            for place in range(len(words) - len(phrase) + 1)
        )
        while words and words[-1] in ("before", ",", ";"):
            past = past or words[-1] == "before"
            words = words[:-1]
        return past, words

    def _draft(self, kind: str, reading: Reading) -> Draft:
        """A target in the making; what rooms are known by that are not meant is no company in it."""
        rooms = [self._tables.rooms[name] for name in reading.avoided if name in self._tables.rooms]
        return Draft(kind, reading, [one for room in rooms for one in room.landmarks])

    # What is named

    def _named(self, reading: Reading) -> dict[str, Any]:
        """The explicit target of a reading whose core has a name."""
        draft = self._draft("explicit", reading)
        self._place_in_rooms(draft, reading.rooms, LANDMARKS_BESIDE)
        if len(draft.things) == 1:
            label = self._tables.labels.get(draft.things[0].label)
            for other in label.company if label is not None else ():
                draft.add(other, "near")
        return draft.json()

    # What serves

    def _serving(
        self, reading: Reading, fit: Fit | None, sentence: str, words: Sequence[str]
    ) -> dict[str, Any]:
        """The target of a reading whose core has no name: by its need, its objects, its room, its meaning."""
        if not reading.things:
            reading.things.append(Thing(OPEN))
        elif not reading.open:
            reading = _emptied(reading)
        known = [thing for thing in reading.objects if thing.known]
        there = [b for a, b, word in reading.relations if a == 0 and not is_denied(word)]
        if fit is not None:
            return self._for_need(reading, fit.need, sentence, words, fit.stems)
        if known:
            return self._for_object(reading, known[0])
        if there:
            return self._for_related(reading, there[0])
        if reading.rooms:
            return self._for_room(reading, sentence)
        described = len(reading.things) > 1 or reading.denies
        need = None if described else self._needs.by_meaning(sentence)
        if need is not None:
            return self._for_need(reading, need, sentence, words)
        if reading.objects:
            return self._for_object(reading, reading.objects[0])
        if reading.denies:
            raise _only_denies(sentence)
        raise NoTarget(f"no known object, purpose or room in {sentence!r:.80} {_HINT}")

    def _for_need(
        self,
        reading: Reading,
        need: Need,
        sentence: str,
        words: Sequence[str],
        stated: frozenset[str] = frozenset(),
    ) -> dict[str, Any]:
        """What serves a need; what the sentence names for it ("sit on the sofa") goes before what the table
        has, unless it only states the need ("wash the *dishes*")."""
        draft = self._draft("implicit", reading)
        for label in (need.core, *need.or_):
            draft.avoid(label, _NOT_AT)  # "somewhere to sit, but not on the sofa"
        unwanted = draft.unwanted - set(reading.missing)
        serves = [label for label in (need.core, *need.or_) if label not in unwanted]
        if not serves:
            raise _only_denies(sentence)
        named = [thing for thing in reading.objects if stem(thing.label) not in stated] + [
            reading.things[b] for a, b, word in reading.relations if a == 0 and word in _AT
        ]
        own = [thing for thing in named if thing.label in serves]
        if own:
            draft.kind = "implicit" if own[0].label == need.core else "explicit"
            draft.name_core(own[0])
        else:
            qualities = self._tables.qualities
            attributes = [a for a in draft.things[0].attributes if a not in qualities]
            draft.name_core(Thing(serves[0], attributes))
        if draft.things[0].label == need.core:  # another thing has other company
            for entry in need.with_:
                label, relation = self._companion(entry)
                draft.add(label, relation, again=need.with_.count(entry) > 1)
        draft.drop_denied(draft.things[0].label)  # "there is no light here"
        for word in words:
            for label in self._tables.qualities.get(word, ()):
                draft.add(label, "near")
        self._place_in_rooms(draft, reading.rooms, LANDMARKS_BESIDE)
        return draft.json()

    def _companion(self, entry: str) -> tuple[str, str]:
        """Label and relation of a need's companion: `laptop on` is a laptop on it, `mirror` one near it."""
        label, _, last = entry.rpartition(" ")
        return (label, last) if label and last in self._tables.relations else (entry, "near")

    def _for_object(self, reading: Reading, thing: Thing) -> dict[str, Any]:
        """What something shall be done with is what is looked for."""
        draft = self._draft("explicit", reading)
        draft.name_core(thing)
        self._place_in_rooms(draft, reading.rooms, LANDMARKS_BESIDE)
        return draft.json()

    def _for_related(self, reading: Reading, heir: int) -> dict[str, Any]:
        """A place that is only told by what is there: the first of it is looked for."""
        draft = self._draft("explicit", reading)
        draft.drop_core(heir)
        self._place_in_rooms(draft, reading.rooms, LANDMARKS_BESIDE)
        return draft.json()

    def _for_room(self, reading: Reading, sentence: str) -> dict[str, Any]:
        room, *others = reading.rooms
        draft = self._draft("implicit", reading)
        landmarks = [one for one in self._tables.rooms[room].landmarks if one not in draft.unwanted]
        if not landmarks:
            raise _only_denies(sentence)
        draft.things[0] = Thing(landmarks[0])
        self._place_in_rooms(draft, [room], len(landmarks))
        self._place_in_rooms(draft, others, 1)
        return draft.json()

    def _place_in_rooms(self, draft: Draft, rooms: Sequence[str], count: int) -> None:
        """Lets things be what their room calls them, and looks for the room's landmarks beside them."""
        for name in rooms:
            room = self._tables.rooms[name]
            for thing in draft.things:
                thing.label = room.says.get(thing.label, thing.label)
            for label in [one for one in room.landmarks if one != draft.things[0].label][:count]:
                draft.add(label, "near")
