"""Relations of two shapes, and the sees and near edges of a key frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from graph_strategies import CAUSE, pose
from hypothesis import given
from hypothesis import strategies as st

from dssmsg.frame import Camera, Frame
from dssmsg.graph import changes as c
from dssmsg.graph.edges import edge_changes
from dssmsg.graph.relations import gap, inverse, relation
from dssmsg.graph.scene_graph import SceneGraph


@dataclass
class Solid:
    """A shape whose visible surface is a union of boxes' surfaces, sampled at 0.05 m."""

    points: np.ndarray

    @property
    def box_min(self) -> np.ndarray:
        """Lower corner."""
        return self.points.min(axis=0).astype(np.float64)

    @property
    def box_max(self) -> np.ndarray:
        """Upper corner."""
        return self.points.max(axis=0).astype(np.float64)


def solid(*boxes: tuple[float, float, float, float, float, float]) -> Solid:
    """A shape of boxes (x0, y0, z0, x1, y1, z1): points on their surfaces."""
    return Solid(np.concatenate([surface(*box) for box in boxes]).astype(np.float32))


def surface(x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> np.ndarray:
    """Points (N, 3) every 0.05 m or less on the surface of a box."""
    axes = [np.linspace(a, b, max(2, round((b - a) / 0.05) + 1)) for a, b in ((x0, x1), (y0, y1), (z0, z1))]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    on_face = ((grid == (x0, y0, z0)) | (grid == (x1, y1, z1))).any(axis=1)
    return grid[on_face]


TABLE = solid((0, 0, 0.70, 1.2, 0.8, 0.75), (0, 0, 0, 0.05, 0.05, 0.7), (1.15, 0.75, 0, 1.2, 0.8, 0.7))
SOFA = solid(
    (0, 0, 0, 2, 0.9, 0.42),
    (0, 0.7, 0.42, 2, 0.9, 0.8),
    (0, 0, 0.42, 0.2, 0.9, 0.6),
    (1.8, 0, 0.42, 2, 0.9, 0.6),
)
BASIN = solid((0, 0, 0.7, 0.5, 0.4, 0.72), (0, 0, 0.7, 0.03, 0.4, 0.85), (0.47, 0, 0.7, 0.5, 0.4, 0.85),
              (0, 0, 0.7, 0.5, 0.03, 0.85), (0, 0.37, 0.7, 0.5, 0.4, 0.85))  # fmt: skip
SHELF = solid((0, 0, 0, 0.03, 0.3, 1.5), (0.77, 0, 0, 0.8, 0.3, 1.5), (0, 0.28, 0, 0.8, 0.3, 1.5),
              *((0, 0, z, 0.8, 0.3, z + 0.03) for z in (0.0, 0.4, 0.8, 1.2, 1.47)))  # fmt: skip
RUG = solid((-1, -1, 0, 2, 2, 0.01))

SCENES = {
    "cup on a table": (solid((0.5, 0.3, 0.76, 0.58, 0.38, 0.86)), "on", TABLE),
    "cup measured 3 cm into the table": (solid((0.5, 0.3, 0.72, 0.58, 0.38, 0.82)), "on", TABLE),
    "phone on a table": (solid((0.5, 0.3, 0.75, 0.6, 0.38, 0.76)), "on", TABLE),
    "plate in a basin": (solid((0.15, 0.1, 0.72, 0.35, 0.3, 0.74)), "in", BASIN),
    "pillow on a sofa's seat": (solid((0.8, 0.3, 0.43, 1.2, 0.65, 0.55)), "on", SOFA),
    "cup in a basin": (solid((0.2, 0.15, 0.72, 0.28, 0.23, 0.8)), "in", BASIN),
    "books in a shelf": (solid((0.3, 0.05, 0.84, 0.6, 0.25, 1.1)), "in", SHELF),
    "vase on a shelf's top": (solid((0.3, 0.05, 1.5, 0.45, 0.2, 1.8)), "on", SHELF),
    "table on a rug": (TABLE, "on", RUG),
    "lamp above a table": (solid((0.4, 0.2, 1.5, 0.8, 0.6, 1.7)), "above", TABLE),
    "chair pushed under a table": (
        solid((0.3, 0.2, 0, 0.7, 0.6, 0.45), (0.3, -0.05, 0.45, 0.7, 0.0, 0.9)), "next to", TABLE),
    "chair beside a table": (solid((1.4, 0.2, 0, 1.8, 0.6, 0.9)), "next to", TABLE),
    "cabinet beside, higher up": (solid((1.3, 0.2, 0.75, 1.8, 0.6, 1.4)), "next to", TABLE),
}  # fmt: skip


@pytest.mark.parametrize(("a", "word", "b"), SCENES.values(), ids=SCENES.keys())
def test_relations_of_furniture(a: Solid, word: str, b: Solid) -> None:
    assert relation(a, b) == word
    assert relation(b, a) == inverse(word)


numbers = st.integers(-4, 4).map(lambda n: n / 8)
solids = st.lists(st.tuples(*[numbers] * 3), min_size=1, max_size=30).map(
    lambda points: Solid(np.array(points, np.float32))
)


@given(solids, solids)
def test_a_relation_told_from_the_other_side_is_its_inverse(a: Solid, b: Solid) -> None:
    assert relation(b, a) == inverse(relation(a, b))


@given(solids)
def test_a_thing_is_neither_on_nor_in_itself(a: Solid) -> None:
    assert relation(a, a) == "next to"


@given(solids, solids, st.tuples(numbers, numbers, numbers))
def test_relations_do_not_depend_on_where_in_the_world_it_is(a: Solid, b: Solid, shift: tuple) -> None:
    move = np.array(shift, np.float32)  # eighths of metres: exact in float32
    assert relation(Solid(a.points + move), Solid(b.points + move)) == relation(a, b)


@given(solids, solids)
def test_a_gap_is_no_larger_than_the_distance_of_the_clouds(a: Solid, b: Solid) -> None:
    distance = gap(a.box_min, a.box_max, b.box_min, b.box_max)
    nearest = np.linalg.norm(a.points[:, None] - b.points[None], axis=2).min()
    assert 0 <= distance <= nearest + 1e-6
    assert distance == gap(b.box_min, b.box_max, a.box_min, a.box_max)


def test_words_that_are_not_ours_stay() -> None:
    assert inverse("facing") == "facing"


# -- edges of a key frame -----------------------------------------------------------------------------


def frame_at(x: float, y: float = 0.0) -> Frame:
    """A frame taken at a place, 0.88 m high."""
    camera = Camera.from_fov(4, 3, 1.2)
    image, depth = np.zeros((3, 4, 3), np.uint8), np.zeros((3, 4), np.float32)
    base = np.eye(4)
    base[:3, 3] = x, y, 0.0
    return Frame(0, 0.0, image, depth, camera, pose(x, y), base)


def added(number: int, shape: Solid) -> c.ObjectAdded:
    """An object of that shape."""
    return c.ObjectAdded(
        cause=CAUSE,
        object_id=f"object-{number}",
        label="thing",
        score=0.5,
        points=shape.points,
        colors=np.zeros(shape.points.shape, np.uint8),
        viewpoint_id=None,
        range_m=1.0,
    )


@pytest.fixture
def room() -> SceneGraph:
    """A table (1), a cup on it (2), a chair 0.2 m beside (3), a lamp 3 m off (4), and viewpoint-1.1."""
    graph = SceneGraph()
    cup, chair = SCENES["cup on a table"][0], SCENES["chair beside a table"][0]
    lamp = solid((4.2, 0, 0, 4.4, 0.2, 1.6))
    changes = [added(n, shape) for n, shape in enumerate((TABLE, cup, chair, lamp), 1)]
    place = c.WaypointAdded(cause=CAUSE, waypoint_id="waypoint-1", position=np.zeros(3))
    view = c.ViewpointAdded(
        cause=CAUSE,
        viewpoint_id="viewpoint-1.1",
        waypoint_id="waypoint-1",
        world_from_camera=pose(-2, 0),
        heading=0.0,
        tilt=0.0,
    )
    graph.apply_all([*changes, place, view], 0, 0.0)
    return graph


def observe(graph: SceneGraph, *numbers: int, viewpoint: str | None = "viewpoint-1.1") -> list[c.Change]:
    """Apply the edges of a frame at (-2, 0) that showed some of the objects."""
    changes = edge_changes(graph, [f"object-{n}" for n in numbers], viewpoint, frame_at(-2.0), CAUSE)
    return list(graph.apply_all(changes, 1, 0.2))


def test_things_seen_together_get_near_edges_and_the_viewpoint_sees_them(room: SceneGraph) -> None:
    observe(room, 3, 1, 2, 4, 2)
    assert set(room.edges) == {
        ("sees", "viewpoint-1.1", "object-1"),
        ("sees", "viewpoint-1.1", "object-2"),
        ("sees", "viewpoint-1.1", "object-3"),
        ("near", "object-1", "object-2"),
        ("near", "object-1", "object-3"),
    }
    table_cup = room.edges["near", "object-1", "object-2"].attributes
    assert table_cup["relation"] == "under"
    assert table_cup["distance"] == pytest.approx(0.01, abs=1e-6)
    assert room.edges["near", "object-1", "object-3"].attributes["distance"] == pytest.approx(0.2, abs=1e-6)
    sees = room.edges["sees", "viewpoint-1.1", "object-1"].attributes["distance"]
    assert sees == pytest.approx(np.hypot(2.0, 0.88 - 0.75), abs=1e-6)


def test_things_that_were_never_seen_together_are_not_near(room: SceneGraph) -> None:
    observe(room, 1)
    observe(room, 2)
    assert not [edge for edge in room.edges.values() if edge.kind == "near"]


def test_nothing_is_said_twice_and_only_what_changed(room: SceneGraph) -> None:
    observe(room, 1, 2, 3)
    assert observe(room, 1, 2, 3) == []
    higher = c.ObjectReplaced(
        cause=CAUSE,
        object_id="object-2",
        points=added(2, solid((0.5, 0.3, 1.0, 0.58, 0.38, 1.1))).points,
        colors=np.zeros_like(added(2, solid((0.5, 0.3, 1.0, 0.58, 0.38, 1.1))).points, dtype=np.uint8),
    )
    room.apply(higher)
    (change,) = [
        change
        for change in observe(room, 1, 2, 3)
        if isinstance(change, c.EdgeChanged) and change.edge == "near"
    ]
    assert change.subjects == ("object-1", "object-2")
    assert (change.before["relation"], change.after["relation"]) == ("under", "below")


def test_things_that_come_apart_are_no_longer_near(room: SceneGraph) -> None:
    observe(room, 1, 3)
    far = solid((3.4, 0.2, 0, 3.8, 0.6, 0.9)).points
    room.apply(
        c.ObjectReplaced(cause=CAUSE, object_id="object-3", points=far, colors=np.zeros(far.shape, np.uint8))
    )
    (removed,) = [change for change in observe(room, 1, 3) if isinstance(change, c.EdgeRemoved)]
    assert removed.subjects == ("object-1", "object-3")
    assert removed.scores[0].value > removed.scores[0].threshold


def test_a_frame_between_viewpoints_gives_near_edges_alone(room: SceneGraph) -> None:
    observe(room, 1, 2, viewpoint=None)
    assert list(room.edges) == [("near", "object-1", "object-2")]


def test_what_was_observed_and_has_left_since_is_passed_over(room: SceneGraph) -> None:
    room.apply(c.ObjectRemoved(cause=CAUSE, object_id="object-2"))
    observe(room, 1, 2)
    assert list(room.edges) == [("sees", "viewpoint-1.1", "object-1")]
