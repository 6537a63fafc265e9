"""What a command writes: never what it reads, and refused before the work."""

from __future__ import annotations

from pathlib import Path

import pytest
from project import Project, project
from recorded_run import SyntheticRun, record


@pytest.fixture
def place(tmp_path: Path) -> Project:
    for name in ("a", "b"):
        record(SyntheticRun(6), tmp_path / f"{name}.rrd")
    return project(tmp_path)


COMMANDS = {
    "report": ("report", "a.rrd", "-o"),
    "report of a folder": ("report", ".", "-o"),
    "export": ("export", "a.rrd", "-o"),
    "diff": ("diff", "b.rrd", "a.rrd", "--recording"),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_writes_over_what_it_reads(place: Project, tmp_path: Path, command: str) -> None:
    (tmp_path / "link.rrd").symlink_to("a.rrd")
    before = (tmp_path / "a.rrd").read_bytes()
    for name in ("a.rrd", "./a.rrd", "link.rrd"):
        done = place.run(*COMMANDS[command], name, "--force")
        assert (done.code, done.out) == (2, "")
        assert "is what is read here" in done.err
        assert (tmp_path / "a.rrd").read_bytes() == before
    assert (tmp_path / "link.rrd").is_symlink()


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("output", "said"), [("nowhere/x", "no such folder"), ("there", "is a folder; expected a file")]
)
def test_where_nothing_can_be_written_is_said_first(
    place: Project, tmp_path: Path, command: str, output: str, said: str
) -> None:
    (tmp_path / "there").mkdir()
    done = place.run(*COMMANDS[command], output, "--force")
    assert (done.code, done.out) == (2, "")
    assert said in done.err
    assert not (tmp_path / "nowhere").exists()
