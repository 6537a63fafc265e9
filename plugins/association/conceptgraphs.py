"""association/conceptgraphs: the mapping of ConceptGraphs (Gu et al., 2024), a baseline.

Written from the paper and its published parameters; docs/baselines.md says what differs and why. It knows
no change: what moved is a new object beside the old one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from pydantic import Field

from dssmsg.baselines.clouds import largest_clusters
from dssmsg.baselines.footprint import box_share, cut, has_pixels, without_contained
from dssmsg.baselines.mapper import GreedyMapper, Method
from dssmsg.baselines.pairs import Weights
from dssmsg.frame import Frame, Observation
from dssmsg.graph.changes import Change
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "association/conceptgraphs"


class ConceptGraphsConfig(PluginConfig):
    """ConceptGraphs' parameters at their published values."""

    min_confidence: float = Field(0.25, ge=0, le=1, description="Detections below this score are left out.")
    min_pixels: int = Field(25, ge=1, description="Things that cover fewer pixels are left out.")
    max_box_share: float = Field(
        0.5, gt=0, le=1, description="Things whose pixel box covers more of the image are left out."
    )
    min_points: int = Field(16, ge=1, description="A cloud with fewer voxels is left out.")
    eps: float = Field(0.1, gt=0, description="DBSCAN's eps, metres; the largest cluster of a cloud stays.")
    tolerance: float = Field(0.025, gt=0, description="Points this near to each other overlap, metres.")
    accept: float = Field(
        1.2, ge=1, le=2, description="Least overlap + image cosine (-1..2) of a merge, else a new object."
    )
    every: int = Field(5, ge=1, description="Key frames between two passes that denoise and join objects.")
    join_overlap: float = Field(0.7, ge=0, le=1, description="Objects join above this overlap ...")
    join_image: float = Field(0.7, ge=-1, le=1, description="... and this cosine of image features ...")
    join_text: float = Field(0.7, ge=-1, le=1, description="... and this cosine of text features.")
    min_detections: int = Field(3, ge=1, description="Objects with fewer are dropped at a visit's end.")


class ConceptGraphs:
    """Detections become objects by overlap and looks, greedily."""

    def __init__(self, config: ConceptGraphsConfig, context: Context) -> None:
        self._config = config
        self._mapper = GreedyMapper(
            context.graph,
            context.ids,
            Method(
                plugin=PLUGIN,
                weights=Weights(overlap=1.0, image=1.0, text=0.0),
                tolerance=config.tolerance,
                accept=config.accept,
                join={
                    "overlap": config.join_overlap, "image": config.join_image, "text": config.join_text
                },
                denoise=partial(largest_clusters, eps=config.eps),
                every=config.every,
                min_points=config.min_points,
                min_detections=config.min_detections,
                by_majority=True,
            ),
        )  # fmt: skip

    def associate(
        self, frame: Frame, observations: Sequence[Observation], viewpoint_id: str | None
    ) -> Sequence[Change]:
        """One `ObjectAdded` or `ObjectMerged` for each observation that passes the method's own filters."""
        return self._mapper.associate(self._filtered(frame, observations), viewpoint_id)

    def finish(self) -> Sequence[Change]:
        """A last denoising and joining; then objects with too few detections are dropped."""
        return self._mapper.finish()

    def _filtered(self, frame: Frame, observations: Sequence[Observation]) -> list[Observation]:
        """What is sure and of a size, without what lies in it, and of that the largest cluster."""
        config = self._config
        wanted = [
            one
            for one in observations
            if one.score >= config.min_confidence
            and box_share(frame, one) <= config.max_box_share
            and has_pixels(frame, one, config.min_pixels)
        ]
        least = config.min_points
        whole = [one for one in without_contained(frame, wanted) if len(one.points_world) >= least]
        kept = largest_clusters([one.points_world for one in whole], config.eps)
        clouds = (cut(one, mask) for one, mask in zip(whole, kept, strict=True))
        return [one for one in clouds if len(one.points_world) >= least]


@hookimpl
def register_association(register: Register) -> None:
    """Announce `conceptgraphs`."""
    register("conceptgraphs", ConceptGraphs, config=ConceptGraphsConfig)
