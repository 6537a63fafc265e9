"""grounding/dssm: target graph against the local subgraph of every viewpoint (paper III-C, ALGORITHM D).

    s_graph = s_node + s_top                                          the paper's, eq. 3-5
    score   = s_graph + core_weight * s_core + relation_weight * s_relation
              + attribute_weight * s_attribute + view_weight * s_view

The last four go beyond the paper and ask about the one object that is taken for the core target: is it the
best match of the map, do the named relations hold for it, does it look as described, is it seen well from
here. With all four weights 0 the paper's formula is left, and the core is matched like any other node. Where
a sentence only names a need, relations to things that it does not name are guesses of the language model:
they are left to s_top, and count `guessed` times in s_relation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dssmsg.errors import ConfigError
from dssmsg.events import Candidate
from dssmsg.frame import FloatArray, MaskArray
from dssmsg.graph.attribute_check import attribute_score
from dssmsg.graph.ids import id_order
from dssmsg.graph.matching import UNMATCHED, TopologyMatch, match_topology, node_score
from dssmsg.graph.relation_check import RelationCheck
from dssmsg.graph.relations import gap
from dssmsg.graph.subgraph import (
    FORMER,
    LAST,
    NOW,
    Subgraph,
    Thing,
    features_of,
    local_subgraphs,
    pixels_of,
    things_of,
)  # fmt: skip
from dssmsg.graph.target_tree import TargetTree, Witnesses, target_degrees
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.grounding import TargetGraph

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

_NEVER_LEFT = 0.8
"""Factor on the similarity of what is where it always was, where a sentence asks for the past."""

PAST = frozenset({"past", "before", "former", "formerly", "previous", "previously", "earlier"})
"""Attributes of a node that ask where it was, not where it is."""
_CLEAR_PIXELS = 600.0
"""From this many pixels on a thing is seen well, three times what counts as visible at all."""


class Config(PluginConfig):
    """Options of `grounding: {use: dssm}`."""

    share: float = Field(
        0.8, ge=0, le=1, description="A node may match where its cosine is this share of its best in the map."
    )
    unmatched: Literal["zero", "drop"] = Field(
        "zero", description="A target node without a match: degree 0 in eq. 4, or left out of it."
    )
    core_weight: float = Field(1.0, ge=0, description="Weight of how well the core target itself matches.")
    relation_weight: float = Field(1.0, ge=0, description="Weight of named relations held against geometry.")
    guessed: float = Field(
        0.0,
        ge=0,
        le=1,
        description="How much a relation counts in s_relation where company of a need is only guessed.",
    )
    attribute_weight: float = Field(0.5, ge=0, description="Weight of colours and sizes of the core target.")
    view_weight: float = Field(0.3, ge=0, description="Weight of how large the core target is in the image.")
    vanished: float = Field(
        0.9, ge=0, le=1, description="Factor on the similarity of objects that are gone; 0 leaves them out."
    )
    other_name: float = Field(
        0.7, ge=0, le=1, description="Factor on s_core of a synonym where a thing of the very name exists."
    )
    tentative: bool = Field(False, description="Whether objects that are not yet believed count too.")
    named: bool = Field(
        True, description="Whether one not yet believed counts where nothing else has the name asked for."
    )

    @property
    def is_paper(self) -> bool:
        """Whether the paper's formula alone ranks."""
        return not (self.core_weight or self.relation_weight or self.attribute_weight or self.view_weight)


@dataclass(frozen=True, slots=True, eq=False)
class _Query:
    """One target graph against the whole map. similarity, allowed (T, N) over all things.

    `rows` are the target nodes (R,) that s_node and s_top ask for, all but those of "without ..."; `degrees`
    (R,) theirs. For each thing (N,) taken for the core target: `core`, `relation`, `attribute` scores 0..1.
    """

    target: TargetGraph
    things: Sequence[Thing]
    rows: NDArray[np.int64]
    degrees: NDArray[np.int64]
    similarity: FloatArray
    allowed: MaskArray
    core: FloatArray
    relation: FloatArray
    attribute: FloatArray
    witnesses: Mapping[int, Mapping[int, int]]


