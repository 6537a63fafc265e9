"""Static and dynamic objects of a map against the truth that could be known (paper, Tables I to III).

The scorer knows nothing of any method: it is given claims (what a map says of an object) and things (what
was true). It matches them one-to-one by assignment, so that a second claim for the same thing is wrong. A
thing that nobody could have known of is `counted=False`: claims that fit it are neither right nor wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from dssmsg.evaluate.static import MAX_CENTRE_M, MIN_IOU
from dssmsg.evaluate.visible import Place
from dssmsg.frame import FloatArray, MaskArray
from dssmsg.geometry import box_iou
from dssmsg.graph.nodes import APPEARED, DISAPPEARED, MOVED, STATIC

DYNAMIC = (APPEARED, DISAPPEARED, MOVED)
_NO_MATCH = 100.0
Box = tuple[FloatArray, FloatArray]
"""Lower and upper corner (3,), world metres."""


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """What a map says of one object. `box` is its place now, its last one if it `disappeared`.

    `former` is where a `moved` object was at the end of the survey, None if the map does not say.
    """

    id: str
    label: str
    state: str
    box: Box
    former: Box | None = None

    @property
    def present(self) -> bool:
        """Whether the object is said to be there."""
        return self.state != DISAPPEARED


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """One true object, relative to the end of the survey.

    `place` is where it is, the last one if it `disappeared`; `former` where it was if it `moved`.
    `former_seen`: the place that it left was looked at again, so that a map may know that it is empty.
    `retained`: it never changed, and was visible in the survey and again after it.
    """

    name: str
    label: str
    state: str
    place: Place
    former: Place | None = None
    counted: bool = True
    former_seen: bool = True
    retained: bool = False
    tag: str = ""


@dataclass(frozen=True, slots=True)
class Tally:
    """Counts of one comparison; `missed` and `wrong` name the false negatives and positives."""

    right: int
    missed: tuple[str, ...]
    wrong: tuple[str, ...]
    ignored: int = 0

    @property
    def precision(self) -> float:
        """Share of the counted claims that are right; of no claim: 1 if there was nothing to find, else 0."""
        counted = self.right + len(self.wrong)
        return self.right / counted if counted else float(not self.missed)

    @property
    def recall(self) -> float:
        """Share of the things that were found; 1 if there were none."""
        things = self.right + len(self.missed)
        return self.right / things if things else 1.0

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; 1 if there was nothing to find and nothing was claimed."""
        counted = 2 * self.right + len(self.wrong) + len(self.missed)
        return 2 * self.right / counted if counted else 1.0

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.right + other.right,
            self.missed + other.missed,
            self.wrong + other.wrong,
            self.ignored + other.ignored,
        )


def static_tally(claims: Sequence[Claim], things: Sequence[Thing]) -> Tally:
    """Objects said to be static against the true static ones (Table I, left).

    A static claim at the present place of a counted dynamic thing has the wrong state, which the dynamic
    tally counts: it is ignored here. One at a place that was seen to be empty is wrong.
    """
    wanted = [thing for thing in things if thing.counted and thing.state == STATIC]
    excused = [place for thing in things if not thing.counted for place in _places(thing)]
    for thing in things:
        if thing.counted and thing.state in (APPEARED, MOVED):
            excused.append(thing.place)
        left = left_place(thing)
        if thing.counted and left is not None and not thing.former_seen:
            excused.append(left)
    return _tally([claim for claim in claims if claim.state == STATIC], wanted, excused)


def dynamic_tally(claims: Sequence[Claim], things: Sequence[Thing], states: Sequence[str] = DYNAMIC) -> Tally:
    """Objects with one of `states` against the things with them; only the right state counts.

    (Table I, right; with one state: Table II.) A moved object must come from the right place, too.
    """
    wanted = [thing for thing in things if thing.counted and thing.state in states]
    excused = [place for thing in things if not thing.counted for place in _places(thing)]
    return _tally([claim for claim in claims if claim.state in states], wanted, excused)


def full_tally(claims: Sequence[Claim], things: Sequence[Thing]) -> Tally:
    """All objects over label, place and state: the accuracy of eq. 6-7 is its F1."""
    wanted = [thing for thing in things if thing.counted]
    excused = [place for thing in things if not thing.counted for place in _places(thing)]
    return _tally(claims, wanted, excused)


def split_moves(claims: Sequence[Claim], things: Sequence[Thing]) -> tuple[list[Claim], list[Thing]]:
    """The same with each move as a disappearance and an appearance, so that identity alone cannot win."""
    parts: list[Claim] = []
    for claim in claims:
        if claim.state != MOVED:
            parts.append(claim)
            continue
        parts.append(replace(claim, state=APPEARED, former=None))
        if claim.former is not None:
            parts.append(replace(claim, state=DISAPPEARED, box=claim.former, former=None))
    truth: list[Thing] = []
    for thing in things:
        if thing.state != MOVED or thing.former is None:
            truth.append(thing)
            continue
        truth.append(replace(thing, state=APPEARED, former=None))
        truth.append(
            replace(
                thing,
                name=f"{thing.name} (left)",
                state=DISAPPEARED,
                place=thing.former,
                former=None,
                counted=thing.counted and thing.former_seen,
            )
        )
    return parts, truth


