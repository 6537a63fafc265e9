"""update/dssm: the dynamic spatio-semantic memory and the update on re-navigation (paper III-A end, III-B).

After a key frame was associated: what does it say of every object in view (ALGORITHM B), which have vanished,
which appeared, which of the two are one thing that moved (eq. 1-2), and how readily is a thing moved (d_a).
The tests are in `dssmsg.graph.evidence`, `presence`, `appearance` and `movement`, the changes in
`transitions`.

Beyond the paper, all off with `paper_exact`: unseen is not gone (only depth behind its place says so), a
new object has appeared only where its place was seen free, evidence of several viewpoints counts together,
and another thing of the same kind in the same place is told by its colours.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.dynamic_attribute import DynamicAttribute, DynamicAttributes, level
from dssmsg.events import WindowEvaluated
from dssmsg.frame import FloatArray, Frame, Observation
from dssmsg.geometry import box_iou
from dssmsg.graph import transitions
from dssmsg.graph.appearance import Newcomer, base_evidence
from dssmsg.graph.changes import Cause, Change, ObjectChanged, ObjectRemoved, Score
from dssmsg.graph.evidence import SightRule, View
from dssmsg.graph.ids import id_order
from dssmsg.graph.memory import ViewpointWindows
from dssmsg.graph.nodes import APPEARED, BELIEVED, DISAPPEARED, MOVED, NEAR, SEES, STATIC, ObjectNode
from dssmsg.graph.observed import added
from dssmsg.graph.pairing import Pair, Pairing, PairingRule
from dssmsg.graph.pieces import came_with, left_with
from dssmsg.graph.presence import ColorRule, Presence
from dssmsg.graph.verdicts import MISSED, SEEN, Evidence
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.update import UpdateResult

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "update/dssm"


class DssmConfig(PluginConfig):
    """Thresholds of memory and update; symbols as in the paper where it names them."""

    paper_exact: bool = Field(
        False, description="The paper's literal rules: not detected is gone, not detected before is new."
    )
    window: int = Field(8, ge=2, description="Frames that a viewpoint's window keeps, across visits.")
    k: int = Field(3, ge=1, description="Consistent frames that a verdict takes.")
    delta_move: float = Field(0.7, ge=0, le=2, description="delta_move: s_move from which a thing has moved.")
    delta_sem: float = Field(0.8, ge=0, le=1, description="delta_sem of eq. 1, for s_v and s_sem.")
    delta_iou: float = Field(0.3, ge=0, le=1, description="delta_iou: 3D IoU from which a place is the same.")
    delta_c: float = Field(0.3, gt=0, description="delta_c: metres up to which two centres are one place.")
    unseen_move_margin: float = Field(
        0.1, ge=0, description="Added to delta_move where the new place was never seen before."
    )
    free_share: float = Field(
        0.6, gt=0, le=1, description="Share of its points in view that must be shown free."
    )
    max_range: float = Field(4.0, gt=0, description="Farthest point that a frame says anything of, metres.")
    min_sightings: int = Field(
        2, ge=1, description="Detections after which a verdict may be given on a thing not believed yet."
    )
    min_votes: float = Field(
        0.7, ge=0, description="Summed scores of its label that such a verdict takes as well."
    )
    exchanged_below: float = Field(
        0.35, ge=0, le=1, description="s_rgb in place below which it is another one of its kind; 0: never."
    )


class DssmUpdate:
    """Follows the objects of the graph through the visits."""

    def __init__(self, config: DssmConfig, context: Context) -> None:
        self._config = config
        self._graph = context.graph
        self._ids = context.ids
        self._noise = (0.001, 0.0) if context.source is None else context.source.depth_noise_m
        self._rule = SightRule(free_share=config.free_share, max_range=config.max_range)
        self._colors = ColorRule(exchanged=config.exchanged_below)
        self._windows = ViewpointWindows(context.graph, config.window, config.max_range + 1.0)
        self._presence = Presence(
            context.graph,
            self._noise,
            self._rule,
            self._colors,
            literal=config.paper_exact,
        )
        self._attributes = DynamicAttributes(context.llm)
        self._visit = -1
        self._seen_this_visit: set[str] = set()
        self._baseline = False
        self._known: set[str] = set()
        """Objects that were there at the end of the first visit."""
        self._home: dict[str, tuple[FloatArray, FloatArray]] = {}
        """Where the believed ones of them were."""
        self._new: dict[str, int] = {}
        """Objects that came after the baseline and are undecided: id -> observations at the last test."""
        self._shown_free: dict[str, tuple[int, ...]] = {}
        """The frames that spoke for an appearance of this key frame."""
        self._pairing = Pairing(
            context.graph,
            PairingRule(
                config.delta_move, config.delta_sem, config.unseen_move_margin, paper_exact=config.paper_exact
            ),
        )

    def update(
        self,
        frame: Frame,
        observations: Sequence[Observation],
        object_ids: Sequence[str | None],
        viewpoint_id: str | None,
    ) -> UpdateResult:
        """Evidence of this key frame, and the verdicts that it completes."""
        if frame.visit != self._visit:
            self._visit = frame.visit
            self._seen_this_visit = set()
            self._presence.begin_visit()
        observed = {
            object_id: observation
            for object_id, observation in zip(object_ids, observations, strict=True)
            if object_id is not None and object_id in self._graph.objects
        }
        self._seen_this_visit.update(observed)
        for object_id in observed:
            if object_id not in self._known and not self._pairing.is_open(object_id):
                self._new.setdefault(object_id, 0)
        view = View.of(frame)
        expected = self._expected(viewpoint_id)
        evidence = self._presence.look(view, observed, expected)
        verdicts: dict[str, str] = {}
        changes = self._moves(verdicts, at_end=False)
        # What moved has another cloud and other edges once these changes are applied: the rest waits.
        open_to_verdicts = [e for e in evidence if e.object_id not in verdicts]
        changes += self._attribute_changes(e.object_id for e in open_to_verdicts if e.verdict == SEEN)
        changes += self._absences(open_to_verdicts, verdicts)
        changes += self._exchanges(observed, viewpoint_id, verdicts)
        changes += self._appearances(observed, viewpoint_id, verdicts)
        windows: tuple[WindowEvaluated, ...] = ()
        if viewpoint_id is not None:
            self._windows.add(viewpoint_id, view, {e.object_id: e.verdict for e in evidence})
            windows = (self._evaluation(viewpoint_id, frame, evidence, verdicts),)
        return UpdateResult(tuple(transitions.without_repeats(changes)), windows)

    def finish(self) -> UpdateResult:
        """A visit is over: what vanished and what arrived are paired; the first visit is the baseline."""
        self._windows.forget_removed()
        self._presence.end_visit()
        if not self._baseline:
            return UpdateResult(tuple(self._take_baseline()))
        # What vanished meanwhile may have made room: asked once more.
        undecided = [object_id for object_id in self._new if object_id in self._graph.objects]
        self._new = dict.fromkeys(undecided, 0)
        verdicts: dict[str, str] = {}
        changes = self._appearances(undecided, None, verdicts)
        return UpdateResult((*changes, *self._moves(verdicts, at_end=True)))

    # -- what is expected, how readily it moves -------------------------------------------------------------

    def _expected(self, viewpoint_id: str | None) -> frozenset[str]:
        """O_ref of the paper: what this viewpoint should see within range."""
        if viewpoint_id is None:
            return frozenset()
        return frozenset(
            edge.target
            for edge in self._graph.edges_of(viewpoint_id, SEES)
            if edge.attributes.get("distance", 0.0) <= self._config.max_range
        )

    def _attribute_changes(self, seen: Iterable[str]) -> list[Change]:
        """d_a of every object in view that is believed and has none yet."""
        changes: list[Change] = []
        for object_id in seen:
            node = self._graph.objects[object_id]
            if node.status != BELIEVED or node.dynamic_attribute is not None:
                continue
            estimate = self._estimate(node)
            changes.append(
                ObjectChanged(
                    cause=Cause(PLUGIN, f"dynamic_attribute ({estimate.source.partition(':')[0]})"),
                    object_id=object_id,
                    values={"dynamic_attribute": estimate.value},
                )
            )
        return changes

    def _estimate(self, node: ObjectNode) -> DynamicAttribute:
        x, y, z = (float(length) for length in node.box_max - node.box_min)
        return self._attributes.estimate(node.label, (x, y, z), self._around(node.id))

    def _attribute(self, node: ObjectNode) -> float:
        """d_a of an object, asked for now if it has none yet."""
        return self._estimate(node).value if node.dynamic_attribute is None else node.dynamic_attribute

    def _is_borne_out(self, node: ObjectNode) -> bool:
        """Whether a verdict may be given on an object: it is believed, or nearly.

        A place that was occupied and then is free, or the other way round, speaks for a thing as views do:
        some detections that agree on its label are enough beside it.
        """
        if node.status == BELIEVED:
            return True
        votes = node.votes[node.label]
        agreed = votes >= max(self._config.min_votes, 0.5 * sum(node.votes.values()))
        enough = node.observations >= self._config.min_sightings
        return enough and agreed and not self._config.paper_exact

    def _around(self, object_id: str) -> list[str]:
        """Labels of the believed objects near it, nearest first."""
        near = []
        for edge in self._graph.edges_of(object_id, NEAR):
            other = self._graph.objects[edge.target if edge.source == object_id else edge.source]
            if other.status == BELIEVED:
                near.append((float(edge.attributes.get("distance", 0.0)), id_order(other.id), other.label))
        return [label for _, _, label in sorted(near)]

    # -- verdicts -------------------------------------------------------------------------------------------

    def _absences(self, evidence: Sequence[Evidence], verdicts: dict[str, str]) -> list[Change]:
        """Objects whose place k frames in a row showed free."""
        changes: list[Change] = []
        for item in evidence:
            frames = self._presence.absent_for(item.object_id)
            if item.verdict != MISSED or len(frames) < self._config.k:
                continue
            node = self._graph.objects[item.object_id]
            scores = (
                *transitions.frame_scores(frames, self._config.k),
                Score("free_share", item.values.get("free", 0.0), self._config.free_share),
            )
            was_there = node.id in self._known and self._is_borne_out(node)
            if node.status != BELIEVED and not was_there:
                verdicts[node.id] = "corrected"
                self._forget(node.id)
                changes.append(transitions.corrected(node.id, Cause(PLUGIN, "corrected"), scores))
            elif (whole := self._whole_that_left(node, verdicts)) is not None:
                verdicts[node.id] = f"a piece of {whole}"
                self._forget(node.id)
                changes.append(transitions.corrected(node.id, Cause(PLUGIN, "left_piece"), scores))
            elif level(self._attribute(node)) < 3:
                verdicts[node.id] = DISAPPEARED
                changes += self._vanish(node, "disappeared", node.frames[-1], scores)
        return changes

    def _whole_that_left(self, node: ObjectNode, verdicts: Mapping[str, str]) -> str | None:
        if self._config.paper_exact:
            return None
        now = [self._graph.objects[i] for i, verdict in verdicts.items() if verdict == DISAPPEARED]
        return left_with(self._graph, node, [*now, *self._pairing.gone()])

    def _come(self, verdicts: Mapping[str, str]) -> set[str]:
        """What has appeared or was moved here, as far as this visit has seen it."""
        if self._config.paper_exact:
            return set()
        seen = (self._graph.objects.get(object_id) for object_id in self._seen_this_visit)
        before = {node.id for node in seen if node is not None and node.state in (APPEARED, MOVED)}
        # What has a verdict in this frame may be gone, or be another object, once it is applied.
        come = {object_id for object_id, verdict in verdicts.items() if verdict == APPEARED}
        return before.difference(verdicts) | come

    def _exchanges(
        self, observed: Mapping[str, Observation], viewpoint_id: str | None, verdicts: dict[str, str]
    ) -> list[Change]:
        """Objects in whose place k frames in a row saw another thing of the kind, told by its colours."""
        changes: list[Change] = []
        if self._config.paper_exact:
            return changes
        for object_id, observation in observed.items():
            frames = self._presence.exchanged_for(object_id)
            node = self._graph.objects[object_id]
            if len(frames) < self._config.k or node.status != BELIEVED or object_id in verdicts:
                continue
            if node.dynamic_attribute is not None and level(node.dynamic_attribute) == 3:
                continue
            scores = transitions.frame_scores(frames, self._config.k)
            cause = Cause(PLUGIN, "exchanged")
            new_id = self._ids.new("object")
            changes.append(added(observation, new_id, viewpoint_id, cause, scores))
            changes.append(transitions.appeared(new_id, cause, scores))
            changes += self._vanish(node, "exchanged", self._presence.last_itself(object_id), scores)
            verdicts[object_id], verdicts[new_id] = DISAPPEARED, APPEARED
            self._pairing.arrive(new_id, free_before=True)
            self._pairing.tell_apart(object_id, new_id)
        return changes

    def _vanish(
        self, node: ObjectNode, rule: str, last_frame: int, scores: tuple[Score, ...]
    ) -> Iterator[Change]:
        self._presence.forget(node.id)
        self._pairing.vanish(node, last_frame)
        self._new.pop(node.id, None)
        return transitions.vanished(self._graph, node.id, Cause(PLUGIN, rule), scores)

    def _appearances(
        self,
        object_ids: Iterable[str],
        viewpoint_id: str | None,
        verdicts: dict[str, str],
    ) -> list[Change]:
        """New objects, believed or seen often enough, whose place k earlier frames showed free."""
        changes: list[Change] = []
        for object_id in object_ids:
            node = self._graph.objects[object_id]
            if object_id not in self._new or object_id in verdicts or not self._is_borne_out(node):
                continue
            tested = self._new[object_id]
            if node.observations < 2 * tested:
                continue  # ask again when it is known twice as well
            self._new[object_id] = node.observations
            free = self._base_frames(node, viewpoint_id)
            whole = came_with(self._graph, node, self._come(verdicts))
            if whole is not None and len(free) >= self._config.k:
                verdicts[object_id] = f"a piece of {whole}"
                self._forget(object_id)
                scores = transitions.frame_scores(free, self._config.k)
                changes.append(transitions.piece(whole, object_id, Cause(PLUGIN, "piece"), scores))
                continue
            has_appeared = len(free) >= self._config.k
            self._pairing.arrive(object_id, free_before=has_appeared)
            if has_appeared:
                del self._new[object_id]
                verdicts[object_id] = APPEARED
                self._shown_free[object_id] = tuple(free)
                scores = transitions.frame_scores(free, self._config.k)
                believe = node.status != BELIEVED
                cause = Cause(PLUGIN, "appeared")
                changes.append(transitions.appeared(object_id, cause, scores, believe=believe))
        return changes

    def _base_frames(self, node: ObjectNode, viewpoint_id: str | None) -> Sequence[int]:
        """O_base: frames from before an object was first seen that show its place without it."""
        first = node.frames[0]
        if self._config.paper_exact:
            window = () if viewpoint_id is None else self._windows.window(viewpoint_id)
            return [remembered.view.frame for remembered in window if remembered.view.frame < first]
        former = [(gone.box_min, gone.box_max) for gone in self._pairing.gone()]
        views = self._windows.looking_at(node.box_min, node.box_max, first)
        new = Newcomer(node.points, node.colors, self._presence.gain or 1.0, self._colors.changed)
        found = base_evidence(new, former, views, self._noise, self._rule)
        return found.free if found.shows_free(self._config.k) else ()

    # -- movement -------------------------------------------------------------------------------------------

    def _moves(self, verdicts: dict[str, str], *, at_end: bool) -> list[Change]:
        """What vanished and was found again elsewhere, or in its place."""
        changes: list[Change] = []
        for pair in self._pairing.pairs(self._seen_this_visit, at_end=at_end):
            changes += self._move(pair, verdicts)
        return changes

    def _move(self, pair: Pair, verdicts: dict[str, str]) -> Iterator[Change]:
        old, new = pair.old, pair.new
        former = self._pairing.close(pair).state
        self._new.pop(new.id, None)
        self._presence.forget(new.id)
        self._presence.forget(old.id)
        verdicts[new.id] = f"is {old.id}"
        scores = transitions.move_scores(pair.score, pair.needed, self._config.delta_sem)
        if self._same_place((old.box_min, old.box_max), (new.box_min, new.box_max)):
            verdicts[old.id] = "returned"
            state = STATIC if old.id in self._home else former
            yield from transitions.returned(old, new, state, Cause(PLUGIN, "returned"), scores)
            return
        home = self._home.get(old.id)
        back = home is not None and self._same_place(home, (new.box_min, new.box_max))
        state = STATIC if back else (MOVED if home is not None or former != APPEARED else APPEARED)
        verdicts[old.id] = "put back" if back else MOVED
        cause = Cause(PLUGIN, "put_back" if back else "moved")
        yield from transitions.moved(old, new, state, self._ids.new("history"), cause, scores)

    def _same_place(self, a: tuple[FloatArray, FloatArray], b: tuple[FloatArray, FloatArray]) -> bool:
        """Centres closer than delta_c (paper III-B, L1), and boxes that touch.

        The paper also wants a 3D IoU; of a thing just found again only one side is known, and two sides of
        one thing may share next to nothing. `paper_exact` wants it.
        """
        apart = float(np.linalg.norm((a[0] + a[1] - b[0] - b[1]) / 2.0))
        least = self._config.delta_iou if self._config.paper_exact else 0.0
        return apart < self._config.delta_c and float(box_iou(*a, *b)) > least

    # -- bookkeeping ----------------------------------------------------------------------------------------

    def _take_baseline(self) -> Iterator[Change]:
        """The end of the first visit: states are told relative to it."""
        self._baseline = True
        for node in self._graph.objects.values():
            if node.state == DISAPPEARED:
                history_id = self._ids.new("history")
                yield ObjectRemoved(cause=Cause(PLUGIN, "baseline"), object_id=node.id, history_id=history_id)
                continue
            if node.state != STATIC:
                cause = Cause(PLUGIN, "baseline")
                yield ObjectChanged(cause=cause, object_id=node.id, values={"state": STATIC})
            self._known.add(node.id)
            if node.status == BELIEVED:
                self._home[node.id] = (node.box_min, node.box_max)
        self._pairing.clear()
        self._new.clear()

    def _forget(self, object_id: str) -> None:
        """An object leaves the graph for good."""
        self._presence.forget(object_id)
        self._pairing.drop(object_id)
        for table in (self._new, self._home):
            table.pop(object_id, None)

    def _evaluation(
        self, viewpoint_id: str, frame: Frame, evidence: Sequence[Evidence], verdicts: Mapping[str, str]
    ) -> WindowEvaluated:
        """The event: this frame's evidence, and what the window's other frames said of objects with a
        verdict."""
        window = self._windows.window(viewpoint_id)
        frames = [remembered.view.frame for remembered in window]
        earlier = [
            Evidence(remembered.view.frame, object_id, remembered.verdicts[object_id])
            for object_id in verdicts
            for remembered in window[:-1]
            if object_id in remembered.verdicts
        ]
        for object_id, verdict in verdicts.items():
            if verdict == APPEARED:  # the frames that showed its place without it
                earlier += [Evidence(f, object_id, MISSED) for f in self._shown_free.pop(object_id, ())]
        return WindowEvaluated(
            viewpoint_id=viewpoint_id,
            frame=frame.index,
            sim_time=frame.sim_time,
            base=tuple(frames[-self._config.k :]),
            comparison=tuple(frames[: -self._config.k]),
            evidence=(*evidence, *earlier),
            verdicts=dict(verdicts),
            threshold=self._config.k,
        )


@hookimpl
def register_update(register: Register) -> None:
    """Announce `dssm`."""
    register("dssm", DssmUpdate, config=DssmConfig)
