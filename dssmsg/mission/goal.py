"""A sentence becomes a target graph: the request to the LLM and the schema of its answer (paper III-C)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dssmsg.interfaces import Message

TARGET_GRAPH_SCHEMA: Mapping[str, Any] = {
    "type": "object",
    "additionalProperties": False,
    "required": ["kind", "nodes", "edges", "core"],
    "properties": {
        "kind": {"enum": ["explicit", "implicit"]},
        "nodes": {
            "type": "array",
            "minItems": 1,
            "maxItems": 20,
            "items": {
                "type": "object",
                "additionalProperties": False,
                "required": ["label"],
                "properties": {
                    "label": {"type": "string", "minLength": 1, "maxLength": 80},
                    "attributes": {
                        "type": "array",
                        "maxItems": 8,
                        "items": {"type": "string", "maxLength": 80},
                    },
                },
            },
        },
        "edges": {
            "type": "array",
            "maxItems": 60,
            "items": {
                "type": "object",
                "additionalProperties": False,
                "required": ["source", "target", "relation"],
                "properties": {
                    "source": {"type": "integer", "minimum": 0, "x-index-of": "nodes"},
                    "target": {"type": "integer", "minimum": 0, "x-index-of": "nodes"},
                    "relation": {"type": "string", "maxLength": 40},
                },
            },
        },
        "core": {"type": "integer", "minimum": 0, "x-index-of": "nodes"},
    },
}

_INSTRUCTIONS = (
    "You turn a sentence about a place or an object in a home into a target graph. Nodes are object labels "
    "(singular nouns) with attributes such as colours; edges are spatial relations between two nodes, by "
    "index; core is the index of the node that the sentence is about. kind is explicit where the sentence "
    "names the objects, implicit where it only names a purpose: then list the objects that such a place "
    "usually has. "
    "Answer with JSON alone."
)


def target_graph_request(sentence: str) -> tuple[Message, ...]:
    """The messages that ask for the target graph of a sentence."""
    return (Message("system", _INSTRUCTIONS), Message("user", sentence))
