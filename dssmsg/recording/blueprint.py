"""The layouts that `dssmsg view` opens; the review layout also travels inside every recording."""

from __future__ import annotations

from collections.abc import Callable

import rerun as rr
import rerun.blueprint as rrb

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


def world_view(focus: str | None = None) -> rrb.Spatial3DView:
    """The scene in 3D; with `focus` (an entity path) the camera follows it."""
    return rrb.Spatial3DView(
        origin=schema.WORLD,
        name="Scene",
        contents=[
            "+ $origin/**",
            f"- {schema.RGB}/**",
            f"- {schema.DEPTH}/**",
            f"- {schema.SEGMENTATION}/**",
            f"- {schema.BOXES}/**",
        ],
        background=rrb.Background(color=(22, 24, 30), kind=rrb.BackgroundKind.SolidColor),
        line_grid=rrb.LineGrid3D(visible=True, spacing=1.0, color=(70, 75, 90, 90)),
        overrides={
            schema.TRAIL: [_ALL_SO_FAR],
            f"{schema.EDGES}/sees": [rrb.EntityBehavior(visible=False)],
        },
        eye_controls=None if focus is None else rrb.EyeControls3D(tracking_entity=focus),
    )


def camera_view() -> rrb.Spatial2DView:
    """The colour image with the detections of key frames drawn over it."""
    return rrb.Spatial2DView(
        origin=schema.CAMERA,
        name="Camera",
        contents=[schema.RGB, schema.SEGMENTATION, schema.BOXES],
    )


def depth_view() -> rrb.Spatial2DView:
    """The depth image."""
    return rrb.Spatial2DView(origin=schema.CAMERA, name="Depth", contents=[schema.DEPTH])


def graph_views() -> rrb.Tabs:
    """The graph drawn as a floor plan: all of it, and one tab an edge kind."""
    names = {"all": "Graph", "path": "Topology", "near": "Near", "sees": "Sees"}
    return rrb.Tabs(
        *(rrb.GraphView(origin=f"{schema.GRAPH}/{part}", name=name) for part, name in names.items()),
        name="Graph",
    )


def change_log_view() -> rrb.TextLogView:
    """The graph changes, one line each, with scores and thresholds."""
    return rrb.TextLogView(origin=f"{schema.LOG}/graph", name="Changes")


def change_table_view() -> rrb.DataframeView:
    """The graph changes as a table, one row an update."""
    return rrb.DataframeView(
        origin=schema.GRAPH_LOG.path,
        name="Change table",
        query=rrb.archetypes.DataframeQuery(
            timeline=schema.UPDATE,
            select=[
                schema.UPDATE,
                *(
                    f"{schema.GRAPH_LOG.path}:{schema.GRAPH_LOG.component(column)}"
                    for column in ("kind", "subjects", "scores", "cause")
                ),
            ],
        ),
    )


def plots() -> rrb.Tabs:
    """Objects, changes a key frame and wall time a frame."""
    def plot(part: str, name: str) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin=f"{schema.PLOTS}/{part}", name=name, plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop)
        )

    return rrb.Tabs(
        plot("objects", "Objects"), plot("changes", "Changes a frame"), plot("timings", "Milliseconds a frame"),
        name="Plots",
    )


def states_view() -> rrb.StateTimelineView:
    """What the robot was doing, over the whole run."""
    return rrb.StateTimelineView(
        origin="/nav", name="States", contents=[schema.PHASE_STATE, schema.NAV_STATE]
    )


def log_view() -> rrb.TextLogView:
    """Everything that was logged, without the graph's changes."""
    return rrb.TextLogView(
        origin=schema.LOG, name="Log", contents=["+ $origin/**", f"- {schema.LOG}/graph"]
    )


def review_layout(focus: str | None = None) -> rrb.Blueprint:
    """Scene, images, graph, changes, plots and log side by side: the layout to scrub a run with."""
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                world_view(focus),
                rrb.Vertical(rrb.Horizontal(camera_view(), depth_view()), graph_views(), row_shares=[2, 3]),
                column_shares=[3, 2],
            ),
            rrb.Horizontal(
                rrb.Tabs(change_log_view(), change_table_view(), log_view(), name="Log"),
                rrb.Vertical(plots(), states_view(), row_shares=[3, 1]),
                column_shares=[3, 2],
            ),
            row_shares=[5, 2],
        ),
        *_panels(),
    )


def scene_layout(focus: str | None = None) -> rrb.Blueprint:
    """The 3D scene, large, beside the camera: for a demonstration."""
    return rrb.Blueprint(
        rrb.Horizontal(
            world_view(focus), rrb.Vertical(camera_view(), depth_view()), column_shares=[3, 1]
        ),
        *_panels(),
    )


def graph_layout(focus: str | None = None) -> rrb.Blueprint:
    """The graph views, large, beside their changes."""
    return rrb.Blueprint(
        rrb.Horizontal(
            graph_views(),
            rrb.Vertical(world_view(focus), rrb.Tabs(change_log_view(), change_table_view())),
            column_shares=[3, 2],
        ),
        *_panels(),
    )


LAYOUTS: dict[str, Callable[[str | None], rrb.Blueprint]] = {
    "review": review_layout,
    "scene": scene_layout,
    "graph": graph_layout,
}
"""Layouts by the name that `dssmsg view --layout` takes."""


def _panels() -> tuple[rrb.BlueprintPanel, rrb.SelectionPanel, rrb.TimePanel]:
    return (
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=schema.FRAME),
    )
