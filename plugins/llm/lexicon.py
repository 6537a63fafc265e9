"""llm/lexicon: no language model at all, readable tables of household English that answer offline.

Explicit sentences are parsed, implicit ones go through tables of needs and rooms and, where no wording fits,
through the text encoder (`dssmsg.lexicon`). What it does not understand, it says so.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pydantic import Field

from dssmsg.dynamic_attribute import ROLE
from dssmsg.errors import ConfigError, NotUnderstood, PluginError
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.llm import Answer, Message
from dssmsg.llm_requests import parse_answer

if TYPE_CHECKING:
    from dssmsg.interfaces import Context
    from dssmsg.lexicon.movement import Movement
    from dssmsg.lexicon.target import Targets

PLUGIN = "llm/lexicon"
_ROLES = ("target_graph", ROLE)


class Config(PluginConfig):
    """Options of `llm: {use: lexicon}`."""

    tables: tuple[str, ...] = Field(
        (), description="YAML tables of your own over the packaged ones (relative to the configuration file)."
    )
    encoder: bool = Field(True, description="Whether the text encoder helps where no wording fits.")


class Lexicon:
    """Answers the roles `target_graph` and `dynamic_attribute` from its tables; the same question alike."""

    def __init__(self, config: Config, context: Context) -> None:
        """Raises ConfigError naming the table of the user's own that does not read, and its key."""
        self._files = [context.base_dir / name for name in config.tables]
        self._encoder = context.encoder if config.encoder else None
        if self._files:
            _ = self._parts  # said before the run begins; the packaged tables need not be read to be right

    @cached_property
    def _parts(self) -> tuple[Targets, Movement]:
        """What answers either role; the tables take half a second to read."""
        from dssmsg.lexicon.movement import Movement
        from dssmsg.lexicon.tables import load_tables
        from dssmsg.lexicon.target import Targets

        try:
            tables = load_tables(self._files)
        except ConfigError as error:
            error.key = ".tables"
            raise
        return Targets(tables, self._encoder), Movement(tables, self._encoder)

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """The answer for a role, from the last user message.

        Raises NotUnderstood where the tables have nothing to say, PluginError for a role that is not known.
        """
        from dssmsg.lexicon.target import NoTarget

        text = next((m.content for m in reversed(messages) if m.role == "user"), "")
        if role not in _ROLES:
            raise PluginError(f"knows the roles {' and '.join(_ROLES)}, not {role!r}", plugin=PLUGIN)
        try:
            targets, movement = self._parts
            value = targets.of(text) if role != ROLE else {ROLE: movement.answer(text)}
        except NoTarget as error:
            raise NotUnderstood(str(error), plugin=PLUGIN) from None
        answer = json.dumps(value)
        try:
            return Answer(parse_answer(answer, schema), answer)
        except ValueError as error:
            raise PluginError(str(error), plugin=PLUGIN) from None


@hookimpl
def register_llm(register: Register) -> None:
    """`lexicon`: tables of words, offline."""
    register("lexicon", Lexicon, config=Config)
