"""Source `rgbd`: folders of posed RGB-D frames, one visit a folder, the world turned z up, its floor at 0.

Depth images are taken to be aligned with the colour images (same centre, same axes), as all the known layouts
publish them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from dssmsg.errors import InputError
from dssmsg.frame import ByteArray, Camera, FloatArray, Frame, quantise_depth
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.source import Command, SourceInfo
from dssmsg.sequences.detect import LAYOUTS, read_folder
from dssmsg.sequences.sequence import Intrinsics, Sequence, View

if TYPE_CHECKING:
    from dssmsg.interfaces import Context
    from dssmsg.sequences.upright import Surfaces

Positive = Annotated[float, Field(gt=0)]
_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_DEFAULT_WIDTH = 640
_GRAVITY_VIEWS = 32
_PAUSE_SECS = 1.0  # of sim time between two visits


class Config(PluginConfig):
    """Options of `source: {use: rgbd}`."""

    path: str | tuple[str, ...] = Field(
        description="folder of a sequence, or several in order: one visit each, all in one world frame"
    )
    layout: str = Field("auto", description=f"auto, or one of {', '.join(LAYOUTS)}")
    depth_scale: Positive | None = Field(None, description="depth units a metre, instead of the layout's")
    intrinsics: tuple[Positive, Positive, float, float] | None = Field(
        None, description="[fx, fy, cx, cy] in pixels of the colour image on disk, instead of the layout's"
    )
    up: Literal["auto", "estimate", "x", "y", "z", "-x", "-y", "-z"] = Field(
        "auto",
        description="world axis of the poses that points up; auto: the layout's axis if the images agree "
        "within 15 degrees, else estimated from them",
    )
    floor: Literal["auto"] | float = Field(
        "auto",
        description="height of the floor along the up axis in the poses' world, metres; auto: estimated",
    )
    pose: Literal["auto", "world_from_camera", "camera_from_world"] = Field(
        "auto", description="what the pose files hold; auto: as the layout says (camera to world)"
    )
    camera_axes: Literal["auto", "opencv", "opengl"] = Field(
        "auto", description="camera axes of the poses: opencv looks along +z, y down; opengl along -z, y up"
    )
    size: Literal["auto", "keep"] | tuple[Annotated[int, Field(ge=16)], Annotated[int, Field(ge=16)]] = Field(
        "auto", description="[width, height] of the frames; keep: as on disk; auto: at most 640 wide"
    )
    stride: int = Field(1, ge=1, description="take every n-th frame")
    max_frames: int | None = Field(None, ge=1, description="at most this many frames a visit")
    rate_hz: Positive | None = Field(
        None, description="frames a second on disk, where the layout has no clock"
    )

    @field_validator("path")
    @classmethod
    def _not_empty(cls, value: str | tuple[str, ...]) -> str | tuple[str, ...]:
        if not value or (not isinstance(value, str) and not all(value)):
            raise ValueError("expected a folder, or a list of folders")
        return value

    @field_validator("layout")
    @classmethod
    def _known_layout(cls, value: str) -> str:
        if value != "auto" and value not in LAYOUTS:
            raise ValueError(f"expected auto or one of {', '.join(LAYOUTS)}, got {value!r}")
        return value


@dataclass(frozen=True, slots=True, eq=False)
class _Shot:
    """A view that can be used; world_from_camera (4, 4) in the files' world, OpenCV camera axes."""

    color: Path
    depth: Path
    world_from_camera: FloatArray
    intrinsics: Intrinsics


