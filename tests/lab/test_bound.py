# SPDX-License-Identifier: Apache-2.0
"""The bounds of a distance: against numbers of another program, and against simulated words."""

from itertools import product

import numpy as np
import pytest

import coincid
from coincid.lab import bound as bounds
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.config import parse_config
from coincid.model.contract.latency import armed_cycle, close_cycle
from coincid.model.depth.arrivals import SYSTEM_FWHM_S
from coincid.model.depth.pulse_ticks import pulse_ticks
from coincid.model.light.light import Arrivals, Light
from coincid.model.light.spad import Spad
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


def test_the_usual_light_is_the_median_of_the_pixels_with_light():
    """Not their mean, which a few bright ones would raise."""
    signal = [[0.0], [0.1], [0.2], [9.0], [0.0]]
    light = Light(
        rows=1, cols=5, distance_m=5.0, signal_per_pulse=signal,
        background_cps=[1e9, 1e6, 8e6, 2e6, 1e9],
    )  # fmt: skip
    assert bounds.median_light(light) == (0.2, 2e6)
    dark = Light(rows=1, cols=2, distance_m=5.0, signal_per_pulse=0.0, background_cps=1e6)
    assert bounds.median_light(dark) is None


@pytest.mark.parametrize(
    ("threshold", "usual"), [([1, 1, 2, 9, 9], 2), ([3, 4], 3), ([2], 2), ([1, 1, 1, 64], 1)]
)
def test_the_usual_threshold_is_the_median_of_the_subgroups(threshold, usual):
    """A whole number, of every subgroup."""
    config = bounds.with_usual_threshold(parse_config({}), np.array(threshold))
    assert config.threshold.tolist() == [usual] * 16


@pytest.mark.parametrize("noise_cps", [0.0, 1e6, 5e7])
def test_a_spad_is_ready_except_in_the_dead_times_of_its_background(noise_cps):
    wall = bounds.subgroup_wall(parse_config({}), 0.2, noise_cps)
    assert wall.alive == pytest.approx(1 / (1 + noise_cps * Spad().dead_time_s))
    assert wall.noise == pytest.approx(noise_cps * 62.5e-12)


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


@pytest.mark.parametrize(
    "own",
    [
        {"threshold": 4},
        {"window": 40},
        {"coincidence": False},
        {"mask": "ffff"},
        {"gating": True, "gate_start": LIT_CYCLE, "gate_len": 10},
    ],
    ids=lambda own: next(iter(own)),
)
def test_a_bound_has_the_settings_of_subgroup_0(own):
    frame = {"gate_every": 1, "gate_step": 10, "gate_steps": 5}
    wall = {"distance_m": 8.0, "pulses": 100, "trials": 1}
    usual, of_all = (
        coincid.bound(parse_config({"frame": frame, "subgroup": subgroup}), **wall)
        for subgroup in ({}, own)
    )
    assert of_all.bound_mm != usual.bound_mm
    for subgroups, expected in ((range(1), of_all), (range(1, 16), usual)):
        override = {"subgroups": list(subgroups), **own}
        config = parse_config({"frame": frame, "override": [override]})
        assert coincid.bound(config, **wall) == expected


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


def test_a_pulse_much_shorter_than_a_tick_has_no_bound_of_words():
    """One tick has one, which grows with the pulse."""
    config = parse_config({"sensor": {"rows": 8, "cols": 8}})
    told = [
        coincid.bound(config, system_fwhm_s=ticks * config.tick_s, **WALL).bound_mm
        for ticks in (0.8, 1.0, 2.0, 4.0)
    ]
    assert told == sorted(told)
    assert told[0] < 0.4 * told[-1]
    with pytest.raises(coincid.InputError, match="at least 4.4e-11 s") as caught:
        coincid.bound(config, system_fwhm_s=1e-12, **WALL)
    assert caught.value.field == "system_fwhm_s"
    short = Pulse(time_s=[0, 25e-12, 50e-12], density=[0, 1, 0])
    with pytest.raises(coincid.InputError, match="much shorter than a tick") as caught:
        coincid.bound(config, pulse=short, **WALL)
    assert caught.value.field == "pulse"
    run = coincid.simulate(scene="flat:4", pulses=50, rows=8, cols=8, pulse=short)
    assert run["bound_mm"] is None
    assert np.isnan(bounds.pixel_bounds_mm(run.config, run.light, short)).all()
    photons_mm = bounds.photon_bound_mm(config, 0.5, 1e6, pulse_ticks(config, 1e-12))
    assert 0 < photons_mm < told[0]


