"""How two things stand to each other in space: the `relation` of a `near` edge (ALGORITHM A.4).

Told from boxes and clouds of *visible surfaces*, so nothing here relies on closed or complete shapes. The
rules, first match wins, "a <relation> b":

    in        most of a's box lies in b's, and b encloses it: walls on all four sides (a basin), or a
              surface above and on two sides (a shelf); an armchair with its three does not
    on        a starts higher up and rests on b: b's surface under a's rim is level with a's bottom
    above     a's bottom is over b's top
    next to   none of these

`contains`, `under` and `below` are the same three told from the other thing. Exactly one word holds, and
`relation(b, a) == inverse(relation(a, b))`. `on` and `above` need floor plans that overlap.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dssmsg.frame import Float32Array, FloatArray, MaskArray

ON, UNDER, IN, CONTAINS, ABOVE, BELOW, NEXT_TO = "on", "under", "in", "contains", "above", "below", "next to"
_INVERSE = {ON: UNDER, UNDER: ON, IN: CONTAINS, CONTAINS: IN, ABOVE: BELOW, BELOW: ABOVE, NEXT_TO: NEXT_TO}

CONTACT_M = 0.05
"""How far apart two touching surfaces may be measured: two voxels, which covers the sensor's noise."""
WALL_M = 0.3
"""How far from a thing a surface may be to count as enclosing it."""
MIN_OVERLAP = 0.3
"""Share of the smaller floor plan that must be shared to be on or above something."""
MIN_CONTAINED = 0.8
"""Share of a box's volume that must lie in another to be in it."""


class Shape(Protocol):
    """What relations are told from; an `ObjectNode` is one."""

    @property
    def box_min(self) -> FloatArray:
        """Lower corner (3,) in world metres."""
        ...

    @property
    def box_max(self) -> FloatArray:
        """Upper corner (3,) in world metres."""
        ...

    @property
    def points(self) -> Float32Array:
        """Visible surface points (N, 3) in world metres."""
        ...


def inverse(word: str) -> str:
    """The same relation told from the other thing; a word that is not one of ours stays as it is."""
    return _INVERSE.get(word, word)


def gap(a_min: FloatArray, a_max: FloatArray, b_min: FloatArray, b_max: FloatArray) -> float:
    """Distance in metres between two axis-aligned boxes, corners (3,); 0 where they touch."""
    apart = np.maximum(0.0, np.maximum(a_min - b_max, b_min - a_max))
    return float(np.sqrt(np.sum(apart * apart)))


def relation(a: Shape, b: Shape) -> str:
    """The word that makes "a <word> b" true.

    Which of the two can be inside and which can be on top is settled first, by size and by height, so the
    answer does not depend on the order of the arguments but for its direction.
    """
    shared = _shared(a, b)
    if not (shared[:2] > 0).all():
        return NEXT_TO
    size_a, size_b = _volume(a), _volume(b)
    if size_a != size_b:
        inner, outer = (a, b) if size_a < size_b else (b, a)
        if shared.prod() >= MIN_CONTAINED * min(size_a, size_b) and _encloses(outer, inner):
            return IN if inner is a else CONTAINS
    height_a, height_b = ((float(shape.box_min[2]), float(shape.box_max[2])) for shape in (a, b))
    plan = min(float(np.prod(_extent(shape)[:2])) for shape in (a, b))
    if height_a == height_b or shared[:2].prod() < MIN_OVERLAP * plan:
        return NEXT_TO
    upper, lower = (a, b) if height_a > height_b else (b, a)
    word = _over(upper, lower)
    return word if upper is a else inverse(word)


def _over(upper: Shape, lower: Shape) -> str:
    bottom = float(upper.box_min[2])
    if bottom > lower.box_max[2] + CONTACT_M:
        return ABOVE
    height = lower.points[_over_plan(lower, upper, CONTACT_M), 2] - bottom
    level = int(np.count_nonzero(np.abs(height) <= CONTACT_M))
    rising = int(np.count_nonzero(height > CONTACT_M))  # where `lower` goes on past it, it carries nothing
    return ON if level > 0 and 2 * level >= rising else NEXT_TO


def _encloses(outer: Shape, inner: Shape) -> bool:
    # A wall rises over what the thing stands on: a table's top beside a phone is not one.
    rise = outer.points[:, 2] - inner.box_min[2]
    height = max(float(inner.box_max[2] - inner.box_min[2]), 2 * CONTACT_M)
    wall = (rise > CONTACT_M) & (rise <= height)
    sides = 0
    for axis in (0, 1):
        other = outer.points[:, 1 - axis]
        level = (other >= inner.box_min[1 - axis]) & (other <= inner.box_max[1 - axis])
        beside = outer.points[wall & level, axis]
        for distance in (inner.box_min[axis] - beside, beside - inner.box_max[axis]):
            sides += bool(((distance >= -CONTACT_M) & (distance <= WALL_M)).any())
    over = outer.points[_over_plan(outer, inner, 0.0), 2] - inner.box_max[2]
    roof = bool(((over >= -CONTACT_M) & (over <= WALL_M)).any())
    return sides == 4 or (roof and sides >= 2)


def _over_plan(points_of: Shape, plan_of: Shape, margin: float) -> MaskArray:
    """(N,) bool: points over or under the other's floor plan, grown by a margin."""
    points = points_of.points[:, :2]
    low, high = plan_of.box_min[:2] - margin, plan_of.box_max[:2] + margin
    inside: MaskArray = np.all((points >= low) & (points <= high), axis=1)
    return inside


def _extent(shape: Shape) -> FloatArray:
    """Box sizes (3,), grown by the contact tolerance: a rug or a mirror has no thickness otherwise."""
    extent: FloatArray = shape.box_max - shape.box_min + CONTACT_M
    return extent


def _volume(shape: Shape) -> float:
    return float(np.prod(_extent(shape)))


def _shared(a: Shape, b: Shape) -> FloatArray:
    """Sizes (3,) of the part that both grown boxes have in common; 0 along axes where they are apart."""
    overlap = np.minimum(a.box_max, b.box_max) - np.maximum(a.box_min, b.box_min) + CONTACT_M
    return np.maximum(overlap, 0.0)
