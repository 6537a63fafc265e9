"""Sweeps: the runs of a matrix, one table, and what happens where something is killed in the middle."""

from __future__ import annotations

import csv
import io
import json
import os
import signal
import subprocess
import sys
import time
from importlib import util
from pathlib import Path
from typing import Any

import pytest
from project import FAKE_RUN, Project, environment, project

PROBE = """
import os, signal, time
from pathlib import Path
from fake_plugins import FakeSource, SourceConfig
from dssmsg.hookspecs import hookimpl

HERE = Path(__file__).parent

def say(word, context, config):
    with (HERE / "log").open("a") as log:
        log.write(f"{word} {context.seed} {config.frames}\\n")

class Probe(FakeSource):
    def __init__(self, config, context):
        super().__init__(config, context)
        self._context = context
        say("begin", context, config)

    def step(self, command):
        trap = HERE / f"kill-{self._context.seed}-{self._config.frames}"
        if trap.exists():
            trap.unlink()
            os.kill(os.getpid(), signal.SIGKILL)
        while (HERE / "hold").exists() and self._context.seed:
            time.sleep(0.05)
        return super().step(command)

    def close(self):
        say("end", self._context, self._config)

@hookimpl
def register_source(register):
    register("probe", Probe, config=SourceConfig)
"""
BASE = FAKE_RUN.replace("plugins: [", "plugins: [probe.py, ").replace(
    "source: {use: fake}", "source: {use: probe}"
)
MATRIX = """
config: base.yaml
configurations:
  short:
  long: {source.frames: 5}
seeds: 2
"""
SIMULATED = "set: {source: {use: pybullet}}\n"
RUNS = [f"{seed} {frames}" for seed in (0, 1) for frames in (3, 5)]


OUTSIDE = {"PYTHONPATH": str(Path(__file__).parent), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""What a process of its own needs to find the tests' plug-ins."""


@pytest.fixture
def folder(tmp_path: Path) -> Project:
    return project(tmp_path, {"base.yaml": BASE, "probe.py": PROBE, "matrix.yaml": MATRIX})


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Project, str]:
    """A sweep that nothing came in the way of, and the table that it printed."""
    files = {"base.yaml": BASE, "probe.py": PROBE, "matrix.yaml": MATRIX}
    made = project(tmp_path_factory.mktemp("whole"), files)
    done = made.run("sweep", "matrix.yaml", "--jobs", "2", "--json")
    assert done.code == 0, done.err
    return made, done.out


def with_seeds(folder: Project, seeds: str) -> None:
    (folder.path / "matrix.yaml").write_text(MATRIX.replace("seeds: 2", f"seeds: {seeds}"))


def log(folder: Project, word: str) -> list[str]:
    file = folder.path / "log"
    lines = file.read_text().splitlines() if file.exists() else []
    return sorted(line.removeprefix(f"{word} ") for line in lines if line.startswith(word))


def rows(out: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(out)))


def test_every_combination_is_run_once_and_the_table_is_the_same_again(whole: tuple[Project, str]) -> None:
    folder, printed_first = whole
    table_rows = json.loads(printed_first)
    assert log(folder, "end") == RUNS
    table = {(row["configuration"], row["metric"]): (row["mean"], row["std"], row["n"]) for row in table_rows}
    assert table["short", "frames"] == (3.0, 0.0, 2)
    assert table["long", "frames"] == (5.0, 0.0, 2)
    assert table["long", "failed"] == (0.0, 0.0, 2)
    assert all(row["table"] == "sweep" for row in table_rows)
    again = folder.run("sweep", "matrix.yaml", "--json")
    assert (again.code, again.out) == (0, printed_first)
    lines = again.err.splitlines()
    assert lines[0].startswith("sweep in sweeps/matrix: 4 runs, up to ")
    assert lines[1] == "4 of 4 runs were done before"
    assert log(folder, "begin") == RUNS
    kept = rows((folder.path / "sweeps/matrix/runs.csv").read_text())
    assert [(row["configuration"], row["seed"]) for row in kept] == [
        (name, seed) for seed in "01" for name in ("short", "long")
    ]
    assert all((folder.path / "sweeps/matrix" / row["recording"]).is_file() for row in kept)
    printed = folder.run("sweep", "matrix.yaml", "--csv")
    assert [(row["metric"], float(row["mean"])) for row in rows(printed.out)] == [
        (row["metric"], row["mean"]) for row in table_rows
    ]
    text = folder.run("sweep", "matrix.yaml")
    assert [line.split()[:2] for line in text.out.splitlines()[1:]] == [["short", "2"], ["long", "2"]]


