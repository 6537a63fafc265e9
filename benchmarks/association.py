# ruff: noqa: E402  (threads must be set before numpy is imported)
"""Time of the `dssm` association a frame: how it grows with the map, and against exhaustive scoring.

    python benchmarks/association.py [--rounds 15] [--json]

Fixed room-like detections: 12 a frame, about 2,000 points each (the visible faces of boxes, voxelised at
0.025 m, with sensor noise), the same ones in view whatever the size of the map around them. One
thread, measurements interleaved, medians. Two comparisons, as CI wants them:

- `map_growth`: time a frame (association and graph update) with 2,000 objects in the map over that with 100;
  at most 1.5.
- `brute_speedup`: at 50 objects, scoring every pair by exhaustive nearest neighbours over our frame time;
  at least 10. Two exhaustive forms are timed, the faster counts: a KD-tree query of all points for each
  pair with the trees given, and a matrix product of all distances.

Exit code 1 if a bound does not hold.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported: one thread

import numpy as np
from dssmsg_plugins.association.dssm import DssmAssociation, DssmConfig
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dssmsg.frame import Camera, Frame, Observation, quantise_depth
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.interfaces import Context, SourceInfo
from dssmsg.lift import voxelise

MAX_GROWTH = 1.5
MIN_SPEEDUP = 10.0
IN_VIEW = 12
NOISE = (0.001, 0.002)
LABELS = 40
CAMERA = Camera.from_fov(320, 240, np.deg2rad(69.4))


def unit(rng: np.random.Generator) -> NDArray[np.float32]:
    """A random unit vector (384,)."""
    vector = rng.standard_normal(384)
    return (vector / np.linalg.norm(vector)).astype(np.float32)


def surface(center: NDArray[np.float64], rng: np.random.Generator, seed: int) -> NDArray[np.float32]:
    """About 2,000 voxel points of three faces of a box of 0.7 m at `center`, as one camera sees it."""
    faces = np.random.default_rng(seed)  # the same box for all its observations
    size = faces.uniform(0.48, 0.66, 3)
    samples = np.random.default_rng(seed + 1).uniform(-0.5, 0.5, (12_000, 3))
    side = np.arange(len(samples)) % 3
    samples[np.arange(len(samples)), side] = 0.5
    points = center + samples * size + rng.normal(0.0, 0.003, samples.shape)
    return voxelise(points, np.zeros((len(points), 3), np.uint8), 0.025)[0].astype(np.float32)


def observation(
    index: int, place: NDArray[np.float64], rng: np.random.Generator, features: Sequence[NDArray[np.float32]]
) -> Observation:
    """Object number `index` seen once more."""
    points = surface(place, rng, seed=1000 + index)
    return Observation(
        detection_index=index % IN_VIEW,
        label=f"label {index % LABELS}",
        score=0.9,
        points_world=points,
        colors=np.zeros((len(points), 3), np.uint8),
        box_min=points.min(axis=0).astype(np.float64),
        box_max=points.max(axis=0).astype(np.float64),
        range_m=2.5,
        text_feature=features[index % LABELS],
    )


def places(count: int) -> NDArray[np.float64]:
    """(count, 3) centres on a dense grid: the 12 in view side by side, the rest of the home around them."""
    side = int(np.ceil(np.sqrt(count)))
    grid = np.array([(x, y) for x in range(side + 1) for y in range(side + 1)], dtype=np.float64)
    order = np.argsort(np.abs(grid).max(axis=1), kind="stable")[
        :count
    ]  # nearest the origin first: always the same
    return np.concatenate([grid[order] * 0.6, np.full((count, 1), 0.4)], axis=1)


class Bench:
    """A map of `count` objects and the fixed frames in which the first 12 are seen again."""

    def __init__(self, count: int, frames: int) -> None:
        rng = np.random.default_rng(count)
        features = [unit(np.random.default_rng(label)) for label in range(LABELS)]
        self.graph = SceneGraph()
        info = SourceInfo("bench", CAMERA, drivable=False, has_truth=False, depth_noise_m=NOISE)
        context = Context(
            seed=0,
            rng=rng,
            graph=self.graph,
            ids=IdAllocator(),
            log=logging.getLogger("bench"),
            base_dir=Path(),
            run_dir=Path(),
            run_id="bench",
            build=lambda kind, slot: None,
            source=info,
        )
        self.plugin = DssmAssociation(DssmConfig(merge_every=10**6), context)
        where = places(count)
        for first in range(0, count, IN_VIEW):
            batch = [
                observation(i, where[i], rng, features) for i in range(first, min(first + IN_VIEW, count))
            ]
            self.feed(first, batch)
        seen = np.random.default_rng(7)
        self.frames = [
            [observation(i, where[i], seen, features) for i in range(IN_VIEW)] for _ in range(frames)
        ]
        self.next = 10**6
        if len(self.graph.objects) != count:
            raise SystemExit(f"expected a map of {count} objects, got {len(self.graph.objects)}")

    def feed(self, index: int, observations: Sequence[Observation]) -> tuple[float, float]:
        """Seconds of the association and of the graph update of one frame."""
        size = (CAMERA.height, CAMERA.width)
        frame = Frame(
            index,
            index * 0.2,
            np.zeros((*size, 3), np.uint8),
            quantise_depth(np.zeros(size)),  # no readings: the observations speak
            CAMERA,
            np.eye(4),
            np.eye(4),
        )
        start = time.perf_counter()
        changes = self.plugin.associate(frame, observations, None)
        middle = time.perf_counter()
        self.graph.apply_all(changes, index, index * 0.2)
        return middle - start, time.perf_counter() - middle

    def step(self, number: int) -> tuple[float, float]:
        """One measured frame."""
        self.next += 1
        return self.feed(self.next, self.frames[number % len(self.frames)])

    def clouds(self) -> list[NDArray[np.float32]]:
        """The points of every object in the map."""
        return [node.points for node in self.graph.objects.values()]


def brute_trees(observations: Sequence[Observation], trees: Sequence[KDTree]) -> float:
    """Seconds to score every pair by the nearest neighbour of every point, the trees given."""
    start = time.perf_counter()
    for item in observations:
        for tree in trees:
            np.count_nonzero(tree.query(item.points_world)[0] <= 0.05)
    return time.perf_counter() - start


def brute_matrix(observations: Sequence[Observation], clouds: Sequence[NDArray[np.float32]]) -> float:
    """Seconds to score every pair from all squared distances, by float32 matrix products."""
    start = time.perf_counter()
    squares = [np.einsum("ij,ij->i", cloud, cloud) for cloud in clouds]
    for item in observations:
        points = item.points_world
        own = np.einsum("ij,ij->i", points, points)
        for cloud, square in zip(clouds, squares, strict=True):
            distances = points @ cloud.T
            distances *= -2.0
            distances += square
            np.count_nonzero(distances.min(axis=1) + own <= 0.05**2)
    return time.perf_counter() - start


def measure(rounds: int) -> dict[str, float]:
    """All figures, in milliseconds where not a ratio."""
    benches = {count: Bench(count, frames=8) for count in (50, 100, 2000)}
    for bench in benches.values():
        for number in range(8):  # every frame once: no new voxels afterwards, as in a map that is complete
            bench.step(number)
    times: dict[int, list[tuple[float, float]]] = {count: [] for count in benches}
    tree_times, matrix_times = [], []
    small = benches[50]
    for number in range(rounds):
        for count, bench in benches.items():
            times[count].append(bench.step(number))
        if number % 5 == 0:  # seconds each: fewer of these, between the others
            trees = [KDTree(cloud) for cloud in small.clouds()]
            tree_times.append(brute_trees(small.frames[0], trees))
            matrix_times.append(brute_matrix(small.frames[0], small.clouds()))

    def median(pick: Callable[[tuple[float, float]], float], count: int) -> float:
        return float(np.median([pick(pair) for pair in times[count]])) * 1e3

    result = {f"associate_ms@{count}": median(lambda pair: pair[0], count) for count in benches}
    result |= {f"frame_ms@{count}": median(sum, count) for count in benches}
    result["brute_trees_ms@50"] = float(np.median(tree_times)) * 1e3
    result["brute_matrix_ms@50"] = float(np.median(matrix_times)) * 1e3
    result["points_a_detection"] = float(np.mean([len(item.points_world) for item in small.frames[0]]))
    result["map_growth"] = result["frame_ms@2000"] / result["frame_ms@100"]
    fastest = min(result["brute_trees_ms@50"], result["brute_matrix_ms@50"])
    result["brute_speedup"] = fastest / result["frame_ms@50"]
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and say by the exit code whether the bounds hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15, help="measured frames a map size")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(arguments)
    result = measure(max(1, options.rounds))
    holds = result["map_growth"] <= MAX_GROWTH and result["brute_speedup"] >= MIN_SPEEDUP
    if options.json:
        print(json.dumps({**{name: round(value, 3) for name, value in result.items()}, "holds": holds}))
    else:
        for name, value in result.items():
            print(f"{name:24} {value:10.2f}")
        print(
            f"map_growth <= {MAX_GROWTH} and brute_speedup >= {MIN_SPEEDUP}: {'holds' if holds else 'FAILS'}"
        )
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
