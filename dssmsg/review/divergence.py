"""A difference between two runs: where it is, whose it is, and how both sides put it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from dssmsg.recording.reader import Recording


@dataclass(frozen=True, slots=True)
class Term:
    """A score that both sides of a divergence have, with the threshold that it was held against, if any."""

    name: str
    a: float | None
    b: float | None
    threshold_a: float | None
    threshold_b: float | None


@dataclass(frozen=True, slots=True)
class Divergence:
    """The first difference: in which frame, of which layer and plug-in, and both sides of it in words.

    `fields` names what differs; `scores` are the terms of the two decisions; `consequence` is False for a
    trace.
    """

    frame: int
    layer: str
    plugin: str
    what: str
    a: str = ""
    b: str = ""
    fields: tuple[str, ...] = ()
    scores: tuple[Term, ...] = ()
    consequence: bool = True


def parted(
    frame: int,
    layer: str,
    plugin: str,
    what: str,
    sides: Iterable[str] = ("", ""),
    fields: Sequence[str] = (),
    scores: Sequence[Term] = (),
    consequence: bool = True,
) -> Divergence:
    """A divergence, its two sides given in one."""
    ours, theirs = sides
    return Divergence(frame, layer, plugin, what, ours, theirs, tuple(fields), tuple(scores), consequence)


def plugin_of(recording: Recording, kind: str) -> str:
    """The plug-in that a run had of a kind, as `kind/name`."""
    made: Callable[[str], Any] = recording.facts.get("plugins", {}).get
    return f"{kind}/{(made(kind) or {}).get('name', '?')}"
