"""What belongs to an object: a vote of the frames on every voxel of its cloud.

A cloud is the union of what masks held (ALGORITHM A.2), and some masks hold two things: one that takes the
desk in with the mug would leave the mug as large as the desk for good. So each frame in which an object was
detected votes on those of its voxels that it shows: inside what was detected, or outside. A voxel that is
mostly outside is not part of the object. Beyond the paper, which keeps every point.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import Float32Array, FloatArray, Frame, MaskArray
from dssmsg.geometry import Sight, sight_of_points
from dssmsg.graph.stations import Stations
from dssmsg.graph.voxels import BESIDE, KeyArray, contained, distinct, first_of_run, voxel_keys
from dssmsg.neighbours import near_any, quick_tree

MIN_OUTSIDE = 2
"""Frames that must have shown a voxel outside before it is refused."""
MIN_INSIDE = 2
"""Frames that must have shown a voxel inside before it counts as certain."""
STATION_M = 0.5
"""Frames taken from nearer to each other than this are one look: they share their mistakes, metres."""
MIN_SHRINK_M = 0.05
"""A cloud is cut where its box becomes this much shorter on an axis, metres; what changes less stays."""
OUTGROWN, MIN_OUTGROWN_M = 1.5, 0.05
"""What becomes this many times and metres wider grows more than one place is trusted with."""
_NO_STATION = np.iinfo(np.int32).max


@dataclass(frozen=True, slots=True)
class _Votes:
    """Ascending voxel keys (N,), how many frames showed each inside and outside, and the stations that showed
    it inside, as the lowest and the highest number (none: `_NO_STATION` and -1)."""

    keys: KeyArray
    inside: NDArray[np.int32]
    outside: NDArray[np.int32]
    first: NDArray[np.int32]
    last: NDArray[np.int32]

    @classmethod
    def of_frame(cls, keys: KeyArray, inside: bool, station: int) -> _Votes:
        """One frame's votes on ascending voxels."""
        one, none = np.ones(len(keys), np.int32), np.zeros(len(keys), np.int32)
        first = np.full(len(keys), station if inside else _NO_STATION, np.int32)
        last = np.full(len(keys), station if inside else -1, np.int32)
        return cls(keys, one if inside else none, none if inside else one, first, last)

    @classmethod
    def counted(cls, parts: Sequence[_Votes]) -> _Votes:
        """The sum of several."""
        parts = [part for part in parts if len(part.keys)] or list(parts[:1])
        if len(parts) == 1:
            return parts[0]
        keys = np.concatenate([part.keys for part in parts])
        order = np.argsort(keys)
        keys = keys[order]
        starts = np.flatnonzero(first_of_run(keys))

        def over(operation: np.ufunc, name: str) -> NDArray[np.int32]:
            values = np.concatenate([getattr(part, name) for part in parts])[order]
            result: NDArray[np.int32] = operation.reduceat(values, starts, dtype=np.int32)
            return result

        return cls(
            keys[starts],
            inside=over(np.add, "inside"),
            outside=over(np.add, "outside"),
            first=over(np.minimum, "first"),
            last=over(np.maximum, "last"),
        )

    def plus(self, keys: KeyArray, inside: bool, station: int) -> _Votes:
        """With one frame's votes on ascending voxels, counted into these very arrays where they are known."""
        place = np.searchsorted(self.keys, keys)
        known = contained(keys, self.keys)
        at = place[known]
        count = self.inside if inside else self.outside
        count[at] += 1
        if inside:
            self.first[at] = np.minimum(self.first[at], station)
            self.last[at] = np.maximum(self.last[at], station)
        if known.all():
            return self
        fresh = _Votes.of_frame(keys[~known], inside, station)
        places = place[~known]
        return _Votes(
            *(
                np.insert(getattr(self, name), places, getattr(fresh, name))
                for name in ("keys", "inside", "outside", "first", "last")
            )
        )


