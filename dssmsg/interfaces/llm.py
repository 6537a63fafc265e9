"""llm: messages + JSON schema -> validated object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable


@dataclass(frozen=True, slots=True)
class Message:
    """One turn: role `system`, `user` or `assistant`."""

    role: str
    content: str


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What came back: `value` fits the schema; `text` is the raw answer."""

    value: Mapping[str, Any]
    text: str
    tokens: int | None = None


@runtime_checkable
class Llm(Protocol):
    """Messages + JSON schema -> validated object."""

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """Answer for a role (`target_graph`, `dynamic_attribute`); raises PluginError when there is none."""
        ...
