"""perception/segments: things without names, from depth geometry alone.

Needs no model and no truth: a user's own RGB-D folder gives a map on the first day. What is left of a room
once floor, ceiling and walls are taken away is cut at depth steps (and, if asked, at concave creases) and
falls into connected pieces. They are called "object". Touching things of one depth (a cup and the table
under it) stay one piece unless a crease parts them; a wardrobe that fills the image passes for a wall.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import ndimage

from dssmsg.frame import Detection, Float32Array, FloatArray, Frame, MaskArray
from dssmsg.geometry import pixel_rays
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

if TYPE_CHECKING:
    from dssmsg.interfaces import Context


class SegmentsConfig(PluginConfig):
    """Options of the segmentation; lengths in metres."""

    label: str = Field("object", min_length=1, description="The label of every piece.")
    min_pixels: int = Field(200, ge=20, description="Smallest piece to report, in pixels.")
    max_share: float = Field(0.5, gt=0, le=1, description="Largest piece to report, as a share of the image.")
    max_range: float = Field(5.0, gt=0, description="Pixels farther than this are left out.")
    plane_margin: float = Field(
        0.03,
        gt=0,
        description="Depth of the slab around floor, ceiling or wall; grows with the sensor's noise.",
    )
    wall_height: float = Field(
        1.9,
        gt=0,
        description="Upright planes this high are walls, and so is the hindmost at the image's top.",
    )
    wall_pixels: float = Field(0.02, gt=0, le=1, description="Smallest wall, as a share of the image.")
    step: float = Field(
        0.04, gt=0, description="Depth step between neighbours that parts two pieces, at range 0."
    )
    step_ratio: float = Field(0.02, ge=0, description="Its growth with range.")
    min_score: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Least compactness (share of its box) of a piece; drops strips along walls.",
    )
    crease_deg: float = Field(
        60.0, ge=0, le=180, description="Concave creases sharper than this part two pieces; 180 turns it off."
    )


class Segments:
    """Cuts a depth image into pieces; frames do not depend on each other."""

    feature_space: str | None = None

    def __init__(self, config: SegmentsConfig, context: Context) -> None:
        self._config = config
        self._noise = (0.0, 0.0) if context.source is None else context.source.depth_noise_m

    def detect(self, frame: Frame) -> Sequence[Detection]:
        """One detection a piece, the largest first; the score 0..1 is its compactness in the image."""
        config = self._config
        valid = (frame.depth > 0) & (frame.depth <= np.float32(config.max_range))
        if np.count_nonzero(valid) < config.min_pixels:
            return []
        points = _world_points(frame)
        normals = surface_normals(points, valid, frame.position)
        margin = config.plane_margin + 2.0 * (self._noise[0] + self._noise[1] * np.square(frame.depth))
        room = room_planes(
            points, normals, valid, frame.position, margin, config.wall_height, config.wall_pixels
        )
        free = valid & ~room
        return self._pieces(frame, free, points, normals)

    def _pieces(
        self, frame: Frame, free: MaskArray, points: Float32Array, normals: Float32Array
    ) -> list[Detection]:
        config = self._config
        cut = free & depth_cuts(frame.depth, config.step, config.step_ratio)
        if config.crease_deg < 180.0:
            cut |= free & concave_creases(points, normals, math.radians(config.crease_deg))
        pieces, count = ndimage.label(free & ~cut)
        labels = _fill_cuts(pieces, free & cut, frame.depth, config.step)
        sizes = np.bincount(labels.reshape(-1), minlength=count + 1)
        windows = ndimage.find_objects(labels)
        detections = []
        for number in np.argsort(-sizes[1:], kind="stable") + 1:
            if sizes[number] < config.min_pixels:
                break
            if sizes[number] > config.max_share * labels.size:
                continue
            rows, columns = windows[number - 1]
            mask = np.zeros(labels.shape, dtype=np.bool_)
            mask[rows, columns] = ndimage.binary_fill_holes(labels[rows, columns] == number) & (
                (labels[rows, columns] == number) | (labels[rows, columns] == 0)
            )
            box = np.array([columns.start, rows.start, columns.stop, rows.stop], dtype=np.float64)
            area = (box[2] - box[0]) * (box[3] - box[1])
            score = float(min(1.0, sizes[number] / area))
            if score >= config.min_score:
                detections.append(Detection(mask, box, config.label, score))
        return detections


def surface_normals(
    points: Float32Array, valid: MaskArray, position: FloatArray, reach: int = 2
) -> Float32Array:
    """(H, W, 3) unit normals towards `position` of world points (H, W, 3), smoothed over 5 x 5 pixels.

    Zero where a pixel has no reading, or too little around it.
    """
    weight = ndimage.uniform_filter(valid.astype(np.float32), size=2 * reach + 1)
    smooth = np.empty(points.shape, dtype=np.float32)
    for axis in range(3):
        channel = np.where(valid, points[..., axis], 0.0).astype(np.float32)
        smooth[..., axis] = ndimage.uniform_filter(channel, size=2 * reach + 1) / np.maximum(weight, 1e-6)
    across = np.zeros_like(smooth)
    down = np.zeros_like(smooth)
    across[:, reach:-reach] = smooth[:, 2 * reach :] - smooth[:, : -2 * reach]
    down[reach:-reach] = smooth[2 * reach :] - smooth[: -2 * reach]
    normals = np.empty_like(smooth)
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        normals[..., axis] = down[..., a] * across[..., b] - down[..., b] * across[..., a]
    length = np.sqrt(np.einsum("ijk,ijk->ij", normals, normals))
    facing = np.einsum("ijk,ijk->ij", normals, smooth - position.astype(np.float32)) > 0
    usable = valid & (weight > 0.5) & (length > 1e-12)
    scale = np.where(usable, np.where(facing, -1.0, 1.0) / np.maximum(length, 1e-12), 0.0)
    normals *= scale[..., None]
    return normals


def room_planes(
    points: Float32Array,
    normals: Float32Array,
    valid: MaskArray,
    position: FloatArray,
    margin: NDArray[np.floating[Any]],
    wall_height: float,
    wall_pixels: float,
) -> MaskArray:
    """(H, W) bool: floor, ceiling and walls. points (H, W, 3) world; margin (H, W) metres off a plane."""
    height = points[..., 2]
    room = np.zeros_like(valid)
    floor = _level(height[valid & (normals[..., 2] > 0.9) & (height < position[2] - 0.2)], lowest=True)
    if floor is not None:
        room |= valid & (height < floor + margin)
    ceiling = _level(height[valid & (normals[..., 2] < -0.9) & (height > position[2] + 0.5)], lowest=False)
    if ceiling is not None:
        room |= valid & (height > ceiling - margin)
    top = wall_height + (0.0 if floor is None else floor)
    upright = valid & ~room & (np.abs(normals[..., 2]) < 0.3) & (np.abs(normals).sum(axis=-1) > 0)
    for direction in _upright_directions(normals[upright]):
        facing = upright & (normals[..., :2] @ direction > 0.93)
        offset = points[..., :2] @ direction
        for plane in _offsets(offset[facing], int(wall_pixels * valid.size)):
            slab = np.abs(offset - plane) < margin
            on_plane = facing & slab
            pixels = np.count_nonzero(on_plane)
            if pixels < wall_pixels * valid.size:
                continue
            reaches_up = height[on_plane].max() > top
            at_top = np.count_nonzero(on_plane[:3].any(axis=0)) > 0.25 * np.count_nonzero(
                on_plane.any(axis=0)
            )
            beyond = np.count_nonzero(facing & (offset < plane - 0.2))
            if reaches_up or (at_top and beyond < wall_pixels * valid.size):
                # Normals are smoothed and wrong along creases: there, lying on the plane is enough.
                near = ndimage.binary_dilation(on_plane, iterations=5)
                room |= valid & slab & (near | (normals[..., :2] @ direction > 0.5))
                upright &= ~slab
    return room


def _level(
    heights: NDArray[np.floating[Any]], *, lowest: bool, bin_m: float = 0.02, least: int = 400
) -> float | None:
    """The lowest (or highest) height that at least `least` of the pixels share, or None."""
    if len(heights) < least:
        return None
    start = float(heights.min())
    counts = np.bincount(((heights - start) / bin_m).astype(np.int64))
    padded = np.concatenate([[0], counts, [0]])
    crowd = np.flatnonzero(padded[:-2] + padded[1:-1] + padded[2:] >= least)
    if len(crowd) == 0:
        return None
    peak = crowd[0] if lowest else crowd[-1]
    around = np.arange(max(peak - 1, 0), min(peak + 3, len(counts)))
    best = around[np.argmax(counts[around])]
    return start + (float(best) + 0.5) * bin_m


def _upright_directions(normals: NDArray[np.floating[Any]]) -> list[FloatArray]:
    """The four horizontal unit vectors (2,) of the room's main axes, from upright normals (N, 3)."""
    if len(normals) < 200:
        return []
    angles = np.arctan2(normals[:, 1], normals[:, 0]) % (math.pi / 2)
    bins = 45
    counts = np.bincount((angles / (math.pi / 2) * bins).astype(np.int64) % bins, minlength=bins)
    smooth = counts + np.roll(counts, 1) + np.roll(counts, -1)
    peak = int(np.argmax(smooth))
    difference = (angles - (peak + 0.5) * math.pi / 2 / bins + math.pi / 4) % (math.pi / 2) - math.pi / 4
    near = np.abs(difference) < math.radians(3.0)
    base = (peak + 0.5) * math.pi / 2 / bins + float(difference[near].mean() if near.any() else 0.0)
    return [np.array([math.cos(base + k * math.pi / 2), math.sin(base + k * math.pi / 2)]) for k in range(4)]