@dataclass(frozen=True, slots=True, eq=False)
class _Scored:
    """The best answer of one viewpoint."""

    subgraph: Subgraph
    scores: dict[str, float]
    match: TopologyMatch
    core: int
    distance: float


class DssmGrounding:
    """Ranks viewpoints for a target graph."""

    def __init__(self, config: Config, context: Context) -> None:
        if context.encoder is None:
            raise ConfigError("grounding needs an encoder for the labels of the goal", key="encoder.use")
        self._config = config
        self._encoder = context.encoder
        self._graph = context.graph
        self._camera = None if context.source is None else context.source.camera

    def ground(self, target: TargetGraph) -> Sequence[Candidate]:
        """All viewpoints that see an object, or saw one that is gone, best first.

        `scores` holds every term of the module's formula, `matching` target node -> object or former place.
        """
        if not target.nodes:
            return ()
        things = self._things(target)
        if not things:
            return ()
        query = self._query(target, things)
        found = [self._scored(query, subgraph) for subgraph in local_subgraphs(self._graph, things)]
        found.sort(
            key=lambda one: (
                -round(one.scores["score"], 9),
                -round(one.scores["similarity"], 6),
                one.distance,
                id_order(one.subgraph.viewpoint_id),
            )
        )
        return tuple(self._candidate(query, one, rank) for rank, one in enumerate(found, 1))

    def _things(self, target: TargetGraph) -> Sequence[Thing]:
        """What may be matched. Who names a thing means one that was seen once rather than another of kin."""
        vanished, former = self._config.vanished > 0, _asks_past(target)
        things = things_of(self._graph, tentative=self._config.tentative, vanished=vanished, former=former)
        name = target.nodes[target.core].label.lower()
        asked = self._config.named and not self._config.is_paper and target.kind == "explicit"
        if not asked or any(thing.label.lower() == name for thing in things):
            return things
        known = {thing.id for thing in things}
        return [
            thing
            for thing in things_of(self._graph, tentative=True, vanished=vanished, former=former)
            if thing.id in known or (thing.when == NOW and thing.label.lower() == name)
        ]

    def _query(self, target: TargetGraph, things: Sequence[Thing]) -> _Query:
        wanted = self._encoder.encode_labels([node.label for node in target.nodes]).astype(np.float64)
        features = features_of(things, self._encoder.encode_labels([thing.label for thing in things]))
        # einsum adds in a fixed order; the order of BLAS depends on threads and processor.
        similarity = np.einsum("id,jd->ij", wanted, features)
        factors = {NOW: 1.0, LAST: self._config.vanished, FORMER: 0.0}
        similarity = similarity * np.array([factors[thing.when] for thing in things])
        past = _past_nodes(target)
        if past:
            own = np.einsum("id,jd->ij", wanted[past], features)
            # Who asks where a thing was means its former place, if it has one, else the last place of one
            # that is gone, and where it is now only if it never left.
            before = {FORMER: 1.0, LAST: self._config.vanished, NOW: _NEVER_LEFT}
            similarity[past] = own * np.array([before[thing.when] for thing in things])
        best = similarity.max(axis=1, keepdims=True)
        allowed = (similarity >= self._config.share * best) & (similarity > 0)
        relative = np.where(allowed, similarity / np.where(best > 0, best, 1.0), 0.0)
        relation, witnesses = np.zeros(len(things)), {}
        attribute = np.zeros(len(things))
        edges, unwanted = [(e.source, e.target, e.relation) for e in target.edges], frozenset[int]()
        if not self._config.is_paper:
            relative *= _own_names(target, things, self._config.other_name)
            looks = _looks(target, things, allowed)
            attribute = looks[target.core]
            tree = TargetTree(edges, target.core, _sureness(target, self._config.guessed))
            unwanted = tree.unwanted()
            search = Witnesses(tree, relative * looks, RelationCheck(self._graph, things).holds)
            for one in np.flatnonzero(allowed[target.core]).tolist() if tree.links else ():
                answer = search.of(one)
                relation[one], witnesses[one] = answer.score, answer.witnesses
        rows = np.array([row for row in range(len(target.nodes)) if row not in unwanted])
        wanted_edges = [(a, b) for a, b, _word in edges if not unwanted & {a, b}]
        degrees = target_degrees(len(target.nodes), wanted_edges)[rows]
        return _Query(
            target, things, rows, degrees, similarity, allowed,
            relative[target.core], relation, attribute, witnesses,
        )  # fmt: skip

    def _scored(self, query: _Query, subgraph: Subgraph) -> _Scored:
        """The best answer within one viewpoint, over the objects that may be the core target."""
        pairs = np.ix_(query.rows, subgraph.things)
        similarity, allowed = query.similarity[pairs], query.allowed[pairs]
        core = int(np.flatnonzero(query.rows == query.target.core)[0])
        s_node = node_score(similarity)
        unlimited = self._config.is_paper or not allowed[core].any()
        best: _Scored | None = None
        for place, terms, extra in (
            [(UNMATCHED, {}, 0.0)] if unlimited else self._cores(query, subgraph, allowed[core])
        ):
            # s_top is at most 1: what cannot reach the best any more needs no matching.
            if best is not None and s_node + 1.0 + extra < best.scores["score"]:
                break
            held = allowed if place == UNMATCHED else _with_core(allowed, core, place)
            match = match_topology(
                query.degrees, subgraph.degrees, held, similarity, unmatched=self._config.unmatched
            )
            s_graph = s_node + match.score
            scores = {
                "score": s_graph + extra, "s_graph": s_graph, "s_node": s_node, "s_top": match.score,
                "similarity": match.similarity,
                **terms,
            }  # fmt: skip
            chosen = int(match.columns[core])
            one = _Scored(subgraph, scores, match, chosen, self._distance(query, subgraph, chosen))
            if best is None or (scores["score"], match.similarity) > (
                best.scores["score"], best.match.similarity,
            ):  # fmt: skip
                best = one
        assert best is not None
        return best

    def _weights(self) -> dict[str, float]:
        """The terms that are asked for, with their weights."""
        own = self._config
        weights = {
            "s_core": own.core_weight,
            "s_relation": own.relation_weight,
            "s_attribute": own.attribute_weight,
            "s_view": own.view_weight,
        }
        return {name: weight for name, weight in weights.items() if weight}

    def _cores(
        self, query: _Query, subgraph: Subgraph, allowed: MaskArray
    ) -> list[tuple[int, dict[str, float], float]]:
        """Places of the things that may be the core, with their terms and the weighted sum, largest first."""
        weights = self._weights()
        found = []
        for place in np.flatnonzero(allowed).tolist():
            one = int(subgraph.things[place])
            seen = self._seen(query.things[one], subgraph.viewpoint_id)
            terms = {
                "s_core": float(query.core[one]), "s_relation": float(query.relation[one]),
                "s_attribute": float(query.attribute[one]), "s_view": seen,
            }  # fmt: skip
            asked = {name: terms[name] for name in weights}
            found.append((place, asked, sum(weights[name] * term for name, term in asked.items())))
        return sorted(found, key=lambda entry: (-entry[2], entry[0]))

    def _seen(self, thing: Thing, viewpoint_id: str) -> float:
        """0..1: how large a thing is in the image of a viewpoint; 0 where the camera is not known."""
        if self._camera is None or not self._config.view_weight:
            return 0.0
        pixels = pixels_of(thing, self._graph.viewpoints[viewpoint_id], self._camera)
        return min(1.0, pixels / _CLEAR_PIXELS)

    def _distance(self, query: _Query, subgraph: Subgraph, place: int) -> float:
        """Metres from the camera to the box of what is taken for the core target; infinite without one."""
        if place == UNMATCHED:
            return float("inf")
        thing = query.things[int(subgraph.things[place])]
        eye = self._graph.viewpoints[subgraph.viewpoint_id].world_from_camera[:3, 3]
        return gap(eye, eye, thing.box_min, thing.box_max)

    def _candidate(self, query: _Query, one: _Scored, rank: int) -> Candidate:
        matching, words = {}, []
        for row, place in zip(query.rows.tolist(), one.match.columns.tolist(), strict=True):
            node = query.target.nodes[row]
            if place == UNMATCHED:
                words.append(f"{node.label}: none")
                continue
            index = int(one.subgraph.things[place])
            thing = query.things[index]
            matching[str(row)] = thing.id
            where = {NOW: "", LAST: ", gone, its last place", FORMER: ", its former place"}[thing.when]
            cosine = query.similarity[row, index]
            words.append(f"{node.label}: {thing.label} ({thing.id}{where}) {cosine:.2f}")
        if one.core != UNMATCHED:
            words += _relations(query, int(one.subgraph.things[one.core]))
            one.scores["core_distance"] = one.distance
        return Candidate(one.subgraph.viewpoint_id, rank, one.scores, matching, "; ".join(words))


