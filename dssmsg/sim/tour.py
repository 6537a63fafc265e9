"""The survey tour: one a visit, checked against what stands in the way, with an estimate of what it costs."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from dssmsg.errors import InputError
from dssmsg.interfaces.source import Stop
from dssmsg.sim.occupancy import ROBOT_RADIUS, Occupancy
from dssmsg.sim.scene import Scene
from dssmsg.sim.scene_layout import Layout, build_layout
from dssmsg.sim.scene_placement import Placer
from dssmsg.sim.script import closed_doors, visit_states
from dssmsg.sim.solid import Solid

DRIVE_SPEED = 0.5
TURN_SPEED = 1.2
FLAT_CORNER_RAD = math.radians(25)
FRAMES_A_VIEW = 4
KEY_FRAMES_A_VIEW = 3


def tour_of(scene: Scene, visit: int) -> tuple[Stop, ...]:
    """The tour of a visit: as written on even visits, backwards on odd ones.

    Backwards starts where the visit before ended, so nothing is driven only to get back. Stops behind
    closed doors are left out.
    """
    stops = _in_order(scene, visit)
    closed = closed_doors(scene, visit)
    if not closed or not stops:
        return stops
    start = tour_of(scene, visit - 1)[-1].room if visit else stops[0].room
    rooms = joined_rooms(scene, start, closed)
    return tuple(stop for stop in stops if stop.room in rooms)


def joined_rooms(scene: Scene, start: str, closed: Collection[str]) -> frozenset[str]:
    """Names of the rooms that can be walked to from `start` with some doors closed, itself included."""
    found, ring = {start}, {start}
    while ring:
        ring = {
            other
            for door in scene.doors
            if door.name not in closed and ring & set(door.between)
            for other in door.between
        } - found
        found |= ring
    return frozenset(found)


def _in_order(scene: Scene, visit: int) -> tuple[Stop, ...]:
    stops = tuple(
        Stop(
            name=stop.name,
            x=stop.at[0],
            y=stop.at[1],
            views=tuple((math.radians(heading), math.radians(tilt)) for heading, tilt in stop.views),
            via=stop.via,
            room=scene.room_at(*stop.at),
        )
        for stop in scene.tour
    )
    if visit % 2 == 0:
        return tuple(replace(stop, via=()) if i == 0 else stop for i, stop in enumerate(stops))
    backwards = []
    for i in range(len(stops) - 1, -1, -1):
        via = stops[i + 1].via[::-1] if i + 1 < len(stops) else ()
        backwards.append(replace(stops[i], via=via))
    return tuple(backwards)


@dataclass(frozen=True, slots=True)
class TourCost:
    """What a tour is expected to take: camera frames, key frames, views, metres driven."""

    frames: int
    key_frames: int
    views: int
    metres: float


def estimate(tour: Sequence[Stop], rate_hz: float = 5.0) -> TourCost:
    """The cost of a tour driven at 0.5 m/s, turned at 1.2 rad/s; a view takes four frames, three key.

    The head pans to a view while the base still turns, so only legs pay for turning: a quarter of a
    second more than the turn, and half a second for speeding up and braking, unless the way goes nearly
    straight on. Key frames while driving come each 0.5 m and each 30 degrees (ALGORITHM A.6).
    """
    seconds, metres, views, driving_keys = 0.0, 0.0, 0, 0
    heading: float | None = None
    place: tuple[float, float] | None = None
    for stop in tour:
        for corner in (*stop.via, (stop.x, stop.y)):
            if place is not None and math.dist(place, corner) > 1e-6:
                bearing = math.atan2(corner[1] - place[1], corner[0] - place[0])
                turn = 0.0 if heading is None else abs(math.remainder(bearing - heading, math.tau))
                length = math.dist(place, corner)
                seconds += length / DRIVE_SPEED
                if turn > FLAT_CORNER_RAD or heading is None:
                    seconds += turn / TURN_SPEED + 0.75
                driving_keys += int(length / 0.5) + int(turn / math.radians(30))
                metres += length
                heading = bearing
            place = corner
        heading = stop.views[-1][0] if stop.views else heading
        views += len(stop.views)
    frames = math.ceil(seconds * rate_hz) + FRAMES_A_VIEW * views
    return TourCost(frames, KEY_FRAMES_A_VIEW * views + driving_keys, views, metres)


def visit_solids(scene: Scene, layout: Layout, placer: Placer, visit: int) -> tuple[Solid, ...]:
    """Everything that stands in the way at any time of a visit: structure and all states of the furniture."""
    if closed := closed_doors(scene, visit):
        layout = build_layout(scene, closed)
    furniture: dict[tuple[object, ...], Solid] = {}
    for state in visit_states(scene, placer, visit):
        for piece in state.values():
            furniture[piece.name, piece.solid.center, piece.solid.yaw_rad] = piece.solid
    return (*layout.solids, *furniture.values())


def tour_problems(
    tour: Sequence[Stop], occupancy: Occupancy, radius: float = ROBOT_RADIUS
) -> tuple[str, ...]:
    """What keeps a robot of `radius` from driving the tour, a line a stop or leg; empty when nothing does."""
    problems = []
    place: tuple[float, float] | None = None
    for stop in tour:
        if not stop.room:
            problems.append(f"stop {stop.name} at ({stop.x:.2f}, {stop.y:.2f}) is in no room")
        for corner in (*stop.via, (stop.x, stop.y)):
            start = corner if place is None else place
            clear = occupancy.leg_clearance(start, corner)
            if clear < radius:
                owner = occupancy.nearest_owner(start, corner)
                problems.append(
                    f"stop {stop.name}: the leg ({start[0]:.2f}, {start[1]:.2f}) to ({corner[0]:.2f}, "
                    f"{corner[1]:.2f}) passes {owner} at {clear:.2f} m; the robot needs {radius} m"
                )
            place = corner
    return tuple(problems)


def check_tour(scene: Scene, layout: Layout, placer: Placer, visits: int = 2) -> None:
    """Raise InputError naming the first stop that cannot be reached in any of the first `visits` visits."""
    for visit in range(visits):
        occupancy = Occupancy(scene, visit_solids(scene, layout, placer, visit))
        problems = tour_problems(tour_of(scene, visit), occupancy)
        if problems:
            more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
            raise InputError(f"visit {visit}, {problems[0]}{more}", file=scene.name, key="tour")
