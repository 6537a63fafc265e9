"""The tables of the lexicon as they are written: packaged YAML files, and a user's own laid over them.

Every file may hold any of the sections. Of mappings a later file replaces or adds lines, lists grow; so a
file of one line is enough to teach the lexicon a word.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from dssmsg.config_yaml import parse_yaml, read_yaml
from dssmsg.errors import ConfigError

FILES = ("labels.yaml", "grammar.yaml", "needs.yaml", "rooms.yaml")
Word = Annotated[str, Field(min_length=1, max_length=80)]
Phrase = Annotated[str, Field(min_length=1, max_length=300)]
_Share = Annotated[float, Field(ge=0, le=1)]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Label(_Section):
    """One household noun."""

    also: tuple[Word, ...] = ()
    like: tuple[Word, ...] = ()
    moves: _Share = 0.5
    company: tuple[Word, ...] = ()


class Surrounding(_Section):
    """How readily a label moves where one of `near` is around."""

    label: Word
    near: tuple[Word, ...] = Field(min_length=1)
    moves: _Share


class Need(_Section):
    """What people want to do, and what serves it."""

    says: tuple[Phrase, ...] = Field(min_length=1)
    about: Phrase
    core: Word
    with_: tuple[Word, ...] = Field((), alias="with")
    or_: tuple[Word, ...] = Field((), alias="or")


class Room(_Section):
    """A room by what stands in it."""

    also: tuple[Word, ...] = ()
    landmarks: tuple[Word, ...] = Field(min_length=1)
    says: Mapping[Word, Word] = {}


class Frames(_Section):
    """What is stripped from the front of a sentence."""

    polite: tuple[Word, ...] = ()
    about: tuple[Word, ...] = ()


class Tables(_Section):
    """All sections; see the comments of the packaged files for what each is."""

    labels: Mapping[Word, Label] = {}
    surroundings: tuple[Surrounding, ...] = ()
    relations: Mapping[Word, tuple[Word, ...]] = {}
    attributes: Mapping[Word, tuple[Word, ...]] = {}
    numbers: Mapping[Word, Annotated[int, Field(ge=1, le=20)]] = {}
    frames: Frames = Frames()
    wants: tuple[Word, ...] = ()
    refuses: tuple[Word, ...] = ()
    places: tuple[Word, ...] = ()
    parts: tuple[Word, ...] = ()
    structure: tuple[Word, ...] = ()
    determiners: tuple[Word, ...] = ()
    conjunctions: tuple[Word, ...] = ()
    alternatives: tuple[Word, ...] = ()
    negations: Mapping[Word, Annotated[str, Field(max_length=80)]] = {}
    pronouns: tuple[Word, ...] = ()
    existence: tuple[Word, ...] = ()
    purpose: tuple[Word, ...] = ()
    fillers: tuple[Word, ...] = ()
    verbs: tuple[Word, ...] = ()
    past: tuple[Word, ...] = ()
    needs: tuple[Need, ...] = ()
    qualities: Mapping[Word, tuple[Word, ...]] = {}
    rooms: Mapping[Word, Room] = {}

    @field_validator("negations", mode="before")
    @classmethod
    def _say_what_they_deny(cls, value: Any) -> Any:
        if isinstance(value, list):
            raise ValueError(
                "write each wording with the relation that it denies, as in {lacking: with, isn't: ''}"
            )
        return value


def load_tables(own: Iterable[Path] = ()) -> Tables:
    """The packaged tables with a user's own over them, in their order.

    Raises ConfigError naming the file and the key that is wrong and what is expected there.
    """
    folder = resources.files("dssmsg") / "data" / "lexicon"
    merged: dict[str, Any] = {}
    for name in FILES:
        _merge(merged, parse_yaml((folder / name).read_text("utf-8"), file=name))
    for path in own:
        written = read_yaml(path)
        _checked(written, path)
        _merge(merged, written)
        _check_negations(_checked(merged, path), path)
    return _checked(merged, None)


def _check_negations(tables: Tables, path: Path) -> None:
    """Raises ConfigError where a negation denies a relation that no table has."""
    for wording, denied in tables.negations.items():
        if denied and denied not in tables.relations:
            raise ConfigError(f"negations.{wording}: no relation {denied!r} in any table", file=path)


def _checked(values: Mapping[str, Any], path: Path | None) -> Tables:
    try:
        return Tables.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "file"
        raise ConfigError(f"{place}: {first['msg']}", file=path) from None


def _merge(into: dict[str, Any], values: Mapping[str, Any]) -> None:
    """Mappings line by line (a label's own line as a whole), lists by appending."""
    for section, value in values.items():
        old = into.get(section)
        if isinstance(value, Mapping) and isinstance(old, Mapping):
            into[section] = {**old, **value}
        elif isinstance(value, list) and isinstance(old, list):
            into[section] = [*old, *value]
        else:
            into[section] = value
