"""An observer that judges episodes by the truth, which the robot does not know (ALGORITHM, Scores)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.evaluate.visible import MAX_RANGE_M, MIN_PIXELS
from dssmsg.events import EpisodeEnded, Event, FrameCaptured, PhaseStarted, TruthSeen
from dssmsg.frame import Frame, Truth, TruthObject

REACHED_M = 1.0
"""So near to a viewpoint that truly shows the target the goal counts as reached."""
_SAME_PLACE_M = 0.1
Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Judged:
    """An episode as the robot ended it and as the truth has it.

    outcome `success`, `failure`, or `void`: no viewpoint of the map ever showed an answer, so there was
    nothing to reach. `reason` names a failure: the robot's own, or `wrong match` where it was content with
    something that is no answer, `collision` where it touched anything. `start` and `goals` are places (x, y):
    of the robot at the beginning, and of the viewpoints that truly show an answer.
    """

    goal: str
    outcome: str
    reason: str
    claimed: bool
    collisions: int
    metres: float
    seconds: float
    replans: int
    detours: int
    viewpoints: int
    start: Point
    end: Point
    goals: tuple[Point, ...]


@dataclass(frozen=True, slots=True)
class _Sight:
    place: Point
    center: tuple[float, float, float]


class EpisodeWitness:
    """Follows a run's frames with their truth; `judged` grows by one an episode.

    `targets`: for each episode the names of the true objects that answer it.
    """

    def __init__(self, targets: Sequence[tuple[str, ...]]) -> None:
        self._targets = list(targets)
        self._sights: dict[str, list[_Sight]] = {}
        self._frame: Frame | None = None
        self._viewpoint: str | None = None
        self._truth: Truth | None = None
        self._collisions = 0
        self._start: Point | None = None
        self._start_collisions = 0
        self.judged: list[Judged] = []

    def on_event(self, event: Event) -> None:
        """Take in what happened."""
        match event:
            case FrameCaptured():
                self._frame, self._viewpoint = event.frame, event.viewpoint_id
                self._collisions = event.collisions
            case TruthSeen():
                self._truth = event.truth
                if self._viewpoint is not None:
                    self._remember(event.truth)
            case PhaseStarted() if event.phase == "seek":
                self._begin()
            case EpisodeEnded():
                self._judge(event)
                self._begin()
            case _:
                pass

    def close(self) -> None:
        """Nothing is held."""

    def outputs(self) -> dict[str, str]:
        """No files."""
        return {}

    def _begin(self) -> None:
        self._start = self._place()
        self._start_collisions = self._collisions

    def _place(self) -> Point:
        if self._frame is None:
            return 0.0, 0.0
        base = self._frame.world_from_base
        return float(base[0, 3]), float(base[1, 3])

    def _pixels(self, truth: Truth) -> dict[str, int]:
        """How many pixels within range the newest frame has of each object that is there."""
        assert self._frame is not None
        depth = self._frame.depth
        near = truth.instance_ids[(depth > 0) & (depth < MAX_RANGE_M)]
        most = max((known.instance_id for known in truth.objects), default=0)
        counts = np.bincount(near.ravel(), minlength=most + 1)
        return {o.name: int(counts[o.instance_id]) for o in truth.objects if o.state != "disappeared"}

    def _remember(self, truth: Truth) -> None:
        pixels, place = self._pixels(truth), self._place()
        for known in truth.objects:
            if pixels.get(known.name, 0) >= MIN_PIXELS:
                self._sights.setdefault(known.name, []).append(_Sight(place, _center(known)))

    def _judge(self, event: EpisodeEnded) -> None:
        if self._truth is None or self._frame is None:
            return
        targets = self._targets[event.episode]
        there = {o.name: o for o in self._truth.objects if o.state != "disappeared" and o.name in targets}
        goals = {
            sight.place
            for name, known in there.items()
            for sight in self._sights.get(name, ())
            if math.dist(sight.center, _center(known)) <= _SAME_PLACE_M
        }
        pixels, end = self._pixels(self._truth), self._place()
        in_view = any(pixels.get(name, 0) >= MIN_PIXELS for name in there)
        near = any(math.dist(end, goal) <= REACHED_M for goal in goals)
        collisions = self._collisions - self._start_collisions
        claimed = event.outcome == "success"
        outcome, reason = "success" if claimed and in_view and near else "failure", ""
        if collisions:
            outcome, reason = "failure", "collision"
        elif not goals:
            outcome = "void"
        elif outcome == "failure":
            reason = "wrong match" if claimed else event.reason
        values = event.values
        self.judged.append(
            Judged(
                goal=event.goal,
                outcome=outcome,
                reason=reason,
                claimed=claimed,
                collisions=collisions,
                metres=float(values.get("metres", 0.0)),
                seconds=float(values.get("seconds", 0.0)),
                replans=int(values.get("replans", 0)),
                detours=int(values.get("detours", 0)),
                viewpoints=int(values.get("viewpoints", 0)),
                start=self._start or end,
                end=end,
                goals=tuple(sorted(goals)),
            )
        )


def _center(known: TruthObject) -> tuple[float, float, float]:
    x, y, z = ((known.box_min + known.box_max) / 2).tolist()
    return x, y, z
