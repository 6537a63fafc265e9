"""Runs a plug-in's code and survives what it does: raising, returning the wrong thing, hanging.

A call runs on the caller's thread. One watchdog thread a guard counts the time of the call under way; when
that exceeds the limit it reports, asks for a flush and ends the process, since Python cannot cancel a call.
The watchdog is a Python thread: an extension that hangs while it holds the interpreter lock hangs it too.
"""

from __future__ import annotations

import os
import sys
import sysconfig
import threading
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any, Literal

from dssmsg.errors import ConfigError, InputError, PluginError, PluginTimeout, StorageError
from dssmsg.events import ErrorOccurred

_NO_DEFAULT: Any = object()
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")})
FLUSH_SECS = 5.0
"""How long reporting and flushing may take once a plug-in hangs: they may wait for what the plug-in holds."""


LastWords = Callable[[PluginTimeout], None]


def say_on_stderr(error: PluginTimeout) -> None:
    """What is said before a hanging plug-in ends the process."""
    print(f"error: {error}", file=sys.stderr)


@dataclass(slots=True, eq=False)
class _Call:
    """A call under way, what it was called from, and the seconds the watchdog has counted."""

    plugin: str
    what: str
    outer: _Call | None
    counted: float = 0.0


class Guard:
    """Decides what becomes of a failing plug-in: `on_error` skip (report, count, use the default) or fail.

    `report` gets an `ErrorOccurred` for every failure; for a hang it is called from another thread, since the
    caller's is the one that hangs, and so is `on_hang`, which shall flush what must not be lost. Use it as a
    context manager, or call `close`, so that the watchdog ends.
    """

    def __init__(
        self,
        on_error: Literal["skip", "fail"] = "skip",
        timeout_secs: float = 30.0,
        report: Callable[[ErrorOccurred], None] = lambda event: None,
        on_hang: Callable[[], None] = lambda: None,
        *,
        last_words: LastWords = say_on_stderr,
        end_process: Callable[[int], Any] = os._exit,
    ) -> None:
        self.errors: Counter[str] = Counter()
        """Failures by plug-in (`kind/name`)."""
        self._on_error = on_error
        self._timeout_secs = timeout_secs
        self._report = report
        self._on_hang = on_hang
        self._last_words = last_words
        self._end_process = end_process
        self._frame, self._sim_time = -1, 0.0
        self._call: _Call | None = None
        self._closed = threading.Event()
        self._watchdog = threading.Thread(target=self._watch, name="dssmsg-watchdog", daemon=True)
        self._watchdog.start()

    def __enter__(self) -> Guard:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """End the watchdog; safe to call twice."""
        self._closed.set()
        if threading.current_thread() is not self._watchdog:
            self._watchdog.join()

    def at(self, frame: int, sim_time: float) -> None:
        """Say which frame the coming calls belong to, for the reports."""
        self._frame, self._sim_time = frame, sim_time

    def call(
        self,
        plugin: str,
        what: str,
        function: Callable[..., Any],
        *arguments: Any,
        check: Callable[[Any], Any] | None = None,
        default: Any = _NO_DEFAULT,
    ) -> Any:
        """`check(function(*arguments))`; `plugin` is `kind/name` and `what` the method, for the report.

        If either fails, the failure is reported and `default` returned. Without a default, or with `on_error`
        fail, PluginError is raised instead. A full disk, a wrong option and a wrong input file
        (StorageError, ConfigError, InputError) pass through: no other frame will go better.
        """
        try:
            with self.watching(plugin, what):
                value = function(*arguments)
                return value if check is None else check(value)
        except (StorageError, ConfigError, InputError):
            raise
        except (Exception, SystemExit) as error:
            message = f"{what} failed: {_describe(error)}"
            fatal = self._on_error == "fail" or default is _NO_DEFAULT
            self.errors[plugin] += 1
            self._report(self._event(plugin, message, skipped="" if fatal else what, fatal=fatal))
            if not fatal:
                return default
            raise PluginError(message, plugin=plugin) from error

    @contextmanager
    def watching(self, plugin: str, what: str) -> Iterator[None]:
        """The watchdog looks on while inside; what is raised there is the caller's business."""
        self._call = _Call(plugin, what, self._call)
        try:
            yield
        finally:
            self._call = self._call.outer if self._call is not None else None

    def _event(self, plugin: str, message: str, *, skipped: str, fatal: bool) -> ErrorOccurred:
        return ErrorOccurred(self._frame, self._sim_time, plugin, message, skipped, fatal)

    def _watch(self) -> None:
        """Count the seconds of the innermost call; a stopped or suspended process counts for one tick."""
        tick = max(0.01, min(0.25, self._timeout_secs / 8))
        last = monotonic()
        while not self._closed.wait(tick):
            now = monotonic()
            passed, last = min(now - last, 2 * tick), now
            call = self._call
            if call is None:
                continue
            call.counted += passed
            if call.counted > self._timeout_secs:
                self._end(call)
                return

    def _end(self, call: _Call) -> None:
        message = f"{call.what} did not return within {self._timeout_secs:g} s (timeout_secs), the run ends"
        error = PluginTimeout(message, plugin=call.plugin)
        self.errors[call.plugin] += 1

        def save() -> None:
            try:
                self._report(self._event(call.plugin, message, skipped=call.what, fatal=True))
            finally:
                self._on_hang()

        saving = threading.Thread(target=save, name="dssmsg-last-words", daemon=True)
        saving.start()
        saving.join(FLUSH_SECS)
        self._last_words(error)
        sys.stderr.flush()
        self._end_process(error.exit_code)


def _describe(error: BaseException) -> str:
    """Type and text of an exception and the line that raised it, on one line."""
    text = " ".join(str(error).split())[:400]
    described = f"{type(error).__name__}: {text}" if text else type(error).__name__
    # The trace begins with the guard's own call; a fault found by a check lies in the checks themselves.
    frames = traceback.extract_tb(error.__traceback__)[1:]
    if frames and not frames[-1].filename.endswith("checks.py"):
        # The user can look at their own line, not at one inside a library that it calls.
        own = [one for one in frames if not one.filename.startswith(_LIBRARIES)]
        line = (own or frames)[-1]
        described += f" ({Path(line.filename).name}:{line.lineno})"
    return described
