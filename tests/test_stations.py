"""Places are numbered as they come; what lies near one bears its number."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dssmsg.graph.stations import Stations

places = st.lists(st.tuples(*[st.floats(-3, 3)] * 3), min_size=1, max_size=40)


@given(places, st.sampled_from([0.25, 0.5, 2.0]))
def test_a_place_is_the_first_one_that_is_near(positions, apart):
    stations, known = Stations(apart), []
    for position in map(np.array, positions):
        near = [number for number, there in enumerate(known) if np.linalg.norm(position - there) < apart]
        if not near:
            known.append(position)
        assert stations.number(position) == (near[0] if near else len(known) - 1)


def test_a_place_stays_where_it_was_though_the_array_moves_on():
    stations, here = Stations(0.5), np.zeros(3)
    assert stations.number(here) == 0
    here += 5.0
    assert stations.number(here) == 1
    assert stations.number(np.zeros(3)) == 0
