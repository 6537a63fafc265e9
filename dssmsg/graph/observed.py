"""The changes that bring an observation into the graph, for whoever decided what it is."""

from __future__ import annotations

from dssmsg.frame import MaskArray, Observation
from dssmsg.graph.changes import Cause, ObjectAdded, ObjectMerged, Score


def added(
    observation: Observation,
    object_id: str,
    viewpoint_id: str | None,
    cause: Cause,
    scores: tuple[Score, ...],
    *,
    vote: float | None = None,
) -> ObjectAdded:
    """A new object from an observation; `vote` is the weight of its label, else the detection's score."""
    return ObjectAdded(
        cause=cause,
        scores=scores,
        object_id=object_id,
        label=observation.label,
        score=observation.score if vote is None else vote,
        points=observation.points_world,
        colors=observation.colors,
        viewpoint_id=viewpoint_id,
        range_m=observation.range_m,
        detection=observation.detection_index,
        text_feature=observation.text_feature,
        image_feature=observation.image_feature,
    )


def merged(
    observation: Observation,
    object_id: str,
    viewpoint_id: str | None,
    cause: Cause,
    scores: tuple[Score, ...],
    *,
    novel: MaskArray | None = None,
    vote: float | None = None,
) -> ObjectMerged:
    """An observation merged into an object; `novel` (N,) are the points to add, all of them if None."""
    points, colors = observation.points_world, observation.colors
    if novel is not None:
        points, colors = points[novel], colors[novel]
    return ObjectMerged(
        cause=cause,
        scores=scores,
        object_id=object_id,
        label=observation.label,
        score=observation.score if vote is None else vote,
        points=points,
        colors=colors,
        viewpoint_id=viewpoint_id,
        range_m=observation.range_m,
        detection=observation.detection_index,
        text_feature=observation.text_feature,
        image_feature=observation.image_feature,
    )