def test_nothing_tells_of_a_wall_without_light():
    found = coincid.bound(**WALL | {"reflectivity": 0})
    assert (found.photons_mm, found.bound_mm, found.wall_bound_mm) == (np.inf, np.inf, np.inf)


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


def test_the_gate_of_a_pixel_is_judged_at_its_strongest_target():
    """Whichever of its targets that is."""
    light = Light(
        rows=1,
        cols=3,
        distance_m=[[8.0, 2.0], [2.0, 8.0], [8.0, 2.0]],
        signal_per_pulse=[[0.2, 0.01], [0.01, 0.2], [0.01, 0.2]],
        background_cps=1e6,
    )
    usual = parse_config({"sensor": {"rows": 8, "cols": 8}})
    gated = usual.with_settings(gating=True, gate_start=20)
    found = bounds.pixel_bounds_mm(gated, light)
    assert list(found[:2]) == list(bounds.pixel_bounds_mm(usual, light)[:2])
    assert np.isnan(found[2])
    assert bounds.usual_open_share(gated, light) == 1.0


def test_light_in_bins_has_a_background_of_its_own_and_no_distance_that_a_gate_could_hide():
    """The background among it counts beside the other, and its signal is what is left."""
    arrivals = Arrivals(
        first=[0, 1, 2],
        start_s=[20e-9, 50e-9],
        photons=[0.7, 0.7],
        background_cps=2e6,
        span_s=100e-9,
    )
    light = Light(
        rows=1,
        cols=2,
        distance_m=np.nan,
        signal_per_pulse=0.0,
        background_cps=1e6,
        arrivals=arrivals,
    )
    assert bounds.median_light(light) == pytest.approx((0.5, 3e6))
    gated = parse_config({"sensor": {"rows": 8, "cols": 8}}).with_settings(
        gating=True, gate_start=20
    )
    assert bounds.usual_open_share(gated, light) == 1.0
    expected = bounds.word_bounds_mm(gated, 0.5, 3e6).pixel_mm
    assert bounds.pixel_bounds_mm(gated, light) == pytest.approx([expected] * 2)


def test_a_gate_shows_light_from_beyond_the_range_where_it_comes():
    """In a later period, as far from its beginning as that of a nearer wall."""
    moving = parse_config({"frame": {"gate_every": 1, "gate_step": 10, "gate_steps": 5}})
    gated = moving.with_settings(gating=True, gate_start=LIT_CYCLE, gate_len=10)
    range_m = gated.period_ticks * gated.tick_m
    near_m = np.array([8.0, 2.0])
    shares = [bounds._open_at(gated, near_m + k * range_m).tolist() for k in range(3)]
    assert shares == [[0.2, 0.0]] * 3


@pytest.mark.parametrize("fwhm_s", [5e-9, 20e-9])
def test_a_pulse_that_is_wider_than_the_period_has_its_gross_errors(fwhm_s):
    short = parse_config({"frame": {"period": 12}})
    found = coincid.bound(short, distance_m=0.5, pulses=10, trials=5, system_fwhm_s=fwhm_s)
    assert 0 <= found.gross_share <= 1


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


@pytest.mark.parametrize(
    ("name", "legal", "wrong"),
    [
        ("distance_m", [0.05, 30.0], [0.0499, -1.0, np.inf, np.nan]),
        ("reflectivity", [0.01, 1.0], [-0.01, 1.01]),
        ("klux", [0, 100], [-0.1]),
        ("trials", [0, 1], [-1, 1_000_001, 0.5]),
        ("system_fwhm_s", [1e-10, 1e-9], [0.0, 21e-9]),
    ],
)
def test_ends_of_the_range_of_a_wall_are_legal(name, legal, wrong):
    usual = {"trials": 0, "pulses": 10}
    for value in legal:
        assert coincid.bound(**usual | {name: value}).bound_mm > 0
    for value in wrong:
        with pytest.raises(coincid.InputError, match=f"^{name} = "):
            coincid.bound(**usual | {name: value})


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


