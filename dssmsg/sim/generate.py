"""Furnished apartments from a seed, with a tour planned on the simulator's own occupancy, for statistics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.errors import InputError
from dssmsg.sim.furnish import SMALL, Furnisher, Slot
from dssmsg.sim.occupancy import Occupancy
from dssmsg.sim.scene import (
    Appear,
    Change,
    Disappear,
    Door,
    Piece,
    Placement,
    Query,
    Relocate,
    Room,
    Scene,
    TourStop,
)
from dssmsg.sim.scene_layout import build_layout
from dssmsg.sim.tour import estimate, tour_of

MAX_FRAMES = 560
"""A visit's budget in camera frames at 5 Hz, with some left for what an estimate misses (limit 600)."""
PLAN_RADIUS_M = 0.22
SLOT_REACH_M = 1.2
_DOOR_M = 0.8
_WALL_M = 0.1
_ATTEMPTS = 200
_AREAS = {
    "living room": 19.0,
    "bedroom": 13.0,
    "dining room": 12.0,
    "kitchen": 9.5,
    "study": 9.5,
    "bathroom": 6.0,
}
_PROGRAMMES = {
    4: ("living room", "bedroom", "kitchen", "bathroom"),
    5: ("living room", "bedroom", "bedroom", "kitchen", "bathroom"),
    6: ("living room", "dining room", "bedroom", "bedroom", "kitchen", "bathroom"),
    7: ("living room", "dining room", "bedroom", "bedroom", "study", "kitchen", "bathroom"),
}
_PLANS = 12
"""Plans drawn for each attempt, of which the one with the squarest rooms is furnished."""
_VIEWS_A_STOP = 5
_FREE_SLOTS = 4
"""Places left empty at first: two for things that appear, two for things that are relocated."""
Rect = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class _Place:
    """A stop of the tour before its views are known."""

    name: str
    at: tuple[float, float]
    via: tuple[tuple[float, float], ...]
    room: str


def generate_scene(seed: int) -> Scene:
    """An apartment of 4 to 7 furnished rooms; the same seed always gives the same one.

    Raises InputError for a seed of which nothing drivable comes (none is known).
    """
    programme = _PROGRAMMES[int(np.random.default_rng(seed).integers(4, 8))]
    for attempt in range(_ATTEMPTS):
        scene = _attempt(seed, programme, np.random.default_rng([seed, attempt]))
        if scene is not None:
            return scene
    raise InputError(
        f"no apartment came of seed {seed} in {_ATTEMPTS} attempts; take another", key="source.scene"
    )


def _attempt(seed: int, programme: Sequence[str], rng: np.random.Generator) -> Scene | None:
    rooms = _rooms(programme, rng)
    doors = _doors(rng, rooms)
    if doors is None:
        return None
    plan = Scene(name=f"generated_{seed}", rooms=rooms, doors=doors)
    layout = build_layout(plan)
    furnisher = Furnisher(
        rng, [(room, hole.center) for hole in layout.openings for room in hole.door.between]
    )
    for room in rooms:
        furnisher.furnish(room)
    occupancy = Occupancy(plan, [*layout.solids, *furnisher.solids])
    stops = _stops(plan, furnisher.slots, occupancy)
    if stops is None:
        return None
    slots = [slot for slot in furnisher.slots if _in_reach(plan, slot, stops)]
    if len(slots) < _FREE_SLOTS + 5:
        return None
    things, changes = _script(rng, plan, furnisher, slots, stops)
    goals = _goals(plan, furnisher, slots, stops)
    tour = [
        TourStop(name=stop.name, at=stop.at, via=stop.via, views=_views(stop.at, goals[stop.name]))
        for stop in stops
    ]
    cut = _within_budget(plan, tour)
    if cut is None:
        return None
    furniture = (*furnisher.pieces, *things)
    return Scene(
        name=plan.name,
        rooms=rooms,
        doors=doors,
        furniture=furniture,
        tour=cut,
        changes=changes,
        queries=_queries(furniture),
    )


# The plan: areas by room type, cut out of a rectangle, joined by doors.


