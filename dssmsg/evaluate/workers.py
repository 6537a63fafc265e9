"""Work shared out over processes of this machine: one function, many independent tasks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import TypeVar

from dssmsg.errors import PluginError

Task = TypeVar("Task")
Result = TypeVar("Result")
_TASKS_A_PROCESS = 1
"""So that none grows. After more than one, Python 3.11 may not replace the process (CPython issue 115634)."""


def each(
    function: Callable[[Task], Result], tasks: Sequence[Task], jobs: int
) -> Iterator[tuple[int, Result]]:
    """(number of the task, what the function makes of it) as they are done, `jobs` at a time.

    In this process and in order for one job; else in processes of their own, to which function and tasks are
    pickled. What the function raises is raised here, and begins no further task; PluginError where a task
    ended its process.
    """
    if jobs <= 1 or len(tasks) <= 1:
        for number, task in enumerate(tasks):
            yield number, function(task)
        return
    # Not forked: the renderer and the recording hold threads.
    context = get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, max_tasks_per_child=_TASKS_A_PROCESS) as pool:
        waiting = {pool.submit(function, task): number for number, task in enumerate(tasks)}
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BrokenProcessPool as error:
            raise PluginError(
                "ended the process of a run; start again to repeat it, with --jobs 1 to see which it was",
                plugin="(one of them)",
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
