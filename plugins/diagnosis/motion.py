"""diagnosis/motion: did the robot move as it was told to?"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from pydantic import Field

from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import Decision, Finding
from dssmsg.review.episode import EpisodeCase, Move
from dssmsg.review.episode_rule import EpisodeRule

LAYER = "control"
_JUMP_M, _JUMP_RAD = 0.4, 0.6
"""More than this in one period no robot of this speed does: the pose is wrong then, not the motion."""


class Config(PluginConfig):
    """Options of the rule `motion`."""

    share: float = Field(
        0.25, gt=0, lt=1, description="How far from what was asked is too far, as a share of it."
    )
    lag_periods: float = Field(
        0.75, ge=0, description="So many periods may pass until the speed follows a command."
    )
    least_metres: float = Field(0.6, gt=0, description="So much must have been asked for to judge, metres.")
    least_degrees: float = Field(40.0, gt=0, description="So much turning must have been asked for, degrees.")
    drift_degrees: float = Field(
        3.0, gt=0, description="Degrees a period off the commanded turn, on average, that are too many."
    )


class MotionRule(EpisodeRule[Config]):
    """Adds up what commands asked for and what the poses say was done."""

    def findings(self, case: EpisodeCase) -> Sequence[Finding]:
        """At most one finding each for driving, for turning, and for veering off."""
        moves = [
            move
            for move in case.moves
            if not move.collided
            and abs(move.moved_m - abs(move.asked_m)) < _JUMP_M
            and abs(math.remainder(move.turned_rad - move.asked_rad, math.tau)) < _JUMP_RAD
        ]
        if len(moves) < 0.5 * len(case.moves):
            return ()
        least = math.radians(self.config.least_degrees)
        return [
            *self._short(
                moves, lambda m: abs(m.asked_m), lambda m: m.moved_m, self.config.least_metres, "metres"
            ),
            *self._short(moves, lambda m: m.asked_rad, lambda m: m.turned_rad, least, "radians of turning"),
            *self._veering(moves),
        ]

    def _short(
        self,
        moves: Sequence[Move],
        asked: Callable[[Move], float],
        done: Callable[[Move], float],
        least: float,
        what: str,
    ) -> Iterator[Finding]:
        """Clearly less, or more, was done than asked for."""
        told = [m for m in moves if asked(m)]
        wanted = sum(abs(asked(m)) for m in told)
        if wanted < least:
            return
        got = sum(math.copysign(1.0, asked(m)) * done(m) for m in told)
        share = got / wanted
        # Speed follows a command with a lag, so that each change of it costs some of the way.
        jolts = sum(
            abs(asked(m) - before) for before, m in zip([0.0, *map(asked, moves)], moves, strict=False)
        )
        if abs(wanted - got) <= self.config.share * wanted + self.config.lag_periods * jolts:
            return
        off = [m for m in told if abs(abs(done(m)) - abs(asked(m))) > self.config.share * abs(asked(m))]
        frame = (off or told)[0].frame
        yield Finding(
            LAYER,
            frame,
            min(0.95, 0.75 + 0.3 * (abs(1.0 - share) - self.config.share)),
            f"commands asked for {wanted:.2f} {what}, the robot did {got:.2f}",
            tuple(f"frame {m.frame}: asked {asked(m):+.3f}, did {done(m):+.3f} {what}" for m in off[:4]),
            decision=Decision(f"{what} done of those asked for", share, 1.0 - self.config.share),
        )

    def _veering(self, moves: Sequence[Move]) -> Iterator[Finding]:
        """It turns by itself, always to the same side."""
        driven = [m for m in moves if abs(m.asked_m) > 0.02]
        if len(driven) < 8:
            return
        off = [math.degrees(math.remainder(m.turned_rad - m.asked_rad, math.tau)) for m in driven]
        mean = sum(off) / len(off)
        if abs(mean) <= self.config.drift_degrees:
            return
        first = next(m for m, o in zip(driven, off, strict=True) if o * mean > 0)
        yield Finding(
            LAYER,
            first.frame,
            0.85,
            f"while driving it turned {mean:+.1f} degrees a period beside what it was told to",
            (f"frame {first.frame}: the first period that veers off",),
            decision=Decision("degrees a period beside the command", abs(mean), self.config.drift_degrees),
        )


@hookimpl
def register_diagnosis(register: Register) -> None:
    """`motion`: commands against poses."""
    register("motion", MotionRule, config=Config)
