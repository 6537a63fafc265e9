"""Crops to learn from: true masks as a mask network would draw them, and things that are no thing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dssmsg.recogniser.contract import CROP_EXTRA, CROP_FACTS, CROP_SIDE
from dssmsg.recogniser.crops import CropImages, cut
from dssmsg.recogniser.inputs import half_geometry
from dssmsg.recogniser.shelf import all_labels
from dssmsg.recogniser.views import CAMERA
from training.proposals import Proposals, load_proposals
from training.render import load, shards
from training.samples import Views, recoloured, repainted

MIN_PIXELS = 80
NOTHING_SHARE = 0.1
Sample = tuple[NDArray[np.float32], NDArray[np.float32], int]


class Crops:
    """Draws instances of all views, rarer labels more often than they occur."""

    def __init__(self, folder: Path, proposals: Path | None = None, wild: float = 0.0) -> None:
        """`proposals`: a folder of the stage of that name; half of the samples then come from there. `wild`:
        the share of samples in colours that their models do not have."""
        self._wild = wild
        self.views = Views(folder)
        self.nothing = len(all_labels())
        rows = []
        for view in range(len(self.views)):
            count = np.bincount(self.views.ids[view].ravel())
            for number in np.flatnonzero(count >= MIN_PIXELS):
                if number:
                    rows.append((view, int(number), int(self.views.label[view][number])))
        self.rows = np.array(rows)
        often = np.bincount(self.rows[:, 2], minlength=self.nothing)
        weight = 1 / np.sqrt(often[self.rows[:, 2]])
        self.weight = weight / weight.sum()
        self._proposals: list[tuple[int, Proposals, int]] = []
        self._chances = np.zeros(0)
        if proposals is not None:
            self._read(folder, proposals)

    def _read(self, folder: Path, proposals: Path) -> None:
        """Proposals as (number of the view, its shard's proposals, index there), nothings one in five."""
        first, weights = 0, []
        for path in shards(folder):
            part = load_proposals(proposals / path.name)
            for i in range(len(part.view)):
                self._proposals.append((first + int(part.view[i]), part, i))
                weights.append(int(part.label[i]))
            first += len(load(path).poses)
        labels = np.array(weights)
        often = np.bincount(labels, minlength=self.nothing + 1)
        chance = 1 / np.sqrt(often[labels])
        chance[labels == self.nothing] *= 0.25 * chance.sum() / chance[labels == self.nothing].sum()
        self._chances = chance / chance.sum()

    def batch(
        self, size: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
        """crops (B, 3 + E, S, S), facts (B, F), labels (B,); two crops of each view that is opened."""
        crops = np.empty((size, 3 + CROP_EXTRA, CROP_SIDE, CROP_SIDE), np.float32)
        facts = np.empty((size, CROP_FACTS), np.float32)
        labels = np.empty(size, np.int64)
        proposed = size // 2 if self._proposals else 0
        for i, row in enumerate(rng.choice(len(self.rows), size - proposed, p=self.weight)):
            crops[i], facts[i], labels[i] = self._true(*(int(v) for v in self.rows[row]), rng)
        if proposed:
            chosen = rng.choice(len(self._proposals), proposed, p=self._chances)
            for i, row in enumerate(chosen, start=size - proposed):
                view, part, index = self._proposals[row]
                label = int(part.label[index])
                crops[i], facts[i], labels[i] = self._sample(view, part.mask(index), label, rng)
        return crops, facts, labels

    def _true(self, view: int, number: int, label: int, rng: np.random.Generator) -> Sample:
        ids = self.views.ids[view]
        if rng.random() < NOTHING_SHARE:
            return self._sample(view, nothing_mask(ids, number, rng), self.nothing, rng)
        return self._sample(view, drawn_mask(ids, number, rng), label, rng)

    def _sample(self, view: int, mask: NDArray[np.bool_], label: int, rng: np.random.Generator) -> Sample:
        rgb = recoloured(self.views.rgb[view], rng)
        if rng.random() < self._wild:
            rgb = repainted(rgb, rng)
        depth = self.views.depth_mm[view].astype(np.float32) / np.float32(1000)
        images = CropImages.of(rgb, half_geometry(depth, CAMERA, self.views.poses[view], 0.0))
        crops, facts = cut(images, [mask])
        crop, numbers = crops[0], facts[0]
        if rng.random() < 0.5:
            crop = crop[:, :, ::-1]
            numbers[[8, 10]] = numbers[[10, 8]]
        # Scenes stretch pieces, and depth is noisy: sizes are a hint, not a key.
        numbers[:3] *= rng.normal(1, 0.08, 3)
        if rng.random() < 0.1:
            numbers[:] = 0
        return crop, numbers, label


def drawn_mask(ids: NDArray[np.uint8], number: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """The instance's mask, often with a rim that is off, sometimes with a part cut off or grown over."""
    mask = ids == number
    whole = int(mask.sum())
    draw = rng.random()
    if draw < 0.35:
        return mask
    if draw < 0.55:
        mask = ndimage.binary_dilation(mask, iterations=int(rng.integers(1, 4)))
    elif draw < 0.7:
        mask = ndimage.binary_erosion(mask, iterations=int(rng.integers(1, 3)))
    elif draw < 0.9:  # a straight cut keeps 50 % to 95 %
        v, u = np.nonzero(mask)
        angle = rng.uniform(0, 2 * np.pi)
        along = u * np.cos(angle) + v * np.sin(angle)
        mask = mask.copy()
        limit = np.quantile(along, rng.uniform(0.5, 0.95))
        mask[v[along > limit], u[along > limit]] = False
    else:  # a neighbour is taken in as far as it makes up to a third
        grown = ndimage.binary_dilation(mask, iterations=int(rng.integers(4, 12))) & (ids > 0)
        mask = mask | grown if grown.sum() < 1.5 * whole else mask
    return mask if mask.sum() >= 40 else ids == number


def nothing_mask(ids: NDArray[np.uint8], number: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """A piece of wall or floor, or several things as one."""
    height, width = ids.shape
    room = ids == 0
    if rng.random() < 0.65 and room.sum() > 2000:
        v, u = np.nonzero(room)
        at = int(rng.integers(len(v)))
        reach_v, reach_u = rng.integers(6, 90, 2)
        mask = np.zeros(ids.shape, np.bool_)
        mask[max(v[at] - reach_v, 0) : v[at] + reach_v, max(u[at] - reach_u, 0) : u[at] + reach_u] = True
        mask &= room
        if mask.sum() >= 60:
            return mask
    counts = np.bincount(ids.ravel())
    counts[[0, number]] = 0
    first = ids == number
    other = ids == int(np.argmax(counts))
    share = rng.uniform(0.5, 2.0)
    mask = first | other if 0.4 * share < counts.max() / max(first.sum(), 1) < 3 else None
    if mask is None or counts.max() == 0:
        mask = np.zeros(ids.shape, np.bool_)
        top, left = int(rng.integers(height - 60)), int(rng.integers(width - 60))
        mask[top : top + 60, left : left + 60] = True
    return mask
