"""The report of a run: one self-contained HTML page that says what happened, with pictures and plots."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dssmsg.frame import FloatArray
from dssmsg.graph.changes import Change
from dssmsg.graph.nodes import BELIEVED, ObjectNode
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.recording import palette
from dssmsg.recording.reader import Recording
from dssmsg.review import report_markup as html
from dssmsg.review.report_map import Spot, Trail, floor_map, state_colour
from dssmsg.review.report_markup import Markup, tag
from dssmsg.review.report_pictures import Sight, best_sights, crops, frame_picture, spread
from dssmsg.review.report_plots import Point, lanes, line_plot
from dssmsg.review.summary import summarize

MAX_PICTURES, MAX_OBJECTS, MAX_ROWS, MAX_CANDIDATES = 12, 300, 200, 5
_CHANGES = {
    "object_added": "objects added",
    "object_merged": "merges",
    "object_removed": "objects gone",
    "objects_joined": "objects joined",
    "object_replaced": "objects replaced",
}


@dataclass(slots=True)
class Course:
    """What a run's changes come to, gathered in one pass: the last graph, and figures by frame."""

    graph: SceneGraph
    believed: list[Point]
    tentative: list[Point]
    changes: dict[str, list[Point]]
    sights: dict[str, Sight]
    labels: dict[str, str]
    """The last label of every object that ever was."""


def report_page(recording: Recording, explanations: Mapping[int, str] | None = None) -> str:
    """The page of one recording. `explanations`: what there is to say on an episode, by its number.

    A recording that was cut off is told as far as it can be read. Raises InputError where it is damaged.
    """
    summary = summarize(recording)
    title = f"{summary['name']}: {summary['scene'] or summary['source']}, seed {summary['seed']}"
    parts = run_sections(recording, summary, explanations or {})
    return html.page(title, tag("h1", title), tag("p", summary["recording"], class_="lead"), *parts)


def run_sections(
    recording: Recording, summary: Mapping[str, Any], explanations: Mapping[int, str]
) -> list[Markup]:
    """The parts of the page that tell one run, in order."""
    course = follow(recording.changes())
    trail = trail_of(recording)
    return [
        html.section("What happened", overview(recording, summary)),
        html.section("Episodes", episodes(recording, explanations)),
        html.section("Map", floor_map(course.graph, trail, episode_marks(recording))),
        html.section("On the way", pictures(recording)),
        html.section("Over time", plots(recording, course)),
        html.section("Verdicts on what changed", verdicts(recording, course.labels)),
        html.section("Queries", queries(recording)),
        html.section("Objects", objects(recording, course)),
        html.section("Errors", errors(recording)),
        html.section("How it was run", settings(recording)),
    ]


def follow(changes: Iterable[Change]) -> Course:
    """Fold the changes of a run once."""
    graph = SceneGraph()
    course = Course(graph, [], [], {name: [] for name in _CHANGES.values()}, {}, {})
    status: dict[str, str] = {}
    counts = dict.fromkeys(_CHANGES, 0)
    frame = -1
    held: list[Change] = []

    def passed() -> None:
        believed = sum(one == BELIEVED for one in status.values())
        course.believed.append((frame, believed))
        course.tentative.append((frame, len(status) - believed))
        for kind, count in counts.items():
            course.changes[_CHANGES[kind]].append((frame, count))

    for change in changes:
        if change.frame != frame and frame >= 0:
            passed()
        frame = change.frame
        graph.apply(change)
        held.append(change)
        if change.kind in counts:
            counts[change.kind] += 1
        for name in change.subjects:
            if name in graph.objects:
                status[name] = graph.objects[name].status
                course.labels[name] = graph.objects[name].label
            else:
                status.pop(name, None)
        if len(held) >= 512:  # changes hold clouds of points: few are kept at a time
            _see(course.sights, held)
            held.clear()
    _see(course.sights, held)
    if frame >= 0:
        passed()
    return course


