"""A whole run: build the plug-ins, carry out the phases, tell the observers, sum up."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from dssmsg import checks
from dssmsg.config import RunConfig
from dssmsg.contexts import ContextFactory
from dssmsg.errors import ConfigError, InputError
from dssmsg.events import (
    EpisodeEnded,
    ErrorOccurred,
    Logged,
    NavigationChanged,
    PhaseStarted,
    RunFinished,
    RunStarted,
)
from dssmsg.frame import Frame
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.nodes import BELIEVED
from dssmsg.graph.read_only import ReadOnlyGraph
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.graph.waypoints import WaypointTopology
from dssmsg.guard import Guard, LastWords, say_on_stderr
from dssmsg.host import Built, Host
from dssmsg.interfaces import Command, Observer, WatchesFloor
from dssmsg.lift import Lifter
from dssmsg.mission.bus import ObserverBus
from dssmsg.mission.identity import installed_versions, new_run_id
from dssmsg.mission.keyframes import KeyFrameSelector, key_frame_rule
from dssmsg.mission.llm_log import LoggedLlm
from dssmsg.mission.log_events import logged_as_events
from dssmsg.mission.pipeline import Pipeline, Plugins
from dssmsg.mission.plugin_set import PluginSet
from dssmsg.mission.seek import EpisodeLimits, Seeker
from dssmsg.mission.survey import Surveyor
from dssmsg.mission.topology import FloorPlan, TopologyKeeper
from dssmsg.navigation.drive import Driver
from dssmsg.navigation.grid import GridOptions, RollingGrid

_log = logging.getLogger("dssmsg.mission")


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run comes to: the summary that `run --json` prints, the graph, and the exit code."""

    summary: dict[str, Any]
    graph: SceneGraph
    exit_code: int


def run_mission(
    config: RunConfig,
    host: Host,
    *,
    observers: Sequence[tuple[str, Observer]] = (),
    last_words: LastWords = say_on_stderr,
) -> RunResult:
    """Carry out the mission of a configuration.

    `observers` are told everything besides the configured ones; `last_words` says why the process ends where
    a plug-in hangs. Raises ConfigError, InputError before
    anything is written; PluginError with `on_error: fail`, StorageError when the disk gives out.
    """
    host.check(config)
    mission = Mission(config, host, observers, last_words)
    return mission.run()


