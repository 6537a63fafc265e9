"""source `pybullet`: a LoCoBot with an RGB-D camera in a simulated, furnished home."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from dssmsg.errors import DssmsgError
from dssmsg.frame import Camera, Frame
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.source import Command, SourceInfo
from dssmsg.sim.scene import Obstacle, generated_seed, load_scene

if TYPE_CHECKING:
    from dssmsg.interfaces import Context, Encoder

ChangeKind = Literal["appear", "disappear", "near", "far", "swap", "put_back", "occluder", "door", "light"]
HORIZONTAL_FOV_RAD = math.radians(69.4)  # RealSense D435, colour


class Config(PluginConfig):
    """Options of the simulated source."""

    scene: str = Field(
        default="rs_int",
        description="rs_int, ihlen_1_int, generated:<seed>, or a scene YAML (relative to the configuration)",
    )
    assets: Literal["auto", "real", "embedded"] = Field(
        default="auto", description="furniture: the real models where installed, or the embedded ones"
    )
    renderer: Literal["auto", "raycast", "tiny"] = Field(
        default="auto", description="camera: Open3D ray casting, or pybullet's TinyRenderer"
    )
    noise: Literal["none", "realistic"] | dict[str, float] = Field(
        default="realistic", description="sensor model: a preset, or a mapping of its options"
    )
    width: int = Field(default=320, ge=32, le=1920, description="image width, pixels")
    height: int = Field(default=240, ge=32, le=1080, description="image height, pixels")
    camera_height: float = Field(
        default=0.88, ge=0.2, le=2.0, description="camera above the floor, metres (0.591 on the real LoCoBot)"
    )
    camera_forward: float = Field(
        default=0.0,
        ge=-0.15,
        le=0.15,
        description="camera ahead of the axis, metres (0.047 on the real LoCoBot)",
    )
    rate_hz: float = Field(default=5.0, ge=1.0, le=30.0, description="camera frames a second of sim time")
    changes: str = Field(
        default="script",
        pattern=r"^(script|none|generated:[0-9]{1,9})$",
        description="script: the scene's own; none; or generated:<seed> instead of its own",
    )
    change_counts: dict[ChangeKind, Annotated[int, Field(ge=0, le=20)]] = Field(
        default={"appear": 2, "disappear": 2, "near": 2, "far": 2},
        description="generated changes: how many of each kind before each visit but the first",
    )
    visits: int = Field(default=2, ge=1, le=20, description="passes through the scene")
    obstacles: tuple[Obstacle, ...] = Field(
        default=(), max_length=50, description="pieces that appear ahead of the robot on its way"
    )

    def problems(self, base_dir: Path, encoder: Encoder | None) -> Sequence[str]:
        """An unknown scene, or a file that is none; a generated one takes too long to try."""
        try:
            if generated_seed(self.scene) is None:
                load_scene(self.scene, base_dir=base_dir)
        except DssmsgError as error:
            inside = None if error.key == "source.scene" else error.key
            return [": ".join(part for part in ("scene", error.file, inside, error.message) if part)]
        return []


class SimulatedSource:
    """Drives the scene's robot and gives a frame at the end of each camera period."""

    def __init__(self, config: Config, context: Context) -> None:
        from dssmsg.sim.camera import make_renderer
        from dssmsg.sim.noise import make_noise
        from dssmsg.sim.obstacles import with_obstacles
        from dssmsg.sim.robot import RobotSpec
        from dssmsg.sim.scenario_source import scripted_scene
        from dssmsg.sim.tour import check_tour, tour_of
        from dssmsg.sim.world import World

        spec = RobotSpec(camera_height=config.camera_height, camera_forward=config.camera_forward)
        scripted = scripted_scene(
            config.scene,
            assets=config.assets,
            changes=config.changes,
            counts={str(kind): count for kind, count in config.change_counts.items()},
            visits=config.visits,
            renderer=config.renderer,
            robot=spec,
            base_dir=context.base_dir,
        )
        library = scripted.library
        scene = with_obstacles(scripted.scene, config.obstacles, library)
        self._noise = make_noise(config.noise)
        renderer, renderer_note = make_renderer(config.renderer)
        self._world = World(scene, library, renderer, robot=spec, scripted=config.changes != "none")
        try:
            check_tour(scene, self._world.layout, self._world.placer, config.visits)
        except Exception:
            self._world.close()
            raise
        self._rng = context.rng
        self._index = 0
        self._period = 1.0 / config.rate_hz
        self._info = SourceInfo(
            name="pybullet",
            camera=Camera.from_fov(config.width, config.height, HORIZONTAL_FOV_RAD),
            drivable=True,
            has_truth=True,
            visits=config.visits,
            rate_hz=config.rate_hz,
            scene=scene.name,
            tours=tuple(tour_of(scene, visit) for visit in range(config.visits)),
            credits=library.credits([self._world.placer.model(piece) for piece in scene.pieces()]),
            depth_noise_m=self._noise.depth_sigma,
            accelerations=(spec.linear_acceleration, spec.angular_acceleration),
            facts={
                "scene": scene.name,
                "rooms": len(scene.rooms),
                "pieces": len(scene.furniture),
                "furniture": library.note,
                "renderer": renderer_note,
                "changes": len(scene.changes) if config.changes != "none" else 0,
                "scenario": scripted.note,
            },
        )
        self._put_at_start()

    @property
    def info(self) -> SourceInfo:
        """What this source is."""
        return self._info

    def start_visit(self, visit: int) -> None:
        """Begin a pass; changes scripted before it are made, the robot stays where it is."""
        self._world.start_visit(visit)

    def step(self, command: Command | None) -> Frame:
        """One camera period of a command (None: stand still), then a frame."""
        world = self._world
        world.step(command or Command(), self._period)
        render, truth = world.look(self._info.camera)
        rgb, depth = self._noise.apply(render, self._rng)
        frame = Frame(
            index=self._index,
            sim_time=world.sim_time,
            rgb=rgb,
            depth=depth,
            camera=self._info.camera,
            world_from_camera=world.robot.world_from_camera,
            world_from_base=world.robot.world_from_base,
            visit=max(world.visit, 0),
            truth=truth,
        )
        self._index += 1
        return frame

    def collisions(self) -> int:
        """Control steps of 0.1 s so far in which the robot touched anything but the floor."""
        return self._world.collisions

    def close(self) -> None:
        """Release the world."""
        self._world.close()

    def _put_at_start(self) -> None:
        """Stand at the first stop, looking at its first view; without a tour, amid the first room."""
        scene, tours = self._world.scene, self._info.tours
        if tours[0]:
            first = tours[0][0]
            self._world.robot.place(first.x, first.y, first.views[0][0])
        else:
            self._world.robot.place(*scene.rooms[0].center, 0.0)


def make_source(config: Config, context: Context) -> SimulatedSource:
    """Build the source; errors name the key of `source` or the scene file."""
    return SimulatedSource(config, context)


@hookimpl
def register_source(register: Register) -> None:
    """Announce `pybullet`."""
    register("pybullet", make_source, config=Config)


__all__ = ["Config", "SimulatedSource", "make_source", "register_source"]