def _see(known: dict[str, Sight], changes: Sequence[Change]) -> None:
    for name, sight in best_sights(changes).items():
        if name not in known or sight.worth > known[name].worth:
            known[name] = sight


def trail_of(recording: Recording) -> Trail:
    """Where the robot was, by visit."""
    trail: dict[int, list[FloatArray]] = {}
    for index in recording.frame_indices:
        trail.setdefault(recording.visit(index), []).append(recording.poses(index)[1][:3, 3])
    return trail


def overview(recording: Recording, summary: Mapping[str, Any]) -> Markup:
    """The run in a dozen lines."""
    whole = "yes" if summary["complete"] else "no: the run was cut off, or is not over"
    states = ", ".join(f"{count} {state}" for state, count in summary.get("states", {}).items())
    rows: list[tuple[str, Any]] = [
        ("run", f"{summary['run_id']}, seed {summary['seed']}"),
        ("where", f"{summary['source']} {summary['scene']}"),
        ("complete", whole),
        *(("", note) for note in summary.get("notes", ())),
        ("frames", f"{summary['frames']} ({summary['key_frames']} key frames)"),
        (
            "objects",
            f"{summary['objects']} believed, {summary['tentative']} tentative" + (states and f"; {states}"),
        ),
        ("topology", f"{summary['waypoints']} waypoints with {summary['viewpoints']} viewpoints"),
        ("changes", ", ".join(f"{name} {count}" for name, count in summary["changes"].items()) or "none"),
    ]
    if "distance_m" in summary:
        rows.append(
            ("way", f"{summary['distance_m']:.1f} m in {summary['sim_seconds']:.0f} s of the robot's time")
        )
    rows.append(("collisions", summary["collisions"]))
    rows.append(("errors", summary["errors"]))
    if summary["seconds"]:
        rows.append(("wall time", f"{_wall(summary['seconds']):.1f} s"))
    if recording.facts.get("parent"):
        rows.append(("replay of", recording.facts["parent"]))
    return html.facts(rows)


def _wall(seconds: Mapping[str, float]) -> float:
    return seconds["total"] if "total" in seconds else sum(seconds.values())


def chip(outcome: Any, reason: Any = "") -> Markup:
    """An outcome as a coloured word; of a failure its reason, where there is one."""
    kind = {"success": "good", "failure": "bad"}.get(str(outcome), "plain")
    return tag("span", html.text(reason or outcome, 60), class_=f"chip {kind}")


def episodes(recording: Recording, explanations: Mapping[int, str]) -> Markup:
    """Every goal with its outcome, and what can be said on why."""
    parts = []
    for row in recording.episodes():
        values = row.get("values", {})
        told = ", ".join(f"{name} {value:g}" for name, value in values.items())
        head = tag("h3", html.joined((chip(row["outcome"]), " ", f"“{row['goal']}”")))
        reason = f"{row['reason']}; " if row["reason"] else ""
        lines = [head, tag("p", f"{reason}ended at frame {row['frame']}. {told}", class_="note")]
        if explanations.get(row["episode"]):
            lines.append(tag("pre", explanations[row["episode"]]))
        parts.append(html.joined(lines))
    return html.joined(parts)


def episode_marks(recording: Recording) -> list[Spot]:
    """Where each episode ended, for the map."""
    known = set(recording.frame_indices)
    return [
        Spot(
            recording.poses(row["frame"])[1][:3, 3],
            f"episode {row['episode']}: {row['outcome']}",
            row["outcome"] == "success",
        )
        for row in recording.episodes()
        if row["frame"] in known
    ]


