# SPDX-License-Identifier: Apache-2.0
"""Laws of all estimators: of several frames, several returns, the places of subgroups, and limits."""

import numpy as np
import pytest

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.parameters import Sensor
from coincid.model.contract.pixels import pixel_table
from coincid.model.depth.arrivals import arrival_ticks, photons_of
from coincid.model.depth.belief import BELIEVED_MIN, Reason
from coincid.model.depth.clusters import cluster_events
from coincid.model.depth.depth import Depth, write_depths
from coincid.model.depth.estimate import PEAKS, PLANES, RETURNS_MAX, estimate_depth
from coincid.model.depth.histograms import (
    SOURCES,
    frame_events,
    pixel_histogram,
    subgroup_histograms,
)
from coincid.model.depth.peaks import APART_SIGMAS, hit_shares, live_share, pixel_peaks, record_live
from coincid.model.depth.pulse_ticks import PulseTicks, pulse_ticks
from coincid.model.golden.frame import golden_result
from coincid.model.shared.errors import InputError

from ..random_cases import SENSORS, configured, random_edges
from ..told import Told
from .equal import assert_equal_depths

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


@pytest.mark.parametrize("number", range(FRAMES))
def test_records_of_a_frame_are_lost_as_often_as_in_the_frame_alone(three_frames, number):
    """Each frame drops more than the one before."""
    run = three_frames
    stored = run.result["mg_stored"]
    result = run.result | {"mg_dropped": stored * np.arange(1, 1 + FRAMES)[:, None]}
    options = {"method": "background", "source": "minigroup"}
    among = estimate_depth(result, run.config, frame=number, **options)
    alone, config = of_one(run, number)
    alone["mg_dropped"] = result["mg_dropped"][number : number + 1]
    assert_equal_depths(among, estimate_depth(alone, config, **options))


def test_light_of_frames_with_a_gate_that_moves_is_that_of_one():
    """The gate begins anew in each frame: in the second half of the pulses, it shows the wall."""
    setup = Setup.of(
        "flat:12,0.4",
        klux=5.0,
        sensor=SENSOR,
        frame={
            "frames": 2,
            "pulses": 200,
            "gate_every": 100,
            "gate_steps": 4,
            "gate_step": 20,
            "link_gbps": 0,
        },
        subgroup={"gating": True, "gate_start": 10, "gate_len": 20},
    )
    run = Run(setup)
    time_cycles = 12 / run.config.tick_m / run.config.sensor.phases
    assert 30 < time_cycles < 50
    light = [
        np.nanmean(run.depth("matched", frame=frame).signal_per_pulse) for frame in (None, 0, 1)
    ]
    assert light[0] == pytest.approx(np.mean(light[1:]), rel=0.1)


@pytest.mark.parametrize("rearm", [0, 6])
def test_background_is_told_from_windows_after_which_the_tree_is_blind(rearm):
    """Its rate is that of the photons, however long the tree takes to be armed again."""
    setup = Setup.of(
        "flat:60,1.0",
        klux=20.0,
        sensor=SENSOR | {"rearm": rearm},
        frame={"pulses": 200, "link_gbps": 0},
        subgroup={"threshold": 1},
    )
    run = Run(setup)
    events = frame_events(run.result, run.config, pulse_ticks(run.config))
    detected = len(run.edges) / run.config.pulses / run.config.period_ticks
    assert detected * run.config.period_ticks > 50
    assert events.photon_rate.sum() == pytest.approx(detected, rel=0.05)


@pytest.mark.parametrize("gate_len", (46, 200))
@pytest.mark.parametrize("gate_step", (0, 100))
def test_background_is_that_of_the_time_in_which_a_gate_is_open(gate_len, gate_step):
    """A gate may end beyond the period, and its places may be beyond it."""
    setup = Setup.of(
        "flat:60,1.0",
        klux=20.0,
        sensor=SENSOR,
        frame={"link_gbps": 0, "gate_every": 1, "gate_steps": 2, "gate_step": gate_step},
        subgroup={"threshold": 1, "gating": True, "gate_start": 200, "gate_len": gate_len},
    )
    run = Run(setup)
    events = frame_events(run.result, run.config, pulse_ticks(run.config))
    detected = len(run.edges) / run.config.pulses / run.config.period_ticks
    assert events.photon_rate.sum() == pytest.approx(detected, rel=0.1)


