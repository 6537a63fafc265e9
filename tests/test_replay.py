"""`dssmsg replay`: recorded frames through the plug-ins again, or through others, never a stranger's."""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from project import Outcome, Project, project
from recorded_run import SyntheticRun, record

from dssmsg import events as ev
from dssmsg.errors import ConfigError, InputError
from dssmsg.frame import Frame
from dssmsg.mission.ahead import Ahead, Ready
from dssmsg.mission.replay_config import ReplayPlan, plan_replay, worth_processes
from dssmsg.recording.lazy_frame import Elsewhere, LazyFrame, looking
from dssmsg.recording.reader import Recording
from dssmsg.review.diff import compare
from dssmsg.sim.camera import probe_open3d

needs_open3d = pytest.mark.skipif(bool(probe_open3d()), reason="needs Open3D's ray casting")

DEN = """
name: den
rooms:
  - {name: den, type: living room, x: [0, 4], y: [0, 4]}
furniture:
  - {id: table-1, category: table, at: [3.0, 2.0], yaw_deg: 90, size: [1.2, 0.8, 0.75]}
  - {id: vase-1, category: vase, on: table-1, at: [-0.3, 0.0]}
  - {id: chair-1, category: chair, at: [0.9, 3.4], size: [0.42, 0.46, 0.88]}
  - {id: sofa-1, category: sofa, wall: den.south, along: 2.0, size: [1.8, 0.8, 0.8]}
tour:
  - {name: a, at: [1.7, 2.0], views: [[0, -25], [-80, -25]]}
  - {name: b, at: [1.4, 2.6], views: [[98, -25]]}
changes:
  - {kind: disappear, object: vase-1, before_visit: 1}
  - {kind: relocate, object: chair-1, before_visit: 1, to: {at: [2.1, 3.5], yaw_deg: 30, z: 0.0}}
"""
RUN = """
source: {use: pybullet, scene: den.yaml, assets: embedded, visits: 2, width: 128, height: 96}
mission:
  phases: [survey, revisit, seek]
  goals: [the sofa, the chair]
  max_frames: 300
perception: {use: oracle, wrong_label_rate: 0.05, min_pixels: 30}
recording: {observers: {rerun: {images: lossless}}}
timeout_secs: 300
"""
TAKE = Ahead.take
TABLES = ("windows", "matches", "navigation", "episodes", "errors", "phases")


@pytest.fixture(scope="module")
def den(tmp_path_factory: pytest.TempPathFactory) -> Project:
    return project(tmp_path_factory.mktemp("den"), {"den.yaml": DEN, "dssmsg.yaml": RUN})


@pytest.fixture(scope="module")
def original(den: Project) -> Path:
    done = den.run("run", "--json")
    assert done.code == 0, done.err
    assert {one["goal"] for one in done.json["episodes"]} == {"the sofa", "the chair"}
    return den.path / done.json["recording"]


def replay(place: Project, path: Path, *arguments: str) -> tuple[Outcome, Path]:
    done = place.run("replay", str(path), "--set", "timeout_secs=300", *arguments, "--json")
    assert done.code == 0, done.err
    return done, place.path / done.json["recording"]


@pytest.fixture(scope="module")
def again(den: Project, original: Path) -> tuple[Outcome, Path]:
    return replay(den, original)


@needs_open3d
def test_unchanged_plugins_on_lossless_images_give_the_same_log(
    original: Path, again: tuple[Outcome, Path]
) -> None:
    with Recording.open(original) as a, Recording.open(again[1]) as b:
        assert list(b.change_rows()) == list(a.change_rows())
        assert a.changes_readable > 100
        for table in TABLES:
            assert getattr(b, table)() == getattr(a, table)(), table
        assert [b.frame_facts[i] for i in b.frame_indices] == [a.frame_facts[i] for i in a.frame_indices]
        assert b.encoded_images(5) == a.encoded_images(5)
        found = compare(a, b)
    assert found.same
    assert (found.a.relation, found.b.relation) == ("parent", "replay")


