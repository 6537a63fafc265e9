"""perception `recorded`: the detections that an earlier run recorded for the same frames.

Other methods can so be compared on what one perception saw. Frames that perception did not run on then
have no detections now; the source must replay the same recording (or the same frame indices).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field

from dssmsg.errors import InputError, PluginError
from dssmsg.frame import Detection, Frame
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "perception/recorded"


class Config(PluginConfig):
    """Options of the replayed perception."""

    recording: Path = Field(
        description="the .rrd file with the detections (relative to the YAML), or a folder: its newest"
    )


class RecordedPerception:
    """Gives recorded detections by frame index. Raises InputError if the recording has none."""

    def __init__(self, config: Config, context: Context) -> None:
        from dssmsg.recording.newest import newest
        from dssmsg.recording.reader import Recording

        path = context.base_dir / config.recording
        self._recording = Recording.open(newest(path) if path.is_dir() else path)
        if not self._recording.has_detections:
            raise InputError("holds no detections", file=self._recording.path, key="perception.recording")
        self._key_frames = frozenset(self._recording.key_frames)
        self.feature_space: str | None = self._recording.facts["feature_space"]

    def detect(self, frame: Frame) -> Sequence[Detection]:
        """The detections recorded for this frame's index; none where perception did not run.

        Raises PluginError where perception failed on this frame, ValueError if the frame has another size
        than the recorded masks.
        """
        found = self._recording.detections(frame.index)
        if found is None and frame.index in self._key_frames:
            # What failed then has to fail again: no detections is not the same as none seen.
            raise PluginError("failed on this frame when it was recorded", plugin=PLUGIN)
        found = found or []
        for detection in found:
            if detection.mask.shape != frame.depth.shape:
                raise ValueError(
                    f"recorded masks are {detection.mask.shape}, the frame is {frame.depth.shape}: "
                    "does the source replay this recording?"
                )
        return found


@hookimpl
def register_perception(register: Register) -> None:
    """Announce `recorded`."""
    register("recorded", RecordedPerception, config=Config)