def _rooms(programme: Sequence[str], rng: np.random.Generator) -> tuple[Room, ...]:
    plans = []
    for _ in range(_PLANS):
        kinds = [programme[int(i)] for i in rng.permutation(len(programme))]
        wanted = [(kind, _AREAS[kind] * float(rng.uniform(0.85, 1.15))) for kind in kinds]
        aspect = float(rng.uniform(1.0, 1.6))
        depth = math.sqrt(sum(area for _, area in wanted) / aspect)
        plans.append(_cut((0.0, depth * aspect, 0.0, depth), wanted, rng))
    rects = min(plans, key=_worst_aspect)
    count: dict[str, int] = {}
    rooms = []
    for kind, (x0, x1, y0, y1) in rects:
        count[kind] = count.get(kind, 0) + 1
        name = f"{kind.split()[0]}_{count[kind]}"
        x, y = (round(x0, 2), round(x1, 2)), (round(y0, 2), round(y1, 2))
        rooms.append(Room(name=name, type=kind, x=x, y=y))
    return tuple(rooms)


def _worst_aspect(rects: Sequence[tuple[str, Rect]]) -> float:
    """How far the most stretched room is from a square."""
    sides = [(x1 - x0, y1 - y0) for _, (x0, x1, y0, y1) in rects]
    return max(max(pair) / min(pair) for pair in sides)


def _cut(rect: Rect, wanted: list[tuple[str, float]], rng: np.random.Generator) -> list[tuple[str, Rect]]:
    """The rectangle cut, across its longer side, into one part for each wanted (type, area)."""
    if len(wanted) == 1:
        return [(wanted[0][0], rect)]
    x0, x1, y0, y1 = rect
    half = len(wanted) // 2 + int(rng.integers(0, 1 + len(wanted) % 2))
    first, second = wanted[:half], wanted[half:]
    share = sum(area for _, area in first) / sum(area for _, area in wanted)
    if x1 - x0 >= y1 - y0:
        at = x0 + (x1 - x0) * share
        parts: tuple[Rect, Rect] = (x0, at - _WALL_M / 2, y0, y1), (at + _WALL_M / 2, x1, y0, y1)
    else:
        at = y0 + (y1 - y0) * share
        parts = (x0, x1, y0, at - _WALL_M / 2), (x0, x1, at + _WALL_M / 2, y1)
    return _cut(parts[0], first, rng) + _cut(parts[1], second, rng)


def _doors(rng: np.random.Generator, rooms: Sequence[Room]) -> tuple[Door, ...] | None:
    """Doors that join all rooms, and now and then one more that closes a loop; None where that fails.

    A bathroom gets one door: nobody walks through it.
    """
    if any(min(r.x[1] - r.x[0], r.y[1] - r.y[0]) < (1.9 if r.type == "bathroom" else 2.3) for r in rooms):
        return None
    edges = [(a, b, shared) for i, a in enumerate(rooms) for b in rooms[:i] if (shared := _shared(a, b))]
    order = rng.permutation(len(edges))
    edges = sorted(
        (edges[int(i)] for i in order), key=lambda e: "bathroom" in (e[0].type, e[1].type)
    )  # bathrooms last
    joined = {room.name: room.name for room in rooms}

    def root(name: str) -> str:
        while joined[name] != name:
            name = joined[name]
        return name

    doors: list[Door] = []
    extra = 1 if rng.random() < 0.6 else 0
    for a, b, (low, high) in edges:
        apart = root(a.name) != root(b.name)
        bath = "bathroom" in (a.type, b.type)
        if not apart and (bath or extra == 0):
            continue
        extra -= not apart
        joined[root(a.name)] = root(b.name)
        along = round(float(rng.uniform(low + _DOOR_M / 2 + 0.1, high - _DOOR_M / 2 - 0.1)), 2)
        doors.append(
            Door(name=f"door_{len(doors) + 1}", between=(a.name, b.name), along=along, width=_DOOR_M)
        )
    return tuple(doors) if len({root(room.name) for room in rooms}) == 1 else None


