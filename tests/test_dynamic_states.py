"""Claims read off snapshots, accuracy that recovers, and the rows that come of it: by hand."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from dssmsg.errors import ConfigError
from dssmsg.evaluate.dynamic import Tally, Thing, UpdateScore
from dssmsg.evaluate.dynamic_states import GraphWatch, Seen, Snapshot, claims_of
from dssmsg.evaluate.dynamic_truth import RunTruth
from dssmsg.evaluate.fig5 import Recovery, mean_curve, recovery
from dssmsg.evaluate.replay_score import ReplayScore, Verdicts, score_replay
from dssmsg.evaluate.replays import METHODS, methods_named
from dssmsg.evaluate.tables import COLUMNS, TABLES, table_rows, write_rows
from dssmsg.evaluate.visible import Place
from dssmsg.events import GraphChanged, PhaseStarted
from dssmsg.graph.changes import Cause, ObjectAdded, ObjectChanged, ObjectRemoved
from dssmsg.graph.scene_graph import SceneGraph

CAUSE = Cause("test/test", "by hand")


def box(x):
    return np.array([x, 0.0, 0.0]), np.array([x + 1.0, 1.0, 1.0])


def seen(label, x, state="static", first=None):
    return Seen(label, state, box(x), None if first is None else box(first))


def place(label, x, visits=None):
    return Place(label, label, "", 5, *box(x), None, None, {0: 5, 1: 5} if visits is None else visits)


SURVEY = Snapshot(
    10, {"object-1": seen("sofa", 0), "object-2": seen("mug", 5), "object-3": seen("bed", 8)}, {}
)


def states(claims):
    return {claim.id: claim.state for claim in claims}


def test_a_graph_with_states_is_taken_at_its_word():
    now = Snapshot(
        20,
        {
            "object-1": seen("sofa", 0),
            "object-2": seen("mug", 9, "moved", first=5),
            "object-3": seen("bed", 8, "disappeared"),
            "object-7": seen("cup", 3),
        },
        {},
    )
    claims = claims_of(now, SURVEY, "graph")
    assert states(claims) == {
        "object-1": "static",
        "object-2": "moved",
        "object-3": "disappeared",
        "object-7": "static",  # discovered, not appeared
    }
    moved = claims[1]
    assert moved.former is not None
    assert moved.former[0][0] == 5


def test_without_states_they_follow_from_who_is_there():
    now = Snapshot(20, {"object-1": seen("sofa", 0), "object-9": seen("mug", 9)}, {})
    assert states(claims_of(now, SURVEY, "derived")) == {
        "object-1": "static",
        "object-9": "appeared",
        "object-2": "disappeared",
        "object-3": "disappeared",
    }


def test_an_object_that_took_another_in_carries_on_its_life():
    now = Snapshot(20, {"object-12": seen("sofa", 0), "object-3": seen("bed", 8)},
                   {"object-1": "object-11", "object-11": "object-12", "object-2": "object-2"})  # fmt: skip
    assert states(claims_of(now, SURVEY, "derived")) == {
        "object-12": "static",
        "object-3": "static",
        "object-2": "disappeared",
    }


def add(number, x):
    low, high = box(x)
    points = np.stack([low, high]).astype(np.float32)
    return ObjectAdded(cause=CAUSE, object_id=f"object-{number}", label="mug", score=1.0, points=points,
                       colors=np.zeros((2, 3), np.uint8), viewpoint_id=None, range_m=1.0)  # fmt: skip


def test_the_watch_counts_an_update_where_beliefs_change_and_not_where_points_grow():
    watch = GraphWatch()
    watch.graph = SceneGraph()

    def apply(frame, *changes):
        stamped = watch.graph.apply_all(changes, frame, frame * 0.2)
        watch.on_event(GraphChanged(frame, frame * 0.2, stamped))

    def believe(number):
        return ObjectChanged(cause=CAUSE, object_id=f"object-{number}", values={"status": "believed"})

    watch.on_event(PhaseStarted("survey", 0, 0, 0.0))
    apply(1, add(1, 0), believe(1), add(2, 5), believe(2))
    watch.on_event(PhaseStarted("revisit", 1, 5, 1.0))
    assert watch.survey is not None
    assert list(watch.survey.objects) == ["object-1", "object-2"]
    apply(6, add(3, 9))  # tentative: nobody believes it yet
    assert watch.updates == []
    apply(7, believe(3))
    apply(8, add(4, 12))
    assert [update.frame for update in watch.updates] == [8]
    apply(9, ObjectRemoved(cause=CAUSE, object_id="object-2", successor_id="object-3"))
    assert [update.frame for update in watch.updates] == [8, 9]
    assert watch.updates[-1].heirs == {"object-2": "object-3"}
    apply(10, ObjectChanged(cause=CAUSE, object_id="object-1", values={"state": "disappeared"}))
    watch.on_event(PhaseStarted("revisit", 2, 11, 2.0))
    assert len(watch.updates) == 3
    assert watch.visit_ends == [3]


HOME_BEFORE = tuple(
    Thing(label, label, "static", place(label, x)) for label, x in (("sofa", 0), ("mug", 5), ("bed", 8))
)
HOME_AFTER = (
    Thing("sofa", "sofa", "static", place("sofa", 0), retained=True),
    Thing("bed", "bed", "static", place("bed", 8, {0: 5}), retained=False),
    Thing("mug", "mug", "moved", place("mug", 12), place("mug", 5)),
    Thing("cup", "cup", "appeared", place("cup", 20)),
)
TRUTH = RunTruth(HOME_BEFORE, HOME_AFTER, 10, {})


def snapshots():
    """The mug is found where it went, then the cup."""
    first = dict(SURVEY.objects) | {"object-2": seen("mug", 12, "moved", first=5)}
    second = first | {"object-8": seen("cup", 20, "appeared")}
    return [Snapshot(30, first, {}), Snapshot(40, second, {})]


def test_relative_accuracy_by_hand():
    """Survey: all right, Acc 1. Then 2 of 3 claims right, 2 of 4 things missed: 2*2/(3+4). Then 6/7, 1."""
    recovered = recovery(SURVEY, snapshots(), TRUTH, "graph")
    assert recovered.previous == 1.0
    assert recovered.outdated == pytest.approx(4 / 7)
    assert recovered.updates == (pytest.approx(6 / 7), 1.0)
    assert recovered.delta == pytest.approx(3 / 7)
    assert recovered.relative == (pytest.approx(2 / 3), pytest.approx(1.0))
    assert recovered.gain == pytest.approx(3 / 7)
    assert recovered.measurable
    assert not Recovery(0.9, 0.885, (0.9,)).measurable


def test_a_run_that_is_done_keeps_its_last_value():
    rows = mean_curve([[0.5, 1.0], [0.0], []])
    assert rows[0] == (pytest.approx(0.5 / 3), pytest.approx(np.std([0.5, 0, 0], ddof=1)), 2)
    assert rows[1][0] == pytest.approx(1 / 3)
    assert rows[1][2] == 1
    assert mean_curve([]) == []


def watched():
    watch = GraphWatch()
    watch.survey, watch.updates = SURVEY, snapshots()
    return watch


FACTS = {"scene": "rs_int", "seed": 0, "perception": "oracle", "method": "dssm", "recording": "a/b.rrd",
         "seconds": 1.0, "errors": 0}  # fmt: skip


def test_everything_that_the_tables_need_survives_the_file(tmp_path):
    score = score_replay(watched(), TRUTH, "graph", **FACTS)
    assert score.dynamic.right == 2
    assert score.update == UpdateScore(2, 2, 1, 1, ())
    assert score.first_revisit == pytest.approx(1.0)
    assert (score.still_there.cases, score.hidden.cases) == (2, 1)
    file = tmp_path / "score.json"
    score.write(file)
    assert ReplayScore.read(file) == score
    file.write_text("{}")
    with pytest.raises(ConfigError, match="is no result"):
        ReplayScore.read(file)


def test_a_hidden_thing_that_is_called_disappeared_is_found_out():
    watch = watched()
    gone = dict(watch.updates[-1].objects) | {"object-3": seen("bed", 8, "disappeared")}
    watch.updates.append(Snapshot(50, gone, {}))
    score = score_replay(watch, TRUTH, "graph", **FACTS)
    assert score.hidden.failed == ("bed",)
    assert score.still_there.failed == ("bed",)
    assert score.still_there.right == 1


@pytest.mark.parametrize(
    ("objects", "right"),
    [
        ({"object-2": seen("mug", 5)}, 1),
        ({"object-2": seen("mug", 5, "moved", first=5)}, 1),  # whatever it is called
        ({"object-9": seen("mug", 5)}, 0),  # another id: it was not recognised
        ({"object-2": seen("mug", 5), "object-9": seen("mug", 15)}, 0),  # still believed where it was
        ({"object-2": seen("mug", 15)}, 0),
    ],
)
def test_put_back(objects, right):
    back = Thing("mug", "mug", "static", place("mug", 5), counted=False, tag="put_back")
    truth = RunTruth(HOME_BEFORE, (back,), 10, {"mug": (place("mug", 15),)})
    watch = GraphWatch()
    watch.survey, watch.updates = SURVEY, [Snapshot(60, objects, {})]
    verdicts = score_replay(watch, truth, "graph", **FACTS).put_back
    assert (verdicts.right, verdicts.cases) == (right, 1)


def scores():
    """Two seeds in each of two scenes."""
    base = score_replay(watched(), TRUTH, "graph", **FACTS)
    half = replace(base, seed=1, dynamic=Tally(1, ("a",), ("b",)), recording="c/d.rrd")
    other = [replace(score, scene="ihlen_1_int") for score in (base, half)]
    return [base, half, *other]


def test_rows_hold_what_the_contract_asks():
    rows = table_rows("table1", scores())
    assert all(set(COLUMNS) <= set(row) for row in rows)
    row = next(r for r in rows if r["scene"] == "rs_int" and r["metric"] == "dynamic_f1")
    assert row["mean"] == pytest.approx(0.75)
    assert row["std"] == pytest.approx(np.std([1.0, 0.5], ddof=1))
    assert row["n"] == 2
    assert row["paper"] == 0.833
    assert row["recordings"] == ["a/b.rrd", "c/d.rrd"]
    assert {r["scene"] for r in rows} == {"rs_int", "ihlen_1_int", "all"}
    assert {table for table in TABLES for _ in table_rows(table, scores())} == set(TABLES)


def test_rates_are_over_things_and_curves_over_updates():
    one = replace(scores()[0], hidden=Verdicts(3, ("bed",)), swap=Verdicts(1, ("mug",)))
    occlusion = {row["metric"]: row["mean"] for row in table_rows("occlusion", [one])}
    assert occlusion["hidden_called_disappeared"] == 1.0
    assert occlusion["hidden_false_disappearance_rate"] == 0.25
    assert {r["metric"]: r["mean"] for r in table_rows("identity", [one])}["swap_right"] == 0.5
    flat = replace(one, recovery=Recovery(0.9, 0.89, (0.9,)))
    figure = {row["metric"]: row for row in table_rows("fig5", [one, flat])}
    assert figure["excluded"]["mean"] == 1.0
    assert figure["relative_accuracy@1"]["mean"] == pytest.approx(2 / 3)


def test_rows_are_written_as_json_and_csv(tmp_path):
    rows = table_rows("table2", scores())
    as_json, as_csv = write_rows(rows, tmp_path / "new", "table2-oracle")
    assert json.loads(as_json.read_text()) == rows
    lines = as_csv.read_text().splitlines()
    assert lines[0].startswith("table,scene,method")
    assert len(lines) == len(rows) + 1


@pytest.mark.parametrize("table", TABLES)
def test_every_table_has_a_figure(tmp_path, table):
    pytest.importorskip("matplotlib")
    from dssmsg.evaluate.tables_figure import draw_figure

    file = tmp_path / "a.png"
    draw_figure(table, table_rows(table, scores()), file)
    assert file.read_bytes().startswith(b"\x89PNG")


def test_without_matplotlib_the_message_says_what_to_do(tmp_path, monkeypatch):
    import sys

    from dssmsg.evaluate.tables_figure import draw_figure

    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ConfigError, match=r"pip install 'dssmsg\[figures\]'"):
        draw_figure("table1", [], tmp_path / "a.png")


def test_methods_are_known_by_name():
    assert [method.name for method in methods_named(["none", "dssm", "none"])] == ["none", "dssm"]
    with pytest.raises(ConfigError, match="unknown method 'dsm'; known: dssm"):
        methods_named(["dsm"])
    assert {m.name for m in METHODS.values() if m.states == "graph"} == {"dssm", "dssm_paper_exact"}
