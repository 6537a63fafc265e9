"""A sentence becomes a target graph: the request to the LLM, its schema, the parsed answer (paper III-C)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dssmsg.interfaces import Message, TargetEdge, TargetGraph, TargetNode

TARGET_GRAPH_SCHEMA: Mapping[str, Any] = {
    "type": "object",
    "additionalProperties": False,
    "required": ["kind", "nodes", "edges", "core"],
    "properties": {
        "kind": {"enum": ["explicit", "implicit"]},
        "nodes": {
            "type": "array",
            "minItems": 1,
            "maxItems": 20,
            "items": {
                "type": "object",
                "additionalProperties": False,
                "required": ["label"],
                "properties": {
                    "label": {"type": "string", "minLength": 1, "maxLength": 80},
                    "attributes": {
                        "type": "array",
                        "maxItems": 8,
                        "items": {"type": "string", "maxLength": 80},
                    },
                },
            },
        },
        "edges": {
            "type": "array",
            "maxItems": 60,
            "items": {
                "type": "object",
                "additionalProperties": False,
                "required": ["source", "target", "relation"],
                "properties": {
                    "source": {"type": "integer", "minimum": 0, "x-index-of": "nodes"},
                    "target": {"type": "integer", "minimum": 0, "x-index-of": "nodes"},
                    "relation": {"type": "string", "maxLength": 40},
                },
            },
        },
        "core": {"type": "integer", "minimum": 0, "x-index-of": "nodes"},
    },
}

_INSTRUCTIONS = (
    "You turn a sentence about a place or an object in a home into a target graph. Nodes are object labels "
    "(singular nouns) with attributes such as colours; edges are spatial relations between two nodes, by "
    "index; core is the index of the node that the sentence is about. kind is explicit where the sentence "
    "names the objects, implicit where it only names a purpose: then list the objects that such a place "
    "usually has. "
    "Answer with JSON alone."
)


def target_graph_request(sentence: str) -> tuple[Message, ...]:
    """The messages that ask for the target graph of a sentence."""
    return (Message("system", _INSTRUCTIONS), Message("user", sentence))


def parse_target_graph(sentence: str, value: Mapping[str, Any]) -> TargetGraph:
    """The target graph from an answer that fits `TARGET_GRAPH_SCHEMA`.

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
    """The target graph as JSON values, for the recording."""
    return {
        "kind": target.kind,
        "nodes": [{"label": n.label, "attributes": list(n.attributes)} for n in target.nodes],
        "edges": [{"source": e.source, "target": e.target, "relation": e.relation} for e in target.edges],
        "core": target.core,
    }
