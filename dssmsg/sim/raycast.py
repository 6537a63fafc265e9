"""Ray casting with Open3D (Embree): colour, depth and instance ids from one cast a pixel.

The cost of a frame hardly depends on the number of triangles, so meshes are not decimated. What stays
and what moves live in two Embree scenes: a moved mug costs the rebuild of the small one, and the small one
is asked only where the boxes of its instances project to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.frame import Camera, Float32Array, FloatArray, IntArray, MaskArray
from dssmsg.sim.camera import Instance, Render
from dssmsg.sim.texture import TextureStore

AMBIENT, HEADLIGHT, SKY = 0.42, 0.43, 0.15
"""Shares of the light: everywhere, from the camera (Lambert), from above (tells floors from walls)."""


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """Per-triangle tables of one layer.

    words (F, 4) int32: colour 0xBBGGRR, instance id, row of `skins` or -1, unused (a row is then 16 bytes,
    one cache line at most). skins (S, 8) float32: uv at corner 0, its change towards corners 1 and 2,
    log2 of texels per metre, texture index.
    """

    words: IntArray
    skins: Float32Array


@dataclass(slots=True)
class _Hits:
    """What one cast found: t (N,) ray parameter, triangle (N,), barycentric (N, 2), normal (N, 3)."""

    t: Float32Array
    triangle: IntArray
    barycentric: Float32Array
    normal: Float32Array


class _Layer:
    """An Embree scene with its surface tables."""

    def __init__(self, instances: Sequence[Instance], textures: TextureStore) -> None:
        import open3d

        o3d: Any = open3d  # its stubs know less than it does
        self._tensor = o3d.core.Tensor
        self.boxes = np.array([_world_box(i) for i in instances if len(i.mesh.faces)]).reshape(-1, 8, 3)
        vertices, faces, words, skins = [], [], [], []
        vertex_count = skin_count = 0
        for instance in instances:
            mesh, pose = instance.mesh, instance.world_from_object
            points = (mesh.vertices @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
            word = np.full((len(mesh.faces), 4), -1, np.int32)
            color = mesh.face_colors.astype(np.int32)
            word[:, 0] = color[:, 0] | color[:, 1] << 8 | color[:, 2] << 16
            word[:, 1] = instance.instance_id
            textured = np.flatnonzero(mesh.face_texture >= 0)
            if textured.size and mesh.uv is not None:
                index = np.array([textures.add(image) for image in mesh.textures], np.int32)
                skins.append(_skin(points, mesh.faces[textured], mesh.uv[textured],
                                   index[mesh.face_texture[textured]], textures))  # fmt: skip
                word[textured, 2] = skin_count + np.arange(textured.size)
                skin_count += textured.size
            vertices.append(points)
            faces.append(mesh.faces + vertex_count)
            words.append(word)
            vertex_count += len(points)
        self.surface = _Surface(
            np.concatenate(words) if words else np.empty((0, 4), np.int32),
            np.concatenate(skins) if skins else np.empty((0, 8), np.float32),
        )
        self._scene: Any = None
        if len(self.surface.words):
            self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
            triangles = np.concatenate(faces).astype(np.uint32)
            self._scene.add_triangles(self._tensor(np.concatenate(vertices)), self._tensor(triangles))

    def cast(self, rays: Float32Array) -> _Hits | None:
        """Nearest hits of `rays` (N, 6); t is infinite for a miss. None for an empty layer."""
        if self._scene is None:
            return None
        found = self._scene.cast_rays(self._tensor.from_numpy(rays), nthreads=1)
        return _Hits(
            found["t_hit"].numpy(),
            found["primitive_ids"].numpy().view(np.int32),
            found["primitive_uvs"].numpy(),
            found["primitive_normals"].numpy(),
        )


class RaycastRenderer:
    """`dssmsg.sim.camera.Renderer` on Open3D's RaycastingScene with a vectorised numpy shader.

    Each cast is limited to one thread, so that a run costs what it says and results cannot depend on the
    machine's core count.
    """

    name = "raycast"

    def __init__(self) -> None:
        self._textures = TextureStore()
        self._static = _Layer((), self._textures)
        self._movable = _Layer((), self._textures)
        self._surface = _joined(self._static.surface, self._movable.surface)
        self._pixel_rays: tuple[Camera, Float32Array, Float32Array] | None = None

    def set_static(self, instances: Sequence[Instance]) -> None:
        """Replace everything that stays; see `Renderer`."""
        self._static = _Layer(instances, self._textures)
        self._surface = _joined(self._static.surface, self._movable.surface)

    def set_movable(self, instances: Sequence[Instance]) -> None:
        """Replace everything that may move; see `Renderer`."""
        self._movable = _Layer(instances, self._textures)
        self._surface = _joined(self._static.surface, self._movable.surface)

    def close(self) -> None:
        """Let go of both scenes."""
        self.set_static(())
        self.set_movable(())

    def render(self, camera: Camera, world_from_camera: FloatArray) -> Render:
        """The view from `world_from_camera` (4, 4); see `Renderer`."""
        shape = (camera.height, camera.width)
        directions_camera, inverse_length = self._rays_of(camera)
        rays = np.empty((directions_camera.shape[0], 6), np.float32)
        rays[:, :3] = world_from_camera[:3, 3]
        # The direction has length 1 along the optical axis, so the ray parameter is the depth itself.
        np.matmul(directions_camera, world_from_camera[:3, :3].T.astype(np.float32), out=rays[:, 3:])
        hits = self._nearest(camera, world_from_camera, rays)
        if hits is None:
            return Render(np.zeros((*shape, 3), np.uint8), np.zeros(shape), np.zeros(shape, np.int32),
                          np.zeros(shape, np.float32))  # fmt: skip
        missed = ~np.isfinite(hits.t)
        hits.t[missed] = 0.0
        hits.triangle[missed] = 0
        words = self._surface.words.take(hits.triangle, axis=0)
        facing = np.einsum("ij,ij->i", hits.normal, rays[:, 3:])
        up = np.copysign(hits.normal[:, 2], -facing * hits.normal[:, 2])
        cosine = np.abs(facing) * inverse_length
        shade = cosine * np.float32(HEADLIGHT * 256) + up * np.float32(SKY * 128)
        shade += np.float32((AMBIENT + SKY / 2) * 256)
        shade[missed] = 0.0
        colors = np.ascontiguousarray(words[:, 0])
        self._paint(colors, words[:, 2], hits, camera)
        rgb = colors.view(np.uint8).reshape(-1, 4)[:, :3].astype(np.uint16)
        rgb *= shade.astype(np.uint16)[:, None]
        rgb >>= 8
        ids = np.where(missed, 0, words[:, 1])
        cosine[missed] = 0.0
        return Render(
            rgb.astype(np.uint8).reshape(*shape, 3),
            hits.t.astype(np.float64).reshape(shape),
            ids.reshape(shape),
            cosine.reshape(shape),
        )

    def _nearest(self, camera: Camera, world_from_camera: FloatArray, rays: Float32Array) -> _Hits | None:
        hits = self._static.cast(rays)
        offset = len(self._static.surface.words)
        if hits is None:
            return self._movable.cast(rays)
        if not len(self._movable.boxes):
            return hits
        inside = _covered(camera, world_from_camera, self._movable.boxes)
        pixels = np.flatnonzero(inside.ravel())
        near = self._movable.cast(rays[pixels]) if pixels.size else None
        if near is not None:
            closer = near.t < hits.t[pixels]
            wins = pixels[closer]
            hits.t[wins] = near.t[closer]
            hits.triangle[wins] = near.triangle[closer] + offset
            hits.barycentric[wins] = near.barycentric[closer]
            hits.normal[wins] = near.normal[closer]
        return hits

    def _paint(self, colors: IntArray, skin_rows: IntArray, hits: _Hits, camera: Camera) -> None:
        """Overwrite `colors` where the triangle has a texture."""
        pixels = np.flatnonzero(skin_rows >= 0)
        if not pixels.size:
            return
        skin = self._surface.skins.take(skin_rows[pixels], axis=0)
        # A sliver of a triangle can give coordinates far outside it, or none at all: any texel of it will do.
        inner = np.fmin(np.fmax(hits.barycentric[pixels], 0.0), 1.0)
        weights: Float32Array = inner.astype(np.float32, copy=False)
        uv: Float32Array = skin[:, 0:2] + weights[:, 0:1] * skin[:, 2:4] + weights[:, 1:2] * skin[:, 4:6]
        metres_per_pixel = np.maximum(hits.t[pixels], np.float32(1e-3)) / np.float32(camera.fx)
        coarse: Float32Array = (skin[:, 6] + np.log2(metres_per_pixel)).astype(np.float32, copy=False)
        colors[pixels] = self._textures.sample(skin[:, 7].astype(np.int32), uv, coarse).view(np.int32)

    def _rays_of(self, camera: Camera) -> tuple[Float32Array, Float32Array]:
        """Directions (N, 3) in camera axes with z = 1, and 1 / their length (N,); kept for the next frame."""
        if self._pixel_rays is None or self._pixel_rays[0] != camera:
            x = (np.arange(camera.width) - camera.cx) / camera.fx
            y = (np.arange(camera.height) - camera.cy) / camera.fy
            grid = np.empty((camera.height, camera.width, 3), np.float32)
            grid[..., 0], grid[..., 1], grid[..., 2] = x[None, :], y[:, None], 1.0
            flat = grid.reshape(-1, 3)
            self._pixel_rays = (camera, flat, (1.0 / np.linalg.norm(flat, axis=1)).astype(np.float32))
        return self._pixel_rays[1], self._pixel_rays[2]


def _joined(first: _Surface, second: _Surface) -> _Surface:
    words = np.concatenate([first.words, second.words])
    rows = words[len(first.words) :, 2]
    rows[rows >= 0] += len(first.skins)
    return _Surface(words, np.concatenate([first.skins, second.skins]))


def _skin(
    points: Float32Array, faces: IntArray, uv: Float32Array, texture: IntArray, textures: TextureStore
) -> Float32Array:
    corner = points[faces].astype(np.float64)
    metres2 = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    along, across = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    turns2 = np.abs(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0])
    texels = np.array([textures.texel_count(int(i)) for i in np.unique(texture)])
    texels2 = turns2 * texels[np.searchsorted(np.unique(texture), texture)]
    skin = np.empty((len(faces), 8), np.float32)
    skin[:, 0:2], skin[:, 2:4], skin[:, 4:6] = uv[:, 0], along, across
    skin[:, 6] = 0.5 * np.log2(np.maximum(texels2, 1e-12) / np.maximum(metres2, 1e-12))
    skin[:, 7] = texture
    return skin


def _world_box(instance: Instance) -> FloatArray:
    """The eight corners (8, 3) of the mesh's box, in the world."""
    low, high = instance.mesh.bounds
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    pose = instance.world_from_object
    result: NDArray[np.float64] = corners @ pose[:3, :3].T + pose[:3, 3]
    return result


def _covered(camera: Camera, world_from_camera: FloatArray, boxes: FloatArray) -> MaskArray:
    """Pixels (H, W) that any of `boxes` (B, 8, 3) may touch: the rectangles around their projections."""
    inside = np.zeros((camera.height, camera.width), np.bool_)
    seen = (boxes - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
    for corners in seen:
        z = corners[:, 2]
        if z.max() <= 0:
            continue
        if z.min() < 1e-3:  # the box reaches behind the camera: its projection is no rectangle
            inside[:] = True
            return inside
        x = corners[:, 0] / z * camera.fx + camera.cx
        y = corners[:, 1] / z * camera.fy + camera.cy
        left, right = max(0, int(np.floor(x.min()))), min(camera.width, int(np.ceil(x.max())) + 1)
        top, bottom = max(0, int(np.floor(y.min()))), min(camera.height, int(np.ceil(y.max())) + 1)
        if left < right and top < bottom:
            inside[top:bottom, left:right] = True
    return inside
