"""Where the runs of a sweep are carried out: processes of this machine, or a Ray cluster.

Both give every run a process of its own and call the same function in it; what a run comes to is read from
its folder. A process that is killed costs its own run alone, which is tried once more.
"""

from __future__ import annotations

import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import connection, get_context, parent_process
from multiprocessing.context import SpawnProcess
from typing import Any

from dssmsg.errors import ConfigError
from dssmsg.evaluate.sweep_matrix import Run
from dssmsg.evaluate.sweep_run import carry_out

LOOPBACK = "127.0.0.1"
ATTEMPTS = 2
"""How often a run is begun whose process was killed from outside."""

Ended = Iterator[tuple[Run, str]]
"""Runs as they end, in any order, each with the reason of a process that ended without a word."""


def local(runs: Sequence[Run], jobs: int) -> Ended:
    """Carry out the runs in `jobs` processes of this machine at a time. Leaving it early ends them."""
    # Not forked: the renderer and the recording hold threads.
    context = get_context("spawn")
    waiting = deque((run, 1) for run in runs)
    active: dict[int, tuple[SpawnProcess, Run, int]] = {}
    try:
        while waiting or active:
            while waiting and len(active) < jobs:
                run, attempt = waiting.popleft()
                process = context.Process(target=_child, args=(run,))
                process.start()
                active[process.sentinel] = (process, run, attempt)
            for sentinel in connection.wait(list(active)):
                assert isinstance(sentinel, int)
                process, run, attempt = active.pop(sentinel)
                process.join()
                code = process.exitcode or 0
                process.close()
                if code < 0 and attempt < ATTEMPTS:
                    waiting.appendleft((run, attempt + 1))
                else:
                    yield run, f"its process ended with code {code}" if code else ""
    finally:
        for process, _, _ in active.values():
            process.terminate()
        for process, _, _ in active.values():
            process.join()


def _child(run: Run) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    carry_out(run)


def _end_with_parent() -> None:
    """End this process with the sweep, also where that was killed: nobody would wait for the run."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def ray(runs: Sequence[Run], jobs: int, address: str | None = None) -> Ended:
    """Carry out the runs on a Ray cluster: the one at `address`, else one of this machine, for this sweep.

    The folders of the runs must be on a file system that all its machines share. Raises ConfigError where
    Ray is not installed or the cluster does not answer.
    """
    for name, value in _RAY_SETTINGS.items():
        os.environ.setdefault(name, value)
    try:
        import ray as cluster
    except ImportError as error:
        raise ConfigError(
            "needs Ray: pip install 'dssmsg[ray]', or take --engine local", key="--engine"
        ) from error
    own: dict[str, Any] = {"address": address}
    if address is None:
        own = {"address": "local", "num_cpus": jobs, "include_dashboard": False, "_node_ip_address": LOOPBACK}
    try:
        cluster.init(log_to_driver=False, logging_level=logging.ERROR, **own)
    except (ConnectionError, RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ConfigError(f"no Ray cluster there ({reason})", key="--address") from error
    try:
        # A process a run, as here: what a run left behind in memory must not reach the next.
        task = cluster.remote(num_cpus=1, max_retries=ATTEMPTS - 1, max_calls=1)(carry_out)
        waiting = {task.remote(run): run for run in runs}
        while waiting:
            for reference in cluster.wait(list(waiting))[0]:
                run = waiting.pop(reference)
                try:
                    cluster.get(reference)
                    yield run, ""
                except cluster.exceptions.RayError as error:
                    yield run, " ".join(str(error).split())[:300]
    finally:
        cluster.shutdown()


_RAY_SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    # A worker that Ray's memory monitor kills is begun anew without end unless this says otherwise.
    "RAY_task_oom_retries": str(ATTEMPTS - 1),
    # A worker that takes longer to start is ended, and another one begun: on a busy machine, for ever.
    "RAY_worker_register_timeout_seconds": "600",
}
"""What Ray reads of the environment; what the user has set stays."""


Engine = Callable[[Sequence[Run], int], Ended]
