"""The pybullet side of the world: one client without a window, solids as static bodies, contacts."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterator
from typing import Any

from dssmsg.sim.solid import Solid

PHYSICS_HZ = 240


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Drop what a C library prints to stdout and stderr, which carry results and messages of ours."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = os.dup(1), os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        ctypes.CDLL(None).fflush(None)  # what C has buffered would come out later otherwise
        os.dup2(saved[0], 1)
        os.dup2(saved[1], 2)
        for descriptor in (*saved, nowhere):
            os.close(descriptor)


def import_pybullet() -> Any:
    """pybullet, without its build time, which it prints when it is first imported."""
    with _quiet():
        import pybullet
    return pybullet


class Physics:
    """One pybullet client holding the robot and the solids."""

    def __init__(self) -> None:
        self.api = pybullet = import_pybullet()
        self.client: int = pybullet.connect(pybullet.DIRECT)
        if self.client < 0:
            raise RuntimeError("pybullet gave no client; it allows 1024 a process")
        pybullet.setTimeStep(1.0 / PHYSICS_HZ, physicsClientId=self.client)
        self._owners: dict[int, str] = {}

    def add(self, solid: Solid) -> int:
        """A static body of a solid's shape; returns its id."""
        api = self.api
        shape = api.createCollisionShape(
            api.GEOM_BOX, halfExtents=[max(h, 1e-3) for h in solid.half], physicsClientId=self.client
        )
        turn = api.getQuaternionFromEuler([0.0, 0.0, solid.yaw_rad])
        body: int = api.createMultiBody(0.0, shape, -1, list(solid.center), turn, physicsClientId=self.client)
        self._owners[body] = solid.owner
        return body

    def remove(self, body: int) -> None:
        """Take a body out of the world."""
        self.api.removeBody(body, physicsClientId=self.client)
        del self._owners[body]

    def load_robot(self, urdf: str) -> int:
        """The robot's body from a URDF file; static bodies only collide with what is not static."""
        with _quiet():
            robot: int = self.api.loadURDF(
                urdf, flags=self.api.URDF_USE_INERTIA_FROM_FILE, physicsClientId=self.client
            )
        return robot

    def penetration(self, body: int) -> tuple[float, str]:
        """How deep `body` is in a solid, metres (0 = free), and that one's owner ('' = a wall)."""
        api = self.api
        api.performCollisionDetection(physicsClientId=self.client)
        deepest, owner = 0.0, ""
        for contact in api.getContactPoints(bodyA=body, physicsClientId=self.client) or ():
            if contact[2] in self._owners and -contact[8] > deepest:
                deepest, owner = -contact[8], self._owners[contact[2]]
        return deepest, owner

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        if self.client >= 0:
            self.api.disconnect(physicsClientId=self.client)
            self.client = -1
