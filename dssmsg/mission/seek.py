"""The seek phase: a sentence, its target graph, the best viewpoint, and the drive there (ALGORITHM D, E)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dssmsg import checks
from dssmsg.events import EpisodeEnded, Matched, NavigationChanged
from dssmsg.frame import Frame
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.guard import Guard
from dssmsg.interfaces import Command, Grounding, Llm, Navigation, TargetGraph
from dssmsg.mission.bus import ObserverBus
from dssmsg.mission.goal import (
    TARGET_GRAPH_SCHEMA,
    parse_target_graph,
    target_graph_json,
    target_graph_request,
)
from dssmsg.mission.pipeline import Pipeline


@dataclass(slots=True)
class Seeker:
    """Carries out one episode a goal. An episode always ends with an outcome: success or a named reason.

    `advance(command)` steps the source and pushes the frame through the pipeline; None when there are no
    more frames.
    """

    llm: Llm
    grounding: Grounding
    navigation: Navigation
    names: dict[str, str]
    graph: SceneGraph
    pipeline: Pipeline
    guard: Guard
    bus: ObserverBus
    advance: Callable[[Command], Frame | None]
    max_frames: int

    def seek(self, episode: int, goal: str, frame: Frame) -> tuple[EpisodeEnded, Frame]:
        """One episode from where the robot stands; returns its end and the last frame."""
        reason, target = "", None
        with self.pipeline.stage("llm"):
            target = self._target(goal)
        goals: tuple[str, ...] = ()
        if target is None:
            reason = "no target graph"
        else:
            with self.pipeline.stage("grounding"):
                goals = self._ground(target, frame)
            if not goals:
                reason = "no match"
        frames = 0
        if not reason:
            reason, frame, frames = self._drive(goals, frame)
        outcome = "success" if reason == "success" else "failure"
        ended = EpisodeEnded(
            episode,
            goal,
            outcome,
            "" if outcome == "success" else reason,
            frame.index,
            frame.sim_time,
            {"frames": float(frames)},
        )
        self.bus.tell(ended)
        return ended, frame

    def _target(self, goal: str) -> TargetGraph | None:
        def ask() -> TargetGraph:
            answer = self.llm.complete("target_graph", target_graph_request(goal), TARGET_GRAPH_SCHEMA)
            return parse_target_graph(goal, answer.value)

        target: TargetGraph | None = self.guard.call(self.names["llm"], "complete", ask, default=None)
        return target

    def _ground(self, target: TargetGraph, frame: Frame) -> tuple[str, ...]:
        candidates = self.guard.call(
            self.names["grounding"],
            "ground",
            lambda: self.grounding.ground(target),
            check=lambda value: checks.check_candidates(self.graph, value),
            default=(),
        )
        self.bus.tell(
            Matched(target.text, frame.index, frame.sim_time, target_graph_json(target), tuple(candidates))
        )
        return tuple(candidate.viewpoint_id for candidate in candidates)

    def _drive(self, goals: tuple[str, ...], frame: Frame) -> tuple[str, Frame, int]:
        name, failed = self.names["navigation"], object()
        state, frames = "", 0
        if (
            self.guard.call(name, "start", lambda: self.navigation.start(frame, goals), default=failed)
            is failed
        ):
            return "navigation failed", frame, frames
        while frames < self.max_frames:
            current = frame
            with self.pipeline.stage("navigation"):
                step = self.guard.call(
                    name,
                    "step",
                    lambda: self.navigation.step(current.without_truth()),  # noqa: B023 - called at once
                    check=checks.check_step,
                    default=None,
                )
            if step is None:
                return "navigation failed", frame, frames
            if step.changes:
                self.pipeline.apply_changes(name, frame, step.changes)
            if step.state != state or step.outcome:
                state = step.state
                self.bus.tell(NavigationChanged(frame.index, frame.sim_time, state, step.detail, step.path))
            if step.outcome:
                return step.outcome, frame, frames
            following = self.advance(step.command)
            if following is None:
                return "out of time", frame, frames
            frame, frames = following, frames + 1
        return "out of time", frame, frames
