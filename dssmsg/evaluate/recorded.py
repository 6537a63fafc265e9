"""Scores of a recording against the truth in it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import networkx as nx
import numpy as np

from dssmsg.errors import InputError
from dssmsg.evaluate.static import StaticScore, score_static
from dssmsg.evaluate.visible import VisibleTruth
from dssmsg.graph.nodes import PATH
from dssmsg.graph.view import GraphView
from dssmsg.recording.reader import Recording


@dataclass(frozen=True, slots=True)
class RecordedScore:
    """The static score of the final graph, and how many driven pairs of stops its topology connects."""

    score: StaticScore
    stop_pairs: int
    connected_stops: int


def score_recording(path: Path) -> RecordedScore:
    """Score a recording that holds the truth; raises InputError where it holds none."""
    with Recording.open(path) as recording:
        visible = VisibleTruth()
        known = False
        for index in recording.frame_indices:
            truth = recording.truth(index)
            if truth is not None:
                known = True
                visible.add(recording.frame(index), truth)
        if not known:
            raise InputError("the recording holds no ground truth to score against", file=path)
        graph = recording.graph_at()
        pairs = driven_pairs(recording)
        connected = sum(are_connected(graph, a, b) for a, b in pairs)
        return RecordedScore(score_static(graph.objects.values(), visible.places()), len(pairs), connected)


def driven_pairs(recording: Recording) -> list[tuple[np.ndarray, np.ndarray]]:
    """Positions (3,) of the stops between which the robot drove, one pair a leg, visit by visit."""
    stops: list[tuple[int, np.ndarray]] = []
    for row in recording.navigation():
        if row["state"] == "look":
            frame = int(row["frame"])
            stops.append((recording.visit(frame), recording.frame(frame).world_from_base[:3, 3]))
    return [(a, b) for (visit, a), (other, b) in pairwise(stops) if visit == other]


def are_connected(graph: GraphView, a: np.ndarray, b: np.ndarray) -> bool:
    """Whether unblocked `path` edges lead from the waypoint nearest to `a` to the one nearest to `b`."""
    roads = nx.Graph()
    roads.add_nodes_from(graph.waypoints)
    roads.add_edges_from(
        (edge.source, edge.target)
        for edge in graph.edges.values()
        if edge.kind == PATH and not edge.attributes.get("blocked", False)
    )
    ends = [
        min(graph.waypoints.values(), key=lambda w: float(np.linalg.norm(w.position - place)))
        for place in (a, b)
    ]
    return bool(nx.has_path(roads, ends[0].id, ends[1].id))
