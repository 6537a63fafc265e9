"""Target graphs as JSON values: what an LLM answers and what a recording holds (paper III-C)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dssmsg.interfaces import TargetEdge, TargetGraph, TargetNode


def parse_target_graph(sentence: str, value: Mapping[str, Any]) -> TargetGraph:
    """The target graph from an answer that fits `dssmsg.mission.goal.TARGET_GRAPH_SCHEMA`.

    Raises ValueError where an index names no node.
    """
    nodes = tuple(
        TargetNode(str(node["label"]), tuple(str(a) for a in node.get("attributes", ())))
        for node in value["nodes"]
    )
    edges = tuple(
        TargetEdge(int(edge["source"]), int(edge["target"]), str(edge["relation"])) for edge in value["edges"]
    )
    core = int(value["core"])
    for index in (core, *(i for edge in edges for i in (edge.source, edge.target))):
        if not 0 <= index < len(nodes):
            raise ValueError(f"node {index} is named, but there are {len(nodes)} nodes")
    return TargetGraph(sentence, nodes, edges, core, str(value["kind"]))


def target_graph_json(target: TargetGraph) -> dict[str, Any]:
    """The target graph as JSON values, as recordings hold it; the inverse of `parse_target_graph`."""
    return {
        "kind": target.kind,
        "nodes": [{"label": n.label, "attributes": list(n.attributes)} for n in target.nodes],
        "edges": [{"source": e.source, "target": e.target, "relation": e.relation} for e in target.edges],
        "core": target.core,
    }