def _offsets(values: NDArray[np.floating[Any]], least: int, bin_m: float = 0.03) -> list[float]:
    """Offsets that at least `least` values crowd around, local maxima of a histogram."""
    if len(values) < least:
        return []
    start = float(values.min())
    counts = np.bincount(((values - start) / bin_m).astype(np.int64))
    padded = np.concatenate([[0], counts, [0]])
    crowd = padded[:-2] + padded[1:-1] + padded[2:]
    sides = np.concatenate([[0], crowd, [0]])
    peaks = np.flatnonzero((crowd >= least) & (crowd >= sides[:-2]) & (crowd > sides[2:]))
    offsets = []
    for peak in peaks:
        near = np.abs(values - (start + (peak + 0.5) * bin_m)) < 1.5 * bin_m
        offsets.append(float(np.median(values[near])))
    return offsets


def depth_cuts(depth: NDArray[np.float32], step: float, step_ratio: float) -> MaskArray:
    """(H, W) bool: pixels on the far side of a depth step larger than step + step_ratio * depth."""
    cut = np.zeros(depth.shape, dtype=np.bool_)
    for axis in (0, 1):
        ahead, behind = (depth[1:], depth[:-1]) if axis == 0 else (depth[:, 1:], depth[:, :-1])
        jump = ahead - behind
        limit = step + step_ratio * np.minimum(ahead, behind)
        far_ahead, far_behind = jump > limit, jump < -limit
        if axis == 0:
            cut[1:] |= far_ahead
            cut[:-1] |= far_behind
        else:
            cut[:, 1:] |= far_ahead
            cut[:, :-1] |= far_behind
    return cut


