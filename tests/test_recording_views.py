"""What the viewer is shown: looks, layouts, descriptions; and the commands that read recordings."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_run import SyntheticRun, record
from rerun.chunk import RrdReader

from dssmsg import events as ev
from dssmsg.cli import main
from dssmsg.errors import ConfigError
from dssmsg.graph import changes as ch
from dssmsg.graph.changes import Cause, Score
from dssmsg.graph.codec import graph_from_json, graph_to_json
from dssmsg.graph.compare import same
from dssmsg.graph.nodes import BELIEVED, NEAR, PATH, SEES, STATIC
from dssmsg.recording import blueprint, describe, looks, palette, schema
from dssmsg.recording.mission_card import MissionCard
from dssmsg.recording.reader import Recording
from dssmsg.recording.scene_log import SceneLog
from dssmsg.review.text import _error_lines


@pytest.fixture(scope="module")
def run() -> SyntheticRun:
    return SyntheticRun(40)


@pytest.fixture(scope="module")
def path(run: SyntheticRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(run, tmp_path_factory.mktemp("views") / "run.rrd")


def test_every_entity_of_the_layouts_is_filled(path: Path) -> None:
    paths = {chunk.entity_path for chunk in RrdReader(path).stream()}
    shown = {
        schema.RGB, schema.DEPTH, schema.SEGMENTATION, schema.BOXES, schema.NAMES, schema.OBJECTS,
        schema.LABELS, schema.WAYPOINTS, schema.VIEWPOINTS, schema.SURFACE, schema.TRAIL, schema.ROBOT,
        schema.PHASE_STATE, schema.NAV_STATE, schema.MISSION, schema.SEEN_NOW,
        f"{schema.LOG}/graph", f"{schema.LOG}/run",
        *(f"{schema.EDGES}/{kind}" for kind in palette.EDGE_COLOURS),
        *(f"{schema.GRAPH}/{name}" for name in ("map", "all", PATH, SEES, NEAR)),
        f"{schema.PLOTS}/objects/believed", f"{schema.PLOTS}/changes/merges",
        f"{schema.PLOTS}/timings/source",
    }  # fmt: skip
    assert shown <= paths
    assert len(RrdReader(path).blueprints()) == 1  # the layout travels inside


def test_an_edge_finds_its_nodes_in_its_own_entity(run: SyntheticRun) -> None:
    for name, (nodes, edges) in looks.graph_looks(run.live).items():
        ids = set(nodes.node_ids.as_arrow_array().to_pylist())
        pairs = edges.edges.as_arrow_array().to_pylist()
        assert ids, name
        assert pairs, name
        assert all(pair["first"] in ids and pair["second"] in ids for pair in pairs), name


def test_a_blocked_way_is_pruned_from_the_graph_views(run: SyntheticRun) -> None:
    graph = graph_from_json(graph_to_json(run.live))
    ways = [edge for edge in graph.edges.values() if edge.kind == PATH]
    blocked = next(edge for edge in ways if not edge.attributes.get("blocked"))
    ends = {"source": blocked.source, "target": blocked.target}
    cause = Cause("navigation/test", "blocked")
    graph.apply(ch.EdgeChanged(cause=cause, edge=PATH, **ends, attributes={"blocked": True}))
    for name in ("map", "all", PATH):
        drawn = {
            tuple(pair.values())
            for pair in looks.graph_looks(graph)[name][1].edges.as_arrow_array().to_pylist()
        }
        assert (blocked.source, blocked.target) not in drawn
        assert drawn
    assert len(looks.edges_looks(graph)["blocked"].strips.as_arrow_array()) > 0


def test_boxes_are_those_of_the_graph(run: SyntheticRun) -> None:
    look = looks.objects_look(run.live)
    centers = np.array(look.centers.as_arrow_array().to_pylist())
    nodes = list(run.live.objects.values())
    assert np.allclose(centers, [node.center for node in nodes], atol=1e-5)
    classes = look.class_ids.as_arrow_array().to_pylist()
    for node, number in zip(nodes, classes, strict=True):
        assert (number == palette.TENTATIVE_CLASS) == (node.status == "tentative")


def test_where_labels_are_too_many_those_of_changes_and_of_waypoints_stay(
    run: SyntheticRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    believed = [node for node in run.live.objects.values() if node.status == BELIEVED]
    changed = [node.label for node in believed if node.state != STATIC]
    few = max(len(run.live.waypoints), len(changed))
    assert few < len(believed)
    monkeypatch.setattr(looks, "LABELS_UP_TO", few)
    look = looks.labels_look(run.live)
    assert look.labels is not None
    assert look.labels.as_arrow_array().to_pylist() == changed
    drawn = looks.graph_looks(run.live)
    assert drawn["map"][0].show_labels.as_arrow_array().to_pylist() == [False]
    assert drawn[PATH][0].show_labels.as_arrow_array().to_pylist() == [True]


@given(
    st.lists(
        st.tuples(st.integers(-200, 200), st.integers(-200, 200), st.integers(1, 14)), min_size=1, max_size=25
    )
)
@settings(max_examples=60, deadline=None)
def test_labels_are_spread_deterministically(labels: list[tuple[int, int, int]]) -> None:
    spots = np.array([label[:2] for label in labels], dtype=np.float32)
    lengths = [label[2] for label in labels]
    spread = looks.spread_labels(spots, lengths)
    assert spread.shape == spots.shape
    assert np.isfinite(spread).all()
    assert np.array_equal(spread, looks.spread_labels(spots, lengths))


def test_labels_in_one_spot_come_apart_and_lone_ones_stay() -> None:
    spots = np.array([[0, 0], [0, 0], [5, 3], [900, 0]], dtype=np.float32)
    spread = looks.spread_labels(spots, [5, 5, 5, 5])
    assert np.array_equal(spread[3], spots[3])
    for first in range(3):
        for second in range(first):
            gap = np.abs(spread[first] - spread[second])
            assert gap[0] > 55 or gap[1] > 25


def test_the_scene_is_sent_only_where_it_changed(run: SyntheticRun, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = rr.RecordingStream("dssmsg_test")
    sent: list[str] = []
    scene = SceneLog(stream)
    monkeypatch.setattr(scene, "_send", lambda path, *parts, **options: sent.append(path))
    assert scene.update(run.live, 0, 0.0) is False
    assert schema.OBJECTS in sent
    assert f"{schema.GRAPH}/all" in sent
    first = len(sent)
    assert scene.update(run.live, 1, 0.2) is True  # the slow part waits for its second
    assert scene.update(run.live, 9, 1.8) is False
    assert len(sent) == first


def test_lines_say_what_and_by_which_numbers(run: SyntheticRun) -> None:
    lines = [describe.change_line(change) for change in run.told]
    merged = next(line for line in lines if "merged" in line)
    assert "s 1.75 (>= 1.1)" in merged
    assert "[association/dssm: merge]" in merged
    assert any("status: tentative -> believed" in line for line in lines)
    assert any("-near-" in line and "next to" in line for line in lines)
    assert all(change.subjects[0] in line for change, line in zip(run.told, lines, strict=True))


def test_lines_are_short_and_say_nothing_twice() -> None:
    change = ch.EdgeAdded(
        cause=Cause("graph/edges", "near"),
        scores=(Score("distance_m", 0.40512, 0.5),),
        edge="near",
        source="object-3",
        target="object-4",
        attributes={"distance": 0.40512, "offset": [-0.05732065, 0.2, 0.1], "relation": "next to"},
    )
    line = describe.change_line(change)
    assert line == "object-3 -near- object-4 new (next to)  [graph/edges: near]  distance_m 0.405 (< 0.5)"


def test_what_the_current_viewpoint_sees_stands_out(run: SyntheticRun) -> None:
    viewpoint = next(iter(run.live.viewpoints))
    seen = [edge for edge in run.live.edges.values() if edge.kind == SEES and edge.source == viewpoint]
    assert len(looks.seen_now(run.live, viewpoint)) == len(seen) > 0
    assert looks.seen_now(run.live, None) == ()
    assert looks.seen_now(run.live, "viewpoint-99.9") == ()


def test_the_mission_page_says_goal_state_and_outcome() -> None:
    card = MissionCard()
    assert "not begun" in card.text()
    card.phase_started(ev.PhaseStarted("seek", 1, 30, 6.0))
    best = ev.Candidate("viewpoint-4.2", 1, {}, {}, "bed 1.00")
    card.matched(ev.Matched("a place to sleep", 30, 6.0, {}, (best,)))
    card.navigation_changed(ev.NavigationChanged(31, 6.2, "drive", "to waypoint-3", ("waypoint-3",)))
    page = card.text()
    for words in ("seek, visit 1", "“a place to sleep”", "viewpoint-4.2 (bed 1.00)", "drive: to waypoint-3"):
        assert words in page
    for number in range(20):
        card.episode_ended(ev.EpisodeEnded(number, f"goal {number}", "failure", "blocked", 40, 8.0))
    page = card.text()
    assert "0 of 20 succeeded" in page
    assert "“goal 19”: **failure** (blocked)" in page
    assert "a place to sleep" not in page
    assert len(page) < 1000


class Seeking(SyntheticRun):
    """A run whose last phase begins with the frame after its last one, and asks for something before that."""

    def events(self):  # type: ignore[no-untyped-def]
        for event in super().events():
            if isinstance(event, ev.RunFinished):
                yield ev.PhaseStarted("seek", 1, event.frame + 1, event.sim_time)
                yield ev.Matched("a place to sleep", event.frame, event.sim_time, {"nodes": []}, ())
            yield event


def test_the_mission_page_keeps_the_goal_of_a_phase_that_is_about_to_begin(tmp_path: Path) -> None:
    file = tmp_path / "seeking.rrd"
    record(Seeking(6, objects=3), file)
    batches = RrdReader(file).stream().filter(content=schema.MISSION).to_chunks()
    told = []
    for chunk in batches:
        table = chunk.to_record_batch().to_pydict()
        pages = next(values for name, values in table.items() if name.endswith("TextDocument:text"))
        told += zip(table["frame"], pages, strict=True)
    frame, page = sorted(told, key=lambda one: one[0])[-1]  # of one frame the later row counts
    assert frame == 6
    assert "a place to sleep" in page[0]


def test_the_same_failures_are_told_together() -> None:
    def error(frame: int, message: str) -> dict[str, Any]:
        return {"frame": frame, "plugin": "perception/x", "message": message, "skipped": "detect"}

    errors = [*(error(frame, "NaN") for frame in (0, 1, 2, 3, 5, 6, 9)), error(4, "slow")]
    assert _error_lines(errors) == [
        "frames 0-3, 5-6, 9 (7 times): perception/x: NaN; skipped: detect",
        "frame 4: perception/x: slow; skipped: detect",
    ]
    many = _error_lines([error(frame, "NaN") for frame in range(0, 100, 2)])
    assert len(many) == 1
    assert "and 42 more spans (50 times)" in many[0]


def test_layouts_look_at_the_map_or_at_a_node(run: SyntheticRun, tmp_path: Path) -> None:
    for name in blueprint.LAYOUTS:
        made = blueprint.make_layout(name, blueprint.eye_on(run.live, "object-2"), focused=True)
        made.save(schema.APPLICATION_ID, str(tmp_path / f"{name}.rbl"))
        assert (tmp_path / f"{name}.rbl").stat().st_size > 1000
    eye = blueprint.eye_on(run.live, "object-2")
    assert eye is not None
    assert np.allclose(eye.target, run.live.objects["object-2"].center)
    whole = blueprint.eye_on(run.live)
    assert whole is not None
    assert whole.position[2] > eye.position[2]
    with pytest.raises(ConfigError, match="no node 'object-999'"):
        blueprint.eye_on(run.live, "object-999")
    with pytest.raises(ConfigError, match="review, scene, graph"):
        blueprint.make_layout("x")


def call(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    code = main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_inspect_prints_one_object(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = call(capsys, "inspect", path, "--json")
    summary = json.loads(out)
    assert code == 0
    assert summary["frames"] == 40
    assert summary["schema_version"] == 2
    assert {"recording", "seed", "objects", "waypoints", "changes", "episodes", "errors", "seconds"} <= set(
        summary
    )
    code, out, _ = call(capsys, "inspect", path)
    assert code == 0
    assert "40 (14 key frames)" in out


def test_export_writes_the_graph_of_a_time_and_overwrites_nothing(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "graph.json"
    assert call(capsys, "export", path, "--at", "frame=12", "-o", target)[0] == 0
    with Recording.open(path) as recording:
        assert same(graph_from_json(json.loads(target.read_text())), recording.graph_at(12))
    before = target.read_bytes()
    code, _, err = call(capsys, "export", path, "-o", target)
    assert code == 2
    assert "--force" in err
    assert target.read_bytes() == before
    assert call(capsys, "export", path, "-o", target, "--force")[0] == 0
    assert target.read_bytes() != before
    assert [entry.name for entry in tmp_path.iterdir()] == ["graph.json"]


@pytest.mark.parametrize(
    ("at", "words"),
    [
        ("frame=400", "its frames are 0 to 39"),
        ("time=-3", "no frame at or before"),
        ("update=100000", "its updates are 1 to"),
        ("soon", "frame=N"),
        ("x=3", "frame=N"),
    ],
)
def test_a_wrong_time_is_said(path: Path, capsys: pytest.CaptureFixture[str], at: str, words: str) -> None:
    code, out, err = call(capsys, "export", path, "--at", at)
    assert code == 2
    assert words in err
    assert out == ""


def test_the_newest_is_taken_and_said(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = call(capsys, "inspect")
    assert code == 2
    assert "dssmsg run" in err
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "mine.rrd").write_bytes(path.read_bytes())
    code, _, err = call(capsys, "inspect")
    assert code == 0
    assert "mine.rrd" in err


def test_view_opens_the_recording_with_a_layout(
    path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from dssmsg.recording import viewer

    opened: list[Any] = []

    class Window:
        @classmethod
        def start(cls, files: list[Path]) -> Window:
            opened.extend(file.name for file in files)
            assert all(file.exists() for file in files)
            return cls()

        def show(self, layout: Any, frame: int | None) -> None:
            opened.append(frame)

        def wait(self) -> int:
            return 0

        def stop(self) -> None:
            opened.append("stopped")

    monkeypatch.setattr(viewer, "Viewer", Window)
    code, _, _ = call(capsys, "view", path, "--at", "update=3", "--focus", "object-1")
    assert code == 0
    assert opened == ["run.rrd", "focus.rrd", 0, "stopped"]
    code, _, err = call(capsys, "view", path, "--focus", "object-999")
    assert code == 2
    assert "object-999" in err


def test_a_viewer_that_cannot_start_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    from dssmsg.recording import viewer

    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    if sys.platform == "linux":
        with pytest.raises(viewer.ViewerError, match=r"no screen here.*--web"):
            viewer.Viewer.start([])
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr(viewer, "rerun_program", lambda: Path("/bin/false"))
    with pytest.raises(viewer.ViewerError, match="--web"):
        viewer.Viewer.start([])
    monkeypatch.setattr(viewer, "rerun_program", lambda: Path("/nowhere/rerun"))
    with pytest.raises(viewer.ViewerError, match="cannot be started"):
        viewer.Viewer.start([])


@pytest.mark.skipif(sys.platform != "linux", reason="reads the kernel's table of sockets")
def test_the_web_page_is_served_on_this_machine_alone(path: Path) -> None:
    import urllib.parse
    import urllib.request

    from dssmsg.recording.viewer import Viewer

    viewer, address = Viewer.serve([path])
    try:
        assert address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(address, timeout=10) as page:
            assert b"<html" in page.read(4000).lower()
        ports = {urllib.parse.urlsplit(address).port, viewer.port}
        table = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        listening = [row[1].split(":") for row in table if row[3] == "0A"]
        hosts = [host for host, port in listening if int(port, 16) in ports]
        assert len(hosts) == 2
        assert set(hosts) == {"0100007F"}  # 127.0.0.1
    finally:
        viewer.stop()
    assert viewer.process.poll() is not None
