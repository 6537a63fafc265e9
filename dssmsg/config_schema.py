"""The JSON schema of a configuration file, and a plug-in's options as a list."""

from __future__ import annotations

import json
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from dssmsg.config import SLOT_KINDS, RunConfig
from dssmsg.host import Host, Registration

_FROM_A_CLASS = {
    "type": "object",
    "properties": {
        "use": {"type": "string", "pattern": ":", "description": "package.module:Class or file.py:Class"}
    },
    "required": ["use"],
}
_WITHOUT_USE = {
    "type": "object",
    "not": {"required": ["use"]},
    "description": "Options of the plug-in that a lower layer names.",
}


def file_schema(host: Host) -> dict[str, Any]:
    """JSON schema of a file: nothing is required, a slot's options are those of the plug-in it names."""
    registered = host.registrations()
    models: list[type[BaseModel]] = list(dict.fromkeys([RunConfig, *(one.config for one in registered)]))
    references, combined = models_json_schema(
        [(model, "validation") for model in models], ref_template="#/$defs/{model}"
    )
    definitions: dict[str, Any] = combined.get("$defs", {})

    def resolve(model: type[BaseModel]) -> dict[str, Any]:
        reference: str = references[model, "validation"]["$ref"]
        found: dict[str, Any] = definitions[reference.rpartition("/")[2]]
        return found

    schema = json.loads(json.dumps(resolve(RunConfig)))
    schema.pop("required", None)
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "dssmsg.yaml"
    paths = {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}
    schema["properties"]["include"] = paths | {
        "description": "Files whose values lie below those of this file."
    }
    for kind in SLOT_KINDS:
        choices = [_choice(one, resolve(one.config)) for one in host.registrations(kind)]
        description = schema["properties"][kind].get("description", "")
        schema["properties"][kind] = {
            "description": description,
            "anyOf": [*choices, _FROM_A_CLASS, _WITHOUT_USE],
        }
    observers = {
        one.name: {"anyOf": [_choice(one, resolve(one.config), named=True), {"type": ["boolean", "null"]}]}
        for one in host.registrations("observer")
    }
    recording = definitions["RecordingConfig"]
    recording.pop("required", None)
    recording["properties"]["observers"] |= {
        "properties": observers,
        "additionalProperties": {"anyOf": [_FROM_A_CLASS, {"type": "object"}, {"type": ["boolean", "null"]}]},
    }
    rules = [_choice(one, resolve(one.config)) for one in host.registrations("diagnosis")]
    schema["properties"]["diagnosis"]["items"] = {"anyOf": [*rules, _FROM_A_CLASS]}
    schema["$defs"] = definitions
    return _only_used(schema)


def _choice(one: Registration, options: dict[str, Any], *, named: bool = False) -> dict[str, Any]:
    """The schema of a slot that names this plug-in; `named` where the key does so already."""
    return {
        "type": "object",
        "title": one.id,
        "properties": {"use": {"const": one.name}, **options.get("properties", {})},
        "required": [*([] if named else ["use"]), *options.get("required", [])],
        "additionalProperties": False,
    }


def _only_used(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema without definitions that nothing refers to."""
    definitions, kept = schema.pop("$defs"), {}
    waiting = [json.dumps(schema)]
    while waiting:
        text = waiting.pop()
        for name, definition in definitions.items():
            if name not in kept and f'"#/$defs/{name}"' in text:
                kept[name] = definition
                waiting.append(json.dumps(definition))
    return {**schema, "$defs": dict(sorted(kept.items()))} if kept else schema


def options_of(model: type[BaseModel]) -> list[dict[str, Any]]:
    """Name, type, default and description of every field of a model."""
    schema = model.model_json_schema()
    rows = []
    for name, field in model.model_fields.items():
        default: Any = None
        if not field.is_required():
            value = field.get_default(call_default_factory=True, validated_data={})
            default = value.model_dump(mode="json") if isinstance(value, BaseModel) else _plain(value)
        rows.append(
            {
                "name": name,
                "type": type_text(schema["properties"][name], schema.get("$defs", {})),
                "default": default,
                "required": field.is_required(),
                "description": field.description or "",
            }
        )
    return rows


def _plain(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)


def type_text(schema: dict[str, Any], definitions: dict[str, Any]) -> str:
    """A field's JSON schema in a few words: `number > 0, <= 0.5`, `survey | revisit`, `list of text`."""
    if "$ref" in schema:
        return type_text(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    if "const" in schema:
        return str(schema["const"])
    if "enum" in schema:
        return " | ".join(map(str, schema["enum"]))
    for together in ("anyOf", "oneOf", "allOf"):
        if together in schema:
            parts = [type_text(one, definitions) for one in schema[together]]
            return " | ".join(dict.fromkeys(parts))
    kind = schema.get("type", "any value")
    if kind == "array":
        if "prefixItems" in schema:
            return f"[{', '.join(type_text(one, definitions) for one in schema['prefixItems'])}]"
        return f"list of {type_text(schema.get('items', {}), definitions)}"
    words = {
        "integer": "whole number",
        "string": "text",
        "boolean": "true | false",
        "object": "mapping",
        "null": "null",
    }
    signs = (("minimum", ">="), ("exclusiveMinimum", ">"), ("maximum", "<="), ("exclusiveMaximum", "<"))
    limits = [f"{sign} {schema[name]}" for name, sign in signs if name in schema]
    return f"{words.get(kind, kind)} {', '.join(limits)}".strip()