def pictures(recording: Recording) -> Markup:
    """Frames worth a look: beginnings of phases, ends of episodes, verdicts, errors; else evenly spread."""
    readable = list(recording.readable_frame_indices)
    if not readable:
        return Markup("")
    captions: dict[int, list[str]] = {}
    for phase in recording.phases():
        captions.setdefault(phase["frame"], []).append(f"{phase['phase']}, visit {phase['visit']} begins")
    for row in recording.episodes():
        captions.setdefault(row["frame"], []).append(f"episode {row['episode']} ends: {row['outcome']}")
    decided = [row for row in recording.windows() if row["verdicts"]]
    for row in decided[:4]:
        said = ", ".join(f"{name} {verdict}" for name, verdict in list(row["verdicts"].items())[:3])
        captions.setdefault(row["frame"], []).append(f"{row['viewpoint']}: {said}")
    for row in recording.errors()[:2]:
        captions.setdefault(row["frame"], []).append(f"error of {row['plugin']}")
    known = set(readable)
    chosen = spread(sorted(index for index in captions if index in known), MAX_PICTURES)
    keys = [index for index in recording.key_frames if index in known] or readable
    for index in spread(keys, MAX_PICTURES - len(chosen)):
        if len(chosen) < MAX_PICTURES and index not in chosen:
            chosen.append(index)
    figures = (
        frame_picture(recording, index, "; ".join((f"frame {index}", *captions.get(index, ()))))
        for index in sorted(chosen)
    )
    return tag("div", *(figure for figure in figures if figure is not None), class_="grid")


def plots(recording: Recording, course: Course) -> Markup:
    """Objects, changes, wall time and states over the frames."""
    stages: dict[str, list[Point]] = {}
    for index, seconds in recording.timings().items():
        for stage, value in seconds.items():
            stages.setdefault(stage, []).append((index, 1000.0 * value))
    heavy = sorted(stages, key=lambda name: -sum(y for _, y in stages[name]))[:6]
    last = max(recording.frame_indices, default=0)
    states = {
        "phase": [(row["frame"], str(row["phase"])) for row in recording.phases()],
        "driver": [(row["frame"], str(row["state"])) for row in recording.navigation()],
    }
    colours = {name: f"#{r:02x}{g:02x}{b:02x}" for name, (r, g, b) in palette.STATE_COLOURS.items()}
    drawn = [
        line_plot("Objects of the map", {"believed": course.believed, "tentative": course.tentative}),
        line_plot(
            "Changes so far", {name: line for name, line in course.changes.items() if line and line[-1][1]}
        ),
        line_plot("Wall time a frame", {name: stages[name] for name in heavy}, unit="ms"),
        lanes("What the robot was doing", states, last, colours),
    ]
    return tag("div", *drawn, class_="plots") if any(drawn) else Markup("")


def verdicts(recording: Recording, labels: Mapping[str, str]) -> Markup:
    """What the viewpoints' windows decided."""
    rows = [
        (
            row["frame"],
            row["viewpoint"],
            name,
            html.text(labels.get(name, ""), 80),
            verdict,
            ", ".join(map(str, row["base"])),
        )
        for row in recording.windows()
        for name, verdict in row["verdicts"].items()
    ]
    if not rows:
        return Markup("")
    head = ("frame", "viewpoint", "object", "label", "verdict", "base frames")
    return html.joined((html.table(head, rows[:MAX_ROWS], numbers=("frame",)), _left_out(rows)))


def queries(recording: Recording) -> Markup:
    """Each grounded query with its best candidates, their scores and reasons."""
    parts = []
    for row in recording.matches()[:MAX_ROWS]:
        candidates = row["candidates"][:MAX_CANDIDATES]
        names = list(dict.fromkeys(name for one in candidates for name in one["scores"]))
        parts.append(tag("h3", f"“{row['query']}”"))
        if not candidates:
            parts.append(tag("p", "nothing in the map matches", class_="note"))
            continue
        lines = (
            (one["rank"], one["viewpoint"], *(_number(one["scores"].get(name)) for name in names))
            for one in candidates
        )
        parts.append(html.table(("rank", "viewpoint", *names), lines, numbers=("rank", *names)))
        why = [tag("li", f"{one['viewpoint']}: {one.get('reason', '')}") for one in candidates]
        parts.append(html.folded("why these", tag("ol", *why)))
    return html.joined(parts)


