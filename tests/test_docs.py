"""The documents: links lead somewhere, and the plug-ins in docs/plugins.md work as they stand."""

from __future__ import annotations

import logging
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import example_plugins as examples
import numpy as np
import pytest
from fake_plugins import FakeSource, SourceConfig
from floor_graph import camera_pose
from project import project

from dssmsg import checks
from dssmsg.cli.doctor import _renderer
from dssmsg.contexts import ContextFactory
from dssmsg.frame import Frame
from dssmsg.graph.changes import Cause, EdgeAdded, ObjectAdded, ViewpointAdded, WaypointAdded
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.hookspecs import PluginConfig
from dssmsg.host import Host
from dssmsg.interfaces import KINDS, TargetGraph, TargetNode

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
_LINK = re.compile(r"\]\(([^)\s]+)\)")


def prose(path: Path) -> str:
    """A document without its code."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"`[^`\n]*`", "", text)


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_relative_links_and_images_lead_to_files(path: Path) -> None:
    """docs/figures.md included, which the README names."""
    links = [link for link in _LINK.findall(prose(path)) if not re.match(r"[a-z]+:|#", link)]
    missing = [link for link in links if not (path.parent / link.partition("#")[0]).exists()]
    assert not missing


def test_the_readme_links_to_every_document() -> None:
    links = set(_LINK.findall(prose(ROOT / "README.md")))
    assert {f"docs/{path.name}" for path in DOCUMENTS[1:]} <= links


def test_the_threshold_that_the_documents_show_is_the_default() -> None:
    from dssmsg_plugins.association.dssm import DssmConfig

    text = (ROOT / "docs/graph.md").read_text(encoding="utf-8")
    assert f'["s_sem",1.0,{DssmConfig().merge_min_semantic}]' in text
    assert f'["s",1.71,{DssmConfig().delta_sim}]' in text


def test_doctor_says_how_slow_the_other_renderer_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dssmsg.sim.camera.probe_open3d", lambda: "gone")
    assert "about ten times slower" in _renderer().detail


# -- the plug-in of every kind ----------------------------------------------------------------------------


def shown() -> dict[str, str]:
    """kind -> the code below its heading in docs/plugins.md."""
    text = (ROOT / "docs/plugins.md").read_text(encoding="utf-8")
    part = text.partition("## One of each\n")[2].partition("\n## ")[0]
    sections = re.split(r"^### ", part, flags=re.MULTILINE)[1:]
    return {
        section.splitlines()[0]: re.findall(r"^```python\n(.*?)^```", section, re.DOTALL | re.MULTILINE)[0]
        for section in sections
    }


def test_every_kind_has_a_heading() -> None:
    assert list(shown()) == list(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_the_code_in_the_page_is_the_code_that_is_tested(kind: str) -> None:
    """Every class of the page stands letter for letter in the tests' modules (and not only in the page)."""
    tested = "".join(
        (ROOT / f"tests/{name}_plugins.py").read_text(encoding="utf-8") for name in ("fake", "example")
    )
    pieces = [piece for piece in shown()[kind].split("\n\n\n") if not piece.startswith(("from ", "import "))]
    assert len(pieces) >= 2
    assert all(piece.strip() in tested for piece in pieces)


@pytest.mark.parametrize("kind", KINDS)
def test_the_code_of_a_kind_works_on_its_own(tmp_path: Path, kind: str) -> None:
    """As a file, named under `plugins:`; the host builds it and finds nothing missing."""
    (tmp_path / "mine.py").write_text(shown()[kind], encoding="utf-8")
    host = Host.load(("mine.py",), tmp_path, entry_points=())
    (found,) = (one for one in host.registrations(kind) if "mine.py" in one.origin)
    contexts = ContextFactory(host, 0, SceneGraph(), IdAllocator(), tmp_path, tmp_path / "out", "run")
    built = host.build(kind, {"use": found.name}, contexts, base_dir=tmp_path, key=kind)
    assert isinstance(built.plugin, KINDS[kind])
    if hasattr(built.plugin, "close"):
        built.plugin.close()


def test_a_run_with_the_code_of_every_kind(tmp_path: Path) -> None:
    lines = ["name: examples", f"plugins: [{', '.join(f'{kind}_mine.py' for kind in KINDS)}]"]
    slots = {kind: "example" if "example" in code else "fake" for kind, code in shown().items()}
    lines += [f"{kind}: {{use: {slots[kind]}}}" for kind in KINDS if kind not in OTHERWISE]
    chain = ", ".join(f"{kind}: {{use: {slots[kind]}}}" for kind in ("tagger", "detector", "segmenter"))
    lines += [f"perception: {{use: chain, {chain}}}", "diagnosis: [{use: example}]", "on_error: fail"]
    lines += ["mission: {phases: [survey]}", "recording: {observers: {rerun: false, fake: {}}}"]
    files = {f"{kind}_mine.py": code for kind, code in shown().items()}
    done = project(tmp_path, {"dssmsg.yaml": "\n".join(lines), **files}).run("run", "--json")
    assert done.code == 0, done.err
    (told,) = (tmp_path / "recordings").glob("*.txt")
    assert "object_changed" in told.read_text()  # tagger, detector, segmenter, association, update


