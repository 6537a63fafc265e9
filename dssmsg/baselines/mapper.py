"""The map making that ConceptGraphs and DovSG share: greedy association, a tidy-up now and then.

Every observation goes to the object that it fits best, if well enough, and becomes a new object otherwise;
several may go to one object. The two methods differ in a `Method`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from dssmsg.baselines.pairs import Pair, PairScorer, Weights
from dssmsg.baselines.tidying import Denoise, denoised, joined
from dssmsg.frame import Float32Array, Observation
from dssmsg.geometry import grow_box
from dssmsg.graph.changes import (
    Cause,
    Change,
    ObjectAdded,
    ObjectChanged,
    ObjectMerged,
    ObjectRemoved,
    ObjectReplaced,
    Score,
)
from dssmsg.graph.fusion import counted, winner
from dssmsg.graph.ids import IdAllocator, id_order
from dssmsg.graph.nodes import BELIEVED
from dssmsg.graph.observed import added, merged
from dssmsg.graph.view import GraphView


@dataclass(frozen=True, slots=True)
class Method:
    """What makes a method: lengths in metres, `every` in key frames.

    `accept` is the least score of a merge, `join` the limits that two objects' terms must exceed to be one;
    `denoise` says which points of objects' clouds stay, None: all. `by_majority`: each detection has one
    vote on the label; otherwise the most confident detection names the object.
    """

    plugin: str
    weights: Weights
    tolerance: float
    accept: float
    join: Mapping[str, float]
    denoise: Denoise | None
    every: int
    min_points: int
    min_detections: int
    by_majority: bool


@dataclass(frozen=True, slots=True)
class _Standing:
    """An object as the batch at hand leaves it; `surest` is its most confident detection: score, label."""

    votes: Mapping[str, float]
    detections: int
    believed: bool
    surest: tuple[float, str]

    def plus(self, other: _Standing) -> _Standing:
        """Both together, as one object."""
        return _Standing(
            counted(self.votes, other.votes),
            self.detections + other.detections,
            self.believed or other.believed,
            other.surest if other.surest[0] > self.surest[0] else self.surest,
        )


@dataclass(frozen=True, slots=True)
class _Tidied:
    """A tidy-up: its changes, where each absorbed object ends up, and the objects it gives a new cloud."""

    changes: tuple[Change, ...] = ()
    into: Mapping[str, str] = field(default_factory=dict)
    recast: frozenset[str] = frozenset()


class GreedyMapper:
    """Turns observations into changes.

    Keeps what was touched since the last tidy-up, the clouds denoised then, and each object's surest name.
    """

    def __init__(self, graph: GraphView, ids: IdAllocator, method: Method) -> None:
        self._graph = graph
        self._ids = ids
        self._method = method
        self._scorer = PairScorer(graph, method.weights, method.tolerance)
        self._key_frames = 0
        self._touched: set[str] = set()
        self._surest: dict[str, tuple[float, str]] = {}
        self._denoised: dict[str, Float32Array] = {}
        self._standings: dict[str, _Standing] = {}

    def associate(self, observations: Sequence[Observation], viewpoint_id: str | None) -> list[Change]:
        """The tidy-up if one is due, one `ObjectAdded` or `ObjectMerged` an observation, names, beliefs.

        A tidy-up is due after every so many key frames; the next one brings it, when the graph shows what
        these left. That frame's observations are scored with the clouds from before it.
        """
        self._standings = {}
        due = self._key_frames > 0 and self._key_frames % self._method.every == 0
        self._key_frames += 1
        tidied = self._tidied() if due else _Tidied()
        changes = list(tidied.changes)
        for observation in observations:
            vote = 1.0 if self._method.by_majority else observation.score
            standing = _Standing({observation.label: vote}, 1, False, (observation.score, observation.label))
            pair = self._best(observation)
            if pair is None or pair.score < self._method.accept:
                added = self._added(observation, pair, vote, viewpoint_id)
                changes.append(added)
                object_id = added.object_id
            else:
                object_id = tidied.into.get(pair.object_id, pair.object_id)
                known = object_id not in tidied.recast
                changes.append(self._merged(observation, pair, vote, object_id, viewpoint_id, known))
                standing = self._standing(object_id).plus(standing)
            self._standings[object_id] = standing
            self._touched.add(object_id)
        return [*changes, *self._names(), *self._beliefs()]

    def finish(self) -> list[Change]:
        """A last tidy-up; then objects with too few detections go."""
        self._standings = {}
        tidied = self._tidied()
        changes = [*tidied.changes, *self._names(), *self._beliefs()]
        least = self._method.min_detections
        for object_id in self._graph.objects:
            count = self._standing(object_id).detections
            if object_id not in tidied.into and count < least:
                changes.append(
                    ObjectRemoved(
                        cause=Cause(self._method.plugin, "few_detections"),
                        scores=(Score("detections", float(count), float(least)),),
                        object_id=object_id,
                    )
                )
        self._surest = {one: known for one, known in self._surest.items() if one in self._graph.objects}
        self._denoised = {one: cloud for one, cloud in self._denoised.items() if one in self._graph.objects}
        return changes

    # -- one observation ----------------------------------------------------------------------------------

    def _best(self, observation: Observation) -> Pair | None:
        """The object that fits best; only what the observation's box reaches can overlap it."""
        reach = grow_box(observation.box_min, observation.box_max, self._method.tolerance)
        return self._scorer.best(observation, self._graph.objects_touching(*reach))

    def _added(
        self, observation: Observation, nearest: Pair | None, vote: float, viewpoint_id: str | None
    ) -> ObjectAdded:
        """A new object, with the terms of the object that came nearest to taking the observation."""
        scores: tuple[Score, ...] = (Score("score", 0.0, self._method.accept),)
        if nearest is not None:
            terms = nearest.terms({"score": self._method.accept})
            scores = (*terms, Score("best_object", float(id_order(nearest.object_id)[1])))
        object_id, cause = self._ids.new("object"), Cause(self._method.plugin, "new")
        return added(observation, object_id, viewpoint_id, cause, scores, vote=vote)

    def _merged(
        self,
        observation: Observation,
        pair: Pair,
        vote: float,
        object_id: str,
        viewpoint_id: str | None,
        known: bool,
    ) -> ObjectMerged:
        """A merge; with `known` (the graph shows the object's cloud as it is) of its new voxels alone."""
        novel = ~self._graph.known_voxels(object_id, observation.points_world) if known else None
        scores, cause = pair.terms({"score": self._method.accept}), Cause(self._method.plugin, "merge")
        return merged(observation, object_id, viewpoint_id, cause, scores, novel=novel, vote=vote)

    # -- the map -------------------------------------------------------------------------------------------

    def _tidied(self) -> _Tidied:
        """Denoise what was touched since the last time, then join it with what it overlaps."""
        method, graph = self._method, self._graph
        touched = sorted((one for one in self._touched if one in graph.objects), key=id_order)
        self._touched = set()
        cut: list[ObjectReplaced] = []
        if method.denoise is not None:
            fresh = [one for one in touched if self._denoised.get(one) is not graph.objects[one].points]
            self._denoised.update({one: graph.objects[one].points for one in fresh})
            cut = denoised(graph, fresh, method.denoise, method.min_points, method.plugin)
        joins = joined(graph, self._scorer, touched, method.join, method.plugin)
        into: dict[str, str] = {}
        for join in joins:
            keep, lose = join.object_id, join.absorbed_id
            into = {part: keep if whole == lose else whole for part, whole in into.items()} | {lose: keep}
            self._standings[keep] = self._standing(keep).plus(self._standing(lose))
            self._standings.pop(lose, None)
            self._touched.add(keep)
        recast = frozenset([one.object_id for one in cut] + [one.object_id for one in joins])
        return _Tidied((*cut, *joins), into, recast)

    def _standing(self, object_id: str) -> _Standing:
        """The object as the batch so far leaves it."""
        if object_id in self._standings:
            return self._standings[object_id]
        node = self._graph.objects[object_id]
        surest = self._surest.get(object_id, (0.0, node.label))
        return _Standing(node.votes, node.observations, node.status == BELIEVED, surest)

    def _names(self) -> list[ObjectChanged]:
        """New labels where the graph's vote and the method's rule disagree; by majority they never do."""
        if self._method.by_majority:
            return []
        changes = []
        for object_id in sorted(self._standings, key=id_order):
            standing = self._standings[object_id]
            self._surest[object_id] = standing.surest
            confidence, label = standing.surest
            if winner(standing.votes) != label:
                changes.append(
                    ObjectChanged(
                        cause=Cause(self._method.plugin, "surest_label"),
                        scores=(Score("confidence", confidence),),
                        object_id=object_id,
                        values={"label": label},
                    )
                )
        return changes

    def _beliefs(self) -> list[ObjectChanged]:
        """`believed` for objects that now have enough detections."""
        least = self._method.min_detections
        return [
            ObjectChanged(
                cause=Cause(self._method.plugin, "believe"),
                scores=(Score("detections", float(standing.detections), float(least)),),
                object_id=object_id,
                values={"status": BELIEVED},
            )
            for object_id, standing in sorted(self._standings.items(), key=lambda one: id_order(one[0]))
            if not standing.believed and standing.detections >= least
        ]
