"""Two graphs in one recording, side by side on one timeline: what `dssmsg diff --recording` writes.

Everything of a run stands below `/a` or `/b`; below each `diff` is what the other one has not, or has
otherwise. The file is for the viewer: it holds no tables and is no recording of a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.recording import palette, schema
from dssmsg.recording.blueprint import eye_on
from dssmsg.recording.describe import change_line
from dssmsg.recording.images import MEDIA_TYPES
from dssmsg.recording.messages import MessageFile
from dssmsg.recording.reader import Recording
from dssmsg.recording.repair import optimize
from dssmsg.recording.scene_log import SceneLog
from dssmsg.recording.store import ChunkFile
from dssmsg.recording.views import Eye

SIDES = ("a", "b")
SUMMARY = "/summary"
LOG = "/log"
PLOTS = "/plots"
DIFFERING = "differing"
"""Below a side's world: boxes around what the other side has not, or has otherwise."""

ONE_SIDED: palette.Colour = (255, 80, 200)
OTHERWISE: palette.Colour = (255, 220, 70)
_FLUSH_FRAMES = 200
_BACKGROUND = (22, 24, 30)

Marks = Mapping[str, Sequence[tuple[str, str, palette.Colour]]]
"""Side -> (object id, words, colour) of what is to be marked in it."""


class _Below:
    """A stream that logs below an entity: what draws into a recording draws into a side of this one."""

    def __init__(self, stream: rr.RecordingStream, side: str) -> None:
        self._stream = stream
        self._side = side

    def set_time(self, timeline: str, **at: Any) -> None:
        self._stream.set_time(timeline, **at)

    def log(self, path: str, *parts: Any, **how: Any) -> None:
        self._stream.log(f"/{self._side}{path}", *parts, **how)


def write_comparison(
    path: Path,
    recordings: tuple[Recording, Recording],
    *,
    summary: str,
    marks: Marks,
    apart_from: int | None,
) -> None:
    """Write two runs side by side; `summary` is Markdown, `marks` what to point at in the final graphs.

    Images are those of key frames, and of every frame around `apart_from`, where the runs part. Raises
    StorageError where the file exists or cannot be written, InputError where a recording is damaged.
    """
    with _open_stream(path) as (stream, file, sink):
        ends = [recording.graph_at() for recording in recordings]
        # One eye for both: what stands in the same place is seen in the same place.
        stream.send_blueprint(comparison_layout(eye_on(ends[0]) or eye_on(ends[1])))
        stream.send_recording_name("comparison")
        stream.log(SUMMARY, rr.TextDocument(summary, media_type="text/markdown"), static=True)
        for side, recording, end in zip(SIDES, recordings, ends, strict=True):
            _log_static(stream, side, recording)
            for number in _Side(stream, side, recording).play(apart_from):
                if number % _FLUSH_FRAMES == 0:
                    stream.flush()
                    file.append(sink.read() or b"")
            _log_marks(stream, side, end, marks.get(side, ()))
        stream.flush()
        file.append(sink.read() or b"")
    optimize(path)


@contextmanager
def _open_stream(path: Path) -> Iterator[tuple[rr.RecordingStream, MessageFile, Any]]:
    file = MessageFile(path)
    stream = rr.RecordingStream(
        schema.COMPARISON_ID,
        recording_id=path.stem,
        batcher_config=rr.ChunkBatcherConfig(flush_tick=60.0),
    )
    try:
        yield stream, file, rr.binary_stream(stream)
    except BaseException:
        file.close()
        path.unlink(missing_ok=True)  # a half of a comparison is none
        raise
    finally:
        file.close()
        stream.disconnect()


class _Side:
    """One of the two runs, drawn frame by frame."""

    def __init__(self, stream: rr.RecordingStream, side: str, recording: Recording) -> None:
        self._stream = stream
        self._side = side
        self._recording = recording
        self._graph = SceneGraph()
        self._scene = SceneLog(_Below(stream, side))  # type: ignore[arg-type]  # it sets times and logs
        self._scene.log_static()

    def play(self, apart_from: int | None) -> Iterator[int]:
        """Draw everything; yields how many frames are drawn, after each of them."""
        recording, side = self._recording, self._side
        changes = recording.changes()
        following = next(changes, None)
        waiting, viewpoint = False, None
        last = (0, 0.0)
        for number, (index, facts) in enumerate(recording.frame_facts.items(), start=1):
            last = (index, facts.sim_time)
            self._at(*last)
            _, base = recording.poses(index)
            self._stream.log(
                f"/{side}{schema.ROBOT}", rr.Transform3D(translation=base[:3, 3], mat3x3=base[:3, :3])
            )
            if facts.key_frame or (apart_from is not None and abs(index - apart_from) <= 5):
                self._image(index)
            told = 0
            while following is not None and following.frame <= index:
                self._graph.apply(following)
                colour = palette.CHANGE_COLOURS.get(following.kind, palette.ROBOT_COLOUR)
                self._stream.log(
                    f"{LOG}/{side}", rr.TextLog(change_line(following), level="INFO", color=colour)
                )
                told += 1
                following = next(changes, None)
            viewpoint = facts.viewpoint or viewpoint
            if told or waiting:
                waiting = self._scene.update(self._graph, index, facts.sim_time, viewpoint=viewpoint)
                believed = sum(node.status == "believed" for node in self._graph.objects.values())
                self._stream.log(f"{PLOTS}/{side}", rr.Scalars(float(believed)))
            yield number
        self._scene.update(self._graph, *last, viewpoint=viewpoint, everything=True)

    def _image(self, index: int) -> None:
        images = self._recording.encoded_images(index)
        if images is not None:
            self._stream.log(f"/{self._side}{schema.RGB}", rr.EncodedImage.from_fields(blob=images[0]))

    def _at(self, frame: int, sim_time: float) -> None:
        self._stream.set_time(schema.FRAME, sequence=frame)
        self._stream.set_time(schema.SIM_TIME, duration=sim_time)


