# SPDX-License-Identifier: Apache-2.0
"""The bounds of a distance: against numbers of another program, and against simulated words."""

import numpy as np
import pytest

import coincid
from coincid.lab import bound as bounds
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.config import parse_config
from coincid.model.depth.arrivals import SYSTEM_FWHM_S
from coincid.model.depth.pulse_ticks import pulse_ticks
from coincid.model.light.light import Light
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S
from coincid.model.shared.pulse import Pulse

# distance, reflectivity at 50 klux: mm for one pulse, by a program that counts ties otherwise:
# from all photons of a pixel; from the words at thresholds 1 and 3, of a pixel and of a wall
OTHERS = {
    (2.0, 0.4): (30.0, (82.0, 82.5), (10.44, 10.80)),
    (4.0, 0.4): (47.2, (115.6, 117.0), (14.45, 14.85)),
    (16.0, 0.4): (175.2, (238.7, 313.9), (29.38, 38.70)),
    (16.0, 0.1): (346.7, (381.8, 1325.8), (47.51, 164.70)),
}


@pytest.mark.parametrize("wall", OTHERS)
def test_bounds_of_another_program(wall):
    distance_m, reflectivity = wall
    photons_mm, of_pixel, of_wall = OTHERS[wall]
    for k, threshold in enumerate((1, 3)):
        found = coincid.bound(
            distance_m=distance_m,
            reflectivity=reflectivity,
            klux=50,
            threshold=threshold,
            pulses=1,
            trials=0,
        )
        assert found.photons_mm == pytest.approx(photons_mm, rel=0.005)
        assert found.bound_mm == pytest.approx(of_pixel[k], rel=0.04)
        assert found.wall_bound_mm == pytest.approx(of_wall[k], rel=0.06)