@pytest.mark.parametrize("source", SOURCES)
def test_histograms_of_the_frames_add_up_to_that_of_all(three_frames, source):
    result, config = three_frames.result, three_frames.config
    pulse = pulse_ticks(config)

    def histograms(frame):
        found = subgroup_histograms(result, config, pulse, source=source, frame=frame)
        return np.stack(list(found)).sum(axis=2)

    total = histograms(None)
    assert total.sum() > 1000
    assert np.array_equal(total, sum(histograms(frame) for frame in range(FRAMES)))


def test_no_event_has_fewer_hits_than_the_lowest_threshold_of_its_frames(three_frames):
    """Also where a later frame had it, as under the controller."""
    run = three_frames
    subgroups = run.config.sensor.subgroups
    threshold = 1 + np.add.outer([4, 0, 2], np.arange(subgroups)) % 7
    result = run.result | {"threshold_used": threshold}
    pulse = PulseTicks(2.0)
    assert np.any(threshold.argmin(axis=0) == 0) and np.any(threshold.argmin(axis=0) > 0)
    together = frame_events(result, run.config, pulse)
    assert np.array_equal(together.threshold, threshold.min(axis=0))
    for frame in range(FRAMES):
        alone = frame_events(result, run.config, pulse, frame)
        assert np.array_equal(alone.threshold, threshold[frame])


def test_records_lie_at_the_first_hit_of_all_pixels_of_their_minigroup():
    """Of any number of pixels: the lead is that of the photons behind all of them."""
    config = configured(
        SENSORS["fine"], {"pulses": 20, "minigroup_records": True, "mg_threshold": 1}
    )
    sensor = config.sensor
    result = golden_result(config, random_edges(config, 4000, 1))
    pulse = PulseTicks(3.0)
    pixels = sensor.minigroup_pixels
    photons = photons_of(np.arange(pixels + 1), pixels)
    lead_ticks = pulse.lead(np.maximum(photons, 1))
    expected = np.zeros((sensor.subgroups, sensor.pixels, config.period_ticks), np.int32)
    table = pixel_table(sensor)
    of_pixel = {
        (s, inside): (minigroup, bit)
        for s, inside, minigroup, bit in zip(
            table.subgroup, table.inside, table.minigroup[table.inside], table.bit[table.inside],
            strict=True,
        )
    }  # fmt: skip
    records = zip(result["mg_subgroup"], result["mg_stamp"], result["mg_map"], strict=True)
    most = 0
    for s, stamp, maps in records:
        for inside in range(sensor.pixels):
            minigroup, bit = of_pixel[s, inside]
            seen = int(maps[minigroup]).bit_count()
            if int(maps[minigroup]) >> int(bit) & 1:
                at = sensor.quarter_ticks * (stamp[minigroup] + 0.5) + lead_ticks[seen]
                expected[s, inside, min(int(at), config.period_ticks - 1)] += 1
                most = max(most, bit)
    assert most == pixels - 1
    found = np.stack(list(subgroup_histograms(result, config, pulse, source="minigroup")))
    assert np.array_equal(found, expected)


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


def test_returns_are_apart_by_the_longest_window_wherever_it_is():
    """Within a window, words do not tell returns apart; the first subgroup has a short one."""
    run = run_of("two-returns:5,5.6", klux=30.0, pulses=200)
    window_ticks = np.full(run.config.sensor.subgroups, 64)
    window_ticks[0] = 4
    refined_ticks = 8  # by which both may move after they were chosen
    run = run.but(config=run.config.with_settings(window=window_ticks))
    depth_m = run.depth(returns=2).depth_m
    between_m = np.abs(depth_m[:, :, 1] - depth_m[:, :, 0])
    assert not np.any(between_m < (64 - refined_ticks) * run.config.tick_m)


