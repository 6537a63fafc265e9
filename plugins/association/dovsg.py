"""association/dovsg: the mapping of DovSG (Yan et al., 2025), a baseline; `update: dovsg` goes with it.

Written from the paper and its published parameters; docs/baselines.md says what differs and why.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pydantic import Field

from dssmsg.baselines.clouds import largest_neighbour_cluster
from dssmsg.baselines.footprint import box_share, cut, has_pixels, mask_share
from dssmsg.baselines.mapper import GreedyMapper, Method
from dssmsg.baselines.pairs import Weights
from dssmsg.frame import Frame, Observation
from dssmsg.graph.changes import Change
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "association/dovsg"


class DovsgConfig(PluginConfig):
    """DovSG's parameters at their published values, but for `tolerance`."""

    min_confidence: float = Field(0.25, ge=0, le=1, description="Detections below this score are left out.")
    min_pixels: int = Field(25, ge=1, description="Things that cover fewer pixels are left out.")
    max_mask_share: float = Field(
        0.3, gt=0, le=1, description="Things that cover more of the image are left out."
    )
    min_points: int = Field(10, ge=1, description="A cloud with fewer voxels is left out.")
    tolerance: float = Field(
        0.025, gt=0, description="Points this near to each other overlap, metres: the map's voxel."
    )
    overlap_weight: float = Field(0.5, ge=0, le=1, description="What the overlap (0..1) counts.")
    image_weight: float = Field(0.4, ge=0, le=1, description="What the cosine of image features counts.")
    text_weight: float = Field(0.1, ge=0, le=1, description="What the cosine of text features counts.")
    accept: float = Field(
        0.75, ge=0, le=1, description="Least weighted score of a merge; below it a new object."
    )
    every: int = Field(5, ge=1, description="Key frames between two passes that join objects.")
    join: float = Field(0.8, ge=0, le=1, description="Objects join above this weighted score.")
    min_detections: int = Field(2, ge=1, description="Objects with fewer are dropped at a visit's end.")


class DovsgAssociation:
    """Detections become objects by a weighted sum of overlap, looks and names, greedily."""

    def __init__(self, config: DovsgConfig, context: Context) -> None:
        self._config = config
        self._mapper = GreedyMapper(
            context.graph,
            context.ids,
            Method(
                plugin=PLUGIN,
                weights=Weights(config.overlap_weight, config.image_weight, config.text_weight),
                tolerance=config.tolerance,
                accept=config.accept,
                join={"score": config.join},
                denoise=None,
                every=config.every,
                min_points=config.min_points,
                min_detections=config.min_detections,
                by_majority=False,
            ),
        )

    def associate(
        self, frame: Frame, observations: Sequence[Observation], viewpoint_id: str | None
    ) -> Sequence[Change]:
        """One `ObjectAdded` or `ObjectMerged` for each observation that passes the method's own filters."""
        clouds = (
            cut(one, largest_neighbour_cluster(one.points_world))
            for one in observations
            if self._fits(frame, one)
        )
        kept = [one for one in clouds if len(one.points_world) >= self._config.min_points]
        return self._mapper.associate(kept, viewpoint_id)

    def finish(self) -> Sequence[Change]:
        """A last pass that joins; then objects with too few detections are dropped."""
        return self._mapper.finish()

    def _fits(self, frame: Frame, observation: Observation) -> bool:
        """Sure enough and not too large; pixels are counted only where the box may hold too many."""
        config = self._config
        if observation.score < config.min_confidence or not has_pixels(frame, observation, config.min_pixels):
            return False
        most = config.max_mask_share
        return box_share(frame, observation) <= most or mask_share(frame, observation) <= most


@hookimpl
def register_association(register: Register) -> None:
    """Announce `dovsg`."""
    register("dovsg", DovsgAssociation, config=DovsgConfig)
