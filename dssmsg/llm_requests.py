"""What every LLM plug-in shares: the identity of a request, and holding an answer against its schema.

The schema language is the part of JSON Schema that our requests use; a keyword that is not known is an error,
never silently passed over.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

from dssmsg.interfaces.llm import Message

_TYPES: Mapping[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "integer": (int,),
    "number": (int, float),
    "boolean": (bool,),
    "null": (type(None),),
}
_OF_OBJECTS = frozenset({"properties", "required", "additionalProperties"})
_NOTES = frozenset({"$schema", "title", "description", "default", "examples"})


def request_hash(role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> str:
    """SHA-256 over the canonical JSON of a request: the same question has the same hash, in every run."""
    request = {
        "role": role,
        "messages": [{"role": m.role, "content": m.content} for m in messages],
        "schema": schema,
    }
    canonical = json.dumps(request, sort_keys=True, separators=(",", ":"), ensure_ascii=True, default=dict)
    return hashlib.sha256(canonical.encode()).hexdigest()


def parse_answer(text: str, schema: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON object in an answer that fits `schema`.

    Raises ValueError saying what is wrong: no JSON, not an object, or where it does not fit.
    """
    try:
        value = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"the answer is no JSON: {error}") from None
    faults = schema_faults(value, schema)
    if faults:
        raise ValueError("the answer does not fit its schema: " + "; ".join(faults[:3]))
    if not isinstance(value, dict):
        raise ValueError(f"expected a JSON object as the answer, got {type(value).__name__}")
    return value


def schema_faults(value: Any, schema: Mapping[str, Any], place: str = "answer") -> list[str]:
    """Where a JSON value does not fit a schema, in reading order; empty if it fits.

    Raises ValueError for a keyword outside the known part of JSON Schema.
    """
    faults: list[str] = []
    kind = schema.get("type")
    if kind is not None and not _is(value, kind):
        return [f"{place}: expected {kind}, got {type(value).__name__}"]
    for keyword, limit in schema.items():
        if keyword == "type" or keyword in _OF_OBJECTS or keyword in _NOTES:
            continue
        if keyword == "enum":
            if value not in limit:
                faults.append(f"{place}: expected one of {', '.join(map(str, limit))}, got {value!r:.60}")
        elif keyword == "items":
            for index, item in enumerate(value if isinstance(value, list) else ()):
                faults += schema_faults(item, limit, f"{place}[{index}]")
        elif keyword in ("minItems", "minLength", "minimum"):
            size = _size(value, keyword)
            if size is not None and size < limit:
                faults.append(f"{place}: expected at least {limit}, got {size}")
        elif keyword in ("maxItems", "maxLength", "maximum"):
            size = _size(value, keyword)
            if size is not None and size > limit:
                faults.append(f"{place}: expected at most {limit}, got {size}")
        else:
            raise ValueError(f"schema keyword {keyword!r} is not known")
    if isinstance(value, dict) and not _OF_OBJECTS.isdisjoint(schema):
        faults += _object_faults(value, schema, place)
    return faults


def _object_faults(value: Mapping[str, Any], schema: Mapping[str, Any], place: str) -> list[str]:
    properties = schema.get("properties", {})
    faults = [f"{place}: {key} is missing" for key in schema.get("required", ()) if key not in value]
    for key, item in value.items():
        if key in properties:
            faults += schema_faults(item, properties[key], f"{place}.{key}")
        elif schema.get("additionalProperties") is False:
            faults.append(f"{place}: {key!r:.40} is not known, expected {', '.join(properties)}")
    return faults


def _is(value: Any, kind: str) -> bool:
    if isinstance(value, bool):
        return kind == "boolean"
    return isinstance(value, _TYPES[kind])


def _size(value: Any, keyword: str) -> float | None:
    """What a limit is held against: items, characters or the number itself; None where it does not apply."""
    if keyword.endswith("Items"):
        return len(value) if isinstance(value, list) else None
    if keyword.endswith("Length"):
        return len(value) if isinstance(value, str) else None
    return value if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON")