def _log_static(stream: rr.RecordingStream, side: str, recording: Recording) -> None:
    encoding = recording.facts.get("images")
    media = MEDIA_TYPES["lossless" if encoding == "lossless" else "jpeg"]
    log = stream.log
    log(f"/{side}{schema.RGB}", rr.EncodedImage.from_fields(media_type=media), static=True)
    log(
        f"/{side}{schema.ROBOT}/heading",
        rr.Arrows3D(
            origins=[(0, 0, 0.15)], vectors=[(0.4, 0, 0)], colors=[palette.TRAIL_COLOUR], radii=[0.03]
        ),
        static=True,
    )
    name = f"believed objects, {side.upper()}"
    colour = palette.OBJECT_CLASSES["static" if side == "a" else "moved"][2]
    log(f"{PLOTS}/{side}", rr.SeriesLines(names=[name], colors=[colour]), static=True)


def _log_marks(
    stream: rr.RecordingStream,
    side: str,
    end: SceneGraph,
    marks: Sequence[tuple[str, str, palette.Colour]],
) -> None:
    """Boxes, a little larger than the objects' own, at all times: they say where to look."""
    found = [(end.objects[name], words, colour) for name, words, colour in marks if name in end.objects]
    if not found:
        return
    centers = np.array([node.center for node, _, _ in found], dtype=np.float32)
    halves = np.array([(node.box_max - node.box_min) / 2 + 0.03 for node, _, _ in found], dtype=np.float32)
    stream.log(
        f"/{side}{schema.WORLD}/{DIFFERING}",
        rr.Boxes3D(
            centers=centers,
            half_sizes=halves,
            labels=[words for _, words, _ in found],
            colors=[colour for _, _, colour in found],
            show_labels=len(found) <= 20,
            radii=rr.Radius.ui_points(2.0),
            fill_mode=rr.components.FillMode.MajorWireframe,
        ),
        static=True,
    )


def last_frame(path: Path) -> int | None:
    """The last frame that a finished comparison shows; None where its file does not say."""
    return ChunkFile(path, path).last_frame


def comparison_layout(eye: Eye | None = None) -> rrb.Blueprint:
    """Both scenes (seen from `eye` at first), graphs and change logs side by side, the summary below."""

    def scene(side: str) -> rrb.Spatial3DView:
        return rrb.Spatial3DView(
            origin=f"/{side}{schema.WORLD}",
            name=f"{side.upper()}: scene",
            # No names of objects, places and waypoints: in half a window they cover each other and the marks.
            contents=[
                "+ $origin/**",
                f"- /{side}{schema.CAMERA}/**",
                f"- /{side}{schema.LABELS}",
                f"- /{side}{schema.HISTORY}",
            ],
            overrides={
                f"/{side}{schema.WAYPOINTS}": rr.Points3D.from_fields(
                    show_labels=False, radii=rr.Radius.ui_points(3.0)
                )
            },
            background=rrb.Background(color=_BACKGROUND, kind=rrb.BackgroundKind.SolidColor),
            line_grid=rrb.LineGrid3D(visible=True, spacing=1.0, color=(70, 75, 90, 90)),
            eye_controls=None
            if eye is None
            else rrb.EyeControls3D(
                kind=rrb.Eye3DKind.Orbital,
                position=eye.position,
                look_target=eye.target,
                eye_up=(0.0, 0.0, 1.0),
            ),
        )

    def column(side: str) -> rrb.Vertical:
        return rrb.Vertical(
            scene(side),
            rrb.Horizontal(
                rrb.GraphView(origin=f"/{side}{schema.GRAPH}/map", name=f"{side.upper()}: graph"),
                rrb.Spatial2DView(
                    origin=f"/{side}{schema.CAMERA}",
                    contents=[f"/{side}{schema.RGB}"],
                    name=f"{side.upper()}: camera at key frames",
                ),
                column_shares=[3, 2],
            ),
            rrb.TextLogView(
                origin=f"{LOG}/{side}",
                name=f"{side.upper()}: changes",
                columns=rrb.archetypes.TextLogColumns(text_log_columns=["Body"]),
            ),
            row_shares=[5, 3, 2],
        )

    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(column("a"), column("b")),
            rrb.Horizontal(
                rrb.TextDocumentView(origin=SUMMARY, name="Where they differ"),
                rrb.TimeSeriesView(
                    origin=PLOTS,
                    name="Believed objects",
                    plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
                ),
                column_shares=[3, 2],
            ),
            row_shares=[3, 1],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=schema.FRAME),
    )
