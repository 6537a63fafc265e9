"""Witnesses for the relations of a target graph, the words held against geometry, and attributes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from floor_graph import FloorGraph

from dssmsg.frame import Camera
from dssmsg.graph.attribute_check import attribute_score, color_share
from dssmsg.graph.relation_check import RelationCheck
from dssmsg.graph.subgraph import local_subgraphs, pixels_of, things_of
from dssmsg.graph.target_tree import TargetTree, Witnesses, target_degrees


def test_degrees_count_neighbours_once():
    assert target_degrees(3, [(0, 1), (1, 0), (1, 2), (2, 2)]).tolist() == [1, 2, 1]


def test_the_tree_hangs_from_the_core_and_breaks_circles():
    tree = TargetTree([(1, 0, "on"), (1, 2, "near"), (2, 0, "near"), (3, 4, "by")], core=0)
    assert [(link.node, link.parent, link.word, link.outward) for link in tree.links] == [
        (1, 0, "on", False), (2, 0, "near", False),
    ]  # fmt: skip


@pytest.mark.parametrize("seed", range(30))
def test_witnesses_are_the_best_of_all(seed):
    """A core with two leaves, one of which carries another: against every choice."""
    rng = np.random.default_rng(seed)
    count = 5
    table = {word: rng.random((count, count)) for word in "abc"}
    likeness = np.where(rng.random((4, count)) < 0.7, rng.random((4, count)), 0.0)
    tree = TargetTree([(0, 1, "a"), (2, 0, "b"), (1, 3, "c")], core=0)
    made = Witnesses(tree, likeness, lambda word, a, b: float(table[word][a, b])).of(0)
    best = 0.0
    for one, two, three in itertools.product([*range(count), None], repeat=3):
        if (one is not None and one in (0, two)) or two == 0 or (three is not None and three == one):
            continue
        worth = 0.0
        if one is not None:
            if likeness[1, one] == 0:
                continue
            worth += likeness[1, one] * table["a"][0, one]
            if three is not None and likeness[3, three] > 0:
                worth += likeness[3, three] * table["c"][one, three]
        if two is not None:
            worth += likeness[2, two] * table["b"][two, 0]
        best = max(best, worth)
    assert made.score == pytest.approx(best / 3)


def test_two_chairs_are_two_things():
    tree = TargetTree([(0, 1, "near"), (0, 2, "near")], core=0)
    likeness = np.array([[1, 0, 0], [0, 1, 1], [0, 1, 1]], float)
    made = Witnesses(tree, likeness, lambda *_: 1.0).of(0)
    assert (made.score, set(made.witnesses.values())) == (1.0, {1, 2})
    likeness[:, 2] = 0
    assert Witnesses(tree, likeness, lambda *_: 1.0).of(0).score == pytest.approx(0.5)


def test_long_chains_take_no_longer_than_their_links():
    """20 nodes in a row over 60 things: every choice tried would never end."""
    tree = TargetTree([(i, i + 1, "near") for i in range(19)], core=0)
    asked = []
    Witnesses(tree, np.ones((20, 60)), lambda word, a, b: asked.append(word) or 0.5).of(0)
    assert len(asked) < 20 * 60 * 60


def things(*rows):
    """(label, x, y, z, size) all seen from one viewpoint at the origin that looks along x."""
    floor = FloorGraph()
    floor.waypoint(0, 0)
    for label, x, y, z, size in rows:
        floor.thing(label, x, y, ["viewpoint-1.1"], z=z, size=size)
    return floor, things_of(floor.graph)


TABLE = ("table", 2.0, 0.0, 0.4, (1.0, 1.0, 0.6))


@pytest.mark.parametrize(
    ("word", "place", "other"),
    [
        ("on", (2.0, 0.0, 0.75), (2.0, 1.2, 0.75)),
        ("on top of", (2.0, 0.0, 0.75), (2.0, 1.2, 0.2)),
        ("next to", (2.0, 0.9, 0.3), (2.0, 2.5, 0.3)),
        ("above", (2.0, 0.0, 1.6), (2.0, 0.0, 0.05)),
        ("below", (2.0, 0.0, 0.0), (2.0, 0.0, 1.6)),
        ("left of", (2.0, 0.9, 0.3), (2.0, -0.9, 0.3)),
        ("right of", (2.0, -0.9, 0.3), (2.0, 0.9, 0.3)),
        ("in front of", (1.0, 0.0, 0.3), (3.0, 0.0, 0.3)),
        ("behind", (3.0, 0.0, 0.3), (1.0, 0.0, 0.3)),
        ("near", (2.0, 0.9, 0.3), (2.0, 3.0, 0.3)),
        ("unheard of", (2.0, 0.9, 0.3), (2.0, 3.0, 0.3)),
    ],
)
def test_words_hold_where_they_should(word, place, other):
    floor, found = things(("mug", *place, 0.2), ("mug", *other, 0.2), TABLE)
    check = RelationCheck(floor.graph, found)
    assert check.holds(word, 0, 2) > check.holds(word, 1, 2) + 0.1
    assert 0.0 <= check.holds(word, 1, 2) <= check.holds(word, 0, 2) <= 1.0


def test_nothing_stands_in_a_relation_to_itself():
    floor, found = things(TABLE)
    assert RelationCheck(floor.graph, found).holds("near", 0, 0) == 0.0


def test_what_is_never_seen_together_is_less_near():
    floor = FloorGraph()
    floor.waypoint(0, 0)
    floor.waypoint(5, 0)
    floor.thing("a", 2, 0, ["viewpoint-1.1"])
    floor.thing("b", 2.5, 0, ["viewpoint-2.1"])  # beyond a wall
    floor.thing("c", 2, 0.5, ["viewpoint-1.1"])
    check = RelationCheck(floor.graph, things_of(floor.graph))
    assert check.holds("near", 0, 1) == pytest.approx(check.holds("near", 0, 2) / 2)


@pytest.mark.parametrize(
    ("word", "color"),
    [
        ("red", (190, 30, 30)), ("green", (40, 150, 50)), ("blue", (30, 50, 170)), ("yellow", (220, 200, 40)),
        ("black", (25, 25, 28)), ("white", (235, 235, 230)), ("grey", (128, 128, 128)),
        ("brown", (110, 70, 35)),
        ("beige", (222, 205, 170)), ("dark blue", (15, 20, 90)), ("gray", (120, 120, 120)),
        ("orange", (240, 130, 20)), ("purple", (120, 40, 150)), ("pink", (240, 150, 180)),
    ],
)  # fmt: skip
def test_colour_words_fit_their_colours(word, color):
    assert color_share(word, np.full((10, 3), color, np.uint8)) == 1.0


def test_colours_do_not_fit_each_other():
    samples = {"red": (190, 30, 30), "green": (40, 150, 50), "blue": (30, 50, 170), "white": (235, 235, 230)}
    for word, other in itertools.permutations(samples, 2):
        assert color_share(word, np.full((4, 3), samples[other], np.uint8)) == 0.0


def test_what_is_no_colour_is_not_judged():
    assert color_share("wooden", np.zeros((4, 3), np.uint8)) is None
    assert color_share("red", np.zeros((0, 3), np.uint8)) is None


def test_sizes_compare_a_thing_with_its_likes():
    _floor, found = things(
        ("box", 2, 0, 0.5, 0.2), ("box", 2, 1, 0.5, 0.6), ("box", 2, 2, 0.5, (1.0, 0.2, 0.2))
    )
    assert attribute_score(["big"], found[1], found) == 1.0
    assert attribute_score(["small"], found[0], found) == 1.0
    assert attribute_score(["tall"], found[1], found) == 1.0
    assert attribute_score(["long"], found[2], found) == 1.0
    assert attribute_score(["big"], found[0], found) == 0.0
    assert attribute_score(["big"], found[0], found[:1]) is None  # nothing to compare it with
    assert attribute_score(["wooden"], found[0], found) is None
    assert attribute_score(["not big"], found[1], found) == 0.0
    assert attribute_score(["not big"], found[0], found) == 1.0
    assert attribute_score(["not wooden"], found[0], found) is None
    assert attribute_score(["big or small"], found[0], found) == 1.0
    assert attribute_score(["wooden or big"], found[0], found) == 0.0
    assert attribute_score(["wooden or old"], found[0], found) is None


def test_subgraphs_hold_what_is_seen_and_its_edges_inside():
    floor = FloorGraph()
    floor.waypoint(0, 0)
    floor.waypoint(3, 0)
    floor.thing("a", 1, 0, ["viewpoint-1.1"])
    floor.thing("b", 1, 0.4, ["viewpoint-1.1", "viewpoint-2.1"])
    floor.thing("c", 1, 0.8, ["viewpoint-2.1"])
    floor.near("object-1", "object-2")
    floor.near("object-2", "object-3")
    one, two = local_subgraphs(floor.graph, things_of(floor.graph))
    assert (one.viewpoint_id, one.things.tolist(), one.degrees.tolist()) == ("viewpoint-1.1", [0, 1], [1, 1])
    assert (two.viewpoint_id, two.things.tolist(), two.degrees.tolist()) == ("viewpoint-2.1", [1, 2], [1, 1])


def test_pixels_shrink_with_distance_and_end_at_the_edge_of_the_image():
    camera = Camera.from_fov(320, 240, np.deg2rad(69.4))
    floor, found = things(
        ("a", 1, 0, 0.88, 0.2), ("a", 2, 0, 0.88, 0.2), ("a", -1, 0, 0.88, 0.2), ("a", 1, 3, 0.88, 0.2)
    )
    view = floor.graph.viewpoints["viewpoint-1.1"]
    near, far, behind, aside = (pixels_of(thing, view, camera) for thing in found)
    assert near == pytest.approx(4 * far, rel=0.2)
    assert behind == aside == 0.0
