# SPDX-License-Identifier: Apache-2.0
"""What the counts of windows say about the times of their winners."""

import numpy as np
import pytest

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth import likelihood
from coincid.model.depth.estimate import estimate_depth
from coincid.model.depth.others import ALONE, GUESS_ERROR, MOST, OwnWindows, moves_with_others
from coincid.model.depth.pulse_ticks import PulseTicks
from coincid.model.golden.frame import golden_result

PIXELS = 8
GUESS_TICK = 100.0
LATER_TICKS = np.arange(-4, 5)
AT_GUESS = 4  # of these


LIGHT = {"window": 6, "noise": 1e-4, "alive": 1.0, "light": 0.5}


def ratios(stamp, winner, others, *, time=None, mask=None, **changed):
    """float64[pixels, bins]: log likelihood ratios if the surfaces of all pixels move together.

    changed: of `LIGHT`.
    """
    known = np.full(PIXELS, GUESS_TICK) if time is None else time
    seen = LIGHT | changed
    move = moves_with_others(
        OwnWindows(*map(np.asarray, (stamp, winner, others))),
        window=seen["window"],
        pulse=PulseTicks(4.0),
        noise=seen["noise"],
        alive=seen["alive"],
        mask=np.ones(PIXELS, bool) if mask is None else mask,
        time=known,
        light=np.full(PIXELS, seen["light"]),
        times=np.broadcast_to(GUESS_TICK + LATER_TICKS, (PIXELS, len(LATER_TICKS))),
    )
    together = (np.exp(move.astype(np.float64)) - ALONE) / (1 - ALONE)
    return np.log(np.maximum(together, 1e-9))


def test_windows_that_are_alike_count_as_often_as_they_come():
    once = ratios([98], [2], [1])
    assert 0.01 < np.abs(once[2]).max() < MOST / 3
    np.testing.assert_allclose(ratios([98] * 3, [2] * 3, [1] * 3), 3 * once, atol=1e-5)
    other = ratios([95], [2], [3])
    np.testing.assert_allclose(ratios([98, 95], [2, 2], [1, 3]), once + other, atol=1e-5)
    elsewhere = ratios([98, 95], [2, 5], [1, 3])
    np.testing.assert_allclose(elsewhere[2], once[2], atol=1e-5)
    assert np.abs(elsewhere[5]).max() > 0.01


def test_windows_say_nothing_of_the_guess_itself_nor_of_pixels_that_win_none():
    found = ratios([98, 95], [2, 5], [1, 3])
    np.testing.assert_allclose(found[:, AT_GUESS], 0, atol=1e-6)
    np.testing.assert_allclose(np.delete(found, [2, 5], axis=0), 0, atol=1e-6)


@pytest.mark.parametrize("others, sign", [(0, -1), (7, 1)])
def test_many_others_make_later_surfaces_likelier(others, sign):
    found = ratios([98], [2], [others])[2]
    assert sign * found[AT_GUESS + 1] > 0 > sign * found[AT_GUESS - 1]


def test_no_ratio_is_above_the_most():
    found = ratios([98] * 500, [2] * 500, [7] * 500)
    assert found.max() == pytest.approx(MOST, abs=1e-3)


def test_a_pixel_without_a_guess_has_no_ratio_and_masked_ones_do_not_fire():
    time = np.full(PIXELS, GUESS_TICK)
    time[2] = np.nan
    np.testing.assert_allclose(ratios([98], [2], [1], time=time), 0, atol=1e-6)
    masked = np.arange(PIXELS) < 4
    fewer = ratios([98], [2], [2], mask=masked)[2]
    more = ratios([98], [2], [2])[2]
    assert fewer[AT_GUESS + 1] > more[AT_GUESS + 1]


def chance_to_fire(tick, window, noise, alive, light):
    """Return the chance of one pixel in a window from a tick on, by its surface at the guess."""
    shares = PulseTicks(4.0).share_before(np.array([tick, tick + window]) - GUESS_TICK)
    before, until = alive * (1 - np.exp(-light * shares))
    return min(1.0, noise * window + (until - before) / (1 - before))


@pytest.mark.parametrize("mask", [np.full(PIXELS, True), np.arange(PIXELS) < 5])
@pytest.mark.parametrize(
    "changed",
    [{}, {"alive": 0.4}, {"noise": 0.02}, {"window": 9}, {"light": 2.0}, {"noise": 1.0}],
    ids=str,
)
def test_a_time_is_as_likely_as_the_number_of_others_that_fire_in_the_window(changed, mask):
    """That of a window which begins earlier by as much as the time is later. The number has the
    variance of independent pixels, and an error of its own.
    """
    stamp, winner, count = 98, 2, 3
    found = ratios([stamp], [winner], [count], mask=mask, **changed)
    others = np.count_nonzero(mask) - 1
    chances = [chance_to_fire(stamp - later, **LIGHT | changed) for later in LATER_TICKS]
    means = [others * chance for chance in chances]
    for direction in (1, -1):
        ratio = 0.0
        for k in range(AT_GUESS + direction, 2 * AT_GUESS * (direction > 0) + direction, direction):
            mean, before = means[k], means[k - direction]
            variance = max(1e-6, mean * (1 - chances[k])) + (GUESS_ERROR * mean) ** 2
            ratio += (count - (mean + before) / 2) / variance * (mean - before)
            assert found[winner, k] == pytest.approx(min(MOST, ratio), abs=1e-3)


@pytest.mark.parametrize("form", ("short", "id"))
@pytest.mark.parametrize("coincidence", ([False, True, True], [True, True, False]))
def test_counts_tell_of_others_where_windows_are_long_and_no_map_names_them(
    coincidence, form, monkeypatch
):
    """Each subgroup has a window of its own; without coincidence, an event is one photon."""
    setup = Setup.of(
        "flat:4.0,0.4",
        sensor={"rows": 8, "cols": 24},
        frame={"pulses": 20, "format": form, "link_gbps": 0},
        klux=10.0,
    )
    windows = np.array([16, 9, 24])
    config = setup.config.with_settings(coincidence=np.array(coincidence), window=windows)
    asked = set()
    real = likelihood.moves_with_others

    def noted(own, window, *rest):
        asked.add(window)
        return real(own, window, *rest)

    monkeypatch.setattr(likelihood, "moves_with_others", noted)
    estimate_depth(golden_result(config, Run(setup).edges), config)
    expected = set(windows[coincidence].tolist()) if form == "short" else set()
    assert asked == expected
