"""How a sentence begins: what it only asks with, what it wants, and what it does not want."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dssmsg.lexicon.tables import Tables
from dssmsg.lexicon.terms import openings


@dataclass(frozen=True, slots=True)
class Opening:
    """`rest` are the words after it. `asked`: a thing is asked for by its name; `wanted`: a wish is told,
    `refused`: what nobody wishes."""

    rest: tuple[str, ...]
    asked: bool = False
    wanted: bool = False
    refused: bool = False


class Openings:
    """Tells the opening of a sentence from the rest."""

    def __init__(self, tables: Tables) -> None:
        self._phrases = openings(tables)

    def of(self, words: Sequence[str]) -> Opening:
        """The opening of a sentence's words."""
        place, asked = 0, False
        while place < len(words):
            if words[place] in (",", ";"):
                place += 1
                continue
            term = self._phrases.at(words, place)
            if term is None:
                break
            place += len(term.words)
            refused = "refuses" in term.kinds
            if refused or "wants" in term.kinds:
                return Opening(tuple(words[place:]), wanted=True, refused=refused)
            asked = asked or "about" in term.kinds
        rest = tuple(words[place:])
        return Opening(rest, asked, wanted=bool(rest) and rest[0] in ("i", "we"))