def _sureness(target: TargetGraph, guessed: float) -> list[float]:
    """How much each edge counts: 1 where the sentence names things, or both ends; else it is guessed."""
    said = {word.strip(".,;:?!'\"").lower() for word in target.text.split()}
    said |= {word.removesuffix("s") for word in said}
    named = [
        row == target.core or said.issuperset(node.label.lower().split())
        for row, node in enumerate(target.nodes)
    ]
    return [
        1.0 if target.kind != "implicit" or (named[edge.source] and named[edge.target]) else guessed
        for edge in target.edges
    ]


def _own_names(target: TargetGraph, things: Sequence[Thing], other: float) -> FloatArray:
    """(T, N) 1 where a thing has the very name of a target node, or nothing has it; else `other`.

    To the encoder synonyms are the same word. Who says "sink" may mean the washbasin, but rather the sink.
    """
    labels = np.array([thing.label.lower() for thing in things])
    same = np.array([labels == node.label.lower() for node in target.nodes])
    return np.where(same | ~same.any(axis=1, keepdims=True), 1.0, other)


def _with_core(allowed: MaskArray, core: int, place: int) -> MaskArray:
    """The pairs (T, N) that are left where the core target is the thing at a place."""
    held = allowed.copy()
    held[core] = False
    held[:, place] = False
    held[core, place] = True
    return held


