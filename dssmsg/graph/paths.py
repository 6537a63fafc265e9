"""Ways over the waypoint topology: Dijkstra over the unblocked `path` edges (ALGORITHM E)."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterator

from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import PATH, Edge
from dssmsg.graph.view import GraphView


def edge_key(a: str, b: str) -> tuple[str, str, str]:
    """The key of the (undirected) path edge between two waypoints, whichever way they are named."""
    first, second = sorted((a, b), key=id_order)
    return PATH, first, second


def nearest_waypoints(graph: GraphView, x: float, y: float, count: int) -> tuple[str, ...]:
    """The `count` waypoints nearest to a place on the floor (world metres), in order; ties: the older."""
    return tuple(
        heapq.nsmallest(
            count,
            graph.waypoints,
            key=lambda i: (math.hypot(*(graph.waypoints[i].position[:2] - (x, y))), id_order(i)),
        )
    )


def shortest_path(
    graph: GraphView,
    start: str,
    goal: str,
    *,
    longest: float = math.inf,
    without: tuple[str, str, str] | None = None,
    try_blocked: Callable[[Edge], bool] | None = None,
) -> tuple[str, ...] | None:
    """Waypoint ids from `start` to `goal`, both included, the shortest by length; None if there is no way.

    Ways longer than `longest` metres are not looked for, so that the search stays around `start`; nor ways
    over the edge `without`. A blocked edge (`blocked: true`) is no way, unless `try_blocked` says so of
    it. Of equally long ways the one through older waypoints is taken.
    """
    if start not in graph.waypoints or goal not in graph.waypoints:
        return None
    queue: list[tuple[float, tuple[str, int, int], str, str | None]] = [(0.0, id_order(start), start, None)]
    came_from: dict[str, str | None] = {}
    while queue:
        length, _order, node, previous = heapq.heappop(queue)
        if node in came_from:
            continue
        came_from[node] = previous
        if node == goal:
            return _walk_back(came_from, goal)
        for edge, other in _open_edges(graph, node, try_blocked):
            further = length + edge_length(graph, edge)
            if other not in came_from and further <= longest and edge_key(node, other) != without:
                heapq.heappush(queue, (further, id_order(other), other, node))
    return None


def edge_length(graph: GraphView, edge: Edge) -> float:
    """Metres of a path edge: as driven, else the straight line."""
    length = edge.attributes.get("length")
    if length is not None:
        return float(length)
    a, b = graph.waypoints[edge.source].position, graph.waypoints[edge.target].position
    return math.hypot(*(a[:2] - b[:2]))


def path_length(graph: GraphView, path: tuple[str, ...]) -> float:
    """Metres of a way over waypoints. Raises KeyError where two of them are not joined by an edge."""
    steps = itertools.pairwise(path)
    return math.fsum(edge_length(graph, graph.edges[edge_key(a, b)]) for a, b in steps)


def _open_edges(
    graph: GraphView, node: str, try_blocked: Callable[[Edge], bool] | None
) -> Iterator[tuple[Edge, str]]:
    for edge in graph.edges_of(node, PATH):
        if not edge.attributes.get("blocked") or (try_blocked is not None and try_blocked(edge)):
            yield edge, edge.target if edge.source == node else edge.source


def _walk_back(came_from: dict[str, str | None], goal: str) -> tuple[str, ...]:
    path: list[str] = []
    node: str | None = goal
    while node is not None:
        path.append(node)
        node = came_from[node]
    return tuple(reversed(path))
