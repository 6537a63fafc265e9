"""Processes that serve another: Ctrl-C in a terminal, and who ends a job, signal all of them at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dssmsg.processes import leave_group

HELD = """
import os, signal, sys, time
from multiprocessing import get_context
from dssmsg.processes import start_sheltered
from test_processes import serve

def interrupted(*_):
    raise KeyboardInterrupt

number = int(sys.argv[1])
signal.signal(number, interrupted)
process = get_context("spawn").Process(target=serve, daemon=True)
start_sheltered(process)
time.sleep(float(sys.argv[2]))
try:
    os.killpg(os.getpgrp(), number)
    time.sleep(5)
except KeyboardInterrupt:
    time.sleep(1.0)
    print("alive" if process.is_alive() else "dead")
process.terminate()
process.join(10.0)
print("alive" if process.is_alive() else "ended")
"""


def serve() -> None:
    """What the helper does."""
    leave_group()
    time.sleep(60)


@pytest.mark.parametrize("delay", [0.0, 2.0], ids=["starting", "at work"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_the_group_reaches_the_main_process_alone(number: int, delay: float) -> None:
    done = subprocess.run(
        [sys.executable, "-c", HELD, str(int(number)), str(delay)],
        capture_output=True,
        text=True,
        timeout=60,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
    )
    assert (done.stdout, done.stderr) == ("alive\nended\n", "")
