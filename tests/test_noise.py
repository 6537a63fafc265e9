"""The sensor model."""

from __future__ import annotations

import time

import numpy as np
import pytest
from pydantic import ValidationError

from dssmsg.errors import ConfigError
from dssmsg.sim.camera import Render
from dssmsg.sim.noise import PRESETS, SensorNoise, make_noise

SHAPE = (240, 320)


def flat(depth: float, cosine: float = 1.0) -> Render:
    return Render(
        np.full((*SHAPE, 3), 128, np.uint8),
        np.full(SHAPE, depth),
        np.ones(SHAPE, np.int32),
        np.full(SHAPE, cosine, np.float32),
    )


def test_none_changes_nothing_but_millimetres() -> None:
    view = flat(2.34567)
    rgb, depth = PRESETS["none"].apply(view, np.random.default_rng(0))
    np.testing.assert_array_equal(rgb, view.rgb)
    assert depth.dtype == np.float32
    assert np.unique(depth).tolist() == [np.float32(2.346)]


@pytest.mark.parametrize("z", [0.5, 2.0, 5.0])
def test_depth_noise_grows_with_the_square(z: float) -> None:
    noise = SensorNoise(depth_a=0.001, depth_b=0.002)
    _, depth = noise.apply(flat(z), np.random.default_rng(1))
    assert depth.mean() == pytest.approx(z, abs=0.001)
    assert depth.std() == pytest.approx(0.001 + 0.002 * z * z, rel=0.05)
    assert noise.sigma(z) == pytest.approx(0.001 + 0.002 * z * z)
    assert noise.depth_sigma == (0.001, 0.002)


def test_range_limits_and_nothing_hit() -> None:
    rng = np.random.default_rng(0)
    for depth, lost in ((0.05, True), (0.2, False), (9.9, False), (10.5, True), (0.0, True)):
        assert (PRESETS["none"].apply(flat(depth), rng)[1] == 0).all() == lost
    assert (PRESETS["realistic"].apply(flat(0.0), rng)[1] == 0).all()


def test_readings_go_missing_at_edges_and_grazing_angles_only() -> None:
    view = flat(2.0)
    depth = view.depth.copy()
    depth[:, 160:] = 3.0
    stepped = Render(view.rgb, depth, view.instance_ids, view.cos_incidence)
    noise = SensorNoise(edge_jump=0.05, edge_dropout=0.5)
    lost = noise.apply(stepped, np.random.default_rng(0))[1] == 0
    assert 0.35 < lost[:, 159:161].mean() < 0.65
    assert not np.delete(lost, [159, 160], axis=1).any()
    grazing = SensorNoise(grazing_cos=0.1)
    assert (grazing.apply(flat(2.0, 0.05), np.random.default_rng(0))[1] == 0).all()
    assert (grazing.apply(flat(2.0, 0.2), np.random.default_rng(0))[1] > 0).all()


def test_speckle_share() -> None:
    lost = SensorNoise(speckle=0.02).apply(flat(2.0), np.random.default_rng(0))[1] == 0
    assert 0.012 < lost.mean() < 0.03


def test_colour_noise_exposure_and_blur() -> None:
    rgb, _ = SensorNoise(rgb_noise=4.0).apply(flat(1.0), np.random.default_rng(0))
    assert rgb.std() == pytest.approx(4.0, rel=0.1)
    bright = [
        SensorNoise(exposure=0.2).apply(flat(1.0), np.random.default_rng(i))[0].mean() for i in range(8)
    ]
    assert np.std(bright) > 5
    view = flat(1.0)
    stripes = view.rgb.copy()
    stripes[:, ::2] = 0
    soft, _ = SensorNoise(blur=1.0).apply(
        Render(stripes, view.depth, view.instance_ids, view.cos_incidence), np.random.default_rng(0)
    )
    assert soft.std() < stripes.std() / 2


def test_same_seed_same_reading() -> None:
    noise = PRESETS["realistic"]
    one, two = (noise.apply(flat(2.0), np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(one[0], two[0])
    np.testing.assert_array_equal(one[1], two[1])
    assert not np.array_equal(one[1], noise.apply(flat(2.0), np.random.default_rng(8))[1])


def test_the_next_frame_does_not_depend_on_what_this_one_showed() -> None:
    draws = []
    for first in (0.0, 2.0):
        rng = np.random.default_rng(3)
        PRESETS["realistic"].apply(flat(first), rng)
        draws.append(rng.random())
    assert draws[0] == draws[1]


def test_presets_and_mistakes() -> None:
    assert make_noise("realistic") is PRESETS["realistic"]
    assert make_noise({"depth_b": 0.01}).depth_b == 0.01
    with pytest.raises(ConfigError, match=r"source\.noise: .*realistic"):
        make_noise("heavy")
    with pytest.raises(ConfigError, match=r"source\.noise\.depth_c.*depth_b"):
        make_noise({"depth_c": 1})
    with pytest.raises(ValidationError):
        SensorNoise(depth_a=-1)


def test_fast_enough() -> None:
    rng, view, seconds = np.random.default_rng(0), flat(2.0), []
    for _ in range(15):
        start = time.perf_counter()
        PRESETS["realistic"].apply(view, rng)
        seconds.append(time.perf_counter() - start)
    assert min(seconds) < 0.2  # about 2 ms on an idle core; the limit only catches a change of kind
