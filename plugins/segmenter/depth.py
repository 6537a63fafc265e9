"""segmenter/depth: masks from boxes by depth alone, for any detector without masks of its own.

A box around a thing holds what carries it, what stands before it and what is seen behind it, too. What
carries it is a level surface that goes on beyond the box: the table under a cup, the floor under a chair.
What is left falls apart at depth steps, and the piece is taken that lies in the middle of the box and does
not go on beyond it, with further pieces of the same kind beside it. A book leaves nothing once the table
under it is taken away: of things known to be flat the surface itself inside the box is taken. A glass leaves
nothing either, where the sensor looks through it, and gets no mask.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import ndimage

from dssmsg.frame import Float32Array, FloatArray, Frame, MaskArray
from dssmsg.geometry import depth_sigma, pixel_rays
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.perception import Box
from dssmsg.level_surfaces import crowded_heights, fit_level, up_facing

TABLES = ("table", "desk", "counter", "countertop", "workbench")
FLAT = (
    "book", "magazine", "newspaper", "paper", "rug", "carpet", "mat", "doormat", "placemat", "keyboard",
    "phone", "tablet", "remote", "remote control", "knife", "fork", "spoon", "scissors", "plate", "tray",
    "cutting board", "towel", "pizza", "mouse",
)  # fmt: skip
PLAN_CELL_M = 0.05


class Config(PluginConfig):
    """Options of the segmenter `depth`; lengths in metres."""

    step: float = Field(
        0.05, gt=0, description="Neighbouring depths that differ by more are not joined, at range 0."
    )
    step_ratio: float = Field(0.02, ge=0, description="Its growth with range.")
    margin: float = Field(
        0.02,
        gt=0,
        description="Half the thickness of a level surface; 3 sigma of the sensor's noise if that is more.",
    )
    floor: float = Field(
        0.05, ge=0, description="Surface below this is floor, unless the box holds nothing else."
    )
    surroundings: float = Field(
        0.5,
        gt=0,
        le=2,
        description="How far around a box to look for what goes on beyond it, as a share of its size.",
    )
    flat_topped: tuple[str, ...] = Field(
        TABLES,
        description="Things whose top is their highest part: what stands on it is left out. Whole labels, "
        "or their last word.",
    )
    flat: tuple[str, ...] = Field(
        FLAT,
        description="Things too flat to stand out: the surface that they lie on speaks for them. Whole "
        "labels, or their last word.",
    )
    exclusive: bool = Field(True, description="Whether a pixel in several masks is the smallest one's alone.")


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """A frame's geometry: points (H, W, 3) world, and masks and thickness (H, W) derived from it."""

    depth: Float32Array
    points: Float32Array
    valid: MaskArray
    up: MaskArray
    cut: MaskArray
    margin: Float32Array


