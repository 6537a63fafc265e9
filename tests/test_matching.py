"""Exact matching of eq. 3-5, held against enumeration."""

from __future__ import annotations

import functools
import itertools
import math

import numpy as np
import pytest

from dssmsg.graph.matching import match_topology, node_score


@functools.cache
def permutations(count):
    return np.array(list(itertools.permutations(range(count))))


def enumerate_matchings(allowed):
    """Every one-to-one matching of the largest size: (M, T) columns, -1 for unmatched.

    Each is what a permutation of the padded table leaves of its allowed pairs.
    """
    targets, objects = allowed.shape
    size = max(targets, objects)
    padded = np.zeros((size, size), bool)
    padded[:targets, :objects] = allowed
    every = permutations(size)[:, :targets]
    every = np.where(padded[np.arange(targets), every], every, -1)
    used = np.count_nonzero(every >= 0, axis=1)
    return every[used == used.max()]


def gathered(values, columns):
    """values[..., column] of every matched target node, 0 for the others."""
    rows = np.arange(columns.shape[1])
    found = values[columns] if values.ndim == 1 else values[rows, columns]
    return np.where(columns >= 0, found, 0)


def cosines(wanted, offered, columns):
    found = gathered(offered, columns)
    lengths = (wanted @ wanted) * np.sum(found * found, axis=1)
    return np.divide(found @ wanted, np.sqrt(lengths), out=np.zeros(len(found)), where=lengths > 0)


def graph_degrees(rng, count):
    edges = np.triu(rng.random((count, count)) < rng.uniform(0, 1), 1)
    return (edges + edges.T).sum(axis=0).astype(np.int64)


def random_case(seed):
    rng = np.random.default_rng(seed)
    targets, objects = rng.integers(1, 8, 2)
    allowed = rng.random((targets, objects)) < rng.uniform(0.2, 1)
    similarity = np.round(rng.random((targets, objects)), 2)
    return graph_degrees(rng, targets), graph_degrees(rng, objects), allowed, similarity


@pytest.mark.parametrize("block", range(4))
def test_the_optimum_equals_enumeration(block):
    for seed in range(block * 600, (block + 1) * 600):
        wanted, offered, allowed, similarity = random_case(seed)
        made = match_topology(wanted, offered, allowed, similarity)
        every = enumerate_matchings(allowed)
        if wanted.any():
            scores = cosines(wanted, offered, every)
            expected, best = scores.max(), every[scores > scores.max() - 1e-9]
        else:
            expected, best = np.count_nonzero(every[0] >= 0) / len(wanted), every
        assert made.score == pytest.approx(expected, abs=1e-12), seed
        assert made.similarity == pytest.approx(gathered(similarity, best).sum(axis=1).max(), abs=1e-5), seed
        used = made.columns[made.columns >= 0]
        assert len(set(used)) == len(used)
        assert all(allowed[i, j] for i, j in enumerate(made.columns) if j >= 0)


def test_where_a_local_search_gets_stuck_the_optimum_is_found():
    """Matchings that are best again at their own scale, but not best of all."""
    found = 0
    for seed in range(300):
        wanted, offered, allowed, similarity = random_case(seed)
        if not wanted.any():
            continue
        every = enumerate_matchings(allowed)
        degrees_found = gathered(offered, every)
        degrees_found = np.unique(degrees_found[degrees_found.any(axis=1)], axis=0)
        if not len(degrees_found):
            continue
        a, b = degrees_found @ wanted, np.sum(degrees_found**2, axis=1)
        t = a / b
        errors = -2 * np.outer(t, a) + np.outer(t * t, b)  # row: scale, column: matching
        stuck = np.diag(errors) <= errors.min(axis=1) + 1e-9
        scores = a / np.sqrt(b * (wanted @ wanted))
        if scores[stuck].min() < scores.max() - 1e-9:
            found += 1
            assert match_topology(wanted, offered, allowed, similarity).score == pytest.approx(scores.max())
    assert found > 5


def test_node_score_is_the_mean_of_best_cosines():
    assert node_score(np.array([[0.2, 0.9], [0.5, 0.1]])) == pytest.approx(0.7)
    assert node_score(np.zeros((2, 0))) == 0.0


def degrees(*values):
    return np.array(values, dtype=np.int64)


def test_a_target_without_edges_scores_the_share_of_matched_nodes():
    allowed = np.array([[True, False], [False, False]])
    made = match_topology(degrees(0, 0), degrees(3, 1), allowed, np.ones((2, 2)))
    assert made.score == 0.5
    assert made.columns.tolist() == [0, -1]


def test_a_candidate_without_edges_scores_nothing_but_is_matched_by_similarity():
    similarity = np.array([[0.5, 0.9], [0.8, 0.7]])
    made = match_topology(degrees(1, 1), degrees(0, 0), np.ones((2, 2), bool), similarity)
    assert made.score == 0.0
    assert made.columns.tolist() == [1, 0]


def test_nothing_allowed_matches_nothing():
    made = match_topology(degrees(1, 1), degrees(1, 1), np.zeros((2, 2), bool), np.ones((2, 2)))
    assert (made.score, made.columns.tolist()) == (0.0, [-1, -1])
    assert match_topology(degrees(1), degrees(), np.zeros((1, 0), bool), np.zeros((1, 0))).score == 0.0


def test_one_match_of_three_does_not_beat_three_of_three():
    """Degree 0 for an unmatched node keeps it in the vector; dropping it would give a perfect cosine."""
    wanted = degrees(2, 1, 1)
    one = np.zeros((3, 3), bool)
    one[0, 0] = True
    all_three = np.eye(3, dtype=bool)
    offered = degrees(2, 2, 1)
    alone = match_topology(wanted, offered, one, np.ones((3, 3)))
    complete = match_topology(wanted, offered, all_three, np.ones((3, 3)))
    assert alone.score == pytest.approx(2 / math.sqrt(6))
    assert complete.score > alone.score
    assert match_topology(wanted, offered, one, np.ones((3, 3)), unmatched="drop").score == pytest.approx(1)


def test_equal_scores_go_to_the_larger_similarity():
    similarity = np.array([[0.7, 0.8, 0.9]])
    made = match_topology(degrees(1), degrees(2, 2, 4), np.ones((1, 3), bool), similarity)
    assert made.score == pytest.approx(1.0)
    assert made.columns.tolist() == [2]  # one node alone has the same direction at any degree


def test_large_degrees_stay_exact():
    rng = np.random.default_rng(3)
    wanted, offered = rng.integers(1, 300, 60), rng.integers(1, 300, 80)
    made = match_topology(wanted, offered, np.ones((60, 80), bool), rng.random((60, 80)))
    assert 0.99 < made.score <= 1.0
