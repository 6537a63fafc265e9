"""JSON values: what facts, attributes and change rows are made of."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any


def json_value(value: Any, name: str = "value") -> Any:
    """`value` in plain JSON types: dict with sorted text keys, list, str, int, finite float, bool, None.

    numpy scalars and arrays become numbers and lists. Raises ValueError for anything else, NaN included,
    naming the place.
    """
    if value is None or type(value) in (str, int, bool):
        return value
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise ValueError(f"{name}: expected text keys, got {list(value)}")
        return {key: json_value(value[key], f"{name}.{key}") for key in sorted(value)}
    if isinstance(value, list | tuple):
        return [json_value(item, f"{name}[{index}]") for index, item in enumerate(value)]
    if hasattr(value, "tolist"):  # numpy's arrays and scalars
        return json_value(value.tolist(), name)
    if isinstance(value, float):
        return finite(value, name)
    raise ValueError(f"{name}: expected a JSON value, got {type(value).__name__}")


def finite(value: Any, name: str) -> float:
    """`value` as a finite float; ValueError otherwise."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{name}: expected a finite number, got {value!r}")
    return number


def canonical_json(value: Any) -> str:
    """One spelling for one value: sorted keys, no spaces, shortest exact floats, NaN refused, UTF-8 text."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
