"""association/dssm: the paper's object association (III-A), ALGORITHM A.2 and A.3.

One step, one method: candidates by spatial index, score every pair, assign one-to-one, turn the
assignment into changes, now and then join what was split, and say which objects are believed. The scores
themselves are in `dssmsg.graph.scoring`, the merge pass is in `dssmsg.graph.joining`.

Of its own it keeps which objects were touched since the last merge pass, and the frames' votes on what
belongs to an object (`dssmsg.graph.extent`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.frame import Frame, Observation
from dssmsg.graph.candidates import CandidateRule, Candidates, Pair
from dssmsg.graph.changes import (
    Cause,
    Change,
    ObjectAdded,
    ObjectChanged,
    ObjectMerged,
    ObjectReplaced,
    ObjectsJoined,
    Score,
)
from dssmsg.graph.extent import Extents, outgrows
from dssmsg.graph.fusion import appended, counted
from dssmsg.graph.ids import id_order
from dssmsg.graph.joining import Join, aligned_pieces, contained_pieces, fragments
from dssmsg.graph.nodes import BELIEVED, ObjectNode
from dssmsg.graph.observed import added, merged
from dssmsg.graph.scoring import (
    assign,
    confidence,
    neighbour_tolerance,
)
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "association/dssm"


class DssmConfig(PluginConfig):
    """Thresholds of the association; symbols as in the paper where it names them."""

    delta_sim: float = Field(
        1.1, ge=0, le=2, description="delta_sim: below this s = s_geo + s_sem (0..2) it is a new object."
    )
    paper_exact: bool = Field(
        False,
        description="The paper's literal rule: s alone decides; no `merge_min_` pair, no joins by fit.",
    )
    merge_min_semantic: float = Field(
        0.9, ge=0, le=1, description="A merge needs this s_sem, or else `merge_min_overlap`."
    )
    merge_min_overlap: float = Field(
        0.5,
        ge=0,
        le=1,
        description="A merge of unlike labels needs this share of either's points on the other.",
    )
    unnamed_labels: tuple[str, ...] = Field(
        ("object",), description="Labels of class-agnostic perceptions: they say nothing, s_sem is 0.5."
    )
    delta_conf: float = Field(
        0.75,
        ge=0,
        le=1,
        description="delta_conf: believed from 1 - 2^-(votes/min_votes + views/min_views) on.",
    )
    min_votes: float = Field(2.0, gt=0, description="Summed scores of the label that halve the doubt once.")
    min_views: float = Field(2.0, gt=0, description="Distinct viewpoints that halve the doubt once.")
    grow_min_score: float = Field(
        0.5, ge=0, le=1, description="A detection below this score adds no points to a believed object."
    )
    extent_share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="A point in fewer of the masks that should hold it is cut off; 0: all are kept.",
    )
    merge_every: int = Field(20, ge=1, description="Key frames between two passes that join split objects.")
    max_free_share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="No merge where this share of the object in view is shown free: it moved.",
    )
    join_containment: float = Field(
        0.5, ge=0, le=1, description="Share of the smaller object's points on the larger that joins the two."
    )
    join_tolerance: float = Field(
        0.05, gt=0, description="Metres within which a point is on the other object, in the merge pass."
    )
    join_fragment: float = Field(
        0.9, gt=0, le=1, description="Share of a doubtful object in a believed one that makes it part of it."
    )
    join_gap: float = Field(
        0.35, ge=0, description="At a visit's end aligned pieces this far apart join, metres; 0 turns it off."
    )
    join_gap_share: float = Field(
        0.25, ge=0, le=1, description="Largest such gap as a share of the joint length along it."
    )
    sample: int = Field(
        512, ge=64, description="Points of a cloud asked for neighbours first; all where a threshold is near."
    )


@dataclass(frozen=True, slots=True)
class _Standing:
    """What speaks for an object: votes label -> summed score, viewpoints; and whether it is believed."""

    votes: Mapping[str, float]
    viewpoints: tuple[str, ...]
    believed: bool

    def plus(self, other: _Standing) -> _Standing:
        """Both together, as one object."""
        return _Standing(
            counted(self.votes, other.votes),
            appended(self.viewpoints, other.viewpoints),
            self.believed or other.believed,
        )


class DssmAssociation:
    """Brings the observations of key frames into the graph."""

    def __init__(self, config: DssmConfig, context: Context) -> None:
        self._config = config
        self._graph = context.graph
        self._ids = context.ids
        self._noise = (0.0, 0.0) if context.source is None else context.source.depth_noise_m
        self._unnamed = frozenset(config.unnamed_labels)
        rule = CandidateRule(
            delta_sim=config.delta_sim,
            paper_exact=config.paper_exact,
            merge_min_semantic=config.merge_min_semantic,
            merge_min_overlap=config.merge_min_overlap,
            max_free_share=config.max_free_share,
            unnamed_labels=self._unnamed,
            sample=config.sample,
        )
        self._candidates = Candidates(context.graph, rule, self._noise)
        self._key_frames = 0
        keeps_all = config.paper_exact or config.extent_share == 0.0
        self._extents = None if keeps_all else Extents(config.extent_share)
        self._touched: set[str] = set()
        self._visited: set[str] = set()

    def associate(
        self, frame: Frame, observations: Sequence[Observation], viewpoint_id: str | None
    ) -> Sequence[Change]:
        """Joins if a pass is due, one `ObjectAdded` or `ObjectMerged` an observation, then beliefs."""
        scored = self._candidates.pairs(frame, observations)
        chosen = self._assign(observations, scored)
        matched = {pair.object_id for pair in chosen if pair is not None}
        self._key_frames += 1
        due = self._key_frames % self._config.merge_every == 0
        joins = [_joined(join, "join", "containment") for join in self._contained(matched)] if due else []
        into, standings = self._after(joins)
        changes: list[Change] = [*joins]
        for observation, pairs, pair in zip(observations, scored, chosen, strict=True):
            vote = _Standing(
                {observation.label: observation.score}, () if viewpoint_id is None else (viewpoint_id,), False
            )
            if pair is None:
                fresh = self._added(observation, pairs, viewpoint_id)
                standings[fresh.object_id] = vote
                changes.append(fresh)
                self._touched.add(fresh.object_id)
                continue
            object_id = into.get(pair.object_id, pair.object_id)
            if object_id == pair.object_id and object_id not in into.values():
                changes += self._cut(frame, observation, observations, object_id)
            parts = [pair.object_id, *(part for part, whole in into.items() if whole == object_id), object_id]
            changes.append(self._merged(observation, pair, object_id, parts, viewpoint_id))
            known = standings.get(object_id) or _standing(self._graph.objects[object_id])
            standings[object_id] = known.plus(vote)
            self._touched.add(object_id)
        self._visited |= self._touched
        return [*changes, *self._beliefs(standings)]

    def finish(self) -> Sequence[Change]:
        """A merge pass over the visit; what is not confirmed stays in the graph as tentative.

        What one cloud holds of another comes first, by the frames since the last pass; then what lines up.
        By now two pieces of one label that line up, of which no frame of the visit saw both, are more likely
        two sides of one thing (a wardrobe from the left and from the right of the bed) than neighbours.
        """
        joins = self._end_joins()
        _, standings = self._after(joins)
        if self._extents is not None:
            self._extents.forget_all_but(self._graph.objects)
        return [*joins, *self._beliefs(standings)]

    def _assign(self, observations: Sequence[Observation], scored: list[list[Pair]]) -> list[Pair | None]:
        """The pair to merge by for each observation, or None: one-to-one, no object gets two of one frame.

        A fragment of a thing lies on it as fully as the whole does, so that both reach the same s; a tie goes
        to the larger observation (its size adds less than 1e-6 to s).
        """
        columns = sorted({pair.object_id for pairs in scored for pair in pairs if pair.allowed}, key=id_order)
        place = {object_id: column for column, object_id in enumerate(columns)}
        scores = np.zeros((len(scored), len(columns)))
        allowed = np.zeros(scores.shape, dtype=np.bool_)
        for row, (observation, pairs) in enumerate(zip(observations, scored, strict=True)):
            size = len(observation.points_world)
            for pair in pairs:
                if pair.allowed:
                    scores[row, place[pair.object_id]] = pair.s + 1e-6 * size / (1 + size)
                    allowed[row, place[pair.object_id]] = True
        return [
            None if column < 0 else next(pair for pair in pairs if pair.object_id == columns[column])
            for pairs, column in zip(scored, assign(scores, allowed, self._config.delta_sim), strict=True)
        ]

    # -- changes ------------------------------------------------------------------------------------------

    def _added(self, observation: Observation, pairs: list[Pair], viewpoint_id: str | None) -> ObjectAdded:
        """A new object, with the scores of the object that came nearest to taking it.

        The rule says why it did not: `new` (s < delta_sim), `new_unlike` (s would do, but neither meaning nor
        overlap), `new_taken` (another observation of the frame fits that object better).
        """
        best = self._candidates.nearest(observation, pairs)
        scores: tuple[Score, ...] = (Score("s", 0.0, self._config.delta_sim),)
        rule = "new"
        if best is not None:
            scores = (*self._scores(best), Score("best_object", float(id_order(best.object_id)[1])))
            if best.s >= self._config.delta_sim:
                rule = "new_taken" if best.allowed else "new_unlike"
        return added(observation, self._ids.new("object"), viewpoint_id, Cause(PLUGIN, rule), scores)

    def _merged(
        self,
        observation: Observation,
        pair: Pair,
        object_id: str,
        parts: Sequence[str],
        viewpoint_id: str | None,
    ) -> ObjectMerged:
        """A merge with only the voxels that none of the object's `parts` (after joins: several) has yet."""
        # A doubtful mask often holds two things: it votes, but what it would add stays out of a known shape.
        believed = self._graph.objects[pair.object_id].status == BELIEVED
        grows = not believed or observation.score >= self._config.grow_min_score
        novel = np.full(len(observation.points_world), grows or self._config.paper_exact)
        if believed and self._extents is not None:
            points = observation.points_world
            novel &= self._extents.confirmed(object_id, points, elsewhere=False)
            node = self._graph.objects[pair.object_id]
            if outgrows(node.box_min, node.box_max, points[novel]):
                novel &= self._extents.confirmed(object_id, points, elsewhere=True)
        for part in dict.fromkeys(parts):
            novel &= ~self._graph.known_voxels(part, observation.points_world)
        cause = Cause(PLUGIN, "merge")
        return merged(observation, object_id, viewpoint_id, cause, self._scores(pair), novel=novel)

    def _cut(
        self, frame: Frame, observation: Observation, observations: Sequence[Observation], object_id: str
    ) -> list[Change]:
        """The frame's vote on what belongs to an object; its cloud without what does not, if that tells."""
        doubtful = observation.score < self._config.grow_min_score
        if doubtful or self._extents is None:
            return []
        node = self._graph.objects[object_id]
        others = [
            other.points_world
            for other in observations
            if other is not observation and other.label in (observation.label, node.label)
        ]
        tolerance = neighbour_tolerance(observation.range_m, self._noise)
        self._extents.vote(object_id, node.points, observation.points_world, others, frame, tolerance)
        belongs = self._extents.cut(object_id, node.points)
        if belongs is None:
            return []
        share = float(np.mean(belongs))
        return [
            ObjectReplaced(
                cause=Cause(PLUGIN, "cut"),
                scores=(Score("kept_share", share), Score("extent_share", self._config.extent_share)),
                object_id=object_id,
                points=node.points[belongs],
                colors=node.colors[belongs],
            )
        ]

    def _scores(self, pair: Pair) -> tuple[Score, ...]:
        """Every term of a pair's decision with what it was held against."""
        exact = self._config.paper_exact
        terms = [
            Score("s", pair.s, self._config.delta_sim),
            Score("s_geo", pair.s_geo),
            Score("s_sem", pair.s_sem, None if exact else self._config.merge_min_semantic),
        ]
        if pair.overlap is not None:
            terms.append(Score("overlap", pair.overlap, self._config.merge_min_overlap))
        return tuple(terms)

    def _contained(self, matched: set[str]) -> list[Join]:
        """The merge pass over what was touched since the last one; this frame tells `matched` apart."""
        touched, self._touched = self._touched | matched, set()
        config = self._config
        return contained_pieces(self._graph, touched, matched, config.join_containment, config.join_tolerance)

    def _end_joins(self) -> list[ObjectsJoined]:
        """The merge pass at the end of a visit, then, over all of the visit, what lines up."""
        config = self._config
        visited, self._visited = self._visited, set()
        contained = self._contained(set())
        joins = [_joined(join, "join", "containment") for join in contained]
        if config.paper_exact:
            return joins
        aligned = aligned_pieces(
            self._graph, visited, contained, self._unnamed, config.join_gap, config.join_gap_share
        )
        before = [*contained, *aligned]
        parts = fragments(self._graph, visited, before, config.join_fragment, config.join_tolerance)
        joins += [_joined(join, "join_aligned", "gap") for join in aligned]
        return [*joins, *(_joined(join, "join_fragment", "containment") for join in parts)]

    def _after(self, joins: Sequence[ObjectsJoined]) -> tuple[dict[str, str], dict[str, _Standing]]:
        """Where each absorbed object ends up, and the standings of those that absorbed some."""
        into: dict[str, str] = {}
        standings: dict[str, _Standing] = {}
        for join in joins:
            keep, lose = join.object_id, join.absorbed_id
            into = {part: keep if whole == lose else whole for part, whole in into.items()} | {lose: keep}
            gone = standings.pop(lose, None) or _standing(self._graph.objects[lose])
            standings[keep] = (standings.get(keep) or _standing(self._graph.objects[keep])).plus(gone)
            self._touched.add(keep)
            if self._extents is not None:
                self._extents.join(keep, lose)
        return into, standings

    def _beliefs(self, standings: Mapping[str, _Standing]) -> list[ObjectChanged]:
        """`believed` for objects whose confidence reached delta_conf by this frame's votes and views."""
        changes = []
        for object_id in sorted(standings, key=id_order):
            standing = standings[object_id]
            votes, views = max(standing.votes.values()), len(standing.viewpoints)
            value = confidence(votes, views, self._config.min_votes, self._config.min_views)
            if standing.believed or value < self._config.delta_conf:
                continue
            changes.append(
                ObjectChanged(
                    cause=Cause(PLUGIN, "believe"),
                    scores=(
                        Score("confidence", value, self._config.delta_conf),
                        Score("votes", votes, self._config.min_votes),
                        Score("views", float(views), self._config.min_views),
                    ),
                    object_id=object_id,
                    values={"status": BELIEVED},
                )
            )
        return changes


def _standing(node: ObjectNode) -> _Standing:
    return _Standing(node.votes, node.viewpoints, node.status == BELIEVED)


def _joined(join: Join, rule: str, term: str) -> ObjectsJoined:
    return ObjectsJoined(
        cause=Cause(PLUGIN, rule),
        scores=(Score(term, join.value, join.limit),),
        object_id=join.object_id,
        absorbed_id=join.absorbed_id,
    )


@hookimpl
def register_association(register: Register) -> None:
    """Announce `dssm`."""
    register("dssm", DssmAssociation, config=DssmConfig)
