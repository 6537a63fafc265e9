"""grounding/objects: viewpoints ranked by the objects they see, the node score of the paper alone (eq. 3).

Every node of the target graph takes the best cosine among the objects seen from a viewpoint; a viewpoint's
score is their mean. Relations, attributes and the topology score (eq. 4-5) are not looked at. Many viewpoints
see the same object: of equals the one nearest to what was taken for the core target comes first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.errors import ConfigError
from dssmsg.events import Candidate
from dssmsg.frame import Float32Array
from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import BELIEVED, DISAPPEARED, SEES, ObjectNode
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.grounding import TargetGraph

if TYPE_CHECKING:
    from dssmsg.interfaces import Context


class Config(PluginConfig):
    """Options of `grounding: {use: objects}`."""

    tentative: bool = Field(False, description="Whether objects that are not yet believed count too.")


class ObjectsGrounding:
    """Averages best cosines, viewpoint by viewpoint."""

    def __init__(self, config: Config, context: Context) -> None:
        if context.encoder is None:
            raise ConfigError("grounding needs an encoder for the labels of the goal", key="encoder.use")
        self._encoder = context.encoder
        self._graph = context.graph
        self._tentative = config.tentative

    def ground(self, target: TargetGraph) -> Sequence[Candidate]:
        """All viewpoints that see an object, best first."""
        graph = self._graph
        seen = {viewpoint: self._seen_from(viewpoint) for viewpoint in graph.viewpoints}
        objects = {node.id: node for nodes in seen.values() for node in nodes}
        if not objects or not target.nodes:
            return ()
        column = {object_id: place for place, object_id in enumerate(objects)}
        wanted = self._encoder.encode_labels([n.label for n in target.nodes]).astype(np.float64)
        # einsum adds in a fixed order; the order of BLAS depends on threads and processor.
        cosine = np.einsum("id,jd->ij", wanted, self._features(objects.values()).astype(np.float64))
        ranking = []
        for viewpoint, nodes in seen.items():
            if not nodes:
                continue
            columns = [column[node.id] for node in nodes]
            best = cosine[:, columns].argmax(axis=1)
            scores = [float(cosine[row, columns[place]]) for row, place in enumerate(best)]
            chosen = [nodes[place] for place in best]
            s_node = sum(scores) / len(scores)
            distance = self._distance(viewpoint, chosen[target.core])
            order = (-s_node, -scores[target.core], distance, id_order(viewpoint))
            values = {"s_node": s_node, "core": scores[target.core], "core_distance": distance}
            values |= {f"node_{row}": score for row, score in enumerate(scores)}
            ranking.append((order, viewpoint, values, scores, chosen))
        ranking.sort(key=lambda entry: entry[0])
        return tuple(
            Candidate(
                viewpoint_id=viewpoint,
                rank=rank,
                scores=values,
                matching={str(row): node.id for row, node in enumerate(chosen)},
                reason="; ".join(
                    f"{sought.label}: {node.label} ({node.id}) {score:.2f}"
                    for sought, node, score in zip(target.nodes, chosen, scores, strict=True)
                ),
            )
            for rank, (_order, viewpoint, values, scores, chosen) in enumerate(ranking, start=1)
        )

    def _distance(self, viewpoint_id: str, node: ObjectNode) -> float:
        """Metres on the floor from the viewpoint's camera to the middle of an object's box."""
        camera = self._graph.viewpoints[viewpoint_id].world_from_camera[:2, 3]
        return math.hypot(*(node.center[:2] - camera))

    def _seen_from(self, viewpoint_id: str) -> list[ObjectNode]:
        """Objects seen from a viewpoint that are there, in order of id."""
        ids = [
            e.target if e.source == viewpoint_id else e.source
            for e in self._graph.edges_of(viewpoint_id, SEES)
        ]
        nodes = [self._graph.objects[i] for i in sorted(ids, key=id_order) if i in self._graph.objects]
        return [n for n in nodes if n.state != DISAPPEARED and (self._tentative or n.status == BELIEVED)]

    def _features(self, nodes: Iterable[ObjectNode]) -> Float32Array:
        """(N, D) text features: the object's own, or its label's where perception gave none of this space."""
        objects = list(nodes)
        features = self._encoder.encode_labels([node.label for node in objects])
        rows = np.array(features, dtype=np.float32)
        for row, node in enumerate(objects):
            if node.text_feature is not None and node.text_feature.shape == rows[row].shape:
                rows[row] = node.text_feature
        return rows


@hookimpl
def register_grounding(register: Register) -> None:
    """`objects`: best cosines of objects, averaged."""
    register("objects", ObjectsGrounding, config=Config)
