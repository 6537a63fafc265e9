"""The scorers of changing homes, on cases worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from dssmsg.evaluate.dynamic import (
    Claim,
    Tally,
    Thing,
    dynamic_tally,
    fits,
    full_tally,
    split_moves,
    static_tally,
    update_score,
)
from dssmsg.evaluate.visible import Place


def box(x, size=1.0):
    return np.array([x, 0.0, 0.0]), np.array([x + size, size, size])


def place(label, x, size=1.0, *, surface=None):
    low, high = box(x, size)
    surface_low, surface_high = (None, None) if surface is None else surface
    return Place(f"{label} at {x}", label, "", 5, low, high, surface_low, surface_high)


def claim(number, label, state, x, former=None, size=1.0):
    return Claim(
        f"object-{number}", label, state, box(x, size), None if former is None else box(former, size)
    )


def thing(label, state, x, former=None, **more):
    return Thing(
        f"{label}-1", label, state, place(label, x), None if former is None else place(label, former), **more
    )


HOME = [
    thing("sofa", "static", 0, retained=True),
    thing("bed", "static", 10, retained=True),
    thing("mug", "appeared", 20),
    thing("book", "disappeared", 30),
    thing("chair", "moved", 50, former=40),
]
RIGHT = [
    claim(1, "sofa", "static", 0),
    claim(2, "bed", "static", 10),
    claim(3, "mug", "appeared", 20),
    claim(4, "book", "disappeared", 30),
    claim(5, "chair", "moved", 50, former=40),
]


def counts(tally):
    return tally.right, len(tally.wrong), len(tally.missed), tally.ignored


def test_a_map_that_is_right_in_everything():
    assert counts(static_tally(RIGHT, HOME)) == (2, 0, 0, 0)
    assert counts(dynamic_tally(RIGHT, HOME)) == (3, 0, 0, 0)
    assert counts(full_tally(RIGHT, HOME)) == (5, 0, 0, 0)
    assert full_tally(RIGHT, HOME).f1 == 1.0


def test_a_map_that_never_noticed():
    """Five static claims: two right; the book and the chair are ghosts, and nothing of the rest is known."""
    stale = [
        claim(1, "sofa", "static", 0),
        claim(2, "bed", "static", 10),
        claim(4, "book", "static", 30),
        claim(5, "chair", "static", 40),
    ]
    static = static_tally(stale, HOME)
    assert counts(static) == (2, 2, 0, 0)
    assert static.precision == 0.5
    assert static.recall == 1.0
    dynamic = dynamic_tally(stale, HOME)
    assert counts(dynamic) == (0, 0, 3, 0)
    assert (dynamic.precision, dynamic.recall, dynamic.f1) == (0.0, 0.0, 0.0)
    assert full_tally(stale, HOME).f1 == pytest.approx(2 * 2 / (4 + 5))


def test_the_right_place_with_the_wrong_state_is_missed_and_wrong():
    claims = [*RIGHT[:2], claim(3, "mug", "moved", 20, former=5), claim(5, "chair", "appeared", 50)]
    assert counts(dynamic_tally(claims, HOME)) == (0, 2, 3, 0)


def test_a_static_claim_where_something_changed_is_the_dynamic_tallys_business():
    claims = [*RIGHT[:2], claim(3, "mug", "static", 20)]
    assert counts(static_tally(claims, HOME)) == (2, 0, 0, 1)


def test_a_move_must_come_from_the_right_place():
    assert dynamic_tally([claim(5, "chair", "moved", 50, former=47)], HOME).right == 0
    assert dynamic_tally([claim(5, "chair", "moved", 50)], HOME).right == 0
    assert dynamic_tally([claim(5, "chair", "moved", 50, former=40)], HOME).right == 1


def test_a_move_split_into_disappear_and_appear():
    """No identity: chair gone from 40, chair new at 50. As a move nothing, as parts everything."""
    claims = [
        claim(3, "mug", "appeared", 20),
        claim(4, "book", "disappeared", 30),
        claim(5, "chair", "disappeared", 40),
        claim(6, "chair", "appeared", 50),
    ]
    assert counts(dynamic_tally(claims, HOME)) == (2, 2, 1, 0)
    assert counts(dynamic_tally(*split_moves(claims, HOME))) == (4, 0, 0, 0)
    assert counts(dynamic_tally(*split_moves(RIGHT, HOME))) == (4, 0, 0, 0)


def test_a_move_whose_old_place_was_not_looked_at_again_has_one_part():
    home = [thing("chair", "moved", 50, former=40, former_seen=False)]
    stale = [claim(5, "chair", "static", 40), claim(6, "chair", "appeared", 50)]
    assert counts(dynamic_tally(*split_moves(stale, home))) == (1, 0, 0, 0)
    assert counts(static_tally(stale, home)) == (0, 0, 0, 1)  # a ghost that nobody could have found out


def test_table_two_takes_one_state_at_a_time():
    assert counts(dynamic_tally(RIGHT, HOME, ["moved"])) == (1, 0, 0, 0)
    assert counts(dynamic_tally(RIGHT[:4], HOME, ["moved"])) == (0, 0, 1, 0)
    assert counts(dynamic_tally([*RIGHT, claim(7, "cup", "appeared", 70)], HOME, ["appeared"])) == (
        1,
        1,
        0,
        0,
    )


def test_two_claims_for_one_thing_are_one_right_and_one_wrong():
    twice = [claim(3, "mug", "appeared", 20), claim(8, "mug", "appeared", 20.1)]
    tally = dynamic_tally(twice, HOME[2:3])
    assert counts(tally) == (1, 1, 0, 0)
    assert tally.wrong == ("object-8 (mug, appeared)",)


def test_assignment_finds_the_pairing_that_serves_all():
    """Claim 1 fits both mugs, claim 2 only the first: greedy by order would leave one mug without."""
    home = [
        Thing("mug-1", "mug", "appeared", place("mug", 0.0)),
        Thing("mug-2", "mug", "appeared", place("mug", 0.5)),
    ]
    claims = [claim(1, "mug", "appeared", 0.25), claim(2, "mug", "appeared", -0.3)]
    assert counts(dynamic_tally(claims, home)) == (2, 0, 0, 0)


def test_what_nobody_could_know_is_neither_right_nor_wrong():
    home = [
        *HOME[:2],
        thing("mug", "appeared", 20, counted=False),
        thing("lamp", "static", 60, counted=False),
    ]
    claims = [*RIGHT[:3], claim(9, "lamp", "disappeared", 60), claim(10, "lamp", "static", 60)]
    assert counts(dynamic_tally(claims, home)) == (0, 0, 0, 2)
    assert counts(static_tally(claims, home)) == (2, 0, 0, 1)


def test_a_static_thing_called_disappeared_is_wrong():
    tally = dynamic_tally([claim(1, "sofa", "disappeared", 0)], HOME)
    assert tally.wrong == ("object-1 (sofa, disappeared)",)
    assert static_tally([claim(1, "sofa", "disappeared", 0)], HOME).missed == ("sofa-1", "bed-1")


def test_nothing_to_find_and_nothing_claimed_is_perfect():
    nothing = Tally(0, (), ())
    assert (nothing.precision, nothing.recall, nothing.f1) == (1.0, 1.0, 1.0)
    assert (nothing + Tally(1, ("a",), ("b", "c"))).f1 == pytest.approx(2 / 5)


@pytest.mark.parametrize(
    ("size", "shift", "label", "ok"),
    [
        (1.0, 0.5, "mug", True),  # IoU 1/3
        (1.0, 0.7, "mug", False),  # IoU 0.176, centres 0.7 m apart
        (1.0, 0.5, "cup", False),
        (0.08, 0.06, "mug", True),  # IoU 1/7; centres 0.06 m apart, half the diagonal 0.069 m
        (0.08, 0.075, "mug", False),
    ],
)
def test_a_place_is_matched_by_overlap_or_by_centre(size, shift, label, ok):
    assert fits([claim(1, label, "static", shift, size=size)], place("mug", 0.0, size)).tolist() == [ok]


def test_the_visible_surface_will_do():
    """A cupboard of 1 m of which the front 0.2 m was seen: IoU with the whole box is 0.2."""
    low, high = np.zeros(3), np.array([0.2, 1.0, 1.0])
    seen = Claim("object-1", "mug", "static", (low, high))
    assert not fits([seen], place("mug", 0.0)).any()
    assert fits([seen], place("mug", 0.0, surface=(low, high))).all()


def test_table_three():
    before = [
        claim(1, "sofa", "static", 0),
        claim(2, "bed", "static", 10),
        claim(4, "book", "static", 30),
        claim(5, "chair", "static", 40),
    ]
    right = update_score(before, RIGHT, HOME)
    assert (right.changes, right.updated, right.static, right.retained, right.failed) == (3, 3, 2, 2, ())
    # The mug is there, called static; the book still stands there; the chair is at both places; no sofa.
    after = [
        claim(2, "bed", "static", 10),
        claim(3, "mug", "static", 20),
        claim(4, "book", "static", 30),
        claim(5, "chair", "static", 40),
        claim(6, "chair", "appeared", 50),
    ]
    score = update_score(before, after, HOME)
    assert (score.changes, score.updated, score.static, score.retained) == (3, 1, 2, 1)
    assert score.failed == ("book-1", "chair-1", "sofa-1")


def test_a_place_taken_by_another_of_its_kind_is_not_a_ghost():
    swapped = [
        Thing("mug-1", "mug", "moved", place("mug", 5), place("mug", 0)),
        Thing("mug-2", "mug", "moved", place("mug", 0), place("mug", 5)),
    ]
    before = [claim(1, "mug", "static", 0), claim(2, "mug", "static", 5)]
    after = [claim(1, "mug", "moved", 5, former=0), claim(2, "mug", "moved", 0, former=5)]
    assert update_score(before, after, swapped).updated == 2
    assert dynamic_tally(after, swapped).right == 2
    assert dynamic_tally(before, swapped).right == 0
