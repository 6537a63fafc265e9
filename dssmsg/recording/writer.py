"""Writes the events of a run into one `.rrd` file. Synchronous; the `rerun` observer gives it a thread.

The file is created exclusively, and everything told before a `flush` is in the file (and would outlive
this process) once `flush` returns. Memory does not grow with the number of frames.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from dssmsg import events
from dssmsg.graph import codec
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.recording import describe, palette, rows, schema
from dssmsg.recording.blueprint import eye_over, make_layout
from dssmsg.recording.camera_log import CameraLog
from dssmsg.recording.images import Encoding
from dssmsg.recording.match_log import MatchLog
from dssmsg.recording.messages import MessageFile
from dssmsg.recording.mission_card import MissionCard
from dssmsg.recording.reader import Recording
from dssmsg.recording.scene_log import SceneLog
from dssmsg.recording.sheets import SheetBook, Stamp, path_part
from dssmsg.recording.snapshots import SnapshotKeeper
from dssmsg.recording.window_log import WindowLog

_CHANGE_GROUPS = {
    "object_added": "objects added",
    "object_merged": "merges",
    "object_removed": "objects gone",
    "objects_joined": "objects gone",
    "edge_added": "edges added",
    "edge_removed": "edges removed",
}
_ABOVE_EDGES = np.array([0.0, 0.0, 0.1], dtype=np.float32)
"""Metres: the plan is drawn over the path edges that it follows."""


class RecordingWriter:
    """One recording in the making. Not thread-safe: one thread opens, writes, flushes and closes it.

    `copied` is a recording of the same frames in the same encoding: its images are taken over as they are.

    Raises StorageError where the file cannot be created (it exists, the folder is read-only) or a write
    failed (full disk), InputError where `copied` does not read.
    """

    def __init__(
        self,
        path: Path,
        recording_id: str,
        *,
        images: Encoding = "jpeg",
        quality: int = 80,
        layout: str = "review",
        copied: Path | None = None,
    ) -> None:
        self.path = path
        self._images: Encoding = images
        self._layout = layout
        self._copied = None if copied is None else Recording.open(copied)
        self._file = MessageFile(path)
        self._stream = rr.RecordingStream(
            schema.APPLICATION_ID,
            recording_id=recording_id,
            # Rows are batched here, a second at a time, and flushed by hand.
            batcher_config=rr.ChunkBatcherConfig(flush_tick=60.0),
        )
        # Not Rerun's own file sink: it truncates what is there, and waits for ever on a disk that is full.
        self._bytes = rr.binary_stream(self._stream)
        self._book = SheetBook(self._stream)
        self._camera = CameraLog(self._book, images, quality, self._copied)
        self._graph = SceneGraph()
        self._snapshots = SnapshotKeeper()
        self._scene = SceneLog(self._stream)
        self._scene_waits = False
        self._viewpoint: str | None = None
        self._card = MissionCard()
        self._candidate_rows = 0
        self._matches = MatchLog(self._book)
        self._windows = WindowLog(self._book)
        self._last = (0, 0.0)
        self._writers: dict[type, Callable[[Any], None]] = {
            events.RunStarted: self._run_started,
            events.PhaseStarted: self._phase_started,
            events.FrameCaptured: self._frame_captured,
            events.TruthSeen: self._truth_seen,
            events.Detected: self._detected,
            events.GraphChanged: self._graph_changed,
            events.WindowEvaluated: self._window_evaluated,
            events.Matched: self._matched,
            events.LlmCalled: self._llm_called,
            events.NavigationChanged: self._navigation_changed,
            events.Advised: self._advised,
            events.EpisodeEnded: self._episode_ended,
            events.ErrorOccurred: self._error_occurred,
            events.StageTimed: self._stage_timed,
            events.Logged: self._logged,
            events.RunFinished: self._run_finished,
        }
        self._scene.log_static()
        self._camera.log_static()
        for name, colour in palette.PLOT_COLOURS.items():
            self._book.log_now(f"{schema.PLOTS}/{name}", None, rr.SeriesLines(colors=[colour]))
        for lane in (schema.PHASE_STATE, schema.NAV_STATE):
            self._book.log_now(lane, None, palette.state_configuration())

    def write(self, event: events.Event) -> None:
        """Take an event into the next flush."""
        self._writers[type(event)](event)

    def flush(self) -> None:
        """Bring everything told so far into the file. Raises StorageError if that failed."""
        self._book.send()
        self._file.append(self._bytes.read() or b"")

    def close(self) -> None:
        """Draw what was left waiting, flush, and close the file; safe to call twice.

        The file then has no index yet: `dssmsg.recording.repair.optimize` gives it one.
        """
        try:
            if not self._file.closed:
                if self._scene_waits:
                    self._scene.update(self._graph, *self._last, viewpoint=self._viewpoint, everything=True)
                self.flush()
        finally:
            self._file.close()
            self._stream.disconnect()
            if self._copied is not None:
                self._copied.close()

    # Events, in the order of `dssmsg.events`.

    def _run_started(self, event: events.RunStarted) -> None:
        source = event.source
        facts = {
            "run_id": event.run_id,
            "name": event.name,
            "seed": event.seed,
            "schema_version": schema.SCHEMA_VERSION,
            "config": event.config,
            "plugins": event.plugins,
            "versions": event.versions,
            "parent": event.parent,
            "feature_space": event.feature_space,
            "images": self._images,
            "layout": self._layout,
            "source": {
                "name": source.name,
                "scene": source.scene,
                "drivable": source.drivable,
                "has_truth": source.has_truth,
                "visits": source.visits,
                "rate_hz": source.rate_hz,
                "credits": source.credits,
                "depth_noise_m": source.depth_noise_m,
                "accelerations": source.accelerations,
                "facts": source.facts,
            },
        }
        # Two layouts in one file would compete, so this one knows what is known before the first frame.
        stops = [(stop.x, stop.y, 0.0) for tour in source.tours for stop in tour]
        # The default, not the active one: which of two active ones wins depends on which is loaded first.
        layout = make_layout(self._layout, eye_over(stops, margin=3.6))
        self._stream.send_blueprint(layout, make_active=False, make_default=True)
        self._stream.send_recording_name(event.run_id)
        self._stream.send_property(
            schema.RUN_PROPERTY,
            rr.AnyValues(
                schema_version=schema.SCHEMA_VERSION,
                name=event.name,
                seed=event.seed,
                source=source.name,
                scene=source.scene,
                parent=event.parent or "",
                credits="\n".join(source.credits),
                plugins=rows.plain_json(event.plugins),
                versions=rows.plain_json(event.versions),
                config=rows.plain_json(event.config),
                json=rows.plain_json(facts),
            ),
        )
        self.flush()  # a recording that holds anything says what it is

    def _phase_started(self, event: events.PhaseStarted) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._book.add(
            schema.PHASES, stamp, {"phase": event.phase, "visit": event.visit, "index": event.frame}
        )
        self._book.look(schema.PHASE_STATE, rr.StateChange, stamp, state=event.phase)
        self._book.text(f"{schema.LOG}/run", stamp, f"phase {event.phase}, visit {event.visit}", "INFO")
        self._card.phase_started(event)
        self._show_mission()

    def _frame_captured(self, event: events.FrameCaptured) -> None:
        stamp = self._stamp(event.frame.index, event.frame.sim_time)
        self._camera.frame(event, stamp, self._graph.updates)
        self._viewpoint = event.viewpoint_id or self._viewpoint
        if self._scene_waits:
            self._draw_scene(stamp)

    def _truth_seen(self, event: events.TruthSeen) -> None:
        self._camera.truth(event, self._stamp(event.frame, event.sim_time))

    def _detected(self, event: events.Detected) -> None:
        self._camera.detections(event, self._stamp(event.frame, event.sim_time))

    def _graph_changed(self, event: events.GraphChanged) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        counts: dict[str, int] = dict.fromkeys(_CHANGE_GROUPS.values(), 0)
        for change in event.changes:
            row, blobs = codec.encode_stamped(change)
            own = self._stamp(change.frame, change.sim_time, update=change.update)
            self._book.add(
                schema.GRAPH_LOG,
                own,
                {
                    "kind": change.kind,
                    "subjects": ", ".join(change.subjects),
                    "cause": f"{change.cause.plugin}: {change.cause.rule}",
                    "scores": describe.scores_text(change.scores),
                    "json": codec.canonical_json(row),
                },
            )
            self._book.add_blobs(stamp, blobs)
            self._book.text(
                f"{schema.LOG}/graph",
                stamp,
                describe.change_line(change),
                "INFO",
                palette.CHANGE_COLOURS.get(change.kind, palette.ROBOT_COLOUR),
            )
            if change.kind in _CHANGE_GROUPS:
                counts[_CHANGE_GROUPS[change.kind]] += 1
        self._graph.follow(event.changes)
        if (snapshot := self._snapshots.row(self._graph, event.frame)) is not None:
            self._book.add(schema.SNAPSHOTS, stamp, snapshot)
        for group, count in counts.items():
            self._book.plot(f"changes/{group}", stamp, count)
        nodes = self._graph.objects.values()
        believed = sum(node.status == "believed" for node in nodes)
        self._book.plot("objects/believed", stamp, believed)
        self._book.plot("objects/tentative", stamp, len(nodes) - believed)
        self._book.plot("objects/waypoints", stamp, len(self._graph.waypoints))
        self._draw_scene(stamp)

    def _window_evaluated(self, event: events.WindowEvaluated) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        row = rows.window_row(event)
        self._book.add(schema.WINDOWS, stamp, row)
        self._windows.add(event, stamp, self._graph, self._camera.picture)
        if row["verdicts"]:
            self._book.text(
                f"{schema.LOG}/windows", stamp, f"{event.viewpoint_id}: {row['verdicts']}", "INFO"
            )

    def _matched(self, event: events.Matched) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._book.add(schema.MATCHES, stamp, rows.match_row(event))
        for candidate in event.candidates:
            self._candidate_rows += 1
            own = self._stamp(event.frame, event.sim_time, row=self._candidate_rows)
            self._book.add(schema.CANDIDATES, own, rows.candidate_row(event.query, candidate))
        if event.candidates:
            best = event.candidates[0]
            text = f"“{event.query}” -> {best.viewpoint_id}: {best.reason}"
        else:
            text = f"“{event.query}” matches nothing"
        self._book.text(f"{schema.LOG}/match", stamp, text, "INFO")
        self._matches.add(event, stamp, self._graph)
        self._card.matched(event)
        self._show_mission()

    def _llm_called(self, event: events.LlmCalled) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._book.add(schema.LLM_CALLS, stamp, rows.llm_row(event))
        answer = event.answer if event.ok else f"**failed:** {event.error}\n\n{event.answer}"
        self._book.look(
            f"{schema.LLM_TEXT}/{event.role}",
            rr.TextDocument,
            stamp,
            # The answer first: prompts are long, and the first lines are what is seen.
            text=f"## {event.role} ({event.provider})\n\n{answer}\n\n---\n\n{event.prompt}\n",
            media_type="text/markdown",
        )

    def _navigation_changed(self, event: events.NavigationChanged) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._book.add(schema.NAVIGATION, stamp, rows.navigation_row(event))
        self._book.look(schema.NAV_STATE, rr.StateChange, stamp, state=event.state)
        spots = [self._graph.waypoints[name].position for name in event.path if name in self._graph.waypoints]
        if self._camera.robot_spot is not None and spots:
            spots.insert(0, self._camera.robot_spot)
        self._book.log_now(
            schema.NAV_PATH,
            stamp,
            rr.LineStrips3D(
                [np.array(spots, dtype=np.float32) + _ABOVE_EDGES] if len(spots) > 1 else [],
                colors=palette.NAV_PATH_COLOUR,
                radii=rr.Radius.ui_points(2.5),
            ),
        )
        if event.detail:
            self._book.text(f"{schema.LOG}/nav", stamp, f"{event.state}: {event.detail}", "INFO")
        self._card.navigation_changed(event)
        self._show_mission()

    def _advised(self, event: events.Advised) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._book.add(schema.ADVICE, stamp, rows.command_row(event.command))

    def _episode_ended(self, event: events.EpisodeEnded) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._book.add(schema.EPISODES, stamp, rows.episode_row(event))
        text = f"episode {event.episode} “{event.goal}”: {event.outcome}"
        self._book.text(
            f"{schema.LOG}/run", stamp, f"{text}, {event.reason}" if event.reason else text, "INFO"
        )
        self._card.episode_ended(event)
        self._show_mission()

    def _error_occurred(self, event: events.ErrorOccurred) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._book.add(schema.ERRORS, stamp, rows.error_row(event))
        skipped = f"; skipped: {event.skipped}" if event.skipped else ""
        self._book.text(
            f"{schema.LOG}/errors",
            stamp,
            f"{event.plugin}: {event.message}{skipped}",
            "CRITICAL" if event.fatal else "ERROR",
        )

    def _stage_timed(self, event: events.StageTimed) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._book.add(
            schema.TIMINGS,
            stamp,
            {"stage": list(event.seconds), "seconds": [float(value) for value in event.seconds.values()]},
        )
        for stage, seconds in event.seconds.items():
            self._book.plot(f"timings/{stage}", stamp, 1000.0 * seconds)

    def _logged(self, event: events.Logged) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._book.add(
            schema.LOGS, stamp, {"logger": event.logger, "level": event.level, "message": event.message}
        )
        self._book.text(f"{schema.LOG}/{path_part(event.logger)}", stamp, event.message, event.level.upper())

    def _run_finished(self, event: events.RunFinished) -> None:
        self._last = (event.frame, event.sim_time)
        self._stream.send_property(
            schema.SUMMARY_PROPERTY,
            rr.AnyValues(json=rows.plain_json(event.summary), frame=event.frame, updates=self._graph.updates),
        )

    # Helpers.

    def _stamp(
        self, frame: int, sim_time: float, *, update: int | None = None, row: int | None = None
    ) -> Stamp:
        self._last = (max(frame, self._last[0]), max(sim_time, self._last[1]))
        return Stamp(frame, sim_time, update=update, row=row)

    def _draw_scene(self, stamp: Stamp) -> None:
        self._scene_waits = self._scene.update(
            self._graph, stamp.frame, stamp.sim_time, viewpoint=self._viewpoint
        )

    def _show_mission(self) -> None:
        """The card as of the last frame told of: a phase stands at its first frame, which is yet to come."""
        text = self._card.text()
        stamp = Stamp(*self._last)
        self._book.look(schema.MISSION, rr.TextDocument, stamp, text=text, media_type="text/markdown")