def start(folder: Project, *arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        folder.command("sweep", "matrix.yaml", *arguments),
        cwd=folder.path,
        env=environment(OUTSIDE),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def wait_until(true: Any, secs: float = 200.0) -> None:
    deadline = time.monotonic() + secs
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_sweep_that_was_killed_goes_on_and_repeats_nothing(
    folder: Project, whole: tuple[Project, str]
) -> None:
    (folder.path / "hold").touch()  # the runs of seed 1 wait in their first frame
    process = start(folder, "--jobs", "1")
    try:
        wait_until(lambda: len(log(folder, "end")) == 2 and len(log(folder, "begin")) == 3)
    finally:
        process.kill()
        process.wait()
    (folder.path / "hold").unlink()
    assert log(folder, "end") == RUNS[:2]
    done = folder.run("sweep", "matrix.yaml", "--jobs", "2", "--json")
    assert done.code == 0, done.err
    assert "2 of 4 runs were done before" in done.err
    begun = log(folder, "begin")
    assert [begun.count(run) for run in RUNS[:2]] == [1, 1]
    assert sorted(set(begun)) == RUNS
    assert done.out == whole[1]


def test_a_run_whose_process_is_killed_is_tried_again(folder: Project) -> None:
    with_seeds(folder, "1")
    (folder.path / "kill-0-5").touch()
    done = folder.run("sweep", "matrix.yaml", "--jobs", "1", "--csv")
    assert done.code == 0, done.err
    begun = log(folder, "begin")
    assert [begun.count(run) for run in RUNS] == [1, 2, 0, 0]
    assert {row["mean"] for row in rows(done.out) if row["metric"] == "failed"} == {"0.0"}


@pytest.mark.skipif(util.find_spec("ray") is None, reason="ray is not installed")
def test_ray_gives_the_same_table_also_where_a_worker_is_killed(
    folder: Project, whole: tuple[Project, str]
) -> None:
    (folder.path / "kill-0-5").touch()
    process = folder.run_process(
        "sweep", "matrix.yaml", "--engine", "ray", "--jobs", "2", "--json", "--work", "cluster", env=OUTSIDE
    )
    assert process.code == 0, process.err
    begun = log(folder, "begin")
    assert [begun.count(run) for run in RUNS] == [1, 2, 1, 1]
    assert process.out == whole[1]


def test_a_run_that_fails_is_counted_named_and_tried_again_next_time(folder: Project) -> None:
    bad = BASE + "on_error: fail\n"
    (folder.path / "base.yaml").write_text(bad)
    (folder.path / "matrix.yaml").write_text(
        "config: base.yaml\nconfigurations: {good: , bad: {source.width: 16}}\n"
    )
    done = folder.run("sweep", "matrix.yaml", "--jobs", "2", "--json")
    assert done.code == 1
    failed = {row["configuration"]: row["mean"] for row in done.json if row["metric"] == "failed"}
    assert failed == {"good": 0.0, "bad": 1.0}
    assert "failed: bad, seed 0" in done.err
    assert "Traceback" not in done.err
    assert "16" in done.err  # what was wrong with the frame
    folder.run("sweep", "matrix.yaml", "--jobs", "1")
    assert sorted(log(folder, "begin")) == ["0 3"] * 3  # the good one once, the bad one twice


def alive(group: int) -> list[str]:
    """The processes of a group that still run."""
    found = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, _, rest = file.read_text().rpartition(")")
        except OSError:  # it ended meanwhile
            continue
        state, _, its_group, *_ = rest.split()
        if int(its_group) == group and state not in "ZX":
            found.append(name)
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="reads the kernel's table of processes")
def test_interrupted_children_do_not_outlive_the_sweep(folder: Project) -> None:
    with_seeds(folder, "[1]")  # all of them are held
    (folder.path / "hold").touch()
    process = start(folder, "--jobs", "1")
    try:
        wait_until(lambda: log(folder, "begin"))
        os.kill(process.pid, signal.SIGTERM)
        assert process.wait(30) == 143
    finally:
        process.kill()
    wait_until(lambda: not alive(process.pid), 30.0)


