"""What of a recorded row is a decision, and where two rows are not the same.

Scores, thresholds and stored appearance lead to a decision or come along with it. Where they alone differ,
both runs decided the same: a trace. Decisions that follow from them are rows of their own.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

Json = dict[str, Any]

NUMBERS, APPEARANCE = "numbers", "appearance"
KIND_OF_TRACE = {
    "scores": NUMBERS,
    "colors": APPEARANCE,
    "text_feature": APPEARANCE,
    "image_feature": APPEARANCE,
}
"""Field of a change that is no decision -> what a difference in it is a trace of."""
_LONGEST = 160


def change_decision(row: Json) -> Json:
    """Of a change of the graph: what became of which object, viewpoint or edge."""
    return _without(row, "cause", *KIND_OF_TRACE)


def window_decision(row: Json) -> Json:
    """Of a window: what each frame says of each object, and the verdicts."""
    evidence = [_without(one, "values") for one in row["evidence"]]
    return {**_without(row, "threshold"), "evidence": evidence}


def match_decision(row: Json) -> Json:
    """Of a match: the target graph, and the candidates in their order, each with what it took for what."""
    return {**row, "candidates": [_without(one, "scores", "reason") for one in row["candidates"]]}


def whole(row: Json) -> Json:
    """Of a row that is all result."""
    return row


def _without(row: Json, *names: str) -> Json:
    return {name: value for name, value in row.items() if name not in names}


def differing(ours: Json, theirs: Json) -> tuple[str, ...]:
    """Names of the fields that are not the same in both rows."""
    return tuple(name for name in dict.fromkeys([*ours, *theirs]) if ours.get(name) != theirs.get(name))


def told_apart(ours: Json, theirs: Json) -> tuple[str, str]:
    """What each of two rows says where the other says otherwise; arrays have no words and are left out."""
    sides: tuple[list[str], list[str]] = [], []
    for place, *values in _leaves(ours, theirs):
        for side, value in zip(sides, values, strict=True):
            side.append(f"{place} {json.dumps(value, sort_keys=True)}")
    return _cut(", ".join(sides[0])), _cut(", ".join(sides[1]))


def _leaves(ours: Any, theirs: Any, place: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Where two JSON values differ, as deep as both have the same shape."""
    if ours == theirs:
        return
    if isinstance(ours, Mapping) and isinstance(theirs, Mapping):
        if "blob" in ours or "blob" in theirs:
            return
        for name in dict.fromkeys([*ours, *theirs]):
            inner = f"{place}.{name}" if place else str(name)
            yield from _leaves(ours.get(name), theirs.get(name), inner)
    elif isinstance(ours, list) and isinstance(theirs, list) and len(ours) == len(theirs):
        for number, (one, other) in enumerate(zip(ours, theirs, strict=True)):
            yield from _leaves(one, other, f"{place}[{number}]")
    else:
        yield place, ours, theirs


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
