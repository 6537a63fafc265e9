"""The layouts that `dssmsg view` opens; the review layout also travels inside every recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dssmsg.errors import ConfigError
from dssmsg.frame import FloatArray
from dssmsg.graph.view import GraphView
from dssmsg.recording import schema
from dssmsg.recording.looks import place

_ALL_SO_FAR = rrb.VisibleTimeRanges(
    [
        rr.VisibleTimeRange(
            timeline,
            start=rr.TimeRangeBoundary.infinite(),
            end=rr.TimeRangeBoundary.cursor_relative(seq=0)
            if timeline == schema.FRAME
            else rr.TimeRangeBoundary.cursor_relative(seconds=0.0),
        )
        for timeline in (schema.FRAME, schema.SIM_TIME)
    ]
)
"""The trail is logged a step at a time; everything up to the cursor is drawn."""


@dataclass(frozen=True)
class Eye:
    """Where the 3D view looks from, and at what: (x, y, z) each, world metres."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]


def world_view(eye: Eye | None = None) -> rrb.Spatial3DView:
    """The scene in 3D, seen from `eye` at first."""
    return rrb.Spatial3DView(
        origin=schema.WORLD,
        name="Scene",
        contents=[
            "+ $origin/**",
            f"- {schema.DEPTH}/**",
            f"- {schema.SEGMENTATION}/**",
            f"- {schema.BOXES}/**",
            f"- {schema.NAMES}/**",
        ],
        background=rrb.Background(color=(22, 24, 30), kind=rrb.BackgroundKind.SolidColor),
        line_grid=rrb.LineGrid3D(visible=True, spacing=1.0, color=(70, 75, 90, 90)),
        overrides={
            schema.TRAIL: [rr.LineStrips3D.from_fields(), _ALL_SO_FAR],
        },
        eye_controls=None
        if eye is None
        else rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0)
        ),
    )


def camera_view() -> rrb.Spatial2DView:
    """The colour image with the detections of key frames drawn over it."""
    return rrb.Spatial2DView(
        origin=schema.CAMERA,
        name="Camera (boxes at key frames)",
        contents=[schema.RGB, schema.SEGMENTATION, schema.BOXES, schema.NAMES],
    )


def depth_view() -> rrb.Spatial2DView:
    """The depth image."""
    return rrb.Spatial2DView(origin=schema.CAMERA, name="Depth, 0 to 5 m", contents=[schema.DEPTH])


def graph_views() -> rrb.Tabs:
    """The graph drawn as a floor plan: all of it, and one tab an edge kind."""
    names = {"map": "Graph", "path": "Topology", "near": "Near", "sees": "Sees", "all": "All edges"}
    return rrb.Tabs(
        *(rrb.GraphView(origin=f"{schema.GRAPH}/{part}", name=name) for part, name in names.items()),
        name="Graph",
    )


def change_log_view() -> rrb.TextLogView:
    """The graph changes, one line each, with scores and thresholds."""
    return rrb.TextLogView(
        origin=f"{schema.LOG}/graph",
        name="Changes",
        columns=rrb.archetypes.TextLogColumns(text_log_columns=["Body"]),
    )


def mission_view() -> rrb.TextDocumentView:
    """Phase, goal, driver's state and the episodes so far."""
    return rrb.TextDocumentView(origin=schema.MISSION, name="Mission")


def plots() -> rrb.Tabs:
    """Objects, changes a key frame and wall time a frame."""

    def plot(part: str, name: str) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin=f"{schema.PLOTS}/{part}",
            name=name,
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
        )

    return rrb.Tabs(
        plot("objects", "Objects"),
        plot("changes", "Changes a frame"),
        plot("timings", "Milliseconds a frame"),
        states_view(),
        name="Plots",
    )


def states_view() -> rrb.StateTimelineView:
    """What the robot was doing, over the whole run."""
    return rrb.StateTimelineView(
        origin="/nav", name="States", contents=[schema.PHASE_STATE, schema.NAV_STATE]
    )


def match_views() -> rrb.Tabs:
    """The candidates of all queries as a table; the scores of the latest as bars and as a matrix."""
    return rrb.Tabs(
        rrb.DataframeView(
            origin="/match/candidates",
            name="Candidates",
            query=rrb.archetypes.DataframeQuery(timeline=schema.ROW),
        ),
        rrb.BarChartView(origin=schema.SCORES, name="Scores", contents="$origin/**"),
        rrb.TensorView(origin=schema.MATRIX, name="Matrix", contents="$origin/**"),
        name="Match",
    )


