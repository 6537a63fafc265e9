"""llm: messages + JSON schema -> validated object."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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


@dataclass(frozen=True, slots=True, eq=False)
class Exchange:
    """One exchange on the way to an answer, failed ones too: what was sent and what came of it.

    `error` is empty where the answer was accepted; `attempt` counts the exchanges of one question from 1;
    `fallback_for` names the provider that failed where this one stood in. No key is in any of the texts.
    """

    provider: str
    messages: tuple[Message, ...]
    text: str = ""
    error: str = ""
    tokens: int | None = None
    seconds: float = 0.0
    attempt: int = 1
    fallback_for: str = ""


@runtime_checkable
class Llm(Protocol):
    """Messages + JSON schema -> validated object."""

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """Answer for a role (`target_graph`, `dynamic_attribute`).

        Raises PluginError when there is none; NotUnderstood, which is one, when that is due to the sentence.
        """
        ...


@runtime_checkable
class TellsExchanges(Protocol):
    """An `llm` that may need several exchanges for one answer, and tells each as soon as it is over.

    The host records one call per exchange then, instead of one per answer.
    """

    def tell_exchanges(self, tell: Callable[[Exchange], None]) -> None:
        """Call `tell` for every exchange from now on, on the thread that asked."""
        ...
