"""YAML as this project reads it: safe, bounded, and strict where YAML is lax.

Refused: files above 1 MB, documents that grow by aliases or nest too deeply, a key written twice, keys that
are not text, and tags. Dates stay text, and `1e-3` is a number. Every refusal is a ConfigError that names
the file and the line.
"""

from __future__ import annotations

import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from dssmsg.errors import ConfigError

MAX_BYTES = 1_000_000
MAX_DEPTH = 30
MAX_VALUES = 50_000

_MAP, _SEQ = "tag:yaml.org,2002:map", "tag:yaml.org,2002:seq"
_SCALARS = {f"tag:yaml.org,2002:{kind}" for kind in ("null", "bool", "int", "float", "str", "merge", "value")}
# YAML 1.1, which PyYAML follows, reads 2026-01-31 as a date, 12:30 as 750, 010 as 8, on as true and 1e-3 as
# text. Here scalars are what YAML 1.2 and a user take them for.
_PLAIN = {
    "bool": (r"(?:true|True|TRUE|false|False|FALSE)$", "tTfF"),
    "int": (r"(?:[-+]?(?:0|[1-9][0-9_]*)|0x[0-9a-fA-F]+)$", "-+0123456789"),
    "float": (
        r"(?:[-+]?(?:[0-9][0-9_]*\.[0-9_]*(?:[eE][-+]?[0-9]+)?|[0-9][0-9_]*[eE][-+]?[0-9]+"
        r"|\.[0-9][0-9_]*(?:[eE][-+]?[0-9]+)?|\.(?:inf|Inf|INF))|\.(?:nan|NaN|NAN))$",
        "-+.0123456789",
    ),
}


class _Loader(yaml.SafeLoader):
    """SafeLoader that checks the composed document before it builds a single value."""

    def get_single_data(self) -> Any:
        node = self.get_single_node()
        if node is None:
            return None
        _measure(node, 1, {}, set())
        return self.construct_document(node)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:merge":
                continue
            if not isinstance(key, yaml.ScalarNode) or key.tag != "tag:yaml.org,2002:str":
                shown = key.value if isinstance(key, yaml.ScalarNode) else "a list or mapping"
                raise _Refused(key, f"a key must be text, got {shown}; put it in quotes")
            if key.value in seen:
                raise _Refused(key, f"the key '{key.value}' is written twice")
            seen.add(key.value)
        return super().construct_mapping(node, deep=deep)


_REPLACED = ("timestamp", *_PLAIN)
_Loader.yaml_implicit_resolvers = {
    first: [(tag, regexp) for tag, regexp in resolvers if tag.rpartition(":")[2] not in _REPLACED]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _kind, (_pattern, _first) in _PLAIN.items():
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(_pattern), list(_first))


class _Refused(Exception):
    def __init__(self, node: Any, message: str) -> None:
        super().__init__(message)
        self.line = node.start_mark.line + 1


def _measure(node: Any, depth: int, known: dict[int, int], open_nodes: set[int]) -> int:
    """How many values a node stands for once its aliases are expanded; refuses what is too much."""
    if depth > MAX_DEPTH:
        raise _Refused(node, f"nested more than {MAX_DEPTH} levels deep")
    if id(node) in open_nodes:
        raise _Refused(node, "an alias that holds itself")
    if isinstance(node, yaml.ScalarNode):
        if node.tag not in _SCALARS:
            raise _Refused(node, f"the tag {_short(node.tag)} is not accepted; write plain values")
        return 1
    if node.tag not in (_MAP, _SEQ):
        raise _Refused(node, f"the tag {_short(node.tag)} is not accepted; write plain values")
    if id(node) in known:
        return known[id(node)]
    open_nodes.add(id(node))
    children = (
        node.value if isinstance(node, yaml.SequenceNode) else [part for pair in node.value for part in pair]
    )
    size = 1
    for child in children:
        size += _measure(child, depth + 1, known, open_nodes)
        if size > MAX_VALUES:
            raise _Refused(child, f"more than {MAX_VALUES:,} values once its aliases are expanded")
    open_nodes.remove(id(node))
    known[id(node)] = size
    return size


def _short(tag: str) -> str:
    return tag.replace("tag:yaml.org,2002:", "!!")


def parse_yaml(text: str, *, file: Path | str | None = None, key: str | None = None) -> Any:
    """The value that a YAML text stands for: None, bool, int, float, str, list or dict with text keys.

    `file` and `key` name the place in a ConfigError.
    """
    if len(text.encode("utf-8", "surrogatepass")) > MAX_BYTES:
        raise ConfigError(f"larger than {MAX_BYTES:,} bytes", file=file, key=key)
    loader: _Loader | None = None
    try:
        loader = _Loader(text)
        return loader.get_single_data()
    except _Refused as error:
        raise ConfigError(f"line {error.line}: {error}", file=file, key=key) from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark is not None else ""
        raise ConfigError(
            f"{line}not valid YAML: {error.problem or error.context}", file=file, key=key
        ) from error
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"not valid YAML: {reason}", file=file, key=key) from error
    except (ValueError, OverflowError) as error:
        raise ConfigError(f"not valid YAML: {error}", file=file, key=key) from error
    except RecursionError as error:
        raise ConfigError(f"nested more than {MAX_DEPTH} levels deep", file=file, key=key) from error
    finally:
        if loader is not None:
            loader.dispose()


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping that a YAML file holds; an empty file is an empty mapping.

    Raises ConfigError where the file is missing, a folder, unreadable, not UTF-8, too large or not a mapping.
    """
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise ConfigError("there is no such file", file=path) from error
    except IsADirectoryError as error:
        raise ConfigError("is a folder; expected a YAML file", file=path) from error
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror or error}", file=path) from error
    if len(raw) > MAX_BYTES:
        raise ConfigError(f"larger than {MAX_BYTES:,} bytes; expected a configuration in YAML", file=path)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"is not UTF-8 text (byte {error.start}); expected YAML", file=path) from error
    value = parse_yaml(text, file=path)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ConfigError(f"expected `key: value` lines, got {describe(value)}", file=path)
    return value


def dump_yaml(value: Any) -> str:
    """Plain values as YAML, keys in the given order."""
    text: str = yaml.safe_dump(value, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)
    return text


def describe(value: Any) -> str:
    """A value for an error message: short, and with its type where that is the point."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return repr(value if len(value) <= 60 else value[:57] + "...")
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, dict):
        return f"a mapping with {', '.join(map(str, list(value)[:4]))}" if value else "an empty mapping"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}" if value else "an empty list"
    return type(value).__name__
