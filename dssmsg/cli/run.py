"""`dssmsg run`: configuration -> host -> mission -> summary."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dssmsg.cli.output import error_json, note, print_json, show, stdout_to_stderr
from dssmsg.cli.plugins import warn_of_failures
from dssmsg.config import load_config
from dssmsg.errors import DssmsgError, PluginTimeout
from dssmsg.host import Host
from dssmsg.review.text import summary_text

if TYPE_CHECKING:
    from dssmsg.events import Event

PROGRESS = "progress"


class _Witness:
    """An observer that remembers which run it was, for the words after an interruption."""

    def __init__(self) -> None:
        self.run_id: str | None = None

    def on_event(self, event: Event) -> None:
        if self.run_id is None:
            self.run_id = getattr(event, "run_id", None)

    def close(self) -> None:
        pass

    def outputs(self) -> dict[str, str]:
        return {}


def run_command(
    path: Path | None,
    sets: Sequence[str],
    *,
    goals: Sequence[str],
    seed: int | None,
    view: bool,
    strict: bool,
    as_json: bool,
) -> int:
    """Run a mission, print its summary, and return the exit code."""
    witness = _Witness()
    with stdout_to_stderr() as real_stdout:
        config = load_config(path, sets=sets, goals=goals, seed=seed)
        with config.naming_files():
            host = Host.load(config.plugins, config.base_dir)
        if any(one.name == PROGRESS for one in host.registrations("observer")):
            config = config.with_defaults({"recording": {"observers": {PROGRESS: {}}}})
        host.check(config)
        warn_of_failures(host)
        from dssmsg.mission.run import run_mission

        directory = Path(config.recording.directory)

        def last_words(error: PluginTimeout) -> None:
            note(f"error: {error}")
            _say_what_is_kept(witness, directory)
            if as_json and real_stdout is not None:
                os.write(real_stdout, (error_json(error.kind, error.message) + "\n").encode())

        try:
            with config.naming_files():
                result = run_mission(
                    config, host, observers=[("command line", witness)], last_words=last_words
                )
        except (KeyboardInterrupt, DssmsgError):
            _say_what_is_kept(witness, directory)
            raise
    summary = result.summary
    if as_json:
        print_json(summary)
    else:
        show(summary_text(summary))
    if view and summary.get("recording"):
        from dssmsg.cli.view import open_viewer

        open_viewer(Path(summary["recording"]))
    failed = any(episode["outcome"] != "success" for episode in summary["episodes"])
    if strict and (failed or summary["errors"]):
        return 1
    return result.exit_code


def _say_what_is_kept(witness: _Witness, directory: Path) -> None:
    kept = sorted(directory.glob(f"{witness.run_id}*")) if witness.run_id else []
    if kept:
        note(f"kept what was recorded so far: {', '.join(map(str, kept))}")