class _Visit:
    """One folder, ready to give frames: its shots, when each was taken, their sizes and cameras."""

    def __init__(self, sequence: Sequence, config: Config) -> None:
        from dssmsg.sequences.images import image_size, read_depth
        from dssmsg.sequences.resample import scaled_camera

        self.sequence = sequence
        self._config = config
        self.without_depth = sum(v.depth is None for v in sequence.views)
        self.invalid_poses = sum(v.world_from_camera is None for v in sequence.views)
        usable = [
            (place, self._shot(view, view.depth, view.world_from_camera), view.time_secs)
            for place, view in enumerate(sequence.views)
            if view.depth is not None and view.world_from_camera is not None
        ]
        if not usable:
            raise InputError("no frame has both a depth image and a valid pose", file=sequence.folder)
        usable = usable[:: config.stride][: config.max_frames]
        self.shots = tuple(shot for _place, shot, _time in usable)
        rate = config.rate_hz or sequence.rate_hz
        stamps = [None if config.rate_hz else time for _place, _shot, time in usable]
        clock = [time for time in stamps if time is not None]
        times = clock if len(clock) == len(usable) else [place / rate for place, _shot, _time in usable]
        self.times = tuple(time - times[0] for time in times)
        if not np.isfinite(self.times).all():
            raise InputError("a frame's time is not a finite number: give rate_hz", file=sequence.folder)
        steps = np.diff(self.times)
        if (steps <= 0).any():
            raise InputError("the times of the frames do not increase: give rate_hz", file=sequence.folder)
        self.rate_hz = float(1 / np.median(steps)) if len(steps) else rate
        self.color_size = image_size(self.shots[0].color)
        published = None if config.intrinsics else sequence.published_size
        if published not in (None, self.color_size):
            raise InputError(
                "the known intrinsics are for {}x{} pixels, the images have {}x{}: "
                "give [fx, fy, cx, cy]".format(*published, *self.color_size),
                file=sequence.folder,
                key="source.intrinsics",
            )
        depth = read_depth(self.shots[0].depth, self.depth_scale, sequence.raw_depth_size)
        self.depth_size = (depth.shape[1], depth.shape[0])
        self.out_size = _out_size(self.color_size, config)
        self.camera = scaled_camera(*self.color_size, self.shots[0].intrinsics, self.out_size)

    @property
    def depth_scale(self) -> float:
        """Depth units a metre."""
        return self._config.depth_scale or self.sequence.depth_scale

    def cameras(self, shot: _Shot) -> tuple[Camera, Camera]:
        """The frame's camera and that of the depth image on disk."""
        from dssmsg.sequences.resample import scaled_camera

        own = self.sequence.depth_intrinsics if self._config.intrinsics is None else None
        depth_camera = (
            scaled_camera(*self.color_size, shot.intrinsics, self.depth_size)
            if own is None
            else scaled_camera(*self.depth_size, own, self.depth_size)
        )
        return scaled_camera(*self.color_size, shot.intrinsics, self.out_size), depth_camera

    def depth(self, shot: _Shot) -> FloatArray:
        """The depth image (H, W) metres as on disk; InputError if its size is not that of the first one."""
        from dssmsg.sequences.images import read_depth

        depth = read_depth(shot.depth, self.depth_scale, self.sequence.raw_depth_size)
        self._check_size(shot.depth, (depth.shape[1], depth.shape[0]), self.depth_size)
        return depth

    def images(self, shot: _Shot) -> tuple[ByteArray, FloatArray, Camera]:
        """rgb (H, W, 3), depth (H, W) metres and their common camera."""
        from dssmsg.sequences.images import read_rgb
        from dssmsg.sequences.resample import resample_depth, resize_rgb

        rgb = read_rgb(shot.color)
        self._check_size(shot.color, (rgb.shape[1], rgb.shape[0]), self.color_size)
        camera, depth_camera = self.cameras(shot)
        return resize_rgb(rgb, self.out_size), resample_depth(self.depth(shot), depth_camera, camera), camera

    def _shot(self, view: View, depth: Path, pose: FloatArray) -> _Shot:
        if self._config.pose == "camera_from_world":
            rotation = pose[:3, :3].T
            pose = np.block([[rotation, -rotation @ pose[:3, 3:]], [np.zeros((1, 3)), np.ones((1, 1))]])
        axes = self.sequence.camera_axes if self._config.camera_axes == "auto" else self._config.camera_axes
        if axes == "opengl":
            pose = pose @ _OPENCV_FROM_OPENGL
        intrinsics = self._config.intrinsics or view.intrinsics or self.sequence.intrinsics
        if intrinsics is None:
            raise InputError(
                "the intrinsics are not known: give [fx, fy, cx, cy]",
                file=self.sequence.folder,
                key="source.intrinsics",
            )
        return _Shot(view.color, depth, pose, intrinsics)

    def _check_size(self, path: Path, size: tuple[int, int], expected: tuple[int, int]) -> None:
        if size != expected:
            raise InputError(
                f"expected {expected[0]}x{expected[1]} pixels, got {size[0]}x{size[1]}", file=path
            )


