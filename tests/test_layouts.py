"""Layouts a task: what they show is there, what the file holds is what was asked for, focus on a node."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
import rerun as rr
from recorded_run import SyntheticRun, record
from rerun.chunk import RrdReader

from dssmsg import events as ev
from dssmsg.cli.view import Layout
from dssmsg.errors import ConfigError
from dssmsg.graph.nodes import PATH
from dssmsg.graph.verdicts import Evidence
from dssmsg.recording import blueprint, focus, looks, match_log, schema, views, window_log
from dssmsg.recording.reader import Recording
from dssmsg.recording.sheets import SheetBook

TARGET = {
    "kind": "implicit",
    "core": 0,
    "nodes": [{"label": "sink", "attributes": ["white"]}, {"label": "oven", "attributes": []}],
    "edges": [{"source": 0, "target": 1, "relation": "near"}],
}
CANDIDATES = (
    ev.Candidate(
        "viewpoint-1.1", 1, {"score": 4.25, "s_node": 1.0}, {"0": "object-1", "1": "object-2"}, "sink 1.00"
    ),
    ev.Candidate("viewpoint-2.1", 2, {"score": 3.5}, {"0": "object-1"}, "sink 0.80"),
)


class Asked(SyntheticRun):
    """A run with a question, an answer of the language model, and a way."""

    def events(self) -> Iterator[ev.Event]:
        for event in super().events():
            if isinstance(event, ev.RunFinished):
                yield ev.LlmCalled(
                    "target_graph", "lexicon", 20, 4.0, "the prompt", "the answer", "hash", True
                )
                yield ev.Matched("a place to wash up", 20, 4.0, TARGET, CANDIDATES)
                yield ev.NavigationChanged(21, 4.2, "drive", "to waypoint-1", ("waypoint-1", "waypoint-2"))
            yield event


@pytest.fixture(scope="module")
def run() -> Asked:
    return Asked(24, run_id="asked")


@pytest.fixture(scope="module")
def path(run: Asked, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(run, tmp_path_factory.mktemp("layouts") / "run.rrd", layout="language")


def test_the_lists_of_layouts_agree() -> None:
    from dssmsg_plugins.observer.rerun import Config

    names = list(blueprint.LAYOUTS)
    assert [layout.value for layout in Layout] == [*names, "comparison"]  # of two runs: a file of its own
    assert list(get_args(Config.model_fields["layout"].annotation)) == names


def test_an_unknown_layout_is_refused() -> None:
    with pytest.raises(ConfigError, match="review, scene, graph, dynamics, language, navigation"):
        blueprint.make_layout("x")


def origins(container: Any) -> set[str]:
    """The origins of all views below a container."""
    found: set[str] = set()
    for part in container.contents:
        found |= (
            origins(part) if hasattr(part, "contents") and not hasattr(part, "origin") else {str(part.origin)}
        )
    return found


@pytest.mark.parametrize("name", blueprint.LAYOUTS)
def test_what_a_layout_shows_is_in_a_recording(name: str, path: Path) -> None:
    filled = {chunk.entity_path for chunk in RrdReader(path).stream()}
    elsewhere = {schema.WINDOW_TEXT, schema.WINDOW_BEFORE, schema.WINDOW_NOW, "/llm/dynamic_attribute"}
    elsewhere.add(f"{schema.LOG}/windows")
    for origin in origins(blueprint.LAYOUTS[name](None)) - elsewhere:
        assert any(entity == origin or entity.startswith(f"{origin}/") for entity in filled), origin


def test_a_recording_holds_the_layout_that_was_asked_for(path: Path) -> None:
    with Recording.open(path) as recording:
        assert recording.facts["layout"] == "language"
    assert len(RrdReader(path).blueprints()) == 1


def test_the_target_graph_has_a_node_a_thing_and_one_a_relation() -> None:
    nodes, edges = match_log.target_look(TARGET)
    assert nodes.node_ids.as_arrow_array().to_pylist() == ["0", "1", "relation 0"]
    assert nodes.labels.as_arrow_array().to_pylist() == ["sink, white", "oven", "near"]
    pairs = [(pair["first"], pair["second"]) for pair in edges.edges.as_arrow_array().to_pylist()]
    assert pairs == [("0", "relation 0"), ("relation 0", "1")]


def test_what_the_best_candidate_matched_is_boxed_and_named(run: Asked) -> None:
    event = ev.Matched("a place to wash up", 20, 4.0, TARGET, CANDIDATES)
    look = match_log.matched_look(event, run.live)
    labels = look.labels.as_arrow_array().to_pylist()
    assert [label.partition(":")[0] for label in labels] == ["sink", "oven"]
    gone = ev.Matched(
        "x", 0, 0.0, TARGET, (ev.Candidate("v", 1, {}, {"0": "object-999", "a": "object-1"}, ""),)
    )
    assert len(match_log.matched_look(gone, run.live).labels.as_arrow_array()) == 1
    nothing = ev.Matched("x", 0, 0.0, TARGET, ())
    assert len(match_log.matched_look(nothing, run.live).centers.as_arrow_array()) == 0


def test_the_page_of_candidates() -> None:
    page = match_log.match_page(ev.Matched("a sink", 0, 0.0, TARGET, CANDIDATES))
    assert "| 1 | viewpoint-1.1 | 4.25 | 1 | 1, 2 |" in page
    assert page.index("**Why the first:** sink 1.00") < page.index("| 1 |")  # seen without scrolling
    assert "Nothing in the map matches" in match_log.match_page(ev.Matched("x", 0, 0.0, TARGET, ()))
    many = ev.Matched("x", 0, 0.0, TARGET, CANDIDATES * 20)
    assert "and 28 more" in match_log.match_page(many)


def test_focus_adds_a_box_and_a_page_to_the_same_run(run: Asked, tmp_path: Path) -> None:
    file = tmp_path / "focus.rrd"
    focus.save_focus(file, "asked", run.live, "object-1", "## object-1\n")
    reader = RrdReader(file)
    (told,) = reader.recordings()
    assert (told.application_id, told.recording_id) == (schema.APPLICATION_ID, "asked")
    assert {schema.FOCUS, schema.FOCUS_TEXT} <= {chunk.entity_path for chunk in reader.stream()}
    look = focus.focus_look(run.live, "object-1")
    assert look is not None
    (half,) = look.half_sizes.as_arrow_array().to_pylist()
    node = run.live.objects["object-1"]
    assert all(a > b for a, b in zip(half, (node.box_max - node.box_min) / 2, strict=True))
    assert focus.focus_look(run.live, "waypoint-1") is not None
    assert focus.focus_look(run.live, "object-999") is None


def test_the_eye_stands_back_from_a_large_object(run: Asked) -> None:
    near = blueprint.eye_on(run.live, "waypoint-1")
    assert near is not None
    distance = sum((a - b) ** 2 for a, b in zip(near.position, near.target, strict=True)) ** 0.5
    assert 2.0 < distance < 3.0


def test_a_window_tells_the_judged_first_and_the_hidden_last(run: Asked) -> None:
    stream = rr.RecordingStream("dssmsg-test", recording_id="window")
    book = SheetBook(stream)
    log = window_log.WindowLog(book)
    verdicts = {"object-1": "out_of_view", "object-2": "seen", "object-3": "missed", "object-4": "missed"}
    evidence = tuple(Evidence(7, name, verdict) for name, verdict in verdicts.items())
    event = ev.WindowEvaluated("viewpoint-1.1", 7, 1.4, (7,), (), evidence, {"object-4": "disappeared"}, 3)
    memory = window_log._Memory()
    memory.columns.append((6, {"object-4": "seen"}))
    memory.columns.append((7, verdicts))
    lines = log._table(event, memory, run.live).splitlines()
    assert "| object | 7 base | 6 |" in lines  # newest first: a narrow view cuts the table at its right
    told = [name for line in lines if line.startswith("| ") for name in verdicts if name in line]
    assert told == ["object-4", "object-3", "object-2", "object-1"]


def test_the_plan_is_wider_than_the_path_edges_above_it(run: Asked) -> None:
    widest = looks.edges_looks(run.live)[PATH].radii
    assert widest is not None
    assert -min(widest.as_arrow_array().to_pylist()) < views._PLAN_WIDTH


def test_lines_without_a_colour_of_their_own_suit_a_bright_page_too(path: Path) -> None:
    chunks = RrdReader(path).stream().filter(content=f"{schema.LOG}/run")
    columns = {name for chunk in chunks for name in chunk.to_record_batch().schema.names}
    assert any("text" in name for name in columns)
    assert not any("color" in name for name in columns)
