"""diagnosis/pose: are the poses of the source true?"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from pydantic import Field

from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import Decision, Finding
from dssmsg.review.episode import EpisodeCase, Move, moves_of
from dssmsg.review.episode_rule import EpisodeRule
from dssmsg.review.episode_truth import inside_share, spread

LAYER = "environment"
_TO_REST = 2
"""Periods in which a robot of this speed has come to rest."""
_LEAST_PERIODS = 4


class Config(PluginConfig):
    """Options of the rule `pose`."""

    jump_metres: float = Field(
        0.3, gt=0, description="So far beside the command in one period is a jump, metres."
    )
    jump_degrees: float = Field(
        25.0, gt=0, description="So much turned beside the command is a jump, degrees."
    )
    drift_metres: float = Field(
        0.01, gt=0, description="So much travelled a period while the wheels stand is a drift, metres."
    )
    inside: float = Field(
        0.6, gt=0, le=1, description="By the truth: this share of what is seen must lie in the true boxes."
    )
    checked: int = Field(24, ge=1, description="Key frames that are held against the truth.")


class PoseRule(EpisodeRule[Config]):
    """By the truth: do pose and depth put things where they are? Without: does the pose jump or drift?"""

    def findings(self, case: EpisodeCase) -> Sequence[Finding]:
        """At most one finding of each kind, over everything until the end of the episode."""
        return [*self._outside(case), *self._jumps(case), *self._drifts(case)]

    def _outside(self, case: EpisodeCase) -> Iterator[Finding]:
        recording = case.recording
        if not recording.has_truth:
            return
        frames = spread(
            [f for f in recording.frame_indices if f <= case.last and f % 5 == 0], self.config.checked
        )
        shares = {f: share for f in frames if (share := inside_share(recording, f)) is not None}
        wrong = [f for f, share in shares.items() if share < self.config.inside]
        if len(wrong) < max(2, 0.1 * len(shares)):
            return
        frame = wrong[0]
        yield Finding(
            LAYER,
            frame,
            min(0.95, 0.8 + 0.1 * len(wrong) / len(shares)),
            f"in {len(wrong)} of {len(shares)} frames pose and depth put things where they are not",
            tuple(f"frame {f}: {shares[f]:.0%} of what is seen lies where it truly is" for f in wrong[:4]),
            decision=Decision("share that lies where it truly is", shares[frame], self.config.inside),
            basis="truth",
        )

    def _jumps(self, case: EpisodeCase) -> Iterator[Finding]:
        frames = [f for f in case.recording.frame_indices if f <= case.last]
        limit = math.radians(self.config.jump_degrees)
        found: list[tuple[Move, float, float]] = []
        for move in moves_of(case.recording, frames):
            beside = move.moved_m - abs(move.asked_m)
            turned = abs(math.remainder(move.turned_rad - move.asked_rad, math.tau))
            if beside > self.config.jump_metres or turned > limit:
                found.append((move, beside, turned))
        if not found or len(found) > 0.2 * len(frames):
            return
        move, beside, turned = found[0]
        yield Finding(
            LAYER,
            move.frame,
            0.9,
            f"the pose jumped by {beside:.2f} m and {math.degrees(turned):.0f} degrees beside the command",
            tuple(
                f"frame {m.frame}: moved {m.moved_m:.2f} m where {m.asked_m:.2f} m were asked for"
                for m, _, _ in found[:4]
            ),
            decision=Decision("metres beside the command in one period", beside, self.config.jump_metres),
        )

    def _drifts(self, case: EpisodeCase) -> Iterator[Finding]:
        """The pose travels on while nothing tells the wheels to drive; noise would go nowhere."""
        recording, metres, periods, first = case.recording, 0.0, 0, -1
        for stretch in _stands(case.moves):
            (x0, y0, _), (x1, y1, _) = (recording.floor_pose(stretch[place].frame) for place in (0, -1))
            away = math.hypot(x1 - x0, y1 - y0)
            if first < 0 and away > self.config.drift_metres * (len(stretch) - 1):
                first = stretch[0].frame
            metres, periods = metres + away, periods + len(stretch) - 1
        if periods < _LEAST_PERIODS or metres <= self.config.drift_metres * periods:
            return
        yield Finding(
            LAYER,
            first,
            0.92,
            f"the pose travelled {metres:.2f} m in {periods} periods in which the wheels were to stand",
            (f"frame {first}: the first stretch of them in which it travels",),
            decision=Decision(
                "metres a period without a command", metres / periods, self.config.drift_metres
            ),
        )


def _stands(moves: Sequence[Move]) -> Iterator[list[Move]]:
    """Stretches in which no command drives and nothing touches the robot, once it has come to rest."""
    stretch: list[Move] = []
    for move in moves:
        if move.command.linear == 0.0 and not move.collided:
            stretch.append(move)
            continue
        if len(stretch) > _TO_REST + 1:
            yield stretch[_TO_REST:]
        stretch = []
    if len(stretch) > _TO_REST + 1:
        yield stretch[_TO_REST:]


@hookimpl
def register_diagnosis(register: Register) -> None:
    """`pose`: jumps of the pose, and poses against the truth."""
    register("pose", PoseRule, config=Config)