@pytest.mark.parametrize("method", METHODS)
def test_more_returns_leave_the_earlier_ones(three_frames, method):
    result, config = three_frames.result, three_frames.config
    two = estimate_depth(result, config, method=method, returns=2)
    four = estimate_depth(result, config, method=method, returns=4)
    assert_equal_depths(two, four, ("depth_m", "confidence", "reason"), returns=2)


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


PULSES_MIXED = 400
# One value for each subgroup of `SENSOR`.
MIXED = {
    "threshold": [1, 2, 3, 1],
    "window": [16, 8, 16, 5],
    "gating": [False, True, False, True],
    "gate_start": [0, 30, 0, 12],
    "gate_len": [250, 60, 250, 100],
    "coincidence": [True, True, True, False],
}


def test_a_subgroup_with_settings_of_its_own_is_as_if_all_had_them():
    """Peaks and their light follow from the subgroup's own events; planes look at neighbours, too."""
    run = run_of("five-objects", pulses=PULSES_MIXED, link_gbps=0)
    settings = {name: np.array(values) for name, values in MIXED.items()}
    mixed = run.but(config=run.config.with_settings(**settings))
    clusters = clusters_of(mixed, PULSES_MIXED)
    shares = shares_of(mixed)
    depths = {method: mixed.depth(method) for method in METHODS}
    of_pixel = pixel_table(run.config.sensor).subgroup.reshape(16, 16)
    for s in range(run.config.sensor.subgroups):
        own = {name: values[s].item() for name, values in settings.items()}
        alike = run.but(config=run.config.with_settings(**own))
        wanted = clusters_of(alike, PULSES_MIXED)[s]
        for found, column in zip(clusters[s], wanted, strict=True):
            assert np.array_equal(found, column)
        for found, all_alike in zip(shares, shares_of(alike), strict=True):
            assert np.array_equal(found[s], all_alike[s]), s
        here = of_pixel == s
        for method, one in depths.items():
            other = alike.depth(method)
            apart_m = np.abs(one.depth_m[:, :, 0] - other.depth_m[:, :, 0])[here]
            if method == PLANES:
                assert np.nanmedian(apart_m) < 5e-3, s
                continue
            assert_equal_where(here, one, other)


def clusters_of(run, pulses, frame=None):
    """Return, for each subgroup, what its events say about when its tree was armed."""
    pulse = pulse_ticks(run.config)
    events = frame_events(run.result, run.config, pulse, frame)
    return cluster_events(events, run.config, pulses, pulse.reach, False)


def shares_of(run):
    """Return what of each subgroup's time the tree was armed, and of its hits came undisturbed."""
    pulse = pulse_ticks(run.config)
    events = frame_events(run.result, run.config, pulse, None)
    hits = hit_shares(run.result, events, run.config, pulse, None)
    return live_share(run.result, events, run.config, None), hits


def assert_equal_where(here, one, other):
    for name in ("depth_m", "signal_per_pulse", "signal_error"):
        found = getattr(one, name)[here]
        assert np.array_equal(found, getattr(other, name)[here], equal_nan=True), name


@pytest.mark.parametrize("method", ("maximum", Told(5.0)), ids=("built in", "own"))
@pytest.mark.parametrize(
    ("name", "low", "high"), [("frame", 0, FRAMES - 1), ("returns", 1, RETURNS_MAX)]
)
def test_the_ends_of_a_range_are_legal_and_nothing_beyond(three_frames, method, name, low, high):
    result, config = three_frames.result, three_frames.config
    for value in (low, high):
        assert estimate_depth(result, config, method=method, **{name: value})
    for value in (low - 1, high + 1):
        told = f"^{name} = {value}: must be an integer from {low} to {high}$"
        with pytest.raises(InputError, match=told):
            estimate_depth(result, config, method=method, **{name: value})


