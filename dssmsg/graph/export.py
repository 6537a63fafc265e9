"""The graph in formats that other programs read: our own JSON, GraphML, PLY, and the JSON of spark-dsg."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dssmsg.errors import ConfigError
from dssmsg.graph.codec import graph_to_json
from dssmsg.graph.facts import facts
from dssmsg.graph.ids import id_order
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.graph.spark_dsg import spark_dsg_document
from dssmsg.graph.values import canonical_json

_PLY_VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("object", "<i4"),
    ]
)


def export_graph(graph: SceneGraph, format: str) -> bytes:
    """The graph as a file of a format: `json`, `graphml`, `ply` or `spark-dsg`.

    The same graph gives the same bytes. Raises ConfigError for another format.
    """
    writer = FORMATS.get(format)
    if writer is None:
        raise ConfigError(f"expected a format of {', '.join(FORMATS)}, got {format!r}", key="format")
    return writer(graph)


def _json(graph: SceneGraph) -> bytes:
    return canonical_json(graph_to_json(graph)).encode()


def _spark_dsg(graph: SceneGraph) -> bytes:
    return canonical_json(spark_dsg_document(graph)).encode()


def _graphml(graph: SceneGraph) -> bytes:
    """Nodes and viewpoints with facts, edges with attributes; `has` leads from waypoint to viewpoint."""
    import networkx  # a third of a second, which only this export needs

    document = networkx.DiGraph(updates=graph.updates)
    for kind, table in _node_tables(graph).items():
        for node_id, node in table.items():
            document.add_node(node_id, kind=kind, **_scalars(facts(node)))
    for edge in graph.edges.values():
        document.add_edge(edge.source, edge.target, kind=edge.kind, **_scalars(edge.attributes))
    for viewpoint in graph.viewpoints.values():
        document.add_edge(viewpoint.waypoint_id, viewpoint.id, kind="has")
    return ("\n".join(networkx.generate_graphml(document)) + "\n").encode()


def _ply(graph: SceneGraph) -> bytes:
    """The coloured points of all objects, binary; `object` is an id's number, labels stand in comments."""
    header = ["ply", "format binary_little_endian 1.0"]
    clouds = []
    for node in graph.objects.values():
        number = id_order(node.id)[1]
        header.append(f"comment {node.id} {node.status} {node.state} {' '.join(node.label.split())}")
        cloud = np.zeros(len(node.points), dtype=_PLY_VERTEX)
        for axis, name in enumerate(("x", "y", "z")):
            cloud[name] = node.points[:, axis]
        for channel, name in enumerate(("red", "green", "blue")):
            cloud[name] = node.colors[:, channel]
        cloud["object"] = number
        clouds.append(cloud)
    vertices = np.concatenate(clouds) if clouds else np.zeros(0, dtype=_PLY_VERTEX)
    header.append(f"element vertex {len(vertices)}")
    header += [f"property float {name}" for name in ("x", "y", "z")]
    header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header += ["property int object", "end_header", ""]
    return "\n".join(header).encode() + vertices.tobytes()


FORMATS: Mapping[str, Callable[[SceneGraph], bytes]] = {
    "json": _json,
    "graphml": _graphml,
    "ply": _ply,
    "spark-dsg": _spark_dsg,
}


def _node_tables(graph: SceneGraph) -> Mapping[str, Mapping[str, Any]]:
    return {
        "object": graph.objects,
        "history": graph.history,
        "waypoint": graph.waypoints,
        "viewpoint": graph.viewpoints,
    }


def _scalars(values: Mapping[str, Any]) -> dict[str, Any]:
    """What GraphML can hold: `position` as position_0, position_1, ...; texts joined; None left out."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, list) and all(isinstance(item, str) for item in value):
            flat[name] = " ".join(value)
        elif isinstance(value, list):
            flat |= {f"{name}_{index}": item for index, item in enumerate(value)}
        elif value is not None:
            flat[name] = value
    return flat
