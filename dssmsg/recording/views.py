"""The views that layouts are made of, each a pure function."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from dssmsg.graph.nodes import SEES
from dssmsg.recording import schema

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

_PLAN_WIDTH = 7.0
"""Points: the plan runs along path edges, just below them, and is seen on both sides of those."""


_UNNAMED: dict[str, Any] = {
    schema.WAYPOINTS: rr.Points3D.from_fields(show_labels=False, radii=rr.Radius.ui_points(3.0)),
    schema.MATCHED: rr.Boxes3D.from_fields(show_labels=False),
}
"""Waypoints small and without numbers, which the view of the topology shows; matched things without names."""


@dataclass(frozen=True)
class Eye:
    """Where the 3D view looks from, and at what: (x, y, z) each, world metres."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]


def world_view(eye: Eye | None = None, *, way: bool = False) -> rrb.Spatial3DView:
    """The scene in 3D, seen from `eye` at first; `way`: without what covers the robot and its plan."""
    overrides: dict[Any, Any] = {
        schema.TRAIL: [rr.LineStrips3D.from_fields(), _ALL_SO_FAR],
        schema.NAV_PATH: rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(_PLAN_WIDTH)),
    }
    if way:
        overrides |= _UNNAMED
    return rrb.Spatial3DView(
        origin=schema.WORLD,
        name="Scene",
        contents=[
            "+ $origin/**",
            f"- {schema.DEPTH}/**",
            f"- {schema.SEGMENTATION}/**",
            f"- {schema.BOXES}/**",
            f"- {schema.NAMES}/**",
            *([f"- {schema.EDGES}/{SEES}"] if way else []),
        ],
        background=rrb.Background(color=(22, 24, 30), kind=rrb.BackgroundKind.SolidColor),
        line_grid=rrb.LineGrid3D(visible=True, spacing=1.0, color=(70, 75, 90, 90)),
        overrides=overrides,
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


def candidates_view() -> rrb.DataframeView:
    """The candidates of all queries as a table, one a row."""
    return rrb.DataframeView(
        origin="/match/candidates",
        name="Candidates",
        query=rrb.archetypes.DataframeQuery(
            timeline=schema.ROW,
            select=[
                schema.ROW,
                *(
                    rrb.components.ComponentColumnSelector(
                        entity_path=schema.CANDIDATES.path, component=schema.CANDIDATES.component(name)
                    )
                    for name in ("rank", "viewpoint", "score", "scores", "matching")
                ),
            ],
        ),
    )


def match_views() -> rrb.Tabs:
    """The candidates of all queries as a table; the scores of the latest as bars and as a matrix."""
    return rrb.Tabs(
        candidates_view(),
        rrb.BarChartView(origin=schema.SCORES, name="Scores", contents="$origin/**"),
        rrb.TensorView(origin=schema.MATRIX, name="Matrix", contents="$origin/**"),
        name="Match",
    )


def verdicts_view() -> rrb.TextLogView:
    """The verdicts of the windows, a line an evaluation that judged something."""
    return rrb.TextLogView(
        origin=f"{schema.LOG}/windows",
        name="Verdicts",
        columns=rrb.archetypes.TextLogColumns(text_log_columns=["Body"]),
    )


def window_views(pictures: float = 1.0) -> rrb.Horizontal:
    """The window of the viewpoint at the cursor, and two pictures of the latest verdict.

    `pictures` is how wide each picture is where the text is 3.
    """
    return rrb.Horizontal(
        rrb.TextDocumentView(origin=schema.WINDOW_TEXT, name="Window", contents=[schema.WINDOW_TEXT]),
        rrb.Spatial2DView(origin=schema.WINDOW_BEFORE, name="Before the latest verdict"),
        rrb.Spatial2DView(origin=schema.WINDOW_NOW, name="At the latest verdict"),
        column_shares=[3, pictures, pictures],
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


def target_view() -> rrb.GraphView:
    """What the latest sentence was taken to ask for: the target graph."""
    return rrb.GraphView(origin=schema.TARGET, name="Target graph")


def match_page_view() -> rrb.TextDocumentView:
    """The best candidates of the latest query, with what decided."""
    return rrb.TextDocumentView(origin=schema.MATCH_TEXT, name="Best candidates")


def scores_view() -> rrb.BarChartView:
    """The score of each candidate of the latest query, best first."""
    return rrb.BarChartView(origin=schema.SCORES, name="Score by rank", contents="$origin/**")


def language_views() -> rrb.Tabs:
    """The latest answer of the language model, a tab a role."""
    roles = {"target_graph": "Asked for the target", "dynamic_attribute": "Asked what moves"}
    return rrb.Tabs(
        *(
            rrb.TextDocumentView(origin=f"{schema.LLM_TEXT}/{role}", name=name)
            for role, name in roles.items()
        ),
        name="Language model",
    )


def topology_view() -> rrb.GraphView:
    """Waypoints and the path edges between them, as a floor plan."""
    return rrb.GraphView(origin=f"{schema.GRAPH}/path", name="Topology")


def life_view() -> rrb.TextDocumentView:
    """The life of the object in focus."""
    return rrb.TextDocumentView(origin=schema.FOCUS_TEXT, name="In focus")