class RgbdSource:
    """Frames of posed RGB-D folders, in order; commands are ignored."""

    def __init__(self, config: Config, context: Context) -> None:
        paths = (config.path,) if isinstance(config.path, str) else config.path
        folders = [context.base_dir / Path(path).expanduser() for path in paths]
        self._visits = [
            _Visit(read_folder(folder, config.layout, key="source.path"), config) for folder in folders
        ]
        for visit in self._visits[1:]:
            if visit.out_size != self._visits[0].out_size:
                raise InputError(
                    "frames of {}x{} after frames of {}x{}: give one size for all".format(
                        *visit.out_size, *self._visits[0].out_size
                    ),
                    file=visit.sequence.folder,
                    key="source.size",
                )
        self._world_from_files, how = _upright(self._visits, config)
        self._visit = -1
        self._next = 0
        facts = self._facts(how)
        for visit in self._visits:
            skipped = visit.invalid_poses + visit.without_depth
            if skipped:
                context.log.warning(
                    "%s: left out %d frames with an invalid pose and %d without depth, of %d",
                    visit.sequence.folder,
                    visit.invalid_poses,
                    visit.without_depth,
                    len(visit.sequence.views),
                )
        if how.get("warning"):
            context.log.warning("%s", how["warning"])
        first = self._visits[0]
        self._info = SourceInfo(
            name="rgbd",
            camera=first.camera,
            drivable=False,
            has_truth=False,
            visits=len(self._visits),
            rate_hz=first.rate_hz,
            scene=first.sequence.folder.resolve().name,
            depth_noise_m=first.sequence.depth_noise_m,
            facts=facts,
        )

    @property
    def info(self) -> SourceInfo:
        """What the folders hold; `facts` count what was left out and say which way up was found."""
        return self._info

    def start_visit(self, visit: int) -> None:
        """Begin the given folder from its first frame."""
        if not 0 <= visit < len(self._visits):
            raise ValueError(f"visit: expected 0..{len(self._visits) - 1}, got {visit}")
        self._visit, self._next = visit, 0

    def step(self, command: Command | None) -> Frame | None:
        """The next frame of the visit, None after its last. Raises InputError for an unreadable image."""
        if self._visit < 0:
            self.start_visit(0)
        visit = self._visits[self._visit]
        if self._next >= len(visit.shots):
            return None
        number, shot = self._next, visit.shots[self._next]
        self._next += 1
        rgb, depth, camera = visit.images(shot)
        world_from_camera = self._world_from_files @ shot.world_from_camera
        before = self._visits[: self._visit]
        return Frame(
            index=sum(len(v.shots) for v in before) + number,
            sim_time=sum(v.times[-1] + _PAUSE_SECS for v in before) + visit.times[number],
            rgb=rgb,
            depth=quantise_depth(depth),
            camera=camera,
            world_from_camera=world_from_camera,
            world_from_base=_base_below(world_from_camera),
            visit=self._visit,
            at_stop=True,  # a camera carried by hand looks all the time
        )

    def collisions(self) -> int:
        """A recorded sequence touches nothing."""
        return 0

    def close(self) -> None:
        """Nothing is held open."""

    def _facts(self, how: dict[str, Any]) -> dict[str, Any]:
        return {
            "layouts": [visit.sequence.layout for visit in self._visits],
            "folders": [str(visit.sequence.folder) for visit in self._visits],
            "frames": [len(visit.shots) for visit in self._visits],
            "invalid_poses": [visit.invalid_poses for visit in self._visits],
            "without_depth": [visit.without_depth for visit in self._visits],
            **how,
        }


