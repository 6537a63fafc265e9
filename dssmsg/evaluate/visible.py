"""What of the truth could be seen: computed from the truth of every frame, never written by hand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from dssmsg.frame import FloatArray, Frame, Truth, TruthObject
from dssmsg.geometry import back_project_world, points_in_box

MIN_PIXELS = 200
MAX_RANGE_M = 4.0
_SURFACE_SLACK_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """One place of a true object (a moved object has two), with what was seen of it.

    `frames`: in how many frames at least `MIN_PIXELS` of it were nearer than `MAX_RANGE_M`.
    box_min, box_max (3,): the true box; surface_min, surface_max (3,): the box of the surface that was
    visible in those frames, None if there were none. World metres.
    """

    name: str
    label: str
    state: str
    frames: int
    box_min: FloatArray
    box_max: FloatArray
    surface_min: FloatArray | None
    surface_max: FloatArray | None
    visits: Mapping[int, int] = field(default_factory=dict)
    """`frames` by the visit in which they were taken."""

    @property
    def center(self) -> FloatArray:
        """Centre (3,) of the visible surface, of the true box where nothing was visible."""
        if self.surface_min is None or self.surface_max is None:
            return np.asarray((self.box_min + self.box_max) / 2)
        return np.asarray((self.surface_min + self.surface_max) / 2)


@dataclass(slots=True)
class _Tally:
    truth: TruthObject
    visits: Counter[int] = field(default_factory=Counter)
    low: FloatArray | None = None
    high: FloatArray | None = None


class VisibleTruth:
    """Collects, frame by frame, which true objects were visible and which surface of them."""

    def __init__(self) -> None:
        self._places: dict[tuple[str, tuple[float, ...]], _Tally] = {}
        self._latest: dict[str, TruthObject] = {}

    def add(self, frame: Frame, truth: Truth) -> None:
        """Take in a frame with its truth; `frame.depth` is what the sensor measured."""
        pixels = np.bincount(truth.instance_ids[(frame.depth > 0) & (frame.depth < MAX_RANGE_M)].ravel())
        for known in truth.objects:
            self._latest[known.name] = known
            if known.state == "disappeared":
                continue
            key = (known.name, tuple(np.round(np.concatenate([known.box_min, known.box_max]), 2)))
            tally = self._places.setdefault(key, _Tally(known))
            tally.truth = known
            if known.instance_id >= len(pixels) or pixels[known.instance_id] < MIN_PIXELS:
                continue
            tally.visits[frame.visit] += 1
            points = back_project_world(
                frame.depth, frame.camera, frame.world_from_camera, truth.instance_ids == known.instance_id
            )
            # Flying pixels at edges and sensor noise are not the object's surface.
            points = points[
                points_in_box(points, known.box_min - _SURFACE_SLACK_M, known.box_max + _SURFACE_SLACK_M)
            ]
            if len(points):
                points = np.clip(points, known.box_min, known.box_max)
                low, high = points.min(axis=0), points.max(axis=0)
                tally.low = low if tally.low is None else np.minimum(tally.low, low)
                tally.high = high if tally.high is None else np.maximum(tally.high, high)

    def places(self) -> list[Place]:
        """Every place of every true object; `state` is the object's state at the end."""
        return [
            Place(
                name,
                tally.truth.label,
                self._latest[name].state,
                tally.visits.total(),
                tally.truth.box_min,
                tally.truth.box_max,
                tally.low,
                tally.high,
                dict(tally.visits),
            )
            for (name, _), tally in self._places.items()
        ]