def test_what_is_not_given_is_the_usual(three_frames):
    """One return of all frames by planes; a pixel's histogram from the maps."""
    result, config = three_frames.result, three_frames.config
    usual = {"source": "map", "frame": None, "system_fwhm_s": 500e-12}
    assert estimate_depth(result, config, method="maximum").depth_m.shape == (16, 16, 1)
    found = estimate_depth(result, config)
    assert_equal_depths(found, estimate_depth(result, config, method="planes", **usual))
    assert np.array_equal(
        pixel_histogram(result, config, 3), pixel_histogram(result, config, 3, **usual)
    )


@pytest.mark.parametrize("method", METHODS)
def test_a_pulse_may_be_much_narrower_than_a_tick(three_frames, method):
    result, config = three_frames.result, three_frames.config
    found = estimate_depth(result, config, method=method, system_fwhm_s=1e-15)
    off_m = np.abs(found.depth_m[:, :, 0] - three_frames.scene.truth_m)
    assert np.nanmedian(off_m) < 0.1
    lit = found.signal_per_pulse[:, :, 0] > 0
    assert lit.mean() > 0.9


@pytest.mark.parametrize("method", METHODS)
def test_darkness_has_no_surface(method):
    run = run_of("flat:5,0", klux=0.0)
    depth = estimate_depth(run.result, run.config, method=method, returns=2)
    assert np.isnan(depth.depth_m).all()
    assert not depth.confidence.any()


def test_a_frame_among_others_with_moving_gates_is_the_frame_alone():
    """The gates begin anew with each frame, in the middle of their steps."""
    gates = {"gating": True, "gate_start": 20, "gate_len": 60}
    steps = {"gate_every": 24, "gate_step": 25, "gate_steps": 2}
    run = run_of("flat:5", frames=FRAMES, **steps).but(subgroup=gates)
    assert_equal_depths(run.depth(frame=2), estimate_depth(*of_one(run, 2)))


def test_events_of_all_frames_with_moving_gates_have_the_gates_of_their_own_frame():
    gates = {"gating": True, "gate_start": 20, "gate_len": 60}
    steps = {"gate_every": 24, "gate_step": 25, "gate_steps": 2}
    run = run_of("flat:5", frames=FRAMES, **steps).but(subgroup=gates)
    together = clusters_of(run, FRAMES * PULSES)
    frames = [clusters_of(run, PULSES, frame) for frame in range(FRAMES)]
    for s, of_subgroup in enumerate(together):
        for name in ("known", "quiet", "since"):
            alone = np.concatenate([getattr(of_frame[s], name) for of_frame in frames])
            np.testing.assert_array_equal(getattr(of_subgroup, name), alone)


@pytest.mark.parametrize("number", (None, 1))
def test_the_light_at_known_distances_is_that_of_the_frame(number):
    """Of all frames together, or of one among others."""
    run = run_of("flat:5", frames=FRAMES)
    found = run.depth(Told(5.0), frame=number).signal_per_pulse
    result, config = merged(run) if number is None else of_one(run, number)
    alone = estimate_depth(result, config, method=Told(5.0)).signal_per_pulse
    assert np.allclose(found, alone, rtol=0.02, equal_nan=True)
    known = run.light.signal_per_pulse.mean()
    assert np.nanmedian(found) == pytest.approx(known, rel=0.5)


@pytest.mark.parametrize("system_fwhm_s", (250e-12, 1.5e-9))
def test_the_light_at_the_same_distances_is_the_same_whose_estimator_it_is(
    three_frames, system_fwhm_s
):
    given = {"config": three_frames.config, "frame": 1, "system_fwhm_s": system_fwhm_s}
    built_in = estimate_depth(three_frames.result, method="maximum", **given)
    own = estimate_depth(three_frames.result, method=Told(built_in.depth_m), **given)
    known = built_in.signal_per_pulse
    assert np.nanmedian(known) > 0
    assert np.allclose(own.signal_per_pulse, known, rtol=1e-6, equal_nan=True)


