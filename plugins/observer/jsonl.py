"""observer `jsonl`: every change of the graph as a line of canonical JSON in `<run_id>.changes.jsonl`.

The file holds no wall-clock time and no path: two runs of one configuration and seed write the same bytes.
"""

from __future__ import annotations

import os
import time
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field

from dssmsg.errors import StorageError
from dssmsg.events import Event, GraphChanged
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

if TYPE_CHECKING:
    from dssmsg.interfaces import Context


class Config(PluginConfig):
    """Options of the change log."""

    flush_secs: float = Field(
        default=1.0, ge=0.0, le=60.0, description="wall seconds after which written lines are flushed"
    )


class JsonlObserver:
    """Writes the change log. Raises StorageError where the file exists already or cannot be written."""

    def __init__(self, config: Config, context: Context) -> None:
        self._flush_secs = config.flush_secs
        self._path = Path(context.run_dir) / f"{context.run_id}.changes.jsonl"
        self._file: TextIOWrapper | None = None
        self._flushed = 0.0

    def on_event(self, event: Event) -> None:
        """Append the lines of a `GraphChanged`; the file is created on the first event."""
        try:
            if self._file is None:
                self._file = _create(self._path)
            if isinstance(event, GraphChanged):
                from dssmsg.graph import codec

                for change in event.changes:
                    row, _ = codec.encode_stamped(change)  # arrays stand in the row as hashes
                    self._file.write(codec.canonical_json(row) + "\n")
            if time.monotonic() - self._flushed >= self._flush_secs:
                self._flush()
        except OSError as error:
            raise StorageError(
                f"the change log could not be written ({error.strerror})", file=self._path
            ) from error

    def close(self) -> None:
        """Flush and close; safe to call twice. Raises StorageError if that failed."""
        if self._file is None or self._file.closed:
            return
        try:
            self._flush()
        except OSError as error:
            raise StorageError(
                f"the change log could not be written ({error.strerror})", file=self._path
            ) from error
        finally:
            _close_quietly(self._file)

    def outputs(self) -> dict[str, str]:
        """`changes`: the file, once there is one."""
        return {} if self._file is None else {"changes": str(self._path)}

    def _flush(self) -> None:
        if self._file is not None:
            self._file.flush()
        self._flushed = time.monotonic()


def _create(path: Path) -> TextIOWrapper:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
    except FileExistsError as error:
        raise StorageError(
            "a change log of this name exists already and is not overwritten", file=path
        ) from error
    except OSError as error:
        raise StorageError(
            f"the change log cannot be created ({error.strerror}); set recording.directory to a folder"
            " that can be written",
            file=path,
        ) from error
    return os.fdopen(handle, "w", encoding="utf-8", newline="\n")


def _close_quietly(file: TextIOWrapper) -> None:
    """Close a file whose failing flush has been reported: `close` would flush, and fail, once more."""
    try:
        file.close()
    except OSError:
        return


@hookimpl
def register_observer(register: Register) -> None:
    """Announce `jsonl`."""
    register("jsonl", JsonlObserver, config=Config)