def _out_size(size: tuple[int, int], config: Config) -> tuple[int, int]:
    if isinstance(config.size, tuple):
        return config.size
    width, height = size
    if config.size == "keep" or width <= _DEFAULT_WIDTH:
        return size
    return _DEFAULT_WIDTH, max(1, round(height * _DEFAULT_WIDTH / width))


def _base_below(world_from_camera: FloatArray) -> FloatArray:
    """The pose (4, 4) on the floor below a camera, x along its heading."""
    forward = world_from_camera[:3, 2]
    if math.hypot(forward[0], forward[1]) < 1e-6:
        forward = -world_from_camera[:3, 1] * math.copysign(1.0, -forward[2])
    heading = math.atan2(forward[1], forward[0])
    base = np.eye(4)
    base[:2, :2] = [[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]]
    base[:2, 3] = world_from_camera[:2, 3]
    return base


def _surfaces(visits: list[_Visit]) -> Surfaces:
    """Surface samples of some frames, spread evenly over all visits."""
    from dssmsg.sequences.upright import joined, surface_samples

    shots = [(visit, shot) for visit in visits for shot in visit.shots]
    chosen = np.unique(np.linspace(0, len(shots) - 1, min(_GRAVITY_VIEWS, len(shots))).round().astype(int))
    return joined(
        [
            surface_samples(visit.depth(shot), visit.cameras(shot)[1], shot.world_from_camera)
            for visit, shot in (shots[i] for i in chosen)
        ]
    )


def _upright(visits: list[_Visit], config: Config) -> tuple[FloatArray, dict[str, Any]]:
    """The (4, 4) motion that puts the files' world upright with its floor at z = 0, and how it was found."""
    from dssmsg.sequences.upright import AXES, SNAP_RAD, estimate_up, floor_height, rotation_to_z

    surfaces = _surfaces(visits)
    poses = np.stack([shot.world_from_camera for visit in visits for shot in visit.shots])
    warning = ""
    if config.up in AXES:
        up, how = np.array(AXES[config.up]), "given"
    else:
        up, how = estimate_up(surfaces.normals, poses[:, :3, :3]), "estimated"
        promised = visits[0].sequence.up if config.up == "auto" else None
        if promised is not None:
            angle = math.acos(min(1.0, max(-1.0, float(up @ np.array(AXES[promised])))))
            if angle <= SNAP_RAD:
                up, how = np.array(AXES[promised]), f"{visits[0].sequence.layout} layout"
            else:
                warning = (
                    f"the {visits[0].sequence.layout} layout says {promised} is up, but the images say "
                    f"{np.round(up, 2).tolist()}, {math.degrees(angle):.0f} degrees off: using the images; "
                    "source.up overrides"
                )
    if isinstance(config.floor, str):
        floor = floor_height(surfaces, up, float((poses[:, :3, 3] @ up).min()))
    else:
        floor = config.floor
    upright = np.eye(4)
    upright[:3, :3] = rotation_to_z(up)
    upright[2, 3] = -floor
    facts = {"up": [round(float(c), 4) for c in up], "up_from": how, "floor": round(floor, 4)}
    return upright, {**facts, "warning": warning} if warning else facts


@hookimpl
def register_source(register: Register) -> None:
    """`rgbd`: posed RGB-D folders."""
    register("rgbd", RgbdSource, config=Config)
