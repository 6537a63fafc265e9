"""Small scene graphs written down by hand: waypoints, viewpoints, edges, objects; and a stand-in encoder."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np

from dssmsg.graph import changes as c
from dssmsg.graph.nodes import BELIEVED, NEAR, PATH, SEES
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.interfaces.source import SourceInfo

CAUSE = c.Cause("test/floor", "drawn")


def camera_pose(x, y, heading=0.0, tilt=0.0, z=0.88):
    """world_from_camera (4, 4), OpenCV axes; radians."""
    h, t = heading, tilt
    forward = np.array([math.cos(h) * math.cos(t), math.sin(h) * math.cos(t), math.sin(t)])
    right = np.array([math.sin(h), -math.cos(h), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = x, y, z
    return pose


class FloorGraph:
    """Builds a graph; `waypoint` also gives it one viewpoint, `viewpoint-N.1`."""

    def __init__(self):
        self.graph = SceneGraph()
        self._waypoints = self._objects = 0

    def add(self, *changes):
        self.graph.apply_all(changes, 0, 0.0)

    def waypoint(self, x, y, heading=0.0, tilt=0.0):
        self._waypoints += 1
        name = f"waypoint-{self._waypoints}"
        view = f"viewpoint-{self._waypoints}.1"
        self.add(
            c.WaypointAdded(cause=CAUSE, waypoint_id=name, position=np.array([x, y, 0.0])),
            c.ViewpointAdded(
                cause=CAUSE,
                viewpoint_id=view,
                waypoint_id=name,
                world_from_camera=camera_pose(x, y, heading, tilt),
                heading=heading,
                tilt=tilt,
            ),
        )
        return name

    def path(self, a, b, length=None, blocked=False):
        positions = [self.graph.waypoints[i].position for i in (a, b)]
        metres = float(np.linalg.norm(positions[0] - positions[1])) if length is None else length
        attributes = {"length": metres, "verified": "driven", "blocked": blocked}
        self.add(c.EdgeAdded(cause=CAUSE, edge=PATH, source=a, target=b, attributes=attributes))

    def thing(
        self, label, x, y, seen_from, feature=None, status=BELIEVED, *, z=0.5, size=0.2, color=0, image=None
    ):
        """An object in a box of `size` metres: 20 points, or with three sizes 300, most on top."""
        self._objects += 1
        name = f"object-{self._objects}"
        count = 20 if np.ndim(size) == 0 else 300
        spread = np.random.default_rng(self._objects).uniform(-0.5, 0.5, (count, 3))
        spread[20:, 2] = 0.5
        points = (spread * size + np.array([x, y, z])).astype(np.float32)
        self.add(
            c.ObjectAdded(
                cause=CAUSE,
                object_id=name,
                label=label,
                score=1.0,
                points=points,
                colors=np.zeros((count, 3), np.uint8) + np.array(color, np.uint8),
                viewpoint_id=seen_from[0],
                range_m=1.0,
                text_feature=feature,
                image_feature=image,
            ),
            c.ObjectChanged(cause=CAUSE, object_id=name, values={"status": status}),
        )
        for viewpoint in seen_from:
            self.add(
                c.EdgeAdded(
                    cause=CAUSE, edge=SEES, source=viewpoint, target=name, attributes={"distance": 1.0}
                )
            )
        return name

    def near(self, a, b):
        """A `near` edge; what it says of the two is not looked at."""
        attributes = {"distance": 0.1, "relation": "next to", "offset": [0.1, 0.0, 0.0]}
        self.add(c.EdgeAdded(cause=CAUSE, edge=NEAR, source=a, target=b, attributes=attributes))


class WordEncoder:
    """Labels as unit vectors: the same word the same axis, `kin` pairs at cosine 0.6."""

    space, dimension = "words/16", 16

    def __init__(self, kin=()):
        self._axes = {}
        self._kin = dict(kin)

    def encode_labels(self, labels):
        vectors = np.zeros((len(labels), self.dimension), np.float32)
        for row, label in enumerate(labels):
            near = self._kin.get(label)
            if near is None:
                vectors[row, self._axis(label)] = 1.0
            else:
                vectors[row, self._axis(near)], vectors[row, self._axis(label)] = 0.6, 0.8
        return vectors

    encode_text = encode_labels

    def encode_crops(self, crops):
        return None

    def _axis(self, label):
        return self._axes.setdefault(label, len(self._axes))


def context(graph, encoder=None, camera=None, **others):
    """A Context as far as these plug-ins look into it."""
    source = SourceInfo("test", camera or SimpleNamespace(), drivable=True, has_truth=False)
    return SimpleNamespace(graph=graph, encoder=encoder, source=source, **others)
