"""The simulated world: structure, furniture, robot and camera, and what is scripted to happen to them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from dssmsg.frame import Camera, FloatArray, Truth
from dssmsg.interfaces.source import Command
from dssmsg.sim.camera import Instance, Render, Renderer
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.obstacles import Obstacles
from dssmsg.sim.occupancy import blocks
from dssmsg.sim.physics import PHYSICS_HZ, Physics
from dssmsg.sim.robot import ACTION_STEPS, Robot, RobotSpec
from dssmsg.sim.scene import Change, DoorChange, LightChange, Scene
from dssmsg.sim.scene_layout import build_layout
from dssmsg.sim.scene_placement import Placed, Placer
from dssmsg.sim.script import Script, changed
from dssmsg.sim.truth import TruthLog


class World:
    """A scene that can be driven through and looked at. Metres, radians, seconds; world z up.

    Raises InputError when the scene cannot be built. Same scene, library and commands: same states.
    """

    def __init__(
        self,
        scene: Scene,
        library: FurnitureLibrary,
        renderer: Renderer,
        *,
        robot: RobotSpec | None = None,
        scripted: bool = True,
    ) -> None:
        self.scene = scene
        self.renderer = renderer
        self.layout = build_layout(scene)
        self.placer = Placer(scene, library)
        self.pieces: dict[str, Placed] = self.placer.initial()
        self.truth_log = TruthLog(self.pieces)
        self.sim_time = 0.0
        self.visit = -1
        self.collisions = 0
        self._script = Script(scene, enabled=scripted)
        self._obstacles = Obstacles(scene, self.placer, self.layout.solids)
        self._visit_began = 0.0
        self._light = 1.0
        self._closed: set[str] = set()
        self._physics = Physics()
        self._structure = [self._physics.add(solid) for solid in self.layout.solids]
        self._bodies: dict[str, int] = {}
        for piece in self.pieces.values():
            self._add_body(piece)
        self.robot = Robot(self._physics, robot or RobotSpec())
        # What the script touches goes into the renderer's small scene, so that a change costs little.
        self.changing = self._script.touches() | self._obstacles.names()
        self._show_fixed()
        self._show_loose()

    def start_visit(self, visit: int) -> None:
        """Begin a pass: the changes scripted before it are made. The robot stays where it is."""
        self.visit = visit
        self._visit_began = self.sim_time
        self.make(self._script.before(visit))

    def step(self, command: Command, seconds: float) -> None:
        """Let the robot carry out a command, in actions of 0.1 s, and the script go on."""
        left = round(seconds * PHYSICS_HZ)
        while left > 0:
            steps = min(left, ACTION_STEPS)
            self.collisions += self.robot.act(command, steps)
            left -= steps
            self.sim_time += steps / PHYSICS_HZ
            position = (self.robot.x, self.robot.y)
            self.make(self._script.during(self.visit, self.sim_time - self._visit_began, position))
            self.make(self._obstacles.due(self.visit, (*position, self.robot.heading)))

    def make(self, changes: Iterable[Change]) -> None:
        """Carry out changes now, in order."""
        made = False
        for change in changes:
            if isinstance(change, LightChange):
                self._light = change.level
                continue
            if isinstance(change, DoorChange):
                self._turn_door(change)
                continue
            after = changed(self.pieces, change, self.placer)
            for name in sorted(set(self.pieces) | set(after)):
                if self.pieces.get(name) is not after.get(name):
                    if name in self._bodies:
                        self._physics.remove(self._bodies.pop(name))
                    if name in after:
                        self._add_body(after[name])
            self.pieces = after
            made = True
        if made:
            self.truth_log.update(self.pieces)
            self._show_loose()
            self.robot.probe()

    def look(self, camera: Camera, world_from_camera: FloatArray | None = None) -> tuple[Render, Truth]:
        """What the robot's camera (or one at `world_from_camera` (4, 4)) sees now, and the truth of it."""
        pose = self.robot.world_from_camera if world_from_camera is None else world_from_camera
        render = self.renderer.render(camera, pose)
        if self._light != 1.0:
            lit = np.minimum(render.rgb * np.float32(self._light), 255.0).astype(np.uint8)
            render = replace(render, rgb=lit)
        return render, Truth(render.instance_ids, self.truth_log.objects())

    def close(self) -> None:
        """Release physics and renderer; safe to call twice."""
        self._physics.close()
        self.renderer.close()

    def _add_body(self, piece: Placed) -> None:
        if blocks(piece.solid):
            self._bodies[piece.name] = self._physics.add(piece.solid)

    def _turn_door(self, change: DoorChange) -> None:
        """Doors belong to the structure, which is built anew: they only move between visits."""
        (self._closed.add if change.closed else self._closed.discard)(change.door)
        self.layout = build_layout(self.scene, self._closed)
        for body in self._structure:
            self._physics.remove(body)
        self._structure = [self._physics.add(solid) for solid in self.layout.solids]
        self._show_fixed()
        self.robot.probe()

    def _show_fixed(self) -> None:
        structure = Instance(0, self.layout.mesh, np.eye(4))
        fixed = [piece for piece in self.pieces.values() if piece.name not in self.changing]
        self.renderer.set_static([structure, *_instances(fixed)])

    def _show_loose(self) -> None:
        self.renderer.set_movable(_instances(p for p in self.pieces.values() if p.name in self.changing))


def _instances(pieces: Iterable[Placed]) -> list[Instance]:
    return [Instance(piece.instance_id, piece.model.mesh, piece.world_from_object) for piece in pieces]
