"""How the program ends: every kind of error as a line on stderr and an exit code."""

from __future__ import annotations

import errno
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import Any

from dssmsg.cli.output import error_json, note, plain
from dssmsg.errors import ConfigError, DssmsgError, StorageError

INTERRUPTED, TERMINATED = 130, 143
_STORAGE_ERRORS = frozenset(
    (
        errno.EACCES,
        errno.EPERM,
        errno.EROFS,
        errno.ENOSPC,
        errno.EDQUOT,
        errno.EFBIG,
        errno.ENOTDIR,
        errno.EISDIR,
    )
)


class Terminated(KeyboardInterrupt):
    """SIGTERM: ends the run as Ctrl-C does, with everything closed."""


@dataclass(frozen=True, slots=True)
class Ending:
    """Turns what a command does into an exit code."""

    as_json: bool
    debug: bool

    def of(self, command: Callable[[], int]) -> int:
        """The exit code of `command()`; errors are printed. Unknown ones keep their traceback."""
        _log_to_stderr(debug=self.debug)
        before = _on_sigterm(_terminate)
        try:
            code = command()
            sys.stdout.flush()
            return code
        except KeyboardInterrupt as error:
            return self._interrupted(error)
        except BrokenPipeError:
            # The reader of stdout left, as `| head` does; Python would complain again when it flushes.
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            return 1
        except Exception as error:
            return self._failed(error)
        finally:
            if before is not None:
                _on_sigterm(before)

    def _failed(self, error: Exception) -> int:
        known = _known(error)
        if self.debug or known is None:
            traceback.print_exception(error)
        if known is None:
            message = f"{type(error).__name__}: {error}"
            self._print("internal", message, None, None)
            note("error: this is a fault in dssmsg or in a plug-in, not in your input")
            return 1
        note(f"error: {' '.join(str(known).split())}")
        self._print(known.kind, known.message, known.file, known.key)
        return known.exit_code

    def _interrupted(self, error: KeyboardInterrupt) -> int:
        terminated = isinstance(error, Terminated)
        word = "terminated" if terminated else "interrupted"
        print(word, file=sys.stderr)
        self._print(word, f"{word} before the end", None, None)
        return TERMINATED if terminated else INTERRUPTED

    def _print(self, kind: str, message: str, file: str | None, key: str | None) -> None:
        if self.as_json:
            print(error_json(kind, message, file, key))


def _known(error: Exception) -> DssmsgError | None:
    """The error as one of ours: wrong arguments and refused files are the user's to mend, too."""
    if isinstance(error, DssmsgError):
        return error
    if hasattr(error, "format_message"):  # a usage error of the parser
        context: Any = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "dssmsg"
        return ConfigError(f"{error.format_message().rstrip('.')}; see {command} --help")
    if isinstance(error, OSError) and error.errno in _STORAGE_ERRORS and error.filename is not None:
        return StorageError(f"{error.strerror}", file=str(error.filename))
    return None


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated


def _on_sigterm(handler: Any) -> Any:
    """Set the handler of SIGTERM and return the one before; None outside the main thread."""
    if threading.current_thread() is not threading.main_thread():
        return None
    return signal.signal(signal.SIGTERM, handler)


class _Line(logging.Formatter):
    """`warning: ...` on one line; the traceback of a record only for debugging."""

    def __init__(self, *, debug: bool) -> None:
        super().__init__()
        self._debug = debug

    def format(self, record: logging.LogRecord) -> str:
        line = plain(f"{record.levelname.lower()}: {' '.join(record.getMessage().split())}")
        if self._debug and record.exc_info:
            line += "\n" + self.formatException(record.exc_info)
        return line


def _log_to_stderr(*, debug: bool) -> None:
    logger = logging.getLogger("dssmsg")
    for old in [one for one in logger.handlers if isinstance(one.formatter, _Line)]:
        logger.removeHandler(old)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Line(debug=debug))
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG if debug else logging.WARNING)
