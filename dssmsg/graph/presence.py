"""Which objects a frame shows, misses or cannot tell of, and for how many frames in a row (ALGORITHM B, C).

`Presence` holds the runs: consecutive informative frames that showed an object's place free, or something of
other colours standing there. A frame without evidence neither lengthens nor ends a run.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dssmsg.frame import ByteArray, Float32Array, FloatArray
from dssmsg.geometry import transform_points
from dssmsg.graph.colors import color_similarities, mean_value
from dssmsg.graph.evidence import (
    PlaceSight,
    SightRule,
    View,
    is_thin,
    look_at_each,
    sampled,
    telling,
    verdict_of,
)
from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import BELIEVED, DISAPPEARED, ObjectNode
from dssmsg.graph.verdicts import MISSED, OUT_OF_VIEW, PRESENT, SEEN, UNKNOWN, Evidence
from dssmsg.graph.view import GraphView

_MIN_COLOR_POINTS = 12
_MIN_LIT_OBJECTS = 3
_DOUBT = 0.1
"""Share shown free from which it is asked whether the rest of the points are the thing's own."""
_ON_NEIGHBOUR = 0.05
"""Metres: two voxels. So near to another object's points a point may be that object's."""


@dataclass(frozen=True, slots=True)
class ColorRule:
    """When a surface counts as another one: s_rgb of what is stored and what is there, at the same pixels."""

    exchanged: float = 0.35
    """Below this the thing that was seen is another one of its kind."""
    changed: float = 0.5
    """Below this a thing too thin for depth, and not detected, is gone from where it lay."""


@dataclass(slots=True)
class _Runs:
    free: list[int] = field(default_factory=list)
    other: list[int] = field(default_factory=list)
    itself: int = -1


