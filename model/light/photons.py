"""Photons to edges: a Monte Carlo of the SPAD array in continuous time, then TDC ticks.

Ref: paper II and IV (SPAD, laser pulse); the effects that the paper leaves out, and their order, are our choice.

Order of the effects, per pixel and laser pulse:

1. photons that would fire the SPAD: background and dark counts (uniform), signal (a Gaussian pulse around the time of
   flight, or around a time drawn from bins, modulo the laser period), another LiDAR's pulses, carriers trapped by earlier
   avalanches (afterpulses), photons from avalanches of neighbours (crosstalk);
2. SPAD gate: outside it nothing happens;
3. dead time, carried on from pulse to pulse: which photons become avalanches;
4. jitter of the avalanche's edge, modulo the laser period;
5. the TDC's taps: time to tick.

Every random number is a hash of (seed, pixel, pulse, purpose, counter), so neither chunks nor workers change the edges.
Crosstalk couples the pixels: a first pass finds the avalanches without it and draws what they send to their four
neighbours, a second pass walks all pixels again with the same photons and these. A crosstalk avalanche sends no
crosstalk of its own (probability squared: neglected).
"""

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from typing import NamedTuple

import numpy as np

from ..contract.edges import Edges
from ..shared.compiled import njit
from ..shared.constants import SIGMA_PER_FWHM, SPEED_OF_LIGHT_M_S
from ..shared.errors import InputError, check_integer
from ..shared.quantities import real_array
from .counter_random import exponential, key_of, normal, open_unit, uniform
from .light import SIGNAL_MAX, Interferer, Light
from .spad import Spad, SpadGate
from .timing import Timing

CHUNK_EDGES = 1 << 16  # edges made and sorted at a time: fits a core's cache
PULSES_MAX = 1 << 40
DITHERED_PULSES_MAX = 1 << 24  # whose starts are kept
CARRIERS_MAX = 32  # trapped carriers of a pixel that outlive their pulse; more are lost


def generate_edges(light: Light, spad: Spad, timing: Timing, **options) -> Edges:
    """All edges of `edge_chunks` in one: sorted by (pulse, tick, pixel). Same options, errors and bytes."""
    chunks = list(edge_chunks(light, spad, timing, **options))
    return Edges(*(np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in ("pulse", "pixel", "tick")))


