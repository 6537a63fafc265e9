"""What every LLM plug-in shares: the identity of a request, and holding an answer against its schema.

The schema language is the part of JSON Schema that our requests use; a keyword that is not known is an error,
never silently passed over. One keyword is ours: `x-index-of: nodes` holds a whole number against the length
of the answer's list `nodes`, so that an index of nothing is a fault that a model is told and can repair.
"""

from __future__ import annotations

import hashlib
import json
import re
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
_FENCE = re.compile(r"```(?:json)?\s*\n(.*?)```", re.DOTALL | re.IGNORECASE)
_UNPRINTABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff]")
MAX_ANSWER_CHARS = 200_000
"""Longer answers are refused unread: the largest that fits one of our schemas has about 10,000 characters."""


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
    """The JSON object in an answer that fits `schema`; a fence or prose around it is left out.

    Raises ValueError saying what is wrong: too long, no JSON, not an object, or where it does not fit.
    """
    if len(text) > MAX_ANSWER_CHARS:
        raise ValueError(f"the answer has {len(text)} characters, at most {MAX_ANSWER_CHARS} are read")
    value = _json_in(text)
    faults = schema_faults(value, schema)
    if faults:
        raise ValueError("the answer does not fit its schema: " + "; ".join(faults[:3]))
    if not isinstance(value, dict):
        raise ValueError(f"expected a JSON object as the answer, got {type(value).__name__}")
    return value


def _json_in(text: str) -> Any:
    """The JSON value of a text, or of the object inside it. Raises ValueError if there is none."""
    try:
        return json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        fault = ValueError(f"the answer is no JSON: {error}")
    fenced = _FENCE.search(text)
    inside = fenced[1] if fenced else text
    start, end = inside.find("{"), inside.rfind("}")
    if 0 <= start < end:
        try:
            return json.loads(inside[start : end + 1], parse_constant=_refuse_constant)
        except (ValueError, RecursionError):
            pass
    raise fault


def schema_faults(
    value: Any, schema: Mapping[str, Any], place: str = "answer", *, whole: Any = None
) -> list[str]:
    """Where a JSON value does not fit a schema, in reading order; empty if it fits.

    `whole` is the whole answer where `value` is a part of it. Raises ValueError for a keyword outside the
    known part of JSON Schema.
    """
    whole = value if whole is None else whole
    faults: list[str] = []
    kind = schema.get("type")
    if kind is not None and not _is(value, kind):
        return [f"{place}: expected {kind}, got {type(value).__name__}"]
    if isinstance(value, str) and _UNPRINTABLE.search(value):
        faults.append(f"{place}: holds a control character or half of a character")
    for keyword, limit in schema.items():
        if keyword == "type" or keyword in _OF_OBJECTS or keyword in _NOTES:
            continue
        if keyword == "enum":
            if value not in limit:
                faults.append(f"{place}: expected one of {', '.join(map(str, limit))}, got {value!r:.60}")
        elif keyword == "items":
            for index, item in enumerate(value if isinstance(value, list) else ()):
                faults += schema_faults(item, limit, f"{place}[{index}]", whole=whole)
        elif keyword == "x-index-of":
            faults += _index_faults(value, limit, place, whole)
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
        faults += _object_faults(value, schema, place, whole)
    return faults


def _index_faults(value: Any, name: str, place: str, whole: Any) -> list[str]:
    """Whether a number is an index of the answer's list `name`; silent where that list is wrong itself."""
    listed = whole.get(name) if isinstance(whole, Mapping) else None
    if not isinstance(listed, list) or not isinstance(value, int) or value < len(listed):
        return []
    return [f"{place}: {value} is no index of {name}, there are {len(listed)} (counted from 0)"]


def _object_faults(value: Mapping[str, Any], schema: Mapping[str, Any], place: str, whole: Any) -> list[str]:
    properties = schema.get("properties", {})
    faults = [f"{place}: {key} is missing" for key in schema.get("required", ()) if key not in value]
    for key, item in value.items():
        if key in properties:
            faults += schema_faults(item, properties[key], f"{place}.{key}", whole=whole)
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
