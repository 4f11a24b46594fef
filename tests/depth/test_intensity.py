# SPDX-License-Identifier: Apache-2.0
"""The estimated light of the pixels, against the light of the scene."""

import numpy as np
import pytest

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth.histograms import pixel_image
from coincid.model.depth.intensity import _count_hits
from coincid.model.scenes.scene import Scene

from ..told import Told

SIZE = 16
SENSOR = {"rows": SIZE, "cols": SIZE, "streams": 4}


def wall_run(distance_m, reflectivity, *, klux=10, pulses=500, form="id", **subgroup):
    shape = (SIZE, SIZE)
    scene = Scene(
        name="wall",
        distance_m=np.broadcast_to(np.asarray(distance_m, np.float64), shape),
        reflectivity=np.broadcast_to(np.asarray(reflectivity, np.float64), shape),
    )
    frame = {"pulses": pulses, "format": form}
    return Run(Setup.of(scene, klux=klux, sensor=SENSOR, frame=frame, subgroup=subgroup), workers=2)


def check_unbiased(run, **options):
    """Assert that the mean over the pixels is right within four of its standard errors and 2 %, and
    that the pixels lie within theirs.
    """
    depth = run.depth(**options)
    truth = run.light.total_signal.reshape(SIZE, SIZE)
    ratio = depth.signal_per_pulse[:, :, 0] / truth
    four = 4 * ratio.std() / SIZE
    assert ratio.mean() == pytest.approx(1, abs=max(four, 0.02))
    off = (depth.signal_per_pulse[:, :, 0] - truth) / depth.signal_error[:, :, 0]
    assert 0.6 < np.mean(np.abs(off) < 1) < 0.8


@pytest.mark.parametrize("method", ["planes", "maximum", "matched", "background"])
def test_light_of_walls_by_every_estimator(method):
    """A half is brighter; pixels of both are in each subgroup."""
    run = wall_run(4.0, np.where(np.arange(SIZE) % 2, 0.1, 0.4), threshold=2)
    check_unbiased(run, method=method)


@pytest.mark.parametrize("threshold", [1, 3])
def test_light_does_not_depend_on_the_threshold(threshold):
    check_unbiased(wall_run(4.0, 0.1, klux=50, threshold=threshold))


def test_light_where_each_column_has_its_own_windows():
    check_unbiased(wall_run(4 + 0.26 * np.arange(SIZE), 0.4, threshold=2))


def test_light_where_most_pulses_hit():
    """2.45 photons per pulse: a pixel fires in 91 % of the pulses."""
    check_unbiased(wall_run(2.0, 0.4, threshold=2))


def test_light_with_coincidence_off():
    check_unbiased(wall_run(8.0, 0.1, klux=50, coincidence=False))


def test_light_from_winners_and_counts():
    """Format short names the winner only."""
    check_unbiased(wall_run(4.0, 0.1, form="short", threshold=2))


@pytest.mark.parametrize("link_gbps", [0.3, 0.1])
def test_light_from_winners_and_counts_of_which_many_are_dropped(link_gbps):
    """15 and 70 % of the windows."""
    run = wall_run(4.0, 0.1, form="short", threshold=1).but(frame={"link_gbps": link_gbps})
    assert run["dropped_share"] > 0.1
    truth = run.light.total_signal.reshape(SIZE, SIZE)
    assert run.depth().signal_per_pulse[:, :, 0].mean() == pytest.approx(truth.mean(), rel=0.08)


def test_light_of_two_surfaces_in_a_pixel():
    distance_m = np.broadcast_to([4.0, 10.0], (SIZE, SIZE, 2))
    scene = Scene(name="pane", distance_m=distance_m, reflectivity=np.full(distance_m.shape, 0.1))
    setup = Setup.of(scene, klux=10, sensor=SENSOR, frame={"pulses": 500})
    run = Run(setup, workers=2)
    found = run.depth(returns=2)
    near = np.abs(found.depth_m[:, :, :, None] - np.array([4.0, 10.0])) < 0.1
    truth = run.light.signal_per_pulse.reshape(SIZE, SIZE, 2)
    for target in range(2):
        here = near[:, :, :, target]
        light = np.where(here, found.signal_per_pulse, 0).sum(axis=2)[here.any(axis=2)]
        assert light.mean() == pytest.approx(truth[0, 0, target], rel=0.05)


