"""The report: one page that holds everything, asks for nothing, and believes nothing it is told."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from project import Project, project
from recorded_run import SyntheticRun, record

from dssmsg import events as ev
from dssmsg.graph import changes as ch
from dssmsg.recording.reader import Recording
from dssmsg.review import report_markup as html
from dssmsg.review.report import report_page
from dssmsg.review.report_map import Spot, floor_map
from dssmsg.review.report_pictures import spread
from dssmsg.review.report_plots import MAX_POINTS, line_plot, nice_ticks, thinned

HOSTILE = "\"><script>alert(1)</script><img src=x onerror=alert(2)>'&\x00\u202e\ud800</svg>" + "A" * 300


class Telling(SyntheticRun):
    """A run with a query, an episode and a verdict; objects and texts named `label` where it is given."""

    def __init__(self, label: str = "", **options: Any) -> None:
        super().__init__(9, objects=5, **options)
        self._label = label

    def _sighting(self, number: int, name: str, viewpoint: str) -> list[ch.Change]:
        changes = super()._sighting(number, name, viewpoint)
        return [
            replace(one, detection=0, **({"label": self._label} if self._label else {}))
            if isinstance(one, ch.ObjectAdded | ch.ObjectMerged)
            else one
            for one in changes
        ]

    def events(self) -> Iterator[ev.Event]:
        said = self._label or "a place to wash up"
        candidate = ev.Candidate("viewpoint-1.1", 1, {"score": 4.2}, {"0": "object-1"}, said)
        target = {"nodes": [{"label": said, "attributes": []}], "edges": [], "core": 0, "kind": "explicit"}
        for event in super().events():
            if isinstance(event, ev.RunFinished):
                yield ev.Matched(said, 7, 1.4, target, (candidate,))
                verdict = {"object-1": self._label or "disappeared"}
                yield ev.WindowEvaluated("viewpoint-1.1", 7, 1.4, (3,), (7,), (), verdict, 3)
                yield ev.EpisodeEnded(
                    0, said, "failure", self._label or "wrong match", 8, 1.6, {"metres": 2.5}
                )
            yield event


class Page(HTMLParser):
    """What a browser would make of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(Telling(run_id="telling"), tmp_path_factory.mktemp("report") / "run.rrd")


@pytest.fixture(scope="module")
def text(path: Path) -> str:
    with Recording.open(path) as recording:
        return report_page(recording, {0: "the matching is to blame"})


def test_the_page_tells_the_run(text: str) -> None:
    page = Page(text)
    headings = re.findall(r"<h2>([^<]+)</h2>", text)
    assert headings == [
        "What happened", "Episodes", "Map", "On the way", "Over time", "Verdicts on what changed", "Queries",
        "Objects", "Errors", "How it was run",
    ]  # fmt: skip
    for words in (
        "a place to wash up", "wrong match", "the matching is to blame", "object-1", "disappeared",
        "viewpoint-1.1", "4.2", "chair", "NaN in a box", "believed", "synthetic",
    ):  # fmt: skip
        assert words in page.text
    images = [attributes["src"] or "" for tag, attributes in page.tags if tag == "img"]
    assert len(images) > 5
    assert all(image.startswith("data:image/jpeg;base64,/9j/") for image in images)
    assert any(attributes.get("class") == "crop" for tag, attributes in page.tags if tag == "img")
    assert sum(tag == "svg" for tag, _ in page.tags) >= 4


def test_a_picture_says_its_frame_and_why_it_is_shown_where_there_is_a_reason(text: str) -> None:
    captions = re.findall(r"<figcaption>([^<]*)</figcaption>", text)
    assert "frame 7; viewpoint-1.1: object-1 disappeared" in captions
    assert any(re.fullmatch(r"frame \d+", one) for one in captions)
    assert all(re.fullmatch(r"frame \d+(; .*\w)?", one) for one in captions)


def self_contained(text: str) -> None:
    """No script, and nothing that a browser would fetch."""
    page = Page(text)
    names = {tag for tag, _ in page.tags}
    assert not names & {"script", "link", "iframe", "object", "embed", "base", "form", "audio", "video", "a"}
    for tag, attributes in page.tags:
        for name, value in attributes.items():
            assert not name.startswith("on"), (tag, name)
            if name in ("src", "href", "srcset", "data", "action", "xlink:href", "poster"):
                assert str(value).startswith("data:image/jpeg;base64,")
    assert "url(" not in text
    assert "@import" not in text
    policies = [attributes.get("content") or "" for tag, attributes in page.tags if tag == "meta"]
    assert any(policy.startswith("default-src 'none'") for policy in policies)


def test_the_page_asks_for_nothing(text: str) -> None:
    self_contained(text)


