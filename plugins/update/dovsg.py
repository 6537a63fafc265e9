"""update/dovsg: DovSG's local update (Yan et al., 2025), a baseline; goes with `association: dovsg`.

On later visits the memory's voxels are held against the depth image; what is seen through is deleted. An
object that lost more than half of itself leaves, another one shrinks. A move is a removal and an addition.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.baselines.depth_test import DepthTest
from dssmsg.frame import Frame, MaskArray, Observation
from dssmsg.geometry import back_project, box_of, transform_points
from dssmsg.graph.changes import Cause, Change, ObjectRemoved, ObjectReplaced, Score
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.update import UpdateResult

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "update/dovsg"


class DovsgUpdateConfig(PluginConfig):
    """DovSG's thresholds at their published values."""

    from_visit: int = Field(1, ge=0, description="The first visit (0 is the survey) that deletes.")
    far: float = Field(0.02, gt=0, description="Depth this far behind a voxel deletes it, metres.")
    near: float = Field(0.01, gt=0, description="Depth this far behind does with another colour, metres.")
    color: float = Field(0.1, ge=0, le=1, description="RGB distance (0..1) that is another colour.")
    max_range: float = Field(5.0, gt=0, description="Voxels farther away are not tested, metres.")
    max_lost: float = Field(
        0.5, ge=0, le=1, description="An object that lost a larger share of its voxels is removed."
    )
    min_points: int = Field(10, ge=1, description="An object with fewer voxels left is removed, too.")


class DovsgUpdate:
    """Deletes what a view sees through; keeps, within a visit, how large each object has been."""

    def __init__(self, config: DovsgUpdateConfig, context: Context) -> None:
        self._config = config
        self._graph = context.graph
        self._test = DepthTest(config.far, config.near, config.color, config.max_range)
        self._visit = -1
        self._largest: dict[str, int] = {}

    def update(
        self,
        frame: Frame,
        observations: Sequence[Observation],
        object_ids: Sequence[str | None],
        viewpoint_id: str | None,
    ) -> UpdateResult:
        """`ObjectRemoved` or `ObjectReplaced` for the objects in view that lost voxels."""
        if frame.visit < self._config.from_visit:
            return UpdateResult()
        if frame.visit != self._visit:
            self._visit, self._largest = frame.visit, {}
        object_ids_in_view = self._in_view(frame)
        if not object_ids_in_view:
            return UpdateResult()
        nodes = [self._graph.objects[object_id] for object_id in object_ids_in_view]
        gone = self._test.gone(
            np.concatenate([node.points for node in nodes]),
            np.concatenate([node.colors for node in nodes]),
            frame,
        )
        changes: list[Change] = []
        ends = np.cumsum([len(node.points) for node in nodes])[:-1]
        for node, lost in zip(nodes, np.split(gone, ends), strict=True):
            largest = max(len(node.points), self._largest.get(node.id, 0))
            self._largest[node.id] = largest
            if lost.any():
                changes.append(self._cut(node.id, ~lost, largest))
        return UpdateResult(tuple(changes))

    def finish(self) -> UpdateResult:
        """Nothing is left to do: every view was worked in when it came."""
        return UpdateResult()

    def _in_view(self, frame: Frame) -> list[str]:
        """Objects whose box touches that of the view's frustum, by their numbers."""
        corners = np.full(frame.depth.shape, False)
        corners[:: frame.camera.height - 1, :: frame.camera.width - 1] = True
        far = np.full(frame.depth.shape, self._config.max_range)
        rim = transform_points(frame.world_from_camera, back_project(far, frame.camera, corners))
        return self._graph.objects_touching(*box_of(np.vstack([rim, frame.position])))

    def _cut(self, object_id: str, left: MaskArray, largest: int) -> Change:
        """The object with only the voxels `left` (N,); none of it where that is too little of `largest`."""
        node = self._graph.objects[object_id]
        count, config = int(np.count_nonzero(left)), self._config
        lost = 1.0 - count / largest
        scores = (
            Score("lost", lost, config.max_lost),
            Score("deleted", float(len(left) - count)),
            Score("voxels", float(count), float(config.min_points)),
        )
        if lost > config.max_lost or count < config.min_points:
            return ObjectRemoved(cause=Cause(PLUGIN, "remove"), scores=scores, object_id=object_id)
        return ObjectReplaced(
            cause=Cause(PLUGIN, "shrink"),
            scores=scores,
            object_id=object_id,
            points=node.points[left],
            colors=node.colors[left],
        )


@hookimpl
def register_update(register: Register) -> None:
    """Announce `dovsg`."""
    register("dovsg", DovsgUpdate, config=DovsgUpdateConfig)
