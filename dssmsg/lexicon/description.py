"""What a sentence says of a thing before it names it, or after: its attributes.

`not red` is a denied one, `red or blue` one of which either will do (`dssmsg.graph.attribute_check`).
"""

from __future__ import annotations

MAX_CHARACTERS = 80
"""The longest attribute of a target graph."""


class Description:
    """Attributes as the words of a sentence give them."""

    def __init__(self) -> None:
        self._words: list[str] = []
        self._row = 0  # where the last row of attributes begins that "and", "or" and commas join
        self._joined = False
        self._either = False
        self._denied = False

    def __bool__(self) -> bool:
        return bool(self._words)

    @property
    def attributes(self) -> tuple[str, ...]:
        """What was said, in its order."""
        return tuple(self._words)

    @property
    def denied(self) -> bool:
        """Whether what comes next is denied."""
        return self._denied

    @property
    def joined(self) -> bool:
        """Whether "and" or the like came last."""
        return self._joined

    @property
    def either(self) -> bool:
        """Whether that was an "or"."""
        return self._either

    def deny(self, denied: bool = True) -> None:
        """Attributes from here on are denied, or no longer."""
        self._denied = denied

    def join(self, *, either: bool) -> None:
        """A word between two attributes; `either` of the two will do, else both are meant."""
        self._joined = True
        self._either = self._either or either

    def add(self, word: str) -> None:
        """One more attribute; "not red or blue" denies both."""
        if not self._joined:
            self._row = len(self._words)
        if self._denied:
            self._words.append(f"not {word}")
        elif self._either and self._row < len(self._words):
            choice = " or ".join((*self._words[self._row :], word))
            if len(choice) <= MAX_CHARACTERS:
                self._words[self._row :] = [choice]
        else:
            self._words.append(word)
        self._joined = self._either = False
