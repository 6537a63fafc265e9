"""The way round an obstacle inside the rolling grid: where to rejoin the way, and how (ALGORITHM E)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dssmsg.frame import FloatArray, IntArray
from dssmsg.navigation.astar import Cell, cheapest_way
from dssmsg.navigation.grid import Point, RollingGrid
from dssmsg.navigation.shortcut import corners_of


@dataclass(frozen=True, slots=True)
class DetourOptions:
    """Metres, unless said otherwise."""

    radius: float = 0.18
    margin: float = 0.04
    """On top of the radius: cells and readings are not exact."""
    comfort: float = 0.15
    """Further from things than radius + margin by this, a cell costs nothing extra."""
    unknown_cost: float = 3.0
    """How many times as dear a step over unseen floor is."""
    stretch: float = 1.5
    """The longest acceptable way round: so many times the straight one, and `extra` metres more."""
    extra: float = 0.8
    reach: float = 2.7
    """No further ahead than this is the way rejoined: the grid ends at 3 m."""
    asides: tuple[float, ...] = (0.0, 0.2, -0.2, 0.4, -0.4)
    """So far beside the way, to the left, it may be rejoined."""
    half_width: float = 0.15
    """Half the width that a way which was driven once must have."""
    onward: float = 1.5
    """So far behind a place to rejoin at the way should be clear, else what blocks it is still ahead."""
    hopeful: bool = False
    """Whether unseen floor right behind something may be free: whoever drives there sees it."""
    outlined: bool = False
    """Whether the outlines of known things are kept off, too (`RollingGrid.outline`)."""
    near_end: float = 0.6
    """Where something stands on the way's end, a place this near stands in for it."""


@dataclass(frozen=True, slots=True)
class Detour:
    """Corner points from where the robot stands (left out) to where the way is rejoined.

    `leg`: index of the way's point that comes after the last corner; the number of its points where the last
    corner stands in for the way's end.
    """

    corners: tuple[Point, ...]
    leg: int


def find_detour(
    grid: RollingGrid, start: Point, way: Sequence[Point], options: DetourOptions | None = None
) -> Detour | None:
    """A drivable way from `start` back onto the way through the points `way`, beyond what blocks it.

    Candidates to rejoin at lie each 0.2 m along the way behind the obstacle, and at its points; the first
    (so the nearest) that can be reached at an acceptable length is taken, before all others those from which
    the way goes on clear. None if none can.
    """
    o = options or DetourOptions()
    cost = step_costs(grid, start, o)
    here = grid.cell(start)
    if here is None:
        return None
    islands, _ = ndimage.label(np.isfinite(cost), structure=np.ones((3, 3)))
    tried: set[Cell] = set()
    places = sorted(
        _rejoining(grid, start, way, o), key=lambda one: not _goes_on(grid, one[0], way[one[1] :], o)
    )
    for place, leg, straight in places:
        cell = grid.cell(place)
        if cell is None or cell in tried or islands[cell] != islands[here]:
            continue
        tried.add(cell)
        cells = cheapest_way(cost, here, cell)
        if cells is None:
            continue
        corners = corners_of(grid, cost, start, cells, place)
        length = math.dist(start, corners[0]) + sum(math.dist(a, b) for a, b in itertools.pairwise(corners))
        if length <= o.stretch * straight + o.extra:
            return Detour(corners, leg)
        if len(tried) >= 6:  # further points are behind the same obstacle: no use in trying them all
            return None
    return None


def step_costs(grid: RollingGrid, start: Point, options: DetourOptions) -> FloatArray:
    """(n, n) what a step into a cell costs: inf where the robot does not fit.

    Close to the start it may be as near to things as it is now, else it could not leave a narrow place.
    """
    o, rooms = options, [grid.clearance(hopeful=options.hopeful)]
    if o.outlined:
        rooms.append(grid.clearance(hopeful=o.hopeful, outlined=True))
    here = grid.cell(start)
    tight = np.clip((o.radius + o.margin + o.comfort - rooms[-1]) / o.comfort, 0.0, 1.0)
    cost: FloatArray = np.where(grid.known_free, 1.0, o.unknown_cost) * (1.0 + 3.0 * tight)
    for clearance in rooms:
        need = np.full(clearance.shape, o.radius + o.margin)
        if here is not None:
            index: IntArray = np.indices(clearance.shape, dtype=np.int32)
            away = np.hypot(index[0] - here[0], index[1] - here[1]) * grid.options.cell
            need[away <= 0.3] = min(o.radius + o.margin, float(clearance[here]))
        cost[clearance < need - 1e-9] = np.inf
    if here is not None:
        cost[grid.occupied] = np.inf
        cost[here] = 1.0
    return cost


def is_clear(grid: RollingGrid, start: Point, corners: Sequence[Point], half_width: float) -> bool:
    """Whether nothing known stands on the polyline from `start` through the corners."""
    legs = itertools.pairwise([start, *corners])
    return all(grid.corridor(a, b, half_width).obstacle is None for a, b in legs)


def _rejoining(
    grid: RollingGrid, start: Point, way: Sequence[Point], options: DetourOptions
) -> Iterator[tuple[Point, int, float]]:
    """Places on the way behind its first obstacle, nearest first; last those that stand in for its end.

    Each with the index of the way's point that comes next, and the metres there along the way.
    """
    travelled, behind = 0.0, False
    clearance = grid.clearance(hopeful=options.hopeful, outlined=options.outlined)
    room = options.radius + options.margin
    for leg, (a, b) in enumerate(itertools.pairwise([start, *way])):
        length = max(math.dist(a, b), 1e-6)
        steps = max(1, math.ceil(length / 0.2))
        for step in range(1, steps + 1):
            share = step / steps
            place = (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))
            if math.dist(start, place) > options.reach:
                return
            behind = behind or not _has_room(grid, clearance, place, room)
            if not behind or travelled + share * length <= 0.4:
                continue
            for aside in options.asides:  # the way may pass as close to things as it was driven, a detour not
                beside = (
                    place[0] - aside * (b[1] - a[1]) / length,
                    place[1] + aside * (b[0] - a[0]) / length,
                )
                straight_on = step == steps or not aside or is_clear(grid, beside, [b], options.radius)
                if _has_room(grid, clearance, beside, room) and straight_on:
                    yield beside, leg + (step == steps), travelled + share * length
                    break
        travelled += length
    for place in _around(way[-1], options.near_end):
        if _has_room(grid, clearance, place, room):
            yield place, len(way), travelled


def _goes_on(grid: RollingGrid, place: Point, rest: Sequence[Point], options: DetourOptions) -> bool:
    """Whether nothing known stands on the way from a place to rejoin at, as far as it should be clear."""
    left, half_width = options.onward, options.radius
    for a, b in itertools.pairwise([place, *rest]):
        length = math.dist(a, b)
        if length > 1e-6:
            share = min(1.0, left / length)
            end = (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))
            if grid.corridor(a, end, half_width).obstacle is not None:
                return False
        left, half_width = left - length, options.half_width
        if left <= 0:
            break
    return True


def _has_room(grid: RollingGrid, clearance: FloatArray, place: Point, room: float) -> bool:
    cell = grid.cell(place)
    return cell is not None and float(clearance[cell]) >= room


def _around(middle: Point, radius: float) -> Iterator[Point]:
    """Places around a point, ring by ring."""
    for ring in np.arange(0.2, radius + 1e-9, 0.2):
        for angle in np.arange(0.0, math.tau - 1e-9, math.pi / 4):
            yield middle[0] + float(ring * math.cos(angle)), middle[1] + float(ring * math.sin(angle))