def test_dropped_events_leave_the_share_of_live_periods():
    """Of the events, every second one is dropped: the windows blocked the tree all the same."""
    run = run_of("flat:5", klux=20.0, pulses=100).but(subgroup={"threshold": 1})
    whole = run.result
    kept = np.flatnonzero(np.arange(len(whole["pulse"])) % 2 == 0)
    thin = dict(whole)
    for name in ("subgroup", "pulse", "stamp", "count", "winner", "overrun", "hits"):
        thin[name] = whole[name][kept]
    number = np.bincount(thin["subgroup"], minlength=run.config.sensor.subgroups)
    thin["stored"] = number[None, :]
    thin["dropped"] = whole["committed"] - thin["stored"]
    shares = []
    for result in (whole, thin):
        events = frame_events(result, run.config, PulseTicks(2.0))
        shares.append(live_share(result, events, run.config, None))
    lost = 1 - shares[0].mean(axis=1)
    assert lost.min() > 0.05
    assert 1 - shares[1].mean(axis=1) == pytest.approx(lost, rel=0.1)


@pytest.mark.parametrize("rearm", (0, 5))
def test_rejected_windows_block_the_tree_until_it_is_armed_again(rearm):
    """In the mean over the period: a window, half a cycle, and the gap before it is armed."""
    sensor = SENSOR | {"rearm": rearm}
    frame = {"pulses": PULSES}
    setup = Setup.of("flat:60,0.4", klux=20.0, sensor=sensor, frame=frame)
    run = Run(setup.but(subgroup={"threshold": 12}))
    config = run.config
    assert not run.result["committed"].any()
    events = frame_events(run.result, config, PulseTicks(2.0))
    lost = 1 - live_share(run.result, events, config, None).mean(axis=1)
    cycle = config.sensor.phases
    blocked = run.result["opened"][0] * (config.window + cycle / 2 + rearm * cycle)
    assert lost.min() > 0.01
    assert lost == pytest.approx(blocked / (PULSES * config.period_ticks))


def test_a_minigroup_is_live_until_the_quarter_after_its_stamp():
    sensor = Sensor(rows=8, cols=8)
    quarter = sensor.quarter_ticks
    stamp = np.full((3, sensor.minigroups), 3)
    stamp[2, :] = 5
    maps = np.ones((3, sensor.minigroups), int)
    maps[:, 1] = 0  # this one has not latched
    live = record_live((stamp, maps), 2.0, sensor, 8 * quarter, periods=20)
    in_quarters = live[:, ::quarter]
    assert in_quarters[0] == pytest.approx([1, 1, 1, 1, 0.8, 0.8, 0.7, 0.7])
    assert np.array_equal(live[0], np.repeat(in_quarters[0], quarter)) and np.all(live[1] == 1)


@pytest.mark.parametrize("confidence", (BELIEVED_MIN, np.nextafter(BELIEVED_MIN, 0)))
def test_a_depth_is_believed_from_the_lowest_confidence_on(confidence):
    depth = Depth.of([[5.0, np.nan]], confidence)
    believed = confidence >= BELIEVED_MIN
    expected = Reason.BELIEVED if believed else Reason.FEW_PHOTONS
    assert depth.reason.tolist() == [[expected, Reason.NO_LIGHT]]


def test_a_depth_is_sure_unless_it_is_told_how_sure():
    told = Depth.of([[5.0]])
    assert (told.confidence.item(), told.reason.item()) == (1.0, Reason.BELIEVED)


def test_the_reason_of_a_pixel_is_that_of_its_first_return():
    depth = Depth.of([[[5.0, np.nan], [np.nan, 5.0]]], [[[0.1, 0.0], [0.0, 1.0]]])
    assert depth.reason.tolist() == [[Reason.FEW_PHOTONS, Reason.NO_LIGHT]]


