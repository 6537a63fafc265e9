"""grounding/image: whole viewpoints by one feature each, without a graph; a baseline of Table IV.

The sentence is compared with one vector a viewpoint. Where perception gives image features that live in the
encoder's space, that vector is the mean of those of the objects seen from there, each once; where it gives
none (the default furniture recogniser, the oracle), it is the mean of their text features, which is all that
such a perception has to say of an image. No relation, no matching, no object is singled out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.errors import ConfigError
from dssmsg.events import Candidate
from dssmsg.frame import FloatArray
from dssmsg.graph.ids import id_order
from dssmsg.graph.subgraph import Thing, features_of, local_subgraphs, things_of
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.grounding import TargetGraph

if TYPE_CHECKING:
    from dssmsg.interfaces import Context


class Config(PluginConfig):
    """Options of `grounding: {use: image}`."""

    tentative: bool = Field(True, description="Whether objects that are not yet believed count too.")


class ImageGrounding:
    """Ranks viewpoints by the cosine of sentence and view."""

    def __init__(self, config: Config, context: Context) -> None:
        if context.encoder is None:
            raise ConfigError("grounding needs an encoder for the words of the goal", key="encoder.use")
        self._config = config
        self._encoder = context.encoder
        self._graph = context.graph

    def ground(self, target: TargetGraph) -> Sequence[Candidate]:
        """All viewpoints that see anything, best first; `matching` is empty."""
        things = things_of(self._graph, tentative=self._config.tentative, vanished=False)
        if not things:
            return ()
        wanted = self._encoder.encode_text([target.text])[0].astype(np.float64)
        features = self._features(things)
        ranking = []
        for subgraph in local_subgraphs(self._graph, things):
            view = features[subgraph.things].mean(axis=0)
            # einsum adds in a fixed order; the order of BLAS depends on threads and processor.
            length = float(np.sqrt(np.einsum("d,d->", view, view)))
            cosine = float(np.einsum("d,d->", wanted, view)) / length if length > 0 else 0.0
            ranking.append(
                (-cosine, id_order(subgraph.viewpoint_id), subgraph.viewpoint_id, len(subgraph.things))
            )
        ranking.sort()
        return tuple(
            Candidate(viewpoint, rank, {"score": -negative}, {}, f"the view as a whole, {count} objects")
            for rank, (negative, _order, viewpoint, count) in enumerate(ranking, 1)
        )

    def _features(self, things: Sequence[Thing]) -> FloatArray:
        """(N, D) image features where every object has one of the encoder's space, else text features."""
        own = [self._graph.objects[thing.id].image_feature for thing in things]
        if all(one is not None and one.shape == (self._encoder.dimension,) for one in own):
            return np.stack([np.asarray(one, np.float64) for one in own])
        return features_of(things, self._encoder.encode_labels([thing.label for thing in things]))


@hookimpl
def register_grounding(register: Register) -> None:
    """`image`: whole views by one feature each."""
    register("image", ImageGrounding, config=Config)
