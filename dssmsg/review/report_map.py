"""The map of a report: objects, topology and the robot's trail from above, as SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.frame import FloatArray
from dssmsg.graph.nodes import BELIEVED, NEAR, PATH, SEES, ObjectNode
from dssmsg.graph.view import GraphView
from dssmsg.recording import palette
from dssmsg.recording.looks import spread_labels
from dssmsg.review.report_markup import Markup, joined, tag, text
from dssmsg.review.report_plots import COLOURS, legend

MAX_LABELS = 150
_PIXELS_A_METRE = 100.0
_MARGIN_M = 0.5
_FURTHEST_M = 1000.0
"""Nothing of a map lies further from its middle; what does is damaged, and left out."""

Trail = Mapping[int, Sequence[FloatArray]]
"""Positions (3,) of the base, world metres, by visit."""


def state_colour(state: str) -> str:
    """The colour of an object's dynamic state, as in the viewer."""
    return _rgb(palette.OBJECT_CLASSES.get(state, palette.OBJECT_CLASSES["static"])[2])


@dataclass(frozen=True, slots=True, eq=False)
class Spot:
    """A marked point (3,), metres, its word, and whether what happened there was meant to."""

    place: FloatArray
    word: str
    well: bool


def floor_map(graph: GraphView, trail: Trail, marks: Sequence[Spot] = ()) -> Markup:
    """The map with marked points. Nothing where there is nothing to draw."""
    objects = [node for node in graph.objects.values() if node.status == BELIEVED and _sane(node.center)]
    spots = [spot for points in trail.values() for spot in points if _sane(spot)]
    spots += [node.position for node in graph.waypoints.values() if _sane(node.position)]
    corners = [corner for node in objects for corner in (node.box_min, node.box_max) if _sane(corner)]
    if not spots and not corners:
        return Markup("")
    all_xy = np.array([point[:2] for point in (*spots, *corners)])
    frame = _Paper(all_xy.min(axis=0) - _MARGIN_M, all_xy.max(axis=0) + _MARGIN_M)
    parts = [
        *(_box(frame, node) for node in sorted(objects, key=_area, reverse=True)),
        *_former_places(frame, graph),
        *_trail(frame, trail),
        *_roads(frame, graph),
        *_labels(frame, objects[:MAX_LABELS]),
        *(_mark(frame, spot) for spot in marks if _sane(spot.place)),
        frame.scale(),
    ]
    picture = tag("svg", joined(parts), viewBox=frame.view_box, role="img", aria_label="map from above")
    states = dict.fromkeys(node.state for node in objects)
    shown = {str(text(state, 40)): state_colour(state) for state in states}
    shown |= {f"way in visit {visit}": _visit_colour(visit) for visit in trail}
    shown |= {
        "path edge": _rgb(palette.EDGE_COLOURS[PATH]),
        "blocked edge": _rgb(palette.EDGE_COLOURS["blocked"]),
    }
    if graph.history:
        shown["former place"] = _rgb(palette.OBJECT_CLASSES["history"][2])
    note = ""
    if len(objects) > MAX_LABELS:
        note = tag("p", f"{MAX_LABELS} of {len(objects)} objects are named", class_="note")
    return tag("figure", picture, legend(shown), note)


class _Paper:
    """World metres (x, y) to pixels, y up."""

    def __init__(self, low: FloatArray, high: FloatArray) -> None:
        self._low, self._high = low, high
        span = float((high - low).max())
        # Large maps are drawn smaller, so that what is written stays readable.
        self._pixels = min(_PIXELS_A_METRE, 1600.0 / span)
        self._size = (high - low) * self._pixels

    @property
    def view_box(self) -> str:
        return f"0 0 {self._size[0]:.0f} {self._size[1]:.0f}"

    def xy(self, point: FloatArray) -> FloatArray:
        """Pixels (2,) of a world point (2,) or (3,)."""
        return np.array([point[0] - self._low[0], self._high[1] - point[1]]) * self._pixels

    def place(self, point: FloatArray) -> str:
        x, y = self.xy(point)
        return f"{x:.1f},{y:.1f}"

    def scale(self) -> Markup:
        """A bar of one metre in the corner."""
        y = f"{self._size[1] - 14:.1f}"
        bar = tag("line", x1=14, x2=f"{14 + self._pixels:.1f}", y1=y, y2=y, stroke="#1d2330", stroke_width=3)
        return joined((bar, tag("text", "1 m", x=14, y=y, dy=-7, font_size=13, fill="#1d2330")))


def _sane(point: FloatArray) -> bool:
    return bool(np.isfinite(point).all() and np.abs(point).max() < _FURTHEST_M)


def _area(node: ObjectNode) -> float:
    size = node.box_max - node.box_min
    return float(size[0] * size[1])


def _rectangle(paper: _Paper, low: FloatArray, high: FloatArray, title: str, **style: object) -> Markup:
    x0, y1 = paper.xy(low)
    x1, y0 = paper.xy(high)
    return tag(
        "rect",
        tag("title", text(title, 300)),
        x=f"{x0:.1f}",
        y=f"{y0:.1f}",
        width=f"{max(x1 - x0, 2):.1f}",
        height=f"{max(y1 - y0, 2):.1f}",
        rx=2,
        **style,
    )