OTHERWISE = {"perception", "tagger", "detector", "segmenter", "diagnosis", "observer"}


def frame() -> Frame:
    found = FakeSource(SourceConfig(), context(SceneGraph())).step(None)
    assert found is not None
    return found


def context(graph: SceneGraph) -> Any:
    return SimpleNamespace(graph=graph, log=logging.getLogger("test"))


def test_links_of_a_chain_keep_their_contracts() -> None:
    one, around = frame(), context(SceneGraph())
    tags = checks.check_tags(examples.HourTagger(PluginConfig(), around).tags(one))
    boxes = checks.check_boxes(examples.NearDetector(PluginConfig(), around).detect(one, tags))
    assert [box.label for box in boxes] == ["chair"]
    (mask,) = checks.check_masks(one, examples.NearSegmenter(PluginConfig(), around).segment(one, boxes), 1)
    assert mask.all()
    dark = replace(one, depth=np.zeros_like(one.depth))
    assert examples.NearDetector(PluginConfig(), around).detect(dark, None) == []
    (empty,) = examples.NearSegmenter(PluginConfig(), around).segment(dark, boxes)
    assert not empty.any()


def seen_chair() -> SceneGraph:
    """A chair seen from one viewpoint, 2 m to the left of the origin."""
    graph, cause = SceneGraph(), Cause("test", "made")
    graph.apply_all(
        [
            WaypointAdded(cause=cause, waypoint_id="waypoint-1", position=np.array([0.0, 2.0, 0.0])),
            ViewpointAdded(
                cause=cause,
                viewpoint_id="viewpoint-1.1",
                waypoint_id="waypoint-1",
                world_from_camera=camera_pose(0.0, 2.0),
                heading=0.0,
                tilt=0.0,
            ),
            ObjectAdded(
                cause=cause,
                object_id="object-1",
                label="chair",
                score=0.9,
                points=np.array([[1, 2, 0.5], [1.1, 2.1, 0.6]], np.float32),
                colors=np.zeros((2, 3), np.uint8),
                viewpoint_id="viewpoint-1.1",
                range_m=1.0,
                detection=0,
            ),
            EdgeAdded(
                cause=cause,
                edge="sees",
                source="viewpoint-1.1",
                target="object-1",
                attributes={"distance": 1.0},
            ),
        ],
        frame=0,
        sim_time=0.0,
    )
    return graph


def test_grounding_and_navigation_find_the_chair() -> None:
    graph = seen_chair()
    grounding = examples.LabelGrounding(PluginConfig(), context(graph))
    target = TargetGraph("a chair", (TargetNode("chair"),))
    (candidate,) = checks.check_candidates(graph, grounding.ground(target))
    assert (candidate.viewpoint_id, candidate.matching) == ("viewpoint-1.1", {"0": "object-1"})
    assert not grounding.ground(TargetGraph("a lamp", (TargetNode("lamp"),)))

    navigation, now = examples.StraightNavigation(PluginConfig(), context(graph)), frame()
    navigation.start(now, [candidate.viewpoint_id])
    x = y = heading = 0.0
    states = []
    for _ in range(200):
        base = np.eye(4)
        base[:2, :2] = [[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]]
        base[:2, 3] = x, y
        step = checks.check_step(navigation.step(replace(now, world_from_base=base)))
        states.append(step.state)
        if step.outcome:
            break
        heading += 0.2 * step.command.angular
        x += 0.2 * step.command.linear * math.cos(heading)
        y += 0.2 * step.command.linear * math.sin(heading)
    assert step.outcome == "success"
    assert math.hypot(x, y - 2.0) < 0.3
    assert list(dict.fromkeys(states)) == ["turn", "drive", "arrived"]


def test_update_believes_what_was_seen() -> None:
    graph = seen_chair()
    update = examples.BelievingUpdate(PluginConfig(), context(graph))
    result = checks.check_update(update.update(frame(), (), ("object-1", None, "object-1"), "viewpoint-1.1"))
    graph.apply_all(result.changes, frame=1, sim_time=0.2)
    assert graph.objects["object-1"].status == "believed"
    assert not update.update(frame(), (), ("object-1",), None).changes


def test_diagnosis_blames_blind_perception() -> None:
    rule = examples.BlindDiagnosis(PluginConfig(), context(SceneGraph()))
    recording = SimpleNamespace(key_frames=[0, 4, 9], detections=lambda index: ["one"] if index == 0 else [])
    (finding,) = checks.check_findings(rule.diagnose(recording, None))
    assert (finding.layer, finding.frame) == ("detector", 4)
    recording.key_frames = [0]
    assert not rule.diagnose(recording, None)
