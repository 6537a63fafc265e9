"""The JSON that the `spark_dsg` package (1.1) loads with `DynamicSceneGraph.load`; written without it.

Objects go into the layer OBJECTS, waypoints into PLACES. `path` and `near` edges stay inside their layers;
the `sees` edges of a waypoint's viewpoints become one edge between the layers, weighted with the least
distance. What the package has no field for (our ids, states, viewpoints, relations) is in the `metadata` of
nodes and edges.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dssmsg.frame import Float32Array
from dssmsg.graph.facts import facts
from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import NEAR, PATH, SEES, ObjectNode, WaypointNode
from dssmsg.graph.scene_graph import SceneGraph

_VERSION = {"major": 1, "minor": 1, "patch": 3}
_OBJECTS, _PLACES, _ROOMS, _BUILDINGS = 2, 3, 4, 5
_NAMES = {"AGENTS": 2, "OBJECTS": _OBJECTS, "PLACES": _PLACES, "ROOMS": _ROOMS, "BUILDINGS": _BUILDINGS}
_NO_LABEL = 2**32 - 1
_NO_TURN = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}


def spark_dsg_document(graph: SceneGraph) -> dict[str, Any]:
    """A graph as the JSON object of a spark-dsg file."""
    labels = {label: n for n, label in enumerate(sorted({node.label for node in graph.objects.values()}))}
    return {
        "SPARK_DSG_header": {"project_name": "dssmsg", "version": _VERSION},
        "directed": False,
        "multigraph": False,
        "layer_keys": [_layer(number) for number in (_OBJECTS, _PLACES, _ROOMS, _BUILDINGS)],
        "layer_names": {name: _layer(number) for name, number in _NAMES.items()},
        "metadata": {
            "labelspaces": {f"_l{_OBJECTS}p0": [[number, label] for label, number in labels.items()]}
        },
        "nodes": [
            *(_object(node, labels[node.label]) for node in graph.objects.values()),
            *(_place(node) for node in graph.waypoints.values()),
        ],
        "edges": _edges(graph),
    }


def symbol(node_id: str) -> int:
    """The package's 64-bit id: `object-12` is O(12), `waypoint-3` is p(3)."""
    kind, number, _ = id_order(node_id)
    letter = {"object": "O", "waypoint": "p"}[kind]
    return ord(letter) << 56 | number


def _layer(number: int) -> dict[str, int]:
    return {"layer": number, "partition": 0}


def _object(node: ObjectNode, label: int) -> dict[str, Any]:
    attributes = {
        "type": "ObjectNodeAttributes",
        "position": node.center.tolist(),
        "bounding_box": {
            "type": "AABB",
            "dimensions": (node.box_max - node.box_min).tolist(),
            "world_P_center": node.center.tolist(),
            "world_R_center": _NO_TURN,
        },
        "semantic_label": label,
        "semantic_feature": _feature(node.text_feature),
        "color": _color(node.colors.mean(axis=0)),
        "last_update_time_ns": round(node.last_seen * 1e9),
        "mesh_connections": [],
        "registered": False,
        "world_R_object": _NO_TURN,
    }
    return _node(node.id, node.label, _OBJECTS, attributes, facts(node))


def _place(node: WaypointNode) -> dict[str, Any]:
    attributes = {
        "type": "PlaceNodeAttributes",
        "position": node.position.tolist(),
        "bounding_box": {
            "type": "INVALID",
            "dimensions": [0.0, 0.0, 0.0],
            "world_P_center": [0.0, 0.0, 0.0],
            "world_R_center": _NO_TURN,
        },
        "semantic_label": _NO_LABEL,
        "semantic_feature": _feature(None),
        "color": _color(np.zeros(3)),
        "last_update_time_ns": 0,
        "active_frontier": False,
        "anti_frontier": False,
        "deformation_connections": [],
        "distance": 0.0,
        "frontier_scale": [0.0, 0.0, 0.0],
        "mesh_vertex_labels": [],
        "need_cleanup": False,
        "num_basis_points": 0,
        "num_frontier_voxels": 0,
        "orientation": _NO_TURN,
        "pcl_mesh_connections": [],
        "real_place": True,
        "voxblox_mesh_connections": [],
    }
    return _node(node.id, node.id, _PLACES, attributes, facts(node))


def _node(
    node_id: str, name: str, layer: int, attributes: dict[str, Any], more: dict[str, Any]
) -> dict[str, Any]:
    common = {"name": name, "is_active": False, "is_predicted": False, "metadata": {"id": node_id, **more}}
    return {"id": symbol(node_id), **_layer(layer), "attributes": attributes | common}


def _edges(graph: SceneGraph) -> list[dict[str, Any]]:
    within, between = [], dict[tuple[str, str], float]()
    for edge in graph.edges.values():
        if edge.kind == SEES:
            ends = (graph.viewpoints[edge.source].waypoint_id, edge.target)
            distance = float(edge.attributes.get("distance", 0.0))
            between[ends] = min(distance, between.get(ends, distance))
        elif edge.kind in (NEAR, PATH):
            length = edge.attributes.get("length" if edge.kind == PATH else "distance", 0.0)
            more = {"kind": edge.kind, **edge.attributes}
            within.append(_edge(edge.source, edge.target, float(length), more))
    seen = [_edge(*ends, distance, {"kind": SEES}) for ends, distance in between.items()]
    return [*within, *seen]


def _edge(source: str, target: str, weight: float, more: dict[str, Any]) -> dict[str, Any]:
    info = {"type": "EdgeAttributes", "weighted": True, "weight": weight, "metadata": more}
    return {"source": symbol(source), "target": symbol(target), "info": info}


def _feature(feature: Float32Array | None) -> dict[str, Any]:
    if feature is None:
        return {"rows": 0, "cols": 0, "data": None}
    return {"rows": len(feature), "cols": 1, "data": feature.tolist()}


def _color(rgb: Any) -> dict[str, int]:
    red, green, blue = (round(float(value)) for value in rgb)
    return {"r": red, "g": green, "b": blue, "a": 255}