def _shared(a: Room, b: Room) -> tuple[float, float] | None:
    """Where two rooms face each other across a wall, if a door fits there."""
    for across, along in (((a.x, b.x), (a.y, b.y)), ((a.y, b.y), (a.x, b.x))):
        gap = max(across[0][0] - across[1][1], across[1][0] - across[0][1])
        low, high = max(along[0][0], along[1][0]), min(along[0][1], along[1][1])
        if 0 < gap < 2 * _WALL_M and high - low >= _DOOR_M + 0.3:
            return low, high
    return None


# The tour: rooms in the order of a walk that ends in the deepest one, paths by A*.


def _stops(plan: Scene, slots: Sequence[Slot], occupancy: Occupancy) -> list[_Place] | None:
    places: list[_Place] = []
    for room in _walk(plan):
        center = occupancy.nearest_free(room.center, PLAN_RADIUS_M)
        if center is None or not room.contains(*center):
            return None
        spots = [center]
        far = [
            slot for slot in slots if slot.room == room.name and math.dist(center, slot.world) > SLOT_REACH_M
        ]
        if far:
            near = occupancy.nearest_free(far[0].world, PLAN_RADIUS_M)
            if near is not None and room.contains(*near) and math.dist(near, far[0].world) <= SLOT_REACH_M:
                spots.append(near)
        for spot in spots:
            via: tuple[tuple[float, float], ...] = ()
            if places:
                path = occupancy.path(places[-1].at, spot, PLAN_RADIUS_M)
                if path is None:
                    if spot is center:
                        return None
                    continue
                via = tuple((round(x, 3), round(y, 3)) for x, y in path[1:-1])
            index = 1 + sum(place.room == room.name for place in places)
            at = (round(spot[0], 3), round(spot[1], 3))
            places.append(_Place(f"{room.name}_{index}", at, via, room.name))
    return places


def _walk(plan: Scene) -> list[Room]:
    """Rooms in depth-first order from one end of the longest way; the deepest branch comes last."""
    links: dict[str, list[str]] = {room.name: [] for room in plan.rooms}
    for door in plan.doors:
        links[door.between[0]].append(door.between[1])
        links[door.between[1]].append(door.between[0])

    def furthest(start: str) -> list[str]:
        seen, ring = [start], [start]
        while ring:
            ring = [other for name in ring for other in links[name] if other not in seen]
            ring = list(dict.fromkeys(ring))
            seen += ring
        return seen

    def visit(name: str, seen: set[str]) -> list[str]:
        seen.add(name)
        branches: list[list[str]] = []
        for other in links[name]:
            if other not in seen:
                branches.append(visit(other, seen))
        return [name, *(part for branch in sorted(branches, key=len) for part in branch)]

    start = furthest(furthest(plan.rooms[0].name)[-1])[-1]
    return [plan.room(name) for name in visit(start, set())]


def _in_reach(plan: Scene, slot: Slot, stops: Sequence[_Place]) -> bool:
    return any(stop.room == slot.room and math.dist(stop.at, slot.world) <= SLOT_REACH_M for stop in stops)


def _goals(
    plan: Scene, furnisher: Furnisher, slots: Sequence[Slot], stops: Sequence[_Place]
) -> dict[str, list[tuple[float, float, float]]]:
    """Points (x, y, z) to look at, by stop: every piece and slot goes to the nearest stop of its room."""
    points = [(*solid.center[:2], solid.center[2]) for solid in furnisher.solids]
    points += [(*slot.world, 0.8) for slot in slots]
    goals: dict[str, list[tuple[float, float, float]]] = {stop.name: [] for stop in stops}
    for point in points:
        room = plan.room_at(point[0], point[1])
        near = [stop for stop in stops if stop.room == room]
        if near:
            goals[min(near, key=lambda stop: math.dist(stop.at, point[:2])).name].append(point)
    return goals


