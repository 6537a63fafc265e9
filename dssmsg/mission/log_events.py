"""What plug-ins and the host log while a run is under way, as events for the recording."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from dssmsg.events import Event, Logged


class _EventHandler(logging.Handler):
    """Tells the observers each record that the mission's own thread logs; other threads have no frame."""

    def __init__(self, tell: Callable[[Event], None], now: Callable[[], tuple[int, float]]) -> None:
        super().__init__()
        self._tell = tell
        self._now = now
        self._thread = threading.get_ident()

    def emit(self, record: logging.LogRecord) -> None:
        if threading.get_ident() == self._thread:
            self._tell(Logged(*self._now(), record.name, record.levelname, record.getMessage()))


@contextmanager
def logged_as_events(tell: Callable[[Event], None], now: Callable[[], tuple[int, float]]) -> Iterator[None]:
    """While inside, records of the logger `dssmsg` and its children are told as `Logged` events too."""
    logger, handler = logging.getLogger("dssmsg"), _EventHandler(tell, now)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
