"""The seek phase: a sentence, its target graph, the best viewpoint, the drive there, a look (ALGORITHM D, E).

The robot judges by sight: an episode is a success when the object that was taken for the core target, or
another of its name that fits the sentence as well, is observed from the goal viewpoint. Where it is not, the
map as it is then is asked again, and the next candidate is tried. Touching anything ends the episode,
whatever it sees, and navigation is told of it; the next episode begins by backing off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from dssmsg import checks
from dssmsg.events import Candidate, EpisodeEnded, Matched, NavigationChanged
from dssmsg.frame import Frame
from dssmsg.geometry import box_distance
from dssmsg.graph.nodes import DISAPPEARED, ObjectNode
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.guard import Guard
from dssmsg.interfaces import Command, FeelsTouch, Grounding, Llm, Navigation, Step, TargetGraph
from dssmsg.mission.bus import ObserverBus
from dssmsg.mission.goal import TARGET_GRAPH_SCHEMA, target_graph_request
from dssmsg.mission.pipeline import Pipeline
from dssmsg.navigation.pose import floor_place
from dssmsg.target_graph import parse_target_graph, target_graph_json

SUCCESS, SEEN, COLLISION = "success", "seen", "collision"
IN_VIEW_M = 4.0
"""Nearer than this an object counts as in view (ALGORITHM, Scores)."""
_AS_GOOD = 0.9
"""Another object of the name will do where its best score is this share of the wanted one's."""
_LOOKS_AN_OBJECT = 2
"""An object that was missed from so many viewpoints is not looked for again."""
_BACK_M, _BACK_MPS, _BACK_FRAMES = 0.25, 0.2, 15
"""After a touch the robot backs off so far, so fast, for so many frames at most."""


@dataclass(frozen=True, slots=True)
class EpisodeLimits:
    """After so many viewpoints, seconds of sim time or metres driven an episode ends."""

    candidates: int = 5
    secs: float = 300.0
    metres: float = 100.0


@dataclass(slots=True)
class _Trip:
    """What an episode has cost so far, and where the robot is: its newest frame.

    `wanted`: the best object for the core target; it will do, too, where a viewpoint promised none.
    """

    frame: Frame
    began: float
    collisions: int
    frames: int = 0
    metres: float = 0.0
    replans: int = 0
    detours: int = 0
    tried: int = 0
    target: TargetGraph | None = None
    wanted: str | None = None
    missed: dict[str, int] = field(default_factory=dict)
    looked_from: set[str] = field(default_factory=set)

    @property
    def secs(self) -> float:
        return self.frame.sim_time - self.began

    def values(self) -> dict[str, float]:
        return {
            "frames": float(self.frames),
            "seconds": round(self.secs, 3),
            "metres": round(self.metres, 3),
            "replans": float(self.replans),
            "detours": float(self.detours),
            "viewpoints": float(self.tried),
        }


