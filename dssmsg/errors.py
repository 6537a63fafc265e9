"""Every error that a user can cause, and the exit code it ends with.

    DssmsgError                 exit 1
    ├── ConfigError             exit 2   a key of the YAML, an option or an argument is wrong
    ├── InputError              exit 2   an input file or folder is missing, malformed or foreign
    ├── PluginError             exit 1   a plug-in or model failed at run time
    │   ├── PluginTimeout       exit 1   a plug-in hung; the watchdog ends the process
    │   └── NotUnderstood       exit 1   a language model works, but makes nothing of a sentence
    ├── StorageError            exit 1   disk full, no permission, a file is in the way
    ├── GraphError              exit 1   a change does not fit the graph (`dssmsg.graph.errors`)
    └── ViewerError             exit 1   the viewer did not start (`dssmsg.recording.viewer`)

An error is handled once, in `dssmsg.cli`. Anything that is not a `DssmsgError` keeps its traceback.
"""

from __future__ import annotations

from pathlib import Path


class DssmsgError(Exception):
    """Base of all errors with a message for the user.

    `message` is one sentence that says what is wrong and what would be accepted; `file` and `key`
    name the place (a path, a dotted YAML key) where they are known.
    """

    kind = "error"
    exit_code = 1

    def __init__(self, message: str, *, file: Path | str | None = None, key: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.file = None if file is None else str(file)
        self.key = key

    def __str__(self) -> str:
        place = ": ".join(part for part in (self.file, self.key) if part)
        return f"{place}: {self.message}" if place else self.message


class ConfigError(DssmsgError):
    """The configuration or the command line is wrong."""

    kind = "config"
    exit_code = 2


class InputError(DssmsgError):
    """An input file or folder is missing, malformed or of a kind that is not known."""

    kind = "input"
    exit_code = 2


class PluginError(DssmsgError):
    """A plug-in failed at run time; `plugin` is its `kind/name`."""

    kind = "plugin"
    exit_code = 1

    def __init__(
        self, message: str, *, plugin: str, file: Path | str | None = None, key: str | None = None
    ) -> None:
        super().__init__(f"plug-in {plugin}: {message}", file=file, key=key)
        self.plugin = plugin


class PluginTimeout(PluginError):
    """A plug-in did not return in time. Python cannot cancel it, so the process ends."""

    kind = "timeout"


class NotUnderstood(PluginError):
    """A language model works, but makes nothing of a sentence; `reason` says why, without the plug-in.

    An episode ends as it does with any other failing plug-in; where the user has just typed the sentence
    (`query`, `explain`), it becomes an InputError.
    """

    def __init__(self, reason: str, *, plugin: str) -> None:
        super().__init__(reason, plugin=plugin)
        self.reason = reason


class StorageError(DssmsgError):
    """A file could not be written."""

    kind = "storage"
    exit_code = 1
