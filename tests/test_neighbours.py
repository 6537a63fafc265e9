"""Points of one cloud near another: as counted pair by pair."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dssmsg.graph.voxels import contained, distinct
from dssmsg.neighbours import near_any

clouds = st.lists(st.tuples(*[st.floats(-1, 1, width=32)] * 3), max_size=12).map(
    lambda rows: np.array(rows, np.float32).reshape(-1, 3)
)


@given(clouds, clouds, st.sampled_from([0.013, 0.37, 5.0]))
@settings(max_examples=60, deadline=None)
def test_near_is_what_has_a_point_within_the_tolerance(points, cloud, tolerance):
    apart = np.linalg.norm(points[:, None].astype(np.float64) - cloud[None].astype(np.float64), axis=2)
    nearest = apart.min(axis=1) if len(cloud) else np.full(len(points), np.inf)
    near = near_any(points, cloud, tolerance)
    assert near.shape == (len(points),)
    assert near[nearest < tolerance * 0.999].all()
    assert not near[nearest > tolerance * 1.001].any()


@given(st.lists(st.integers(-5, 5), max_size=20), st.lists(st.integers(-5, 5), max_size=20))
def test_keys_once_in_order_and_found_again(keys, others):
    once = distinct(np.array(keys, np.int64))
    assert once.tolist() == sorted(set(keys))
    assert contained(np.array(others, np.int64), once).tolist() == [other in keys for other in others]
