"""`dssmsg view`: when it opens, with which layout, what a page is served from; completion of the shell."""

from __future__ import annotations

import json
import sys
import urllib.parse
from collections.abc import Iterator
from importlib import util
from pathlib import Path
from typing import Any

import pytest
from project import project
from recorded_run import SyntheticRun, record

from dssmsg import events as ev
from dssmsg.cli import main
from dssmsg.graph.verdicts import Evidence
from dssmsg.recording import viewer as viewer_module
from dssmsg.recording.viewer import Viewer, ViewerError

NEEDS_CATALOG = pytest.mark.skipif(
    util.find_spec("datafusion") is None, reason="the extra `catalog` is missing"
)


class Judged(SyntheticRun):
    """A run in which a window sees object-1 twice, and judges it in between."""

    def events(self) -> Iterator[ev.Event]:
        seen = {"free": 0.0}
        for event in super().events():
            if isinstance(event, ev.RunFinished):
                for frame, verdicts in ((6, {}), (7, {"object-1": "disappeared"}), (9, {})):
                    evidence = (Evidence(frame, "object-1", "missed", seen),)
                    yield ev.WindowEvaluated(
                        "viewpoint-1.1", frame, 0.2 * frame, (6,), (frame,), evidence, verdicts, 3
                    )
            yield event


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(Judged(12, run_id="judged"), tmp_path_factory.mktemp("view") / "run.rrd", layout="dynamics")


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What a viewer that opens no window was asked for."""
    asked: list[Any] = []

    class Window:
        @classmethod
        def start(cls, files: list[Path]) -> Window:
            assert all(file.exists() for file in files)
            asked.append([file.name for file in files])
            return cls()

        @classmethod
        def serve(cls, files: list[Path]) -> tuple[Window, str]:
            asked.append(["page", *(file.name for file in files)])
            return cls(), "http://127.0.0.1:1/"

        @classmethod
        def serve_at(
            cls, recording: Path, frame: int, layout: Path, additions: list[Path]
        ) -> tuple[Window, str]:
            asked.append(["page at", frame, *(file.name for file in (recording, layout, *additions))])
            return cls(), "http://127.0.0.1:1/"

        def show(self, layout: Any = None, frame: int | None = None) -> None:
            asked.append(("shown", layout is not None, frame))

        def wait(self) -> None: ...

        def stop(self) -> None:
            asked.append("stopped")

    monkeypatch.setattr(viewer_module, "Viewer", Window)
    return asked


@pytest.fixture
def layouts(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    from dssmsg.recording import blueprint

    chosen: list[str] = []
    real = blueprint.make_layout

    def make(name: str, *arguments: Any, **options: Any) -> Any:
        chosen.append(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(blueprint, "make_layout", make)
    return chosen


def test_the_layout_of_the_file_unless_another_is_asked_for(
    path: Path, opened: list[Any], layouts: list[str]
) -> None:
    assert main(["view", str(path)]) == 0
    assert main(["view", str(path), "--layout", "navigation"]) == 0
    assert layouts == ["dynamics", "navigation"]
    assert opened == [["run.rrd"], ("shown", True, 11), "stopped"] * 2


def test_json_says_what_is_open(path: Path, opened: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(path), "--focus", "object-1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {
        "recording": str(path),
        "layout": "dynamics",
        "frame": 7,
        "focus": "object-1",
        "page": None,
    }
    assert main(["view", str(path), "--web", "--json"]) == 0
    written = capsys.readouterr()
    assert json.loads(written.out)["page"] == "http://127.0.0.1:1/"
    assert "open http://127.0.0.1:1/" in written.err


def test_focus_opens_where_the_object_was_judged_last(path: Path, opened: list[Any]) -> None:
    assert main(["view", str(path), "--focus", "object-1"]) == 0
    assert opened == [["run.rrd", "focus.rrd"], ("shown", True, 7), "stopped"]
    opened.clear()
    assert main(["view", str(path), "--focus", "object-1", "--at", "frame=3"]) == 0
    assert opened[1] == ("shown", True, 3)
    opened.clear()
    assert main(["view", str(path), "--focus", "waypoint-1"]) == 0
    assert opened == [["run.rrd", "focus.rrd"], ("shown", True, 11), "stopped"]


def test_a_node_that_is_not_there_is_refused_with_the_time_that_was_looked_at(
    path: Path, opened: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    for time, when in (([], "at the end of the run"), (["--at", "frame=3"], "at that time")):
        assert main(["view", str(path), "--focus", "object-9999", *time]) == 2
        assert f"--focus: the graph has no node 'object-9999' {when}\n" in capsys.readouterr().err
    assert not opened


def test_a_page_opens_at_a_time(
    path: Path, opened: list[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", str(path), "--web"]) == 0
    assert main(["view", str(path), "--web", "--at", "frame=5", "--focus", "object-1"]) == 0
    assert opened == [
        ["page at", 11, "run.rrd", "layout.rbl"],
        "stopped",
        ["page at", 5, "run.rrd", "layout.rbl", "focus.rrd"],
        "stopped",
    ]
    opened.clear()

    def missing(*_: Any) -> Any:
        raise ViewerError("needs something")

    monkeypatch.setattr(viewer_module.Viewer, "serve_at", missing)
    assert main(["view", str(path), "--web", "--at", "frame=5"]) == 0
    assert opened == [["page", "run.rrd"], "stopped"]
    assert "opens at the end, in the recording's own layout: needs something" in capsys.readouterr().err


def test_a_comparison_is_shown_as_it_is(
    path: Path, opened: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "both.rrd"
    assert main(["diff", str(path), str(path), "--recording", str(file)]) == 0
    assert main(["view", str(file), "--layout", "comparison", "--at", "frame=3"]) == 0
    assert opened == [["both.rrd"], ("shown", False, 3), "stopped"]
    capsys.readouterr()
    for wrong in (["--layout", "review"], ["--focus", "object-1"], ["--at", "time=3"]):
        assert main(["view", str(file), *wrong]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert main(["view", str(path), "--layout", "comparison"]) == 2
    assert "dssmsg diff A B" in capsys.readouterr().err


def test_the_extra_is_named_where_it_is_missing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "datafusion", None)
    with pytest.raises(ViewerError, match=r"pip install 'dssmsg\[catalog\]'"):
        Viewer.serve_at(path, 3, path)


@NEEDS_CATALOG
@pytest.mark.skipif(sys.platform != "linux", reason="reads the kernel's table of sockets")
def test_a_page_at_a_time_is_served_on_this_machine_alone(path: Path, tmp_path: Path) -> None:
    from dssmsg.recording import schema
    from dssmsg.recording.blueprint import eye_on, make_layout
    from dssmsg.recording.focus import save_focus
    from dssmsg.recording.reader import Recording

    with Recording.open(path) as recording:
        graph = recording.graph_at()
        layout = make_layout("dynamics", eye_on(graph, "object-1"), focused=True)
        layout.save(schema.APPLICATION_ID, str(tmp_path / "layout.rbl"))
        save_focus(tmp_path / "focus.rrd", "judged", graph, "object-1", "## object-1")
    viewer, address = Viewer.serve_at(path, 5, tmp_path / "layout.rbl", [tmp_path / "focus.rrd"])
    try:
        page = urllib.parse.urlsplit(address)
        (inner,) = urllib.parse.parse_qs(page.query)["url"]
        assert page.hostname == "127.0.0.1"
        assert inner.startswith("rerun+http://127.0.0.1:")
        assert inner.endswith("segment_id=judged#when=frame@5")
        served = urllib.parse.urlsplit(inner.removeprefix("rerun+"))
        ports = {page.port, viewer.port, served.port}
        table = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        hosts = [row[1].split(":") for row in table if row[3] == "0A"]
        assert {host for host, port in hosts if int(port, 16) in ports} == {"0100007F"}
        everywhere = [line.split()[1] for line in Path("/proc/net/tcp6").read_text().splitlines()[1:]]
        assert not [place for place in everywhere if int(place.rpartition(":")[2], 16) in ports]
    finally:
        viewer.stop()


def test_completion_is_installed_and_answers(tmp_path: Path) -> None:
    folder = project(tmp_path, {"home/.bashrc": "# mine\n"})
    # Typer finds out by itself which shell it was called from; a test is called from none.
    home = {"HOME": str(tmp_path / "home"), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    done = folder.run_process("--install-completion", "bash", env=home)
    assert done.code == 0, done.err
    start_up = (tmp_path / "home/.bashrc").read_text()
    assert start_up.startswith("# mine\n")
    script = next(part for part in start_up.replace("'", " ").split() if part.endswith("dssmsg.sh"))
    assert "_DSSMSG_COMPLETE=complete_bash" in Path(script).read_text()

    def complete(words: str, place: int) -> list[str]:
        asked = {"_DSSMSG_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(place)}
        return folder.run_process(env=asked).out.split()

    assert {"episodes", "explain", "export", "eval"} == set(complete("dssmsg e", 1))
    assert "navigation" in complete("dssmsg view --layout n", 3)
