"""diagnosis/route: was the way planned over the map as it was, and to the place that was asked for?"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import Field

from dssmsg.graph.nodes import DISAPPEARED
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import Decision, Finding
from dssmsg.review.episode import EpisodeCase
from dssmsg.review.episode_rule import EpisodeRule

LAYER = "planner"
_VIEWPOINT = re.compile(r"viewpoint-[0-9.]*[0-9]")


class Config(PluginConfig):
    """Options of the rule `route`."""

    near: float = Field(
        1.0, gt=0, description="So near to the viewpoint a drive must end that arrived, metres."
    )


class RouteRule(EpisodeRule[Config]):
    """Plans over the recorded map once more, and looks where the drive ended."""

    def findings(self, case: EpisodeCase) -> Sequence[Finding]:
        """Findings: no way found where there is one; another goal than asked; arrived somewhere else."""
        if not case.candidates:
            return ()
        return [*self._no_path(case), *self._other_goal(case), *self._elsewhere(case)]

    def _no_path(self, case: EpisodeCase) -> Iterator[Finding]:
        """Given up for want of a way, though free edges lead to a candidate."""
        if case.reason not in ("no path", "navigation failed"):
            return
        history = case.recording.history
        end = case.driving[-1] if case.driving else None
        frame = case.last if end is None else end["frame"]
        x, y, _ = case.recording.floor_pose(frame)
        away = {name: math.dist((x, y), place) for name, place in history.places.items()}
        nearest = sorted(away, key=lambda name: away[name])[:3]
        nearest = [name for name in nearest if name == nearest[0] or away[name] <= self.config.near]
        for one in case.candidates[:5]:
            goal = history.viewpoints.get(one["viewpoint"])
            start = next((w for w in nearest if goal and history.connected(w, goal, frame)), None)
            if start is None:
                continue
            yield Finding(
                LAYER,
                frame,
                0.9,
                f"no way was found to {one['viewpoint']}, though free edges lead from {start} to {goal}",
                (f"frame {frame}: {end['state']} {end['detail']}" if end else f"frame {frame}: gave up",),
                focus=str(goal),
                decision=Decision("metres to the waypoint it begins at", away[start], self.config.near),
            )
            return

    def _other_goal(self, case: EpisodeCase) -> Iterator[Finding]:
        """A way that leads elsewhere, though free edges lead to the best candidate that is worth trying."""
        history = case.recording.history
        best = next((one for one in case.candidates if _worth_trying(case, one)), case.candidates[0])
        goal = history.viewpoints.get(best["viewpoint"])
        row, way = next(((row, way) for row in case.driving if (way := _way(case, row))), (None, ()))
        if row is None or goal is None or way[-1] == goal:
            return
        if not history.connected(way[0], goal, row["frame"]):
            return
        yield Finding(
            LAYER,
            row["frame"],
            0.85,
            f"the way leads to {way[-1]}, though free edges lead to {goal}, the best candidate's",
            (
                f"frame {row['frame']}: {best['viewpoint']} at {goal} came first: {best['reason']}",
                f"frame {row['frame']}: {row['state']} {row['detail']} of a way to {way[-1]}",
            ),
            focus=way[-1],
        )

    def _elsewhere(self, case: EpisodeCase) -> Iterator[Finding]:
        """It looked for the target from a place that is not the viewpoint's."""
        goal = case.recording.history.poses.get(case.driven_to)
        looks = [row["frame"] for row in case.driving if row["state"] == "look"]
        if goal is None or not looks:
            return
        x, y, _ = case.recording.floor_pose(looks[-1])
        away = math.dist((x, y), goal)
        if away > self.config.near:
            yield Finding(
                LAYER,
                looks[-1],
                0.85,
                f"it looked for the target {away:.1f} m away from {case.driven_to}, its viewpoint",
                (f"frame {looks[-1]}: at ({x:.2f}, {y:.2f}) m, not ({goal[0]:.2f}, {goal[1]:.2f}) m",),
                focus=case.driven_to,
                decision=Decision("metres from the viewpoint", away, self.config.near),
            )


def _way(case: EpisodeCase, row: Mapping[str, Any]) -> Sequence[str]:
    """The waypoints ahead; who looks along a viewpoint without having driven is there. Empty if unknown."""
    if row["path"]:
        return [str(name) for name in row["path"]]
    viewpoint = _VIEWPOINT.search(row["detail"]) if row["state"] == "look" else None
    there = case.recording.history.viewpoints.get(viewpoint.group()) if viewpoint else None
    return () if there is None else (there,)


def _worth_trying(case: EpisodeCase, candidate: Mapping[str, Any]) -> bool:
    """Whether what it takes for the target is not called gone."""
    core = str(case.match["target"]["core"]) if case.match else ""
    thing = case.recording.history.objects.get(candidate["matching"].get(core, ""))
    return thing is None or thing.value("state", case.before) != DISAPPEARED


@hookimpl
def register_diagnosis(register: Register) -> None:
    """`route`: the planned way against the map."""
    register("route", RouteRule, config=Config)
