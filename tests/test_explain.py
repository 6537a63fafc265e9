"""`dssmsg explain --object`: the life of an object, from a recording alone."""

import json
import re

import pytest
from changing_room import ChangingRoom
from planted_run import PlantedRun
from project import project
from recorded_run import record
from rerun.chunk import RrdReader
from test_update_dssm import BALL, ROOM, box
from typer.testing import CliRunner

from dssmsg.cli import app
from dssmsg.errors import InputError
from dssmsg.recording.reader import Recording
from dssmsg.review.life import life_of, life_text


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    """A ball that moved, recorded; with its id, the retired one and the revisit's first frame."""
    room = ChangingRoom()
    room.visit([*ROOM, BALL])
    ball, revisit = room.one("ball").id, room.index
    room.visit([*ROOM, box("ball", 0.9, -1.6)])
    retired = next(c.absorbed_id for c in room.changes if c.kind == "objects_joined" and c.object_id == ball)
    return room.record(tmp_path_factory.mktemp("life") / "moved.rrd"), ball, retired, revisit


def test_a_life_is_told_in_order_with_scores_and_thresholds(moved):
    path, ball, _, revisit = moved
    with Recording.open(path) as recording:
        life = life_of(recording, ball)
    frames = [event.frames[0] for event in life.events]
    assert frames == sorted(frames)
    told = [event.what for event in life.events]
    for part in ("first seen as ball", "believed", "seen again as ball", "disappeared", "history-1", "moved"):
        assert any(part in what for what in told), part
    (gone,) = [e for e in life.events if e.what.startswith("state disappeared")]
    assert gone.frames[0] >= revisit
    assert gone.scores["consistent_frames"] == (3.0, 3.0)
    (place,) = life.end["former_places"]
    assert place["to_time"] > place["from_time"]
    assert life.end["state"] == "moved"


def test_a_retired_id_goes_on_as_its_successor(moved):
    path, ball, retired, _ = moved
    with Recording.open(path) as recording:
        life = life_of(recording, retired)
    assert life.ids == (retired, ball)
    # What the successor was seen to do before is of its own life, not of this one.
    assert life.events[0].what.startswith("first seen")
    assert life.end["id"] == ball
    assert f"known as {retired}, then {ball}" in life_text(life)


def test_a_former_place_tells_the_life_of_its_object(moved):
    path, ball, _, _ = moved
    with Recording.open(path) as recording:
        told = life_text(life_of(recording, "history-1"))
        assert told == life_text(life_of(recording, ball))
    place = r"was at \(.*\) m from frame \d+ \(.* s\) on, found elsewhere in frame \d+ \(.* s\) \(history-1\)"
    assert re.search(place, told)


def test_what_is_left_empty_is_named(tmp_path):
    for option, expected in (("--query", "a sentence"), ("--object", "an id")):
        for empty in ("", "  "):
            done = project(tmp_path).run("explain", option, empty)
            assert done.code == 2
            assert done.err == f"error: {option}: expected {expected}\n"


@pytest.mark.parametrize("asked", [("--episode", "0"), ("--query", "the mug")])
def test_a_target_graph_that_is_none_is_said_with_the_file(tmp_path, asked):
    record(PlantedRun(), tmp_path / "run.rrd")  # its target graph has a core and no nodes
    done = project(tmp_path).run("explain", "run.rrd", *asked)
    assert (done.code, done.out) == (2, "")
    assert done.err.splitlines()[-1].startswith("error: run.rrd: the target graph of a match: damaged")


def test_evidence_in_a_row_is_told_together(moved):
    path, ball, _, _ = moved
    with Recording.open(path) as recording:
        told = [
            event for event in life_of(recording, ball).events if event.what.startswith("evidence: missed")
        ]
    assert told
    assert told[0].frames[-1] > told[0].frames[0]


def test_the_command_prints_lines_or_json(moved):
    path, ball, _, _ = moved
    runner = CliRunner()
    plain = runner.invoke(app, ["explain", str(path), "--object", ball])
    assert plain.exit_code == 0
    assert plain.stdout.startswith(f"{ball}: ball, believed, moved")
    told = json.loads(runner.invoke(app, ["explain", str(path), "--object", ball, "--json"]).stdout)
    assert told["object"] == ball
    assert told["recording"] == str(path)
    assert {"frames", "sim_time", "what", "scores"} <= set(told["events"][0])


def test_the_viewer_gets_each_window_as_a_table_and_pictures_with_its_verdict(moved):
    path, ball, _, _revisit = moved
    texts, pictures = [], {"/window/before": 0, "/window/now": 0}
    for chunk in RrdReader(path).stream():
        if not chunk.entity_path.startswith("/window"):
            continue
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            cells = [cell for cell in batch.column(name).to_pylist() if cell]
            if name == "TextDocument:text":
                texts += [cell[0] for cell in cells]
            elif name == "EncodedImage:blob":
                pictures[chunk.entity_path] += len(cells)
    (gone,) = [text for text in texts if f"ball ({ball}): disappeared" in text]
    assert "**missed**" in gone
    assert "comparison |" in gone
    assert "base |" in gone
    assert pictures["/window/before"] == pictures["/window/now"] >= 2


def test_an_unknown_object_is_named_with_those_there_are(moved):
    path, *_ = moved
    with (
        Recording.open(path) as recording,
        pytest.raises(InputError, match=r"no object 'object-999'.*object-1"),
    ):
        life_of(recording, "object-999")
