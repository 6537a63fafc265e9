"""`problems` of a config model, made from what its plug-in does: see `dssmsg.slot_problems`."""

from __future__ import annotations

from collections.abc import Callable

from dssmsg.errors import DssmsgError, PluginError


def problems_of(build: Callable[[], object]) -> list[str]:
    """Try what a run would do; its error as a sentence that begins with the option, or nothing."""
    try:
        build()
    except PluginError:
        raise
    except DssmsgError as error:
        parts = ((error.key or "").removeprefix("."), error.file, error.message)
        return [": ".join(part for part in parts if part)]
    return []
