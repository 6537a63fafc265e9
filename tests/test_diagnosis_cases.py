"""What episodes of an evaluation of diagnosis are made of: goals that a tour shows, faults that bite."""

from __future__ import annotations

import pytest

from dssmsg.evaluate.diagnosis_views import opened_views, shown_by
from dssmsg.evaluate.faults.host import Aim
from dssmsg.evaluate.faults.matching import WrongWeights
from dssmsg.events import Candidate
from dssmsg.interfaces import TargetGraph, TargetNode
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.scene import load_scene
from dssmsg.sim.scene_placement import Placer


@pytest.fixture(scope="module")
def shown():
    """What the tour of a packaged home shows in images of two widths."""
    scene = load_scene("rs_int")
    placer = Placer(scene, FurnitureLibrary.open("embedded"))
    with opened_views() as views:
        return scene, {width: shown_by(views, scene, placer, 0, width) for width in (100, 640)}


def test_larger_images_show_more(shown):
    _, by_width = shown
    few, many = by_width[100].shares, by_width[640].shares
    assert set(few) < set(many)
    assert all(few[name] <= many[name] for name in few)


def test_shares_are_of_the_views(shown):
    scene, by_width = shown
    views = sum(len(stop.views) for stop in scene.tour)
    for share in by_width[640].shares.values():
        assert 0.0 < share <= 1.0
        assert share * views == pytest.approx(round(share * views))


def test_the_end_of_the_tour_shows_some_of_it(shown):
    _, by_width = shown
    assert by_width[640].last
    assert by_width[640].last < set(by_width[640].shares)


class Ranked:
    """A grounding with two answers: the right one first."""

    def ground(self, target):
        right = {"s_graph": 2.0, "s_core": 1.0, "s_view": 1.0, "score": 3.3}
        wrong = {"s_graph": 0.4, "s_core": 0.0, "s_view": 0.5, "score": 0.55}
        return (Candidate("viewpoint-1.1", 1, right, {}), Candidate("viewpoint-2.1", 2, wrong, {}))


@pytest.mark.parametrize("seed", range(3))
def test_wrong_weights_turn_the_order_and_stay_in_order_themselves(seed):
    target = TargetGraph("the sofa", (TargetNode("sofa"),))
    found = WrongWeights(Ranked(), None, Aim("sofa", ("bed",), seed)).ground(target)
    assert [one.viewpoint_id for one in found] == ["viewpoint-2.1", "viewpoint-1.1"]
    assert [one.rank for one in found] == [1, 2]
    assert found[0].scores["score"] > found[1].scores["score"]