class Mission:
    """One run. Built in its constructor, carried out by `run`."""

    def __init__(
        self,
        config: RunConfig,
        host: Host,
        observers: Sequence[tuple[str, Observer]] = (),
        last_words: LastWords = say_on_stderr,
        lifter: Lifter | None = None,
    ) -> None:
        self._lifter = lifter or Lifter()
        self._config = config
        self._host = host
        self._started = perf_counter()
        self._run_id = new_run_id(config)
        self.graph = SceneGraph()
        self._contexts = ContextFactory(
            host,
            config.seed,
            ReadOnlyGraph(self.graph),
            IdAllocator(),
            config.base_dir,
            Path(config.recording.directory),
            self._run_id,
            timeout_secs=config.timeout_secs,
        )
        self._plugins = PluginSet(config, host, self._contexts, self._logged_llm)
        self._source, self._info = self._plugins.source, self._plugins.info
        self._guard = Guard(
            config.on_error,
            config.timeout_secs,
            report=lambda event: self._bus.tell(event),
            on_hang=lambda: self._bus.close(),
            last_words=last_words,
        )
        self._bus = ObserverBus([*self._plugins.observers, *observers], self._guard.watching)
        self._pipeline = self._make_pipeline()
        self._driver = Driver(
            config.mission.linear_speed,
            config.mission.angular_speed,
            self._info.rate_hz,
            linear_acceleration=self._info.accelerations[0],
            angular_acceleration=self._info.accelerations[1],
        )
        self._episodes: list[EpisodeEnded] = []
        self._skipped_stops: list[str] = []
        self._visit = -1
        self._frame: Frame | None = None
        self._phase_state = ("", "")
        self._distance = 0.0
        self._out_of_frames = False
        self._collisions = 0

    def run(self) -> RunResult:
        """Carry out all phases; the observers are closed and the source released however it ends."""
        try:
            self._bus.tell(self._start_event())
            try:
                with logged_as_events(self._bus.tell, self._now):
                    self._phases()
                self._give_up_untried_goals()
            finally:
                self._guard.call(self._source_id, "close", self._source.close, default=None)
            summary = self._summary()
            self._bus.tell(RunFinished(*self._now(), summary))
        finally:
            self._guard.close()
            self._bus.close()
        outputs = self._bus.outputs()
        summary = {"recording": outputs.pop("recording", None), **summary}
        if outputs:
            summary["outputs"] = outputs
        return RunResult(summary, self.graph, 1 if self._bus.failed else 0)

    # Building

    @property
    def _source_id(self) -> str:
        return self._plugins.id("source")

    def _logged_llm(self, built: Built) -> LoggedLlm:
        # The bus and the guard come to be after the plug-ins; nobody asks before.
        return LoggedLlm(
            built.plugin,
            built.registration.name,
            lambda event: self._bus.tell(event),
            self._now,
            lambda: self._guard.watching(built.registration.id, "complete"),
        )

    def _make_pipeline(self) -> Pipeline:
        built = self._plugins
        plugins = Plugins(
            perception=built["perception"].plugin,
            association=built["association"].plugin,
            update=built["update"].plugin,
            perception_name=built.id("perception"),
            association_name=built.id("association"),
            update_name=built.id("update"),
            perception_needs_truth=built["perception"].registration.needs_truth,
        )
        return Pipeline(
            plugins,
            self.graph,
            WaypointTopology(self.graph, self._contexts.ids),
            self._lifter,
            KeyFrameSelector(key_frame_rule(self._config.mission)),
            self._guard,
            self._bus,
            TopologyKeeper(self.graph, self._contexts.ids, self._floor_plan()),
        )

    def _floor_plan(self) -> FloorPlan:
        return RollingGrid(GridOptions(noise=self._info.depth_noise_m))

    def _start_event(self) -> RunStarted:
        return RunStarted(
            run_id=self._run_id,
            name=self._config.name,
            seed=self._config.seed,
            config=self._host.resolved(self._config),
            source=self._info,
            plugins={
                key: {"name": made.name, "version": made.version, "origin": made.origin}
                for key, made in self._contexts.made.items()
            },
            versions=installed_versions(),
            parent=self._info.facts.get("parent"),
            feature_space=self._plugins["perception"].plugin.feature_space,
        )

    # Phases

    def _phases(self) -> None:
        phases = self._config.mission.phases
        if not self._info.drivable:
            if "seek" in phases:
                self._skip("mission", f"source {self._info.name} cannot be driven", "phase seek")
            visits = self._info.visits or 1
            for visit in range(visits):
                if self._is_out_of_frames():
                    break
                self._begin("survey" if visit == 0 else "revisit", visit)
                self._play()
                self._end_visit()
            return
        for phase in phases:
            if self._is_out_of_frames():
                break
            if phase == "seek":
                later = self._config.mission.seek_visit == "next"
                self._begin("seek", max(self._visit + later, 0))
                self._seek()
                self._end_visit()
            else:
                self._begin(phase, self._visit + 1)
                self._survey()
                self._end_visit()

    def _begin(self, phase: str, visit: int) -> None:
        if visit != self._visit:
            self._start_visit(visit)
            self._visit = visit
        index, sim_time = (self._frame.index + 1, self._frame.sim_time) if self._frame else (0, 0.0)
        self._bus.tell(PhaseStarted(phase, visit, index, sim_time))

    def _start_visit(self, visit: int) -> None:
        with self._pipeline.stage("source"):
            self._guard.call(self._source_id, "start_visit", lambda: self._source.start_visit(visit))

    def _end_visit(self) -> None:
        if self._frame is not None:
            self._pipeline.finish_visit(self._frame)

    def _play(self) -> None:
        """A source that cannot be driven: take its frames as they come."""
        while (frame := self._capture(None)) is not None:
            self._take(frame, None)
        if self._frame is None:
            raise InputError(f"source {self._info.name} gave no frame", key="source")

    def _survey(self) -> None:
        tours = self._info.tours
        if not tours:
            raise ConfigError(f"scene '{self._info.scene}' has no tour to drive", key="source.scene")
        mission = self._config.mission
        surveyor = Surveyor(
            tours[min(self._visit, len(tours) - 1)],
            self._driver,
            looks=mission.views_per_heading,
            look_step_rad=math.radians(mission.heading_step_deg),
        )
        command = Command()
        while (frame := self._capture(command)) is not None:
            step = surveyor.advance(frame)
            if step is None:
                self._take(frame, command)
                break
            self._take(replace(frame, at_stop=step.at_stop), command)
            self._tell_state(frame, step.state, step.detail, step.target_xy)
            if step.state == "done":
                break
            command = step.command
        for name in surveyor.skipped:
            self._skip("mission", f"stop {name} could not be reached", f"stop {name}")
        self._skipped_stops += surveyor.skipped

    def _seeker(self) -> Seeker:
        built, mission = self._plugins, self._config.mission
        assert self._contexts.llm is not None  # built before any phase
        return Seeker(
            llm=self._contexts.llm,
            grounding=built["grounding"].plugin,
            navigation=built["navigation"].plugin,
            names={kind: built.id(kind) for kind in ("llm", "grounding", "navigation")},
            graph=self.graph,
            pipeline=self._pipeline,
            guard=self._guard,
            bus=self._bus,
            capture=self._capture,
            take=self._take,
            collisions=lambda: self._collisions,
            limits=EpisodeLimits(mission.candidates, mission.episode_secs, mission.episode_metres),
        )

    def _seek(self) -> None:
        seeker = self._seeker()
        frame = self._frame or self._advance(Command())
        for goal in self._config.mission.goals:
            if frame is None:
                raise InputError(f"source {self._info.name} gave no frame", key="source")
            if self._is_out_of_frames():
                break
            ended, frame = seeker.seek(len(self._episodes), goal, frame)
            self._episodes.append(ended)

    def _give_up_untried_goals(self) -> None:
        """A goal that was asked for ends as an episode, also where the run ended before its turn."""
        if "seek" not in self._config.mission.phases:
            return
        for goal in self._config.mission.goals[len(self._episodes) :]:
            ended = EpisodeEnded(len(self._episodes), goal, "failure", "not begun", *self._now())
            self._bus.tell(ended)
            self._episodes.append(ended)

    def _advance(self, command: Command) -> Frame | None:
        frame = self._capture(command)
        if frame is not None:
            self._take(frame, command)
        return frame

    def _capture(self, command: Command | None) -> Frame | None:
        """The next frame of the source; None at the end of the visit or of the frame budget."""
        if self._is_out_of_frames():
            return None
        with self._pipeline.stage("source"):
            return self._step(command)

    def _step(self, command: Command | None) -> Frame | None:
        frame: Frame | None = self._guard.call(
            self._source_id,
            "step",
            lambda: self._source.step(command),
            check=lambda value: checks.check_frame(value, self._info, self._frame),
        )
        return frame

    def _count_collisions(self) -> int:
        count: int = self._guard.call(
            self._source_id, "collisions", self._source.collisions, check=checks.check_count
        )
        return count

    def _is_out_of_frames(self) -> bool:
        """Whether `mission.max_frames` is used up; said once, in the log: it is a wish, not a fault."""
        budget = self._config.mission.max_frames
        if self._pipeline.tally.frames < budget:
            return False
        if not self._out_of_frames:
            self._out_of_frames = True
            message = f"mission.max_frames ({budget}) is used up in visit {self._visit}; the rest is left out"
            self._bus.tell(Logged(*self._now(), "dssmsg.mission", "WARNING", message))
        return True

    def _take(self, frame: Frame, command: Command | None) -> None:
        if self._frame is not None and self._frame.visit == frame.visit:
            step = frame.world_from_base[:2, 3] - self._frame.world_from_base[:2, 3]
            self._distance += float(math.hypot(*step))
        self._frame = frame
        self._collisions = self._count_collisions()
        navigation = self._plugins["navigation"].plugin
        if isinstance(navigation, WatchesFloor) and "seek" in self._config.mission.phases:
            name = self._plugins.id("navigation")
            with self._pipeline.stage("navigation"):
                self._guard.call(name, "watch", navigation.watch, frame.without_truth(), default=None)
        self._pipeline.process(frame, command, self._collisions)

    def _tell_state(self, frame: Frame, state: str, detail: str, target_xy: tuple[float, float]) -> None:
        if (state, detail) != self._phase_state:
            self._phase_state = (state, detail)
            self._bus.tell(NavigationChanged(frame.index, frame.sim_time, state, detail, target_xy=target_xy))

    def _now(self) -> tuple[int, float]:
        return (self._frame.index, self._frame.sim_time) if self._frame else (-1, 0.0)

    def _skip(self, who: str, message: str, skipped: str) -> None:
        self._bus.tell(ErrorOccurred(*self._now(), who, message, skipped))

    # Summing up

    def _summary(self) -> dict[str, Any]:
        tally, objects = self._pipeline.tally, self.graph.objects.values()
        believed = sum(node.status == BELIEVED for node in objects)
        return {
            "name": self._config.name,
            "run_id": self._run_id,
            "seed": self._config.seed,
            "source": self._info.name,
            "scene": self._info.scene,
            "notes": [
                str(self._info.facts[key]) for key in ("furniture", "renderer") if key in self._info.facts
            ],
            "frames": tally.frames,
            "key_frames": tally.key_frames,
            "objects": believed,
            "tentative": len(objects) - believed,
            "waypoints": len(self.graph.waypoints),
            "viewpoints": len(self.graph.viewpoints),
            "changes": dict(sorted(tally.changes.items())),
            "dropped_detections": dict(sorted(tally.dropped.items())),
            "episodes": [{"goal": e.goal, "outcome": e.outcome, "reason": e.reason} for e in self._episodes],
            "errors": self._bus.errors,
            "failures": dict(sorted(self._guard.errors.items())),
            "collisions": self._collisions,
            "out_of_frames": self._out_of_frames,
            "skipped_stops": list(self._skipped_stops),
            "distance_m": round(self._distance, 2),
            "sim_seconds": round(self._frame.sim_time, 3) if self._frame else 0.0,
            "seconds": {
                **{name: round(value, 3) for name, value in tally.seconds.items()},
                "total": round(perf_counter() - self._started, 3),
            },
        }
