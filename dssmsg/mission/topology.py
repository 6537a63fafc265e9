"""The waypoint topology kept true frame by frame: a floor plan from depth, and what it says of the edges."""

from __future__ import annotations

from typing import Protocol

from dssmsg.frame import Frame
from dssmsg.graph.changes import Change
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.topology import Floor, TopologyMaintenance, TopologyOptions
from dssmsg.graph.view import GraphView


class FloorPlan(Floor, Protocol):
    """A floor plan in the making: `dssmsg.navigation.grid.RollingGrid`."""

    def forget(self) -> None:
        """Begin with an empty floor plan."""
        ...

    def observe(self, frame: Frame) -> None:
        """Take in a frame's depth."""
        ...


class TopologyKeeper:
    """Feeds every frame to a floor plan and asks the maintenance what follows."""

    def __init__(
        self,
        graph: GraphView,
        ids: IdAllocator,
        floor: FloorPlan,
        options: TopologyOptions | None = None,
    ) -> None:
        self._graph = graph
        self._grid = floor
        self._maintenance = TopologyMaintenance(graph, ids, self._grid, options)
        self._visit: int | None = None

    def observe(self, frame: Frame, *, key: bool, viewpoint_id: str | None) -> tuple[Change, ...]:
        """The changes after a frame; on a key frame loop closures are looked for too."""
        if frame.visit != self._visit:
            self._grid.forget()
            self._visit = frame.visit
        self._grid.observe(frame)
        viewpoint = None if viewpoint_id is None else self._graph.viewpoints.get(viewpoint_id)
        return self._maintenance.observe(
            frame.world_from_base[:3, 3],
            closures=key,
            keep=None if viewpoint is None else viewpoint.waypoint_id,
        )
