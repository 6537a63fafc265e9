"""diagnosis/depth: did the depth camera give readings where things were seen?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from dssmsg.errors import InputError
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import Decision, Finding
from dssmsg.review.episode import EpisodeCase
from dssmsg.review.episode_rule import EpisodeRule
from dssmsg.review.episode_truth import spread

LAYER = "environment"


class Config(PluginConfig):
    """Options of the rule `depth`."""

    read_share: float = Field(0.2, gt=0, lt=1, description="So few pixels with a reading are too few.")
    frames: int = Field(
        16, ge=2, description="Key frames that are looked at, spread until the episode's end."
    )
    lost_share: float = Field(0.2, gt=0, le=1, description="In this share of them readings must be missing.")


class DepthRule(EpisodeRule[Config]):
    """Looks at some depth images."""

    def findings(self, case: EpisodeCase) -> Sequence[Finding]:
        """One finding where depth was lost in a good part of the frames, or in those of the episode."""
        asked = [f for f in case.recording.key_frames if f <= case.last]
        half = self.config.frames // 2
        chosen = sorted({*spread(asked, half), *spread([*case.frames], half)})
        shares = {frame: share for frame in chosen if (share := _read(case, frame)) is not None}
        lost = [frame for frame, share in shares.items() if share < self.config.read_share]
        if len(lost) < max(2, self.config.lost_share * len(shares)):
            return ()
        frame = self._first(case, lost[0], [f for f in shares if f < lost[0]])
        return [
            Finding(
                LAYER,
                frame,
                0.95,
                f"{len(lost)} of {len(shares)} depth images that were looked at have hardly a reading",
                tuple(f"frame {f}: {shares[f]:.0%} of the pixels have depth" for f in lost[:4]),
                decision=Decision("share of pixels with a reading", shares[lost[0]], self.config.read_share),
            )
        ]

    def _first(self, case: EpisodeCase, lost: int, good: Sequence[int]) -> int:
        """The first frame without readings, between the last good one that is known and a lost one."""
        low = max(good, default=-1)
        frames = [f for f in case.recording.frame_indices if low < f <= lost]
        while len(frames) > 1:
            middle = (len(frames) - 1) // 2
            share = _read(case, frames[middle])
            if share is not None and share < self.config.read_share:
                frames = frames[: middle + 1]
            else:
                frames = frames[middle + 1 :]
        return frames[0] if frames else lost


def _read(case: EpisodeCase, frame: int) -> float | None:
    """Share of a frame's pixels with a reading; None where its image was cut off."""
    try:
        depth = case.recording.frame(frame).depth
    except InputError:
        return None
    return float(np.count_nonzero(depth) / depth.size)


@hookimpl
def register_diagnosis(register: Register) -> None:
    """`depth`: readings of the depth camera."""
    register("depth", DepthRule, config=Config)