def objects(recording: Recording, course: Course) -> Markup:
    """Every object of the last graph: believed ones first, each with a picture where there is one."""
    nodes = sorted(
        course.graph.objects.values(), key=lambda node: (node.status != BELIEVED, _number_of(node.id))
    )
    shown = nodes[:MAX_OBJECTS]
    seen = {node.id: course.sights[node.id] for node in shown if node.id in course.sights}
    images = crops(recording, seen)
    rows = [
        (
            images.get(node.id, ""),
            node.id,
            html.text(node.label, 80),
            node.status if node.status != BELIEVED else _state(node),
            _number(node.dynamic_attribute),
            node.observations,
            ", ".join(f"{part:.2f}" for part in node.center),
            " x ".join(f"{part:.2f}" for part in node.box_max - node.box_min),
            f"{node.first_seen:.0f} to {node.last_seen:.0f}",
        )
        for node in shown
    ]
    if not rows:
        return Markup("")
    head = ("", "object", "label", "state", "d_a", "seen", "centre, m", "size, m", "time, s")
    return html.joined((html.table(head, rows, numbers=("d_a", "seen")), _left_out(nodes, MAX_OBJECTS)))


def _state(node: ObjectNode) -> Markup:
    return tag(
        "span", html.text(node.state, 40), class_="chip", style=f"background:{state_colour(node.state)}"
    )


def _number_of(name: str) -> tuple[int, str]:
    """Sorts object-2 before object-10."""
    digits = name.rpartition("-")[2]
    return (int(digits) if digits.isdecimal() and len(digits) < 18 else -1, name)


def errors(recording: Recording) -> Markup:
    """What failed or was skipped."""
    rows = [
        (row["frame"], row["plugin"], html.text(row["message"], 600), row["skipped"])
        for row in recording.errors()
    ]
    if not rows:
        return Markup("")
    table = html.table(("frame", "plug-in", "message", "skipped"), rows[:MAX_ROWS], numbers=("frame",))
    return html.joined((table, _left_out(rows)))


def settings(recording: Recording) -> Markup:
    """Plug-ins, versions, credits and the configuration."""
    facts = recording.facts
    plugins = [
        (key, made.get("name", ""), made.get("version", ""), made.get("origin", ""))
        for key, made in facts["plugins"].items()
    ]
    asked = [
        (row["frame"], row["role"], row["provider"], "yes" if row["ok"] else f"no: {row['error']}",
         html.text(row["prompt"][-400:], 400), html.text(row["answer"], 400))
        for row in recording.llm_calls()
    ]  # fmt: skip
    parts: list[Any] = [html.table(("slot", "plug-in", "version", "from"), plugins)]
    if asked:
        table = html.table(
            ("frame", "role", "provider", "answered", "end of the prompt", "answer"), asked[:MAX_ROWS]
        )
        parts.append(html.folded(f"{len(asked)} calls of the language model", table, _left_out(asked)))
    versions = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
    parts.append(html.folded("versions", tag("p", versions)))
    if facts["source"].get("credits"):
        parts.append(html.folded("credits", tag("pre", "\n".join(map(str, facts["source"]["credits"])))))
    parts.append(
        html.folded("configuration", tag("pre", json.dumps(facts["config"], indent=2, ensure_ascii=False)))
    )
    return html.joined(parts)


def _left_out(rows: Sequence[Any], limit: int = MAX_ROWS) -> Markup:
    if len(rows) <= limit:
        return Markup("")
    return tag("p", f"... and {len(rows) - limit} more", class_="note")


def _number(value: Any) -> str:
    if not isinstance(value, int | float) or not np.isfinite(value):
        return ""
    return f"{value:.3f}".rstrip("0").rstrip(".")
