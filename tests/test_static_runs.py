"""`dssmsg eval static`: runs, scores, rows, and going on where it stopped."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from project import project

from dssmsg.errors import ConfigError
from dssmsg.evaluate import missions
from dssmsg.evaluate.static_runs import StaticRun, evaluate_static, static_rows
from dssmsg.recording.reader import Recording

SETS = ("source.assets=embedded", "mission.max_frames=24", "mission.phases=[survey]")


def run_of(scene, perception, seed, f1):
    return StaticRun(scene, perception, "dssm", seed, "x.rrd", f1 / 2, f1, f1, 3, 0, (), (), 1.0)


def sweep(work, seeds=(0, 1), **options):
    given = {"scenes": ["rs_int"], "perceptions": ["oracle"], "sets": SETS, **options}
    return evaluate_static(work, seeds=seeds, **given)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder with two finished runs, and what came back."""
    work = tmp_path_factory.mktemp("sweep")
    return work, sweep(work)


@pytest.fixture
def forbidden(monkeypatch):
    """No mission may run any more."""

    def refuse(*_args, **_more):
        raise AssertionError("a mission was run")

    monkeypatch.setattr(missions, "run_mission", refuse)


def test_rows_are_mean_and_spread_over_seeds():
    runs = [run_of("a", "oracle", 0, 0.8), run_of("a", "oracle", 1, 1.0), run_of("b", "oracle", 0, 0.5)]
    rows = static_rows(runs)
    first, single = rows[0], rows[3]
    assert (first["table"], first["scene"], first["method"], first["perception"]) == (
        "static", "a", "dssm", "oracle",
    )  # fmt: skip
    assert [row["metric"] for row in rows[:3]] == ["static_f1", "static_precision", "static_recall"]
    assert (first["mean"], first["n"]) == (pytest.approx(0.9), 2)
    assert first["std"] == pytest.approx(np.sqrt(0.02))  # of the sample
    assert (single["scene"], single["mean"], single["std"], single["n"]) == ("b", 0.5, 0.0, 1)


def test_runs_are_scored_and_seeds_differ(finished):
    work, runs = finished
    assert [(run.scene, run.perception, run.method, run.seed) for run in runs] == [
        ("rs_int", "oracle", "dssm", 0),
        ("rs_int", "oracle", "dssm", 1),
    ]
    for run in runs:
        assert run.right > 0
        assert 0 < run.f1 <= 1
        assert run.seconds > 0
    depths = []
    for run in runs:
        with Recording.open(work / run.recording) as recording:
            depths.append(recording.frame(5).depth)
    assert (depths[0] != depths[1]).mean() > 0.3  # the noise is another one


def test_finished_runs_are_not_repeated(finished, forbidden):
    work, runs = finished
    assert sweep(work) == runs


def test_another_configuration_is_another_run(finished, forbidden):
    with pytest.raises(AssertionError, match="a mission was run"):
        sweep(finished[0], sets=(*SETS, "association.delta_sim=1.2"))


def test_a_run_that_was_cut_is_done_again(finished, tmp_path):
    work, runs = finished
    (name,) = [file.stem for file in work.glob("*-1-*.json")]
    shutil.copytree(work, tmp_path / "cut")
    (tmp_path / "cut" / f"{name}.json").unlink()
    (tmp_path / "cut" / name / "done.json").unlink()
    (tmp_path / "cut" / name / "leftover").touch()
    again = sweep(tmp_path / "cut")
    assert again[0] == runs[0]
    assert (again[1].f1, again[1].missed, again[1].wrong) == (runs[1].f1, runs[1].missed, runs[1].wrong)
    assert not (tmp_path / "cut" / name / "leftover").exists()


def test_a_recording_that_is_finished_is_scored_without_a_run(finished, tmp_path, forbidden):
    work, runs = finished
    shutil.copytree(work, tmp_path / "kept")
    for file in (tmp_path / "kept").glob("*.json"):
        file.unlink()
    assert sweep(tmp_path / "kept") == runs


@pytest.mark.parametrize("content", ["{", "[]", "{}", json.dumps({"missed": [], "wrong": [], "x": 1})])
def test_a_result_that_is_none_is_named(finished, tmp_path, content, forbidden):
    (name,) = [file.name for file in finished[0].glob("*-0-*.json")]
    (tmp_path / name).write_text(content)
    with pytest.raises(ConfigError, match="no result of this evaluation") as error:
        sweep(tmp_path, seeds=(0,))
    assert error.value.file == str(tmp_path / name)


def test_wrong_configurations_are_refused_before_the_first_run(tmp_path, forbidden):
    with pytest.raises(ConfigError, match="rerun"):
        sweep(tmp_path, sets=("recording.observers.rerun=false",))
    with pytest.raises(ConfigError, match="oracle"):
        sweep(tmp_path, perceptions=["oracle", "orakle"])


def test_the_command_prints_rows_and_keeps_nothing_unasked(finished, tmp_path, forbidden):
    work, runs = finished
    arguments = ["eval", "static", "--scenes", "rs_int", "--perception", "oracle", "--seeds", "2"]
    for assignment in SETS:
        arguments += ["--set", assignment]
    done = project(tmp_path).run(*arguments, "--work", str(work), "--json")
    assert done.code == 0, done.err
    assert done.json == static_rows(runs)
    assert "2 of 2: rs_int, oracle, seed 1: F1" in done.err
    table = project(tmp_path).run(*arguments, "--work", str(work)).out
    assert table.splitlines()[0].split() == ["scene", "method", "perception", "metric", "mean", "std", "n"]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("names", ["", "a,,b", "rs_int,rs_int"])
def test_lists_of_names_are_checked(tmp_path, names):
    done = project(tmp_path).run("eval", "static", "--scenes", names)
    assert done.code == 2
    assert "--scenes" in done.err