def test_hostile_labels_stay_text(tmp_path: Path) -> None:
    clean = HOSTILE.replace("\ud800", "")  # no writer could store that one
    path = record(Telling(clean, run_id="hostile"), tmp_path / "hostile.rrd")
    with Recording.open(path) as recording:
        text = report_page(recording, {0: HOSTILE})
    text.encode("utf-8")
    self_contained(text)
    assert "<script>alert(1)</script>" in Page(text).text  # as words
    assert not set("\x00\u202e\ud800") & set(text)
    assert all(attributes.get("src") != "x" for _, attributes in Page(text).tags)


def test_markup_is_escaped_everywhere() -> None:
    assert html.tag("p", "<b>", title='"x"') == '<p title="&quot;x&quot;">&lt;b&gt;</p>'
    assert html.tag("p", html.tag("b", "<")) == "<p><b>&lt;</b></p>"
    assert html.tag("rect", stroke_width=2, fill=None) == '<rect stroke-width="2"></rect>'
    assert html.text("x" * 50, 10) == "xxxxxxxxxx ... (40 more characters)"
    assert html.section("Empty", "") == ""


def test_maps_leave_out_what_cannot_be() -> None:
    run = Telling(run_id="far")
    list(run.events())
    nowhere = np.array([np.nan, 0.0, 0.0])
    far = np.array([1e9, 0.0, 0.0])
    drawn = floor_map(
        run.live,
        {0: [np.zeros(3), nowhere, far, np.ones(3)]},
        [Spot(nowhere, "here", False), Spot(np.ones(3), "x", True)],
    )
    assert "nan" not in drawn
    assert max(float(number) for number in re.findall(r'x="([-\d.]+)"', drawn)) < 5000
    assert "here" not in drawn
    from dssmsg.graph.scene_graph import SceneGraph

    assert floor_map(SceneGraph(), {}) == ""


def test_plots_of_odd_data() -> None:
    assert line_plot("none", {"a": []}) == ""
    assert "<polyline" in line_plot("one point", {"a": [(3.0, 0.0)]})
    many = [(float(x), float(x % 7 == 0)) for x in range(10 * MAX_POINTS)]
    few = thinned(many)
    assert len(few) == MAX_POINTS
    assert [x for x, _ in few] == sorted(x for x, _ in few)
    for low, high in ((0.0, 0.0), (0.0, 1e-9), (3.0, 7.5), (0.0, 1e12)):
        ticks = nice_ticks(low, high)
        assert ticks[0] <= low
        assert ticks[-1] >= high
        assert 2 <= len(ticks) <= 12
    assert spread(list(range(100)), 3) == [0, 50, 99]
    assert spread([4, 5], 3) == [4, 5]
    assert spread([4, 5], 1) == [4]


def in_cache(folder: Project, *arguments: str) -> Any:
    return folder.run(*arguments, env={"XDG_CACHE_HOME": str(folder.path / "cache")})


def test_the_command_writes_one_file_and_overwrites_none(path: Path, tmp_path: Path) -> None:
    folder = project(tmp_path)
    done = in_cache(folder, "report", str(path), "-o", "page.html")
    assert (done.code, done.out) == (0, "page.html\n")
    page = (tmp_path / "page.html").read_text("utf-8")
    self_contained(page)
    assert "cannot be explained" not in page
    again = in_cache(folder, "report", str(path), "-o", "page.html")
    assert again.code == 2
    assert "--force" in again.err
    (tmp_path / "page.html").write_text("mine")
    in_cache(folder, "report", str(path), "-o", "page.html", "--force", "--json")
    assert (tmp_path / "page.html").read_text("utf-8") == page
    assert in_cache(folder, "report", "nothing.rrd", "-o", "x.html").code == 2
    assert not (tmp_path / "x.html").exists()


def test_a_folder_is_told_with_its_failures_and_its_broken_files(path: Path, tmp_path: Path) -> None:
    folder = project(tmp_path, {"runs/broken.rrd": "no recording", "empty/x": ""})
    shutil.copy(path, tmp_path / "runs/one.rrd")
    record(Telling(run_id="second", seed=1), tmp_path / "runs/two.rrd")
    done = in_cache(folder, "report", "runs", "-o", "runs.html", "--json")
    assert done.code == 0, done.err
    assert done.json["recordings"] == 3
    text = (tmp_path / "runs.html").read_text("utf-8")
    self_contained(text)
    page = Page(text)
    assert page.text.count("a place to wash up") >= 4
    assert "broken.rrd" in page.text
    assert "0%" in page.text
    assert sum(tag == "details" and "open" not in attributes for tag, attributes in page.tags) >= 2
    assert in_cache(folder, "report", "empty", "-o", "e.html").code == 2
