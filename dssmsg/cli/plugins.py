"""`dssmsg plugins`: what is there, where it comes from, what failed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from dssmsg.cli.output import note, print_json, stdout_to_stderr
from dssmsg.config import load_config
from dssmsg.config_schema import options_of
from dssmsg.host import Host, Problem, Registration


def list_plugins(path: Path | None, *, options: bool, as_json: bool) -> None:
    """Print one row a plug-in and one a failure; with `options` also what each can be told."""
    with stdout_to_stderr():
        config = load_config(path)
        with config.naming_files():
            host = Host.load(config.plugins, config.base_dir)
    if as_json:
        print_json([*map(_row, host.registrations()), *map(_problem_row, host.problems)])
        return
    rows = [
        (
            one.kind,
            one.name,
            one.version,
            one.origin + (" (sees the truth)" if one.needs_truth else ""),
            one.config,
        )
        for one in host.registrations()
    ]
    widths = [max(map(len, column), default=0) for column in list(zip(*rows, strict=True))[:3]]
    for *facts, origin, config_model in rows:
        print("  ".join([*(fact.ljust(width) for fact, width in zip(facts, widths, strict=True)), origin]))
        for option in options_of(config_model) if options else ():
            default = "required" if option["required"] else json.dumps(option["default"], ensure_ascii=False)
            print(f"    {option['name']}: {option['type']} ({default}); {option['description']}")
    for problem in host.problems:
        print(f"failed: {_told(problem)}")


def warn_of_failures(*hosts: Host) -> None:
    """Say on stderr what failed to load, once: for commands that do without, once they know that they can."""
    for line in dict.fromkeys(_told(problem) for host in hosts for problem in host.problems):
        note(f"warning: {line}")


def _told(problem: Problem) -> str:
    name = f"{problem.kind} {problem.name}: " if problem.name else ""
    return f"{name}{problem.origin}: {problem.message}"


def _row(one: Registration) -> dict[str, Any]:
    return {
        "kind": one.kind,
        "name": one.name,
        "origin": one.origin,
        "version": one.version,
        "error": None,
        "needs_truth": one.needs_truth,
        "options": options_of(one.config),
    }


def _problem_row(problem: Problem) -> dict[str, Any]:
    return {
        "kind": problem.kind or None,
        "name": problem.name or None,
        "origin": problem.origin,
        "version": problem.version,
        "error": problem.message,
    }
