"""Voxels, spatial indexes and feature averages, by their laws."""

from __future__ import annotations

import numpy as np
import pytest
from graph_strategies import unit
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dssmsg.graph.fusion import averaged, thinned, with_frame
from dssmsg.graph.spatial import BoxIndex, PointIndex
from dssmsg.graph.tables import Table
from dssmsg.graph.voxels import REACH_M, VOXEL_M, contained, first_in_voxel, voxel_keys

coordinates = st.floats(-50, 50, width=32)
clouds = st.integers(0, 30).flatmap(lambda n: arrays(np.float32, (n, 3), elements=coordinates))


@given(clouds)
def test_two_points_share_a_key_exactly_where_they_share_a_cell(points: np.ndarray) -> None:
    cells = np.floor(points.astype(np.float64) / VOXEL_M)
    keys = voxel_keys(points)
    np.testing.assert_array_equal(keys[:, None] == keys[None], (cells[:, None] == cells[None]).all(axis=2))
    order = np.lexsort((cells[:, 2], cells[:, 1], cells[:, 0]))
    assert (np.diff(keys[order]) >= 0).all()


@given(clouds, clouds)
def test_membership_is_that_of_sets(points: np.ndarray, others: np.ndarray) -> None:
    keys, known = voxel_keys(np.concatenate([points, others[:3]])), voxel_keys(others)
    expected = [key in set(known.tolist()) for key in keys.tolist()]
    assert contained(keys, np.sort(known)).tolist() == expected


@given(clouds)
def test_thinning_keeps_the_first_of_each_voxel_and_is_idempotent(points: np.ndarray) -> None:
    points = np.repeat(points, 2, axis=0)
    colors = np.arange(points.size, dtype=np.uint8).reshape(points.shape)
    keys = voxel_keys(points).tolist()
    kept, kept_colors = thinned(points, colors)
    firsts = [i for i, key in enumerate(keys) if key not in keys[:i]]
    np.testing.assert_array_equal(kept, points[firsts])
    np.testing.assert_array_equal(kept_colors, colors[firsts])
    assert first_in_voxel(voxel_keys(kept)).all()
    assert thinned(kept, kept_colors)[0] is kept


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 2 * REACH_M])
def test_what_has_no_voxel_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="26 km"):
        voxel_keys(np.array([[0.0, value, 0.0]]))


sizes = st.floats(0, 3)
boxes = st.tuples(st.tuples(*[coordinates] * 3), st.tuples(*[sizes] * 3)).map(
    lambda box: (np.array(box[0]), np.array(box[0]) + np.array(box[1]))
)
huge = st.just((np.full(3, -40.0), np.full(3, 40.0)))


@given(st.lists(st.tuples(st.integers(0, 9), boxes | huge | st.none()), max_size=30), boxes | huge)
def test_the_box_index_finds_what_an_exhaustive_search_finds(writes: list, asked: tuple) -> None:
    index, known = BoxIndex(), {}
    for number, box in writes:  # inserted, replaced and removed in any order
        name = f"object-{number}"
        if box is None:
            index.remove(name)
            known.pop(name, None)
        else:
            index.set(name, *box)
            known[name] = box
    touching = {n for n, (low, high) in known.items() if (low <= asked[1]).all() and (asked[0] <= high).all()}
    found = index.touching(*asked)
    assert set(found) == touching
    assert len(found) == len(touching)


@given(
    st.lists(st.tuples(*[st.floats(-4, 4)] * 3), max_size=20),
    st.tuples(*[st.floats(-4, 4)] * 3),
    st.floats(0, 3),
)
def test_the_point_index_finds_what_an_exhaustive_search_finds(
    points: list, asked: tuple, radius: float
) -> None:
    index = PointIndex()
    for number, point in enumerate(points):
        index.set(f"viewpoint-1.{number}", np.array(point))
    index.remove("viewpoint-1.0")
    distances = {f"viewpoint-1.{n}": np.linalg.norm(np.subtract(p, asked)) for n, p in enumerate(points) if n}
    found = set(index.within(np.array(asked), radius))
    assert {n for n, d in distances.items() if d < radius - 1e-9} <= found
    assert found <= {n for n, d in distances.items() if d <= radius + 1e-9}


def test_a_table_takes_back_writes_with_their_order() -> None:
    told: list[tuple] = []
    table: Table[str, int] = Table(lambda *write: told.append(write))
    for number, key in enumerate("abc"):
        table.put(key, number)
    table.keep()
    table.drop("a")
    table.put("b", 7)
    table.put("d", 8)
    table.put("a", 9)
    assert list(table.rows.items()) == [("b", 7), ("c", 2), ("d", 8), ("a", 9)]
    told.clear()
    table.take_back()
    assert list(table.rows.items()) == [("a", 0), ("b", 1), ("c", 2)]
    assert told == [("a", 9, None), ("d", 8, None), ("b", 7, 1), ("a", None, 0)]
    with pytest.raises(KeyError):
        table.drop("d")


@given(st.integers(0, 99), st.integers(0, 99), st.integers(1, 50), st.integers(1, 50))
def test_averages_are_unit_vectors_between_the_two(a: int, b: int, m: int, n: int) -> None:
    u, v = unit(a), unit(b)
    mean = averaged(u, m, v, n)
    assert mean is not None
    assert mean.dtype == np.float32
    assert abs(float(np.linalg.norm(mean)) - 1) < 1e-6
    assert mean @ u >= u @ v - 1e-5
    assert averaged(u, m, None, n) is u
    assert averaged(None, m, v, n) is v
    assert averaged(u, m, -u, m) is u
    np.testing.assert_allclose(mean, averaged(v, n, u, m), atol=1e-6)


@given(st.lists(st.integers(0, 20)))
def test_frames_stay_ascending_and_unique(frames: list[int]) -> None:
    kept: tuple[int, ...] = ()
    for frame in frames:
        kept = with_frame(kept, frame)
    assert list(kept) == sorted(set(frames))
