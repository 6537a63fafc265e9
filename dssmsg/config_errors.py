"""pydantic's findings as one sentence with a dotted key and what would be accepted."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from dssmsg.config_yaml import describe
from dssmsg.errors import ConfigError

_EXPECTED = {
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_parsing_size": "a smaller whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "string_type": "text",
    "path_type": "a path",
    "list_type": "a list",
    "tuple_type": "a list",
    "set_type": "a list",
    "dict_type": "a mapping",
    "mapping_type": "a mapping",
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
    "none_required": "nothing",
}


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """`; did you mean 'oracle'?`, or nothing where no known word is near."""
    words = list(known)
    near = difflib.get_close_matches(word, words, n=1, cutoff=0.6) or [
        one for one in words if len(word) > 3 and (word in one or one in word)
    ]
    return f"; did you mean '{near[0]}'?" if near else ""


def choices(words: Iterable[str]) -> str:
    """The words as `a, b or c`."""
    listed = list(words)
    if len(listed) < 2:
        return "".join(listed)
    return f"{', '.join(listed[:-1])} or {listed[-1]}"


def validate(
    model: type[BaseModel], data: Mapping[str, Any], *, key: str = "", file: str | None = None
) -> Any:
    """`model` made from `data`; a ConfigError names the first wrong key below `key` and counts the others."""
    try:
        return model.model_validate(dict(data))
    except ValidationError as error:
        found = error.errors(include_url=False)
        where, message = explain(found[0], data, model)
        if len(found) > 1:
            others = [explain(one, data, model)[0] for one in found[1:]]
            named = list(dict.fromkeys(other for other in others if other and other != where))
            if named:
                message += f" (also wrong: {', '.join(named[:5])}{', ...' if len(named) > 5 else ''})"
        dotted = (
            where if not key else f"{key}.{where}" if where and not where.startswith("[") else key + where
        )
        raise ConfigError(message, file=file, key=dotted or None) from error


def explain(finding: Mapping[str, Any], data: Any, model: type[BaseModel]) -> tuple[str, str]:
    """(dotted key, sentence) of one pydantic finding about `data`."""
    kind, value, context = finding["type"], finding.get("input"), finding.get("ctx") or {}
    key = dotted_key(finding["loc"], data, keep_last=kind in ("missing", "extra_forbidden"))
    if kind == "extra_forbidden":
        word, known = str(finding["loc"][-1]), _fields(model, finding["loc"][:-1])
        accepted = f"; accepted here: {', '.join(known)}" if known else "; nothing can be set here"
        return key, f"unknown key{did_you_mean(word, known) or accepted}"
    if kind == "missing":
        return key, "is missing and has no default"
    if kind in ("literal_error", "enum"):
        expected = str(context.get("expected", "")).replace("'", "")
        near = (
            did_you_mean(value, expected.replace(" or ", ", ").split(", ")) if isinstance(value, str) else ""
        )
        return key, f"expected {expected}, got {describe(value)}{near}"
    if kind in _EXPECTED:
        return key, f"expected {_EXPECTED[kind]}, got {describe(value)}"
    if kind in ("value_error", "assertion_error"):
        return key, str(context.get("error", finding["msg"]))
    for name, sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<=")):
        if name in context:
            return key, f"expected a number {sign} {context[name]}, got {describe(value)}"
    message = str(finding["msg"])
    return key, f"{message[:1].lower()}{message[1:]}, got {describe(value)}"


def dotted_key(location: Sequence[Any], data: Any, *, keep_last: bool = False) -> str:
    """`mission.phases[1]` from a pydantic location, following the data.

    A location also holds the names of a union's branches; what leads nowhere in the data is left out.
    """
    key, here = "", data
    for place, part in enumerate(location):
        if isinstance(here, Mapping) and part in here:
            key, here = f"{key}.{part}" if key else str(part), here[part]
        elif isinstance(here, (list, tuple)) and isinstance(part, int) and 0 <= part < len(here):
            key, here = f"{key}[{part}]", here[part]
        elif keep_last and place == len(location) - 1 and isinstance(part, str):
            key = f"{key}.{part}" if key else part
    return key


def _fields(model: type[BaseModel], location: Sequence[Any]) -> list[str]:
    """Names of the fields at a location inside a model; empty where no model can be found there."""
    here: Any = model
    for part in location:
        field = getattr(here, "model_fields", {}).get(part)
        if field is not None:
            here = _model_in(field.annotation)
        # otherwise an index, a mapping's key or a union's branch: the model stays the one found last
    return list(getattr(here, "model_fields", {}))


def _model_in(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for part in getattr(annotation, "__args__", ()):
        found = _model_in(part)
        if found is not None:
            return found
    return None
