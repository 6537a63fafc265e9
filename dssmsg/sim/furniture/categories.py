"""The table of categories: which pieces there are, how large, and what they are made of without assets."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

from dssmsg.config_yaml import parse_yaml
from dssmsg.errors import InputError

TABLE = "data/furniture/categories.yaml"


@dataclass(frozen=True, slots=True)
class Piece:
    """One model of a category: size (x, y, z) and elevation in metres, its colour in the embedded set."""

    model: str
    size: tuple[float, float, float]
    elevation: float
    color: str


@dataclass(frozen=True, slots=True)
class Category:
    """One row of the table; `pieces` has the default first; `parts` are primitives, see `embedded`.

    `real` says whether the pieces name models of the furniture libraries.
    """

    name: str
    label: str
    movable: bool
    real: bool
    pieces: tuple[Piece, ...]
    parts: tuple[str, ...]


def canonical(category: str) -> str:
    """The spelling of the table: lower case, words apart (`Coffee_Table` -> `coffee table`)."""
    return " ".join(category.lower().replace("_", " ").replace("-", " ").split())


@functools.cache
def load_categories() -> Mapping[str, Category]:
    """The packaged table, by canonical name. Raises InputError for a row that is not complete."""
    text = resources.files("dssmsg").joinpath(TABLE).read_text("utf-8")
    rows = parse_yaml(text, file=TABLE)
    return {name: _category(name, row) for name, row in rows.items()}


def _category(name: str, row: dict[str, Any]) -> Category:
    elevation = float(row.get("elevation", 0.0))
    colors = row.get("colors", ["a0a0a0"])
    models = row.get("models") or {name: row.get("size")}
    pieces = []
    for i, (model, numbers) in enumerate(models.items()):
        if not isinstance(numbers, list) or len(numbers) not in (3, 4):
            raise InputError("expected [width, depth, height] in metres", file=TABLE, key=f"{name}.{model}")
        width, depth, height = (float(x) for x in numbers[:3])
        own = float(numbers[3]) if len(numbers) == 4 else elevation
        pieces.append(Piece(model, (width, depth, height), own, colors[i % len(colors)]))
    if not row.get("parts"):
        raise InputError("expected a list of primitives", file=TABLE, key=f"{name}.parts")
    label = row.get("label", name)
    return Category(
        name, label, bool(row.get("movable", False)), "models" in row, tuple(pieces), tuple(row["parts"])
    )
