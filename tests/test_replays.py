"""A home that changes, recorded once, replayed through methods and scored: from end to end."""

from __future__ import annotations

import json
import types
from pathlib import Path
from typing import Any

import pytest

from dssmsg.cli import main
from dssmsg.errors import ConfigError, InputError
from dssmsg.evaluate import replays
from dssmsg.evaluate.dynamic_truth import run_truth
from dssmsg.evaluate.replay_score import ReplayScore
from dssmsg.evaluate.replays import Case, Setup, methods_named, replay_cases
from dssmsg.evaluate.replays_occlusion import occlusion_cases, screened
from dssmsg.recording.reader import Recording
from dssmsg.sim.camera import probe_open3d
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.scene import load_scene

pytestmark = pytest.mark.skipif(bool(probe_open3d()), reason="needs Open3D's ray casting")

DEN = """
name: den
rooms:
  - {name: den, type: living room, x: [0, 4], y: [0, 4]}
  - {name: cell, type: storage, x: [4.1, 6], y: [0, 4]}
doors:
  - {name: way, between: [den, cell], along: 3.5, width: 0.7}
furniture:
  - {id: table-1, category: table, at: [3.0, 2.0], yaw_deg: 90, size: [1.2, 0.8, 0.75]}
  - {id: laptop-1, category: laptop, on: table-1, at: [0.3, 0.0]}
  - {id: vase-1, category: vase, on: table-1, at: [-0.3, 0.0]}
  - {id: chair-1, category: chair, at: [0.9, 3.4], size: [0.42, 0.46, 0.88]}
  - {id: sofa-1, category: sofa, wall: den.south, along: 2.0, size: [1.8, 0.8, 0.8]}
  - {id: box-1, category: box, at: [5.5, 0.5], size: [0.5, 0.5, 0.5]}
tour:
  - {name: a, at: [1.7, 2.0], views: [[0, -25], [-80, -25], [98, -25]]}
changes:
  - {kind: disappear, object: vase-1, before_visit: 1}
  - {kind: relocate, object: chair-1, before_visit: 1, to: {at: [2.1, 3.5], yaw_deg: 30, z: 0.0}, tag: near}
  - {kind: appear, before_visit: 1, piece: {id: backpack-1, category: backpack, at: [2.4, 1.0], z: 0.0}}
  - {kind: relocate, object: box-1, before_visit: 1, to: {at: [5.5, 2.0]}}
"""
SETS = ("source.assets=embedded", "source.noise=none", "timeout_secs=120")


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("work")
    (folder / "den.yaml").write_text(DEN)
    return folder


@pytest.fixture(scope="module")
def case(work: Path) -> Case:
    return Case("den", 0, "oracle", file=work / "den.yaml")


@pytest.fixture(scope="module")
def scores(work: Path, case: Case) -> list[ReplayScore]:
    return replay_cases(Setup(work, None, SETS), [case], methods_named(["none", "conceptgraphs"]))


def test_the_truth_of_the_run(work: Path, scores: list[ReplayScore]) -> None:
    with Recording.open(work / scores[0].recording) as recording:
        truth = run_truth(recording)
    after = {thing.name: thing for thing in truth.after}
    assert {name: thing.state for name, thing in after.items()} == {
        "table-1": "static",
        "laptop-1": "static",
        "vase-1": "disappeared",
        "chair-1": "moved",
        "sofa-1": "static",
        "box-1": "moved",
        "backpack-1": "appeared",
    }
    assert {name for name, thing in after.items() if not thing.counted} == {"box-1"}  # behind the wall
    assert after["chair-1"].tag == "near"
    assert after["chair-1"].former is not None
    assert after["chair-1"].former_seen
    assert after["laptop-1"].retained
    assert {thing.name for thing in truth.before if thing.counted} == {
        "table-1", "laptop-1", "vase-1", "chair-1", "sofa-1",
    }  # fmt: skip


def test_a_map_without_an_update_keeps_ghosts_and_finds_what_is_new(scores: list[ReplayScore]) -> None:
    none = scores[0]
    assert (none.method, none.errors) == ("none", 0)
    assert none.appear.right == 1
    assert none.disappear.missed == ("vase-1",)
    assert none.relocation.missed == ("chair-1",)
    assert none.update.updated == 1
    assert (none.update.static, none.update.retained) == (3, 3)
    assert len(none.static.wrong) == 2  # the vase and the chair where they were
    assert none.recovery.previous > none.recovery.outdated


def test_all_methods_share_one_recording_and_nothing_is_done_twice(
    work: Path, case: Case, scores: list[ReplayScore], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len({score.recording for score in scores}) == 1

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("made again")

    monkeypatch.setattr(replays, "Mission", refuse)
    lines: list[str] = []
    again = replay_cases(
        Setup(work, None, SETS), [case], methods_named(["conceptgraphs", "none"]), progress=lines.append
    )
    assert again == scores[::-1]
    assert lines[0].startswith("1 of 1: den, seed 0: dynamic F1 conceptgraphs")
    with pytest.raises(AssertionError, match="made again"):
        replay_cases(Setup(work, None, SETS), [case], methods_named(["dovsg"]))


def test_wrong_settings_are_refused_before_anything_runs(work: Path, case: Case) -> None:
    with pytest.raises(ConfigError, match=r"source\.sceen"):
        replay_cases(Setup(work, None, (*SETS, "source.sceen=x")), [case], methods_named(["none"]))
    with pytest.raises(ConfigError, match="need the source pybullet"):
        replay_cases(Setup(work, None, ("source.use=rgbd",)), [case], methods_named(["none"]))


def test_a_run_without_a_revisit_cannot_be_scored() -> None:
    empty: Any = types.SimpleNamespace(key_frames=[], path=Path("a.rrd"))
    with pytest.raises(InputError, match="a survey and a revisit"):
        run_truth(empty)


def test_occlusion_cases_are_scene_files_that_are_kept(work: Path) -> None:
    first = occlusion_cases(work, ["rs_int"], 2, "oracle", assets="embedded")
    files = [case.file for case in first]
    assert len(set(files)) == 2
    written = [file.read_text() for file in files if file is not None]
    for file in files:
        assert file is not None
        scene = load_scene(str(file))
        assert len(scene.tour) == 1
        assert [change.tag for change in scene.changes] == ["occluder"]
    assert [case.file for case in occlusion_cases(work, ["rs_int"], 2, "oracle", assets="embedded")] == files
    assert [file.read_text() for file in files if file is not None] == written


def test_a_scene_without_room_for_a_screen_is_an_error(work: Path) -> None:
    bare = load_scene(str(work / "den.yaml")).model_copy(update={"tour": ()})
    with pytest.raises(InputError, match="no stop at which a screen hides"):
        screened(bare, FurnitureLibrary.open("embedded"), 0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["table1", "--methods", "dsm"], "unknown method 'dsm'"),
        (["fig5", "--scenes", "nowhere", "--seeds", "1"], "unknown scene"),
    ],
)
def test_the_command_line_says_what_is_wrong(
    arguments: list[str], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["eval", *arguments, "--json"]) == 2
    assert message in json.loads(capfd.readouterr().out)["error"]["message"]
