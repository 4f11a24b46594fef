# SPDX-License-Identifier: Apache-2.0
"""A second LiDAR's photons, and the dithered laser period, against results by hand."""

import numpy as np
import pytest
from scipy import stats

from coincid.model.contract.config import parse_config
from coincid.model.contract.dither import LFSR_BITS, start_cycles
from coincid.model.light.light import Interferer, Light
from coincid.model.light.photons import edge_chunks, generate_edges
from coincid.model.light.spad import Spad
from coincid.model.light.timing import Timing
from coincid.model.shared.constants import SIGMA_PER_FWHM, SPEED_OF_LIGHT_M_S
from coincid.model.shared.errors import InputError

from .test_photons import BARE, LEVEL, same

SHARP = {"fwhm_s": 0.0}


def edges_of(light, timing, spad=BARE, pulses=400, **options):
    return generate_edges(light, spad, timing, pulses=pulses, seed=1, **options)


def dark(**others):
    return Light(rows=8, cols=8, distance_m=np.nan, signal_per_pulse=0.0, **others)


def test_photons_of_the_other_are_poisson():
    """With one foreign pulse in each of our periods: the stated number of photons, at its phase,
    with the pixels' delays.
    """
    delay_s = np.arange(64) * 1e-9
    other = Interferer(photons_per_pulse=0.7, phase_s=100.03e-9, delay_s=delay_s, **SHARP)
    edges = edges_of(dark(interferer=other), Timing())
    counts = np.bincount(edges.pixel * 400 + edges.pulse, minlength=64 * 400)
    seen = np.bincount(np.minimum(counts, 5))
    expected = stats.poisson(0.7).pmf(np.arange(5)) * counts.size
    assert stats.chisquare(seen, np.r_[expected, counts.size - expected.sum()]).pvalue > LEVEL
    assert np.array_equal(edges.tick, 1600 + 16 * edges.pixel)


@pytest.mark.parametrize("period_s", [137.03e-9, 499.99e-9, 500.5e-9, 1.7e-6])
@pytest.mark.parametrize("bits", [0, 3])
def test_pulses_of_the_other_come_when_they_must(period_s, bits):
    """All foreign pulses, and nothing else, arrive at phase + k * period, on a clock that starts at
    our first trigger.
    """
    timing = Timing(dither_bits=bits)
    other = Interferer(photons_per_pulse=40, period_s=period_s, phase_s=33.0123e-9, **SHARP)
    edges = edges_of(dark(interferer=other), timing)
    start_s = timing.start_cycles(400) / timing.clock_hz
    k = np.arange(-2, start_s[-1] / period_s + 1)
    came_s = 33.0123e-9 + k * period_s
    pulse = np.searchsorted(start_s, came_s, side="right") - 1
    tick = np.floor((came_s - start_s[pulse]) / timing.tick_s).astype(int)
    wanted = {
        (int(p), int(t))
        for p, t in zip(pulse, tick, strict=True)
        if 0 <= p < 400 and t < timing.period_ticks
    }
    found = set(zip(edges.pulse.tolist(), edges.tick.tolist(), strict=True))
    assert found == wanted and len(wanted) > 100


def test_width_of_the_others_pulse():
    edges = edges_of(
        dark(interferer=Interferer(photons_per_pulse=1.0, phase_s=200e-9, fwhm_s=2e-9)), Timing()
    )
    time_s = (edges.tick + 0.5) * Timing().tick_s
    assert time_s.mean() == pytest.approx(200e-9, abs=30e-12)
    assert time_s.std() == pytest.approx(2e-9 / 2.3548, rel=0.02)


def test_light_of_the_other_falls_on_both_sides_of_a_trigger():
    """A third of it comes before the trigger, at the end of the period before."""
    other = Interferer(photons_per_pulse=0.5, phase_s=0.5e-9, fwhm_s=2.5e-9)
    edges = edges_of(dark(interferer=other), Timing())
    early = stats.norm.cdf(-0.5e-9, scale=2.5e-9 * SIGMA_PER_FWHM)
    expected = np.array([early, 1 - early]) * 0.5 * 64 * 400
    seen = np.bincount(edges.tick < 4000)
    assert seen == pytest.approx(expected, rel=0.05)