def test_a_return_within_the_dead_time_of_an_earlier_one_has_its_own_light():
    """A pixel that fires at the near surface is dead at the far one, 6 ns later; not the reverse."""
    distance_m = np.broadcast_to([4.0, 4.9], (SIZE, SIZE, 2))
    scene = Scene(name="pane", distance_m=distance_m, reflectivity=np.full(distance_m.shape, 0.4))
    setup = Setup.of(scene, klux=10, sensor=SENSOR, frame={"pulses": 500})
    run = Run(setup, workers=2)
    found = run.depth(Told((4.0, 4.9)), returns=2).signal_per_pulse.mean(axis=(0, 1))
    truth = run.light.signal_per_pulse.mean(axis=0)
    assert truth.min() > 0.3
    assert found == pytest.approx(truth, rel=0.05)


def test_light_where_a_gate_that_moves_opens():
    """A wall at 12 m returns its light in cycle 40, where the third of four places begins."""
    setup = Setup.of(
        "flat:12,0.3",
        klux=30.0,
        sensor={"rows": 16, "cols": 16},
        frame={"pulses": 1000, "gate_every": 1, "gate_steps": 4, "gate_step": 20},
        subgroup={"threshold": 1, "gating": True, "gate_start": 0, "gate_len": 30},
    )
    check_unbiased(Run(setup, workers=2))


def test_light_at_the_distances_of_an_estimator_of_a_users_own():
    check_unbiased(wall_run(4.0, 0.1, threshold=2), method=Told(4.0))


def test_masked_pixels_have_a_depth_of_their_neighbours_and_no_light():
    """They do not change the light of the others."""
    run = wall_run(4.0, 0.1, threshold=2, mask="f0fffffffffffff0")
    depth = run.depth()
    masked = ~pixel_image(run.config.mask, run.config.sensor)
    assert masked.sum() == 4 * 8
    assert np.abs(depth.depth_m[masked] - 4.0).max() < 0.05
    assert np.isnan(depth.signal_per_pulse[masked]).all()
    assert np.isnan(depth.signal_error[masked]).all()
    truth = run.light.total_signal.reshape(SIZE, SIZE)
    assert depth.signal_per_pulse[~masked].mean() == pytest.approx(truth[~masked].mean(), rel=0.05)


@pytest.mark.parametrize("words", [1, 2, 4])
def test_hits_of_each_return_are_those_of_its_pixel_in_its_ticks(words):
    """In maps of any number of words; a pixel may have several returns, or none."""
    rng = np.random.default_rng(words)
    events, pixels, ticks = 60, 64 * words, 20
    stamp = rng.integers(0, 100, events)
    weight = rng.uniform(1, 2, events)
    is_hit = rng.random((events, pixels)) < 0.1
    maps = np.packbits(is_hit, axis=1, bitorder="little").view("<u8").astype(np.uint64)
    starts = np.concatenate([[0], np.cumsum(np.arange(pixels) % 3)])
    pixel = np.repeat(np.arange(pixels), np.diff(starts))
    first = rng.integers(-10, 90, len(pixel))
    hits, total = np.zeros(len(pixel)), np.zeros(pixels)
    _count_hits(stamp, maps, weight, starts, first, ticks, hits, total)
    assert total == pytest.approx(weight @ is_hit)
    near = (stamp[:, None] >= first) & (stamp[:, None] < first + ticks)
    assert hits == pytest.approx(weight @ (is_hit[:, pixel] & near))
