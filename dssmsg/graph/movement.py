"""Did the thing that vanished here turn up there? Eq. 1-2 of the paper (III-A), ALGORITHM B.

s_move = (s_rgb + delta_sem * s_v + (s_sem - delta_sem)) / 2
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from dssmsg.frame import FloatArray
from dssmsg.graph.colors import color_similarity
from dssmsg.graph.nodes import ObjectNode
from dssmsg.graph.scoring import semantic_similarity

_MIN_EXTENT = 0.05
"""Metres: two voxels. Thinner than that an extent says how noisy depth is, not how large the thing is."""


@dataclass(frozen=True, slots=True)
class MoveScore:
    """s_move 0..1 with its terms."""

    s_rgb: float
    s_sem: float
    s_v: float
    s_move: float


def move_score(
    old: ObjectNode, new: ObjectNode, delta_sem: float, *, gain: float = 1.0, paper_exact: bool = False
) -> MoveScore:
    """How well a new object fits one that vanished; `gain` brings the new one's light to that of the old.

    s_sem is the cosine of the text features (1 for equal labels where there are none).
    """
    s_rgb = color_similarity(old.colors, new.colors, gain)
    s_sem = 2.0 * semantic_similarity(old.label, old.text_feature, new.label, new.text_feature) - 1.0
    s_v = volume_ratio(old, new) if paper_exact else size_similarity(old, new)
    return MoveScore(s_rgb, s_sem, s_v, (s_rgb + delta_sem * s_v + (s_sem - delta_sem)) / 2.0)


def volume_ratio(a: ObjectNode, b: ObjectNode) -> float:
    """s_v of the paper: min / max of the boxes' volumes, 0..1."""
    volumes = sorted(float(np.prod(extents(node))) for node in (a, b))
    return volumes[0] / volumes[1]


def size_similarity(a: ObjectNode, b: ObjectNode) -> float:
    """s_v for partial views: the geometric mean over axes of min / max of the extents, 0..1.

    It is the cube root of the ratio of volumes where both are seen whole. A side that was not seen shortens
    one extent, and so costs a third of what it costs the volume. A turned box has its horizontal extents in
    another order: they are compared sorted.
    """
    sides = []
    for node in (a, b):
        x, y, z = extents(node)
        sides.append((*sorted((float(x), float(y))), float(z)))
    ratios = [min(p, q) / max(p, q) for p, q in zip(*sides, strict=True)]
    return float(np.cbrt(np.prod(ratios)))


def extents(node: ObjectNode) -> FloatArray:
    """The box's extents (3,) in metres, none below two voxels."""
    size: FloatArray = np.maximum(node.box_max - node.box_min, _MIN_EXTENT)
    return size


def pair_moves(
    scores: Mapping[tuple[str, str], MoveScore], threshold: float, order: Sequence[str]
) -> list[tuple[str, str]]:
    """One-to-one pairs (old, new) with the largest summed s_move, each at least `threshold`; by old id.

    `order` ranks the ids, so that ties fall alike in every run.
    """
    rank = {object_id: place for place, object_id in enumerate(order)}
    fitting = {pair: score.s_move for pair, score in scores.items() if score.s_move >= threshold}
    olds = sorted({old for old, _ in fitting}, key=rank.__getitem__)
    news = sorted({new for _, new in fitting}, key=rank.__getitem__)
    gain = np.zeros((len(olds), len(news)))
    for (old, new), value in fitting.items():
        gain[olds.index(old), news.index(new)] = value
    rows, columns = linear_sum_assignment(gain, maximize=True)
    return [(olds[r], news[c]) for r, c in zip(rows, columns, strict=True) if gain[r, c] > 0.0]
