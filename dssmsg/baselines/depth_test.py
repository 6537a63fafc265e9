"""DovSG's test of memory against a new view: which voxels does the depth image show to be gone?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dssmsg.frame import ByteArray, Float32Array, Frame, MaskArray
from dssmsg.geometry import invert_rigid, project, transform_points


@dataclass(frozen=True, slots=True)
class DepthTest:
    """Delete where depth - M > `far`, or where it is > `near` and the colours differ by more than `color`.

    M is the least depth of the memory's voxels on that pixel: only the voxel in front is tested. Metres
    along the optical axis; colours differ by their distance in RGB, 1 from black to white. Voxels farther
    than `max_range`, and pixels without a reading, are not tested.
    """

    far: float = 0.02
    near: float = 0.01
    color: float = 0.1
    max_range: float = 5.0

    def gone(self, points: Float32Array, colors: ByteArray, frame: Frame) -> MaskArray:
        """(N,) bool: which of the memory's voxels, points (N, 3) world and colors (N, 3), to delete."""
        deleted: MaskArray = np.zeros(len(points), dtype=np.bool_)
        camera = frame.camera
        uv, z = project(transform_points(invert_rigid(frame.world_from_camera), points), camera)
        u, v = np.rint(np.nan_to_num(uv, nan=-1.0)).T
        seen = np.flatnonzero(
            (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height) & (z <= self.max_range)
        )
        if len(seen) == 0:
            return deleted
        pixel = v[seen].astype(np.intp) * camera.width + u[seen].astype(np.intp)
        order = np.lexsort((z[seen], pixel))
        first = np.concatenate([[True], np.diff(pixel[order]) > 0])
        front, pixel = seen[order[first]], pixel[order[first]]
        depth = frame.depth.reshape(-1)[pixel].astype(np.float64)
        behind = depth - z[front]
        rgb = frame.rgb.reshape(-1, 3)[pixel].astype(np.float64) - colors[front]
        distance = np.sqrt(np.sum(rgb * rgb, axis=1) / 3.0) / 255.0
        free = (behind > self.far) | ((behind > self.near) & (distance > self.color))
        deleted[front[free & (depth > 0)]] = True
        return deleted
