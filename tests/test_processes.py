"""Processes that serve another: Ctrl-C in a terminal goes to all of them."""

from __future__ import annotations

import signal
import subprocess
import sys

HELD = """
import os, signal, time
from multiprocessing import get_context
from dssmsg.processes import start_sheltered

process = get_context("spawn").Process(target=time.sleep, args=(60,), daemon=True)
start_sheltered(process)
time.sleep(0.5)
try:
    os.killpg(os.getpgrp(), signal.SIGINT)
    time.sleep(5)
except KeyboardInterrupt:
    time.sleep(0.5)
    print("alive" if process.is_alive() else "dead")
process.terminate()
"""


def test_ctrl_c_reaches_the_main_process_alone() -> None:
    done = subprocess.run(
        [sys.executable, "-c", HELD],
        capture_output=True,
        text=True,
        timeout=60,
        start_new_session=True,
        # A shell's background job, as a test run may be, has it ignored.
        preexec_fn=_interruptible,
    )
    assert (done.stdout, done.stderr) == ("alive\n", "")


def _interruptible() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
