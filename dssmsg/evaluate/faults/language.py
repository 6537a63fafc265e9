"""Faults of the language model: another target graph than the sentence's, or none at all."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dssmsg.errors import PluginError
from dssmsg.evaluate.faults.host import Aim
from dssmsg.interfaces import Answer, Context, Llm, Message

ROLE = "target_graph"


@dataclass(slots=True)
class WrongTarget:
    """The core of every target graph is another thing of the home."""

    inner: Llm
    context: Context
    aim: Aim

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """The inner answer, its core replaced."""
        answer = self.inner.complete(role, messages, schema)
        if role != ROLE:
            return answer
        other = self.aim.others[self.aim.seed % len(self.aim.others)]
        nodes = [dict(node) for node in answer.value["nodes"]]
        nodes[answer.value["core"]] = {"label": other, "attributes": []}
        value = {**answer.value, "nodes": nodes}
        return Answer(value, json.dumps(value), answer.tokens)


@dataclass(slots=True)
class ProviderDown:
    """Nobody answers questions about goals."""

    inner: Llm
    context: Context
    aim: Aim

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """Raises PluginError for a goal."""
        if role == ROLE:
            raise PluginError("cannot be reached: connection refused", plugin="llm/lexicon")
        return self.inner.complete(role, messages, schema)
