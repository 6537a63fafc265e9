"""The memory of a viewpoint: its last observations, across visits (paper III-A; ALGORITHM A.5, B).

A sliding window a viewpoint. Each of its frames keeps the pose, what depth showed (thinned) and what the
frame said of every object in view; that is enough to ask later whether a place was free before something
stood there. What a question costs depends on the viewpoints around the place, not on how many there are.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dssmsg.frame import FloatArray
from dssmsg.geometry import invert_rigid
from dssmsg.graph.evidence import View
from dssmsg.graph.ids import id_order
from dssmsg.graph.view import GraphView


@dataclass(frozen=True, slots=True, eq=False)
class Remembered:
    """One frame of a window: the view, and object id -> verdict (`dssmsg.graph.evidence`)."""

    viewpoint_id: str
    view: View
    verdicts: Mapping[str, str]


class ViewpointWindows:
    """The windows of all viewpoints; each holds the last `length` frames taken from it."""

    def __init__(self, graph: GraphView, length: int, reach: float) -> None:
        self._graph = graph
        self._length = length
        self._reach = reach
        self._windows: dict[str, deque[Remembered]] = {}

    def add(self, viewpoint_id: str, view: View, verdicts: Mapping[str, str]) -> None:
        """Remember a frame; the oldest of a full window is forgotten."""
        window = self._windows.setdefault(viewpoint_id, deque(maxlen=self._length))
        window.append(Remembered(viewpoint_id, view.thinned(), verdicts))

    def window(self, viewpoint_id: str) -> tuple[Remembered, ...]:
        """A viewpoint's frames, oldest first; empty for one never seen."""
        return tuple(self._windows.get(viewpoint_id, ()))

    def looking_at(self, box_min: FloatArray, box_max: FloatArray, before_frame: int) -> Iterator[Remembered]:
        """Frames earlier than `before_frame` whose image holds some of a box, corners (3,); nearest first."""
        centre = (box_min + box_max) / 2.0
        corners = [np.where(pick, box_max, box_min) for pick in np.ndindex(2, 2, 2)]
        spots = np.array([centre, *corners])
        earlier = [
            remembered
            for viewpoint_id in self._graph.viewpoints_near(centre, self._reach)
            for remembered in self._windows.get(viewpoint_id, ())
            if remembered.view.frame < before_frame
        ]
        holding = _hold([remembered.view for remembered in earlier], spots)
        found = [remembered for remembered, holds in zip(earlier, holding, strict=True) if holds]
        found.sort(
            key=lambda r: (
                float(np.linalg.norm(r.view.world_from_camera[:3, 3] - centre)),
                -r.view.frame,
                id_order(r.viewpoint_id),
            )
        )
        return iter(found)

    def forget_removed(self) -> None:
        """Drop the windows of viewpoints that have left the graph."""
        for viewpoint_id in [i for i in self._windows if i not in self._graph.viewpoints]:
            del self._windows[viewpoint_id]


def _hold(views: Sequence[View], spots: FloatArray) -> list[bool]:
    """Of each view, whether any of the spots (N, 3) falls inside its image."""
    if not views:
        return []
    camera_from_world = invert_rigid(np.stack([view.world_from_camera for view in views]))
    rotation, position = camera_from_world[:, :3, :3], camera_from_world[:, None, :3, 3]
    x, y, z = np.moveaxis(spots @ np.swapaxes(rotation, 1, 2) + position, -1, 0)  # (views, N) each
    cameras = [view.camera for view in views]
    fx, fy, cx, cy, width, height = np.array(
        [(one.fx, one.fy, one.cx, one.cy, one.width, one.height) for one in cameras]
    ).T[:, :, None]
    before = z > 0
    ahead = np.where(before, z, 1.0)
    u, v = x / ahead * fx + cx, y / ahead * fy + cy
    inside = before & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    holding: list[bool] = inside.any(axis=1).tolist()
    return holding
