"""Table IV: sentences answered with ranked viewpoints, recall at 1, 2 and 3 (paper IV-C).

Every scene, seed and perception is recorded once; all methods are asked on the same graph: `static` as it
stood at the end of the survey, `changed` at the end of the revisit. An answer is right where its viewpoint
truly showed a target (`ViewpointTruth`); ranks count distinct waypoints, each by the first of its viewpoints.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dssmsg import checks
from dssmsg.config import RunConfig, Slot, load_config
from dssmsg.contexts import ContextFactory
from dssmsg.errors import ConfigError, PluginError
from dssmsg.evaluate.missions import recorded_mission
from dssmsg.evaluate.queries import GENERATED, KINDS, SETS, Query, generated_queries, load_queries
from dssmsg.evaluate.viewpoint_truth import ViewpointTruth
from dssmsg.events import Candidate
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.read_only import ReadOnlyGraph
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.graph.view import GraphView
from dssmsg.host import Host
from dssmsg.interfaces import SourceInfo, TargetGraph
from dssmsg.mission.goal import TARGET_GRAPH_SCHEMA, target_graph_request
from dssmsg.recording.reader import Recording
from dssmsg.target_graph import parse_target_graph

TABLE = "table4"
WHEN = ("static", "changed")
RANKS = (1, 2, 3)
CHANCE = "chance"
METHODS: Mapping[str, Mapping[str, Any]] = {
    "dssm": {"use": "dssm"},
    "dssm_paper": {
        "use": "dssm", "core_weight": 0, "relation_weight": 0, "attribute_weight": 0, "view_weight": 0,
    },
    "image": {"use": "image"},
    "objects": {"use": "objects"},
    "objects_core": {"use": "objects", "query": "core"},
    "configured": {},
}  # fmt: skip
"""What each row of the table is: `dssm_paper` is the paper's formula alone, `objects_core` the baseline that
gets the language model's reading of the sentence, too, `configured` the slot `grounding`. The options of
that slot hold for every row of its plug-in."""


@dataclass(frozen=True, slots=True)
class Answer:
    """One query put to one method: `rank` of the first right waypoint, from 1, or None.

    `chance` is the probability of a right one among the first 1, 2, 3 drawn at random. `said` tells what came
    first, and why; `parse` the target graph, or why there is none.
    """

    scene: str
    perception: str
    seed: int
    when: str
    method: str
    query: Query
    rank: int | None
    chance: tuple[float, ...]
    said: str
    parse: str


def evaluate_table4(
    work: Path,
    *,
    scenes: Sequence[str],
    perceptions: Sequence[str],
    methods: Sequence[str],
    seeds: Sequence[int],
    when: Sequence[str] = WHEN,
    generated: int = 0,
    config: Path | None = None,
    sets: Sequence[str] = (),
    progress: Callable[[str], None] = lambda _line: None,
) -> list[Answer]:
    """Every query put to every method. Recordings stay in `work` and are not made again.

    `generated` more sentences are made of the truth of each graph. Queries whose targets no viewpoint of the
    recording ever showed cannot be answered and are left out. Raises ConfigError for unknown names.
    """
    for name in methods:
        if name not in METHODS:
            raise ConfigError(f"expected methods of {', '.join(METHODS)}, got {name!r}", key="--methods")
    queries = {scene: load_queries(scene) for scene in scenes}
    answers: list[Answer] = []
    for seed in seeds:
        for scene in scenes:
            for perception in perceptions:
                # Long enough for both scenes; whoever knows better says so with --set.
                own = (
                    "mission.max_frames=3000",
                    *sets,
                    f"source.scene={scene}",
                    f"perception.use={perception}",
                )
                resolved = load_config(config, sets=own, seed=seed)
                host = Host.load(resolved.plugins, resolved.base_dir)
                with resolved.naming_files():
                    host.check(resolved)
                name = f"{scene}-{perception}-{seed}"
                path, made = recorded_mission(work, name, resolved, host)
                progress(f"{name}: {'recorded' if made else 'kept'} {path.name}")
                with Recording.open(path) as recording:
                    asker = _Asker(resolved, host, recording)
                    for state in when:
                        answers += asker.ask(
                            (scene, perception, seed, state), queries[scene], methods, generated
                        )
    return answers


class _Asker:
    """Puts queries to methods on the graphs of one recording."""

    def __init__(self, config: RunConfig, host: Host, recording: Recording) -> None:
        self._config = config
        self._host = host
        self._recording = recording
        self._truth = ViewpointTruth(recording)
        camera = recording.camera()
        assert camera is not None  # the truth was read off its frames
        info = SourceInfo("recording", camera, drivable=False, has_truth=False)
        self._contexts = ContextFactory(
            host, config.seed, SceneGraph(), IdAllocator(), config.base_dir, Path(), "eval", source=info
        )
        with config.naming_files():
            self._contexts.encoder = self._build("encoder", config.encoder)
            self._contexts.llm = self._build("llm", config.llm)
        self._targets: dict[str, TargetGraph | str] = {}

    def ask(
        self,
        where: tuple[str, str, int, str],
        queries: Sequence[Query],
        methods: Sequence[str],
        generated: int,
    ) -> Iterator[Answer]:
        """All answers in one state of the graph."""
        scene, perception, seed, state = where
        frame = self._frame(state)
        graph = self._recording.graph_at(frame)
        self._contexts.graph = ReadOnlyGraph(graph)
        plugins = {name: self._build("grounding", slot_of(self._config, name)) for name in methods}
        gone = self._truth.gone(frame)
        here = [known for name, known in self._truth.objects(frame).items() if name not in gone]
        for query in (*queries, *generated_queries(here, generated, seed)):
            right = self._truth.showing(query.targets, frame) & graph.viewpoints.keys()
            if not right:
                continue
            chance = tuple(chance_level(graph, right, count) for count in RANKS)
            target = self._target(query.text)
            for name, plugin in plugins.items():
                # What compares the sentence itself does not need it understood.
                asked = TargetGraph(query.text, ()) if isinstance(target, str) else target
                ranked = by_waypoint(graph, checks.check_candidates(graph, plugin.ground(asked)))
                rank = next((place for place, one in enumerate(ranked, 1) if one.viewpoint_id in right), None)
                said = f"{ranked[0].viewpoint_id}: {ranked[0].reason}" if ranked else "nothing"
                yield Answer(
                    scene, perception, seed, state, name, query, rank, chance, said, describe(target)
                )

    def _frame(self, state: str) -> int:
        """The last frame of the survey, or of all."""
        frames = self._recording.frame_indices
        later = [phase["frame"] for phase in self._recording.phases() if phase["phase"] == "revisit"]
        if state == "static" and later:
            return max(index for index in frames if index < later[0])
        return frames[-1]

    def _target(self, text: str) -> TargetGraph | str:
        """The target graph of a sentence, asked for once; why there is none where the model has none."""
        if text not in self._targets:
            llm = self._contexts.llm
            assert llm is not None
            try:
                answer = llm.complete("target_graph", target_graph_request(text), TARGET_GRAPH_SCHEMA)
                self._targets[text] = parse_target_graph(text, answer.value)
            except (PluginError, ValueError) as error:
                self._targets[text] = str(error)
        return self._targets[text]

    def _build(self, kind: str, slot: Slot) -> Any:
        built = self._host.build(kind, slot, self._contexts, base_dir=self._config.base_dir, key=kind)
        return built.plugin


def slot_of(config: RunConfig, method: str) -> Slot:
    """The plug-in and options of a method: its own, over the configured ones of the same plug-in."""
    own = METHODS[method]
    asked = config.grounding.flat()
    return Slot.model_validate({**asked, **own} if own.get("use", asked["use"]) == asked["use"] else own)


def by_waypoint(graph: GraphView, candidates: Iterable[Candidate]) -> list[Candidate]:
    """The first candidate of each waypoint, in order."""
    first: dict[str, Candidate] = {}
    for candidate in candidates:
        first.setdefault(graph.viewpoints[candidate.viewpoint_id].waypoint_id, candidate)
    return list(first.values())


def chance_level(graph: GraphView, right: frozenset[str], count: int) -> float:
    """Probability of a right viewpoint among one of each of `count` different waypoints, all at random."""
    views: dict[str, list[bool]] = {}
    for name, viewpoint in graph.viewpoints.items():
        views.setdefault(viewpoint.waypoint_id, []).append(name in right)
    count = min(count, len(views))
    # Elementary symmetric sums of the shares of wrong viewpoints: all draws of k waypoints that miss.
    missing = np.zeros(count + 1)
    missing[0] = 1.0
    for hits in views.values():
        missing[1:] += missing[:-1] * (1.0 - sum(hits) / len(hits))
    return float(1.0 - missing[count] / math.comb(len(views), count))


def describe(target: TargetGraph | str) -> str:
    """A target graph in a line."""
    if isinstance(target, str):
        return f"no target graph: {target}"
    nodes = [" ".join((*node.attributes, node.label)) for node in target.nodes]
    edges = [f"{nodes[edge.source]} {edge.relation} {nodes[edge.target]}" for edge in target.edges]
    return f"{nodes[target.core]} [{'; '.join(edges) or ', '.join(nodes)}]"


def table4_rows(answers: Sequence[Answer]) -> list[dict[str, Any]]:
    """Rows of the table: `<when>_<kind>_R@k` over all queries, `<when>_<kind>_<set>_R@k` a set.

    Means over queries, then over seeds; `std` is that of the sample of seeds (0 for one), `n` counts answers.
    The scene `all` is every query of every scene; the method `chance` is drawing at random.
    """
    rows: list[dict[str, Any]] = []
    scenes = list(dict.fromkeys(answer.scene for answer in answers))
    for scene in (*scenes, *(["all"] if len(scenes) > 1 else [])):
        for perception in dict.fromkeys(answer.perception for answer in answers):
            for state in dict.fromkeys(answer.when for answer in answers):
                members = [
                    one for one in answers
                    if scene in (one.scene, "all") and (one.perception, one.when) == (perception, state)
                ]  # fmt: skip
                for name, chosen in _groups(members):
                    rows += _method_rows(chosen, f"{state}_{name}", scene, perception)
    return rows


def _groups(answers: Sequence[Answer]) -> Iterator[tuple[str, list[Answer]]]:
    """By kind, and by kind and set; generated sentences stand for themselves."""
    for kind in KINDS:
        written = [one for one in answers if one.query.kind == kind and one.query.set != GENERATED]
        if written:
            yield kind, written
        for name in SETS:
            chosen = [one for one in written if one.query.set == name]
            if chosen:
                yield f"{kind}_{name}", chosen
    made = [one for one in answers if one.query.set == GENERATED]
    if made:
        yield GENERATED, made


def _method_rows(
    answers: Sequence[Answer], prefix: str, scene: str, perception: str
) -> Iterator[dict[str, Any]]:
    methods = list(dict.fromkeys(one.method for one in answers))
    for method in (*methods, CHANCE):
        members = [one for one in answers if one.method == (methods[0] if method == CHANCE else method)]
        for place, k in enumerate(RANKS):
            seeds: dict[int, list[float]] = {}
            for one in members:
                hit = one.chance[place] if method == CHANCE else float(one.rank is not None and one.rank <= k)
                seeds.setdefault(one.seed, []).append(hit)
            means = np.array([np.mean(hits) for hits in seeds.values()])
            yield {
                "table": TABLE, "scene": scene, "method": method, "perception": perception,
                "metric": f"{prefix}_R@{k}", "mean": float(means.mean()),
                "std": float(means.std(ddof=1)) if len(means) > 1 else 0.0, "n": len(members),
            }  # fmt: skip
