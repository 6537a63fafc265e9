"""grounding/objects: the best object by cosine, from the nearest viewpoint that sees it; a baseline.

This is how a map of objects without a scene graph is asked (ConceptGraphs in the paper's Table IV): the
sentence as a whole is compared with the feature of every object, and nothing is known of relations,
attributes, changes or what a sentence is really after. `query: core` compares the label of the core target
instead, which lends the baseline the language model's reading of the sentence.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from dssmsg.errors import ConfigError
from dssmsg.events import Candidate
from dssmsg.graph.ids import id_order
from dssmsg.graph.relations import gap
from dssmsg.graph.subgraph import features_of, local_subgraphs, things_of
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.grounding import TargetGraph

if TYPE_CHECKING:
    from dssmsg.interfaces import Context


class Config(PluginConfig):
    """Options of `grounding: {use: objects}`."""

    query: Literal["sentence", "core"] = Field(
        "sentence", description="What is compared with objects: the sentence, or the core target's label."
    )
    tentative: bool = Field(False, description="Whether objects that are not yet believed count too.")


class ObjectsGrounding:
    """Ranks viewpoints by the best object that they see."""

    def __init__(self, config: Config, context: Context) -> None:
        if context.encoder is None:
            raise ConfigError("grounding needs an encoder for the words of the goal", key="encoder.use")
        self._config = config
        self._encoder = context.encoder
        self._graph = context.graph

    def ground(self, target: TargetGraph) -> Sequence[Candidate]:
        """All viewpoints that see an object that is there, best first."""
        things = things_of(self._graph, tentative=self._config.tentative, vanished=False)
        by_core = self._config.query == "core"
        if not things or (by_core and not target.nodes):
            return ()
        if by_core:
            wanted = self._encoder.encode_labels([target.nodes[target.core].label])[0]
        else:
            wanted = self._encoder.encode_text([target.text])[0]
        features = features_of(things, self._encoder.encode_labels([thing.label for thing in things]))
        # einsum adds in a fixed order; the order of BLAS depends on threads and processor.
        cosines = np.einsum("d,jd->j", wanted.astype(np.float64), features)
        ranking = []
        for subgraph in local_subgraphs(self._graph, things):
            place = int(subgraph.things[cosines[subgraph.things].argmax()])
            eye = self._graph.viewpoints[subgraph.viewpoint_id].world_from_camera[:3, 3]
            distance = gap(eye, eye, things[place].box_min, things[place].box_max)
            order = (-float(cosines[place]), place, distance, id_order(subgraph.viewpoint_id))
            ranking.append((order, subgraph.viewpoint_id, place, distance))
        ranking.sort(key=lambda entry: entry[0])
        return tuple(
            Candidate(
                viewpoint_id=viewpoint,
                rank=rank,
                scores={"score": float(cosines[place]), "core_distance": distance},
                matching={str(target.core): things[place].id},
                reason=f"{things[place].label} ({things[place].id}) {cosines[place]:.2f}, {distance:.1f} m",
            )
            for rank, (_order, viewpoint, place, distance) in enumerate(ranking, 1)
        )


@hookimpl
def register_grounding(register: Register) -> None:
    """`objects`: the best object by cosine, seen from nearby."""
    register("objects", ObjectsGrounding, config=Config)
