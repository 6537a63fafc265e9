"""Facts: what `before` and `after` of a change say of a node or an edge, as JSON values."""

from __future__ import annotations

from typing import Any

from dssmsg.graph.nodes import Edge, HistoryNode, ObjectNode, Viewpoint, WaypointNode

Node = ObjectNode | HistoryNode | WaypointNode | Viewpoint


def facts(node: Node | Edge) -> dict[str, Any]:
    """The facts of a node or an edge. Boxes are six numbers, min then max; `points` is how many there are."""
    match node:
        case ObjectNode():
            return {
                "label": node.label,
                "status": node.status,
                "state": node.state,
                "dynamic_attribute": node.dynamic_attribute,
                "observations": node.observations,
                "points": len(node.points),
                "box": _box(node),
            }
        case HistoryNode():
            return {
                "object": node.object_id,
                "label": node.label,
                "box": _box(node),
                "from_time": node.from_time,
                "to_time": node.to_time,
            }
        case WaypointNode():
            return {"position": node.position.tolist(), "viewpoints": list(node.viewpoints)}
        case Viewpoint():
            return {
                "waypoint": node.waypoint_id,
                "heading": node.heading,
                "tilt": node.tilt,
                "frame": node.frame,
                "observations": node.observations,
            }
        case Edge():
            return dict(node.attributes)


def _box(node: ObjectNode | HistoryNode) -> list[float]:
    return [*node.box_min.tolist(), *node.box_max.tolist()]
