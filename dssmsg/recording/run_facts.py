"""The facts that a run begins with, checked: whoever reads them may rely on their names and types."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_TEXT_OR_NONE = (str, type(None))
_RUN: Mapping[str, type | tuple[type, ...]] = {
    "run_id": str,
    "name": str,
    "seed": int,
    "config": dict,
    "plugins": dict,
    "versions": dict,
    "parent": _TEXT_OR_NONE,
    "feature_space": _TEXT_OR_NONE,
    "images": str,
    "source": dict,
}
_SOURCE: Mapping[str, type | tuple[type, ...]] = {
    "name": str,
    "scene": str,
    "drivable": bool,
    "has_truth": bool,
    "visits": (int, type(None)),
    "credits": list,
    "facts": dict,
}


def checked_facts(facts: Mapping[str, Any]) -> dict[str, Any]:
    """The facts of a run as they were told. Raises ValueError naming what is missing or of another type."""
    _check(facts, _RUN, "")
    _check(facts["source"], _SOURCE, "source.")
    return dict(facts)


def _check(facts: Mapping[str, Any], kinds: Mapping[str, type | tuple[type, ...]], place: str) -> None:
    for name, kind in kinds.items():
        value = facts.get(name)
        if name not in facts or not isinstance(value, kind):
            names = [one.__name__ for one in (kind if isinstance(kind, tuple) else (kind,))]
            raise ValueError(f"{place}{name}: expected {' or '.join(names)}, got {type(value).__name__}")