class Extents:
    """The votes on the voxels of all objects. `share`: a voxel inside less often than this is refused."""

    def __init__(self, share: float) -> None:
        self._share = share
        self._votes: dict[str, _Votes] = {}
        self._stations = Stations(STATION_M)

    def vote(
        self,
        object_id: str,
        cloud: Float32Array,
        seen: Float32Array,
        others: Sequence[Float32Array],
        frame: Frame,
        tolerance: float,
    ) -> None:
        """Count a frame in which the object of this `cloud` (N, 3) was detected as the points `seen` (M, 3).

        `others` are clouds that may be further pieces of it: voxels on them get no vote. Points count as on a
        cloud, and as shown by the frame, within `tolerance` metres.
        """
        sight = sight_of_points(cloud, frame.depth, frame.camera, frame.world_from_camera, tolerance)
        shown = cloud[sight == Sight.ON_SURFACE]
        outside = shown[~near_any(shown, seen, tolerance)]
        for other in others:
            outside = outside[~near_any(outside, other, tolerance)]
        out_keys = distinct(voxel_keys(outside))
        in_keys = distinct(np.concatenate([voxel_keys(shown), voxel_keys(seen)]))
        in_keys = in_keys[~contained(in_keys, out_keys)]
        station = self._stations.number(frame.world_from_camera[:3, 3])
        votes = self._votes.get(object_id)
        votes = (
            _Votes.of_frame(in_keys, True, station) if votes is None else votes.plus(in_keys, True, station)
        )
        self._votes[object_id] = votes.plus(out_keys, False, station)

    def belongs(self, object_id: str, points: Float32Array) -> MaskArray:
        """(N,) bool: which points (N, 3) are part of the object.

        The votes decide on a voxel that enough frames showed; any other goes with the nearest one decided.
        """
        return _with_nearest(points, *self._decided(object_id, points))

    def cut(self, object_id: str, cloud: Float32Array) -> MaskArray | None:
        """(N,) bool: which points of a cloud (N, 3) to keep; None where the cut would not shrink it."""
        refused, sure = self._decided(object_id, cloud)
        if not shrinks(cloud, sure):  # whatever else stays can only make it larger
            return None
        belongs = _with_nearest(cloud, refused, sure)
        return belongs if shrinks(cloud, belongs) else None

    def _decided(self, object_id: str, points: Float32Array) -> tuple[MaskArray, MaskArray]:
        """(N,), (N,) bool: which points (N, 3) the votes refuse, and which they are sure of."""
        votes = self._votes.get(object_id)
        if votes is None or not len(votes.keys):
            none = np.zeros(len(points), dtype=np.bool_)
            return none, none
        place = np.searchsorted(votes.keys, keys := voxel_keys(points))
        place[place == len(votes.keys)] = 0
        known = votes.keys[place] == keys
        inside, outside = (np.where(known, count[place], 0) for count in (votes.inside, votes.outside))
        rare = inside < self._share * (inside + outside)
        return rare & (outside >= MIN_OUTSIDE), ~rare & (inside >= MIN_INSIDE)

    def confirmed(self, object_id: str, points: Float32Array, *, elsewhere: bool) -> MaskArray:
        """(N,) bool: which points (N, 3) lie in a voxel that two frames had inside, or next to one; with
        `elsewhere` two frames from different stations."""
        votes = self._votes.get(object_id)
        if votes is None:
            return np.zeros(len(points), dtype=np.bool_)
        agreed = votes.first < votes.last if elsewhere else votes.inside > 1
        agreed &= votes.inside >= self._share * (votes.inside + votes.outside)
        known = votes.keys[agreed]
        keys = voxel_keys(points)
        near: MaskArray = np.zeros(len(points), dtype=np.bool_)
        for step in BESIDE:
            near |= contained(keys + step, known)
        return near

    def join(self, object_id: str, absorbed_id: str) -> None:
        """Two objects turned out to be one: what either has of the other was never outside."""
        gone = self._votes.pop(absorbed_id, None)
        kept = self._votes.pop(object_id, None)
        if gone is None or kept is None:
            return
        self._votes[object_id] = _Votes.counted([_cleared(kept, gone), _cleared(gone, kept)])

    def forget_all_but(self, object_ids: Container[str]) -> None:
        """Drop the votes of objects that are no more."""
        self._votes = {name: votes for name, votes in self._votes.items() if name in object_ids}


def shrinks(cloud: Float32Array, belongs: MaskArray) -> bool:
    """Whether leaving out what does not belong makes the box of a cloud (N, 3) clearly smaller."""
    if belongs.all() or not belongs.any():
        return False
    columns = np.ascontiguousarray(cloud.T)  # quicker to go along than across
    return bool((np.ptp(columns, axis=1) - np.ptp(columns[:, belongs], axis=1) >= MIN_SHRINK_M).any())


def outgrows(box_min: FloatArray, box_max: FloatArray, points: Float32Array) -> bool:
    """Whether points (N, 3) make a box much wider than it is; upwards masks seldom run over."""
    if not len(points):
        return False
    before = float((box_max - box_min)[:2].max())
    after = np.maximum(box_max, points.max(axis=0)) - np.minimum(box_min, points.min(axis=0))
    return float(after[:2].max()) > max(OUTGROWN * before, before + MIN_OUTGROWN_M)


def _cleared(votes: _Votes, other: _Votes) -> _Votes:
    """Without the votes against voxels that were inside the other one."""
    known = contained(votes.keys, other.keys[other.inside > 0])
    return replace(votes, outside=np.where(known, 0, votes.outside).astype(np.int32))


def _with_nearest(points: Float32Array, refused: MaskArray, sure: MaskArray) -> MaskArray:
    """(N,) bool: which points (N, 3) belong, where the undecided go with the nearest one decided."""
    fits: MaskArray = np.ones(len(points), dtype=np.bool_)
    if not refused.any() or not sure.any():
        return fits
    decided = refused | sure
    fits[decided] = sure[decided]
    _, nearest = quick_tree(points[decided]).query(points[~decided])
    fits[~decided] = sure[decided][nearest]
    return fits
