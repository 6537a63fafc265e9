"""Change scripts from a seed: what a home's owners may do between two visits of the robot.

Every change is made so that it can be told from what the tours see: the place that a thing leaves and the one
that it comes to are in view, at the size that counts, both before and after. Nothing stands in the way of
the tour or in the air, and no label changes twice, so that which thing went where is not a riddle. The
same scene, furniture, seed and counts give the same script.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.errors import InputError
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.scenario_pieces import (
    anywhere,
    appear_change,
    is_screen,
    new_pieces,
    plain_scene,
    relocate_change,
    screens,
    scripted,
    with_twins,
)
from dssmsg.sim.scenario_spots import Spots
from dssmsg.sim.scenario_views import NEED, Shot, TourViews
from dssmsg.sim.scene import (
    Change,
    Disappear,
    DoorChange,
    LightChange,
    Placement,
    Scene,
)
from dssmsg.sim.scene_layout import build_layout
from dssmsg.sim.scene_placement import Placed, Placer
from dssmsg.sim.script import closed_doors
from dssmsg.sim.tour import check_tour, tour_of

KINDS = ("swap", "put_back", "occluder", "disappear", "near", "far", "appear", "door", "light")
"""Every kind of change, in the order in which they are drawn: those that find fewest places come first."""
USUAL: Mapping[str, int] = {"appear": 2, "disappear": 2, "near": 2, "far": 2}
NEAR_M = (0.45, 1.5)
FAR_M = 2.0
HIDDEN_SHARE = 0.1
"""A thing is hidden where no view shows more than this share of the pixels that count."""
_ROUNDS = 12
_LIGHTS = (0.5, 0.6, 0.75, 1.2, 1.35)


@dataclass(frozen=True, slots=True)
class Scenario:
    """A scene with its generated changes, and how many of each kind were asked for and made."""

    scene: Scene
    asked: Mapping[str, int]
    made: Mapping[str, int]

    def note(self) -> str:
        """What was made, in one line: `2 appear, 1 of 2 near`."""
        parts = []
        for kind, count in self.asked.items():
            made = self.made.get(kind, 0)
            parts.append(f"{made} {kind}" if made == count else f"{made} of {count} {kind}")
        return ", ".join(parts) or "no changes"


@dataclass(frozen=True, slots=True, eq=False)
class _Draft:
    """A change that is thought of: what stands where afterwards (`new`, with `places` as they are written),
    and what must be hidden by it."""

    kind: str
    changes: tuple[Change, ...]
    old: tuple[Placed, ...] = ()
    new: tuple[Placed, ...] = ()
    places: tuple[Placement, ...] = ()
    hides: Placed | None = None

    @property
    def names(self) -> frozenset[str]:
        """Names of all pieces that it is about."""
        hidden = () if self.hides is None else (self.hides,)
        return frozenset(piece.name for piece in (*self.old, *self.new, *hidden))


def generate_scenario(
    scene: Scene,
    library: FurnitureLibrary,
    views: TourViews,
    *,
    seed: int,
    counts: Mapping[str, int] = USUAL,
    visits: int = 2,
) -> Scenario:
    """`scene` with changes before each of the visits 1 .. `visits` - 1, its own script dropped.

    `counts` says how many of each of `KINDS` each of these visits brings; what is put back in the visit
    after needs three visits. Where a home has no room for a change it is left out; `made` tells.
    Raises InputError for an unknown kind.
    """
    for kind in counts:
        if kind not in KINDS:
            raise InputError(
                f"unknown kind of change {kind!r}; known: {', '.join(KINDS)}", key="change_counts"
            )
    writer = _Writer(scene, library, views, seed, counts, visits)
    for visit in range(1, visits):
        writer.write(visit)
    return writer.scenario()


class _Writer:
    def __init__(
        self,
        scene: Scene,
        library: FurnitureLibrary,
        views: TourViews,
        seed: int,
        counts: Mapping[str, int],
        visits: int,
    ) -> None:
        self._rng = np.random.default_rng([seed, 0x5CE2])
        self._views = views
        self._visits = visits
        self._counts = {kind: counts[kind] for kind in KINDS if counts.get(kind, 0) > 0}
        self._scene = plain_scene(scene)
        self._pairs: list[tuple[str, str]] = []
        if "swap" in self._counts:
            self._scene, self._pairs = with_twins(
                self._scene, library, self._rng, self._counts["swap"] * (visits - 1)
            )
        self._pool = [*new_pieces(self._scene, self._rng), *screens(self._scene, visits * 8)]
        # Every thing that may ever come is known to the placer, which numbers the instances.
        self._placer = Placer(
            scripted(self._scene, [appear_change(piece, anywhere(scene), 1) for piece in self._pool]), library
        )
        self._pieces = self._placer.initial()
        self._places = {
            p.id: Placement(**p.model_dump(include=set(Placement.model_fields))) for p in scene.furniture
        }
        self._used: set[str] = set()
        self._labels: set[str] = set()
        self._changes: list[Change] = []
        self._made: dict[str, int] = {}
        self._back: list[tuple[str, Placement]] = []

    def scenario(self) -> Scenario:
        asked = {
            kind: count * (max(0, self._visits - 2) if kind == "put_back" else self._visits - 1)
            for kind, count in self._counts.items()
        }
        return Scenario(scripted(self._scene, self._changes), asked, dict(self._made))

    def write(self, visit: int) -> None:
        """Draw the changes before one visit."""
        before = self._shots(visit - 1)
        for name, place in self._back:
            self._changes.append(relocate_change(name, place, visit, "put_back"))
            self._pieces[name] = self._placer.place(self._pieces[name].piece, place, self._pieces)
            self._places[name] = place
        self._back.clear()
        for kind in ("door", "light"):
            for _ in range(self._counts.get(kind, 0)):
                self._change_home(kind, visit)
        drafts: list[_Draft] = []
        failed: set[tuple[str, str]] = set()
        for _ in range(_ROUNDS):
            self._fill(drafts, visit, before, failed)
            after = self._shots(visit, _pieces_after(self._pieces, drafts))
            good = [draft for draft in drafts if self._can_be_told(draft, before, after)]
            done = len(good) == len(drafts)
            failed |= {(d.kind, d.old[0].name) for d in drafts if d not in good and d.old}
            drafts = good
            if done:
                break
        for draft in drafts:
            self._commit(draft)

    # What the tours see

    def _shots(self, visit: int, pieces: Mapping[str, Placed] | None = None) -> list[Shot]:
        scene = scripted(self._scene, self._changes)
        layout = build_layout(scene, closed_doors(scene, visit))
        return self._views.take(tour_of(scene, visit), layout, (pieces or self._pieces).values())

    def _can_be_told(self, draft: _Draft, before: Sequence[Shot], after: Sequence[Shot]) -> bool:
        views = self._views
        if not all(views.shown(before, piece) for piece in draft.old):
            return False
        if not all(views.shown(after, piece) for piece in draft.new):
            return False
        if draft.hides is not None:
            most = max((shot.glimpsed.get(draft.hides.instance_id, 0) for shot in after), default=0)
            if most > HIDDEN_SHARE * NEED:
                return False
        if draft.kind == "swap":  # both places are taken, before and after
            return True
        return all(views.place_shown(after, piece) for piece in draft.old) and all(
            views.place_shown(before, piece) for piece in draft.new
        )

    # Drawing

    def _fill(
        self, drafts: list[_Draft], visit: int, before: Sequence[Shot], failed: set[tuple[str, str]]
    ) -> None:
        """Draw what is still missing of each kind."""
        scene = scripted(self._scene, self._changes)
        layout = build_layout(scene, closed_doors(scene, visit))
        spots = Spots(
            scene, self._placer, layout, [tour_of(scene, later) for later in range(visit, self._visits)]
        )
        for kind, count in self._counts.items():
            if kind in ("door", "light") or (kind == "put_back" and visit + 1 >= self._visits):
                continue
            for _ in range(count - sum(draft.kind == kind for draft in drafts)):
                draft = self._draw(kind, visit, spots, drafts, before, failed)
                if draft is not None:
                    drafts.append(draft)

    def _draw(
        self,
        kind: str,
        visit: int,
        spots: Spots,
        drafts: Sequence[_Draft],
        before: Sequence[Shot],
        failed: set[tuple[str, str]],
    ) -> _Draft | None:
        pieces = _pieces_after(self._pieces, drafts)
        # Nothing is put where something has just left: that would be one thing changed into another.
        pieces |= {f"{old.name} (left)": old for draft in drafts for old in draft.old}
        names = self._used.union(*(draft.names for draft in drafts))
        labels = self._labels | {p.model.label for d in drafts for p in (*d.old, *d.new)}
        if kind == "swap":
            return self._draw_swap(visit, names, failed)
        if kind == "occluder":
            return self._draw_occluder(visit, spots, pieces, names, before, failed)
        if kind == "appear":
            for piece in self._pool:
                if piece.id in names or self._placer.model(piece).label in labels or is_screen(piece):
                    continue
                found = spots.draw(self._rng, piece, pieces)
                if found is not None:
                    new, at = found
                    return _Draft(kind, (appear_change(piece, at, visit, kind),), new=(new,), places=(at,))
            return None
        for old in self._movable(pieces, names, labels, before):
            if (kind, old.name) in failed:
                continue
            if kind == "disappear":
                change = Disappear(kind="disappear", object=old.name, before_visit=visit, tag=kind)
                return _Draft(kind, (change,), old=(old,))
            near = kind == "near" or (kind == "put_back" and bool(self._rng.random() < 0.5))
            others = {name: piece for name, piece in pieces.items() if name != old.name}
            found = spots.draw(
                self._rng,
                old.piece,
                others,
                rooms=[old.room] if near else None,
                accept=functools.partial(_is_move, old, near=near),
            )
            if found is not None:
                new, at = found
                return _Draft(kind, (relocate_change(old.name, at, visit, kind),), (old,), (new,), (at,))
        return None

    def _movable(
        self, pieces: Mapping[str, Placed], names: set[str], labels: set[str], before: Sequence[Shot]
    ) -> list[Placed]:
        """What may be changed next, in random order: in view, carrying nothing, of a fresh label."""
        loaded = {piece.support for piece in pieces.values()}
        fit = [
            piece
            for piece in pieces.values()
            if piece.movable
            and piece.name not in names
            and piece.name not in loaded
            and piece.model.label not in labels
            and self._views.shown(before, piece)
        ]
        return [fit[int(i)] for i in self._rng.permutation(len(fit))]

    def _draw_swap(self, visit: int, names: set[str], failed: set[tuple[str, str]]) -> _Draft | None:
        for first, second in self._pairs:
            if first in names or second in names or ("swap", first) in failed:
                continue
            old = (self._pieces[first], self._pieces[second])
            places = (self._places[second], self._places[first])
            others = {name: p for name, p in self._pieces.items() if name not in (first, second)}
            new = tuple(self._placer.place(p.piece, at, others) for p, at in zip(old, places, strict=True))
            changes = tuple(
                relocate_change(p.name, at, visit, "swap") for p, at in zip(old, places, strict=True)
            )
            return _Draft("swap", changes, old, new, places)
        return None

    def _draw_occluder(
        self,
        visit: int,
        spots: Spots,
        pieces: Mapping[str, Placed],
        names: set[str],
        before: Sequence[Shot],
        failed: set[tuple[str, str]],
    ) -> _Draft | None:
        """A screen between a stop and a thing that no other stop shows."""
        screen = next((p for p in self._pool if is_screen(p) and p.id not in names), None)
        if screen is None:
            return None
        fit = [p for p in pieces.values() if p.name not in names and p.name in self._pieces]
        for index in self._rng.permutation(len(fit)):
            target = fit[int(index)]
            if ("occluder", target.name) in failed or max(target.model.size) > 0.9:
                continue
            most = HIDDEN_SHARE * NEED
            seers = {shot.stop for shot in before if shot.glimpsed.get(target.instance_id, 0) > most}
            if len(seers) != 1 or not self._views.shown(before, target):
                continue
            stop = next((stop for stop in spots.tours[0] if stop.name in seers), None)
            if stop is None:  # behind a door by now
                continue
            x, y = target.solid.center[:2]
            bearing = math.degrees(math.atan2(y - stop.y, x - stop.x))
            for share in self._rng.permutation([0.4, 0.5, 0.6, 0.7, 0.8]):
                at = (round(stop.x + share * (x - stop.x), 3), round(stop.y + share * (y - stop.y), 3))
                where = Placement(at=at, z=0.0, yaw_deg=round(math.remainder(bearing - 90.0, 360.0), 1))
                new = spots.standing(screen, where, pieces)
                if new is not None:
                    failed.add(("occluder", target.name))  # each thing is tried once
                    change = appear_change(screen, where, visit, "occluder")
                    return _Draft("occluder", (change,), new=(new,), places=(where,), hides=target)
        return None

    def _change_home(self, kind: str, visit: int) -> None:
        if kind == "light":
            level = float(self._rng.choice(_LIGHTS))
            self._keep(kind, [LightChange(kind="light", level=level, before_visit=visit, tag=kind)])
            return
        scene = scripted(self._scene, self._changes)
        open_now = [door for door in scene.doors if door.name not in closed_doors(scene, visit)]
        for index in self._rng.permutation(len(open_now)):
            change = DoorChange(kind="door", door=open_now[int(index)].name, before_visit=visit, tag=kind)
            trial = scripted(self._scene, [*self._changes, change])
            stops, left = len(tour_of(scene, visit)), len(tour_of(trial, visit))
            if not stops / 2 <= left < stops:
                continue
            try:
                check_tour(trial, build_layout(trial), Placer(trial, self._placer.library), self._visits)
            except InputError:  # the robot would have to go round, which a tour does not
                continue
            self._keep(kind, [change])
            return

    def _commit(self, draft: _Draft) -> None:
        if draft.kind == "put_back":
            self._back.append((draft.old[0].name, self._places[draft.old[0].name]))
        self._pieces = _pieces_after(self._pieces, [draft])
        self._places |= {piece.name: at for piece, at in zip(draft.new, draft.places, strict=True)}
        self._used |= draft.names
        self._labels |= {
            piece.model.label for piece in (*draft.old, *draft.new) if not is_screen(piece.piece)
        }
        self._keep(draft.kind, draft.changes)

    def _keep(self, kind: str, changes: Sequence[Change]) -> None:
        self._changes += changes
        self._made[kind] = self._made.get(kind, 0) + 1


def _pieces_after(pieces: Mapping[str, Placed], drafts: Sequence[_Draft]) -> dict[str, Placed]:
    after = dict(pieces)
    for draft in drafts:
        for piece in draft.old:
            after.pop(piece.name, None)
        for piece in draft.new:
            after[piece.name] = piece
    return after


def _is_move(old: Placed, new: Placed, *, near: bool) -> bool:
    """Near: out of its own place but in the room; far: beyond reach, or in another room."""
    distance = math.dist(old.solid.center, new.solid.center)
    if near:
        size = float(np.linalg.norm(old.solid.half))
        return max(NEAR_M[0], size) <= distance <= max(NEAR_M[1], 2 * size) and old.room == new.room
    return distance >= FAR_M or (old.room != new.room and distance >= NEAR_M[1])
