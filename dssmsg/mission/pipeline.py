"""One frame through the plug-ins: perception -> lift -> association -> edges -> update -> observers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter

from dssmsg import checks
from dssmsg.events import Detected, FrameCaptured, GraphChanged, StageTimed, TruthSeen, WindowEvaluated
from dssmsg.frame import Detection, Frame, Observation
from dssmsg.graph.changes import Cause, Change, ObjectAdded, ObjectMerged, ObjectsJoined
from dssmsg.graph.edges import edge_changes
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.graph.waypoints import WaypointTopology
from dssmsg.guard import Guard
from dssmsg.interfaces import Association, Command, Perception, Update, UpdateResult
from dssmsg.lift import Lifter
from dssmsg.mission.bus import ObserverBus
from dssmsg.mission.keyframes import KeyFrameSelector
from dssmsg.mission.topology import TopologyKeeper


@dataclass(slots=True)
class Plugins:
    """The built plug-ins of the mapping side, with the names that errors carry."""

    perception: Perception
    association: Association
    update: Update
    perception_name: str
    association_name: str
    update_name: str
    perception_needs_truth: bool


@dataclass(slots=True)
class Tally:
    """What the summary counts."""

    frames: int = 0
    key_frames: int = 0
    changes: dict[str, int] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


class Pipeline:
    """Carries every frame through the plug-ins, applies their changes and tells the observers.

    The changes of one plug-in for one frame apply all or none; a batch that the graph refuses is that
    plug-in's error. Observers get all changes of a frame in one event, stamped.
    """

    def __init__(
        self,
        plugins: Plugins,
        graph: SceneGraph,
        topology: WaypointTopology,
        lifter: Lifter,
        selector: KeyFrameSelector,
        guard: Guard,
        bus: ObserverBus,
        keeper: TopologyKeeper,
    ) -> None:
        self._keeper = keeper
        self._plugins = plugins
        self._graph = graph
        self._topology = topology
        self._lifter = lifter
        self._selector = selector
        self._guard = guard
        self._bus = bus
        self._stages: dict[str, float] = {}
        self.tally = Tally()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage of the current frame; the seconds go into `StageTimed` and the summary."""
        start = perf_counter()
        try:
            yield
        finally:
            self._stages[name] = self._stages.get(name, 0.0) + perf_counter() - start

    def process(self, frame: Frame, command: Command | None, collisions: int) -> None:
        """One frame from the source, in order; `command` led to it."""
        self.tally.frames += 1
        self._guard.at(frame.index, frame.sim_time)
        plain = frame.without_truth()
        key = self._selector.is_key(plain)
        viewpoint_id: str | None = None
        applied: list[Change] = []
        detected: Detected | None = None
        windows: Sequence[WindowEvaluated] = ()
        if key:
            self.tally.key_frames += 1
            with self.stage("waypoints"):
                viewpoint_id, changes = self._topology.observe(plain)
                applied += self._graph.apply_all(changes, frame.index, frame.sim_time)
            detected, changes_of_map, windows = self._map(frame, plain, viewpoint_id)
            applied += changes_of_map
        with self.stage("topology"):
            changes = self._keeper.observe(plain, key=key, viewpoint_id=viewpoint_id)
            applied += self._graph.apply_all(changes, frame.index, frame.sim_time)
        with self.stage("observers"):
            self._bus.tell(FrameCaptured(plain, command, key, viewpoint_id, collisions))
            if frame.truth is not None:
                self._bus.tell(TruthSeen(frame.index, frame.sim_time, frame.truth))
            if detected is not None:
                self._bus.tell(detected)
            for window in windows:
                self._bus.tell(window)
            self._tell_changes(frame, applied)
        self._tell_times(frame)

    def finish_visit(self, frame: Frame) -> None:
        """A visit is over after `frame`: the last merge pass, the last verdicts."""
        self._guard.at(frame.index, frame.sim_time)
        with self.stage("association"):
            name = self._plugins.association_name
            joined = self._guard.call(
                name, "finish", self._plugins.association.finish, check=checks.check_changes, default=()
            )
            applied = self._apply(name, frame, joined)
        with self.stage("update"):
            name = self._plugins.update_name
            result = self._guard.call(
                name, "finish", self._plugins.update.finish, check=checks.check_update, default=UpdateResult()
            )
            applied += self._apply(name, frame, result.changes)
        with self.stage("observers"):
            for window in result.windows:
                self._bus.tell(window)
            self._tell_changes(frame, applied)
        self._tell_times(frame)

    def apply_changes(self, plugin: str, frame: Frame, changes: Sequence[Change]) -> None:
        """Apply changes that another part of the mission asks for (navigation), and tell the observers."""
        self._tell_changes(frame, self._apply(plugin, frame, changes))

    def _map(
        self, frame: Frame, plain: Frame, viewpoint_id: str | None
    ) -> tuple[Detected | None, list[Change], Sequence[WindowEvaluated]]:
        plugins, guard = self._plugins, self._guard
        with self.stage("perception"):
            seen = frame if plugins.perception_needs_truth else plain
            detections: Sequence[Detection] = guard.call(
                plugins.perception_name,
                "detect",
                lambda: plugins.perception.detect(seen),
                check=lambda value: checks.check_detections(plain, value),
                default=None,
            )
            if detections is None:
                return None, [], ()
        with self.stage("lift"):
            lifted = self._lifter.lift(plain, detections)
            observations = lifted.observations
            for reason, count in lifted.dropped.items():
                self.tally.dropped[reason] = self.tally.dropped.get(reason, 0) + count
        detected = Detected(plain.index, plain.sim_time, tuple(detections), tuple(observations), lifted.kept)
        with self.stage("association"):
            name = plugins.association_name
            changes = guard.call(
                name,
                "associate",
                lambda: plugins.association.associate(plain, observations, viewpoint_id),
                check=checks.check_changes,
                default=(),
            )
            applied = self._apply(name, plain, changes)
        with self.stage("edges"):
            object_ids = object_ids_of(observations, applied)
            seen_ids = [object_id for object_id in object_ids if object_id is not None]
            applied += self._graph.apply_all(
                edge_changes(
                    self._graph, seen_ids, viewpoint_id, plain, Cause("graph/edges", "seen together")
                ),
                plain.index,
                plain.sim_time,
            )
        with self.stage("update"):
            name = plugins.update_name
            result: UpdateResult = guard.call(
                name,
                "update",
                lambda: plugins.update.update(plain, observations, object_ids, viewpoint_id),
                check=checks.check_update,
                default=UpdateResult(),
            )
            applied += self._apply(name, plain, result.changes)
        return detected, applied, result.windows

    def _apply(self, plugin: str, frame: Frame, changes: Sequence[Change]) -> list[Change]:
        """Apply a plug-in's batch, all or none; a refused batch is the plug-in's error."""
        stamped: Sequence[Change] = self._guard.call(
            plugin,
            "changes",
            lambda: self._graph.apply_all(changes, frame.index, frame.sim_time),
            default=(),
        )
        return list(stamped)

    def _tell_changes(self, frame: Frame, applied: Sequence[Change]) -> None:
        if not applied:
            return
        for change in applied:
            self.tally.changes[change.kind] = self.tally.changes.get(change.kind, 0) + 1
        self._bus.tell(GraphChanged(frame.index, frame.sim_time, tuple(applied)))

    def _tell_times(self, frame: Frame) -> None:
        for name, seconds in self._stages.items():
            self.tally.seconds[name] = self.tally.seconds.get(name, 0.0) + seconds
        timed, self._stages = self._stages, {}
        start = perf_counter()
        self._bus.tell(StageTimed(frame.index, frame.sim_time, timed))
        self._stages["observers"] = perf_counter() - start


def object_ids_of(observations: Sequence[Observation], applied: Sequence[Change]) -> list[str | None]:
    """What each observation became, read off the applied changes; None where it was left out."""
    became: dict[int, str] = {}
    for change in applied:
        if isinstance(change, ObjectAdded | ObjectMerged):
            became[change.detection] = change.object_id
        elif isinstance(change, ObjectsJoined):
            became = {
                index: change.object_id if object_id == change.absorbed_id else object_id
                for index, object_id in became.items()
            }
    return [became.get(observation.detection_index) for observation in observations]
