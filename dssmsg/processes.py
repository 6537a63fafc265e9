"""This process and those that serve it: what they are spared, and which signals reach them."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import threading
from multiprocessing.process import BaseProcess

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_COLLECTED_AFTER = (50_000, 20, 20)


def collect_seldom() -> None:
    """Look for unused cycles of objects seldom, and not once more at the end, when everything goes anyway.

    Rows of a recording are small objects that stay: with Python's own threshold, 700, the search among an
    hour of them took a sixth of the time.
    """
    gc.set_threshold(*_COLLECTED_AFTER)
    atexit.register(gc.freeze)


def start_sheltered(process: BaseProcess) -> None:
    """Start a process whose work begins with `leave_group`: signals to this one's group do not reach it.

    Ctrl-C goes to all processes of a terminal, and who ends a job may end its group; what a helper then has
    to do is this process's to say.
    """
    if threading.current_thread() is not threading.main_thread():  # only that one may set handlers
        process.start()
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in _SIGNALS}  # is inherited
    try:
        process.start()
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def leave_group() -> None:
    """Called by the process itself: it can be ended alone, and nobody else's signals reach it."""
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
