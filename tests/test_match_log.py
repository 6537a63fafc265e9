"""What a recording shows of a grounded query: table, bars and matrix, a path a query."""

from __future__ import annotations

import pytest
from recorded_run import SyntheticRun
from rerun.chunk import RrdReader

from dssmsg import events
from dssmsg.recording.reader import Recording
from dssmsg.recording.repair import optimize
from dssmsg.recording.writer import RecordingWriter


def matched(query, *scores):
    candidates = tuple(
        events.Candidate(f"viewpoint-1.{rank}", rank, values, {"0": f"object-{rank}"}, "because")
        for rank, values in enumerate(scores, 1)
    )
    return events.Matched(query, 3, 0.6, {"kind": "explicit"}, candidates)


QUERIES = [
    matched(
        "the mug / on the desk?", {"score": 3.5, "s_node": 1.0}, {"score": 2.0, "s_node": 0.5, "s_top": 0.1}
    ),
    matched("nothing like it"),
    matched("the mug / on the desk?", {"cosine": 0.25}),
    matched("no scores", {}),
]


@pytest.fixture
def path(tmp_path):
    run = SyntheticRun(frames=5, objects=3)
    writer = RecordingWriter(tmp_path / "a.rrd", run.run_id)
    writer.write(run.started())
    for event in QUERIES:
        writer.write(event)
    writer.close()
    optimize(tmp_path / "a.rrd")
    return tmp_path / "a.rrd"


def cells(path, entity, component):
    """Values of a component of an entity, in order."""
    found = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == entity:
            batch = chunk.to_record_batch()
            names = [name for name in batch.schema.names if name.endswith(component)]
            found += [cell for name in names for cell in batch.column(name).to_pylist() if cell]
    return found


def test_every_query_has_its_bars_and_its_matrix(path):
    paths = {chunk.entity_path for chunk in RrdReader(path).stream()}
    assert {"/scores/001_the_mug___on_the_desk", "/matrix/001_the_mug___on_the_desk"} <= paths
    assert {"/scores/003_the_mug___on_the_desk", "/matrix/003_the_mug___on_the_desk"} <= paths
    assert not any("002" in one or "004" in one for one in paths)  # nothing to draw


def test_bars_are_the_scores_that_ranked(path):
    (bars,) = cells(path, "/scores/001_the_mug___on_the_desk", "BarChart:values")
    assert list(bars[0]["buffer"]) == [3.5, 2.0]


def test_the_matrix_has_a_row_a_candidate_and_a_column_a_score(path):
    (matrix,) = cells(path, "/matrix/001_the_mug___on_the_desk", "Tensor:data")
    assert matrix[0]["shape"] == [2, 3]
    assert matrix[0]["names"] == ["candidate", "score s_node s_top"]


def test_the_table_has_a_row_a_candidate_with_what_it_is_ranked_by(path):
    with Recording.open(path) as recording:
        first, none, third, _ = recording.matches()
    assert [one["rank"] for one in first["candidates"]] == [1, 2]
    assert first["candidates"][0]["matching"] == {"0": "object-1"}
    assert none["candidates"] == []
    assert third["candidates"][0]["scores"] == {"cosine": 0.25}
    assert [one[0] for one in cells(path, "/match/candidates", "Candidate:score")] == [3.5, 2.0, 0.25]
