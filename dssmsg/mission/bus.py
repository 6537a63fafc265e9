"""The observer bus: tells every observer every event, in order, and survives the ones that raise."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

from dssmsg.errors import StorageError
from dssmsg.events import ErrorOccurred, Event, FrameCaptured
from dssmsg.interfaces import Observer

_log = logging.getLogger("dssmsg.observers")


Watching = Callable[[str, str], AbstractContextManager[None]]
"""`watching(plugin, what)`: a watchdog looks on while inside."""


def _unwatched(plugin: str, what: str) -> AbstractContextManager[None]:
    return nullcontext()


class ObserverBus:
    """Dispatches events to observers. One that raises is disabled, and the others are told of it.

    A `StorageError` is not survived: a run that can no longer be written down ends.
    """

    def __init__(self, observers: Sequence[tuple[str, Observer]], watching: Watching = _unwatched) -> None:
        self._watching = watching
        self._active = list(observers)
        self._all = tuple(observers)
        self.failed: list[str] = []
        self.errors = 0
        self._frame = -1
        self._sim_time = 0.0

    def tell(self, event: Event) -> None:
        """Tell all active observers of an event."""
        if isinstance(event, ErrorOccurred):
            self.errors += 1
        if isinstance(event, FrameCaptured):
            self._frame, self._sim_time = event.frame.index, event.frame.sim_time
        broken: list[tuple[str, str]] = []
        for name, observer in list(self._active):
            try:
                with self._watching(f"observer/{name}", "on_event"):
                    observer.on_event(event)
            except StorageError:
                raise
            except Exception as error:
                # Out of the list first: the warning is an event, too.
                self._active.remove((name, observer))
                self.failed.append(name)
                broken.append((name, f"{type(error).__name__}: {error}"))
                _log.warning("observer %s failed and is disabled: %s", name, error, exc_info=True)
        for name, message in broken:
            self.tell(self._error(name, message, skipped="all further events"))

    def close(self) -> None:
        """Close all observers, also those that failed; a StorageError is raised once all are closed."""
        storage_error: StorageError | None = None
        for name, observer in self._all:
            try:
                observer.close()
            except StorageError as error:
                storage_error = storage_error or error
            except Exception as error:
                _log.warning("observer %s failed while closing: %s", name, error, exc_info=True)
                if name not in self.failed:
                    self.failed.append(name)
        if storage_error is not None:
            raise storage_error

    def outputs(self) -> dict[str, str]:
        """What the observers leave behind: name -> path."""
        found: dict[str, str] = {}
        for name, observer in self._all:
            if name in self.failed:
                continue
            try:
                found.update(observer.outputs())
            except Exception as error:
                self.failed.append(name)
                _log.warning("observer %s does not say what it left: %s", name, error, exc_info=True)
        return found

    def _error(self, name: str, message: str, *, skipped: str) -> ErrorOccurred:
        return ErrorOccurred(self._frame, self._sim_time, f"observer/{name}", message, skipped)
