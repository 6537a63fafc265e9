"""The layouts that `dssmsg view` opens, one a task; a recording holds the one it was asked to hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from dssmsg.errors import ConfigError
from dssmsg.frame import FloatArray
from dssmsg.graph.view import GraphView
from dssmsg.recording import schema, views
from dssmsg.recording.looks import place
from dssmsg.recording.views import Eye

Layout = rrb.Horizontal | rrb.Vertical


def review_layout(eye: Eye | None) -> Layout:
    """Scene, images, graph, changes, plots and log side by side: the layout to scrub a run with."""
    pictures = rrb.Horizontal(views.camera_view(), views.depth_view())
    details = rrb.Tabs(
        views.change_log_view(), views.window_views(), views.match_views(), views.log_view(), name="Log"
    )
    return rrb.Vertical(
        rrb.Horizontal(
            views.world_view(eye),
            rrb.Vertical(pictures, views.graph_views(), row_shares=[2, 3]),
            column_shares=[3, 2],
        ),
        rrb.Horizontal(views.mission_view(), details, views.plots(), column_shares=[3, 7, 6]),
        row_shares=[12, 5],
    )


def scene_layout(eye: Eye | None) -> Layout:
    """The 3D scene, large, beside the camera: for a demonstration."""
    aside = rrb.Vertical(views.camera_view(), views.depth_view(), views.mission_view())
    return rrb.Horizontal(views.world_view(eye), aside, column_shares=[3, 1])


def graph_layout(eye: Eye | None) -> Layout:
    """The graph views, large, beside their changes."""
    aside = rrb.Vertical(views.world_view(eye), views.change_log_view())
    return rrb.Horizontal(views.graph_views(), aside, column_shares=[3, 2])


def dynamics_layout(eye: Eye | None) -> Layout:
    """What changed in the home: the windows of the viewpoints large, beside the scene and the changes."""
    return rrb.Vertical(
        rrb.Horizontal(
            views.world_view(eye),
            rrb.Vertical(rrb.Horizontal(views.camera_view(), views.verdicts_view()), views.change_log_view()),
            column_shares=[3, 2],
        ),
        views.window_views(pictures=1.6),
    )


def language_layout(eye: Eye | None) -> Layout:
    """What a sentence was taken for, and which viewpoint won: target, candidates, scores, matched objects."""
    return rrb.Vertical(
        rrb.Horizontal(
            views.world_view(eye),
            rrb.Vertical(views.target_view(), views.scores_view(), row_shares=[3, 2]),
            views.language_views(),
            column_shares=[6, 3, 4],
        ),
        rrb.Horizontal(
            views.mission_view(),
            rrb.Tabs(views.match_page_view(), views.candidates_view(), name="Candidates"),
            column_shares=[1, 4],
        ),
        row_shares=[3, 2],
    )


def navigation_layout(eye: Eye | None) -> Layout:
    """The way of the robot: its plan in the scene and in the topology, what it saw, and what it was doing."""
    return rrb.Vertical(
        rrb.Horizontal(
            views.world_view(eye, way=True),
            rrb.Vertical(views.camera_view(), views.depth_view()),
            views.topology_view(),
            column_shares=[5, 3, 4],
        ),
        rrb.Horizontal(
            views.mission_view(),
            rrb.Vertical(views.states_view(), views.log_view()),
            column_shares=[1, 3],
        ),
        row_shares=[3, 2],
    )


_FROM = np.array([-0.35, -0.6, 0.72])
"""Where the eye stands, seen from what it looks at, in distances."""
_NEARER = 0.12

LAYOUTS: dict[str, Callable[[Eye | None], Layout]] = {
    "review": review_layout,
    "scene": scene_layout,
    "graph": graph_layout,
    "dynamics": dynamics_layout,
    "language": language_layout,
    "navigation": navigation_layout,
}
"""Layouts by the name that `dssmsg view --layout` takes."""


def make_layout(name: str, eye: Eye | None = None, *, focused: bool = False) -> rrb.Blueprint:
    """The layout of a name, the 3D view seen from `eye`; `focused`: beside it the life of an object.

    Raises ConfigError for an unknown layout.
    """
    if name not in LAYOUTS:
        raise ConfigError(f"expected a layout of {', '.join(LAYOUTS)}, got {name!r}", key="--layout")
    root = LAYOUTS[name](eye)
    if focused:
        root = rrb.Horizontal(root, views.life_view(), column_shares=[4, 1])
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=schema.FRAME),
    )


def eye_on(graph: GraphView, focus: str | None = None, when: str = "at that time") -> Eye | None:
    """An eye that sees the whole map from above and aside, or one node from nearby; None for an empty map.

    Raises ConfigError if the graph has no such node; `when` tells the graph's time in the message.
    """
    if focus is not None:
        spot = place(graph, focus)
        if spot is None and focus in graph.history:
            spot = (graph.history[focus].box_min + graph.history[focus].box_max) / 2
        if spot is None:
            raise ConfigError(f"the graph has no node {focus!r} {when}", key="--focus")
        return _eye(spot, max(2.5, 2.0 * _diagonal(graph, focus)))
    spots = [node.center for node in graph.objects.values()] + [n.position for n in graph.waypoints.values()]
    return eye_over(spots)


def eye_over(spots: Sequence[Any], margin: float = 0.0) -> Eye | None:
    """An eye that sees all spots (3,), and `margin` metres around them, from above; None for none."""
    if not len(spots):
        return None
    low, high = np.min(spots, axis=0), np.max(spots, axis=0)
    distance = max(3.0, 0.85 * float(np.linalg.norm(high - low)) + margin)
    # What is near looks larger: the middle of the view lies on this side of the map's own.
    return _eye((low + high) / 2 + _NEARER * distance * _FROM * (1, 1, 0), distance)


def _diagonal(graph: GraphView, node: str) -> float:
    """Metres from corner to corner of an object's box; 0 for what has none."""
    found = graph.objects.get(node)
    return 0.0 if found is None else float(np.linalg.norm(found.box_max - found.box_min))


def _eye(target: FloatArray, distance: float) -> Eye:
    position = target + distance * _FROM
    return Eye(_triple(position), _triple(target))


def _triple(values: FloatArray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