@pytest.mark.parametrize("pixels", [1, 3])
def test_a_map_without_any_light_has_no_bounds(pixels):
    config = parse_config({"sensor": {"rows": 8, "cols": 8}})
    dark = Light(rows=1, cols=pixels, distance_m=5.0, signal_per_pulse=0.0, background_cps=1e6)
    found = bounds.pixel_bounds_mm(config, dark)
    assert found.shape == (pixels,)
    assert np.isnan(found).all()


def test_bounds_between_the_lights_of_a_map_are_near_those_of_their_own_light():
    """Though it ranges over two orders of magnitude."""
    config = parse_config({"sensor": {"rows": 8, "cols": 8}, "subgroup": {"threshold": 2}})
    signal = np.array([0.02, 0.05, 0.11, 0.3, 0.7, 1.5])
    light = Light(
        rows=1, cols=6, distance_m=5.0, signal_per_pulse=signal[:, None], background_cps=1e6
    )
    expected = [bounds.word_bounds_mm(config, one, 1e6).pixel_mm for one in signal]
    assert bounds.pixel_bounds_mm(config, light) == pytest.approx(expected, rel=0.03)


def test_the_usual_wall_is_grey_8_m_away_and_in_full_daylight():
    wall = coincid.bound(distance_m=8, reflectivity=0.4, klux=50, trials=0)
    usual = coincid.bound(trials=0)
    for name in ("signal_per_pulse", "background_cps", "photons_mm", "bound_mm"):
        assert getattr(usual, name) == getattr(wall, name)


def tiny(window, rearm):
    """Return three pixels before a wall whose light is as wide as some ticks; of two pixels half of
    the windows are rejected, of one all.
    """
    return bounds.Wall(
        signal=0.9,
        noise=0.05,
        alive=0.75,
        pulse=pulse_ticks(parse_config({}), 3e-10),
        pixels=3,
        window=window,
        phases=2,
        rearm=rearm,
        rejected=np.array([1.0, 1.0, 0.5, 0.0]),
        start=-4,
        cycles=4,
    )


def fired(wall, place, first, last):
    """Return the chance that a pixel fires in some ticks, both included."""
    shares = wall.pulse.share_before(wall.start + np.array([first, last + 1]) - place)
    photons = wall.signal * (shares[1] - shares[0]) + wall.noise * (last + 1 - first)
    return 1 - np.exp(-wall.alive * photons)


def counted_windows(wall, place, shift, of_all):
    """Return for each tick the chance of an event with each number of pixels, of one with the first
    pixel and of one without, and of a rejected window: from what each pixel does by itself.
    """
    found = []
    for tick in range(wall.cycles * wall.phases):
        places = [place + shift * (of_all or k == 0) for k in range(wall.pixels)]
        cycle, end = tick // wall.phases * wall.phases, tick + wall.window - 1
        silent = 1.0
        states = []  # of each pixel: chances to fire at once, only later, not at all
        for own in places:
            silent *= 1 - fired(wall, own, cycle, tick - 1)
            at_once, never = fired(wall, own, tick, tick), 1 - fired(wall, own, tick, end)
            states.append((at_once, 1 - at_once - never, never))
        numbers, with_first, without, rejected = np.zeros(wall.pixels), 0.0, 0.0, 0.0
        for chosen in product(range(3), repeat=wall.pixels):
            if 0 not in chosen:
                continue  # no window
            chance = silent * np.prod([of[k] for of, k in zip(states, chosen, strict=True)])
            count = sum(k < 2 for k in chosen)
            kept = chance * (1 - wall.rejected[count])
            numbers[count - 1] += kept
            with_first += kept * (chosen[0] < 2)
            without += kept * (chosen[0] == 2)
            rejected += chance - kept
        found.append((numbers, with_first, without, rejected))
    return found


@pytest.mark.parametrize("shift", (0.0, 0.4))
@pytest.mark.parametrize("window", (1, 2, 3))
def test_chances_of_windows_are_those_of_their_pixels(window, shift):
    wall, place = tiny(window, 0), 0.7
    together = bounds.windows(wall, place, shift, of_all=True)
    alone = bounds.windows(wall, place, shift, of_all=False)
    counted = counted_windows(wall, place, shift, of_all=True)
    assert np.allclose(together.told, [numbers for numbers, *_ in counted], rtol=1e-9)
    assert np.allclose(together.rejected, [one[3] for one in counted], rtol=1e-9)
    counted = counted_windows(wall, place, shift, of_all=False)
    wins, others_win, outside = alone.told.T
    assert np.allclose(wins + others_win, [one[1] for one in counted], rtol=1e-9)
    assert np.allclose(outside, [one[2] for one in counted], rtol=1e-9)
    assert np.allclose(alone.rejected, [one[3] for one in counted], rtol=1e-9)


