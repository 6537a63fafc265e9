"""The simulated camera's contract: what is put before it, what it gives, and which renderer to take."""

from __future__ import annotations

import functools
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from dssmsg.errors import ConfigError
from dssmsg.frame import ByteArray, Camera, FloatArray, IntArray, frozen_array
from dssmsg.sim.mesh import Mesh

RENDERERS = ("auto", "raycast", "tiny")


@dataclass(frozen=True, slots=True, eq=False)
class Instance:
    """A mesh placed in the world.

    `instance_id` 0 is structure (walls, floor, ceiling, doors), positive numbers are objects;
    world_from_object (4, 4) rigid, or scaled.
    """

    instance_id: int
    mesh: Mesh
    world_from_object: FloatArray

    def __post_init__(self) -> None:
        if self.instance_id < 0:
            raise ValueError(f"instance_id: expected 0 or more, got {self.instance_id}")
        pose = frozen_array("world_from_object", self.world_from_object, np.float64, (4, 4), finite=True)
        object.__setattr__(self, "world_from_object", pose)


@dataclass(frozen=True, slots=True, eq=False)
class Render:
    """One exact view, before any sensor model.

    rgb (H, W, 3) uint8; depth (H, W) float64 metres along the optical axis, not quantised, 0 = nothing
    hit; instance_ids (H, W) int32, 0 = structure or nothing; cos_incidence (H, W) float32, cosine of the
    angle between ray and surface normal in 0..1 (0 = nothing hit): the sensor model needs it.
    """

    rgb: ByteArray
    depth: FloatArray
    instance_ids: IntArray
    cos_incidence: Any


@runtime_checkable
class Renderer(Protocol):
    """Turns placed meshes and a pose into a view. Results do not depend on the number of threads."""

    @property
    def name(self) -> str:
        """`raycast` or `tiny`."""
        ...

    def set_static(self, instances: Sequence[Instance]) -> None:
        """Replace everything that stays where it is; costs a rebuild of the large scene."""
        ...

    def set_movable(self, instances: Sequence[Instance]) -> None:
        """Replace everything that may move; costs a rebuild of the small scene only."""
        ...

    def render(self, camera: Camera, world_from_camera: FloatArray) -> Render:
        """The view from `world_from_camera` (4, 4), OpenCV axes (x right, y down, z forward)."""
        ...

    def close(self) -> None:
        """Release what is held; safe to call twice."""
        ...


@functools.cache
def probe_open3d() -> str:
    """Empty when Open3D's ray casting works here, else the reason in one line.

    Asked in a subprocess, because a missing system library or an unsuitable CPU may end the process.
    """
    script = (
        "import numpy, open3d.core as c, open3d.t.geometry as g\n"
        "s = g.RaycastingScene()\n"
        "s.add_triangles(c.Tensor(numpy.eye(3, dtype='f4')), c.Tensor(numpy.array([[0, 1, 2]], 'u4')))\n"
        "s.cast_rays(c.Tensor(numpy.zeros((1, 6), 'f4')))\n"
    )
    try:
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"probe failed: {error}"
    if done.returncode == 0:
        return ""
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"the probe ended with code {done.returncode}"


def make_renderer(name: str = "auto") -> tuple[Renderer, str]:
    """The renderer called `name` and one line saying which was taken and why.

    `auto` takes Open3D ray casting where it loads, else pybullet's TinyRenderer. Raises ConfigError for
    an unknown name, or when `raycast` was asked for and Open3D does not load.
    """
    if name not in RENDERERS:
        raise ConfigError(
            f"unknown renderer {name!r}; accepted: {', '.join(RENDERERS)}", key="source.renderer"
        )
    reason = "" if name == "tiny" else probe_open3d()
    if name == "tiny" or (name == "auto" and reason):
        from dssmsg.sim.tiny import TinyRenderer

        why = f"Open3D does not load ({reason})" if reason else "as configured"
        return TinyRenderer(), f"pybullet TinyRenderer: {why}"
    if reason:
        hint = "accepted here: tiny, or auto; on Debian: apt install libusb-1.0-0 libgl1 libgomp1 libx11-6"
        raise ConfigError(
            f"raycast needs Open3D, which does not load ({reason}); {hint}", key="source.renderer"
        )
    from dssmsg.sim.raycast import RaycastRenderer

    why = "as configured" if name == "raycast" else "Open3D loads"
    return RaycastRenderer(), f"Open3D ray casting: {why}"
