"""A schema as servers take it: the part of JSON Schema that structured outputs know, or as words."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

_KEPT = ("type", "enum", "description")
_JSON_TYPES = {str: "string", bool: "boolean", int: "integer", float: "number"}


def strict_schema(schema: Mapping[str, Any]) -> dict[str, Any] | None:
    """The schema with every property required and nothing else allowed, limits as descriptions.

    That is what the servers enforce by grammar; an answer that fits it and the limits fits the original. None
    where the original lets an object hold anything, which cannot be said so.
    """
    made = {key: schema[key] for key in _KEPT if key in schema}
    values = schema.get("enum")
    if values and "type" not in made:
        made["type"] = _JSON_TYPES.get(type(values[0]), "string")
    limits = _limits(schema)
    if limits:
        made["description"] = "; ".join(filter(None, (made.get("description"), limits)))
    if "items" in schema:
        items = strict_schema(schema["items"])
        if items is None:
            return None
        made["items"] = items
    if schema.get("type") == "object":
        if schema.get("additionalProperties") is not False or not schema.get("properties"):
            return None
        properties = {name: strict_schema(part) for name, part in schema["properties"].items()}
        if None in properties.values():
            return None
        made |= {"properties": properties, "required": list(properties), "additionalProperties": False}
    return made


def schema_words(schema: Mapping[str, Any]) -> str:
    """The sentence that asks for an answer of a schema, for servers that do not take one."""
    text = json.dumps(_plain(schema), sort_keys=True, separators=(",", ":"))
    return f"Answer with one JSON object and nothing else. It must fit this JSON schema: {text}"


def _plain(value: Any) -> Any:
    """The schema without our own keywords."""
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items() if not key.startswith("x-")}
    return [_plain(part) for part in value] if isinstance(value, (list, tuple)) else value


def _limits(schema: Mapping[str, Any]) -> str:
    words = []
    for low, high, unit in (
        ("minItems", "maxItems", " items"),
        ("minLength", "maxLength", " characters"),
        ("minimum", "maximum", ""),
    ):
        if low in schema:
            words.append(f"at least {schema[low]}{unit}")
        if high in schema:
            words.append(f"at most {schema[high]}{unit}")
    if "x-index-of" in schema:
        words.append(f"an index of {schema['x-index-of']}, counted from 0")
    return ", ".join(words)
