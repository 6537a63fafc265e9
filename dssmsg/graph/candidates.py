"""Which object may an observation be? Its scores against those that it touches (paper III-A; ALGORITHM A.2).

s = s_geo + s_sem: the share of the observation's points on the object, and how alike the two are called. The
scores themselves are in `scoring`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from dssmsg.frame import Frame, Observation
from dssmsg.geometry import Sight, grow_box, points_in_box, sight_of_points
from dssmsg.graph.evidence import SightRule, View, look_at_each, telling
from dssmsg.graph.nodes import DISAPPEARED, ObjectNode
from dssmsg.graph.scoring import neighbour_share, neighbour_tolerance, sampled_share, semantic_similarity
from dssmsg.graph.view import GraphView
from dssmsg.neighbours import quick_tree

_SIGHT = SightRule()


@dataclass(frozen=True, slots=True)
class CandidateRule:
    """Thresholds; see the options of `association: dssm`, which bear the same names."""

    delta_sim: float
    paper_exact: bool
    merge_min_semantic: float
    merge_min_overlap: float
    max_free_share: float
    unnamed_labels: frozenset[str]
    sample: int


@dataclass(frozen=True, slots=True)
class Pair:
    """The scores of one observation against one object."""

    object_id: str
    s_geo: float
    s_sem: float
    overlap: float | None
    """Mutual overlap; None where it was not asked for."""
    allowed: bool
    exact: bool
    """False: s_geo is only an upper bound, too low for a merge."""

    @property
    def s(self) -> float:
        """Eq. of III-A: s = s_geo + s_sem."""
        return self.s_geo + self.s_sem


class Candidates:
    """Scores observations against the objects of a graph; `noise` of depth as in `neighbour_tolerance`."""

    def __init__(self, graph: GraphView, rule: CandidateRule, noise: tuple[float, float]) -> None:
        self._graph = graph
        self._rule = rule
        self._noise = noise

    def pairs(self, frame: Frame, observations: Sequence[Observation]) -> list[list[Pair]]:
        """Of each observation, the scores against every object that its box, grown by the tolerance, touches.

        What the frame shows free is not what was seen in its place: such a pair is not allowed.
        """
        scored = [self._scores(frame, observation) for observation in observations]
        if self._rule.paper_exact:
            return scored
        asked = {
            pair.object_id: self._graph.objects[pair.object_id]
            for pairs in scored
            for pair in pairs
            if pair.allowed
        }
        clouds = {
            object_id: node.points[telling(node.points)]
            for object_id, node in asked.items()
            if node.observations > 1
        }
        sights = look_at_each(list(clouds.values()), View.of(frame), self._noise, _SIGHT) if clouds else []
        free = {
            object_id
            for object_id, sight in zip(clouds, sights, strict=True)
            if sight.free >= self._rule.max_free_share
        }
        return [
            [
                replace(pair, allowed=False) if pair.allowed and pair.object_id in free else pair
                for pair in pairs
            ]
            for pairs in scored
        ]

    def _scores(self, frame: Frame, observation: Observation) -> list[Pair]:
        tolerance = neighbour_tolerance(observation.range_m, self._noise)
        observation_tree: KDTree | None = None
        pairs = []
        for object_id in self._graph.objects_touching(
            *grow_box(observation.box_min, observation.box_max, tolerance)
        ):
            node = self._graph.objects[object_id]
            if node.state == DISAPPEARED:
                continue  # what is seen in its place is another thing, until the update finds it is the same
            s_sem = semantic_similarity(
                observation.label,
                observation.text_feature,
                node.label,
                node.text_feature,
                self._rule.unnamed_labels,
            )
            alike = self._rule.paper_exact or s_sem >= self._rule.merge_min_semantic
            needed = self._rule.delta_sim - s_sem
            if not alike:
                needed = max(needed, self._rule.merge_min_overlap)
            s_geo, exact = self._share(observation, node, tolerance, needed)
            overlap = None
            if s_geo >= needed and not alike:
                observation_tree = observation_tree or quick_tree(observation.points_world)
                overlap = min(s_geo, self._covered(frame, node, observation_tree, tolerance))
            enough = alike or (overlap is not None and overlap >= self._rule.merge_min_overlap)
            allowed = 0.0 < s_geo >= needed and enough
            pairs.append(Pair(object_id, s_geo, s_sem, overlap, allowed, exact))
        return pairs

    def _share(
        self, observation: Observation, node: ObjectNode, tolerance: float, needed: float
    ) -> tuple[float, bool]:
        """s_geo and True; or an upper bound of it, below `needed` and so too low for a merge, and False.

        Points outside the object's box are off it without asking; often that settles it.
        """
        points = observation.points_world
        near = points[points_in_box(points, *grow_box(node.box_min, node.box_max, tolerance))]
        bound = len(near) / len(points)
        if bound == 0.0 or bound < needed:
            return bound, bound == 0.0
        share = sampled_share(
            near, self._graph.tree(node.id), tolerance, self._rule.sample, (needed / bound,)
        )
        return bound * share, True

    def _covered(self, frame: Frame, node: ObjectNode, observation_tree: KDTree, tolerance: float) -> float:
        """Share of the object's points in sight of this frame that lie on the observation.

        Only what this frame shows of the object counts: a close-up of a sofa's arm covers little of the
        stored sofa, but all of it that is in view. 0 if nothing is.
        """
        count = len(node.points)
        points = node.points
        if count > self._rule.sample:
            points = points[(np.arange(self._rule.sample) * count) // self._rule.sample]
        margin = max(tolerance, 0.05)  # two voxels: stored points are means of their cell
        sight = sight_of_points(points, frame.depth, frame.camera, frame.world_from_camera, margin)
        return neighbour_share(points[sight == Sight.ON_SURFACE], observation_tree, tolerance)

    def nearest(self, observation: Observation, pairs: list[Pair]) -> Pair | None:
        """The pair that came nearest to a merge, its s_geo made exact where a bound was enough so far."""
        tolerance = neighbour_tolerance(observation.range_m, self._noise)
        best: Pair | None = None
        for pair in sorted(pairs, key=lambda pair: (not pair.allowed, -pair.s)):
            if best is not None and (best.allowed or best.s >= pair.s):
                break
            if not pair.exact:
                s_geo, _ = self._share(observation, self._graph.objects[pair.object_id], tolerance, 0.0)
                pair = replace(pair, s_geo=s_geo, exact=True)
            if best is None or pair.s > best.s:
                best = pair
        return best