@needs_open3d
def test_it_names_its_parent_and_keeps_what_the_robot_did(
    original: Path, again: tuple[Outcome, Path]
) -> None:
    summary = again[0].json
    with Recording.open(original) as a, Recording.open(again[1]) as b:
        facts = b.facts["source"]["facts"]
        assert b.facts["parent"] == summary["parent"] == a.facts["run_id"]
        assert facts["parent_file"] == original.name
        assert facts["parent_sha256"] == hashlib.sha256(original.read_bytes()).hexdigest()
        assert b.facts["name"] == "default-replay"
        assert [b.command(i) for i in b.frame_indices] == [a.command(i) for i in a.frame_indices]
        # In seek navigation is asked again; it asks for what it asked for, which led to these frames.
        seek = a.phases()[-1]["frame"]
        advised = [i for i in b.frame_indices if b.advice(i) is not None]
        assert advised
        assert min(advised) >= seek
        assert all(b.advice(i) == b.command(i) for i in advised)
        assert b.facts["plugins"]["perception"]["name"] == "recorded"
        assert b.facts["plugins"]["llm"]["name"] == "recorded"
    assert summary["faster"] > 0
    assert "recorded detections and answers of the language model used again" in again[0].err


@needs_open3d
@pytest.mark.parametrize("killed_at", [None, 9])
def test_a_second_process_changes_nothing_also_where_it_is_killed(
    den: Project, original: Path, monkeypatch: pytest.MonkeyPatch, killed_at: int | None
) -> None:
    taken: list[bool] = []

    def take(self: Ahead, index: int) -> Ready | None:
        if index == killed_at:
            self._process.kill()
            self._process.join()
        taken.append((ready := TAKE(self, index)) is not None)
        return ready

    monkeypatch.setattr(Ahead, "take", take)
    monkeypatch.setattr("dssmsg.mission.replay_config._WORTH_A_PROCESS", 1)
    _, path = replay(den, original)
    with Recording.open(original) as a, Recording.open(path) as b:
        assert list(b.change_rows()) == list(a.change_rows())
        assert [b.frame_facts[i] for i in b.frame_indices] == [a.frame_facts[i] for i in a.frame_indices]
        for index in (0, 20, a.frame_indices[-1]):
            assert b.encoded_truth(index) == a.encoded_truth(index)
            assert b.detection_cells(index) == a.detection_cells(index)
        assert len(taken) == len(a.frame_indices)
    assert taken[0]
    assert all(taken) == (killed_at is None)