def told_by_all_sequences(wall, of_shifts):
    """Return Fisher's information of all sequences of events that a pulse may have.

    of_shifts: the windows now, and with a time that is later and earlier by `SHIFT_TICKS`.
    """

    def follow(c, weights):
        """weights: of each shift, chance to be armed in each cycle, with the events so far."""
        if c == wall.cycles:
            now, later, earlier = (sum(of.values()) for of in weights)
            return (later - earlier) ** 2 / (2 * bounds.SHIFT_TICKS) ** 2 / now if now else 0.0
        ticks = range(c * wall.phases, (c + 1) * wall.phases)
        again = [armed_cycle(close_cycle(t, wall.window, wall.phases), wall.rearm) for t in ticks]
        silent, total = [], 0.0
        for of, one in zip(weights, of_shifts, strict=True):
            none = {cycle: weight for cycle, weight in of.items() if cycle != c}
            armed = of.get(c, 0.0)
            for t, cycle in zip(ticks, again, strict=True):
                none[cycle] = none.get(cycle, 0.0) + armed * one.rejected[t]
            stays = 1 - one.told[ticks].sum() - one.rejected[ticks].sum()
            none[c + 1] = none.get(c + 1, 0.0) + armed * stays
            silent.append(none)
        total += follow(c + 1, silent)
        if any(of.get(c) for of in weights):
            for t, cycle in zip(ticks, again, strict=True):
                for kind in range(of_shifts[0].told.shape[1]):
                    chances = [
                        of.get(c, 0.0) * one.told[t, kind]
                        for of, one in zip(weights, of_shifts, strict=True)
                    ]
                    total += follow(c + 1, [{cycle: chance} for chance in chances])
        return total

    return follow(0, [{0: 1.0}] * 3)


@pytest.mark.parametrize("of_all", (True, False))
@pytest.mark.parametrize(("window", "rearm"), [(1, 0), (2, 0), (2, 1), (3, 2)])
def test_what_a_pulse_tells_is_what_all_sequences_of_events_tell(window, rearm, of_all):
    """Rejected windows are hidden, and close the tree until it is armed again."""
    wall, place = tiny(window, rearm), 0.7
    shifts = 0.0, bounds.SHIFT_TICKS, -bounds.SHIFT_TICKS
    of_shifts = [bounds.windows(wall, place, shift, of_all=of_all) for shift in shifts]
    expected = told_by_all_sequences(wall, of_shifts)
    assert bounds._information(wall, place, of_all=of_all) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("window", "of_all"), [(1, False), (4, True)])
def test_a_bound_is_that_of_times_anywhere_in_a_cycle(window, of_all):
    """Not in the first tick of it alone, where fewer ticks of the cycle come before the pulse."""
    config = parse_config(
        {"sensor": {"rows": 8, "cols": 8}, "subgroup": {"window": window, "threshold": 1}}
    )
    signal, noise_cps, places = 0.8, 3e7, 16
    wall = bounds.subgroup_wall(config, signal, noise_cps, None)
    told = [
        bounds._information(wall, (place + 0.5) * wall.phases / places, of_all=of_all)
        for place in range(places)
    ]
    information = config.pulses * bounds._armed_share(wall) * np.mean(told)
    found = bounds.word_bounds_mm(config, signal, noise_cps)
    expected = bounds.mm_per_tick(config) / np.sqrt(information)
    assert (found.wall_mm if of_all else found.pixel_mm) == pytest.approx(expected, rel=0.01)


def test_a_tree_that_background_opens_is_armed_less_often():
    """Background opens a window in half of the cycles in which the tree is armed, and each window
    takes three further cycles: of five cycles, the tree is armed in two.
    """
    wall = tiny(window=5, rearm=1)
    noise = np.log(2) / (wall.pixels * wall.alive * wall.phases)
    assert bounds._armed_share(wall._replace(noise=noise)) == pytest.approx(2 / 5)
    assert bounds._armed_share(wall._replace(noise=0.0)) == 1
    assert bounds._armed_share(wall._replace(window=1, rearm=0)) == 1
