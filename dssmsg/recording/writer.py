"""Writes the events of a run into one `.rrd` file. Synchronous; the `rerun` observer gives it a thread.

The file is created exclusively, and everything told before a `flush` is in the file (and would outlive
this process) once `flush` returns. Memory does not grow with the number of frames.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from dssmsg import events
from dssmsg.errors import StorageError
from dssmsg.graph import codec
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.recording import describe, palette, rows, schema
from dssmsg.recording.blueprint import review_layout
from dssmsg.recording.images import MEDIA_TYPES, Encoding, encode_depth, encode_rgb
from dssmsg.recording.scene_log import SceneLog
from dssmsg.recording.sheets import LookSheet, Sheet, Stamp

FLUSH_TIMEOUT_SECS = 20.0
_REMEMBERED_BLOBS = 8192  # a blob forgotten and met again is written twice, which harms nobody
_CHANGE_GROUPS = {
    "object_added": "objects added",
    "object_merged": "merges",
    "object_removed": "objects gone",
    "objects_joined": "objects gone",
    "edge_added": "edges added",
    "edge_removed": "edges removed",
}


class RecordingWriter:
    """One recording in the making. Not thread-safe: one thread opens, writes, flushes and closes it.

    Raises StorageError where the file cannot be created (it exists, the folder is read-only) or a write
    failed (full disk).
    """

    def __init__(
        self,
        path: Path,
        recording_id: str,
        *,
        images: Encoding = "jpeg",
        quality: int = 80,
        extra_sinks: Sequence[Any] = (),
    ) -> None:
        self.path = path
        self._images: Encoding = images
        self._quality = quality
        _create_exclusively(path)
        self._stream = rr.RecordingStream(
            schema.APPLICATION_ID,
            recording_id=recording_id,
            # Rows are batched here, a second at a time, and flushed by hand: Rerun's own tick stays out of it.
            batcher_config=rr.ChunkBatcherConfig(flush_tick=60.0),
        )
        self._stream.set_sinks(rr.FileSink(path), *extra_sinks, default_blueprint=review_layout())
        self._sheets = {table.path: Sheet(table) for table in schema.TABLES}
        self._looks: dict[str, LookSheet] = {}
        self._graph = SceneGraph()
        self._scene = SceneLog(self._stream)
        self._scene_waits = False
        self._seen_blobs: OrderedDict[str, None] = OrderedDict()
        self._truth_objects = ""
        self._queries = 0
        self._candidate_rows = 0
        self._camera: Any = None
        self._last_base: np.ndarray[Any, Any] | None = None
        self._boxes_shown = False
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
            events.EpisodeEnded: self._episode_ended,
            events.ErrorOccurred: self._error_occurred,
            events.StageTimed: self._stage_timed,
            events.Logged: self._logged,
            events.RunFinished: self._run_finished,
        }
        self._scene.log_static()
        self._log_static_looks()

    def write(self, event: events.Event) -> None:
        """Take an event into the next flush."""
        self._writers[type(event)](event)

    def flush(self) -> None:
        """Bring everything told so far into the file. Raises StorageError if that failed."""
        try:
            for sheet in self._sheets.values():
                sheet.send(self._stream)
            for look in self._looks.values():
                look.send(self._stream)
            self._stream.flush(timeout_sec=FLUSH_TIMEOUT_SECS)
        except (RuntimeError, OSError) as error:
            raise StorageError(
                f"the recording could not be written ({error}): is the disk full?", file=self.path
            ) from error

    def close(self) -> None:
        """Draw what was left waiting, flush, and write the file's footer."""
        if self._scene_waits:
            self._scene.update(self._graph, *self._last, everything=True)
        try:
            self.flush()
        finally:
            self._stream.disconnect()

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
            "source": {
                "name": source.name,
                "scene": source.scene,
                "drivable": source.drivable,
                "has_truth": source.has_truth,
                "visits": source.visits,
                "rate_hz": source.rate_hz,
                "credits": source.credits,
                "depth_noise_m": source.depth_noise_m,
                "facts": source.facts,
            },
        }
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
        self._add(schema.PHASES, stamp, {"phase": event.phase, "visit": event.visit, "index": event.frame})
        self._look(schema.PHASE_STATE, rr.StateChange, stamp, state=event.phase)
        self._text(f"{schema.LOG}/run", stamp, f"phase {event.phase}, visit {event.visit}", "INFO")

    def _frame_captured(self, event: events.FrameCaptured) -> None:
        frame = event.frame
        stamp = self._stamp(frame.index, frame.sim_time)
        self._add(schema.FRAMES, stamp, rows.frame_row(event))
        if event.command is not None:
            self._add(schema.COMMANDS, stamp, rows.command_row(event.command))
        self._look(
            schema.RGB,
            rr.EncodedImage,
            stamp,
            blob=encode_rgb(frame.rgb, self._images, self._quality),
            media_type=MEDIA_TYPES[self._images],
        )
        self._look(schema.DEPTH, rr.EncodedDepthImage, stamp, blob=encode_depth(frame.depth))
        self._pose(schema.CAMERA, stamp, frame.world_from_camera)
        self._pose(schema.ROBOT, stamp, frame.world_from_base)
        if frame.camera != self._camera:
            self._camera = frame.camera
            self._set_time(stamp)
            self._stream.log(
                schema.CAMERA,
                rr.Pinhole(
                    image_from_camera=frame.camera.matrix,
                    resolution=(frame.camera.width, frame.camera.height),
                    camera_xyz=rr.ViewCoordinates.RDF,
                    image_plane_distance=0.35,
                    color=palette.ROBOT_COLOUR,
                ),
                strict=True,
            )
        base = frame.world_from_base[:3, 3] + (0.0, 0.0, 0.02)  # just above the floor, so that it is seen
        if self._last_base is not None and not np.array_equal(base, self._last_base):
            self._look(
                schema.TRAIL,
                rr.LineStrips3D,
                stamp,
                strips=np.stack([self._last_base, base]).astype(np.float32),
            )
        self._last_base = base
        if self._boxes_shown and not event.key_frame:
            self._clear_detections(stamp)
        if self._scene_waits:
            self._draw_scene(stamp)

    def _truth_seen(self, event: events.TruthSeen) -> None:
        objects = rows.truth_objects_json(event.truth.objects)
        changed = objects != self._truth_objects
        self._truth_objects = objects
        self._add(
            schema.TRUTH,
            self._stamp(event.frame, event.sim_time),
            rows.truth_row(event.truth, objects if changed else None),
        )

    def _detected(self, event: events.Detected) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        row, blobs = rows.detections_row(event)
        self._add(schema.DETECTIONS, stamp, row)
        self._add_blobs(stamp, blobs)
        self._set_time(stamp)
        if not event.detections:
            self._clear_detections(stamp)
            return
        classes = [palette.detection_class(index) for index in range(len(event.detections))]
        picture = np.zeros(event.detections[0].mask.shape, dtype=np.uint8)
        order = sorted(range(len(classes)), key=lambda index: -int(event.detections[index].mask.sum()))
        for index in order:  # small ones on top
            picture[event.detections[index].mask] = classes[index]
        self._stream.log(
            schema.SEGMENTATION, rr.SegmentationImage(picture, opacity=0.4, draw_order=1.0), strict=True
        )
        self._stream.log(
            schema.BOXES,
            rr.Boxes2D(
                array=np.stack([detection.box_xyxy for detection in event.detections]),
                array_format=rr.Box2DFormat.XYXY,
                labels=[f"{detection.label} {detection.score:.2f}" for detection in event.detections],
                class_ids=classes,
                draw_order=2.0,
            ),
            strict=True,
        )
        self._boxes_shown = True

    def _graph_changed(self, event: events.GraphChanged) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        counts: dict[str, int] = dict.fromkeys(_CHANGE_GROUPS.values(), 0)
        for change in event.changes:
            row, blobs = codec.encode(change)
            own = self._stamp(change.frame, change.sim_time, update=change.update)
            self._add(
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
            self._add_blobs(stamp, blobs)
            self._text(
                f"{schema.LOG}/graph",
                stamp,
                describe.change_line(change),
                "INFO",
                palette.CHANGE_COLOURS.get(change.kind, palette.ROBOT_COLOUR),
            )
            if change.kind in _CHANGE_GROUPS:
                counts[_CHANGE_GROUPS[change.kind]] += 1
        for change in event.changes:
            self._graph.apply(change)
        for group, count in counts.items():
            self._plot(f"changes/{group}", stamp, count)
        nodes = self._graph.objects.values()
        believed = sum(node.status == "believed" for node in nodes)
        self._plot("objects/believed", stamp, believed)
        self._plot("objects/tentative", stamp, len(nodes) - believed)
        self._plot("objects/waypoints", stamp, len(self._graph.waypoints))
        self._draw_scene(stamp)

    def _window_evaluated(self, event: events.WindowEvaluated) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        row = rows.window_row(event)
        self._add(schema.WINDOWS, stamp, row)
        if row["verdicts"]:
            self._text(f"{schema.LOG}/windows", stamp, f"{event.viewpoint_id}: {row['verdicts']}", "INFO")

    def _matched(self, event: events.Matched) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._add(schema.MATCHES, stamp, rows.match_row(event))
        self._queries += 1
        for candidate in event.candidates:
            self._candidate_rows += 1
            own = self._stamp(event.frame, event.sim_time, row=self._candidate_rows)
            self._add(schema.CANDIDATES, own, rows.candidate_row(event.query, candidate))
        if event.candidates:
            best = event.candidates[0]
            for name, value in best.scores.items():
                self._look(f"{schema.SCORES}/{name}", rr.Scalars, stamp, scalars=float(value))
            text = f"“{event.query}” -> {best.viewpoint_id}: {best.reason}"
        else:
            text = f"“{event.query}” matches nothing"
        self._text(f"{schema.LOG}/match", stamp, text, "INFO")

    def _llm_called(self, event: events.LlmCalled) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._add(schema.LLM_CALLS, stamp, rows.llm_row(event))
        answer = event.answer if event.ok else f"**failed:** {event.error}\n\n{event.answer}"
        self._look(
            f"{schema.LLM_TEXT}/{event.role}",
            rr.TextDocument,
            stamp,
            text=f"## {event.role} ({event.provider})\n\n{event.prompt}\n\n---\n\n{answer}\n",
            media_type="text/markdown",
        )

    def _navigation_changed(self, event: events.NavigationChanged) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._add(schema.NAVIGATION, stamp, rows.navigation_row(event))
        self._look(schema.NAV_STATE, rr.StateChange, stamp, state=event.state)
        known = [self._graph.waypoints[name].position for name in event.path if name in self._graph.waypoints]
        if self._last_base is not None and known:
            known.insert(0, self._last_base)
        self._set_time(stamp)
        self._stream.log(
            schema.NAV_PATH,
            rr.LineStrips3D(
                [np.array(known, dtype=np.float32)] if len(known) > 1 else [],
                colors=palette.NAV_PATH_COLOUR,
                radii=rr.Radius.ui_points(2.5),
            ),
            strict=True,
        )
        if event.detail:
            self._text(f"{schema.LOG}/nav", stamp, f"{event.state}: {event.detail}", "INFO")

    def _episode_ended(self, event: events.EpisodeEnded) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._add(schema.EPISODES, stamp, rows.episode_row(event))
        text = f"episode {event.episode} “{event.goal}”: {event.outcome}"
        self._text(f"{schema.LOG}/run", stamp, f"{text}, {event.reason}" if event.reason else text, "INFO")

    def _error_occurred(self, event: events.ErrorOccurred) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._add(schema.ERRORS, stamp, rows.error_row(event))
        skipped = f"; skipped: {event.skipped}" if event.skipped else ""
        self._text(
            f"{schema.LOG}/errors",
            stamp,
            f"{event.plugin}: {event.message}{skipped}",
            "CRITICAL" if event.fatal else "ERROR",
        )

    def _stage_timed(self, event: events.StageTimed) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._add(
            schema.TIMINGS,
            stamp,
            {"stage": list(event.seconds), "seconds": [float(value) for value in event.seconds.values()]},
        )
        for stage, seconds in event.seconds.items():
            self._plot(f"timings/{stage}", stamp, 1000.0 * seconds)

    def _logged(self, event: events.Logged) -> None:
        stamp = self._stamp(event.frame, event.sim_time)
        self._add(
            schema.LOGS, stamp, {"logger": event.logger, "level": event.level, "message": event.message}
        )
        self._text(f"{schema.LOG}/{_name(event.logger)}", stamp, event.message, event.level.upper())

    def _run_finished(self, event: events.RunFinished) -> None:
        self._last = (event.frame, event.sim_time)
        self._stream.send_property(
            schema.SUMMARY_PROPERTY, rr.AnyValues(json=rows.plain_json(event.summary), frame=event.frame)
        )

    # Helpers.

    def _stamp(
        self, frame: int, sim_time: float, *, update: int | None = None, row: int | None = None
    ) -> Stamp:
        self._last = (max(frame, self._last[0]), max(sim_time, self._last[1]))
        return Stamp(frame, sim_time, update=update, row=row)

    def _add(self, table: schema.Table, stamp: Stamp, row: Mapping[str, Any]) -> None:
        self._sheets[table.path].add(stamp, row)

    def _look(self, path: str, archetype: Any, stamp: Stamp, **fields: Any) -> None:
        sheet = self._looks.get(path)
        if sheet is None:
            sheet = self._looks[path] = LookSheet(path, archetype)
        sheet.add(stamp, **fields)

    def _pose(self, path: str, stamp: Stamp, world_from_local: np.ndarray[Any, Any]) -> None:
        self._look(
            path,
            rr.Transform3D,
            stamp,
            translation=world_from_local[:3, 3],
            mat3x3=world_from_local[:3, :3],
        )

    def _plot(self, name: str, stamp: Stamp, value: float) -> None:
        self._look(f"{schema.PLOTS}/{_name(name)}", rr.Scalars, stamp, scalars=float(value))

    def _text(
        self, path: str, stamp: Stamp, text: str, level: str, colour: palette.Colour = palette.ROBOT_COLOUR
    ) -> None:
        self._look(path, rr.TextLog, stamp, text=text, level=level, color=colour)

    def _add_blobs(self, stamp: Stamp, blobs: Mapping[str, bytes]) -> None:
        for name, data in blobs.items():
            if name in self._seen_blobs:
                self._seen_blobs.move_to_end(name)
                continue
            self._seen_blobs[name] = None
            if len(self._seen_blobs) > _REMEMBERED_BLOBS:
                self._seen_blobs.popitem(last=False)
            self._add(schema.BLOBS, stamp, {"hash": name, "data": data})

    def _draw_scene(self, stamp: Stamp) -> None:
        self._scene_waits = self._scene.update(self._graph, stamp.frame, stamp.sim_time)

    def _clear_detections(self, stamp: Stamp) -> None:
        if not self._boxes_shown:
            return
        self._set_time(stamp)
        self._stream.log(schema.BOXES, rr.Clear(recursive=False), strict=True)
        self._stream.log(schema.SEGMENTATION, rr.Clear(recursive=False), strict=True)
        self._boxes_shown = False

    def _set_time(self, stamp: Stamp) -> None:
        self._stream.set_time(schema.FRAME, sequence=stamp.frame)
        self._stream.set_time(schema.SIM_TIME, duration=stamp.sim_time)

    def _log_static_looks(self) -> None:
        def log(path: str, look: Any) -> None:
            self._stream.log(path, look, static=True, strict=True)

        log(schema.DEPTH, rr.EncodedDepthImage.from_fields(media_type="image/png", meter=1000.0))


def _name(text: str) -> str:
    """A text as one or more plain parts of an entity path."""
    return "".join(char if char.isalnum() or char in "_-/" else "_" for char in text) or "_"


def _create_exclusively(path: Path) -> None:
    """Make the empty file: Rerun's file sink would silently truncate one that exists."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except FileExistsError as error:
        raise StorageError(
            "a recording of this name exists already and is not overwritten", file=path
        ) from error
    except OSError as error:
        raise StorageError(
            f"the recording cannot be created ({error.strerror}); set recording.directory to a folder that can"
            " be written",
            file=path,
        ) from error
