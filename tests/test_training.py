"""What the networks are taught: targets that say the truth, crops that show it. Needs no torch."""

from __future__ import annotations

import numpy as np
import pytest

from dssmsg.recogniser.contract import OFFSET_PX
from dssmsg.recogniser.shelf import all_labels, seed_range
from training.crops import drawn_mask, nothing_mask
from training.proposals import Proposals, name_of
from training.render import CLUTTERED_FROM, KINDS, VIEWS_A_SEED, load, render, shards
from training.samples import Views, recoloured, repainted, targets

IDS = np.zeros((120, 160), np.uint8)
IDS[20:60, 30:90] = 1
IDS[70:80, 100:112] = 2
LABEL = np.array([-1, 5, 9], np.int16)


def test_votes_lead_to_the_centre_and_small_things_weigh_more():
    thing, heat, border, offset, weight, classes = targets(IDS, LABEL)
    v, u = np.mgrid[:120, :160]
    for number in (1, 2):
        at = number == IDS
        assert np.ptp((u + offset[0] * OFFSET_PX)[at]) < 1e-3
        assert (u + offset[0] * OFFSET_PX)[at].mean() == pytest.approx(u[at].mean(), abs=1e-3)
        assert (v + offset[1] * OFFSET_PX)[at].mean() == pytest.approx(v[at].mean(), abs=1e-3)
        assert heat[at].max() > 0.8
    np.testing.assert_array_equal(thing > 0, IDS > 0)
    assert weight[75, 105] > weight[40, 60] > 0
    assert weight[0, 0] == 0
    assert border[20, 50] == 1
    assert border[40, 60] == 0
    assert set(np.unique(classes)) == {-1, 5, 9}
    assert classes[20, 30] == 5


def test_a_drawn_mask_is_mostly_the_thing():
    rng = np.random.default_rng(0)
    ids = IDS.repeat(2, 0).repeat(2, 1)
    for _ in range(60):
        mask = drawn_mask(ids, 1, rng)
        assert mask.shape == ids.shape
        assert (mask & (ids == 1)).sum() / max((ids == 1).sum(), 1) > 0.4
        assert (mask & (ids == 1)).sum() / mask.sum() > 0.6


def test_nothing_is_never_one_whole_thing():
    rng = np.random.default_rng(0)
    ids = IDS.repeat(2, 0).repeat(2, 1)
    for _ in range(60):
        mask = nothing_mask(ids, 2, rng)
        assert mask.any()
        assert name_of(mask, ids, LABEL) != LABEL[2]


def test_a_proposal_is_called_by_what_it_covers():
    ids = IDS.repeat(2, 0).repeat(2, 1)
    whole = ids == 1
    assert name_of(whole, ids, LABEL) == 5
    part = whole.copy()
    part[:, 80:] = False
    assert name_of(part, ids, LABEL) == len(all_labels())
    most = whole.copy()
    most[:, 110:] = False
    assert name_of(most, ids, LABEL) is None
    assert name_of(ids == 0, ids, LABEL) == len(all_labels())


def test_a_proposal_comes_back_from_its_bits():
    mask = np.random.default_rng(0).random((240, 320)) < 0.5
    packed = Proposals(np.zeros(1, np.int32), np.zeros(1, np.int32), np.packbits(mask)[None])
    np.testing.assert_array_equal(packed.mask(0), mask)


def test_other_colours_keep_the_picture():
    rgb = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    rng = np.random.default_rng(1)
    for paint in (recoloured, repainted):
        other = paint(rgb, rng)
        assert other.shape == rgb.shape
        assert other.dtype == np.uint8
        assert (other != rgb).any()


def test_shards_are_resumed_and_hold_what_was_seen(tmp_path, capsys):
    seed = KINDS.index("embedded room")
    assert seed < CLUTTERED_FROM
    assert render(tmp_path, range(seed, seed + 1)) == 1
    before = shards(tmp_path)[0].read_bytes()
    assert render(tmp_path, range(seed, seed + 1)) == 0
    assert shards(tmp_path)[0].read_bytes() == before
    shard = load(shards(tmp_path)[0])
    assert shard.rgb.shape == (VIEWS_A_SEED, 240, 320, 3)
    present = np.unique(shard.ids)
    assert (shard.label[present[present > 0]] >= 0).all()
    image, geometry, *_targets = Views(tmp_path).sample(0, np.random.default_rng(0))
    assert image.shape == (3, 240, 320)
    assert geometry.shape[1:] == (120, 160)
    with pytest.raises(ValueError, match="kept for the evaluation"):
        render(tmp_path, seed_range("evaluation")[:1])