def concave_creases(points: Float32Array, normals: Float32Array, angle: float, reach: int = 3) -> MaskArray:
    """(H, W) bool: pixels where the surface folds towards the camera by more than `angle` radians.

    Points p, q with normals n, m are on a concave fold where (m - n) . (q - p) < 0: n and m lean together.
    """
    crease = np.zeros(points.shape[:2], dtype=np.bool_)
    limit = math.cos(angle)
    across = (np.s_[:, : -2 * reach], np.s_[:, 2 * reach :], np.s_[:, reach:-reach])
    down = (np.s_[: -2 * reach, :], np.s_[2 * reach :, :], np.s_[reach:-reach, :])
    for a, b, middle in (across, down):
        turn = np.einsum("ijk,ijk->ij", normals[a], normals[b])
        lean = np.einsum("ijk,ijk->ij", normals[b] - normals[a], points[b] - points[a])
        both = np.abs(normals[a]).sum(axis=-1) * np.abs(normals[b]).sum(axis=-1) > 0
        crease[middle] |= both & (turn < limit) & (lean < -0.002)
    return crease


def _fill_cuts(
    labels: NDArray[np.integer[Any]], cut: MaskArray, depth: NDArray[np.float32], step: float
) -> NDArray[np.integer[Any]]:
    """Give cut pixels to the nearest piece whose depth there is like theirs."""
    if not cut.any() or not labels.any():
        return labels
    _, (rows, columns) = ndimage.distance_transform_edt(
        labels == 0, return_distances=True, return_indices=True
    )
    filled = labels.copy()
    v, u = np.nonzero(cut)
    nearest = (rows[v, u], columns[v, u])
    close = (np.hypot(nearest[0] - v, nearest[1] - u) <= 6) & (
        np.abs(depth[nearest] - depth[v, u]) < 3 * step
    )
    filled[v[close], u[close]] = labels[nearest][close]
    return filled


def _world_points(frame: Frame) -> Float32Array:
    """(H, W, 3) float32 world points of all pixels; those without a reading lie at the camera."""
    rays = pixel_rays(frame.camera).astype(np.float32)
    pose = frame.world_from_camera.astype(np.float32)
    points = (rays * frame.depth.reshape(-1, 1)) @ pose[:3, :3].T
    image: Float32Array = (points + pose[:3, 3]).astype(np.float32, copy=False)
    return image.reshape(*frame.depth.shape, 3)


@hookimpl
def register_perception(register: Register) -> None:
    """Announce `segments`."""
    register("segments", Segments, config=SegmentsConfig)