def _views(
    at: tuple[float, float], goals: Sequence[tuple[float, float, float]]
) -> tuple[tuple[float, float], ...]:
    """(heading, tilt) in degrees that bring the goals well into the image, the most useful view first."""
    seen: set[int] = set()
    views: list[tuple[float, float]] = []
    while len(views) < _VIEWS_A_STOP:
        options = [
            (heading, tilt)
            for heading in range(-180, 180, 20)
            for tilt in (0.0, -25.0)
            if not any(v[1] == tilt and abs((v[0] - heading + 180) % 360 - 180) < 35 for v in views)
        ]
        shown = {view: _shown(at, goals, view) - seen for view in options}
        best = max(options, key=lambda view: len(shown[view]))
        if views and not shown[best]:
            break
        views.append((float(best[0]), best[1]))
        seen |= shown[best]
    return tuple(views)


def _shown(
    at: tuple[float, float], goals: Sequence[tuple[float, float, float]], view: tuple[float, float]
) -> set[int]:
    """Which goals a view has at least 6 degrees inside its frame; walls apart, a room hides little."""
    found = set()
    for index, (x, y, z) in enumerate(goals):
        bearing = math.degrees(math.atan2(y - at[1], x - at[0]))
        rise = math.degrees(math.atan2(z - 0.88, max(0.2, math.hypot(x - at[0], y - at[1]))))
        if abs((bearing - view[0] + 180) % 360 - 180) < 28 and abs(rise - view[1]) < 21:
            found.add(index)
    return found


def _within_budget(plan: Scene, tour: list[TourStop]) -> tuple[TourStop, ...] | None:
    """The tour with as many of its views as both directions leave frames for, headings in turning order."""
    while True:
        trial = plan.model_copy(update={"tour": tuple(tour)})
        if max(estimate(tour_of(trial, visit)).frames for visit in (0, 1)) <= MAX_FRAMES:
            return tuple(s.model_copy(update={"views": tuple(sorted(s.views))}) for s in tour)
        longest = max(range(len(tour)), key=lambda i: len(tour[i].views))
        if len(tour[longest].views) == 1:
            return None
        tour[longest] = tour[longest].model_copy(update={"views": tour[longest].views[:-1]})


# Small things, and what happens to them.


def _script(
    rng: np.random.Generator, plan: Scene, furnisher: Furnisher, slots: list[Slot], stops: Sequence[_Place]
) -> tuple[tuple[Piece, ...], tuple[Change, ...]]:
    """Things for the slots, and changes of every kind between visits 0 and 1 and during visit 1."""
    slots = [slots[int(i)] for i in rng.permutation(len(slots))]
    kinds = [SMALL[int(i)] for i in rng.permutation(len(SMALL))]
    free, filled = slots[:_FREE_SLOTS], slots[_FREE_SLOTS:]
    made = [furnisher.small(slot, *kinds[i % len(kinds)]) for i, slot in enumerate(filled)]
    new = [furnisher.small(slot, *kinds[(len(made) + i) % len(kinds)]) for i, slot in enumerate(free[:2])]

    def elsewhere(slot: Slot) -> str:
        """A stop in another room, so that the robot does not watch it happen."""
        return next((stop.name for stop in stops[1:-1] if stop.room != slot.room), stops[0].name)

    changes: tuple[Change, ...] = (
        Disappear(kind="disappear", object=made[0].id, before_visit=1),
        Relocate(kind="relocate", object=made[1].id, before_visit=1, to=_onto(free[2])),
        Relocate(kind="relocate", object=made[2].id, before_visit=1, to=_onto(free[3])),
        Appear(kind="appear", piece=new[0], before_visit=1),
        Disappear(kind="disappear", object=made[3].id, during_visit=1, at_stop=elsewhere(filled[3])),
        Appear(kind="appear", piece=new[1], during_visit=1, at_stop=elsewhere(free[1])),
    )
    return tuple(made), changes


def _onto(slot: Slot) -> Placement:
    return Placement(on=slot.support, at=slot.offset)


def _queries(furniture: Sequence[Piece]) -> tuple[Query, ...]:
    queries = []
    for text, categories in (
        ("a place suitable for washing up", ("sink", "washbasin")),
        ("somewhere to lie down and sleep", ("bed",)),
        ("a place to sit together", ("sofa", "table")),
    ):
        targets = tuple(piece.id for piece in furniture if piece.category in categories)
        if targets:
            queries.append(Query(text=text, targets=targets, kind="implicit"))
    return tuple(queries)
