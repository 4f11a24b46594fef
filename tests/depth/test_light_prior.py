# SPDX-License-Identifier: Apache-2.0
"""How frequent lights are, if all surfaces were at the same distance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from coincid.model.depth.light_prior import (
    EVEN,
    LIGHT_FLOOR,
    OFFSETS_SIGMAS,
    STEP,
    LightPrior,
    fall,
    learned_prior,
    mean_prior,
    measured_prior,
    own_priors,
    prior_in_doubt,
    prior_on_surfaces,
)

LIGHTS = np.exp(STEP * np.arange(-6, 7))  # as far apart as the steps
NEAR = np.zeros(1)  # at a distance of one tick


def likelihoods(light, width=0.3):
    """float32[n, lights]: of pixels that know their light to this logarithm."""
    return np.exp(-0.5 * (np.log(LIGHTS / light[:, None]) / width) ** 2).astype(np.float32)


def mean_light(log_prior):
    """Return the mean of the logarithm of the light, without the floor, for each pixel."""
    share = np.exp(log_prior.astype(float))
    share -= share.min(axis=1, keepdims=True)
    return share @ np.log(LIGHTS) / share.sum(axis=1)


@given(prior=arrays(np.float32, (2, 20), elements=st.floats(-20, 0, width=32)))
def test_no_light_counts_as_rarer_than_a_brighter_one_where_the_law_is_in_doubt(prior):
    met = prior_in_doubt(prior, 1.0)
    assert np.all(np.diff(met) <= 1e-5)
    for light in range(20):
        assert met[:, light] == pytest.approx(prior[:, light:].max(axis=1), abs=1e-5)
    assert np.array_equal(prior_in_doubt(prior, 0.0), prior)
    assert prior_in_doubt(prior, 0.25) == pytest.approx(prior + (met - prior) / 4, abs=1e-5)


def test_light_falls_with_the_square_of_the_distance():
    assert fall(np.array([1.0, 2.0, 100.0])) == pytest.approx(np.log([1.0, 4.0, 1e4]))
    assert fall(np.array([-3.0, 0.5])).tolist() == [0.0, 0.0]  # nearer than the first tick


def test_the_shares_of_lights_reach_the_steps_around_them():
    """Pixels between two steps are all nearest to one; the other must not be ruled out for them."""
    chance = np.zeros((10, len(LIGHTS)), np.float32)
    chance[:, 5] = 1.0
    chance[:5, 7] = 0.5
    learned = learned_prior(chance, LIGHTS, np.zeros(10))
    shares = np.exp(own_priors(learned, LIGHTS, NEAR)[0])
    floor = LIGHT_FLOOR / (1 + LIGHT_FLOOR * len(LIGHTS))
    assert shares.sum() == pytest.approx(1)
    assert np.argmax(shares) == 5
    assert shares[4] > 8 * floor and shares[6] > 8 * floor
    assert shares[[0, 1, 10, 11, 12]] == pytest.approx([floor] * 5, rel=0.1)


@given(distance=st.integers(1, 5000), seed=st.integers(0, 9))
def test_pixels_farther_away_are_as_much_darker_as_the_square_of_their_distance(distance, seed):
    """Pixels of one reflectivity: each has its own light as the likeliest, also one that was not
    there when the shares were learned.
    """
    ticks = np.random.default_rng(seed).uniform(1, 4, 50) * distance
    light = (3 * distance / ticks) ** 2 / 4
    learned = learned_prior(likelihoods(light), LIGHTS, fall(ticks))
    others = distance * np.array([1.0, 1.7, 3.1])
    found = mean_light(own_priors(learned, LIGHTS, fall(others)))
    assert found == pytest.approx(np.log((3 * distance / others) ** 2 / 4), abs=0.2)


def test_two_reflectivities_at_many_distances_are_two_peaks():
    ticks = np.tile(np.geomspace(100, 300, 40), 2)
    bright = np.repeat([1.0, 0.1], [20, 60])
    light = bright * (250 / ticks) ** 2
    learned = learned_prior(likelihoods(light), LIGHTS, fall(ticks))
    at = learned.first + STEP * np.arange(len(learned.share))
    middle = np.log(250.0**2) - np.log(10) / 2
    assert learned.share.sum() == pytest.approx(1, abs=1e-6)
    assert learned.share[at > middle].sum() == pytest.approx(0.25, abs=0.05)
    assert learned.share[at < middle].sum() == pytest.approx(0.75, abs=0.05)
    own = np.exp(own_priors(learned, LIGHTS, fall(np.array([250.0])))[0])
    assert own[LIGHTS > 0.316].sum() == pytest.approx(0.25, abs=0.12)


def test_lights_that_are_measured_are_as_frequent_as_lights_that_are_learned():
    ticks = np.geomspace(100, 300, 60).reshape(6, 10)
    signal = 0.5 * (200 / ticks) ** 2
    signal[:3] = 0.0  # unknown
    measured = measured_prior(signal, signal / 20, LIGHTS.astype(np.float32), ticks)
    found = mean_light(own_priors(measured, LIGHTS, fall(np.array([120.0, 280.0]))))
    assert found == pytest.approx(np.log(0.5 * (200 / np.array([120.0, 280.0])) ** 2), abs=0.2)


def test_lights_that_are_unequally_far_apart_stand_for_as_many_steps():
    lights = np.exp(STEP * np.array([0, 1, 2, 3, 5, 7, 9]))
    share = np.full(10, 0.1)
    own = np.exp(own_priors(LightPrior(0.0, share), lights, NEAR)[0])
    assert own[1] / own[5] == pytest.approx((0.1 + LIGHT_FLOOR) / (0.2 + LIGHT_FLOOR))


def test_pixels_that_see_one_surface_tell_their_lights_together():
    """A pixel cannot tell its light from that beside it on a surface that is farther or nearer.

    Half of the pixels have the first of three lights, half have the last. Alone, all may have the
    middle one, which is likeliest. A bright and a dark pixel of one surface cannot. Surfaces are off by
    different times.
    """
    offsets = len(OFFSETS_SIGMAS)
    lights = np.exp(4 * STEP * np.arange(3))
    chance = np.zeros((40, offsets, 3), np.float32)
    for pixel in range(40):
        bright = pixel % 2
        surface = offsets // 2 - 1 + pixel // 4 % 3
        chance[pixel, surface, 2 * bright] = 1
        chance[pixel, surface + (-3 if bright else 3), 1] = 1
    fallen = np.zeros(40)
    alone = learned_prior(chance.sum(axis=1), lights, fallen)
    together = prior_on_surfaces(chance, lights, fallen, np.repeat(np.arange(10), 4))
    for found in (alone, together):
        assert found.share.sum() == pytest.approx(1)
        assert len(found.share) == 13
    assert alone.share[4:9].sum() > 0.9
    assert together.share[4:9].sum() < 0.1
    assert together.share[:4].sum() == pytest.approx(together.share[9:].sum(), abs=0.02)


def test_without_pixels_all_lights_are_alike():
    none = np.zeros((0, len(OFFSETS_SIGMAS), 4), np.float32)
    lights = np.geomspace(0.1, 3, 4)
    fallen = np.zeros(0)
    alone = learned_prior(none[:, 0], lights, fallen)
    for prior in (alone, prior_on_surfaces(none, lights, fallen, np.zeros(0, int)), EVEN):
        assert np.exp(own_priors(prior, lights, np.array([0.0, 9.0]))) == pytest.approx(
            np.full((2, 4), 0.25)
        )


def test_pixels_whose_likelihoods_are_all_0_tell_nothing_of_the_lights():
    chance = np.zeros((3, 4), np.float32)
    lights = np.geomspace(0.1, 3, 4)
    assert learned_prior(chance, lights, np.zeros(3)) is EVEN
    chance[1, 2] = 1.0
    learned = learned_prior(chance, lights, np.array([50.0, 0.0, -50.0]))
    assert np.argmax(own_priors(learned, lights, NEAR)[0]) == 2


def test_the_prior_of_a_subgroup_is_the_mean_of_its_live_pixels():
    own = np.log(np.array([[0.5, 0.5], [0.1, 0.9], [0.9, 0.1]], np.float32))
    live = np.array([True, True, False])
    assert np.exp(mean_prior(own, live)) == pytest.approx([0.3, 0.7])
    assert np.exp(mean_prior(own, ~live)) == pytest.approx([0.9, 0.1])
    assert np.exp(mean_prior(own, np.zeros(3, bool))) == pytest.approx([0.5, 0.5])
