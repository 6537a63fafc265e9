"""source `recording`: the frames of an earlier run, in order, as they were captured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field

from dssmsg.errors import InputError
from dssmsg.frame import Frame
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.source import Command, SourceInfo

if TYPE_CHECKING:
    from dssmsg.interfaces import Context


class Config(PluginConfig):
    """Options of the replaying source."""

    recording: Path = Field(
        description="the .rrd file to replay (relative to the configuration file), or a folder: its newest"
    )
    start: int = Field(default=0, ge=0, description="first frame index to give")
    stop: int | None = Field(
        default=None, ge=1, description="frame index to stop before; none: the last one too"
    )
    key_frames: bool = Field(
        default=False, description="give only the frames that perception ran on: all that the map needs"
    )
    truth: bool = Field(default=True, description="give the recorded truth to plug-ins that may see it")


class RecordedSource:
    """Gives recorded frames. Commands are ignored: what the robot did is done.

    Raises InputError if the recording does not read or holds no frame in the range.
    """

    def __init__(self, config: Config, context: Context) -> None:
        from dssmsg.recording.newest import newest
        from dssmsg.recording.reader import Recording

        path = context.base_dir / config.recording
        self._recording = Recording.open(newest(path) if path.is_dir() else path)
        recording = self._recording
        stop = config.stop
        indices = [
            i for i in recording.readable_frame_indices if i >= config.start and (stop is None or i < stop)
        ]
        if config.key_frames:
            keys = frozenset(recording.key_frames)
            indices = [i for i in indices if i in keys]
        if not indices:
            recording.close()
            raise InputError(
                f"holds no frame from {config.start} on" + ("" if stop is None else f" and before {stop}"),
                file=recording.path,
                key="source.start",
            )
        self._visits: dict[int, list[int]] = {}
        for index in indices:
            self._visits.setdefault(recording.visit(index), []).append(index)
        self._order = sorted(self._visits)
        self._pending: list[int] = []
        self._latest = indices[0]
        self._moved = False
        recorded = recording.facts["source"]
        self._with_truth = config.truth and bool(recorded["has_truth"])
        camera = recording.camera()
        assert camera is not None  # there are frames
        self._info = SourceInfo(
            name="recording",
            camera=camera,
            drivable=False,
            has_truth=self._with_truth,
            visits=len(self._order),
            rate_hz=recorded["rate_hz"],
            scene=recorded["scene"],
            credits=tuple(recorded["credits"]),
            depth_noise_m=tuple(recorded["depth_noise_m"]),
            # Recordings from before these were recorded: what the interface says of any robot.
            accelerations=tuple(recorded.get("accelerations", (1.0, 3.0))),
            facts={**recorded["facts"], "parent": recording.facts["run_id"], "recorded_by": recorded["name"]},
        )

    @property
    def info(self) -> SourceInfo:
        """What the recorded source said of itself, but that it cannot be driven."""
        return self._info

    def start_visit(self, visit: int) -> None:
        """Begin the recording's pass of this number, counted from 0. Raises InputError if there is none."""
        if not 0 <= visit < len(self._order):
            raise InputError(
                f"holds {len(self._order)} visit(s); there is no visit {visit}", file=self._recording.path
            )
        self._pending = self._visits[self._order[visit]][::-1]

    def step(self, command: Command | None) -> Frame | None:
        """The next frame of the pass; None when there is none."""
        del command
        if not self._pending:
            return None
        index = self._latest = self._pending.pop()
        self._moved = True
        return self._recording.frame(index, with_truth=self._with_truth, lazy=True)

    def collisions(self) -> int:
        """What the recorded source had counted by the latest frame."""
        return self._recording.collisions(self._latest) if self._moved else 0

    def close(self) -> None:
        """Release the recording; safe to call twice."""
        self._recording.close()


@hookimpl
def register_source(register: Register) -> None:
    """Announce `recording`."""
    register("recording", RecordedSource, config=Config)
