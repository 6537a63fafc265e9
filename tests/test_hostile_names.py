"""Names in a recording that would steer the terminal: every reading command spells them out."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from project import FAKE_RUN, Project, project
from recorded_run import SyntheticRun, record
from spoilt_recordings import rewritten

from dssmsg import events as ev
from dssmsg.cli.output import plain

CLEARS, RETITLES, ONE_BYTE, TURNS, HALF = "\x1b[2J", "\x1b]0;mine\x07", "\x9b31m", "\u202e", "\ud800"
EVIL = f"evil{CLEARS}{RETITLES}{ONE_BYTE}{TURNS}\r{HALF}"
COMMANDS = {
    "inspect": ("inspect", "REC"),
    "explain": ("explain", "REC", "--object", "object-1"),
    "explain --episode": ("explain", "REC", "--episode", "0"),
    "explain --query": ("explain", "REC", "--query", "the chair"),
    "diff": ("diff", "REC", "GOOD"),
    "episodes": ("episodes", "FOLDER"),
}


class Seeking(SyntheticRun):
    """A run that ends with a goal that was grounded and not reached."""

    def events(self) -> Iterator[ev.Event]:
        """Those of the run, and the goal's before the last."""
        *rest, end = super().events()
        yield from rest
        target = {"core": 0, "kind": "explicit", "edges": [], "nodes": [{"label": "chair", "attributes": []}]}
        found = ev.Candidate("viewpoint-1.1", 1, {"score": 1.0}, {"0": "object-1"}, "a chair")
        last = self.frames - 1
        yield ev.Matched("the chair", last, last * 0.2, target, (found,))
        yield ev.EpisodeEnded(0, "the chair", "failure", "blocked", last, last * 0.2)
        yield end


def evil(value: object, key: str = "") -> object:
    """A JSON value in which what people name bears another name."""
    if isinstance(value, dict):
        return {name: evil(one, name) for name, one in value.items()}
    if isinstance(value, list):
        return [evil(one, key) for one in value]
    named = key in ("label", "goal", "reason", "name", "scene", "message", "detail", "rule")
    return value + EVIL if named and isinstance(value, str) else value


def texts(value: object) -> Iterator[str]:
    """All texts in a JSON value, keys too."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from (text for pair in value.items() for part in pair for text in texts(part))
    elif isinstance(value, list):
        yield from (text for one in value for text in texts(one))


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Project]:
    """A project with a good recording and, in a folder, one whose names are hostile."""
    folder = tmp_path_factory.mktemp("names")
    made = project(folder, {"dssmsg.yaml": FAKE_RUN})
    good = record(Seeking(9), folder / "good.rrd")
    (folder / "evil").mkdir()
    path = folder / "evil" / "evil.rrd"
    place = good
    for number, (entity, component) in enumerate(
        (
            ("/graph_log", "GraphChange:json"),
            ("/__properties/run", "json"),
            ("/__properties/summary", "json"),
            ("/episodes", "Episode:json"),
            ("/match", "Match:json"),
            ("/nav/events", "Navigation:json"),
            ("/errors", "Error:json"),
        )
    ):
        after = folder / f"step-{number}.rrd"
        rewritten(place, after, entity, component, lambda text: json.dumps(evil(json.loads(str(text)))))
        place = after
    place.rename(path)
    return made


def words(home: Project, name: str) -> tuple[str, ...]:
    places = {"REC": "evil/evil.rrd", "GOOD": "good.rrd", "FOLDER": "evil"}
    return tuple(str(home.path / places[word]) if word in places else word for word in COMMANDS[name])


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_no_name_steers_the_terminal(home: Project, name: str) -> None:
    done = home.run(*words(home, name))
    assert done.code == 0, done.err
    assert "[2J" in done.out, "the name is told, without what would clear the screen"
    for sign in ("\x1b", "\x07", "\x9b", TURNS, "\r"):
        assert sign not in done.out + done.err


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_json_holds_the_name_itself(home: Project, name: str) -> None:
    done = home.run(*words(home, name), "--json")
    assert done.code == 0, done.err
    assert any(EVIL in text for text in texts(done.json))
    for sign in ("\x1b", "\x07", "\x9b", TURNS):
        assert sign not in done.out


def test_an_error_that_quotes_a_name_is_plain_too(home: Project) -> None:
    done = home.run("explain", str(home.path / "good.rrd"), "--object", f"object-{CLEARS}")
    assert done.code == 2
    assert "object-\\x1b[2J" in done.err
    assert "\x1b" not in done.err


def test_lines_tabs_and_letters_of_all_tongues_stay() -> None:
    text = "une chaise étroite\n\t椅子 🛋"
    assert plain(text) == text
