# SPDX-License-Identifier: Apache-2.0
"""Laws of all estimators: of several frames, several returns, the places of subgroups, and limits."""

import numpy as np
import pytest

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.pixels import pixel_table
from coincid.model.depth.arrivals import pulse_sigma_ticks
from coincid.model.depth.estimate import PEAKS, PLANES, RETURNS_MAX, estimate_depth
from coincid.model.depth.histograms import SOURCES, subgroup_histograms

METHODS = (PLANES, *PEAKS)
SENSOR = {"rows": 16, "cols": 16, "phases": 16}
FRAMES = 3
PULSES = 40


def run_of(scene, klux=20.0, frames=1, pulses=PULSES, **frame):
    frame = {"frames": frames, "pulses": pulses, "minigroup_records": True} | frame
    return Run(Setup.of(scene, klux=klux, sensor=SENSOR, frame=frame))


@pytest.fixture(scope="module")
def three_frames():
    return run_of("five-objects", frames=FRAMES)


def merged(run):
    """Return the result and the configuration of all frames as those of one frame."""
    totals = {name: run.result[name].sum(axis=0, keepdims=True) for name in COUNTER_NAMES}
    config = run.config.with_frame(frames=1, pulses=FRAMES * PULSES)
    return run.result | totals, config


def of_one(run, number):
    """Return the result and the configuration of a frame as if it were the only one."""
    result = run.result
    alone = {name: result[name][number : number + 1] for name in COUNTER_NAMES}
    for pulse, prefix in (("pulse", ""), ("mg_pulse", "mg_")):
        rows = np.flatnonzero(result[pulse] // PULSES == number)
        for name in result.keys() - {*COUNTER_NAMES, "fate"}:
            is_record = name.startswith("mg_") and name != "mg_offset"
            if is_record == bool(prefix):
                alone[name] = result[name][rows]
        alone[pulse] = alone[pulse] - number * PULSES
    return alone, run.config.with_frame(frames=1)


def assert_equal_depths(one, other):
    assert np.array_equal(one.depth_m, other.depth_m, equal_nan=True)
    assert np.array_equal(one.confidence, other.confidence)


def test_all_frames_together_are_one_long_frame(three_frames):
    """Except for what the estimator learns about the first and the last events of a frame."""
    result, config = merged(three_frames)
    together = estimate_depth(three_frames.result, three_frames.config)
    long = estimate_depth(result, config)
    for name, most in (("depth_m", 3e-3), ("error_m", 1e-3), ("confidence", 3e-2)):
        apart = np.abs(getattr(together, name) - getattr(long, name))
        assert np.nanquantile(apart, 0.95) < most, name


@pytest.mark.parametrize("source", SOURCES)
def test_peaks_of_every_source_take_all_frames_together(three_frames, source):
    result, config = merged(three_frames)
    options = {"method": "background", "source": source}
    together = estimate_depth(three_frames.result, three_frames.config, **options)
    assert_equal_depths(together, estimate_depth(result, config, **options))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("number", (0, FRAMES - 1))
def test_a_frame_among_others_is_the_frame_alone(three_frames, method, number):
    result, config = of_one(three_frames, number)
    among = estimate_depth(three_frames.result, three_frames.config, method=method, frame=number)
    assert_equal_depths(among, estimate_depth(result, config, method=method))


@pytest.mark.parametrize("source", SOURCES)
def test_histograms_of_the_frames_add_up_to_that_of_all(three_frames, source):
    result, config = three_frames.result, three_frames.config
    sigma_ticks = pulse_sigma_ticks(config, 500e-12)

    def histograms(frame):
        found = subgroup_histograms(result, config, sigma_ticks, source=source, frame=frame)
        return np.stack(list(found)).sum(axis=2)

    total = histograms(None)
    assert total.sum() > 1000
    assert np.array_equal(total, sum(histograms(frame) for frame in range(FRAMES)))


@pytest.mark.parametrize("method", METHODS)
def test_returns_of_a_pixel_are_apart_from_each_other(method):
    """Each from all others, not only from the first."""
    run = run_of("two-returns:5,9", klux=30.0, pulses=200)
    depth_m = estimate_depth(run.result, run.config, method=method, returns=RETURNS_MAX).depth_m
    assert np.isfinite(depth_m[:, :, 1]).mean() > 0.5
    apart_m = 0.1
    for one in range(RETURNS_MAX):
        for other in range(one):
            between = np.abs(depth_m[:, :, one] - depth_m[:, :, other])
            assert not np.any(between < apart_m), (one, other)


@pytest.mark.parametrize("method", METHODS)
def test_more_returns_leave_the_earlier_ones(three_frames, method):
    result, config = three_frames.result, three_frames.config
    two = estimate_depth(result, config, method=method, returns=2).depth_m
    four = estimate_depth(result, config, method=method, returns=4).depth_m
    assert np.array_equal(two, four[:, :, :2], equal_nan=True)


@pytest.mark.parametrize("method", PEAKS)
def test_peaks_do_not_depend_on_the_place_of_a_subgroup(three_frames, method):
    """Events of subgroups that change places give the same depth at the new places."""
    result, config = three_frames.result, three_frames.config
    table = pixel_table(config.sensor)
    moved = np.random.default_rng(1).permutation(config.sensor.subgroups)
    there = dict(result)
    for name in ("subgroup", "mg_subgroup"):
        there[name] = moved[result[name]]
    for name in COUNTER_NAMES:
        there[name] = result[name][:, np.argsort(moved)]
    depth = estimate_depth(result, config, method=method).depth_m.ravel()
    found = estimate_depth(there, config, method=method).depth_m.ravel()
    place = {}
    for pixel in range(config.sensor.array_pixels):
        place[int(table.subgroup[pixel]), int(table.inside[pixel])] = pixel
    for (subgroup, inside), pixel in place.items():
        after = found[place[int(moved[subgroup]), inside]]
        assert depth[pixel] == after or (np.isnan(depth[pixel]) and np.isnan(after))


@pytest.mark.parametrize("method", METHODS)
def test_darkness_has_no_surface(method):
    run = run_of("flat:5,0", klux=0.0)
    depth = estimate_depth(run.result, run.config, method=method, returns=2)
    assert np.isnan(depth.depth_m).all()
    assert not depth.confidence.any()
