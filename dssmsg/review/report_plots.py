"""Plots of a report as SVG: lines over the frames of a run, and lanes of states."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

from dssmsg.review.report_markup import Markup, joined, tag, text

Point = tuple[float, float]
COLOURS = ("#2f6fde", "#e07b39", "#2c9f6b", "#a855c7", "#c93c37", "#0e94a8", "#8a8f9c", "#b58a00")
MAX_POINTS = 400
"""Points of a line that are drawn; of more, the highest of each stretch."""

_WIDTH, _HEIGHT = 560.0, 220.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 12.0, 12.0, 30.0


def line_plot(title: str, lines: Mapping[str, Sequence[Point]], *, unit: str = "") -> Markup:
    """Lines over frames, with a legend; nothing where no line has a point."""
    drawn = {name: thinned(points) for name, points in lines.items() if points}
    if not drawn:
        return Markup("")
    low_x = min(x for points in drawn.values() for x, _ in points)
    high_x = max(x for points in drawn.values() for x, _ in points)
    ticks = nice_ticks(0.0, max((y for points in drawn.values() for _, y in points), default=1.0))
    span_x, span_y = max(high_x - low_x, 1.0), ticks[-1]

    def place(point: Point) -> str:
        x = _LEFT + (point[0] - low_x) / span_x * (_WIDTH - _LEFT - _RIGHT)
        y = _HEIGHT - _BOTTOM - point[1] / span_y * (_HEIGHT - _TOP - _BOTTOM)
        return f"{x:.1f},{y:.1f}"

    parts = [_axis_y(value, value / span_y) for value in ticks]
    parts += [
        _axis_x(value, (value - low_x) / span_x)
        for value in nice_ticks(low_x, high_x)
        if low_x <= value <= high_x
    ]
    for (name, points), colour in zip(drawn.items(), _colours(len(drawn)), strict=True):
        path = " ".join(place(point) for point in points)
        line = tag("polyline", tag("title", name), points=path, fill="none", stroke=colour, stroke_width=1.8)
        parts.append(line)
    label = f"{title}, {unit}" if unit else title
    return tag(
        "figure",
        tag("h3", label),
        _svg(_HEIGHT, label, parts),
        legend(dict(zip(drawn, _colours(len(drawn)), strict=True))),
    )


def lanes(
    title: str, rows: Mapping[str, Sequence[tuple[int, str]]], end: int, colours: Mapping[str, str]
) -> Markup:
    """States over frames, a lane a name: each state from its frame to the next one's, the last to `end`."""
    rows = {name: row for name, row in rows.items() if row}
    if not rows:
        return Markup("")
    height = _TOP + 34.0 * len(rows) + _BOTTOM
    span = max(end, 1)
    scale = (_WIDTH - _LEFT - _RIGHT) / span
    parts: list[Markup] = []
    for number, (name, row) in enumerate(rows.items()):
        y = _TOP + 34.0 * number
        parts.append(
            tag("text", name, x=_LEFT - 6, y=y + 17, font_size=11, text_anchor="end", fill="#667085")
        )
        for (first, state), after in zip(row, [*(frame for frame, _ in row[1:]), end], strict=True):
            x, wide = _LEFT + first * scale, max((after - first) * scale, 0.8)
            told = tag("title", f"{state}, frames {first} to {after}")
            colour = colours.get(state, "#8a8f9c")
            parts.append(tag("rect", told, x=f"{x:.1f}", y=y, width=f"{wide:.1f}", height=26, fill=colour))
    parts += [_axis_x(value, value / span, height) for value in nice_ticks(0, span) if value <= span]
    used = {state: colours.get(state, "#8a8f9c") for row in rows.values() for _, state in row}
    return tag("figure", tag("h3", title), _svg(height, title, parts), legend(used))


def legend(colours: Mapping[str, str]) -> Markup:
    """Names with their colours."""
    return tag(
        "div",
        *(tag("span", tag("i", style=f"background:{colour}"), name) for name, colour in colours.items()),
        class_="legend",
    )


def thinned(points: Sequence[Point]) -> list[Point]:
    """At most `MAX_POINTS` of the points, in order: the highest of each stretch."""
    if len(points) <= MAX_POINTS:
        return list(points)
    edges = [round(n * len(points) / MAX_POINTS) for n in range(MAX_POINTS + 1)]
    return [max(points[first:after], key=lambda point: point[1]) for first, after in pairwise(edges)]


def nice_ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Round values from at most `low` to at least `high`, in about `count` steps."""
    span = high - low if high > low else 1.0
    rough = span / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough * 0.999)
    first = math.floor(low / step)
    last = math.ceil((low + span) / step - 1e-9)
    return [round(step * number, 10) for number in range(first, last + 1)]


def _colours(count: int) -> list[str]:
    return [COLOURS[number % len(COLOURS)] for number in range(count)]


def _svg(height: float, label: str, parts: Sequence[Markup]) -> Markup:
    return tag(
        "svg",
        joined(parts),
        viewBox=f"0 0 {_WIDTH:.0f} {height:.0f}",
        role="img",
        aria_label=text(label, 200),
    )


def _axis_y(value: float, share: float) -> Markup:
    y = f"{_HEIGHT - _BOTTOM - share * (_HEIGHT - _TOP - _BOTTOM):.1f}"
    line = tag("line", x1=_LEFT, x2=_WIDTH - _RIGHT, y1=y, y2=y, stroke="#e2e6ee")
    return joined((line, tag("text", f"{value:g}", x=_LEFT - 6, y=y, dy=4, **_SMALL, text_anchor="end")))


def _axis_x(value: float, share: float, height: float = _HEIGHT) -> Markup:
    x = f"{_LEFT + share * (_WIDTH - _LEFT - _RIGHT):.1f}"
    return tag("text", f"{value:g}", x=x, y=height - 10, **_SMALL, text_anchor="middle")


_SMALL = {"font_size": 11, "fill": "#667085"}
