"""Work shared out over processes: every task once, whatever is raised, and a process that dies."""

from __future__ import annotations

import os

import pytest

from dssmsg.errors import ConfigError, PluginError
from dssmsg.evaluate.workers import each


def doubled(task: int) -> tuple[int, int]:
    return 2 * task, os.getpid()


def refusing(task: int) -> int:
    if task == 1:
        raise ConfigError("no such scene", key="--scenes")
    return task


def dying(task: int) -> int:
    if task == 1:
        os._exit(3)
    return task


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_task_is_done_once_however_many_jobs(jobs: int) -> None:
    tasks = list(range(5))  # more than twice the processes: each of these does one
    found = dict(each(doubled, tasks, jobs))
    assert {number: result for number, (result, _) in found.items()} == {n: 2 * n for n in tasks}
    here = {pid for _, pid in found.values()} == {os.getpid()}
    assert here == (jobs == 1)


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_task_raises_is_raised(jobs: int) -> None:
    with pytest.raises(ConfigError, match="no such scene"):
        list(each(refusing, [0, 1, 2], jobs))


def test_a_task_that_ends_its_process_is_told_of() -> None:
    with pytest.raises(PluginError, match="ended the process"):
        list(each(dying, [0, 1, 2, 3], 2))