def test_what_is_wrong_only_in_a_run_is_said_with_the_file_too(folder: Project) -> None:
    (folder.path / "matrix.yaml").write_text(
        "config: base.yaml\nconfigurations: {none: {source.frames: 0}}\n"
    )
    done = folder.run("sweep", "matrix.yaml")
    assert done.code == 1
    assert (
        "failed: none, seed 0: matrix.yaml, configuration none: source: source fake gave no frame" in done.err
    )


def test_a_plugin_file_that_does_not_load_is_said_once(folder: Project) -> None:
    with_seeds(folder, "1")
    (folder.path / "broken.py").write_text("import nothing_of_the_kind\n")
    text = BASE.replace("plugins: [", "plugins: [broken.py, ")
    (folder.path / "base.yaml").write_text(text)
    done = folder.run("sweep", "matrix.yaml", "--jobs", "2")
    assert done.code == 0, done.err
    assert [line for line in done.err.splitlines() if "broken.py" in line] == [
        f"warning: {folder.path}/broken.py: failed to load: ModuleNotFoundError: No module named"
        " 'nothing_of_the_kind'"
    ]


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        ("seeds: 0", "seeds"),
        ("seeds: [1, x]", "seeds"),
        ("colour: red", "colour"),
        ("configurations: {}", "configurations"),
        ("configurations: {a b: }", "configurations"),
        ("configurations: {a: {source.nothing: 1}}", "configuration a: source.nothing"),
        ("configurations: {a: {perception: {use: nobody}}}", "nobody"),
        ("config: missing.yaml\nseeds: 1", "missing.yaml"),
        ("", "says nothing to sweep; expected configurations, scenes or seeds"),
        ("set: {source.frames: 4}", "says nothing to sweep"),
        (
            f"{SIMULATED}scenes: [rs_int, nowhere]",
            "matrix.yaml, configuration default: source.scene: unknown",
        ),
        (
            f"{SIMULATED}scenes: ['generated:x']",
            "configuration default: source.scene: expected generated:<seed>",
        ),
        (f"{SIMULATED}scenes: [gone.yaml]", "gone.yaml: no such scene file"),
        (f"{SIMULATED}scenes: [base.yaml]", "base.yaml: rooms: "),
        ("[1, 2]", "matrix.yaml"),
    ],
)
def test_a_wrong_matrix_is_said_before_anything_is_run(folder: Project, matrix: str, words: str) -> None:
    if not matrix.startswith(("config:", "[")):
        matrix = f"config: base.yaml\n{matrix}"
    (folder.path / "matrix.yaml").write_text(matrix)
    done = folder.run("sweep", "matrix.yaml")
    assert done.code == 2
    assert words in done.err
    assert "--set" not in done.err
    assert len(done.err.splitlines()) <= 2
    assert not (folder.path / "sweeps").exists()


def test_an_empty_matrix_is_refused(folder: Project) -> None:
    (folder.path / "matrix.yaml").write_text("")
    done = folder.run("sweep", "matrix.yaml")
    assert done.code == 2
    assert "matrix.yaml: says nothing to sweep" in done.err
    assert not (folder.path / "sweeps").exists()


def test_options_that_contradict_each_other_are_refused(folder: Project) -> None:
    assert folder.run("sweep", "matrix.yaml", "--csv", "--json").code == 2
    assert folder.run("sweep", "matrix.yaml", "--address", "127.0.0.1:1").code == 2
    assert folder.run("sweep", "nothing.yaml").code == 2
