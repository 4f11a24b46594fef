# SPDX-License-Identifier: Apache-2.0
"""The lights that a pixel may have."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from coincid.model.depth.evidence import WAYS, Pixels
from coincid.model.depth.lights import (
    LIGHT_SPAN,
    add_chances_on_surfaces,
    add_light_chances,
    lights_near,
    mean_over_lights,
)

LIGHTS = np.geomspace(1e-3, 10.0, 20)


@pytest.mark.parametrize("hit", (False, True), ids=("silent", "hit"))
@given(shape=arrays(np.float32, 5, elements=st.floats(-1, 0, width=32)))
def test_the_mean_over_the_lights_has_no_step_where_it_is_low(hit, shape):
    """What many silent pixels say together must not depend on where the likelihoods begin."""
    times = 40
    lower = np.linspace(3, -12, times, dtype=np.float32)
    common = lower[:, None] + shape
    pixels = Pixels(
        minigroup=np.zeros(1, np.int64),
        mask=np.ones(1, bool),
        activity=np.ones(1),
        first=np.zeros(1, np.int64),
        total=np.zeros((1, times * 5), np.float32),
        touched=np.full((1, times), hit),
        counted=np.full(1, -1),
        number=np.zeros((WAYS, 1), np.int64),
        hit=np.zeros(1, np.int64),
    )
    prior = np.log(np.full(5, 0.2, np.float32))
    where = np.log(np.geomspace(0.1, 1, 5)).astype(np.float32)
    level = np.empty((1, times), np.float32)
    light = np.empty((1, times), np.uint8)
    place = np.zeros(1, int)
    mean_over_lights(
        common.ravel(), pixels, prior, prior[None], where, 0, place, level, light, -np.inf
    )
    assert level[0] - lower == pytest.approx(np.full(times, level[0, 0] - lower[0]), abs=1e-3)


@given(known=arrays(np.float64, st.integers(1, 5), elements=st.floats(1e-3, 10.0)))
def test_the_lights_near_the_seeds_are_all_within_the_span_and_one_beyond(known):
    near = lights_near(known, LIGHTS)
    chosen = np.arange(20)[near]
    low = known.min() / LIGHT_SPAN
    high = known.max() * LIGHT_SPAN
    within = np.flatnonzero((LIGHTS >= low) & (LIGHTS <= high))
    assert set(within) <= set(chosen)
    assert len(chosen) <= len(within) + 2
    assert LIGHTS[chosen[0]] <= max(low, LIGHTS[0])
    assert LIGHTS[chosen[-1]] >= min(high, LIGHTS[-1])


def test_without_seeds_all_lights_are_possible():
    assert lights_near(np.empty(0), LIGHTS) == slice(0, 20)


def pixels_of(total, touched, first):
    """Return pixels with these log likelihoods, float32[pixels, bins * lights]."""
    number = len(total)
    none = np.zeros(number, np.int64)
    return Pixels(
        minigroup=none,
        mask=np.ones(number, bool),
        activity=np.ones(number),
        first=np.asarray(first),
        total=total.copy(),
        touched=touched.copy(),
        counted=none,
        number=np.zeros((3, number), np.int64),
        hit=none,
    )


@pytest.mark.parametrize("on_surfaces", [False, True])
def test_what_was_never_written_of_a_pixel_counts_as_0(on_surfaces):
    """In each of its bins. Some of the first pixel are before the first time, some of the last one
    behind the last.
    """
    rng = np.random.default_rng(4)
    bins, lights, times, offsets = 6, 3, 12, 2
    common = rng.normal(0, 1, times * lights).astype(np.float32)
    total = rng.normal(0, 1, (3, bins * lights)).astype(np.float32)
    touched = rng.random((3, bins)) < 0.5
    kept = np.repeat(touched, lights, axis=1)
    first = [-2, 3, 8]
    found = []
    for unwritten in (0.0, 7.0):
        pixels = pixels_of(np.where(kept, total, np.float32(unwritten)), touched, first)
        known = np.array([True, True, True])
        if on_surfaces:
            chance = np.zeros((3, offsets, lights), np.float32)
            at = np.array([2.3, 3.9, 0.4])
            add_chances_on_surfaces(common, pixels, at, np.array([-0.1, 0.4]), known, chance)
        else:
            chance = np.zeros((3, lights), np.float32)
            add_light_chances(common, pixels, known, chance)
        assert known.all() and np.all(chance.sum(axis=-1) > 0)
        found.append(chance)
    np.testing.assert_array_equal(found[0], found[1])


def test_the_lights_on_a_surface_are_those_between_the_two_times_beside_it():
    """For each time by which the surface may be off, also earlier; the unit is the same for all."""
    rng = np.random.default_rng(9)
    bins, lights, times = 7, 3, 9
    offset = np.array([-1.25, 0.0, 0.5, 1.75])
    common = rng.normal(0, 1, (times, lights)).astype(np.float32)
    total = rng.normal(0, 1, (3, bins, lights)).astype(np.float32)
    first, at = np.array([0, 2, -2]), np.array([2.5, 1.25, 4.0])
    pixels = pixels_of(total.reshape(3, -1), np.ones((3, bins), bool), first)
    known = np.ones(3, bool)
    chance = np.zeros((3, len(offset), lights), np.float32)
    add_chances_on_surfaces(common.ravel(), pixels, at, offset, known, chance)
    assert known.all()
    for i in range(3):
        level = [
            [
                np.interp(
                    at[i] + off,
                    np.arange(bins),
                    total[i, :, x]
                    + np.interp(first[i] + np.arange(bins), np.arange(times), common[:, x]),
                )
                for x in range(lights)
            ]
            for off in offset
        ]
        assert chance[i] == pytest.approx(np.exp(np.array(level) - np.max(level)), rel=1e-4)


@pytest.mark.parametrize(
    ("first", "at", "is_known"),
    [
        (1, 0.5, True),  # from the pixel's first time
        (1, 0.45, False),
        (1, 4.0, True),
        (1, 4.25, False),  # beyond its last one
        (-2, 2.5, True),  # from the first time of all
        (-2, 2.25, False),
        (5, 2.0, True),
        (5, 2.25, False),  # beyond the last one of all
    ],
)
def test_a_surface_whose_times_are_not_all_there_tells_no_lights(first, at, is_known):
    """The pixel is not known then, and neither is one that was not known before."""
    bins, lights, times = 6, 2, 9
    pixels = pixels_of(
        np.zeros((2, bins * lights), np.float32), np.ones((2, bins), bool), [first] * 2
    )
    known = np.array([True, False])
    chance = np.full((2, 2, lights), 7, np.float32)
    common = np.zeros(times * lights, np.float32)
    offset = np.array([-0.5, 0.75])
    add_chances_on_surfaces(common, pixels, np.array([at, at]), offset, known, chance)
    assert known.tolist() == [is_known, False]
    assert chance[0] == pytest.approx(1 if is_known else 7, rel=1e-5)
    assert np.all(chance[1] == 7)


def test_a_pixels_lights_are_those_of_all_its_times():
    rng = np.random.default_rng(6)
    bins, lights, times = 5, 2, 9
    common = rng.normal(0, 1, (times, lights)).astype(np.float32)
    total = rng.normal(0, 1, (4, bins, lights)).astype(np.float32)
    first = np.array([-1, 2, 6, 3])
    pixels = pixels_of(total.reshape(4, -1), np.ones((4, bins), bool), first)
    chance = np.zeros((4, lights), np.float32)
    add_light_chances(common.ravel(), pixels, np.array([True, True, True, False]), chance)
    for i in range(3):
        bin_of = np.arange(max(0, -first[i]), min(bins, times - first[i]))
        likely = np.exp(common[first[i] + bin_of] + total[i, bin_of])
        assert chance[i] / chance[i].sum() == pytest.approx(
            likely.sum(axis=0) / likely.sum(), rel=1e-4
        )
    assert not chance[3].any()


@pytest.mark.parametrize("cubic", [0.0, 8.0, -8.0])
def test_sharp_lights_between_the_steps_are_averaged_over_all_lights(cubic):
    """Each time has its likeliest light at another step, the second and the last but one included.

    Around it, the log likelihood is that of a number of hits, and near it a cubic difference from that.
    """
    lights, step, hits, top = 9, 0.4, 60.0, 5.0
    where = (step * np.arange(lights)).astype(np.float32)
    steps = np.arange(1, lights - 1)
    offs = 0.3 * step * np.cos(steps)  # from the step to the likeliest light

    def level_at(off, beyond):
        own = hits * off - hits * np.exp(-beyond) * (np.exp(off) - 1)
        near = np.abs(off) < 2.5 * step
        return top + own + np.where(near, cubic * off * (off - step) * (off + step), 0.0)

    total = level_at(where - where[steps][:, None], offs[:, None])
    fine = np.linspace(-1.5 * step, 1.5 * step, 2001)
    likely = np.exp(level_at(fine, offs[:, None]))
    expected = np.log(np.trapezoid(likely, fine, axis=1) / step)
    times = len(steps)
    pixels = pixels_of(total.reshape(1, -1).astype(np.float32), np.ones((1, times), bool), [0])
    level = np.empty((1, times), np.float32)
    light = np.empty((1, times), np.uint8)
    mean_over_lights(
        np.zeros(times * lights, np.float32),
        pixels,
        np.zeros(lights, np.float32),
        np.zeros((1, lights), np.float32),
        where,
        3,
        np.zeros(1, np.int64),
        level,
        light,
        -np.inf,
    )
    assert light[0].tolist() == (3 + steps).tolist()
    assert level[0] == pytest.approx(expected, abs=0.02)


def test_a_pixel_that_was_hit_has_its_own_prior_of_the_lights():
    """One that was not has that of all; and where it was not, a pixel that was hit has it, too."""
    rng = np.random.default_rng(8)
    times, lights = 5, 4
    common = rng.normal(0, 0.3, (times, lights)).astype(np.float32)
    total = rng.normal(0, 0.3, (3, times, lights)).astype(np.float32)
    touched = np.array([[True] * times, [False] * times, [True, False, True, True, False]])
    pixels = pixels_of(total.reshape(3, -1), touched, [0, 0, 0])
    prior = rng.normal(0, 0.3, lights).astype(np.float32)
    own_prior = rng.normal(0, 0.3, (3, lights)).astype(np.float32)
    where = (0.4 * np.arange(lights)).astype(np.float32)
    level = np.empty((3, times), np.float32)
    light = np.empty((3, times), np.uint8)
    place = np.array([2, 0, 1])
    mean_over_lights(
        common.ravel().copy(), pixels, prior, own_prior, where, 0, place, level, light, -np.inf
    )
    hit = touched[:, :, None]
    expected = common + np.where(hit, total + own_prior[:, None], prior)
    assert level[place] == pytest.approx(np.log(np.exp(expected).sum(axis=2)), abs=1e-4)
    np.testing.assert_array_equal(light[place], expected.argmax(axis=2))
