"""What one frame says of a place: is something there, is it hidden, or is it shown free (ALGORITHM B).

"Unseen is not gone": a detector that misses a thing says nothing about it. Only depth that reaches behind
where the thing stood says that it is not there; a place that is hidden, out of the image, too far or
without a reading gives no evidence at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import ByteArray, Camera, Float32Array, FloatArray, Frame, MaskArray
from dssmsg.geometry import depth_sigma, invert_rigid, project, transform_points
from dssmsg.graph.verdicts import MISSED, OCCLUDED, OUT_OF_RANGE, OUT_OF_VIEW, PRESENT, UNKNOWN


@dataclass(frozen=True, slots=True)
class SightRule:
    """Thresholds of the test.

    A point is shown free where depth lies more than max(min_margin, sigmas * sigma(z)) metres behind it; a
    place is free where at least `free_share` of the points that fall inside the image are, and something is
    there where depth finds `present_share` of them in place: the rest hides behind them. Where a part is
    hidden the share is taken of what is not, if less than `own_surface` is found in place. `sample` points
    of a cloud are asked, `min_points` must fall inside, `max_range` metres is as far as anyone looks.
    """

    min_margin: float = 0.03
    sigmas: float = 3.0
    free_share: float = 0.6
    present_share: float = 0.25
    own_surface: float = 0.15
    sample: int = 256
    min_points: int = 6
    min_inside_share: float = 0.15
    max_range: float = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A frame made ready for many questions: pose, and the nearest depth around each pixel.

    near (h, w) float32 metres: the smallest reading within one pixel, 0 where the pixel itself has none, so
    that thin things and edges never look free because of a pixel beside them. `stride` is the step between
    its pixels in the camera's image. rgb (h, w, 3) uint8 at the same pixels.
    """

    frame: int
    visit: int
    camera: Camera
    world_from_camera: FloatArray
    near: Float32Array
    rgb: ByteArray
    stride: int = 1

    @classmethod
    def of(cls, frame: Frame) -> View:
        """The view of a frame at full size; association and update ask for the same one."""
        return _view_of(frame)

    def thinned(self, stride: int = 2) -> View:
        """Every second pixel of each second row, to be kept: a quarter of the memory."""
        return View(
            self.frame,
            self.visit,
            self.camera,
            self.world_from_camera,
            np.ascontiguousarray(self.near[::stride, ::stride]),
            np.ascontiguousarray(self.rgb[::stride, ::stride]),
            self.stride * stride,
        )


@lru_cache(maxsize=1)
def _view_of(frame: Frame) -> View:
    valid = frame.depth > 0
    filled = np.where(valid, frame.depth, np.float32(np.inf))
    near = np.where(valid, _least_around(filled), np.float32(0))
    return View(frame.index, frame.visit, frame.camera, frame.world_from_camera, near, frame.rgb)


def _least_around(values: Float32Array) -> Float32Array:
    """(H, W): the smallest of each value and its neighbours. Scipy's filter takes ten times as long."""
    least = values.copy()
    np.minimum(least[:, 1:], values[:, :-1], out=least[:, 1:])
    np.minimum(least[:, :-1], values[:, 1:], out=least[:, :-1])
    rows = least.copy()
    np.minimum(least[1:], rows[:-1], out=least[1:])
    np.minimum(least[:-1], rows[1:], out=least[:-1])
    return least


@dataclass(frozen=True, slots=True, eq=False)
class PlaceSight:
    """How a cloud's sampled points look in a view: shares of the points inside the image and range.

    `inside` is how many of the `asked` points fall inside the image, `near_enough` how many of these lie
    within range; `on_surface` (asked,) says which of them depth finds in place, `rows` and `columns`
    (asked,) where in the view they fall.
    """

    asked: int
    inside: int
    near_enough: int
    free: float
    surface: float
    occluded: float
    unread: float
    on_surface: MaskArray
    rows: np.ndarray
    columns: np.ndarray

    def values(self) -> dict[str, float]:
        """The shares by name, for the recording."""
        return {
            "points": float(self.near_enough),
            "free": round(self.free, 4),
            "surface": round(self.surface, 4),
            "occluded": round(self.occluded, 4),
        }