@needs_open3d
def test_what_was_lifted_is_recorded_and_not_searched_for_again(
    den: Project, original: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Recording.open(original) as a:
        kept = {index: a.kept(index) for index in a.key_frames}
    assert all(one is not None for one in kept.values())
    assert any(kept.values())

    def searched(*_: object) -> None:
        raise AssertionError("clusters were searched for")

    monkeypatch.setattr("dssmsg.lift.density_clusters", searched)
    _, path = replay(den, original)
    with Recording.open(original) as a, Recording.open(path) as b:
        assert list(b.change_rows()) == list(a.change_rows())
        for index, masks in kept.items():
            again = b.kept(index)
            assert again is not None
            assert masks is not None
            assert {name: one.tolist() for name, one in again.items()} == {
                name: one.tolist() for name, one in masks.items()
            }


@needs_open3d
def test_the_user_says_whether_another_process_writes(
    original: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(*sets: str) -> object:
        with Recording.open(original) as recording:
            made = plan_replay(recording, sets=sets, environment={}, processes=worth_processes(recording))
        return made.config.recording.observers["rerun"].options.get("process")

    assert asked() is None  # too little to do
    monkeypatch.setattr("dssmsg.mission.replay_config._WORTH_A_PROCESS", 10)
    assert asked() is True
    assert asked("recording.observers.rerun.process=false") is False


@needs_open3d
def test_another_threshold_gives_another_map_and_diff_says_why(
    den: Project, original: Path, again: tuple[Outcome, Path]
) -> None:
    done, path = replay(den, original, "--set", "association.delta_sim=1.9")
    assert "association.delta_sim: 1.1 -> 1.9" in done.err
    with Recording.open(original) as a, Recording.open(path) as b:
        found = compare(a, b)
    assert found.divergence is not None
    assert found.divergence.plugin == "association/dssm"
    assert [one.key for one in found.because] == ["association.delta_sim"]
    assert {one.key for one in found.settings} == {"association.delta_sim"}


@needs_open3d
def test_other_perception_and_navigation_are_run(den: Project, original: Path) -> None:
    done, path = replay(
        den, original, "--set", "perception.wrong_label_rate=0.9", "--set", "navigation.detour=false"
    )
    assert "recorded answers of the language model used again" in done.err
    with Recording.open(original) as a, Recording.open(path) as b:
        assert b.facts["plugins"]["perception"]["name"] == "oracle"
        assert b.config["navigation"]["detour"] is False
        assert b.key_frames == a.key_frames
        found = compare(a, b)
        assert found.divergence is not None
        assert found.divergence.layer == "perception"
        # Whatever came of the episodes: they had the frames that were driven.
        assert [one["goal"] for one in b.episodes()] == ["the sofa", "the chair"]
        assert b.frame_indices == a.frame_indices


@needs_open3d
def test_a_recording_that_was_cut_off_is_replayed_as_far_as_it_got(
    den: Project, original: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.rrd"
    content = original.read_bytes()
    for share in range(50, 100, 5):  # where the images lie in a finished file is not promised
        cut.write_bytes(content[: len(content) * share // 100])
        with Recording.open(cut) as short:
            if short.frames_readable:
                break
    apart = den.run_process(
        "replay",
        str(cut),
        "--set",
        "recording.observers.rerun.process=true",
        "--set",
        "timeout_secs=300",
        "--json",
    )
    assert apart.code == 0, apart.err
    with Recording.open(cut) as short:
        assert 0 < apart.json["frames"] == short.frames_readable
    # Source, perception, language model and the process that writes read it too.
    said = [line for line in apart.err.splitlines() if "repaired copy" in line]
    assert said == [f"warning: {cut} was cut off, or is still being written: reading a repaired copy"]


# What a replay is put together from.


class ConfiguredRun(SyntheticRun):
    """A run that says it had some configuration."""

    def __init__(self, config: Mapping[str, Any]) -> None:
        super().__init__(6)
        self._config = config

    def started(self) -> ev.RunStarted:
        from dataclasses import replace

        return replace(super().started(), config=self._config)


def stranger(path: Path, config: Mapping[str, Any]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return record(ConfiguredRun(config), path)


def plan(path: Path, *sets: str, file: Path | None = None) -> ReplayPlan:
    with Recording.open(path) as recording:
        return plan_replay(recording, sets=sets, file=file, environment={})


OWN = """
class Own:
    def associate(self, frame, observations, viewpoint_id):
        return ()

    def finish(self):
        return ()
"""
EVIL = "from pathlib import Path\nPath({marker!r}).touch()\nclass Evil:\n    pass\n"


def test_where_the_frames_are_used_up_in_an_episode_the_next_one_never_begins(
    den: Project, original: Path
) -> None:
    with Recording.open(original) as recording:
        surveyed = next(row["frame"] for row in recording.phases() if row["phase"] == "revisit")
    sets = ("mission.phases=[survey,seek]", f"mission.max_frames={surveyed + 2}")
    done = den.run("run", *(part for one in sets for part in ("--set", one)), "--json")
    assert done.code == 0, done.err
    assert [one["reason"] for one in done.json["episodes"]] == ["out of time", "not begun"]
    path = den.path / done.json["recording"]
    again, _ = replay(den, path)
    assert again.json["episodes"] == done.json["episodes"]
    for episode, verdict in enumerate(("cannot tell", "not begun")):
        told = den.run("explain", str(path), "--episode", str(episode), "--json").json
        assert (told["verdict"], told["key"]) == (verdict, "mission.max_frames")
        assert f"where mission.max_frames ({surveyed + 2}) was used up; raise it" in told["note"]


def test_nothing_that_a_recording_names_is_imported(tmp_path: Path) -> None:
    marker, evil = tmp_path / "was-here", tmp_path / "evil.py"
    evil.write_text(EVIL.format(marker=str(marker)))
    code = f"{evil}:Evil"
    slots: list[tuple[dict[str, Any], str]] = [
        ({"association": {"use": code}}, "association.use"),
        ({"encoder": {"use": code}}, "encoder.use"),
        ({"navigation": {"use": "antigravity:fly"}}, "navigation.use"),
        # A chain hides its links deeper; without an encoder of its own it would have been reused.
        (
            {"perception": {"use": "chain", "detector": {"use": code}}, "encoder": {"use": "clip"}},
            "perception.detector.use",
        ),
    ]
    for number, (config, key) in enumerate(slots):
        path = stranger(tmp_path / f"{number}.rrd", {"plugins": [str(evil)], **config})
        changed = ("seed=5",) if "perception" in config else ()
        with pytest.raises(ConfigError, match="never imported from there") as caught:
            plan(path, *changed)
        assert caught.value.key == key
    assert not marker.exists()
    done = project(tmp_path).run("replay", str(tmp_path / "0.rrd"))
    assert (done.code, done.out) == (2, "")
    assert "name one of yours by --config FILE or --set association.use=" in done.err
    assert not marker.exists()


def test_plugins_of_the_user_are(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(OWN)
    path = stranger(tmp_path / "a.rrd", {"plugins": ["gone.py"], "association": {"use": "theirs"}})
    assert plan(path, f"association.use={own}:Own").config.association.use == f"{own}:Own"
    file = tmp_path / "mine.yaml"
    file.write_text("association: {use: own.py:Own}\nsource: {use: pybullet}\n")
    made = plan(path, file=file)
    assert made.config.association.use == f"{own}:Own"
    assert made.config.source.use == "recording"
    with pytest.raises(ConfigError, match="plug-in files of a recording are never loaded"):
        plan(path)


def test_servers_and_places_of_a_recording_are_not_used(tmp_path: Path) -> None:
    path = stranger(
        tmp_path / "a.rrd",
        {
            "llm": {"use": "openai", "model": "m", "base_url": "http://203.0.113.5/v1"},
            "recording": {"directory": "/etc", "observers": {"jsonl": {}}},
        },
    )
    made = plan(path)
    assert made.reuses_answers
    assert made.config.llm.flat() == {
        "use": "recorded",
        "recording": str(path),
        "fallback": {"use": "lexicon"},
    }
    assert made.config.recording.directory == "recordings"
    assert set(made.config.recording.observers) == {"rerun"}
    asked = plan(path, "llm.use=scripted", f"llm.file={tmp_path / 'x.yaml'}")
    assert not asked.reuses_answers
    assert "base_url" not in asked.config.llm.options


def test_detections_are_reused_as_long_as_nothing_makes_others(tmp_path: Path) -> None:
    path = stranger(tmp_path / "a.rrd", {"perception": {"use": "segments"}, "seed": 3})
    assert plan(path).reuses_detections
    assert plan(path, "association.delta_sim=1.3", "perception.use=segments").reuses_detections
    assert plan(path, "association.delta_sim=1.3").changed == {"association.delta_sim": (1.1, 1.3)}
    for other in ("perception.use=oracle", "seed=4", "mission.views_per_heading=2"):
        made = plan(path, other)
        assert not made.reuses_detections
        assert made.config.perception.use in ("segments", "oracle")


def test_options_of_an_older_version_are_left_out_and_said(tmp_path: Path) -> None:
    config = {"navigation": {"use": "dijkstra", "max_secs": 9, "detour": False}, "mission": {"speed": 2}}
    path = stranger(tmp_path / "a.rrd", config)
    made = plan(path)
    assert set(made.left_out) == {"navigation.max_secs", "mission.speed"}
    assert made.config.navigation.options["detour"] is False
    with pytest.raises(ConfigError, match="max_secs"):
        plan(path, "navigation.max_secs=9")


@pytest.mark.parametrize(
    ("assignment", "key"),
    [
        ("source.scene=rs_int", "source"),
        ("mission.goals=[a cup]", "mission.goals"),
        ("mission.phases=[survey]", "mission.phases"),
        ("association.delta_sin=1.2", "association.delta_sin"),
        ("perception.use=none", "perception.use"),
    ],
)
def test_what_a_replay_cannot_change_is_refused(tmp_path: Path, assignment: str, key: str) -> None:
    path = stranger(tmp_path / "a.rrd", {})
    with pytest.raises(ConfigError) as caught:
        plan(path, assignment)
    assert caught.value.key == key
    assert caught.value.file == "--set"


def test_a_recording_without_frames_is_refused(tmp_path: Path) -> None:
    class Frameless(SyntheticRun):
        def events(self) -> Any:
            yield self.started()
            yield self.finished()

    path = record(Frameless(1), tmp_path / "empty.rrd")
    done = project(tmp_path).run("replay", str(path), "--json")
    assert done.code == 2
    assert done.json["error"]["kind"] == InputError.kind
    assert "frame" in done.json["error"]["message"]


# Frames that are decoded when they are looked at.


def test_a_lazy_frame_is_a_frame_and_decodes_once() -> None:
    whole = SyntheticRun(1).frame(0)
    decoded: list[int] = []

    def colours() -> np.ndarray:
        decoded.append(1)
        return whole.rgb

    names = ("index", "sim_time", "camera", "world_from_camera", "world_from_base", "visit")
    fields = {name: getattr(whole, name) for name in names}
    frame = LazyFrame(colours, whole.depth, **fields, at_stop=True, truth=whole.truth)
    assert isinstance(frame, Frame)
    plain = looking(frame.without_truth(), False)
    assert (plain.truth, plain.at_stop, frame.at_stop) == (None, False, True)
    assert (plain.heading_rad, plain.position.tolist()) == (whole.heading_rad, whole.position.tolist())
    assert decoded == []
    for one in (plain, frame):
        assert np.array_equal(one.rgb, whole.rgb)
        assert not one.rgb.flags.writeable
    assert decoded == [1]
    assert looking(frame, True) is frame
    assert looking(whole, not whole.at_stop).at_stop is not whole.at_stop


def test_a_lazy_frame_checks_what_it_is_given() -> None:
    whole = SyntheticRun(1).frame(0)
    names = ("index", "sim_time", "camera", "world_from_camera", "world_from_base", "visit", "truth")
    fields = {name: getattr(whole, name) for name in names}
    with pytest.raises(ValueError, match="depth"):
        LazyFrame(whole.rgb, whole.depth[1:], **fields, at_stop=False)
    frame = LazyFrame(lambda: whole.rgb[1:], lambda: whole.depth[1:], **fields, at_stop=False)
    with pytest.raises(ValueError, match="rgb"):
        _ = frame.rgb
    with pytest.raises(ValueError, match="depth"):
        _ = frame.depth


def test_a_lazy_frame_crosses_to_another_process() -> None:
    whole = SyntheticRun(1).frame(0)
    sent = pickle.loads(
        pickle.dumps(LazyFrame.like(whole, rgb=lambda: whole.rgb, depth=lambda: whole.depth, at_stop=True))
    )
    assert np.array_equal(sent.rgb, whole.rgb)
    assert np.array_equal(sent.depth, whole.depth)
    assert (sent.index, sent.at_stop) == (whole.index, True)
    bare = pickle.loads(pickle.dumps(LazyFrame.like(whole, rgb=Elsewhere(), depth=Elsewhere())))
    assert np.array_equal(bare.world_from_camera, whole.world_from_camera)
    with pytest.raises(ValueError, match="another process"):
        _ = bare.rgb


def test_the_summary_is_json(tmp_path: Path) -> None:
    path = stranger(tmp_path / "a.rrd", {"perception": {"use": "segments"}})
    made = plan(path, "association.delta_sim=1.5")
    assert json.dumps(made.changed)
    assert made.config.name == "default-replay"
