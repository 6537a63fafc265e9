"""Triangle meshes with flat colours and textures: what the camera renders.

Object frame: x = width, y = depth, z = height (up), metres; the front faces -y; the origin is the centre
of the footprint at the bottom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import ByteArray, Float32Array, FloatArray, IntArray, frozen_array

MAX_TURNS = 100_000
"""Texture coordinates beyond this are damaged data, and would not fit the renderer's 32-bit texel places."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """An immutable triangle mesh.

    vertices (V, 3) float32 metres; faces (F, 3) int32 into them; face_colors (F, 3) uint8 sRGB;
    uv (F, 3, 2) float32, one pair a corner, origin at the image's lower left, wrapping around; None when
    nothing is textured; face_texture (F,) int32 into `textures`, -1 = flat colour; textures are (H, W, 3)
    uint8 sRGB images. Raises ValueError when the arrays disagree.
    """

    vertices: Float32Array
    faces: IntArray
    face_colors: ByteArray
    uv: Float32Array | None = None
    face_texture: IntArray = field(default_factory=lambda: np.empty(0, np.int32))
    textures: tuple[ByteArray, ...] = ()

    def __post_init__(self) -> None:
        fix = object.__setattr__
        fix(self, "vertices", frozen_array("vertices", self.vertices, np.float32, (None, 3), finite=True))
        fix(self, "faces", frozen_array("faces", self.faces, np.int32, (None, 3)))
        count = len(self.faces)
        fix(self, "face_colors", frozen_array("face_colors", self.face_colors, np.uint8, (count, 3)))
        if self.uv is None:
            fix(self, "face_texture", frozen_array("face_texture", np.full(count, -1), np.int32, (count,)))
            if self.textures:
                raise ValueError("textures: given without uv")
        else:
            fix(self, "uv", frozen_array("uv", self.uv, np.float32, (count, 3, 2), finite=True))
            fix(self, "face_texture", frozen_array("face_texture", self.face_texture, np.int32, (count,)))
            if count and float(np.abs(self.uv).max()) > MAX_TURNS:
                raise ValueError(f"uv: a texture wraps around more than {MAX_TURNS:,} times")
        images = tuple(
            frozen_array(f"textures[{i}]", image, np.uint8, (None, None, 3))
            for i, image in enumerate(self.textures)
        )
        fix(self, "textures", images)
        if count and not (int(self.faces.min()) >= 0 and int(self.faces.max()) < len(self.vertices)):
            raise ValueError(f"faces: an index is outside the {len(self.vertices)} vertices")
        if count and int(self.face_texture.max()) >= len(images):
            raise ValueError(f"face_texture: an index is outside the {len(images)} textures")

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest corner, each (3,) metres. Raises ValueError for a mesh without vertices."""
        if not len(self.vertices):
            raise ValueError("a mesh without vertices has no bounds")
        return self.vertices.min(axis=0).astype(np.float64), self.vertices.max(axis=0).astype(np.float64)

    @property
    def size(self) -> FloatArray:
        """Extent (3,) along x, y, z in metres."""
        low, high = self.bounds
        return high - low

    def transformed(self, matrix: Any) -> Mesh:
        """This mesh with a (4, 4) or (3, 3) matrix applied to every vertex.

        A matrix that mirrors (negative determinant) also turns the faces, so that they stay outward.
        """
        matrix = np.asarray(matrix, dtype=np.float64)
        vertices = self.vertices @ matrix[:3, :3].T
        if matrix.shape == (4, 4):
            vertices = vertices + matrix[:3, 3]
        mesh = replace(self, vertices=vertices.astype(np.float32))
        return mesh.flipped() if np.linalg.det(matrix[:3, :3]) < 0 else mesh

    def flipped(self) -> Mesh:
        """The same surface with every face's winding turned around."""
        uv = None if self.uv is None else np.ascontiguousarray(self.uv[:, ::-1])
        return replace(self, faces=np.ascontiguousarray(self.faces[:, ::-1]), uv=uv)

    def scaled_to(self, size: Sequence[float]) -> Mesh:
        """This mesh stretched to `size` (3,) metres and moved into the object frame.

        An axis without extent keeps its scale.
        """
        low, high = self.bounds
        extent = high - low
        factor = np.where(extent > 1e-9, np.asarray(size, dtype=np.float64) / np.maximum(extent, 1e-9), 1.0)
        origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        return replace(self, vertices=((self.vertices - origin) * factor).astype(np.float32))

    def moved(self, offset: Sequence[float]) -> Mesh:
        """This mesh shifted by `offset` (3,) metres."""
        return replace(self, vertices=(self.vertices + np.asarray(offset, np.float32)).astype(np.float32))


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of all `meshes`, faces in their order; textures that are the same array are kept once."""
    if not meshes:
        return Mesh(np.empty((0, 3), np.float32), np.empty((0, 3), np.int32), np.empty((0, 3), np.uint8))
    textures: list[ByteArray] = []
    place: dict[int, int] = {}
    faces, links = [], []
    offset = 0
    for mesh in meshes:
        table = np.full(len(mesh.textures) + 1, -1, np.int32)  # the last entry serves index -1
        for i, image in enumerate(mesh.textures):
            if id(image) not in place:
                place[id(image)] = len(textures)
                textures.append(image)
            table[i] = place[id(image)]
        faces.append(mesh.faces + offset)
        links.append(table[mesh.face_texture])
        offset += len(mesh.vertices)
    uv: NDArray[np.float32] | None = None
    if any(mesh.uv is not None for mesh in meshes):
        uv = np.concatenate(
            [np.zeros((len(m.faces), 3, 2), np.float32) if m.uv is None else m.uv for m in meshes]
        )
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate(faces).astype(np.int32),
        np.concatenate([m.face_colors for m in meshes]),
        uv,
        np.concatenate(links).astype(np.int32),
        tuple(textures),
    )


def from_triangles(vertices: Any, faces: Any, color: Sequence[int]) -> Mesh:
    """A mesh of one flat colour; vertices (V, 3) metres, faces (F, 3), color (r, g, b) 0..255."""
    faces = np.asarray(faces, np.int32).reshape(-1, 3)
    colors = np.tile(np.asarray(color, np.uint8), (len(faces), 1))
    return Mesh(np.asarray(vertices, np.float32).reshape(-1, 3), faces, colors)


_BOX_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2],
     [2, 4, 6], [1, 3, 5], [3, 7, 5]]
)  # fmt: skip


def box(size: Sequence[float], color: Sequence[int], center: Sequence[float] | None = None) -> Mesh:
    """A box of `size` (x, y, z) metres; `center` is its middle, by default it stands on the origin."""
    half = np.asarray(size, np.float64) / 2
    middle = np.array([0.0, 0.0, half[2]]) if center is None else np.asarray(center, np.float64)
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float64)
    return from_triangles(corners * half + middle, _BOX_FACES, color)


def cylinder(
    radius: float, height: float, color: Sequence[int], *, top_radius: float | None = None, segments: int = 20
) -> Mesh:
    """An upright cylinder (or cone, with `top_radius`) standing on the origin; metres."""
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    upper = radius if top_radius is None else top_radius
    low = np.column_stack([ring * radius, np.zeros(segments)])
    high = np.column_stack([ring * upper, np.full(segments, height)])
    vertices = np.concatenate([low, high, [[0, 0, 0], [0, 0, height]]])
    i = np.arange(segments)
    j = (i + 1) % segments
    bottom, top = 2 * segments, 2 * segments + 1
    faces = np.concatenate(
        [
            np.column_stack([i, j, j + segments]),
            np.column_stack([i, j + segments, i + segments]),
            np.column_stack([j, i, np.full(segments, bottom)]),
            np.column_stack([i + segments, j + segments, np.full(segments, top)]),
        ]
    )
    return from_triangles(vertices, faces, color)


def sphere(radius: float, color: Sequence[int], *, rings: int = 10, segments: int = 16) -> Mesh:
    """A ball standing on the origin; metres."""
    polar = np.linspace(0, np.pi, rings + 1)
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    grid = np.stack(
        [
            np.sin(polar)[:, None] * np.cos(angle),
            np.sin(polar)[:, None] * np.sin(angle),
            -np.cos(polar)[:, None] * np.ones(segments),
        ],
        axis=-1,
    ).reshape(-1, 3)
    r, s = np.meshgrid(np.arange(rings), np.arange(segments), indexing="ij")
    a, b = (r * segments + s).ravel(), (r * segments + (s + 1) % segments).ravel()
    faces = np.concatenate(
        [np.column_stack([a, b, b + segments]), np.column_stack([a, b + segments, a + segments])]
    )
    return from_triangles(grid * radius + [0, 0, radius], faces, color)