def _looks(target: TargetGraph, things: Sequence[Thing], allowed: MaskArray) -> FloatArray:
    """(T, N) how well each allowed thing looks as each target node is described; 1 where nothing is said."""
    looks = np.ones(allowed.shape)
    for row, node in enumerate(target.nodes):
        if not node.attributes:
            continue
        columns = np.flatnonzero(allowed[row]).tolist()
        likes = [things[column] for column in columns]
        for column in columns:
            score = attribute_score(node.attributes, things[column], likes)
            looks[row, column] = 1.0 if score is None else score
    return looks


def _relations(query: _Query, core: int) -> list[str]:
    """What was found for each named relation, for the reason of a candidate."""
    found = query.witnesses.get(core, {})
    return [
        f"{edge.relation} {query.target.nodes[other].label}: {query.things[found[other]].id}"
        for edge in query.target.edges
        for other in {edge.source, edge.target} - {query.target.core}
        if query.target.core in (edge.source, edge.target) and other in found
    ]


def _past_nodes(target: TargetGraph) -> list[int]:
    return [row for row, node in enumerate(target.nodes) if PAST & {word.lower() for word in node.attributes}]


def _asks_past(target: TargetGraph) -> bool:
    return bool(_past_nodes(target))


@hookimpl
def register_grounding(register: Register) -> None:
    """`dssm`: target graph against local subgraphs."""
    register("dssm", DssmGrounding, config=Config)
