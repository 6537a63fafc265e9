"""What a tour gets to see: pixels of every piece from every view, and a choice of views that sees most."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dssmsg.frame import Camera
from dssmsg.interfaces.source import Stop
from dssmsg.sim.camera import Renderer
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.robot import RobotSpec, camera_pose
from dssmsg.sim.scene import Scene
from dssmsg.sim.tour import tour_of
from dssmsg.sim.world import World

SEEN_PIXELS = 200
SEEN_FRAMES = 3
SEEN_RANGE_M = 4.0
SWEEP_RAD = math.radians(6.0)
TILTS_RAD = (0.0, math.radians(-25.0))
HORIZONTAL_FOV_RAD = math.radians(69.4)
FULL_WIDTH, FULL_HEIGHT = 320, 240
APART_RAD = math.radians(35.0)
_WORTH = (1.0, 0.25, 0.1)
_COARSE = 2  # candidate views are rendered at half the size, so a pixel there stands for four


def seen_frames(
    world: World, tour: Sequence[Stop], *, range_m: float = SEEN_RANGE_M, pixels: int = SEEN_PIXELS
) -> dict[str, int]:
    """For every piece now in the world: in how many of the tour's key frames at stops it is seen.

    A view gives three key frames, 6 degrees apart. Seen means at least `pixels` pixels of a 320x240 image
    nearer than `range_m` metres, the bar that scores use.
    """
    camera = Camera.from_fov(FULL_WIDTH, FULL_HEIGHT, HORIZONTAL_FOV_RAD)
    counts = dict.fromkeys(world.pieces, 0)
    names = {piece.instance_id: piece.name for piece in world.pieces.values()}
    for stop in tour:
        for heading, tilt in stop.views:
            for offset in (-SWEEP_RAD, 0.0, SWEEP_RAD):
                for number, area in _areas(world, camera, stop, heading + offset, tilt, range_m).items():
                    counts[names[number]] += area >= pixels
    return counts


@dataclass(frozen=True, slots=True)
class View:
    """A view that a stop offers, and the instance ids of the pieces it shows well."""

    stop: str
    heading: float
    tilt: float
    shown: frozenset[int]


def possible_views(world: World, stops: Sequence[Stop], step_rad: float = math.radians(20.0)) -> list[View]:
    """Every heading and tilt at every stop, in the world as it is now.

    A piece is shown where it fills half as much again as it must, so that the sweep of a view keeps it.
    """
    camera = Camera.from_fov(FULL_WIDTH // _COARSE, FULL_HEIGHT // _COARSE, HORIZONTAL_FOV_RAD)
    need = 1.5 * SEEN_PIXELS / _COARSE**2
    views = []
    for stop in stops:
        for heading in np.arange(-math.pi, math.pi - 1e-9, step_rad):
            for tilt in TILTS_RAD:
                areas = _areas(world, camera, stop, float(heading), tilt, SEEN_RANGE_M)
                shown = frozenset(number for number, area in areas.items() if area >= need)
                views.append(View(stop.name, float(heading), tilt, shown))
    return views


def views_of_both(before: Sequence[View], after: Sequence[View], changed: frozenset[int]) -> list[View]:
    """The same views before and after changes: `changed` pieces count once for each, as -id afterwards."""
    return [
        replace(old, shown=old.shown | {-number for number in new.shown if number in changed})
        for old, new in zip(before, after, strict=True)
    ]


def choose_views(
    stops: Sequence[Stop], candidates: Sequence[View], views: int
) -> dict[str, tuple[tuple[float, float], ...]]:
    """(heading, tilt) pairs by stop name, at most `views` in all and at least one a stop.

    Greedy cover: each step takes the view that shows most pieces for the first time, later sightings
    counting less; among equals the stop with fewer views. Headings at a stop come in turning order.
    """
    left = list(candidates)
    times: dict[int, int] = {}
    chosen: dict[str, list[tuple[float, float]]] = {stop.name: [] for stop in stops}
    while left and views > 0:
        empty = [name for name, taken in chosen.items() if not taken]
        # Once the views left only just serve the stops that have none, only those may take one.
        open_to = left if views > len(empty) else [view for view in left if view.stop in empty]
        best = max(open_to, key=lambda view: _gain(view.shown, times) - 0.1 * len(chosen[view.stop]))
        if _gain(best.shown, times) <= 0 and best.stop not in empty:
            if not empty:
                break
            best = next(view for view in left if view.stop in empty)
        left = [view for view in left if not _same(view, best)]
        views -= 1
        chosen[best.stop].append((best.heading, best.tilt))
        for number in best.shown:
            times[number] = times.get(number, 0) + 1
    return {name: _turning_order(taken) for name, taken in chosen.items()}


def _same(first: View, second: View) -> bool:
    """Whether two views are too alike to be told apart as viewpoints (ALGORITHM A.5), sweep included."""
    turn = abs(math.remainder(first.heading - second.heading, math.tau))
    return first.stop == second.stop and first.tilt == second.tilt and turn < APART_RAD


def suggest_views(
    scene: Scene, library: FurnitureLibrary, renderer: Renderer, views: int
) -> dict[str, tuple[tuple[float, float], ...]]:
    """Views for the stops of a scene that show its pieces best, before and after the changes of visit 1.

    The views that the scene has are ignored. The renderer is filled anew and closed.
    """
    world = World(scene, library, renderer)
    try:
        stops = tour_of(scene, 0)
        before = possible_views(world, stops)
        changed = frozenset(world.placer.instance_id(name) for name in world.changing)
        world.make(change for change in scene.changes if change.visit <= 1)
        after = possible_views(world, stops)
        return choose_views(stops, views_of_both(before, after, changed), views)
    finally:
        world.close()


def _gain(shown: Iterable[int], times: Mapping[int, int]) -> float:
    """What a view adds: each piece counts fully at its first sighting, less at the next two, then nothing."""
    return sum(_WORTH[times.get(number, 0)] for number in shown if times.get(number, 0) < len(_WORTH))


def _turning_order(views: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Sorted by heading, beginning behind the widest gap, so that the robot turns least."""
    ordered = sorted(views)
    if len(ordered) < 3:
        return tuple(ordered)
    headings = [heading for heading, _ in ordered]
    gaps = [(headings[i] - headings[i - 1]) % math.tau for i in range(len(headings))]
    start = int(np.argmax(gaps))
    return tuple(ordered[start:] + ordered[:start])


def _areas(
    world: World, camera: Camera, stop: Stop, heading: float, tilt: float, range_m: float
) -> dict[int, int]:
    pose = camera_pose(stop.x, stop.y, heading, 0.0, tilt, RobotSpec())
    render, _ = world.look(camera, pose)
    ids = render.instance_ids[(render.depth > 0) & (render.depth <= range_m)]
    numbers, counts = np.unique(ids[ids > 0], return_counts=True)
    return {int(n): int(c) for n, c in zip(numbers, counts, strict=True)}