@dataclass(slots=True)
class Seeker:
    """Carries out one episode a goal. An episode always ends with an outcome: success or a named reason.

    `capture(command)` steps the source and gives its frame, None when there are no more; `take(frame,
    command)` pushes it through the pipeline; `collisions()` counts contacts so far.
    """

    llm: Llm
    grounding: Grounding
    navigation: Navigation
    names: dict[str, str]
    graph: SceneGraph
    pipeline: Pipeline
    guard: Guard
    bus: ObserverBus
    capture: Callable[[Command], Frame | None]
    take: Callable[[Frame, Command], None]
    collisions: Callable[[], int]
    limits: EpisodeLimits = EpisodeLimits()
    out_of_frames: str = "out of time"
    """The reason where `capture` has no more frames to give."""
    _touched: bool = field(default=False, init=False)

    def seek(self, episode: int, goal: str, frame: Frame) -> tuple[EpisodeEnded, Frame]:
        """One episode from where the robot stands; returns its end and the last frame."""
        trip = _Trip(frame, frame.sim_time, self.collisions())
        if self._touched:
            self._back_off(trip)
        with self.pipeline.stage("llm"):
            target = self._target(goal)
        reason = "no target graph" if target is None else self._search(target, trip)
        self._touched = reason == COLLISION
        success = reason == SUCCESS
        ended = EpisodeEnded(
            episode,
            goal,
            "success" if success else "failure",
            "" if success else reason,
            trip.frame.index,
            trip.frame.sim_time,
            trip.values(),
        )
        self.bus.tell(ended)
        return ended, trip.frame

    def _target(self, goal: str) -> TargetGraph | None:
        def ask() -> TargetGraph:
            answer = self.llm.complete("target_graph", target_graph_request(goal), TARGET_GRAPH_SCHEMA)
            return parse_target_graph(goal, answer.value)

        target: TargetGraph | None = self.guard.call(self.names["llm"], "complete", ask, default=None)
        return target

    def _ground(self, target: TargetGraph, frame: Frame) -> tuple[Candidate, ...]:
        with self.pipeline.stage("grounding"):
            candidates: Sequence[Candidate] = self.guard.call(
                self.names["grounding"],
                "ground",
                lambda: self.grounding.ground(target),
                check=lambda value: checks.check_candidates(self.graph, value),
                default=(),
            )
        self.bus.tell(
            Matched(target.text, frame.index, frame.sim_time, target_graph_json(target), tuple(candidates))
        )
        return tuple(candidates)

    def _search(self, target: TargetGraph, trip: _Trip) -> str:
        """Drive to one candidate after the other until the target is seen; `success` or the reason."""
        core, reason, trip.target = str(target.core), "no match", target
        candidates = self._ground(target, trip.frame)
        trip.wanted = next((one.matching[core] for one in candidates if core in one.matching), None)
        while trip.tried < self.limits.candidates:
            waiting = self._worth_trying(candidates, core, trip)
            if not waiting:
                break
            trip.tried += 1
            outcome, viewpoint_id = self._drive(waiting, core, trip)
            if outcome == SEEN:
                return SUCCESS
            if outcome != SUCCESS:
                # Where it has looked in vain the match was wrong, however the drive to the next one ends.
                return reason if outcome == "no path" and reason == "wrong match" else outcome
            reason = "wrong match"
            places = [candidate.viewpoint_id for candidate in waiting]
            at = places.index(viewpoint_id) if viewpoint_id in places else 0
            missing = waiting[at].matching.get(core, "")
            trip.missed[missing] = trip.missed.get(missing, 0) + 1
            trip.looked_from.add(places[at])
            self._tell(trip.frame, "missing", f"{missing or 'the target'} is not in view from {viewpoint_id}")
            # The drive has changed the map: what vanished, moved or came to light counts for the next one.
            candidates = self._ground(target, trip.frame)
        return reason

    def _worth_trying(self, candidates: Sequence[Candidate], core: str, trip: _Trip) -> list[Candidate]:
        """Candidates not yet tried whose core object may be there; else those of vanished objects."""
        left = [
            candidate
            for candidate in candidates
            if candidate.viewpoint_id in self.graph.viewpoints
            and candidate.viewpoint_id not in trip.looked_from
            and trip.missed.get(candidate.matching.get(core, ""), 0) < _LOOKS_AN_OBJECT
        ]
        present = [candidate for candidate in left if self._is_there(candidate.matching.get(core))]
        return present or left

    def _is_there(self, object_id: str | None) -> bool:
        node = None if object_id is None else self.graph.objects.get(object_id)
        return object_id is None or (node is not None and node.state != DISAPPEARED)

    # -- driving ----------------------------------------------------------------------------------------

    def _drive(self, waiting: Sequence[Candidate], core: str, trip: _Trip) -> tuple[str, str]:
        """Follow navigation's commands; how it ended and which viewpoint it drove to.

        `seen`: the target is in view; `success`: the viewpoint was reached and looked from, in vain.
        """
        goals = [candidate.viewpoint_id for candidate in waiting]
        matched = {candidate.viewpoint_id: candidate.matching.get(core) for candidate in waiting}
        name, failed, state = self.names["navigation"], object(), ""
        begun = self.guard.call(
            name, "start", lambda: self.navigation.start(trip.frame, goals), default=failed
        )
        if begun is failed:
            return "navigation failed", ""
        step = self._step(trip.frame)
        while step is not None:
            if step.changes:
                self.pipeline.apply_changes(name, trip.frame, step.changes)
            if step.state != state or step.outcome:
                trip.replans += step.state == "replan"
                trip.detours += step.state == "detour"
                state = step.state
                self.bus.tell(
                    NavigationChanged(trip.frame.index, trip.frame.sim_time, state, step.detail, step.path)
                )
            goal = step.goal or goals[0]
            if step.at_stop and (state == "look" or step.outcome == SUCCESS):
                seen = self._sighted(matched.get(goal) or trip.wanted, trip)
                if seen is not None:
                    self._tell(trip.frame, SEEN, f"{seen.id} ({seen.label}) from {goal}")
                    return SEEN, goal
            if step.outcome:
                return step.outcome, goal
            if trip.secs > self.limits.secs or trip.metres > self.limits.metres:
                return "out of time", goal
            following = self.capture(step.command)
            if following is None:
                return self.out_of_frames, goal
            # Navigation says of the new frame whether it was taken looking; only then is it put into the map.
            command, step = step.command, self._step(following)
            following = replace(following, at_stop=step is not None and step.at_stop)
            self._move(trip, following, command)
            if self.collisions() > trip.collisions:
                self._feel(trip.frame, command)
                return COLLISION, goal
        return "navigation failed", ""

    def _back_off(self, trip: _Trip) -> None:
        """Straight back from what the last episode touched: it came from there."""
        begin, command = floor_place(trip.frame), Command(linear=-_BACK_MPS, tilt=trip.frame.tilt_rad)
        for _ in range(_BACK_FRAMES):
            if math.dist(begin, floor_place(trip.frame)) >= _BACK_M:
                break
            following = self.capture(command)
            if following is None:
                break
            self._move(trip, following, command)
        self._tell(trip.frame, "back", "off what was touched")

    def _feel(self, frame: Frame, command: Command) -> None:
        """Let navigation remember what was touched, if it can: later episodes shall not drive there again."""
        if isinstance(self.navigation, FeelsTouch):
            self.guard.call(
                self.names["navigation"],
                "touched",
                self.navigation.touched,
                frame.without_truth(),
                command,
                default=None,
            )
        x, y = floor_place(frame)
        self._tell(frame, "touch", f"something, at {x:.2f} {y:.2f}")

    def _move(self, trip: _Trip, frame: Frame, command: Command) -> None:
        """Take in the next frame of an episode, to which the command led."""
        trip.frames += 1
        trip.metres += math.dist(floor_place(trip.frame), floor_place(frame))
        trip.frame = frame
        self.take(frame, command)

    def _step(self, frame: Frame) -> Step | None:
        with self.pipeline.stage("navigation"):
            self.guard.at(frame.index, frame.sim_time)
            step: Step | None = self.guard.call(
                self.names["navigation"],
                "step",
                lambda: self.navigation.step(frame.without_truth()),
                check=checks.check_step,
                default=None,
            )
        return step

    def _sighted(self, object_id: str | None, trip: _Trip) -> ObjectNode | None:
        """The object itself if the newest frame observed it, else one of its label that fits as well."""
        wanted = None if object_id is None else self.graph.objects.get(object_id)
        if wanted is None:
            return None
        alike = [
            node
            for node in self.graph.objects.values()
            if node.label == wanted.label and self._is_in_view(node, trip.frame)
        ]
        return next((node for node in alike if node.id == object_id), None) or next(
            (node for node in alike if self._fits_as_well(node, wanted, trip)), None
        )

    def _fits_as_well(self, node: ObjectNode, wanted: ObjectNode, trip: _Trip) -> bool:
        """Whether a sentence that tells more than a name is true of another thing of the name, too."""
        target = trip.target
        if target is None or target.kind != "explicit":
            return True
        if not target.edges and not target.nodes[target.core].attributes:
            return True
        best: dict[str, float] = {}
        for candidate in self._ground(target, trip.frame):
            name = candidate.matching.get(str(target.core), "")
            best[name] = max(best.get(name, 0.0), candidate.scores.get("score", 0.0))
        return node.id in best and best[node.id] >= _AS_GOOD * best.get(wanted.id, 0.0)

    @staticmethod
    def _is_in_view(node: ObjectNode, frame: Frame) -> bool:
        if node.state == DISAPPEARED or frame.index not in node.frames[-1:]:
            return False
        return float(box_distance(frame.position, frame.position, node.box_min, node.box_max)) <= IN_VIEW_M

    def _tell(self, frame: Frame, state: str, detail: str) -> None:
        self.bus.tell(NavigationChanged(frame.index, frame.sim_time, state, detail))
