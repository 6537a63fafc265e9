"""The LoCoBot: a differential drive with limits, a pan/tilt head, and contacts that stop it.

Figures: Kobuki base and LoCoBot data sheets (+-0.5 m/s, +-1.57 rad/s, camera 0.88 m high as in the iGibson
challenge). The base is driven as a kinematic pose with a contact test at 240 Hz: exact, repeatable, and it
cannot be pushed through thin things. It never jumps: `place` is for the beginning of the first visit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import resources

import numpy as np

from dssmsg.frame import FloatArray
from dssmsg.interfaces.source import Command
from dssmsg.sim.physics import PHYSICS_HZ, Physics

ACTION_STEPS = PHYSICS_HZ // 10
"""Physics steps of one control action (0.1 s)."""
CONTACT_DEPTH = 5e-4
"""Touching deeper than this is a contact; less is the collision engine's rounding. Metres."""


@dataclass(frozen=True, slots=True)
class RobotSpec:
    """Limits in m/s, rad/s, their rates a second, radians; the camera's place in metres."""

    max_linear: float = 0.5
    max_angular: float = 1.57
    linear_acceleration: float = 1.0
    angular_acceleration: float = 5.0
    pan_limits: tuple[float, float] = (-2.7, 2.6)
    tilt_limits: tuple[float, float] = (-1.4, 1.75)
    mount_speed: float = 3.0
    camera_height: float = 0.88
    camera_forward: float = 0.0


def camera_pose(x: float, y: float, heading: float, pan: float, tilt: float, spec: RobotSpec) -> FloatArray:
    """world_from_camera (4, 4), OpenCV axes, of a robot at `x`, `y` with head at `pan`, `tilt`; m, rad."""
    look = heading + pan
    forward = np.array([math.cos(look) * math.cos(tilt), math.sin(look) * math.cos(tilt), math.sin(tilt)])
    right = np.array([math.sin(look), -math.cos(look), 0.0])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(forward, right), forward
    pose[:3, 3] = [
        x + spec.camera_forward * math.cos(heading),
        y + spec.camera_forward * math.sin(heading),
        spec.camera_height,
    ]
    return pose


class Robot:
    """State: x, y metres, heading, pan, tilt radians, linear m/s, angular rad/s, all in world axes."""

    def __init__(self, physics: Physics, spec: RobotSpec) -> None:
        self.spec = spec
        self.x = self.y = self.heading = 0.0
        self.pan = self.tilt = 0.0
        self.linear = self.angular = 0.0
        self.touching = False
        self.hit = ""
        """Name of what was touched last ('' = a wall, or nothing yet)."""
        self._physics = physics
        self._depth = 0.0
        with resources.as_file(resources.files("dssmsg") / "data" / "robot" / "locobot.urdf") as path:
            self.body = physics.load_robot(str(path))
        api = physics.api
        joints = range(api.getNumJoints(self.body, physicsClientId=physics.client))
        names = {
            api.getJointInfo(self.body, j, physicsClientId=physics.client)[1].decode(): j for j in joints
        }
        self.pan_joint, self.tilt_joint = names["pan_joint"], names["tilt_joint"]

    def place(self, x: float, y: float, heading: float) -> None:
        """Put the robot down at rest, head straight ahead."""
        self.x, self.y, self.heading = x, y, heading
        self.linear = self.angular = self.pan = self.tilt = 0.0
        self.touching = False
        self._write_base()
        self._write_head()

    @property
    def world_from_base(self) -> FloatArray:
        """(4, 4): the base on the floor, x ahead."""
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        return np.array(
            [[cos, -sin, 0, self.x], [sin, cos, 0, self.y], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=np.float64
        )

    @property
    def world_from_camera(self) -> FloatArray:
        """(4, 4) OpenCV axes."""
        return camera_pose(self.x, self.y, self.heading, self.pan, self.tilt, self.spec)

    def act(self, command: Command, steps: int = ACTION_STEPS) -> bool:
        """Carry out a command for `steps` physics steps; True if the robot touched something meanwhile."""
        spec, dt = self.spec, 1.0 / PHYSICS_HZ
        want_linear = _clip(command.linear, -spec.max_linear, spec.max_linear)
        want_angular = _clip(command.angular, -spec.max_angular, spec.max_angular)
        pan = _clip(command.pan, *spec.pan_limits)
        tilt = _clip(command.tilt, *spec.tilt_limits)
        contact = False
        for _ in range(steps):
            self.linear = _toward(self.linear, want_linear, spec.linear_acceleration * dt)
            self.angular = _toward(self.angular, want_angular, spec.angular_acceleration * dt)
            self.pan = _toward(self.pan, pan, spec.mount_speed * dt)
            self.tilt = _toward(self.tilt, tilt, spec.mount_speed * dt)
            contact = self._drive(dt) or contact
        self._write_head()
        self.touching = contact
        return contact

    def _drive(self, dt: float) -> bool:
        """One physics step on the arc of the current speeds; a step into something is not taken."""
        if self.linear == 0.0:
            if self.angular:
                self.heading = _wrap(self.heading + self.angular * dt)
                self._write_base()
            return False
        x, y, heading, before = self.x, self.y, self.heading, self._depth
        middle = heading + self.angular * dt / 2  # the chord of the arc
        self.x += self.linear * dt * math.cos(middle)
        self.y += self.linear * dt * math.sin(middle)
        self.heading = _wrap(heading + self.angular * dt)
        self._write_base()
        depth, owner = self._physics.penetration(self.body)
        if depth <= CONTACT_DEPTH:
            self._depth = 0.0
            return False
        self.hit = owner
        if depth < before:  # it leads out of something that was put onto the robot
            self._depth = depth
            return True
        self.x, self.y = x, y
        self.linear = 0.0
        self._write_base()
        return True

    def probe(self) -> bool:
        """Whether the robot touches something where it stands; to be asked when the world has changed."""
        depth, owner = self._physics.penetration(self.body)
        self._depth = depth if depth > CONTACT_DEPTH else 0.0
        if self._depth:
            self.hit = owner
        return self._depth > 0

    def _write_base(self) -> None:
        half = self.heading / 2
        self._physics.api.resetBasePositionAndOrientation(
            self.body,
            [self.x, self.y, 0.0],
            [0.0, 0.0, math.sin(half), math.cos(half)],
            physicsClientId=self._physics.client,
        )

    def _write_head(self) -> None:
        for joint, angle in ((self.pan_joint, self.pan), (self.tilt_joint, self.tilt)):
            self._physics.api.resetJointState(self.body, joint, angle, physicsClientId=self._physics.client)


def _clip(value: float, low: float, high: float) -> float:
    return max(low, min(high, value))


def _toward(value: float, goal: float, step: float) -> float:
    return goal if abs(goal - value) <= step else value + math.copysign(step, goal - value)


def _wrap(angle: float) -> float:
    return math.remainder(angle, math.tau)