def window_views() -> rrb.Horizontal:
    """The window of the viewpoint at the cursor, and two pictures of the latest verdict."""
    return rrb.Horizontal(
        rrb.TextDocumentView(origin=schema.WINDOW_TEXT, name="Window", contents=[schema.WINDOW_TEXT]),
        rrb.Spatial2DView(origin=schema.WINDOW_BEFORE, name="Before the latest verdict"),
        rrb.Spatial2DView(origin=schema.WINDOW_NOW, name="At the latest verdict"),
        column_shares=[3, 1, 1],
        name="Windows",
    )


def log_view() -> rrb.TextLogView:
    """Everything that was logged, without the graph's changes."""
    return rrb.TextLogView(
        origin=schema.LOG,
        name="Log",
        contents=["+ $origin/**", f"- {schema.LOG}/graph"],
        columns=rrb.archetypes.TextLogColumns(text_log_columns=["LogLevel", "Body"]),
    )


def review_layout(eye: Eye | None = None) -> rrb.Blueprint:
    """Scene, images, graph, changes, plots and log side by side: the layout to scrub a run with."""
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                world_view(eye),
                rrb.Vertical(rrb.Horizontal(camera_view(), depth_view()), graph_views(), row_shares=[2, 3]),
                column_shares=[3, 2],
            ),
            rrb.Horizontal(
                mission_view(),
                rrb.Tabs(change_log_view(), window_views(), match_views(), log_view(), name="Log"),
                plots(),
                column_shares=[3, 7, 6],
            ),
            row_shares=[12, 5],
        ),
        *_panels(),
    )


def scene_layout(eye: Eye | None = None) -> rrb.Blueprint:
    """The 3D scene, large, beside the camera: for a demonstration."""
    return rrb.Blueprint(
        rrb.Horizontal(
            world_view(eye), rrb.Vertical(camera_view(), depth_view(), mission_view()), column_shares=[3, 1]
        ),
        *_panels(),
    )


def graph_layout(eye: Eye | None = None) -> rrb.Blueprint:
    """The graph views, large, beside their changes."""
    return rrb.Blueprint(
        rrb.Horizontal(
            graph_views(),
            rrb.Vertical(world_view(eye), change_log_view()),
            column_shares=[3, 2],
        ),
        *_panels(),
    )


def dynamics_layout(eye: Eye | None = None) -> rrb.Blueprint:
    """What changed in the home: the windows of the viewpoints large, beside the scene and the changes."""
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                world_view(eye), rrb.Vertical(camera_view(), change_log_view()), column_shares=[3, 2]
            ),
            window_views(),
        ),
        *_panels(),
    )


LAYOUTS: dict[str, Callable[[Eye | None], rrb.Blueprint]] = {
    "review": review_layout,
    "scene": scene_layout,
    "graph": graph_layout,
    "dynamics": dynamics_layout,
}
"""Layouts by the name that `dssmsg view --layout` takes."""


def save_layout(path: Path, name: str, graph: GraphView, focus: str | None) -> None:
    """Write the layout of a name as a blueprint file (.rbl): the whole map in view, or the node `focus`.

    Raises ConfigError for an unknown layout, or a node that the graph does not have.
    """
    if name not in LAYOUTS:
        raise ConfigError(f"expected a layout of {', '.join(LAYOUTS)}, got {name!r}", key="--layout")
    LAYOUTS[name](eye_on(graph, focus)).save(schema.APPLICATION_ID, str(path))


def eye_on(graph: GraphView, focus: str | None = None) -> Eye | None:
    """An eye that sees the whole map from above and aside, or one node from nearby; None for an empty map.

    Raises ConfigError if the graph has no such node.
    """
    if focus is not None:
        spot = place(graph, focus)
        if spot is None and focus in graph.history:
            spot = (graph.history[focus].box_min + graph.history[focus].box_max) / 2
        if spot is None:
            raise ConfigError(f"the graph has no node {focus!r} at that time", key="--focus")
        return _eye(spot, 2.5)
    spots = [node.center for node in graph.objects.values()] + [n.position for n in graph.waypoints.values()]
    return eye_over(spots)


def eye_over(spots: Sequence[Any], margin: float = 0.0) -> Eye | None:
    """An eye that sees all spots (3,), and `margin` metres around them, from above; None for none."""
    if not len(spots):
        return None
    low, high = np.min(spots, axis=0), np.max(spots, axis=0)
    return _eye((low + high) / 2, max(3.0, 0.85 * float(np.linalg.norm(high - low)) + margin))


def _eye(target: FloatArray, distance: float) -> Eye:
    position = target + distance * np.array([-0.35, -0.6, 0.72])
    return Eye(_triple(position), _triple(target))


def _triple(values: FloatArray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _panels() -> tuple[rrb.BlueprintPanel, rrb.SelectionPanel, rrb.TimePanel]:
    return (
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=schema.FRAME),
    )
