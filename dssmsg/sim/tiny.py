"""pybullet's TinyRenderer: the fallback where Open3D does not load, and the cross-check where it does.

Slower than ray casting and its cost grows with the number of triangles, but it needs nothing beside pybullet.
It draws outward faces only, so an eye inside a piece looks through it; ray casting sees both sides.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from dssmsg.frame import ByteArray, Camera, Float32Array, FloatArray
from dssmsg.sim.camera import Instance, Render
from dssmsg.sim.mesh import Mesh
from dssmsg.sim.physics import import_pybullet

NEAR, FAR = 0.05, 60.0
"""Metres: clipping planes of the depth buffer."""

MAX_TRIANGLES = 40_000
"""A visual shape holds at most 131,072 vertices; ours have three a triangle."""

COLUMN_SHIFT, ROW_SHIFT = -0.5, 0.5
"""Pixels: TinyRenderer draws half a column and half a row off OpenGL's raster. With these, walls and floors
lie where ray casting finds them, to 0.1 mm."""


class TinyRenderer:
    """`dssmsg.sim.camera.Renderer` on a pybullet client of its own."""

    name = "tiny"

    def __init__(self) -> None:
        self._bullet: Any = import_pybullet()
        self._client: int | None = self._bullet.connect(self._bullet.DIRECT)
        self._folder = tempfile.TemporaryDirectory(prefix="dssmsg-textures-")
        self._textures: dict[
            int, tuple[int, ByteArray]
        ] = {}  # the array is held, so that its id stays its own
        self._static: dict[int, int] = {}
        self._movable: dict[int, int] = {}

    def set_static(self, instances: Sequence[Instance]) -> None:
        """Replace everything that stays; see `Renderer`."""
        self._static = self._replace(self._static, instances)

    def set_movable(self, instances: Sequence[Instance]) -> None:
        """Replace everything that may move; see `Renderer`."""
        self._movable = self._replace(self._movable, instances)

    def close(self) -> None:
        """Disconnect the client and remove the texture files."""
        if self._client is not None:
            self._bullet.disconnect(self._client)
            self._client = None
            self._folder.cleanup()

    def render(self, camera: Camera, world_from_camera: FloatArray) -> Render:
        """The view from `world_from_camera` (4, 4); see `Renderer`."""
        _, _, rgba, buffer, mask = self._bullet.getCameraImage(
            camera.width,
            camera.height,
            viewMatrix=_view_matrix(world_from_camera),
            projectionMatrix=_projection_matrix(camera),
            lightDirection=(-world_from_camera[:3, 2]).tolist(),
            lightAmbientCoeff=0.45,
            lightDiffuseCoeff=0.5,
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=self._bullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        shape = (camera.height, camera.width)
        buffer = np.asarray(buffer, np.float64).reshape(shape)
        bodies = np.asarray(mask, np.int32).reshape(shape)
        hit = bodies >= 0
        depth = np.where(hit, FAR * NEAR / (FAR - (FAR - NEAR) * buffer), 0.0)
        owners = {**self._static, **self._movable}
        table = np.zeros(max(owners, default=0) + 1, np.int32)
        for body, instance_id in owners.items():
            table[body] = instance_id
        ids = np.where(hit, table[np.where(hit, bodies, 0)], 0).astype(np.int32)
        rgb = np.asarray(rgba, np.uint8).reshape(*shape, 4)[..., :3].copy()
        rgb[~hit] = 0
        return Render(rgb, depth, ids, _cos_incidence(depth, camera))

    def _replace(self, bodies: dict[int, int], instances: Sequence[Instance]) -> dict[int, int]:
        for body in bodies:
            self._bullet.removeBody(body, physicsClientId=self._client)
        made = {}
        for instance in instances:
            pose = instance.world_from_object
            points = (instance.mesh.vertices @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
            for rows, texture, color in _by_material(instance.mesh):
                for start in range(0, len(rows), MAX_TRIANGLES):
                    body = self._body(
                        points, instance.mesh, rows[start : start + MAX_TRIANGLES], texture, color
                    )
                    made[body] = instance.instance_id
        return made

    def _body(
        self, points: Float32Array, mesh: Mesh, rows: Any, texture: ByteArray | None, color: Sequence[float]
    ) -> int:
        """One body of one material; a visual shape has one colour and one texture."""
        bullet = self._bullet
        corners = points[mesh.faces[rows]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        uv = np.zeros((len(rows), 3, 2)) if mesh.uv is None else mesh.uv[rows]
        shape = bullet.createVisualShape(
            bullet.GEOM_MESH,
            vertices=corners.reshape(-1, 3).tolist(),
            indices=list(range(3 * len(rows))),
            uvs=uv.reshape(-1, 2).tolist(),
            normals=np.repeat(normals, 3, axis=0).tolist(),
            rgbaColor=[*color, 1.0],
            specularColor=[0, 0, 0],
            physicsClientId=self._client,
        )
        body = bullet.createMultiBody(baseVisualShapeIndex=shape, physicsClientId=self._client)
        if texture is not None:
            bullet.changeVisualShape(
                body, -1, textureUniqueId=self._texture(texture), physicsClientId=self._client
            )
        return int(body)

    def _texture(self, image: ByteArray) -> int:
        known = self._textures.get(id(image))
        if known is None:
            path = Path(self._folder.name) / f"{len(self._textures)}.png"
            Image.fromarray(np.ascontiguousarray(image)).save(path)
            known = (self._bullet.loadTexture(os.fspath(path), physicsClientId=self._client), image)
            self._textures[id(image)] = known
        return known[0]


def _by_material(mesh: Mesh) -> Iterator[tuple[Any, ByteArray | None, list[float]]]:
    """Face rows (n,) that share a texture or a flat colour, with that texture and colour (0..1)."""
    color = mesh.face_colors.astype(np.int64)
    flat = color[:, 0] << 16 | color[:, 1] << 8 | color[:, 2]
    key = np.where(mesh.face_texture >= 0, -1 - mesh.face_texture, flat)
    for value in np.unique(key):
        rows = np.flatnonzero(key == value)
        if value < 0:
            yield rows, mesh.textures[-1 - int(value)], [1.0, 1.0, 1.0]
        else:
            yield rows, None, (mesh.face_colors[rows[0]] / 255.0).tolist()


def _view_matrix(world_from_camera: FloatArray) -> list[float]:
    """OpenGL view matrix, column by column; its camera looks along -z with y up."""
    world_from_gl = world_from_camera @ np.diag([1.0, -1.0, -1.0, 1.0])
    matrix: list[float] = np.linalg.inv(world_from_gl).T.ravel().tolist()
    return matrix


def _projection_matrix(camera: Camera) -> list[float]:
    """OpenGL projection of the pinhole, column by column. Its pixel centres are at half integers."""
    cx, cy = camera.cx + 0.5 + COLUMN_SHIFT, camera.cy + 0.5 + ROW_SHIFT
    width, height = camera.width, camera.height
    rows = np.zeros((4, 4))
    rows[0, 0], rows[0, 2] = 2 * camera.fx / width, 1 - 2 * cx / width
    rows[1, 1], rows[1, 2] = 2 * camera.fy / height, 2 * cy / height - 1
    rows[2, 2], rows[2, 3] = -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)
    rows[3, 2] = -1
    matrix: list[float] = rows.T.ravel().tolist()
    return matrix


def _cos_incidence(depth: FloatArray, camera: Camera) -> Float32Array:
    """Cosine between ray and surface (H, W), the surface taken from neighbouring depths; 0 without a hit."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], np.ones_like(depth)), axis=-1)
    points = rays * depth[..., None]
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    lengths = np.linalg.norm(normal, axis=-1) * np.linalg.norm(rays, axis=-1)
    cosine = np.abs((normal * rays).sum(axis=-1)) / np.maximum(lengths, 1e-12)
    return np.where(depth > 0, np.minimum(cosine, 1.0), 0.0).astype(np.float32)