class DepthSegmenter:
    """Boxes to masks; frames do not depend on each other. `noise`: (a, b) of sigma(z) = a + b z^2, metres."""

    def __init__(self, config: Config, noise: tuple[float, float] = (0.0, 0.0)) -> None:
        self._config = config
        self._noise = noise
        self._flat_topped = frozenset(map(_plain, config.flat_topped))
        self._flat = frozenset(map(_plain, config.flat))

    def segment(self, frame: Frame, boxes: Sequence[Box]) -> Sequence[MaskArray]:
        """One mask (H, W) a box; the detector's own where it gave one, empty where there is no depth."""
        if all(box.mask is not None for box in boxes):
            return [box.mask for box in boxes if box.mask is not None]
        scene = self._scene(frame)
        masks = [self._mask(scene, box) if box.mask is None else box.mask.copy() for box in boxes]
        if self._config.exclusive:
            _share_out(masks, [box.mask is None for box in boxes])
        return masks

    def _scene(self, frame: Frame) -> _Scene:
        config, depth = self._config, frame.depth
        pose = frame.world_from_camera
        rays = pixel_rays(frame.camera).astype(np.float32)
        points = (rays * depth.reshape(-1, 1)) @ pose[:3, :3].T.astype(np.float32)
        points = (points + pose[:3, 3].astype(np.float32)).reshape(*depth.shape, 3)
        valid = depth > 0
        margin = np.maximum(config.margin, 3.0 * depth_sigma(depth, self._noise)).astype(np.float32)
        return _Scene(
            depth,
            points,
            valid,
            up_facing(points, valid),
            _far_sides(depth, config.step, config.step_ratio),
            margin,
        )

    def _mask(self, scene: _Scene, box: Box) -> MaskArray:
        """The mask (H, W) of one box."""
        shape = scene.depth.shape
        mask = np.zeros(shape, dtype=np.bool_)
        inner = _window(box.xyxy, shape, 0.0)
        outer = _window(box.xyxy, shape, self._config.surroundings)
        if inner is None or outer is None or not scene.valid[inner].any():
            return mask
        inside = np.zeros(shape, dtype=np.bool_)
        inside[inner] = True
        inside, part = inside[outer], _cut_out(scene, outer)
        weight = _middle(inside)
        usable = part.valid & (part.points[..., 2] > self._config.floor)
        if np.count_nonzero(usable & inside) < 0.1 * np.count_nonzero(part.valid & inside):
            usable = part.valid
        support = self._support(part, usable, inside)
        found = self._pieces(part, usable & ~support, inside, weight)
        if float(weight[found].sum()) < 0.25 * float(weight[support].sum()):
            found = support & inside if _is_one_of(box.label, self._flat) else np.zeros_like(found)
        if _is_one_of(box.label, self._flat_topped):
            found &= _top_and_below(part, found)
        mask[outer] = found
        return mask

    def _support(self, part: _Scene, usable: MaskArray, inside: MaskArray) -> MaskArray:
        """Pixels of level surfaces that lie more outside than inside the box."""
        support = np.zeros_like(inside)
        level = usable & part.up
        around = level & ~inside
        least = max(30, int(0.1 * np.count_nonzero(~inside)))
        # Normals are wrong along the foot of what stands there; a wall across the height is far from level.
        near_level = ndimage.binary_dilation(level, iterations=5)
        for height in crowded_heights(part.points[..., 2][around], least):
            plane = fit_level(part.points[around], height, 2 * self._config.margin)
            if plane is None:
                continue
            on_plane = usable & near_level & (np.abs(plane.above(part.points)) < part.margin)
            within = np.count_nonzero(on_plane & inside)
            if within < np.count_nonzero(on_plane & ~inside):
                support |= on_plane
        return support

    def _pieces(self, part: _Scene, free: MaskArray, inside: MaskArray, weight: FloatArray) -> MaskArray:
        """The piece of the free pixels with the most of the box's middle and the least beyond the box.

        With it come others that keep to the box, at the same depth.
        """
        labels, count = ndimage.label(free & ~part.cut)
        if count == 0:
            return np.zeros_like(inside)
        flat = labels.reshape(-1)
        total = np.bincount(flat, minlength=count + 1)
        within = np.bincount(flat, inside.reshape(-1).astype(np.float64), count + 1)
        central = np.bincount(flat, weight.reshape(-1), count + 1)
        kept = within / np.maximum(total, 1)
        score = central * kept
        score[0] = -1.0
        best = int(np.argmax(score))
        depth = part.depth
        near, far = np.percentile(depth[(labels == best) & inside], [5, 95]) if within[best] else (0.0, -1.0)
        chosen = [best]
        for other in np.flatnonzero((kept > 0.9) & (within > 0.1 * within[best])):
            if other in (0, best):
                continue
            middle = float(np.median(depth[labels == other]))
            if near - 0.1 <= middle <= far + 0.1:
                chosen.append(int(other))
        return np.isin(labels, chosen) & inside


