"""What happens in a scene by itself: pieces that come, go and are relocated, doors, light, at their time."""

from __future__ import annotations

import math
from collections.abc import Mapping

from dssmsg.errors import InputError
from dssmsg.sim.scene import Appear, Change, Disappear, DoorChange, LightChange, Relocate, Scene
from dssmsg.sim.scene_placement import Placed, Placer

ARRIVAL_M = 0.3
"""A robot this near to a stop has arrived there."""


class Script:
    """The scene's changes that are still to come. Each is handed out once, in the file's order."""

    def __init__(self, scene: Scene, *, enabled: bool = True) -> None:
        self._waiting: list[Change] = list(scene.changes) if enabled else []
        self._stops = {stop.name: stop.at for stop in scene.tour}

    def touches(self) -> frozenset[str]:
        """Names of all pieces that a change still to come appears, takes away or relocates."""
        return frozenset(
            c.piece.id if isinstance(c, Appear) else c.object
            for c in self._waiting
            if isinstance(c, Appear | Disappear | Relocate)
        )

    def before(self, visit: int) -> list[Change]:
        """The changes to make before `visit` begins, those of skipped visits included."""
        return self._take(
            [
                c
                for c in self._waiting
                if (c.before_visit is not None and c.before_visit <= visit)
                or (c.during_visit is not None and c.during_visit < visit)
            ]
        )

    def during(self, visit: int, elapsed: float, position: tuple[float, float]) -> list[Change]:
        """The changes due `elapsed` seconds into `visit` with the robot at `position` (x, y)."""
        due = []
        for change in self._waiting:
            if change.during_visit != visit:
                continue
            late = change.at_time is not None and elapsed >= change.at_time
            stop = self._stops[change.at_stop] if change.at_stop is not None else None
            there = stop is not None and math.dist(stop, position) <= ARRIVAL_M
            if late or there:
                due.append(change)
        return self._take(due)

    def _take(self, due: list[Change]) -> list[Change]:
        self._waiting = [change for change in self._waiting if all(change is not other for other in due)]
        return due


def changed(placed: Mapping[str, Placed], change: Change, placer: Placer) -> dict[str, Placed]:
    """The pieces after one change; the input is left alone. Doors and light leave them as they are.

    Raises InputError when the piece is (not) there as the change needs it, or carries others.
    """
    after = dict(placed)
    if isinstance(change, DoorChange | LightChange):
        return after
    if isinstance(change, Appear):
        if change.piece.id in after:
            raise InputError("is in the scene already", key=f"changes.{change.piece.id}")
        after[change.piece.id] = placer.place(change.piece, change.piece, after)
        return after
    piece = after.get(change.object)
    if piece is None:
        raise InputError("is not in the scene then", key=f"changes.{change.object}")
    load = sorted(other.name for other in after.values() if other.support == change.object)
    if load:
        raise InputError(f"carries {', '.join(load)}; change those first", key=f"changes.{change.object}")
    if isinstance(change, Disappear):
        del after[change.object]
    else:
        after[change.object] = placer.place(piece.piece, change.to, after)
    return after


def visit_states(scene: Scene, placer: Placer, visit: int) -> list[dict[str, Placed]]:
    """All states of the furniture that `visit` may see: as it begins, and after each change during it."""
    script = Script(scene)
    state = placer.initial()
    for earlier in range(visit + 1):
        for change in script.before(earlier):
            state = changed(state, change, placer)
    states = [state]
    for change in scene.changes:
        if change.during_visit == visit:
            states.append(changed(states[-1], change, placer))
    return states


def closed_doors(scene: Scene, visit: int) -> frozenset[str]:
    """Names of the doors that are closed during `visit`."""
    closed: set[str] = set()
    # Sorting keeps the file's order within a visit, in which changes are made.
    for change in sorted(scene.changes, key=lambda one: one.before_visit or 0):
        if isinstance(change, DoorChange) and (change.before_visit or 0) <= visit:
            (closed.add if change.closed else closed.discard)(change.door)
    return frozenset(closed)