def test_likeliest_time_of_simulated_words_reaches_the_bound():
    """80 frames of a subgroup before a wall: the likeliest common time, by the law of the bound."""
    distance_m, pulses, frames = 8.0, 50, 80
    setup = Setup.of(
        f"flat:{distance_m},0.4",
        klux=10,
        sensor={"rows": 8, "cols": 8},
        frame={"pulses": pulses, "frames": frames},
        subgroup={"threshold": 2},
    )
    run = Run(setup, workers=2)
    true_ticks = 2 * distance_m / SPEED_OF_LIGHT_M_S / run.config.tick_s
    begin = int(true_ticks // 32) * 32
    light = float(run.light.total_signal[0])
    noise = float(run.light.background_cps[0])
    wall = bounds.subgroup_wall(run.config, light, noise)
    shifts = np.arange(-3, 3.01, 0.05)
    tables = [
        np.log(bounds.windows(wall, true_ticks - begin, shift, of_all=True).told + 1e-12)
        for shift in shifts
    ]
    result = run.result
    tick = result["stamp"] - begin - wall.start
    inside = (tick >= 0) & (tick < wall.cycles * wall.phases)
    frame = result["pulse"] // pulses
    off = []
    for number in range(frames):
        here = inside & (frame == number)
        fits = [one[tick[here], result["count"][here] - 1].sum() for one in tables]
        off.append(shifts[np.argmax(fits)])
    found = coincid.bound(
        distance_m=distance_m, klux=10, threshold=2, pulses=pulses, trials=0
    ).wall_bound_mm
    rms_mm = np.sqrt(np.mean(np.square(off))) * bounds.mm_per_tick(run.config)
    assert 0.8 < rms_mm / found < 1.25


def test_more_pulses_and_fewer_rejected_windows_lower_the_bound():
    dim = {"distance_m": 16.0, "reflectivity": 0.1, "trials": 0}
    many = coincid.bound(threshold=3, pulses=400, **dim)
    few = coincid.bound(threshold=3, pulses=100, **dim)
    assert few.bound_mm == pytest.approx(2 * many.bound_mm)
    assert coincid.bound(threshold=2, pulses=100, **dim).bound_mm < 0.6 * few.bound_mm
    assert few.photons_mm < few.bound_mm


def test_a_frame_has_the_bound_of_its_median_light():
    setup = Setup.of(
        "flat:8,0.4",
        klux=10,
        sensor={"rows": 8, "cols": 8},
        frame={"pulses": 100},
        subgroup={"threshold": 3},
    )
    same = coincid.bound(setup.config, distance_m=8, reflectivity=0.4, klux=10, trials=0)
    assert Run(setup)["bound_mm"] == pytest.approx(same.bound_mm)


def test_without_coincidence_no_threshold_costs_anything():
    dim = {"distance_m": 16.0, "reflectivity": 0.1, "klux": 50, "trials": 0}
    found = [
        coincid.bound(
            parse_config({"subgroup": {"coincidence": False, "threshold": threshold}}), **dim
        )
        for threshold in (1, 3)
    ]
    assert found[0].bound_mm == found[1].bound_mm


def test_the_usual_background_is_that_of_pixels_with_light():
    light = Light(
        rows=1, cols=3, distance_m=5.0, signal_per_pulse=[[0.2], [0.0], [0.0]],
        background_cps=[1e6, 5e6, 5e6],
    )  # fmt: skip
    assert bounds.median_light(light).noise_cps == 1e6


def test_gross_errors_of_an_ideal_estimator():
    dim = {"distance_m": 16.0, "reflectivity": 0.1, "klux": 50}
    assert coincid.bound(pulses=1000, trials=100, **dim).gross_share < 0.2
    assert coincid.bound(pulses=100, trials=100, **dim).gross_share > 0.6
    assert np.isnan(coincid.bound(pulses=100, trials=0, **dim).gross_share)


@pytest.mark.parametrize(
    "dark",
    [
        {"distance_m": 30.0, "reflectivity": 0.1, "klux": 0, "pulses": 10},
        {"reflectivity": 0.0, "klux": 50, "pulses": 100},
    ],
)
def test_a_frame_that_tells_nothing_is_as_wrong_as_a_guess(dark):
    found = coincid.bound(trials=100, **dark)
    told = 1 - np.exp(-found.signal_per_pulse * dark["pulses"])
    assert found.gross_share == pytest.approx(1 - told, abs=0.06)


WALL = {"distance_m": 8.0, "klux": 50, "threshold": 2, "pulses": 100, "trials": 1}
LIT_CYCLE = 26  # of the light of `WALL`


def test_a_bound_counts_the_pulses_with_an_open_gate():
    """One that moves by its length covers the light in every fifth pulse."""
    usual = coincid.bound(**WALL)
    gate = {"gating": True, "gate_start": LIT_CYCLE, "gate_len": 10}
    assert coincid.bound(**WALL, **gate) == usual
    frame = {"gate_every": 1, "gate_step": 10, "gate_steps": 5}
    moving = coincid.bound(parse_config({"frame": frame}), **WALL, **gate)
    assert moving.bound_mm == pytest.approx(usual.bound_mm * 5**0.5)
    assert moving.wall_bound_mm == pytest.approx(usual.wall_bound_mm * 5**0.5)
    assert moving.photons_mm == usual.photons_mm


def test_a_bound_has_the_pixels_that_are_on():
    """As if the subgroup had no others; so fewer windows become events."""
    half = coincid.bound(**WALL, mask="ffffffff")
    small = parse_config({"sensor": {"subgroup": [4, 8]}})
    assert half == coincid.bound(small, **WALL)
    assert half.wall_photons_mm == pytest.approx(half.photons_mm / 32**0.5)


@pytest.mark.parametrize(
    ("frame", "subgroup", "says"),
    [
        ({}, {"gating": True, "gate_start": LIT_CYCLE + 1}, "subgroup.gate_start: .* never open"),
        ({}, {"gating": True, "gate_start": 0, "gate_len": LIT_CYCLE}, "subgroup.gate_start"),
        ({}, {"mask": "0"}, "subgroup.mask: no window"),
        ({}, {"mask": "1"}, "subgroup.mask: no window"),
        ({"format": "counts"}, {}, "frame.format = 'counts': has no events"),
    ],
)
def test_where_no_event_tells_of_the_wall_there_is_no_bound(frame, subgroup, says):
    sensor = {"rows": 8, "cols": 8, "counts": 1}
    config = parse_config({"sensor": sensor, "frame": frame, "subgroup": subgroup})
    with pytest.raises(coincid.InputError, match=says):
        coincid.bound(config, **WALL)
    setup = Setup.of(
        f"flat:{WALL['distance_m']}",
        sensor=sensor,
        frame=frame | {"pulses": WALL["pulses"]},
        subgroup=subgroup | {"threshold": WALL["threshold"]},
    )
    run = Run(setup)
    assert run["bound_mm"] is None
    if not setup.config.counting:
        assert np.isnan(bounds.pixel_bounds_mm(setup.config, run.light)).all()


def test_bounds_of_a_map_count_the_open_gates_of_each_distance():
    """One gate covers the first pixel, the second one's light comes before it."""
    light = Light(
        rows=1, cols=2, distance_m=[[8.0], [2.0]], signal_per_pulse=0.2, background_cps=1e6
    )
    usual = parse_config({"sensor": {"rows": 8, "cols": 8}})
    gated = usual.with_settings(gating=True, gate_start=20)
    found = bounds.pixel_bounds_mm(gated, light)
    assert found[0] == bounds.pixel_bounds_mm(usual, light)[0]
    assert np.isnan(found[1])


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"distance_m": 0.0}, "distance_m"),
        ({"reflectivity": 1.5}, "reflectivity"),
        ({"klux": -1}, "klux"),
        ({"threshold": 0}, "threshold"),
    ],
)
def test_errors_name_the_value(given, says):
    with pytest.raises(coincid.InputError, match=says):
        coincid.bound(parse_config({}), **given)