def edge_chunks(
    light: Light,
    spad: Spad,
    timing: Timing,
    *,
    pulses: int,
    seed: int,
    pulse_start: int = 0,
    gate: SpadGate | None = None,
    workers: int = 1,
    chunk_pulses: int | None = None,
) -> Iterator[Edges]:
    """Edges of laser pulses from `pulse_start` on, in chunks of whole pulses, each sorted by (pulse, tick, pixel).

    All SPADs are ready at `pulse_start`; dead time and trapped carriers go on from chunk to chunk. `workers` threads
    share the pixels. Neither `workers` nor `chunk_pulses` (default: about `CHUNK_EDGES` edges) changes the edges;
    memory grows with the chunk only. Raises `InputError` for values out of range.
    """
    check_integer("pulses", pulses, 1, PULSES_MAX)
    check_integer("pulse_start", pulse_start, 0, PULSES_MAX)
    check_integer("seed", seed, 0, (1 << 64) - 1)
    check_integer("workers", workers, 1, 256)
    physics, arrays = _in_ticks(light, spad, timing, gate, pulse_start + pulses)
    edges_per_pulse = physics.edges_per_pulse(arrays)
    packing = _Packing((light.pixels - 1).bit_length(), (timing.period_ticks - 1).bit_length())
    if chunk_pulses is None:
        chunk_pulses = min(max(1, int(CHUNK_EDGES / (edges_per_pulse.sum() + 1e-9))), CHUNK_EDGES)
    check_integer("chunk_pulses", chunk_pulses, 1, 1 << min(31, 63 - sum(packing)), "of this array and period")
    blocks = [(light.pixels * i // workers, light.pixels * (i + 1) // workers) for i in range(workers)]
    walkers = [_Walker(physics, arrays, block, seed, packing, edges_per_pulse[slice(*block)].sum()) for block in blocks]
    return _chunks(walkers, range(pulse_start, pulse_start + pulses), chunk_pulses)


def _chunks(walkers: list["_Walker"], pulses: range, chunk_pulses: int) -> Iterator[Edges]:
    """For each chunk both passes over all blocks of pixels, then the order in time."""
    physics, packing = walkers[0].physics, walkers[0].packing
    with ThreadPoolExecutor(len(walkers)) as pool:
        for first in pulses[::chunk_pulses]:
            span = (first, min(chunk_pulses, pulses.stop - first))
            received = (np.empty(0, np.int64), np.empty(0))
            if physics.crosstalk > 0:
                sent = list(pool.map(_Walker.walk, walkers, repeat(span), repeat(received), repeat(True)))
                where, time = (np.concatenate([part[i] for part in sent]) for i in range(2))
                order = np.lexsort((time, where))
                received = where[order], time[order]
            made = pool.map(_Walker.walk, walkers, repeat(span), repeat(received), repeat(False))
            keys = np.concatenate([part[0] for part in made])
            keys.sort()
            yield Edges(*_unpacked(keys, first, packing))


class _Packing(NamedTuple):
    """An edge as one integer that sorts by (pulse, tick, pixel): the width of its lower fields."""

    pixel_bits: int
    tick_bits: int


class _Physics(NamedTuple):
    """Scalars of the walk; times in ticks."""

    period: float
    phases: int
    dead: float
    paralyzable: bool
    jitter: float
    tail_fraction: float
    tail: float
    afterpulse: float
    afterpulse_time: float
    crosstalk: float
    rows: int
    cols: int
    gate_every: int
    gate_steps: int
    frame_pulses: int
    other_period: float
    other_sigma: float
    bin_width: float

    def edges_per_pulse(self, arrays: "_Arrays") -> np.ndarray:
        """Expected edges of each pixel in a period, about (from above): sizes buffers and nothing else."""
        photons = arrays.noise + arrays.signal_per_pulse + arrays.other * self.others_per_pulse
        photons *= 1 + 2 * self.afterpulse + 4 * self.crosstalk
        return np.minimum(photons, self.period / self.dead + 1) if self.dead else photons

    @property
    def others_per_pulse(self) -> float:
        """Pulses of another LiDAR in a period, at most."""
        return self.period / self.other_period + 1 if self.other_period else 0.0


class _Arrays(NamedTuple):
    """Arrays of the walk: noise [pixels], signal [pixels, targets] in photons a period; the others in ticks.

    centre, sigma: [pixels, targets]; laps: whole periods of the flight, [pixels, targets]. bin_first: int64[pixels + 1], where
    the bins of a pixel are; bin_start: when they begin; bin_photons: of a pixel's bins up to and with each one. gate_start,
    gate_len, gate_step: [pixels]. taps: inner borders of the phases, empty = ideal. other, other_first: photons of another LiDAR's
    pulse, and when the first came, [pixels]. starts: of the pulses' periods, empty = one after the other.
    """

    noise: np.ndarray
    signal: np.ndarray
    centre: np.ndarray
    sigma: np.ndarray
    gate_start: np.ndarray
    gate_len: np.ndarray
    gate_step: np.ndarray
    taps: np.ndarray
    laps: np.ndarray
    bin_first: np.ndarray
    bin_start: np.ndarray
    bin_photons: np.ndarray
    other: np.ndarray
    other_first: np.ndarray
    starts: np.ndarray

    @property
    def signal_per_pulse(self) -> np.ndarray:
        """float64[pixels]: photons a period, of all targets and bins."""
        filled = np.diff(self.bin_first) > 0
        binned = np.zeros(len(filled))
        binned[filled] = self.bin_photons[self.bin_first[1:][filled] - 1]
        return self.signal.sum(axis=1) + binned


def _in_ticks(
    light: Light, spad: Spad, timing: Timing, gate: SpadGate | None, pulse_stop: int
) -> tuple[_Physics, _Arrays]:
    """Seconds, metres and rates to ticks and photons per period."""
    tick_s, period_ticks, pixels = timing.tick_s, timing.period_ticks, light.pixels
    rate_cps = light.background_cps + real_array("dark_cps", spad.dark_cps, (pixels,), 0)
    pulse_variance_s2 = light.system_fwhm_s**2 - spad.jitter_fwhm_s**2
    if np.any(pulse_variance_s2 < 0):
        narrowest = light.system_fwhm_s.min()
        raise InputError(f"system_fwhm_s = {narrowest:g}: must be at least the SPAD's {spad.jitter_fwhm_s:g}")
    flight_ticks = np.nan_to_num(2 * light.distance_m / SPEED_OF_LIGHT_M_S / tick_s)
    seen = ~np.isnan(light.distance_m) & (light.range_ambiguity | (flight_ticks < period_ticks))
    gate = gate or SpadGate(start_cycles=0, len_cycles=timing.period_cycles)
    gate_start, gate_len, gate_step = (
        real_array(name, getattr(gate, name), (pixels,), 0, timing.period_cycles) * timing.phases
        for name in ("start_cycles", "len_cycles", "step_cycles")
    )
    other = light.interferer or Interferer(photons_per_pulse=0.0)
    if timing.dither_bits:
        check_integer("pulses", pulse_stop, 0, DITHERED_PULSES_MAX, "with dither")
    physics = _Physics(
        period=float(period_ticks),
        phases=timing.phases,
        dead=spad.dead_time_s / tick_s,
        paralyzable=bool(spad.paralyzable),
        jitter=spad.jitter_fwhm_s * SIGMA_PER_FWHM / tick_s,
        tail_fraction=spad.jitter_tail_fraction,
        tail=spad.jitter_tail_s / tick_s,
        afterpulse=spad.afterpulse_probability,
        afterpulse_time=spad.afterpulse_s / tick_s,
        crosstalk=spad.crosstalk_probability,
        rows=light.rows,
        cols=light.cols,
        gate_every=gate.every_pulses,
        gate_steps=gate.steps,
        frame_pulses=gate.frame_pulses,
        other_period=other.period_s / tick_s if light.interferer else 0.0,
        other_sigma=other.fwhm_s * SIGMA_PER_FWHM / tick_s,
        bin_width=light.arrivals.width_s / tick_s if light.arrivals else 0.0,
    )
    bin_first, bin_start, bin_photons = _bins(light, tick_s, period_ticks)
    arrays = _Arrays(
        noise=rate_cps * timing.period_s,
        signal=np.where(seen, light.signal_per_pulse, 0.0),
        centre=flight_ticks % period_ticks,
        sigma=np.sqrt(pulse_variance_s2) * SIGMA_PER_FWHM / tick_s,
        gate_start=gate_start,
        gate_len=gate_len,
        gate_step=gate_step,
        taps=np.empty(0) if timing.tap_width_lsb is None else np.cumsum(timing.tap_width_lsb, dtype=np.float64)[:-1],
        laps=(flight_ticks // period_ticks).astype(np.int64),
        bin_first=bin_first,
        bin_start=bin_start,
        bin_photons=bin_photons,
        other=real_array("photons_per_pulse", other.photons_per_pulse, (pixels,), 0, SIGNAL_MAX),
        other_first=(other.phase_s + real_array("delay_s", other.delay_s, (pixels,), 0)) / tick_s,
        starts=timing.start_cycles(pulse_stop) * float(timing.phases) if timing.dither_bits else np.empty(0),
    )
    return physics, arrays


def _bins(light: Light, tick_s: float, period_ticks: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(bin_first, bin_start, bin_photons) of `_Arrays`."""
    if light.arrivals is None:
        return np.zeros(light.pixels + 1, np.int64), np.empty(0), np.empty(0)
    first, start, photons = light.arrivals.first, light.arrivals.start_s / tick_s, light.arrivals.photons
    if not light.range_ambiguity:
        photons = np.where(start < period_ticks, photons, 0.0)
    summed = np.concatenate([np.cumsum(photons[begin:end]) for begin, end in zip(first, first[1:])])
    return first, start, summed


class _Walker:
    """A block of pixels and what they carry from chunk to chunk, in the sending pass of crosstalk and in the last."""

    def __init__(self, physics, arrays, block, seed, packing, edges_per_pulse):
        self.physics, self.arrays, self.block, self.packing = physics, arrays, block, packing
        self.seed, self.edges_per_pulse = np.uint64(seed), edges_per_pulse
        brightest = (arrays.noise + arrays.signal_per_pulse + arrays.other * physics.others_per_pulse).max()
        self.photons_max = int(brightest + 12 * math.sqrt(brightest)) + 64  # exceeded about never: then doubled
        pixels = block[1] - block[0]
        fresh = np.zeros(pixels), np.full((pixels, CARRIERS_MAX if physics.afterpulse else 0), np.inf)
        self.state = {True: fresh, False: fresh}

    def walk(self, span, received, sending):
        """Packed edges, or (with `sending`) where crosstalk goes and when: int64[n] and float64[n]."""
        capacity = int(self.edges_per_pulse * span[1] * 1.1) + 1000
        while True:
            ready, carriers = (array.copy() for array in self.state[sending])
            keys, times, photons = np.empty(capacity, np.int64), np.empty(capacity), np.empty(self.photons_max)
            n = _walk(
                self.physics,
                self.arrays,
                self.block,
                self.seed,
                self.packing,
                span,
                received,
                sending,
                ready,
                carriers,
                photons,
                keys,
                times,
            )
            if n < 0:
                self.photons_max *= 2
            elif n > capacity:
                capacity = n
            else:
                self.state[sending] = ready, carriers
                return keys[:n], times[:n]


GAP, SOURCE, SHAPE, JITTER, TAIL_SHARE, TAIL, TRAP, RELEASE, CROSSTALK, OTHER, OTHER_SHAPE, IN_BIN = range(
    1, 13
)  # purposes
POISSON_MEAN_MAX = 64.0  # a brighter pixel's count is drawn in parts, each by inversion of its law
LAW_SIZE = 256
GAPS_FROM = 24.0  # photons of noise in a period from which on they come in order of time, by exponential gaps
INSERTION_MAX = 32  # other photons up to which insertion beats sorting


class _Source(NamedTuple):
    """A pixel's photons of noise, targets and bins, whose superposed Poisson processes are drawn as one. Photons in a period.

    noise: 0 for a bright pixel, whose noise comes in order of time. binned: of all its bins. mean: of all; it is drawn in equal `parts`.
    """

    noise: float
    noise_to_ticks: float
    bright: bool
    binned: float
    mean: float
    parts: int


@njit(error_model="numpy")
def _walk(physics, arrays, block, seed, packing, span, received, sending, ready, carriers, photons, keys, times):
    """Walks each pixel of the block through the pulses of the span.

    `photons` is scratch for those of one pixel and pulse, in ascending time. Returns the number of items made: all are
    in `keys` (with `sending`, also in `times`) if they fit. -1: `photons` is too small.
    """
    first_pulse, pulses = span
    received_where, received_time = received
    period, starts = physics.period, arrays.starts
    law, done = np.empty(LAW_SIZE), 0
    for pixel in range(block[0], block[1]):
        pixel_key, local = key_of(key_of(seed, 0), pixel), pixel - block[0]
        source = _source(pixel, period, arrays)
        _poisson_law(source.mean / source.parts, law)
        alive_at = ready[local]
        next_received = np.searchsorted(received_where, pixel << 32)
        for index in range(pulses):
            pulse = first_pulse + index
            key, n = key_of(pixel_key, pulse), 0
            begin = starts[pulse] if starts.size else pulse * period
            gap = starts[pulse + 1] - begin - period if starts.size else 0.0
            if source.bright:
                n = _draw_noise(key, source.noise_to_ticks, period, photons)
            count = _draw_count(key, source.parts, law)
            if n + count >= photons.size:
                return -1
            n = _draw_photons(key, count, n, pixel, pulse, source, physics, arrays, photons)
            if physics.other_period > 0:
                n = _draw_others(key, n, begin - arrays.other_first[pixel], arrays.other[pixel], physics, photons)
            if physics.afterpulse > 0:
                n = _release(n, carriers[local], period, photons)
            while next_received < received_where.size and received_where[next_received] == (pixel << 32) + index:
                n = _insert(photons, n, received_time[next_received])
                next_received += 1
            opens = arrays.gate_start[pixel]
            if physics.gate_every > 0:
                opens += arrays.gate_step[pixel] * _gate_step(pulse, physics)
            n, alive_at, done = _avalanches(
                key,
                n,
                pixel,
                index,
                opens,
                opens + arrays.gate_len[pixel],
                alive_at,
                done,
                physics,
                arrays.taps,
                packing,
                sending,
                carriers[local],
                photons,
                keys,
                times,
            )
            if n >= photons.size:
                return -1
            alive_at = max(alive_at - period - gap, 0.0)
            if gap > 0 and physics.afterpulse > 0:
                _lose(carriers[local], gap)
        ready[local] = alive_at
    return done


@njit(error_model="numpy")
def _source(pixel, period, arrays):
    noise, signal = arrays.noise[pixel], arrays.signal[pixel].sum()
    first_bin, end_bin = arrays.bin_first[pixel], arrays.bin_first[pixel + 1]
    noise_to_ticks, bright = period / noise, noise > GAPS_FROM
    if bright:
        noise = 0.0
    binned = arrays.bin_photons[end_bin - 1] if end_bin > first_bin else 0.0
    mean = noise + signal + binned
    return _Source(noise, noise_to_ticks, bright, binned, mean, int(mean / POISSON_MEAN_MAX) + 1)


@njit(inline="always")
def _draw_noise(key, noise_to_ticks, period, photons):
    """A bright pixel's noise in order of time, by exponential gaps: into `photons`. Returns how many."""
    n, t = 0, exponential(key, GAP, 0) * noise_to_ticks
    while t < period and n < photons.size:
        photons[n] = t
        n += 1
        t += exponential(key, GAP, n) * noise_to_ticks
    return n


@njit(inline="always")
def _draw_count(key, parts, law):
    """A Poisson number, the sum of `parts` of the same law."""
    count = 0
    for part in range(parts):
        u, k = open_unit(key_of(key, part) if part else key), 0
        while u > law[k]:
            k += 1
        count += k
    return count


@njit(inline="always")
def _draw_photons(key, count, n, pixel, pulse, source, physics, arrays, photons):
    """Adds `count` photons of `source`, each of its own origin and time, to the ascending photons[:n]. Returns the new n."""
    for i in range(count):
        mark = uniform(key, SOURCE, i) * source.mean
        if mark < source.noise:
            t = mark * source.noise_to_ticks
        else:
            t = _arrival(key, i, mark - source.noise, source.binned, pixel, pulse, physics, arrays)
        if t < 0:
            continue
        if count <= INSERTION_MAX:
            n = _insert(photons, n, t)
        else:
            photons[n] = t
            n += 1
    if count > INSERTION_MAX:
        photons[:n].sort()
    return n


@njit(inline="always")
def _arrival(key, i, mark, binned, pixel, pulse, physics, arrays):
    """When photon `i` comes, which is the target's or bin's that `mark` falls into; negative: in no period, for a gap before this one."""
    period, signal, starts = physics.period, arrays.signal, arrays.starts
    target, last_target = 0, signal.shape[1] - 1
    while target < last_target and mark >= signal[pixel, target]:
        mark -= signal[pixel, target]
        target += 1
    begins, lap = arrays.centre[pixel, target], arrays.laps[pixel, target]
    if binned > 0 and mark >= signal[pixel, target]:
        mark -= signal[pixel, target]
        target = 0
        first_bin, last_bin = arrays.bin_first[pixel], arrays.bin_first[pixel + 1] - 1
        chosen = first_bin + np.searchsorted(arrays.bin_photons[first_bin:last_bin], mark, side="right")
        begins = arrays.bin_start[chosen] + physics.bin_width * uniform(key, IN_BIN, i)
        lap = np.int64(begins // period)
        begins -= lap * period
    t = begins + arrays.sigma[pixel, target] * normal(key, SHAPE, i)
    if starts.size and lap:  # of an earlier pulse, whose distance in time varies
        emitted = max(pulse - lap, 0)
        t += (pulse - emitted) * period - (starts[pulse] - starts[emitted])
        if not 0 <= t < period:
            return -1.0
    return _modulo(t, period)


@njit(inline="always")
def _draw_others(key, n, since, mean, physics, photons):
    """Adds photons of another LiDAR's pulses, of which the first came `since` ticks ago: `mean` per pulse. Returns the new n."""
    drawn = 0
    t = -_modulo(since, physics.other_period)  # the last pulse before the period: its tail
    while t < physics.period:
        sum_of_gaps = exponential(key, OTHER, drawn)
        while sum_of_gaps < mean:
            at = t + physics.other_sigma * normal(key, OTHER_SHAPE, drawn)
            if 0 <= at < physics.period:
                n = _insert(photons, n, at)
            drawn += 1
            sum_of_gaps += exponential(key, OTHER, drawn)
        drawn += 1
        t += physics.other_period
    return n


@njit(inline="always")
def _release(n, carriers, period, photons):
    """Adds what trapped carriers release in this period; the others wait a period less. Returns the new n."""
    for slot in range(CARRIERS_MAX):
        if carriers[slot] < period:
            n = _insert(photons, n, carriers[slot])
            carriers[slot] = np.inf
        carriers[slot] -= period
    return n


@njit(inline="always")
def _lose(carriers, gap):
    """Carriers that are released in the gap between two periods are lost."""
    for slot in range(CARRIERS_MAX):
        carriers[slot] -= gap
        if carriers[slot] < 0:
            carriers[slot] = np.inf


@njit(inline="always")
def _gate_step(pulse, physics):
    """How many steps progressive gating has gone."""
    return pulse % physics.frame_pulses // physics.gate_every % physics.gate_steps


@njit(inline="always")
def _avalanches(
    key, n, pixel, index, opens, closes, alive_at, done, physics, taps, packing, sending, carriers, photons, keys, times
):
    """Photons to avalanches by gate and dead time, and these to edges, or (with `sending`) to crosstalk; afterpulses join the photons.

    Returns the new n, the time from which the SPAD is alive, and the number of items made.
    """
    i, fired = 0, 0
    while i < n:
        t = photons[i]
        i += 1
        if t < opens or t >= closes:
            continue
        alive = t >= alive_at
        if alive or physics.paralyzable:
            alive_at = t + physics.dead
        if not alive:
            continue
        if physics.afterpulse > 0 and uniform(key, TRAP, fired) < physics.afterpulse:
            released = t + physics.afterpulse_time * exponential(key, RELEASE, fired)
            if released < physics.period:
                n = _insert(photons, n, released)
            else:
                carriers[np.argmax(carriers)] = released - physics.period  # a free slot is infinite
        if sending:
            done = _send(key, fired, t, pixel, index, done, physics, keys, times)
        else:
            if done < keys.size:
                tick = _tick(_modulo(_with_jitter(key, fired, t, physics), physics.period), physics, taps)
                keys[done] = (((index << packing[1]) + tick) << packing[0]) + pixel
            done += 1
        fired += 1
    return n, alive_at, done


@njit(inline="always")
def _send(key, fired, t, pixel, index, done, physics, keys, times):
    """Crosstalk of an avalanche: the neighbours that it reaches. Returns the number of items made."""
    for side in range(4):
        neighbour = _neighbour(pixel, side, physics.rows, physics.cols)
        if neighbour >= 0 and uniform(key, CROSSTALK, 4 * fired + side) < physics.crosstalk:
            if done < keys.size:
                keys[done], times[done] = (neighbour << 32) + index, t
            done += 1
    return done


@njit(inline="always")
def _with_jitter(key, fired, t, physics):
    """Time of an avalanche's edge."""
    if physics.jitter > 0:
        t += physics.jitter * normal(key, JITTER, fired)
    if physics.tail_fraction > 0 and uniform(key, TAIL_SHARE, fired) < physics.tail_fraction:
        t += physics.tail * exponential(key, TAIL, fired)
    return t


@njit
def _poisson_law(mean, law):
    """Fills law[k] with the chance of at most k, up to where it is 1 in float64."""
    chance = math.exp(-mean)
    law[0], last = chance, 0
    while last < law.size - 1 and (chance > 1e-18 or last < mean):
        last += 1
        chance *= mean / last
        law[last] = law[last - 1] + chance
    law[last] = 1.0


@njit(inline="always")
def _insert(photons, n, t):
    """Puts `t` into the ascending photons[:n] (a full one loses it) and returns n + 1, at most the size."""
    if n == photons.size:
        return n
    i = n
    while i > 0 and photons[i - 1] > t:
        photons[i] = photons[i - 1]
        i -= 1
    photons[i] = t
    return n + 1


@njit(inline="always")
def _modulo(t, period):
    """`t` in [0, period]; the division is rarely needed."""
    return t if 0.0 <= t < period else t - period * np.floor(t / period)


@njit(inline="always")
def _tick(t, physics, taps):
    """TDC code of time `t` in ticks; `taps`: the inner borders of the phases, empty = ideal."""
    if taps.size:
        cycle = np.floor(t / physics.phases)
        t = cycle * physics.phases + np.searchsorted(taps, t - cycle * physics.phases, side="right")
    return min(np.int64(t), np.int64(physics.period) - 1)


@njit(inline="always")
def _neighbour(pixel, side, rows, cols):
    """Pixel above, left, right or below; -1 beyond the array."""
    row, col = pixel // cols + (side == 3) - (side == 0), pixel % cols + (side == 2) - (side == 1)
    return row * cols + col if 0 <= row < rows and 0 <= col < cols else -1


@njit
def _unpacked(keys, first_pulse, packing):
    """(pulse, pixel, tick) of packed edges."""
    pixel_bits, tick_bits = packing
    pulse, pixel, tick = np.empty_like(keys), np.empty_like(keys), np.empty_like(keys)
    for i, key in enumerate(keys):
        pulse[i] = first_pulse + (key >> (pixel_bits + tick_bits))
        pixel[i] = key & ((1 << pixel_bits) - 1)
        tick[i] = key >> pixel_bits & ((1 << tick_bits) - 1)
    return pulse, pixel, tick