class Presence:
    """Asks frames about objects, and keeps what speaks for their absence."""

    def __init__(
        self,
        graph: GraphView,
        noise: tuple[float, float],
        rule: SightRule,
        colors: ColorRule,
        *,
        literal: bool = False,
    ) -> None:
        """`literal`: the paper's rule, by which an expected object that is not detected is missed."""
        self._literal = literal
        self._graph = graph
        self._noise = noise
        self._rule = rule
        self._colors = colors
        self._runs: dict[str, _Runs] = {}
        self._left: dict[str, tuple[Float32Array, ByteArray]] = {}
        self._clouds: dict[str, tuple[Float32Array, Float32Array, ByteArray]] = {}
        self.gain: float | None = None
        """How much brighter than the stored colours this visit's light is; None before anything tells."""

    def begin_visit(self) -> None:
        """The light may be another one."""
        self.gain = None
        self._clouds.clear()

    def look(self, view: View, observed: Collection[str], expected: Collection[str]) -> list[Evidence]:
        """What the view says of every object whose box is in sight, and of the `expected` ones; by id.

        `observed` are the objects that detections of this frame were matched to.
        """
        lowest, highest = frustum_box(view, self._rule.max_range)
        ids = {*self._graph.objects_touching(lowest, highest), *expected}
        nodes = [
            node
            for node in (self._graph.objects.get(object_id) for object_id in sorted(ids, key=id_order))
            if node is not None and node.state != DISAPPEARED
        ]
        clouds = {node.id: self._cloud(node) for node in nodes}
        looks = look_at_each([clouds[node.id][0] for node in nodes], view, self._noise, self._rule)
        sights = dict(zip(clouds, looks, strict=True))
        colors = {node.id: self._seen_colors(clouds[node.id][1], sights[node.id], view) for node in nodes}
        self._follow_light(colors)
        alike = self._likeness(colors)
        found = []
        for node in nodes:
            sight = self._without_neighbours(node, clouds[node.id][0], sights[node.id])
            evidence = self._evidence(node, sight, alike.get(node.id), view, node.id in observed)
            if self._literal and evidence.verdict != SEEN:
                verdict = MISSED if node.id in expected else UNKNOWN
                evidence = replace(evidence, verdict=verdict)
            if evidence.verdict == OUT_OF_VIEW and node.id not in expected:
                continue
            self._note(evidence)
            found.append(evidence)
        return found

    def absent_for(self, object_id: str) -> Sequence[int]:
        """The frames in a row that showed its place free, up to now."""
        runs = self._runs.get(object_id)
        return () if runs is None else runs.free

    def exchanged_for(self, object_id: str) -> Sequence[int]:
        """The frames in a row in which it was matched by something of other colours."""
        runs = self._runs.get(object_id)
        return () if runs is None else runs.other

    def last_itself(self, object_id: str) -> int:
        """The last frame that showed it in place in its own colours; -1 if none did."""
        runs = self._runs.get(object_id)
        return -1 if runs is None else runs.itself

    def end_visit(self) -> None:
        """Remember every object as this visit leaves it."""
        self._left = {node.id: (node.points, node.colors) for node in self._graph.objects.values()}

    def forget(self, object_id: str) -> None:
        """Start anew with an object: it is elsewhere, or another thing."""
        self._runs.pop(object_id, None)
        self._left.pop(object_id, None)
        self._clouds.pop(object_id, None)

    # -----------------------------------------------------------------------------------------------------

    def _evidence(
        self,
        node: ObjectNode,
        sight: PlaceSight,
        alike: float | None,
        view: View,
        observed: bool,
    ) -> Evidence:
        values = sight.values()
        if alike is not None:
            values["s_rgb"] = round(alike, 4)
        verdict = SEEN if observed else verdict_of(sight, self._rule)
        flat = verdict in (PRESENT, UNKNOWN) and is_thin(node.points, 2 * self._rule.min_margin)
        if flat and values.get("s_rgb", 1.0) < self._colors.changed:
            verdict = MISSED  # depth cannot tell it from what it lay on, colours can
        return Evidence(view.frame, node.id, verdict, values)

    def _cloud(self, node: ObjectNode) -> tuple[Float32Array, ByteArray]:
        """Points and colours to ask: some of the thing as the last visit left it, without its underside.

        What this visit merged into it may be another thing of its kind, in its place.
        """
        points, colors = self._left.get(node.id, (node.points, node.colors))
        known = self._clouds.get(node.id)
        if known is None or known[0] is not points:
            high = telling(points)
            count = self._rule.sample
            known = points, sampled(points[high], count), sampled(colors[high], count)
            self._clouds[node.id] = known
        return known[1], known[2]

    def _without_neighbours(self, node: ObjectNode, cloud: Float32Array, sight: PlaceSight) -> PlaceSight:
        """The sight without points that lie on another object's surface.

        A detection that took in a piece of the dresser behind a chair leaves it in the chair; there it
        would say for ever that the chair is in its place. Asked only where it may turn the verdict.
        """
        if not _DOUBT < sight.free < self._rule.free_share:
            return sight
        points = cloud[sight.on_surface]
        foreign = np.zeros(len(points), dtype=np.bool_)
        for object_id in self._graph.objects_touching(node.box_min, node.box_max):
            other = self._graph.objects[object_id]
            if object_id == node.id or other.status != BELIEVED or other.state == DISAPPEARED:
                continue
            distance, _ = self._graph.tree(object_id).query(points, distance_upper_bound=_ON_NEIGHBOUR)
            foreign |= np.isfinite(distance)
        left = sight.near_enough - int(np.count_nonzero(foreign))
        if left < max(self._rule.min_points, self._rule.min_inside_share * sight.asked):
            return sight
        scale = sight.near_enough / left
        return replace(
            sight,
            near_enough=left,
            free=sight.free * scale,
            surface=sight.surface * scale - int(np.count_nonzero(foreign)) / left,
            occluded=sight.occluded * scale,
            unread=sight.unread * scale,
        )

    def _note(self, evidence: Evidence) -> None:
        runs = self._runs.setdefault(evidence.object_id, _Runs())
        if evidence.verdict == MISSED:
            runs.free.append(evidence.frame)
        elif evidence.verdict in (SEEN, PRESENT):
            runs.free.clear()
        if evidence.verdict == SEEN and "s_rgb" in evidence.values:
            if evidence.values["s_rgb"] < self._colors.exchanged:
                runs.other.append(evidence.frame)
            else:
                runs.other.clear()
                runs.itself = evidence.frame

    def _seen_colors(
        self, colors: ByteArray, sight: PlaceSight, view: View
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Stored colours and those in the image, where depth is on the object's surface; None if too few."""
        on = sight.on_surface
        if np.count_nonzero(on) < _MIN_COLOR_POINTS:
            return None
        return colors[on], view.rgb[sight.rows[on], sight.columns[on]]

    def _likeness(self, colors: Mapping[str, tuple[np.ndarray, np.ndarray] | None]) -> dict[str, float]:
        """s_rgb of what is stored and what is there, of the objects whose colours are in sight."""
        if self.gain is None:
            return {}
        shown = {object_id: pair for object_id, pair in colors.items() if pair is not None}
        return dict(zip(shown, color_similarities(list(shown.values()), 1.0 / self.gain), strict=True))

    def _follow_light(self, colors: Mapping[str, tuple[np.ndarray, np.ndarray] | None]) -> None:
        """The gain of this visit's light: median over the objects in view, smoothed over frames."""
        ratios = [
            mean_value(now) / mean_value(stored)
            for stored, now in (pair for pair in colors.values() if pair is not None)
            if mean_value(stored) > 0.05
        ]
        if len(ratios) >= _MIN_LIT_OBJECTS:
            now = float(np.clip(np.median(ratios), 0.2, 5.0))
            self.gain = now if self.gain is None else self.gain + 0.3 * (now - self.gain)


def frustum_box(view: View, reach: float) -> tuple[FloatArray, FloatArray]:
    """The axis-aligned box of what the view can show up to `reach` metres along its optical axis."""
    camera = view.camera
    corners = [
        ((u - camera.cx) / camera.fx * reach, (v - camera.cy) / camera.fy * reach, reach)
        for u in (0, camera.width - 1)
        for v in (0, camera.height - 1)
    ]
    points = transform_points(view.world_from_camera, np.array([(0.0, 0.0, 0.0), *corners]))
    return points.min(axis=0), points.max(axis=0)
