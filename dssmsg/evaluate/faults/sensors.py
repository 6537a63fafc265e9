"""Faults of the environment: lost depth, a pose that jumps or drifts, a way that is closed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dssmsg.evaluate.faults.host import Aim
from dssmsg.evaluate.faults.source import BetweenSource
from dssmsg.frame import FloatArray, Frame


class LostDepth(BetweenSource):
    """The depth camera gives no reading any more."""

    def frame_out(self, frame: Frame) -> Frame:
        """The frame without depth."""
        return replace(frame, depth=np.zeros_like(frame.depth))


class PoseJump(BetweenSource):
    """After a while every pose is displaced and turned."""

    def frame_out(self, frame: Frame) -> Frame:
        """The frame from another pose."""
        if self.since < 3:
            return frame
        rng = np.random.default_rng(self.aim.seed)
        bearing, turn = rng.uniform(0, math.tau), rng.uniform(0.3, 0.9) * rng.choice([-1.0, 1.0])
        shift = rng.uniform(1.0, 2.0)
        return _displaced(frame, shift * math.cos(bearing), shift * math.sin(bearing), turn)


class PoseDrift(BetweenSource):
    """The pose drifts away, a little every frame."""

    def frame_out(self, frame: Frame) -> Frame:
        """The frame from a pose that is a little more off."""
        rng = np.random.default_rng(self.aim.seed)
        bearing, side = rng.uniform(0, math.tau), rng.choice([-1.0, 1.0])
        away = min(0.03 * self.since, 2.5)
        return _displaced(
            frame, away * math.cos(bearing), away * math.sin(bearing), side * min(0.008 * self.since, 0.7)
        )


def closed_doors(aim: Aim) -> Mapping[str, Any]:
    """Source options by which something stands in every door of the target's room."""
    return {"obstacles": [dict(one) for one in aim.barriers]}


def _displaced(frame: Frame, dx: float, dy: float, turn: float) -> Frame:
    """The frame with its poses turned about the robot and shifted on the floor, metres and radians."""
    x, y = frame.world_from_base[:2, 3]
    about: FloatArray = np.eye(4)
    cos, sin = math.cos(turn), math.sin(turn)
    about[:2, :2] = [[cos, -sin], [sin, cos]]
    about[:2, 3] = [x + dx - cos * x + sin * y, y + dy - sin * x - cos * y]
    return replace(
        frame,
        world_from_base=about @ frame.world_from_base,
        world_from_camera=about @ frame.world_from_camera,
    )
