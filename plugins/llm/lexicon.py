"""llm/lexicon: no language model at all, a readable table of household words that answers offline.

It finds known labels, relations between them and attributes before them in a sentence, or the objects that a
named purpose or room stands for. What is not in the table it does not understand, and says so.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dssmsg.config_yaml import parse_yaml, read_yaml
from dssmsg.errors import ConfigError, PluginError
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.llm import Answer, Message
from dssmsg.llm_requests import parse_answer

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "llm/lexicon"
_UNDECIDED = 0.5
_WORD = re.compile(r"[a-z0-9]+(?:['-][a-z0-9]+)*")
Word = Annotated[str, Field(min_length=1, max_length=80)]


class Config(PluginConfig):
    """Options of `llm: {use: lexicon}`."""

    file: str | None = Field(
        None, description="A table of your own instead of the packaged one (lexicon.yaml)."
    )


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    also: tuple[Word, ...] = ()
    moves: float = Field(_UNDECIDED, ge=0, le=1)


class _Purpose(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    phrases: tuple[Word, ...] = Field(min_length=1)
    objects: tuple[Word, ...] = Field(min_length=1)


class _Table(BaseModel):
    """The file as it is written."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    labels: dict[Word, _Entry] = Field(min_length=1)
    purposes: tuple[_Purpose, ...] = ()
    rooms: dict[Word, Annotated[tuple[Word, ...], Field(min_length=1)]] = {}
    relations: tuple[Word, ...] = ()
    attributes: tuple[Word, ...] = ()


@dataclass(slots=True)
class _Found:
    """A label in a sentence, the attributes before it and the relation that leads to it."""

    label: str
    attributes: list[str] = field(default_factory=list)
    relation: str = ""


class Lexicon:
    """Answers the roles `target_graph` and `dynamic_attribute` from its table."""

    def __init__(self, config: Config, context: Context) -> None:
        table = _read_table(None if config.file is None else context.base_dir / config.file)
        self._moves = {label: entry.moves for label, entry in table.labels.items()}
        terms: dict[tuple[str, ...], tuple[str, str]] = {}
        for word in table.attributes:
            terms[_words(word)] = ("attribute", word)
        for word in table.relations:
            terms[_words(word)] = ("relation", word)
        for room in table.rooms:
            terms[_words(room)] = ("room", room)
        for index, purpose in enumerate(table.purposes):
            for phrase in purpose.phrases:
                terms[_words(phrase)] = ("purpose", str(index))
        for label, entry in table.labels.items():
            for word in (*entry.also, label):
                terms[_words(word)] = ("label", label)
        self._terms = terms
        self._longest = max(map(len, terms))
        self._table = table

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """The answer for a role, from the last user message.

        Raises PluginError where the table has nothing to say, or for a role that it does not know.
        """
        text = next((m.content for m in reversed(messages) if m.role == "user"), "")
        if role == "target_graph":
            value = self._target_graph(text)
        elif role == "dynamic_attribute":
            value = {"dynamic_attribute": self._dynamic_attribute(text)}
        else:
            raise PluginError(
                f"knows the roles target_graph and dynamic_attribute, not {role!r}", plugin=PLUGIN
            )
        answer = json.dumps(value)
        try:
            return Answer(parse_answer(answer, schema), answer)
        except ValueError as error:
            raise PluginError(str(error), plugin=PLUGIN) from None

    def _target_graph(self, sentence: str) -> dict[str, Any]:
        terms = self._find(sentence)
        found = self._labels(terms)
        rooms = [name for kind, name in terms if kind == "room"]
        if found:
            nodes = [{"label": f.label, "attributes": f.attributes} for f in found]
            edges = [
                {"source": i - 1, "target": i, "relation": f.relation or "near"}
                for i, f in enumerate(found)
                if i
            ]
            for room in rooms:
                self._add_room(room, nodes, edges)
            return {"kind": "explicit", "nodes": nodes, "edges": edges, "core": 0}
        purposes = [self._table.purposes[int(name)].objects for kind, name in terms if kind == "purpose"]
        objects = [
            label for group in (*purposes, *(self._table.rooms[room] for room in rooms)) for label in group
        ]
        objects = list(dict.fromkeys(objects))
        if not objects:
            raise PluginError(f"no known object, purpose or room in {sentence!r:.80}", plugin=PLUGIN)
        return {
            "kind": "implicit",
            "nodes": [{"label": label, "attributes": []} for label in objects],
            "edges": [{"source": 0, "target": i, "relation": "near"} for i in range(1, len(objects))],
            "core": 0,
        }

    def _add_room(self, room: str, nodes: list[dict[str, Any]], edges: list[dict[str, Any]]) -> None:
        """The first object that the room is known by, unless it is there already."""
        label = self._table.rooms[room][0]
        if all(node["label"] != label for node in nodes):
            nodes.append({"label": label, "attributes": []})
            edges.append({"source": 0, "target": len(nodes) - 1, "relation": "near"})

    def _dynamic_attribute(self, text: str) -> float:
        """How readily the first label in a text is moved; 0.5 for what the table does not know."""
        return next((self._moves[name] for kind, name in self._find(text) if kind == "label"), _UNDECIDED)

    @staticmethod
    def _labels(terms: Sequence[tuple[str, str]]) -> list[_Found]:
        """Labels in order with what stands before them; the same label twice is one."""
        found: list[_Found] = []
        attributes: list[str] = []
        relation = ""
        for kind, name in terms:
            if kind == "attribute":
                attributes.append(name)
            elif kind == "relation":
                relation = "near" if name in ("and", "with") else name
                attributes = []
            elif kind == "label":
                if all(f.label != name for f in found):
                    found.append(_Found(name, attributes, relation))
                attributes, relation = [], ""
        return found

    def _find(self, sentence: str) -> list[tuple[str, str]]:
        """Known terms (kind, name) of a sentence in order, the longest match first at every word."""
        words = _words(sentence)
        terms: list[tuple[str, str]] = []
        place = 0
        while place < len(words):
            for length in range(min(self._longest, len(words) - place), 0, -1):
                window = words[place : place + length]
                term = self._terms.get(window) or self._terms.get((*window[:-1], _singular(window[-1])))
                if term is not None:
                    terms.append(term)
                    place += length
                    break
            else:
                place += 1
        return terms


def _words(text: str) -> tuple[str, ...]:
    return tuple(_WORD.findall(text.lower()))


def _singular(word: str) -> str:
    """The likely singular of an English plural."""
    if word.endswith("ies") and len(word) > 4:
        return word[:-3] + "y"
    if word.endswith("ves") and len(word) > 4:
        return word[:-3] + "f"
    if word.endswith(("ches", "shes", "sses", "xes")):
        return word[:-2]
    return word[:-1] if word.endswith("s") and not word.endswith("ss") else word


def _read_table(path: Path | None) -> _Table:
    """The table of a file, or the packaged one. Raises ConfigError naming the file and the key."""
    try:
        if path is None:
            packaged = resources.files("dssmsg") / "data" / "lexicon.yaml"
            return _Table.model_validate(parse_yaml(packaged.read_text("utf-8"), file="lexicon.yaml"))
        return _Table.model_validate(read_yaml(path))
    except ConfigError as error:
        error.key = ".file"
        raise
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "file"
        raise ConfigError(f"{place}: {first['msg']}", file=path, key=".file") from None


@hookimpl
def register_llm(register: Register) -> None:
    """`lexicon`: a table of words, offline."""
    register("lexicon", Lexicon, config=Config)