@dataclass(frozen=True, slots=True)
class UpdateScore:
    """Table III as counts: changes that the map took over, and static objects that it kept."""

    changes: int
    updated: int
    static: int
    retained: int
    failed: tuple[str, ...]
    """Names of the changes that were not taken over, and of the static objects that were lost."""


def update_score(before: Sequence[Claim], after: Sequence[Claim], things: Sequence[Thing]) -> UpdateScore:
    """How the map at the end of the survey became the map `after` it.

    A change is taken over where the map, whatever it calls it, has the object at its new place and nothing of
    that label at the old one (unless another thing of that label is there now). A static object is kept where
    the map had it at its place, and still has it.
    """
    there = [claim for claim in after if claim.present]
    changed = [thing for thing in things if thing.counted and thing.state != STATIC]
    failed = []
    for thing in changed:
        arrived = thing.state == DISAPPEARED or bool(fits(there, thing.place).any())
        left = left_place(thing) if thing.former_seen else None
        others = [other for other in things if other is not thing and other.state != DISAPPEARED]
        ghost = left is not None and bool(fits(there, left).any()) and not _is_taken(left, others)
        if ghost or not arrived:
            failed.append(thing.name)
    updated = len(changed) - len(failed)
    known = [thing for thing in things if thing.retained and fits(before, thing.place).any()]
    lost = [thing.name for thing in known if not fits(there, thing.place).any()]
    return UpdateScore(len(changed), updated, len(known), len(known) - len(lost), (*failed, *lost))


def fits(claims: Sequence[Claim], place: Place) -> MaskArray:
    """(N,) bool: which claims have the place's label, and their box there.

    3D IoU >= 0.25 with the visible surface or with the whole true box, or the centres within min(0.3 m, half
    the diagonal of the true box).
    """
    if not claims:
        return np.zeros(0, dtype=np.bool_)
    low, high = (np.stack([claim.box[i] for claim in claims]) for i in (0, 1))
    near: MaskArray = np.linalg.norm((low + high) / 2 - place.center, axis=1) <= min(
        MAX_CENTRE_M, float(np.linalg.norm(place.box_max - place.box_min)) / 2
    )
    near = near | (box_iou(low, high, place.box_min, place.box_max) >= MIN_IOU)
    if place.surface_min is not None and place.surface_max is not None:
        near = near | (box_iou(low, high, place.surface_min, place.surface_max) >= MIN_IOU)
    same: MaskArray = np.array([claim.label == place.label for claim in claims])
    return near & same


def _tally(claims: Sequence[Claim], wanted: Sequence[Thing], excused: Sequence[Place]) -> Tally:
    """One-to-one by assignment: as many pairs as possible, then the nearest."""
    cost = np.full((len(claims), len(wanted)), _NO_MATCH)
    for j, thing in enumerate(wanted):
        ok = fits(claims, thing.place)
        ok &= np.array([claim.state == thing.state for claim in claims], dtype=np.bool_)
        if thing.state == MOVED and thing.former is not None:
            ok = ok & _came_from(claims, thing.former)
        for i in np.flatnonzero(ok):
            low, high = claims[int(i)].box
            cost[i, j] = min(float(np.linalg.norm((low + high) / 2 - thing.place.center)), 1.0)
    rows, columns = linear_sum_assignment(cost)
    pairs = [(i, j) for i, j in zip(rows, columns, strict=True) if cost[i, j] < _NO_MATCH]
    taken, found = {i for i, _ in pairs}, {j for _, j in pairs}
    rest = [claim for i, claim in enumerate(claims) if i not in taken]
    let_off = np.zeros(len(rest), dtype=np.bool_)
    for place in excused:
        let_off |= fits(rest, place)
    wrong = [claim for claim, off in zip(rest, let_off, strict=True) if not off]
    return Tally(
        right=len(pairs),
        missed=tuple(thing.name for j, thing in enumerate(wanted) if j not in found),
        wrong=tuple(f"{claim.id} ({claim.label}, {claim.state})" for claim in wrong),
        ignored=len(rest) - len(wrong),
    )


def _came_from(claims: Sequence[Claim], former: Place) -> MaskArray:
    """Which claims say that the object was at `former` at the end of the survey."""
    return np.array(
        [
            claim.former is not None and bool(fits([replace(claim, box=claim.former)], former)[0])
            for claim in claims
        ],
        dtype=np.bool_,
    )


def _places(thing: Thing) -> list[Place]:
    return [thing.place] if thing.former is None else [thing.place, thing.former]


def left_place(thing: Thing) -> Place | None:
    """The place that a thing is no longer at."""
    return thing.place if thing.state == DISAPPEARED else thing.former


def _is_taken(place: Place, others: Sequence[Thing]) -> bool:
    """Whether another thing of that label is there now."""
    stand_ins = [
        Claim(other.name, other.label, other.state, (other.place.box_min, other.place.box_max))
        for other in others
    ]
    return bool(fits(stand_ins, place).any())
