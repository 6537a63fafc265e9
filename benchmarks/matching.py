# ruff: noqa: E402  (threads must be set before numpy is imported)
"""Time of the exact matching (eq. 4-5), and against enumeration.

    python benchmarks/matching.py [--rounds 15] [--json]

One thread, medians of processor time, so that a busy machine does not matter. Two bounds:

- `large_secs`: a target of 20 nodes against the subgraphs of 500 viewpoints of 30 objects; at most 1 s.
- `enumeration_speedup`: 7 target nodes, 7 objects, all pairs allowed: scoring each of the 5,040 permutations
  one after the other, as the paper does, over our time; at least 50. `table_speedup` tells the same for
  enumeration at its best, one array operation over a table of permutations that is given. It has no bound:
  from 10 nodes on its table no longer fits.

Exit code 1 if a bound does not hold.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import sys
import time
from collections.abc import Callable
from statistics import median

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported: one thread

import numpy as np

from dssmsg.graph.matching import match_topology, node_score

MAX_LARGE_SECS = 1.0
MIN_SPEEDUP = 50.0
NODES = 7


def degrees(rng: np.random.Generator, count: int, share: float) -> np.ndarray:
    """Degrees (count,) of a random graph."""
    edges = np.triu(rng.random((count, count)) < share, 1)
    return (edges + edges.T).sum(axis=0).astype(np.int64)


def large_secs(seed: int) -> float:
    """Seconds for a 20-node target against 500 subgraphs of 30 objects, where a node may match a third."""
    rng = np.random.default_rng(seed)
    wanted = degrees(rng, 20, 0.2)
    views = [(degrees(rng, 30, 0.15), rng.random((20, 30)) < 1 / 3, rng.random((20, 30))) for _ in range(500)]
    start = time.process_time()
    scores = [
        node_score(similarity) + match_topology(wanted, offered, allowed, similarity).score
        for offered, allowed, similarity in views
    ]
    assert max(scores) <= 2.0
    return time.process_time() - start


def one_by_one(wanted: np.ndarray, offered: np.ndarray) -> float:
    """s_top by scoring every permutation in turn."""
    target, length = wanted.tolist(), math.sqrt(float(wanted @ wanted))
    best = 0.0
    for permutation in itertools.permutations(offered.tolist()):
        product = sum(a * b for a, b in zip(target, permutation, strict=True))
        norm = math.sqrt(sum(b * b for b in permutation))
        best = max(best, product / (length * norm) if norm else 0.0)
    return best


def by_table(wanted: np.ndarray, offered: np.ndarray, table: np.ndarray) -> float:
    """s_top by one array operation over all permutations (5040, 7)."""
    found = offered[table]
    lengths = np.sqrt((wanted @ wanted) * np.sum(found * found, axis=1))
    return float(np.max(found @ wanted / np.where(lengths > 0, lengths, 1)))


def timed(what: Callable[[], float], times: int) -> tuple[float, float]:
    """(seconds a call, what it returned)."""
    start = time.process_time()
    for _ in range(times):
        value = what()
    return (time.process_time() - start) / times, value


def small(rounds: int) -> tuple[float, float, float]:
    """Median seconds at 7 nodes: ours, one by one, by table; all three agree."""
    table = np.array(list(itertools.permutations(range(NODES))))
    allowed, similarity = np.ones((NODES, NODES), bool), np.zeros((NODES, NODES))
    found: list[tuple[float, float, float]] = []
    for seed in range(rounds):
        rng = np.random.default_rng(seed)
        wanted, offered = degrees(rng, NODES, 0.4), degrees(rng, NODES, 0.4)
        if not wanted.any() or not offered.any():
            continue
        ours, a = timed(lambda w=wanted, o=offered: match_topology(w, o, allowed, similarity).score, 20)  # type: ignore[misc]
        loop, b = timed(lambda w=wanted, o=offered: one_by_one(w, o), 1)  # type: ignore[misc]
        whole, c = timed(lambda w=wanted, o=offered: by_table(w, o, table), 3)  # type: ignore[misc]
        assert max(abs(a - b), abs(a - c)) < 1e-9, (seed, a, b, c)
        found.append((ours, loop, whole))
    return tuple(median(column) for column in zip(*found, strict=True))  # type: ignore[return-value]


def main() -> int:
    """Measure, print, and say by the exit code whether the bounds hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    large = median(large_secs(seed) for seed in range(max(3, options.rounds // 3)))
    ours, loop, whole = small(options.rounds)
    result = {
        "large_secs": large,
        "ours_7_ms": ours * 1e3,
        "enumeration_7_ms": loop * 1e3,
        "table_7_ms": whole * 1e3,
        "enumeration_speedup": loop / ours,
        "table_speedup": whole / ours,
    }
    print(json.dumps(result) if options.json else "\n".join(f"{k:<20} {v:.3f}" for k, v in result.items()))
    ok = large <= MAX_LARGE_SECS and loop / ours >= MIN_SPEEDUP
    if not ok:
        print("a bound does not hold", file=sys.stderr)
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