def telling(points: Float32Array, height: float = 0.05) -> MaskArray:
    """(N,) bool: which points (N, 3) of a thing can say whether it is there.

    Not those within `height` metres of its underside: depth takes them for what it stands on, and it for
    them. All, where hardly any others are left.
    """
    high: MaskArray = points[:, 2] > float(points[:, 2].min()) + height
    return high if np.count_nonzero(high) >= 0.2 * len(points) else np.ones(len(points), dtype=np.bool_)


def sampled(points: NDArray[Any], count: int) -> NDArray[Any]:
    """At most `count` of the points (N, 3), spread evenly; always the same ones of the same cloud."""
    return points if len(points) <= count else points[(np.arange(count) * len(points)) // count]


def look_at(
    points: Float32Array, view: View, noise: tuple[float, float], rule: SightRule = SightRule()
) -> PlaceSight:
    """What a view shows where the points (N, 3) of a cloud are; `noise` (a, b): sigma(z) = a + b z^2."""
    return look_at_each([points], view, noise, rule)[0]


def look_at_each(
    clouds: Sequence[Float32Array], view: View, noise: tuple[float, float], rule: SightRule = SightRule()
) -> list[PlaceSight]:
    """`look_at` of several clouds (N, 3) at once: one look-up for all their points."""
    if not clouds:
        return []
    samples = [sampled(points, rule.sample) for points in clouds]
    asked = np.concatenate(samples)
    uv, z = project(transform_points(invert_rigid(view.world_from_camera), asked), view.camera)
    u, v = np.rint(np.nan_to_num(uv, nan=-1e9) / view.stride).T
    height, width = view.near.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    # Just before the camera a point may be any number of pixels aside.
    columns, rows = (np.where(inside, pixels, -1).astype(np.int64) for pixels in (u, v))
    within = inside & (z <= rule.max_range)
    measured = np.zeros(len(asked), np.float64)
    measured[within] = view.near[rows[within], columns[within]]
    margin = np.maximum(rule.min_margin, rule.sigmas * depth_sigma(np.where(within, z, 0.0), noise))
    read = within & (measured > 0)
    free = read & (measured > z + margin)
    hidden = read & (measured < z - margin)
    surface = read & ~free & ~hidden
    ends = np.cumsum([len(points) for points in samples])
    # How many points of each cloud are so: sums up to the cloud's end less those up to its start.
    sums = np.cumsum([inside, within, free, surface, hidden, within & ~read], axis=1)
    counts = np.diff(np.pad(sums, ((0, 0), (1, 0)))[:, [0, *ends]], axis=1).T.tolist()
    return [
        PlaceSight(
            asked=len(points),
            inside=in_image,
            near_enough=near,
            free=shown_free / max(near, 1),
            surface=in_place / max(near, 1),
            occluded=behind / max(near, 1),
            unread=unread / max(near, 1),
            on_surface=surface[end - len(points) : end],
            rows=rows[end - len(points) : end],
            columns=columns[end - len(points) : end],
        )
        for points, end, (in_image, near, shown_free, in_place, behind, unread) in zip(
            samples, ends.tolist(), counts, strict=True
        )
    ]


def verdict_of(sight: PlaceSight, rule: SightRule = SightRule()) -> str:
    """The verdict on a place that no detection was matched to: missed, present, occluded, ..."""
    if sight.inside < min(rule.min_points, sight.asked):
        return OUT_OF_VIEW
    if sight.near_enough < min(rule.min_points, sight.asked):
        return OUT_OF_RANGE
    if sight.near_enough < rule.min_inside_share * sight.asked:
        return UNKNOWN
    if sight.free >= rule.free_share:
        return MISSED
    in_sight = 1.0 - sight.occluded
    if sight.surface < rule.own_surface and rule.free_share / 2 <= sight.free >= rule.free_share * in_sight:
        return MISSED  # what is not hidden of it is not there
    if sight.free > rule.free_share / 2:
        return UNKNOWN  # part of what is stored is there, part is not: too little of either
    if sight.surface >= rule.present_share:
        return PRESENT
    return OCCLUDED if sight.occluded >= sight.unread else UNKNOWN


def is_thin(points: Float32Array, margin: float) -> bool:
    """Whether depth cannot tell a thing from what it lies on: no extent of its surface reaches the margin.

    A rug on the floor, a picture on the wall.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    return bool(float((high - low).min()) < margin)
