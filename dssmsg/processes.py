"""Starting processes that serve this one."""

from __future__ import annotations

import signal
import threading
from multiprocessing.process import BaseProcess


def start_sheltered(process: BaseProcess) -> None:
    """Start a process that Ctrl-C, which goes to all of a terminal's, does not reach: this one ends it."""
    if threading.current_thread() is not threading.main_thread():  # only that one may
        process.start()
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # is inherited
    try:
        process.start()
    finally:
        signal.signal(signal.SIGINT, before)