def _top_and_below(part: _Scene, found: MaskArray) -> MaskArray:
    """(H, W) bool: the largest level surface of a mask and what is straight below it; all if there is none.

    A table's legs belong to it; cups that stand on it and chairs around it do not.
    """
    seen = part.points[found & part.up]
    planes = [
        plane
        for height in crowded_heights(seen[:, 2], max(30, len(seen) // 5))
        if (plane := fit_level(seen, height, 0.04)) is not None
    ]
    if not planes:
        return np.ones_like(found)
    plane = max(planes, key=lambda one: int(np.count_nonzero(np.abs(one.above(seen)) < 0.02)))
    above = plane.above(part.points)
    top = found & (np.abs(above) < part.margin) & ndimage.binary_dilation(part.up & found, iterations=5)
    # The top's ground plan on a grid; holes are what stands on it, and its rim is a cell uncertain.
    low = part.points[found][:, :2].min(axis=0)
    cells = ((part.points[..., :2] - low) / PLAN_CELL_M).astype(np.int64) + 1
    cells = np.where(found[..., None], cells, 0)
    plan = np.zeros(cells.reshape(-1, 2).max(axis=0) + 2, dtype=np.bool_)
    plan[tuple(cells[top].T)] = True
    plan = ndimage.binary_fill_holes(ndimage.binary_dilation(plan))
    belongs: MaskArray = top | ((above < 0) & plan[cells[..., 0], cells[..., 1]])
    return belongs


def _far_sides(depth: Float32Array, step: float, ratio: float) -> MaskArray:
    """(H, W) bool: pixels that lie behind a neighbour by more than `step` + `ratio` of the nearer depth."""
    cut = np.zeros(depth.shape, dtype=np.bool_)
    for ahead, behind in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        jump = depth[ahead] - depth[behind]
        nearer = np.minimum(depth[ahead], depth[behind])
        limit = np.where(nearer > 0, np.float32(step) + np.float32(ratio) * nearer, np.float32(np.inf))
        cut[ahead] |= jump > limit
        cut[behind] |= jump < -limit
    return cut


def _window(xyxy: FloatArray, shape: tuple[int, ...], grow: float) -> tuple[slice, slice] | None:
    """Rows and columns of a box grown by that share of its size on each side; None outside the image."""
    x0, y0, x1, y1 = (float(value) for value in xyxy)
    more_x, more_y = grow * (x1 - x0), grow * (y1 - y0)
    rows = slice(max(0, int(np.floor(y0 - more_y))), min(shape[0], int(np.ceil(y1 + more_y))))
    columns = slice(max(0, int(np.floor(x0 - more_x))), min(shape[1], int(np.ceil(x1 + more_x))))
    return (rows, columns) if rows.start < rows.stop and columns.start < columns.stop else None


def _cut_out(scene: _Scene, window: tuple[slice, slice]) -> _Scene:
    return _Scene(
        scene.depth[window],
        scene.points[window],
        scene.valid[window],
        scene.up[window],
        scene.cut[window],
        scene.margin[window],
    )


def _middle(inside: MaskArray) -> FloatArray:
    """Weights (H, W) that sum to 1 over a rectangle, highest in its middle, 0 outside."""
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    weight = np.zeros(inside.shape)

    def bell(count: int) -> NDArray[np.float64]:
        place = (np.arange(count) + 0.5) / count - 0.5
        return np.exp(-0.5 * np.square(place / 0.25))

    weight[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] = np.outer(
        bell(len(rows)), bell(len(columns))
    )
    weight /= weight.sum()
    return weight


def _is_one_of(label: str, names: frozenset[str]) -> bool:
    plain = _plain(label)
    return plain in names or plain.rpartition(" ")[2] in names


def _plain(label: str) -> str:
    return " ".join(label.replace("_", " ").lower().split())


def _share_out(masks: list[MaskArray], ours: Sequence[bool]) -> None:
    """Take from each of our masks the pixels of those that are smaller; in place."""
    sizes = [int(np.count_nonzero(mask)) for mask in masks]
    taken = np.zeros_like(masks[0])
    for place in sorted(range(len(masks)), key=lambda place: (sizes[place], place)):
        whole = masks[place].copy()
        if ours[place]:
            masks[place] &= ~taken
        taken |= whole


@hookimpl
def register_segmenter(register: Register) -> None:
    """`depth`: connected depth inside a box."""
    register(
        "depth",
        lambda config, context: DepthSegmenter(
            config, (0.0, 0.0) if context.source is None else context.source.depth_noise_m
        ),
        config=Config,
    )