def _box(paper: _Paper, node: ObjectNode) -> Markup:
    colour = state_colour(node.state)
    title = f"{node.id}: {node.label}, {node.state}, {node.observations} observations"
    return _rectangle(
        paper,
        node.box_min,
        node.box_max,
        title,
        fill=colour,
        fill_opacity=0.22,
        stroke=colour,
        stroke_width=1.2,
    )


def _former_places(paper: _Paper, graph: GraphView) -> list[Markup]:
    colour = _rgb(palette.OBJECT_CLASSES["history"][2])
    return [
        _rectangle(
            paper,
            place.box_min,
            place.box_max,
            f"{place.id}: {place.label} was here",
            fill="none",
            stroke=colour,
            stroke_dasharray="5 4",
            stroke_width=1.4,
        )
        for place in graph.history.values()
        if _sane(place.box_min) and _sane(place.box_max)
    ]


def _roads(paper: _Paper, graph: GraphView) -> list[Markup]:
    parts = []
    for edge in graph.edges.values():
        if edge.kind in (SEES, NEAR) or not {edge.source, edge.target} <= graph.waypoints.keys():
            continue
        ends = [graph.waypoints[name].position for name in (edge.source, edge.target)]
        if not all(map(_sane, ends)):
            continue
        blocked = bool(edge.attributes.get("blocked", False))
        (x1, y1), (x2, y2) = (paper.xy(end) for end in ends)
        parts.append(
            tag(
                "line",
                x1=f"{x1:.1f}",
                y1=f"{y1:.1f}",
                x2=f"{x2:.1f}",
                y2=f"{y2:.1f}",
                stroke=_rgb(palette.EDGE_COLOURS["blocked" if blocked else PATH]),
                stroke_width=3 if blocked else 1.4,
                stroke_opacity=1 if blocked else 0.55,
            )
        )
    return parts


def _trail(paper: _Paper, trail: Trail) -> list[Markup]:
    parts = []
    for visit, points in trail.items():
        sane = [point for point in points if _sane(point)]
        if not sane:
            continue
        colour = _visit_colour(visit)
        path = " ".join(paper.place(point) for point in sane)
        parts.append(
            tag(
                "polyline", points=path, fill="none", stroke=colour, stroke_width=2.2, stroke_linejoin="round"
            )
        )
        for point, word, filled in ((sane[0], "start", "#fff"), (sane[-1], "end", colour)):
            x, y = paper.xy(point)
            title = tag("title", f"{word} of visit {visit}")
            parts.append(
                tag(
                    "circle",
                    title,
                    cx=f"{x:.1f}",
                    cy=f"{y:.1f}",
                    r=6,
                    fill=filled,
                    stroke=colour,
                    stroke_width=2.5,
                )
            )
    return parts


def _labels(paper: _Paper, objects: Sequence[ObjectNode]) -> list[Markup]:
    """Names beside their objects, moved apart; a thin line leads to the object where a name went far."""
    if not objects:
        return []
    anchors = np.array([paper.xy(node.center) for node in objects], np.float32)
    names = [node.label if len(node.label) <= 24 else f"{node.label[:23]}…" for node in objects]
    # Labels are spread for letters of twice this size.
    spots = spread_labels(anchors * 1.5, [len(name) for name in names]) / 1.5
    parts = []
    for anchor, spot, name in zip(anchors, spots, names, strict=True):
        if float(np.hypot(*(anchor - spot))) > 14:
            (x1, y1), (x2, y2) = anchor, spot
            parts.append(
                tag("line", x1=f"{x1:.1f}", y1=f"{y1:.1f}", x2=f"{x2:.1f}", y2=f"{y2:.1f}", stroke="#b9c0cf")
            )
        parts.append(
            tag(
                "text",
                name,
                x=f"{spot[0]:.1f}",
                y=f"{spot[1]:.1f}",
                dy=4,
                font_size=11.5,
                text_anchor="middle",
                fill="#1d2330",
                stroke="#fff",
                stroke_width=3,
                paint_order="stroke",
            )
        )
    return parts


def _mark(paper: _Paper, spot: Spot) -> Markup:
    x, y = paper.xy(spot.place)
    colour = "#1a7f37" if spot.well else "#c93c37"
    star = tag("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=9, fill="none", stroke=colour, stroke_width=3)
    name = tag(
        "text",
        text(spot.word, 40),
        x=f"{x:.1f}",
        y=f"{y:.1f}",
        dy=-14,
        font_size=13,
        font_weight=600,
        text_anchor="middle",
        fill=colour,
        stroke="#fff",
        stroke_width=3,
        paint_order="stroke",
    )
    return joined((star, name))


def _visit_colour(visit: int) -> str:
    return ("#d6408f", "#7a3fd0", *COLOURS)[visit % (2 + len(COLOURS))]


def _rgb(colour: Sequence[int]) -> str:
    """An opaque colour that shows on white: the viewer's are made for a dark ground."""
    return "#" + "".join(f"{int(part * 0.82):02x}" for part in colour[:3])
