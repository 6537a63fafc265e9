"""From detections to observations in the world: ALGORITHM A.1, after paper III-A.

"2D masks are projected into 3D point clouds using the depth image and camera pose." Ours adds what keeps
those clouds clean: mask rims on depth steps are left out, points are thinned to voxels, and only
dense clusters stay.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dssmsg.cluster import density_clusters
from dssmsg.frame import Detection, Float32Array, FloatArray, Frame, MaskArray, Observation
from dssmsg.geometry import box_of, cell_keys, pixel_rays, transform_points

BACKGROUND_LABELS = frozenset({"wall", "floor", "ceiling", "door"})
"""Labels that are never nodes of the graph."""
SPILL_LAYER_M = 0.03
"""How thick the layer is that may be the surface a thing stands on, metres."""
SPILL_LEAST, SPILL_BODY_SHARE = 8, 0.1
"""So many points above that layer, and this share of it, make what stands there a thing and not a rim."""
_NOTHING = np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, slots=True)
class Lifted:
    """Observations in the order of their detections; `dropped` counts detections by reason, `reasons` names
    it for each dropped detection by its index: `background`, `no_depth`, `few_points` or `sparse`. `kept`
    says, by the index of each observation's detection, which (V,) of the voxels of its mask are of the
    thing."""

    observations: tuple[Observation, ...]
    dropped: Counter[str]
    reasons: dict[int, str]
    kept: Mapping[int, MaskArray] = field(default_factory=dict)


class Lifter:
    """Lifts the detections of one frame at a time; holds settings only.

    Lengths in metres. `max_range` drops pixels farther along the optical axis; `min_points` is asked of the
    pixels with depth and again of the final voxels' cluster; `voxel` is the side of world-aligned cells
    floor(p / voxel), each represented by the mean of its points; `eps` and `min_neighbours` (the point
    itself counted) define density clusters. Of these the largest is the thing, and so is, beyond the paper,
    any other of at least `part_share` of its size within `part_gap`, and no farther than it is large, of what
    is kept already: behind a chair a table shows in two parts, and keeping the larger alone makes two tables
    of it once the parts have been the larger in turn (1.0: the largest alone). What runs over onto the
    surface below goes, see `spilled`. A mask pixel beside a pixel outside the mask counts as rim, and is left
    out where the two depths differ by more than `step` plus `step_ratio` of the depth.
    """

    def __init__(
        self,
        max_range: float = 5.0,
        min_points: int = 16,
        voxel: float = 0.025,
        eps: float = 0.1,
        min_neighbours: int = 10,
        part_share: float = 0.15,
        part_gap: float = 0.5,
        step: float = 0.05,
        step_ratio: float = 0.02,
        background_labels: frozenset[str] = BACKGROUND_LABELS,
    ) -> None:
        self.max_range = max_range
        self.min_points = min_points
        self.voxel = voxel
        self.eps = eps
        self.min_neighbours = min_neighbours
        self.part_share = part_share
        self.part_gap = part_gap
        self.step = step
        self.step_ratio = step_ratio
        self.background_labels = background_labels

    def lift(
        self, frame: Frame, detections: Sequence[Detection], kept: Mapping[int, MaskArray] | None = None
    ) -> Lifted:
        """Observations of the detections that hold enough points; masks must have the frame's size (H, W).

        `kept` is that of an earlier lift of the same frame, which saves the search for clusters; where it is
        not of these masks, it is passed over. Raises ValueError for a mask of another size.
        """
        reasons: dict[int, str] = {}
        chosen: list[int] = []
        pixels: list[NDArray[np.intp]] = []
        readable = (frame.depth > 0) & (frame.depth <= np.float32(self.max_range))
        steps = depth_steps(frame.depth, self.step, self.step_ratio)
        for index, detection in enumerate(detections):
            if detection.mask.shape != frame.depth.shape:
                raise ValueError(
                    f"detection {index}: expected a mask {frame.depth.shape}, got {detection.mask.shape}"
                )
            if detection.label.strip().lower() in self.background_labels:
                reasons[index] = "background"
                continue
            found = mask_pixels(detection.mask, readable, steps)
            if len(found) < self.min_points:
                reasons[index] = "few_points" if len(found) else "no_depth"
                continue
            chosen.append(index)
            pixels.append(found)
        voxels: dict[int, MaskArray] = {}
        observations = (
            self._observe(frame, detections, chosen, pixels, reasons, kept, voxels) if chosen else []
        )
        return Lifted(tuple(observations), Counter(reasons.values()), dict(sorted(reasons.items())), voxels)

    def _observe(
        self,
        frame: Frame,
        detections: Sequence[Detection],
        chosen: list[int],
        pixels: list[NDArray[np.intp]],
        reasons: dict[int, str],
        known: Mapping[int, MaskArray] | None,
        voxels: dict[int, MaskArray],
    ) -> list[Observation]:
        """Voxelise and cluster all detections in one go (few large array operations, not many small).

        Fills `voxels` with what is kept of each mask; where that is `known`, it is not searched for.
        """
        owner = np.repeat(np.arange(len(chosen)), [len(p) for p in pixels])
        pixel = np.concatenate(pixels)
        depth = frame.depth.reshape(-1)[pixel].astype(np.float64)
        points = transform_points(frame.world_from_camera, pixel_rays(frame.camera)[pixel] * depth[:, None])
        colors = frame.rgb.reshape(-1, 3)[pixel]
        points, voxel_colors, owner = voxelise(points, colors, self.voxel, owner)
        observations = []
        ends = np.searchsorted(owner, np.arange(len(chosen) + 1))
        if known is None or not _of_these(known, dict(zip(chosen, np.diff(ends), strict=True))):
            known = None
            labels = density_clusters(points, self.eps, self.min_neighbours, groups=owner)
        for place, index in enumerate(chosen):
            part = slice(ends[place], ends[place + 1])
            if known is None:
                keep = self._parts(points[part], labels[part])
                keep = keep[~spilled(points[part][keep])]
            else:
                keep = np.flatnonzero(known[index]) if index in known else _NOTHING
            if len(keep) < self.min_points:
                reasons[index] = "sparse"
                continue
            detection = detections[index]
            voxels[index] = np.zeros(part.stop - part.start, dtype=np.bool_)
            voxels[index][keep] = True
            cloud: Float32Array = points[part][keep].astype(np.float32)
            box_min, box_max = box_of(cloud)
            observations.append(
                Observation(
                    detection_index=index,
                    label=detection.label,
                    score=detection.score,
                    points_world=_read_only(cloud),
                    colors=_read_only(voxel_colors[part][keep]),
                    box_min=_read_only(box_min),
                    box_max=_read_only(box_max),
                    range_m=float(np.median(frame.depth.reshape(-1)[pixels[place]])),
                    text_feature=detection.text_feature,
                    image_feature=detection.image_feature,
                )
            )
        return observations

    def _parts(self, points: NDArray[np.float64], labels: NDArray[np.int64]) -> NDArray[np.intp]:
        """Ascending indices of the largest cluster and of those that count as further parts of the thing."""
        if not (labels >= 0).any():
            # A pole or a cable is a line of voxels and never has as many neighbours as a surface: ask half.
            labels = density_clusters(points, self.eps, (self.min_neighbours + 1) // 2)
        sizes = np.bincount(labels[labels >= 0])
        if len(sizes) == 0:
            return np.zeros(0, dtype=np.intp)
        by_size = np.argsort(-sizes, kind="stable")
        kept = np.flatnonzero(labels == by_size[0])
        least = max(self.part_share * sizes[by_size[0]], self.min_points)
        for cluster in by_size[1:]:
            if self.part_share >= 1.0 or sizes[cluster] < least:
                break
            part = np.flatnonzero(labels == cluster)
            gap = min(self.part_gap, float(np.linalg.norm(np.ptp(points[kept], axis=0))))
            gaps, _ = KDTree(points[kept]).query(points[part], distance_upper_bound=gap)
            if np.isfinite(gaps).any():
                kept = np.sort(np.concatenate([kept, part]))
        return kept


def _of_these(kept: Mapping[int, MaskArray], voxels: Mapping[int, int]) -> bool:
    """Whether what was kept can be of masks with so many voxels, both by detection."""
    return all(voxels.get(index) == len(mask) for index, mask in kept.items())


def spilled(points: FloatArray) -> MaskArray:
    """(N,) bool: which points (N, 3) of a thing are of the surface it stands on.

    A mask that runs over onto the table takes in a low layer far beyond the mug. What is in the lowest
    `SPILL_LAYER_M` and farther from all that stands above it than that is high is spilled. Flat things have
    too little above that layer, and stay whole.
    """
    none: MaskArray = np.zeros(len(points), dtype=np.bool_)
    if len(points) == 0:
        return none
    heights = points[:, 2] - np.quantile(points[:, 2], 0.02)
    low = heights < SPILL_LAYER_M
    body = points[~low]
    if len(body) < max(SPILL_LEAST, SPILL_BODY_SHARE * np.count_nonzero(low)):
        return none
    high = float(np.quantile(heights[~low], 0.9))
    if high < 2 * SPILL_LAYER_M - 0.01:
        return none
    away, _ = KDTree(body[:, :2]).query(points[low, :2])
    result = none
    result[low] = away > high
    return result


def depth_steps(depth: Float32Array, step: float, step_ratio: float) -> tuple[MaskArray, MaskArray]:
    """Where depth (H, W) jumps: between horizontal neighbours (H, W - 1) and vertical ones (H - 1, W), bool.

    A jump is more than `step` metres plus `step_ratio` of the nearer depth; no reading counts as depth 0.
    """

    def jump(a: Float32Array, b: Float32Array) -> MaskArray:
        far: MaskArray = np.abs(a - b) > step + step_ratio * np.minimum(a, b)
        return far

    return jump(depth[:, 1:], depth[:, :-1]), jump(depth[1:], depth[:-1])


def mask_pixels(mask: MaskArray, readable: MaskArray, steps: tuple[MaskArray, MaskArray]) -> NDArray[np.intp]:
    """Flat, ascending indices of the mask's readable pixels, without its rim where depth jumps across it.

    Sensors mix the depths on both sides of such a step ("flying pixels"), and masks leak over it. Thin
    things are nearly all rim: if less than half would be left, the rim stays.
    """
    rows = np.flatnonzero(mask.any(axis=1))
    if len(rows) == 0:
        return rows
    top, bottom = int(rows[0]), int(rows[-1]) + 1
    columns = np.flatnonzero(mask[top:bottom].any(axis=0))
    left, right = int(columns[0]), int(columns[-1]) + 1
    # One pixel more on each side, inside the image, so that the neighbours across the rim are seen too.
    top, left = max(top - 1, 0), max(left - 1, 0)
    bottom, right = min(bottom + 1, mask.shape[0]), min(right + 1, mask.shape[1])
    inside = mask[top:bottom, left:right]
    good = inside & readable[top:bottom, left:right]
    across = (inside[:, 1:] != inside[:, :-1]) & steps[0][top:bottom, left : right - 1]
    down = (inside[1:] != inside[:-1]) & steps[1][top : bottom - 1, left:right]
    rim = np.zeros_like(inside)
    rim[:, 1:] |= across
    rim[:, :-1] |= across
    rim[1:] |= down
    rim[:-1] |= down
    core = good & ~rim
    if 2 * np.count_nonzero(core) >= np.count_nonzero(good):
        good = core
    v, u = np.nonzero(good)
    flat: NDArray[np.intp] = (v + top) * mask.shape[1] + (u + left)
    return flat


def voxelise(
    points: NDArray[np.float64],
    colors: NDArray[np.uint8],
    voxel: float,
    owner: NDArray[np.intp] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.intp]]:
    """Thin points (N, 3) to one a cell floor(p / voxel) of each owner: the mean point and mean colour.

    Returns points (M, 3), colours (M, 3) and owners (M,), ordered by owner, then by cell x, y, z.
    """
    if owner is None:
        owner = np.zeros(len(points), dtype=np.intp)
    if len(points) == 0:
        return points, colors, owner
    keys, _ = cell_keys(points, voxel, owner)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    sizes = np.diff(np.append(starts, len(points)))
    mean_points = np.empty((len(starts), 3))
    mean_colors = np.empty((len(starts), 3), dtype=np.uint8)
    for axis in range(3):
        mean_points[:, axis] = np.add.reduceat(points[order, axis], starts) / sizes
        sums = np.add.reduceat(colors[order, axis], starts, dtype=np.int64)
        mean_colors[:, axis] = (2 * sums + sizes) // (2 * sizes)  # rounded
    return mean_points, mean_colors, owner[order[starts]]


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    array.flags.writeable = False
    return array
