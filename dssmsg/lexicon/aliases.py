"""Other names of the same things, from `dssmsg/data/aliases.yaml`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import resources

from dssmsg.config_yaml import parse_yaml


def builtin_aliases() -> dict[str, str]:
    """Other name -> canonical name, both as `plain_name` writes them."""
    text = resources.files("dssmsg").joinpath("data/aliases.yaml").read_text(encoding="utf-8")
    table: Mapping[str, Sequence[str]] = parse_yaml(text, file="aliases.yaml")
    return {
        plain_name(other): plain_name(canonical) for canonical, others in table.items() for other in others
    }


def plain_name(label: str) -> str:
    """A label in lower case, `_` as space, no space twice."""
    return " ".join(label.replace("_", " ").lower().split())
