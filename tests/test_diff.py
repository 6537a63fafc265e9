"""`dssmsg diff`: a planted change is found, with its layer and first frame; both graphs in one file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from planted_run import LAYERS, SCORE, PlantedRun, occasions
from project import project
from recorded_run import record
from test_replay import DEN, RUN, needs_open3d

from dssmsg import events as ev
from dssmsg.errors import InputError, StorageError
from dssmsg.recording.reader import Recording
from dssmsg.review.diff import Difference, compare
from dssmsg.review.diff_objects import compare_objects, placed
from dssmsg.review.diff_picture import write_picture
from dssmsg.review.diff_text import difference_text

CASES = [(plant, 0) for plant in LAYERS] + [("threshold", 1), ("merge refused", 2), ("edge blocked", 1)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("diff")


def base(folder: Path, seed: int = 0) -> Path:
    path = folder / f"base-{seed}.rrd"
    return path if path.exists() else record(PlantedRun(seed=seed), path)


def planted(folder: Path, plant: str, seed: int = 0) -> tuple[Path, int]:
    """The recording of a run with a plant, and the frame in which it was planted."""
    path = folder / f"{plant}-{seed}.rrd"
    run = PlantedRun(plant, occasions(plant, seed), seed, run_id=path.stem)
    if path.exists():
        for _ in run.events():
            pass
    else:
        record(run, path)
    assert run.planted is not None, f"{plant} found no occasion"
    return path, run.planted


def difference(a: Path, b: Path) -> Difference:
    with Recording.open(a) as first, Recording.open(b) as second:
        return compare(first, second)


def test_twenty_cases() -> None:
    assert len(set(CASES)) == 20


@pytest.mark.parametrize(("plant", "seed"), CASES)
def test_what_was_planted_is_found_in_its_first_frame(folder: Path, plant: str, seed: int) -> None:
    path, frame = planted(folder, plant, seed)
    found = difference(base(folder, seed), path)
    assert found.divergence is not None
    assert (found.divergence.frame, found.divergence.layer) == (frame, LAYERS[plant]), found.divergence
    assert not found.same
    assert str(frame) in difference_text(found)


@pytest.mark.parametrize("plant", ["merge refused", "detection dropped", "frame missing"])
def test_the_order_of_the_two_does_not_matter(folder: Path, plant: str) -> None:
    path, frame = planted(folder, plant)
    found = difference(path, base(folder))
    assert found.divergence is not None
    assert (found.divergence.frame, found.divergence.layer) == (frame, LAYERS[plant])


def test_equal_runs_part_nowhere(folder: Path, tmp_path: Path) -> None:
    twin = record(PlantedRun(run_id="twin"), tmp_path / "twin.rrd")
    found = difference(base(folder), twin)
    assert found.same
    assert found.traces == ()
    assert found.settings == ()
    objects = found.objects
    assert (objects.differing, objects.only_a, objects.only_b, found.rules) == ((), (), (), ())
    assert "parted       nowhere" in difference_text(found)


def test_a_threshold_is_named_with_the_score_that_it_refused(folder: Path) -> None:
    path, frame = planted(folder, "threshold")
    found = difference(base(folder), path)
    assert found.divergence is not None
    term = next(one for one in found.divergence.scores if one.name == "s")
    assert (term.threshold_a, term.threshold_b) == (SCORE, pytest.approx(SCORE + 0.1))
    assert term.a == term.b
    assert "merged" in found.divergence.a
    assert "new" in found.divergence.b
    assert [(one.key, one.a) for one in found.because] == [("association.delta_sim", SCORE)]
    # Decisions before were held against the other threshold too, and came out the same.
    (trace,) = found.traces
    assert trace.frame <= frame
    assert not trace.consequence
    assert "because association.delta_sim: 1.1 -> 1.2" in difference_text(found)


class Recoloured(PlantedRun):
    """The same run by slightly other colours, as a replay of JPEG images is one."""

    def _sighting(self, number: int, name: str, viewpoint: str) -> list[Any]:
        return [
            replace(one, colors=one.colors // 2) if hasattr(one, "colors") else one
            for one in super()._sighting(number, name, viewpoint)
        ]

    def _judged(self, index: int, seconds: float) -> Iterator[ev.Event]:
        for event in super()._judged(index, seconds):
            if isinstance(event, ev.WindowEvaluated):
                evidence = [replace(one, values=MappingProxyType({"share": 0.8})) for one in event.evidence]
                event = replace(event, evidence=tuple(evidence))
            elif isinstance(event, ev.Matched):
                told = [replace(one, scores={"score": 1.5 - one.rank / 4}) for one in event.candidates]
                event = replace(event, candidates=tuple(told))
            yield event


def test_other_colours_and_numbers_are_traces(folder: Path, tmp_path: Path) -> None:
    twin = record(Recoloured(run_id="twin"), tmp_path / "twin.rrd")
    found = difference(base(folder), twin)
    assert found.same
    colours, numbers = found.traces
    assert (colours.frame, colours.layer, colours.fields) == (0, "association", ("colors",))
    assert (colours.a, colours.b) == ("", "")
    assert (numbers.frame, numbers.layer, numbers.fields) == (0, "update", ("evidence",))
    assert (numbers.a, numbers.b) == ("evidence[0].values.share 0.9", "evidence[0].values.share 0.8")
    text = difference_text(found)
    assert "parted       nowhere: every frame, detection, decision" in text
    assert (
        "first trace  frame 0, association (association/dssm): merge: the same decision, other colors" in text
    )


@pytest.mark.parametrize(
    ("plant", "told"),
    [
        ("verdict changed", "a window differs: viewpoint-1.1 (verdicts)"),
        ("rank swapped", "a match differs: the mug (candidates)"),
        ("merge refused", "another change"),
    ],
)
def test_a_decision_behind_other_colours_is_found(
    folder: Path, tmp_path: Path, plant: str, told: str
) -> None:
    run = Recoloured(plant, 6, run_id="planted")
    path = record(run, tmp_path / "planted.rrd")
    found = difference(base(folder), path)
    assert found.divergence is not None
    assert (found.divergence.frame, found.divergence.layer) == (run.planted, LAYERS[plant])
    assert told in difference_text(found)
    assert len(found.traces) == 2


@needs_open3d
def test_a_jpeg_run_and_its_replay_part_where_a_decision_did(tmp_path: Path) -> None:
    config = RUN.replace("images: lossless", "images: jpeg").replace("max_frames: 300", "max_frames: 40")
    place = project(tmp_path, {"den.yaml": DEN, "dssmsg.yaml": config})
    began = place.run("run", "--json")
    assert began.code == 0, began.err
    run = began.json["recording"]
    paths = []
    for limit in (1.1, 1.9):
        done = place.run("replay", run, "--set", f"association.delta_sim={limit}", "--json")
        assert done.code == 0, done.err
        paths.append(place.path / done.json["recording"])
    same = difference(place.path / run, paths[0])
    assert same.same
    assert "colors" in same.traces[0].fields
    found = difference(place.path / run, paths[1])
    assert found.divergence is not None
    assert found.divergence.a != found.divergence.b
    assert any(one.name == "s" and one.threshold_b == 1.9 for one in found.divergence.scores)
    assert [one.key for one in found.because] == ["association.delta_sim"]
    text = difference_text(found)
    assert "images       A's are JPEG" in text
    assert "the same decision, other colors, scores" in text
    # Two replays saw the same images.
    assert "images  " not in difference_text(difference(*paths))


def test_results_are_compared(folder: Path) -> None:
    gone, _ = planted(folder, "object gone")
    pair = difference(base(folder), gone).objects.differing
    assert [(one.a.state, one.b.state, one.differs) for one in pair] == [
        ("static", "disappeared", ("state",))
    ]
    refused = difference(base(folder), planted(folder, "merge refused")[0])
    assert refused.changes["object_added"][1] == refused.changes["object_added"][0] + 1
    swapped = difference(base(folder), planted(folder, "rank swapped")[0])
    lost = difference(base(folder), planted(folder, "episode lost")[0])
    assert [(one.a, one.b) for one in lost.episodes] == [("success", "failure (wrong match)")]
    assert all(query.query == "the mug" for query in swapped.queries)
    assert difference(base(folder), planted(folder, "perception failed")[0]).errors == (1, 2)


def test_objects_are_matched_by_place_not_by_id(folder: Path) -> None:
    with Recording.open(base(folder)) as recording:
        graph, early = recording.graph_at(), recording.graph_at(12)
    found = compare_objects(placed(early), placed(graph))
    assert found.only_a == ()
    assert len(found.only_b) == len(graph.objects) - len(early.objects) > 0
    assert {one.id for one in found.only_b} == set(graph.objects) - set(early.objects)


def test_both_graphs_in_one_file(folder: Path, tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    path, frame = planted(folder, "object gone")
    both = tmp_path / "both.rrd"
    with Recording.open(base(folder)) as a, Recording.open(path) as b:
        found = compare(a, b)
        write_picture(both, a, b, found)
        with pytest.raises(StorageError, match="exists"):
            write_picture(both, a, b, found)
    reader = RrdReader(both)
    assert reader.recordings()[0].application_id == "dssmsg-comparison"
    store = reader.store(store=reader.recordings()[0])
    paths = {str(column.entity_path) for column in store.schema().component_columns()}
    for side in ("a", "b"):
        assert {
            f"/{side}/world/objects",
            f"/{side}/world/camera/rgb",
            f"/{side}/graph/map",
            f"/{side}/world/differing",
            f"/log/{side}",
            f"/plots/{side}",
        } <= paths
    assert "/summary" in paths
    with pytest.raises(InputError, match="made by `dssmsg diff --recording`; `dssmsg view` opens it"):
        Recording.open(both)
    assert frame > 0


def test_the_command(folder: Path, tmp_path: Path) -> None:
    path, frame = planted(folder, "edge blocked")
    place = project(tmp_path)
    done = place.run("diff", str(base(folder)), str(path), "--json")
    assert done.code == 0, done.err
    assert done.json["divergence"]["frame"] == frame
    assert done.json["divergence"]["plugin"] == "graph/topology"
    assert done.json["same"] is False
    done = place.run("diff", str(base(folder)), str(path), "--recording", "both.rrd")
    assert (done.code, (tmp_path / "both.rrd").stat().st_size > 0) == (0, True)
    assert f"parted       frame {frame}, topology (graph/topology)" in done.out
    assert "both side by side: both.rrd" in done.err
    before = (tmp_path / "both.rrd").read_bytes()
    refused = place.run("diff", "nowhere.rrd", str(path), "--recording", "both.rrd")
    assert (refused.code, refused.out) == (2, "")
    assert "both.rrd: --recording: exists already; give --force" in refused.err
    assert (tmp_path / "both.rrd").read_bytes() == before
    done = place.run("diff", str(base(folder)), str(base(folder)), "--recording", "both.rrd", "--force")
    assert done.code == 0
    assert (tmp_path / "both.rrd").read_bytes() != before
    assert [one.name for one in tmp_path.iterdir()] == ["both.rrd"]
    wrong = place.run("diff", str(path), "nowhere.rrd")
    assert (wrong.code, wrong.out) == (2, "")
    assert "nowhere.rrd" in wrong.err


class Seeking(PlantedRun):
    """The same run, told to seek `goals`."""

    def __init__(self, *goals: str) -> None:
        super().__init__(run_id=f"seeking-{len(goals)}-{goals[0]}")
        self._goals = goals

    def events(self) -> Iterator[ev.Event]:
        for event in super().events():
            match event:
                case ev.RunStarted():
                    mission = {"phases": ["survey", "seek"], "goals": list(self._goals)}
                    yield replace(event, config={**event.config, "mission": mission})
                case ev.Matched():
                    yield replace(event, query=self._goals[0])
                case ev.EpisodeEnded():
                    yield replace(event, goal=self._goals[0])
                    for number, goal in enumerate(self._goals[1:], start=1):
                        yield replace(event, episode=number, goal=goal)
                case _:
                    yield event


def test_other_goals_are_the_missions_doing_and_asked_in_one_run_alone(tmp_path: Path) -> None:
    mug, cup, both = (
        record(Seeking(*goals), tmp_path / f"{len(goals)}{goals[0][4:]}.rrd")
        for goals in (("the mug",), ("the cup",), ("the mug", "the cup"))
    )
    found = difference(mug, cup)
    assert found.divergence is not None
    assert (found.divergence.layer, found.divergence.a, found.divergence.b) == (
        "mission",
        "the mug",
        "the cup",
    )
    assert [one.key for one in found.because] == ["mission.goals"]
    assert {(one.query, one.only_in) for one in found.queries} == {("the mug", "a"), ("the cup", "b")}
    assert [(one.goal, one.a, one.b) for one in found.episodes] == [
        ("the mug", "success", "not run"),
        ("the cup", "not run", "success"),
    ]
    assert "“the cup”: asked in B alone" in difference_text(found)
    longer = difference(mug, both)
    assert longer.divergence is not None
    assert (longer.divergence.layer, longer.divergence.a, longer.divergence.b) == (
        "mission",
        "no goal",
        "the cup",
    )
