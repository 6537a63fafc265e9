"""A recorded match, its target graph checked: a damaged or hostile recording may hold anything there."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dssmsg.recording.damage import reading
from dssmsg.target_graph import parse_target_graph, target_graph_json

Json = Mapping[str, Any]


def whole_match(match: Json, path: Path) -> Json:
    """A match with all parts of its target graph. Raises InputError where they do not fit."""
    with reading(path, "the target graph of a match"):
        target = parse_target_graph(match["query"], match["target"])
    return {**match, "target": target_graph_json(target)}
