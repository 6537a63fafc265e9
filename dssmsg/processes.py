"""Processes that serve this one: a signal to the whole group does not end them, this one does."""

from __future__ import annotations

import os
import signal
import threading
from multiprocessing.process import BaseProcess

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


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
