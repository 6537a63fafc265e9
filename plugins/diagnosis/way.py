"""diagnosis/way: did something stand in the way, or was it only thought to?"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
from pydantic import Field

from dssmsg.errors import InputError
from dssmsg.geometry import back_project_world
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import Decision, Finding
from dssmsg.review.episode import EpisodeCase
from dssmsg.review.episode_rule import EpisodeRule

_STOPPED = frozenset({"blocked", "no path", "stuck", "out of time", "collision"})
_PLACE = re.compile(r"something at (-?[0-9.]+) (-?[0-9.]+)")


class Config(PluginConfig):
    """Options of the rule `way`."""

    near: float = Field(0.35, gt=0, description="A reading so near to the place is the obstacle, metres.")
    low: float = Field(0.05, ge=0, description="Readings above this height can block the way, metres.")
    high: float = Field(0.9, gt=0, description="Readings below this height can block the way, metres.")
    points: int = Field(20, ge=1, description="So many readings in one frame are something.")


class WayRule(EpisodeRule[Config]):
    """Looks for what blocked the way in the depth images that were taken of it."""

    def findings(self, case: EpisodeCase) -> Sequence[Finding]:
        """Findings: `environment` where depth shows an obstacle, `planner` where it shows nothing there."""
        if not case.failed:
            return ()
        stopped = case.reason in _STOPPED or _turned_away(case)
        return [*(self._obstacles(case) if stopped else ()), *_touched(case)]

    def _obstacles(self, case: EpisodeCase) -> Iterator[Finding]:
        rows = [row for row in case.driving if _PLACE.search(row["detail"])]
        places: dict[tuple[float, float], int] = {}
        for row in rows:
            found = _PLACE.search(row["detail"])
            if found:
                places.setdefault((float(found[1]), float(found[2])), row["frame"])
        shown = {place: self._readings(case, place, frame) for place, frame in places.items()}
        told = {place: points for place, points in shown.items() if points is not None}
        if not told:
            return
        real = {place: points for place, points in told.items() if points >= self.config.points}
        if len(real) >= 0.5 * len(told):
            place, points = next(iter(real.items()))
            frame = places[place]
            names = _names(case, place)
            yield Finding(
                "environment",
                frame,
                0.85 + (0.05 if names else 0.0),
                f"something stood in the way at ({place[0]:.2f}, {place[1]:.2f}) m"
                + (f": {', '.join(names)}" if names else ""),
                tuple(
                    f"frame {places[p]}: {n} readings at ({p[0]:.2f}, {p[1]:.2f}) m"
                    for p, n in list(real.items())[:4]
                ),
                decision=Decision("readings of an obstacle", float(points), float(self.config.points)),
                basis="truth" if names else "recording",
            )
            return
        place = next(p for p in told if p not in real)
        yield Finding(
            "planner",
            places[place],
            0.8,
            f"given up for something at ({place[0]:.2f}, {place[1]:.2f}) m, where depth shows nothing",
            tuple(
                f"frame {places[p]}: {n} readings at ({p[0]:.2f}, {p[1]:.2f}) m"
                for p, n in list(told.items())[:4]
            ),
            decision=Decision("readings of an obstacle", float(told[place]), float(self.config.points)),
        )

    def _readings(self, case: EpisodeCase, place: tuple[float, float], frame: int) -> int | None:
        """Most readings at a place in one of the frames around; None where none of them looks there."""
        best: int | None = None
        around = [f for f in case.recording.frame_indices if frame - 12 <= f <= frame + 16]
        for index in around[::2]:
            try:
                image = case.recording.frame(index)
            except InputError:
                continue
            points = back_project_world(image.depth, image.camera, image.world_from_camera)
            if not len(points):
                continue
            beside = np.linalg.norm(points[:, :2] - np.array(place), axis=1) <= self.config.near
            height = (points[:, 2] > self.config.low) & (points[:, 2] < self.config.high)
            count = int(np.count_nonzero(beside & height))
            if np.count_nonzero(beside) >= self.config.points:
                best = max(best or 0, count)
        return best


def _turned_away(case: EpisodeCase) -> bool:
    """Whether something in the way made the robot go to another place than the best candidate's."""
    stops = case.recording.history.viewpoints
    return (
        bool(case.candidates)
        and any(row["state"] == "replan" and _PLACE.search(row["detail"]) for row in case.driving)
        and stops.get(case.driven_to) != stops.get(str(case.candidates[0]["viewpoint"]))
    )


def _names(case: EpisodeCase, place: tuple[float, float]) -> list[str]:
    """True things at a place that were not there when the run began."""
    at = np.array(place)
    return [
        thing.name
        for thing in case.things
        if thing.state in ("appeared", "moved")
        and (thing.box_min[:2] - 0.4 <= at).all()
        and (at <= thing.box_max[:2] + 0.4).all()
    ]


def _touched(case: EpisodeCase) -> Iterator[Finding]:
    """A collision with something that had not been there, by the truth."""
    hit = case.touched
    if hit is None or not case.things:
        return
    x, y, _ = case.recording.floor_pose(hit.frame)
    names = _names(case, (x, y))
    if names:
        yield Finding(
            "environment",
            hit.frame,
            0.7,
            f"the robot touched {', '.join(names)}, which had not been there",
            (f"frame {hit.frame}: contact at ({x:.2f}, {y:.2f}) m",),
            basis="truth",
        )


@hookimpl
def register_diagnosis(register: Register) -> None:
    """`way`: obstacles that were met, against depth."""
    register("way", WayRule, config=Config)
