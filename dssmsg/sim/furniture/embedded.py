"""Furniture made of primitives: the categories and sizes of the real pieces, from nothing but numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dssmsg.errors import InputError
from dssmsg.sim.mesh import Mesh, box, cylinder, from_triangles, merge, sphere

Color = Sequence[int]

GROWTH = 0.0006
"""Share of the size by which each part is larger than the one before: where two lie in one plane, the later
one is in front, instead of a pattern of rounding errors."""


def build(parts: Sequence[str], size: Sequence[float], tint: str, where: str) -> Mesh:
    """The mesh of `parts` stretched to `size` (x, y, z) metres, in the object frame.

    A part reads `shape x y z width depth height colour` in fractions of the size: x, y its middle, z its
    bottom. `tint` replaces the colour `@`. Raises InputError naming `where` for a part that does not read so.
    """
    return merge([_part(text, tint, where, i * GROWTH) for i, text in enumerate(parts)]).scaled_to(size)


def _part(text: str, tint: str, where: str, growth: float) -> Mesh:
    words = text.split()
    try:
        shape, color = words[0], words[7]
        x, y, z, width, depth, height = (float(word) for word in words[1:7])
        rgb = list(bytes.fromhex(tint if color == "@" else color))
        unit = _SHAPES[shape](rgb)
    except (IndexError, ValueError, KeyError):
        known = ", ".join(_SHAPES)
        raise InputError(
            f"cannot read the part {text!r}: expected 'shape x y z width depth height RRGGBB', "
            f"shape one of {known}",
            key=where,
        ) from None
    grown = np.diag([width + growth, depth + growth, height + growth, 1.0])
    return unit.transformed(grown).moved((x, y, z - growth / 2))


def _upright(mesh: Mesh, *, along: int) -> Mesh:
    """A primitive of unit size whose axis z is turned to `along` (0 = x, 1 = y), standing on the origin."""
    order = [2, 0, 1] if along == 0 else [1, 2, 0]
    turned = mesh.vertices[:, order]
    return (
        Mesh(turned, mesh.faces, mesh.face_colors)
        .moved((0, 0, -float(turned[:, 2].min())))
        .moved((-0.5, 0, 0) if along == 0 else (0, -0.5, 0))
    )


def _revolved(profile: Sequence[tuple[float, float]], color: Color, segments: int = 24) -> Mesh:
    """The surface of `profile` (radius, height) turned around z."""
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    rings = [
        np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(segments, h)]) for r, h in profile
    ]
    i = np.arange(segments)
    j = (i + 1) % segments
    faces = []
    for k in range(len(profile) - 1):
        a, b = k * segments, (k + 1) * segments
        faces += [np.column_stack([a + i, a + j, b + j]), np.column_stack([a + i, b + j, b + i])]
    return from_triangles(np.concatenate(rings), np.concatenate(faces), color)


_BOWL = (
    (0.0, 0.0),
    (0.25, 0.0),
    (0.42, 0.4),
    (0.5, 1.0),
    (0.45, 1.0),
    (0.36, 0.45),
    (0.2, 0.12),
    (0.0, 0.12),
)
_RING = ((0.5, 0.0), (0.5, 1.0), (0.41, 1.0), (0.41, 0.0), (0.5, 0.0))

_SHAPES: dict[str, Callable[[Color], Mesh]] = {
    "box": lambda color: box((1, 1, 1), color),
    "cylinder": lambda color: cylinder(0.5, 1, color),
    "cone": lambda color: cylinder(0.5, 1, color, top_radius=0.3),
    "cone2": lambda color: cylinder(0.36, 1, color, top_radius=0.5),
    "sphere": lambda color: sphere(0.5, color),
    "bowl": lambda color: _revolved(_BOWL, color),
    "disc": lambda color: _upright(cylinder(0.5, 1, color), along=1),
    "wheel": lambda color: _upright(_revolved(_RING, color), along=0),
}
