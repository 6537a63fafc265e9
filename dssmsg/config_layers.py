"""Where the values of a configuration come from: default < included files < file < environment < --set.

Each layer is a nested mapping with a label that an error can name. Merging is deep for mappings; lists
and single values are replaced. A layer that changes `use` in a slot drops the lower layers' options of
that slot, since they belong to another plug-in.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dssmsg.config_yaml import describe, parse_yaml, read_yaml
from dssmsg.errors import ConfigError

ENV_PREFIX = "DSSMSG__"
MAX_INCLUDES = 50

# A name that is or ends with a word for a secret. Any `*_key` is one (`openai_key`); a bare `key` is not.
_SECRET = re.compile(
    r"(?:^|[_-])(?:token|pwd|secret|auth|authorization|bearer)$|[_-]key$"
    r"|(?:apikey|password|passwd|passphrase|credentials?)$",
    re.IGNORECASE,
)
_PASSWORD_IN_URL = re.compile(r"://[^/@:\s]*:[^/@\s]*@")
_QUERY = re.compile(r"[?&]([^=?&#\s]*)=[^&#\s]")


@dataclass(frozen=True, slots=True)
class Layer:
    """One source of values; `label` is what an error calls it (a path, a variable, `--set`)."""

    label: str
    data: Mapping[str, Any]

    def holds(self, path: Sequence[str | int]) -> int:
        """How many leading parts of a path this layer has something to say about."""
        here: Any = self.data
        for depth, part in enumerate(path):
            known = part in here if isinstance(here, Mapping) else _has_index(here, part)
            if not known:
                return depth
            here = here[part]
        return len(path)


def _has_index(value: Any, part: str | int) -> bool:
    return isinstance(value, list) and isinstance(part, int) and part < len(value)


def file_layers(path: Path, *, label: str | None = None) -> list[Layer]:
    """The layers of a YAML file: those it includes, lowest first, then itself.

    `include:` takes a path or a list of paths, relative to the file that says so. Relative plug-in paths
    are made absolute here, where it is known which file they stand in.
    """
    layers: list[Layer] = []
    _read_file(path, label or str(path), (), layers)
    return layers


def _read_file(path: Path, label: str, trail: tuple[Path, ...], layers: list[Layer]) -> None:
    place = path.resolve()
    if place in trail:
        circle = " -> ".join(one.name for one in (*trail[trail.index(place) :], place))
        raise ConfigError(f"files include each other in a circle: {circle}", file=trail[-1], key="include")
    if len(layers) >= MAX_INCLUDES:
        raise ConfigError(f"more than {MAX_INCLUDES} included files", file=trail[-1], key="include")
    try:
        data = read_yaml(path)
    except ConfigError as error:
        if not trail or not error.message.startswith(("there is no such", "is a folder", "cannot be read")):
            raise
        raise ConfigError(f"{path}: {error.message}", file=trail[-1], key="include") from error
    included = data.pop("include", None)
    if isinstance(included, str):
        included = [included]
    if not (
        included is None or (isinstance(included, list) and all(isinstance(one, str) for one in included))
    ):
        raise ConfigError(
            f"expected a path or a list of paths, got {describe(included)}", file=label, key="include"
        )
    for one in included or ():
        below = path.parent / Path(one).expanduser()
        _read_file(below, str(below), (*trail, place), layers)
    refuse_secrets(data, label)
    layers.append(Layer(label, anchor_paths(data, path.parent.resolve())))


def environment_layers(environment: Mapping[str, str]) -> list[Layer]:
    """One layer a variable `DSSMSG__A__B`, in alphabetical order; the value is parsed as YAML."""
    layers = []
    for name in sorted(environment):
        if not name.startswith(ENV_PREFIX):
            continue
        parts = [part.lower() for part in name.removeprefix(ENV_PREFIX).split("__")]
        if not all(parts):
            raise ConfigError("expected a name like DSSMSG__ASSOCIATION__USE", file=f"environment {name}")
        layers.append(_single(f"environment {name}", parts, environment[name]))
    return layers


def set_layers(assignments: Iterable[str], label: str = "--set") -> list[Layer]:
    """One layer an assignment `a.b=value`; the value is parsed as YAML, `label` says where they stand."""
    layers = []
    for assignment in assignments:
        dotted, equals, text = assignment.partition("=")
        parts = dotted.strip().split(".")
        if not equals or not all(parts):
            raise ConfigError(
                f"expected key=value, like perception.use=oracle, got {assignment!r}", file=label
            )
        layers.append(_single(label, parts, text))
    return layers


def _single(label: str, parts: list[str], text: str) -> Layer:
    key = ".".join(parts)
    value: Any = None if _SECRET.search(parts[-1]) else parse_yaml(text, file=label, key=key)
    for part in reversed(parts):
        value = {part: value}
    refuse_secrets(value, label)
    return Layer(label, anchor_paths(value, Path.cwd()))


def merge(layers: Iterable[Layer]) -> dict[str, Any]:
    """The layers as one nested mapping, later ones on top."""
    merged: dict[str, Any] = {}
    for layer in layers:
        merged = _merge(merged, layer.data, ())
    return merged


def _merge(lower: Mapping[str, Any], upper: Mapping[str, Any], path: tuple[str, ...]) -> dict[str, Any]:
    # An observer's plug-in is named by its key unless `use` says otherwise.
    implied = path[-1] if path[:-1] == ("recording", "observers") else None
    used = lower.get("use", implied)
    if "use" in upper and used is not None and upper["use"] != used:
        lower = {}
    merged = dict(lower)
    for key, value in upper.items():
        below = merged.get(key)
        if isinstance(value, Mapping):
            merged[key] = _merge(below if isinstance(below, Mapping) else {}, value, (*path, key))
        elif value is None and isinstance(below, Mapping):
            continue  # `observers: {rerun: }` says nothing about the options below
        else:
            merged[key] = value
    return merged


def split_key(dotted: str) -> list[str | int]:
    """`mission.phases[1]` as ["mission", "phases", 1]."""
    parts: list[str | int] = []
    for word in dotted.split("."):
        name, *indices = word.replace("]", "").split("[")
        parts.append(name)
        parts.extend(int(index) for index in indices if index.isdigit())
    return parts


def origin(layers: Sequence[Layer], dotted: str) -> str | None:
    """The label of the topmost layer that says most about a key; None if no layer mentions it."""
    path = split_key(dotted)
    best, label = 0, None
    for layer in reversed(layers):
        depth = layer.holds(path)
        if depth > best:
            best, label = depth, layer.label
    return label


def anchor_paths(data: Any, folder: Path) -> Any:
    """`data` with the paths of `plugins:` and of `use: file.py:Class` made absolute from `folder`."""
    anchored = _anchor_uses(data, folder)
    listed = anchored.get("plugins") if isinstance(anchored, dict) else None
    if isinstance(listed, list):
        anchored["plugins"] = [
            str(folder / Path(one).expanduser()) if isinstance(one, str) and one else one for one in listed
        ]
    return anchored


def _anchor_uses(value: Any, folder: Path) -> Any:
    if isinstance(value, dict):
        return {
            key: _anchor_use(one, folder) if key == "use" else _anchor_uses(one, folder)
            for key, one in value.items()
        }
    if isinstance(value, list):
        return [_anchor_uses(one, folder) for one in value]
    return value


def _anchor_use(use: Any, folder: Path) -> Any:
    if not isinstance(use, str):
        return use
    file, colon, name = use.rpartition(":")
    return f"{folder / Path(file).expanduser()}:{name}" if colon and file.endswith(".py") else use


def refuse_secrets(data: Any, label: str, key: str = "") -> None:
    """Refuse keys and values that carry a password or key: a configuration ends up in every recording."""
    if isinstance(data, Mapping):
        for name, value in data.items():
            dotted = f"{key}.{name}" if key else str(name)
            if _SECRET.search(str(name)):
                raise ConfigError(
                    "no secrets here, a recording holds a copy of the configuration; remove it and set the "
                    "environment variable that the plug-in reads, such as OPENAI_API_KEY",
                    file=label,
                    key=dotted,
                )
            refuse_secrets(value, label, dotted)
    elif isinstance(data, list):
        for index, value in enumerate(data):
            refuse_secrets(value, label, f"{key}[{index}]")
    elif isinstance(data, str) and _secret_in_url(data):
        raise ConfigError(
            "holds a password or key in an address; use an environment variable", file=label, key=key
        )


def _secret_in_url(text: str) -> bool:
    """Whether an address in a text has `user:password@`, or a query like `?api_key=...` or `?key=...`."""
    if "://" not in text:
        return False
    names = (match[1] for match in _QUERY.finditer(text))
    return bool(_PASSWORD_IN_URL.search(text)) or any(
        name.lower() == "key" or _SECRET.search(name) for name in names
    )
