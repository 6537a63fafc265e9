"""Does an object fit its kind's Protocol? Said in one sentence that names what is missing."""

from __future__ import annotations

import inspect
from typing import Any

from dssmsg.interfaces import KINDS


def mismatch(plugin: Any, kind: str) -> str:
    """Why `plugin` cannot serve as `kind`; empty where it can.

    Methods must exist and take the Protocol's arguments by position; attributes must exist.
    """
    protocol = KINDS[kind]
    label = f"a {kind} plug-in ({protocol.__name__})"
    if plugin is None:
        return f"the factory returned nothing; expected {label}"
    if isinstance(plugin, type):
        return f"the factory returned the class {plugin.__name__} itself, not an object of it"
    for name in attributes(protocol):
        if not hasattr(plugin, name):
            return f"{type(plugin).__name__} has no attribute '{name}', which {label} must have"
    for name, method in methods(protocol).items():
        found = getattr(plugin, name, None)
        if found is None:
            return f"{type(plugin).__name__} has no method {name}{_shape(method)}, which {label} must have"
        if not callable(found):
            return f"{type(plugin).__name__}.{name} is not a method"
        if inspect.iscoroutinefunction(found):
            return f"{type(plugin).__name__}.{name} is async; plug-ins are called without a loop"
        if not _takes(found, len(inspect.signature(method).parameters) - 1):
            return f"{type(plugin).__name__}.{name} must take {_shape(method)}"
    return ""


def methods(protocol: type) -> dict[str, Any]:
    """The methods of a Protocol by name, in order."""
    return {
        name: value
        for name, value in vars(protocol).items()
        if inspect.isfunction(value) and not name.startswith("_")
    }


def attributes(protocol: type) -> list[str]:
    """The attributes and properties of a Protocol."""
    properties = [name for name, value in vars(protocol).items() if isinstance(value, property)]
    return [*(name for name in inspect.get_annotations(protocol) if not name.startswith("_")), *properties]


def _shape(method: Any) -> str:
    return f"({', '.join(list(inspect.signature(method).parameters)[1:])})"


def _takes(function: Any, count: int) -> bool:
    try:
        inspect.signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:  # some extension functions have no signature to look at
        return True
    return True
