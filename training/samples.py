"""Views in memory, and what the mask network shall say of them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dssmsg.recogniser.contract import OFFSET_PX
from dssmsg.recogniser.inputs import geometry_channels, half_geometry, normalised_rgb
from dssmsg.recogniser.views import CAMERA
from training.render import load, shards


class Views:
    """All views of the shards in memory; gives augmented samples."""

    def __init__(self, folder: Path, seeds: int = 10**6) -> None:
        """The shards of `folder` of seeds below `seeds`."""
        paths = [path for path in shards(folder) if int(path.stem) < seeds]
        parts = [load(path) for path in paths]
        self.rgb = np.concatenate([part.rgb for part in parts])
        self.depth_mm = np.concatenate([part.depth_mm for part in parts])
        self.ids = np.concatenate([part.ids for part in parts])
        self.poses = np.concatenate([part.poses for part in parts])
        self.seeds = np.repeat([int(path.stem) for path in paths], [len(part.rgb) for part in parts])
        self.label = [part.label for part in parts for _ in part.rgb]

    def __len__(self) -> int:
        return len(self.rgb)

    def sample(self, index: int, rng: np.random.Generator) -> tuple[NDArray[np.float32], ...]:
        """rgb (3, H, W), geometry (G, h, w), targets; mirrored and recoloured by chance."""
        rgb = recoloured(self.rgb[index], rng)
        depth = self.depth_mm[index].astype(np.float32) / np.float32(1000)
        geometry = geometry_channels(half_geometry(depth, CAMERA, self.poses[index], 0.0))
        ids = self.ids[index, ::2, ::2]
        image = normalised_rgb(rgb)
        if rng.random() < 0.5:
            image, geometry, ids = image[:, :, ::-1].copy(), geometry[:, :, ::-1].copy(), ids[:, ::-1].copy()
            geometry[2] *= -1  # the normal's component to the right
        return (image, geometry, *targets(ids, self.label[index]))


def recoloured(rgb: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Brightness, contrast and colour balance changed a little."""
    gain = rng.normal(1.0, 0.15) * rng.normal(1.0, 0.06, 3)
    image = (rgb.astype(np.float32) - 128) * np.float32(rng.normal(1, 0.12)) + 128
    return np.clip(image * gain.astype(np.float32), 0, 255).astype(np.uint8)


def repainted(rgb: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Other colours altogether: channels exchanged, some turned round, so that shape must tell."""
    image = rgb[..., rng.permutation(3)]
    if rng.random() < 0.3:
        image = np.repeat(image.mean(axis=2, keepdims=True).astype(np.uint8), 3, axis=2)
    turned = rng.random(3) < 0.15
    return np.where(turned, 255 - image, image).astype(np.uint8)


def targets(ids: NDArray[np.uint8], label: NDArray[np.int16]) -> tuple[NDArray[np.float32], ...]:
    """From ids (h, w) at half size: thing, heat, border, offset (2, h, w), weight, class (h/2, w/2)."""
    height, width = ids.shape
    thing = (ids > 0).astype(np.float32)
    heat = np.zeros(ids.shape, np.float32)
    count = np.bincount(ids.ravel(), minlength=len(label)).astype(np.float64)
    v, u = np.mgrid[:height, :width].astype(np.float32)
    centre_u = np.bincount(ids.ravel(), u.ravel(), minlength=len(count)) / np.maximum(count, 1)
    centre_v = np.bincount(ids.ravel(), v.ravel(), minlength=len(count)) / np.maximum(count, 1)
    for number in np.flatnonzero(count[1:] >= 12) + 1:
        sigma = float(np.clip(0.12 * math.sqrt(count[number]), 1.2, 6.0))
        bump = np.exp(-((u - centre_u[number]) ** 2 + (v - centre_v[number]) ** 2) / (2 * sigma * sigma))
        heat = np.maximum(heat, bump.astype(np.float32))
    offset = np.stack([centre_u[ids] - u, centre_v[ids] - v]).astype(np.float32) / np.float32(OFFSET_PX)
    weight = np.clip(np.sqrt(400 / np.maximum(count, 1)), 0.3, 3.0).astype(np.float32)[ids] * thing
    border = np.zeros(ids.shape, np.float32)
    border[:, 1:] += ids[:, 1:] != ids[:, :-1]
    border[:, :-1] += ids[:, 1:] != ids[:, :-1]
    border[1:] += ids[1:] != ids[:-1]
    border[:-1] += ids[1:] != ids[:-1]
    classes = np.where(ids[::2, ::2] > 0, label[ids[::2, ::2]], -1).astype(np.float32)
    return thing, heat, np.minimum(border, 1), offset, weight, classes