def test_bounds_of_a_measured_pulse():
    """A table of the Gaussian has its bounds; a tail takes light away from the edge of the pulse."""
    wall = {"distance_m": 8.0, "klux": 10, "threshold": 2, "trials": 20}
    usual = coincid.bound(**wall)
    same = coincid.bound(pulse=Pulse.gaussian(SYSTEM_FWHM_S), **wall)
    for name in ("photons_mm", "bound_mm", "wall_photons_mm", "wall_bound_mm"):
        assert getattr(same, name) == pytest.approx(getattr(usual, name), rel=0.02)
    assert same.gross_share == pytest.approx(usual.gross_share, abs=0.1)
    time_s = np.arange(-1000, 3000, 25) * 1e-12
    early = np.exp(-((time_s / 212e-12) ** 2) / 2)
    tail = np.where(time_s > 0, np.exp(-np.maximum(time_s, 0) / 250e-12), 0)
    tailed = coincid.bound(pulse=Pulse(time_s=time_s, density=early + 0.8 * tail), **wall)
    assert 1.02 < tailed.bound_mm / usual.bound_mm < 2


def test_bounds_of_a_map_are_those_of_its_light():
    """Each pixel's of its own signal, with the measured pulse if there is one."""
    config = parse_config({"sensor": {"rows": 8, "cols": 8}, "subgroup": {"threshold": 2}})
    wide = Pulse.gaussian(2 * SYSTEM_FWHM_S)
    for pulse in (None, wide):
        light = Light(
            rows=1, cols=3, distance_m=5.0, signal_per_pulse=[[0.2], [0.0], [0.8]], pulse=pulse,
            background_cps=1e6,
        )  # fmt: skip
        found = bounds.pixel_bounds_mm(config, light, pulse)
        shape = pulse_ticks(config, pulse=pulse)
        for pixel in (0, 2):
            signal = light.total_signal[pixel]
            expected = bounds.word_bounds_mm(config, signal, 1e6, shape).pixel_mm
            assert found[pixel] == pytest.approx(expected, rel=1e-9)
        assert np.isnan(found[1])