def test_wide_pulses_of_the_other_are_even_light():
    """Also in the first nanoseconds of a period, where there is light of several earlier pulses."""
    other = Interferer(photons_per_pulse=0.1, period_s=1e-9, fwhm_s=5e-9)
    edges = edges_of(dark(interferer=other), Timing(), pulses=200)
    expected = 64 * 200 * 0.1
    seen = np.bincount(edges.tick // 16, minlength=500)
    assert seen == pytest.approx(np.full(500, expected), abs=5 * expected**0.5)


def waits_of(pulses, bits):
    return np.diff(start_cycles(pulses, 250, bits)) - 250


def test_the_wait_is_the_registers():
    """The LFSR takes all states except 0; waits are its low bits at the ends of the periods,
    counted step by step.
    """
    state, states = 1, set()
    for _ in range(1 << LFSR_BITS):
        states.add(state)
        state = (state >> 1) ^ (0xB400 if state & 1 else 0)
    assert len(states) == (1 << LFSR_BITS) - 1
    state, waits = 1, []
    for _ in range(50):
        for _ in range(250):
            state = (state >> 1) ^ (0xB400 if state & 1 else 0)
        waits.append(state & 15)
    assert waits_of(50, 4).tolist() == waits
    assert waits_of(50, 0).tolist() == [0] * 50
    waits = waits_of(4096, 4)
    assert stats.chisquare(np.bincount(waits)).pvalue > LEVEL
    assert abs(np.corrcoef(waits[1:], waits[:-1])[0, 1]) < 0.06


def test_every_frame_waits_alike():
    config = parse_config(
        {"frame": {"frames": 3, "pulses": 7, "dither_bits": 5, "dither_seed": 99}}
    )
    waits = np.diff(Timing.from_config(config).start_cycles(21)) - 250
    assert waits.any() and waits[:7].tolist() == waits[7:14].tolist() == waits[14:].tolist()
    gap = config.with_frame(gap=1000)
    assert np.diff(Timing.from_config(gap).start_cycles(21)).tolist() == (1250 + waits).tolist()
    assert np.diff(gap.start_cycles()).tolist() == [*(1250 + waits[:6]), 250]
    # A frame ends with its last period.
    assert np.diff(config.start_cycles()).tolist() == (250 + np.r_[waits[:6], 0]).tolist()


def test_searches_of_counts_are_waits_as_those_of_the_sensor():
    """So the pulses of another LiDAR with our spacing of 350 cycles come at another time after each
    search: these take 13,244 and 8252 cycles more than the gap, or 56 and 148 less than a multiple.
    """
    config = parse_config(
        {
            "sensor": {"rows": 8, "cols": 8, "counts": 1},
            "frame": {"format": "counts", "pulses": 10, "gap": 100},
        }
    )
    timing = Timing.from_config(config)
    assert timing.start_cycles(10)[:10].tolist() == config.start_cycles()[:10].tolist()
    other = Interferer(photons_per_pulse=40, period_s=700e-9, phase_s=33.01e-9, **SHARP)
    edges = edges_of(dark(interferer=other), timing, pulses=10)
    of_pulse = [np.unique(edges.tick[edges.pulse == pulse]).tolist() for pulse in range(10)]
    assert of_pulse == [[528]] * 2 + [[528 + 56 * 32]] * 2 + [[2320 + 148 * 32]] * 6


def test_dither_leaves_what_is_in_range_alone():
    """Our own light and the background do not depend on when the pulse began."""
    wall = Light(rows=8, cols=8, distance_m=20.0, signal_per_pulse=0.3, background_cps=1e6)
    assert same(edges_of(wall, Timing()), edges_of(wall, Timing(dither_bits=5)))
    dead = edges_of(wall, Timing(dither_bits=5), Spad())
    assert len(dead) >= len(edges_of(wall, Timing(), Spad()))  # SPADs recover during a wait


def test_a_wait_counts_as_dead_time():
    """In dense light an edge follows as soon as the SPAD is alive and a period runs."""
    timing, spad = Timing(dither_bits=8), Spad(dead_time_s=300e-9, jitter_fwhm_s=0)
    edges = edges_of(
        Light(rows=1, cols=1, distance_m=np.nan, signal_per_pulse=0.0, background_cps=1e9),
        timing,
        spad,
    )
    start_s = timing.start_cycles(400) / timing.clock_hz
    time_s = start_s[edges.pulse] + edges.tick * timing.tick_s
    alive_s = time_s[:-1] + spad.dead_time_s
    last = np.searchsorted(start_s, alive_s, side="right") - 1
    first_s = np.where(alive_s < start_s[last] + timing.period_s, alive_s, start_s[last + 1])
    assert np.all(time_s[1:] - first_s < 30e-9)


def test_afterpulses_in_a_wait_are_lost():
    trap_s, timing = 200e-9, Timing(dither_bits=8)
    spad = Spad(dead_time_s=0, jitter_fwhm_s=0, afterpulse_probability=0.1, afterpulse_s=trap_s)
    flight_s = timing.period_s - 1e-9
    wall = Light(
        rows=8,
        cols=8,
        distance_m=flight_s * SPEED_OF_LIGHT_M_S / 2,
        signal_per_pulse=40.0,
        system_fwhm_s=0.0,
    )
    edges = edges_of(wall, timing, spad)
    primary = edges.tick == np.bincount(edges.tick).argmax()
    # mostly in the next period
    released = np.exp(-(waits_of(400, 8) / timing.clock_hz) / trap_s).mean()
    assert np.sum(~primary) == pytest.approx(0.1 * primary.sum() * released, rel=0.25)


def test_after_a_long_gap_every_pulse_is_like_the_first():
    """Dead time and trapped carriers do not outlive a gap of 4 us."""
    spad = Spad(dead_time_s=300e-9, afterpulse_probability=0.2, afterpulse_s=50e-9)
    bright = Light(rows=2, cols=4, distance_m=60.0, signal_per_pulse=1.0, background_cps=1e8)
    apart = edges_of(bright, Timing(gap_cycles=2000), spad, pulses=20)
    alone = [edges_of(bright, Timing(), spad, pulses=1, pulse_start=k) for k in range(20)]
    assert len(apart) > 200
    for name in ("pulse", "pixel", "tick"):
        together = np.concatenate([getattr(edges, name) for edges in alone])
        assert np.array_equal(getattr(apart, name), together)
    assert not same(apart, edges_of(bright, Timing(), spad, pulses=20))


@pytest.mark.parametrize(
    ("flight", "arrives"),
    [(0.7, 0.7), (1.2, None), (1.7, 0.2), (2.2, 0.7), (2.6, None), (4.6, 0.1)],
)
def test_where_light_arrives_with_gaps(flight, arrives):
    """Periods begin 1.5 periods apart; numbers are in periods."""
    timing = Timing(gap_cycles=125)
    wall = Light(
        rows=1,
        cols=1,
        distance_m=(flight * timing.period_s + 1e-12) * SPEED_OF_LIGHT_M_S / 2,
        signal_per_pulse=20.0,
        system_fwhm_s=0.0,
    )
    edges = edges_of(wall, timing, pulses=10)
    ticks = [] if arrives is None else [round(arrives * timing.period_ticks)]
    assert np.unique(edges.tick).tolist() == ticks


@pytest.mark.parametrize("bits", (4, 8))
@pytest.mark.parametrize("periods", (1.04, 1.8, 2.3, 5.3))
def test_dither_spreads_what_is_out_of_range(bits, periods):
    """A target beyond the laser period answers an earlier pulse, or falls into a wait. Before the
    first pulse, the laser did not wait.
    """
    timing = Timing(dither_bits=bits)
    flight_s = (periods * 8000 + 0.5) * timing.tick_s
    far = Light(
        rows=8,
        cols=8,
        distance_m=flight_s * SPEED_OF_LIGHT_M_S / 2,
        signal_per_pulse=5.0,
        system_fwhm_s=0.0,
    )
    edges = edges_of(far, timing)
    starts = np.concatenate([[0], np.cumsum(250 + waits_of(400, bits))]) * 32
    sent = np.concatenate([np.arange(-8, 0) * 8000, starts[:400]])
    arrives = sent + round(periods * 8000)
    pulse = np.searchsorted(starts, arrives, side="right") - 1
    inside = (pulse >= 0) & (pulse < 400)
    pulse = pulse[inside]
    tick = arrives[inside] - starts[pulse]
    expected = set(zip(pulse[tick < 8000].tolist(), tick[tick < 8000].tolist(), strict=True))
    assert len(expected) > 10
    assert set(zip(edges.pulse.tolist(), edges.tick.tolist(), strict=True)) == expected


def test_dither_parts_a_pulse_at_the_end_of_the_range():
    """Its late half comes in the wait and is lost, unless there is no wait."""
    timing = Timing(dither_bits=8)
    wall = Light(rows=8, cols=8, distance_m=timing.range_m, signal_per_pulse=0.5)
    expected = 0.5 * 64 * 400 * 0.5
    assert len(edges_of(wall, timing)) == pytest.approx(expected, rel=0.05)


def test_light_before_its_trigger_ends_the_period_before_it_unless_that_one_waits():
    """Its early half comes in the wait and is lost, or else in the period of the pulse before."""
    timing = Timing(dither_bits=1)
    edges = edges_of(Light(rows=8, cols=8, distance_m=1e-3, signal_per_pulse=0.5), timing)
    early = edges.pulse[edges.tick > timing.period_ticks / 2]
    followed = np.arange(399)
    assert np.unique(early[early < 399]).tolist() == followed[waits_of(400, 1)[:399] == 0].tolist()


def test_neither_chunks_nor_workers_change_the_edges():
    other = Interferer(photons_per_pulse=0.5, period_s=333e-9, phase_s=70e-9)
    scene = Light(
        rows=8, cols=8, distance_m=80.0, signal_per_pulse=0.3, background_cps=1e6, interferer=other
    )
    spad = Spad(afterpulse_probability=0.1, afterpulse_s=1e-6, crosstalk_probability=0.02)
    timing = Timing(dither_bits=4)
    whole = edges_of(scene, timing, spad)
    assert same(whole, edges_of(scene, timing, spad, workers=3))
    chunks = list(edge_chunks(scene, spad, timing, pulses=400, seed=1, chunk_pulses=37))
    assert np.array_equal(whole.tick, np.concatenate([chunk.tick for chunk in chunks]))


def test_bad_values():
    for make, words in (
        (lambda: Interferer(photons_per_pulse=1, period_s=0.0), "period_s = 0"),
        (lambda: Timing(dither_bits=17), "from 0 to 8"),
        (
            lambda: edges_of(dark(interferer=Interferer(photons_per_pulse=-1)), Timing()),
            "photons_per_pulse",
        ),
        (
            lambda: edges_of(dark(), Timing(dither_bits=1), pulses=1 << 25),
            "pulses = 33554432.*with a gap, dither or pauses",
        ),
    ):
        with pytest.raises(InputError, match=words):
            make()