def test_the_confidence_of_a_pixel_without_a_depth_does_not_matter():
    depth = Depth.of([[5.0, np.nan, np.nan]], [[0.5, np.nan, 0.9]])
    assert depth.confidence.ravel().tolist() == [0.5, 0.0, 0.0]


def test_a_depth_stays_as_it_is_when_the_callers_arrays_change():
    distance_m = np.full((2, 2, 1), 5.0)
    confidence = np.full((2, 2, 1), 0.75)
    depth = Depth.of(distance_m, confidence)
    distance_m[:] = 6.0
    confidence[:] = 0.25
    assert (depth.depth_m == 5.0).all()
    assert (depth.confidence == 0.75).all()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Depth.of(np.zeros(4)), r"depth_m: has shape \(4,\), must be"),
        (lambda: Depth.of(np.zeros((2, 2, 0))), "depth_m: has shape"),
        (lambda: Depth.of([["far"]]), "depth_m: must hold numbers"),
        (lambda: Depth.of([[1.0], [2.0, 3.0]]), "depth_m: has lists of different lengths"),
        (lambda: Depth.of([[1.0, np.inf]]), r"depth_m\[0, 1\] = inf: must be"),
        (lambda: Depth.of(np.ones((2, 2)), confidence=5.0), r"confidence.* = 5.0: must be"),
        (lambda: Depth.of(np.ones((2, 2)), confidence=-0.1), r"confidence.* = -0.1: must be"),
        (lambda: Depth.of(np.ones((2, 2)), [1.0, 1.0, 1.0]), r"confidence: has shape \(3,\)"),
        (lambda: Depth.of([[1.0, 2.0]], [[1.0, np.nan]]), "confidence: is NaN where there is"),
        (lambda: write_depths("depths.npz", []), "depths: is empty"),
    ],
)
def test_a_depth_that_is_none_is_refused(make, says):
    with pytest.raises(InputError, match=says):
        make()


@pytest.mark.parametrize("name", ("wide", "odd"))
def test_an_event_of_format_short_has_its_winner_in_the_map(name):
    """Also of subgroups with more than 64 pixels."""
    config = configured(SENSORS[name], {"format": "short", "pulses": 20}, {"threshold": 1})
    result = golden_result(config, random_edges(config, 4000, 1))
    events = frame_events(result, config, PulseTicks(2.0))
    pixels = config.sensor.pixels
    for subgroup in range(config.sensor.subgroups):
        maps = events.maps(subgroup, pixels)
        rows = slice(events.bounds[subgroup], events.bounds[subgroup + 1])
        assert maps.sum(axis=1).tolist() == [1] * len(maps)
        assert np.array_equal(maps.argmax(axis=1), events.winner[rows])
    assert events.winner.max() > pixels - pixels // 4


def test_masked_pixels_do_not_take_part_in_the_lead_of_the_first_photon():
    half = configured({"rows": 8, "cols": 8}, {}, {"mask": "ffffffff"})
    one = np.zeros(1, np.int64)
    lead = PulseTicks(3.0).lead
    for count in (1, 8, 32):
        arrival = arrival_ticks(one, one + 100, one + count, half, lead)
        assert arrival == pytest.approx(100.5 + lead(np.maximum(photons_of(count, 32), 1)))


@pytest.mark.parametrize("side", (-1, 1))
def test_a_second_return_is_farther_from_the_first_than_its_pulse_is_wide(side):
    """By at least one tick more than `APART_SIGMAS`, before it or after it."""
    sigma_ticks = 2.0
    apart = round(APART_SIGMAS * sigma_ticks)
    for distance, returns in ((apart, 1), (apart + 1, 2)):
        histogram = np.zeros((1, 200), np.int32)
        histogram[0, 100] = 90
        histogram[0, 100 + side * distance] = 80
        ticks, _ = pixel_peaks(histogram, "maximum", None, PulseTicks(sigma_ticks), 3)
        expected = [100.5, 100.5 + side * distance][:returns]
        assert ticks[0, :returns].tolist() == expected
        assert np.isnan(ticks[0, returns:]).all()
