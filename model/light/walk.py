# SPDX-License-Identifier: Apache-2.0
"""The photon walk: takes each pixel through its laser pulses, from photons to avalanches to edges.

The code is compiled; `photons.py` describes it and calls it. Times are in ticks from the start of a
pulse's period.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ..shared.compiled import njit, part
from ..shared.interpolation import interpolated
from .counter_random import exponential, key_of, normal, open_unit, uniform

CARRIERS_MAX = 32  # trapped carriers per pixel that outlive their pulse; further ones are lost
# Purposes of random numbers.
GAP = 1
SOURCE = 2
SHAPE = 3
JITTER = 4
TAIL_SHARE = 5
TAIL = 6
TRAP = 7
RELEASE = 8
CROSSTALK = 9
OTHER = 10
OTHER_SHAPE = 11
IN_BIN = 12
POISSON_MEAN_MAX = 64.0  # for a brighter pixel, the count is drawn in parts, each by its own law
LAW_SIZE = 256
GAPS_FROM = 24.0  # noise photons per period above which they are drawn by exponential gaps
INSERTION_MAX = 32  # number of other photons up to which insertion is faster than sorting
_PIXEL_LSB = 32  # of the pixel in `Received.where`; the pulse stands below it


class Packing(NamedTuple):
    """Widths of the lower fields of an edge that is packed into one integer.

    The integers sort by (pulse, tick, pixel).
    """

    pixel_bits: int
    tick_bits: int


class Physics(NamedTuple):
    """Scalars of the walk; times in ticks."""

    period_ticks: float
    spacing_ticks: float  # from a period to the next one, without dither
    phases: int
    dead: float  # time from an avalanche until the SPAD is alive again
    paralyzable: bool  # a photon within the dead time extends it
    jitter: float  # sigma of an edge
    tail_fraction: float  # share of the edges that are late by an additional, exponential time
    tail: float  # mean of that time
    afterpulse: float  # probability that an avalanche traps a carrier
    afterpulse_time: float  # mean time to its release
    crosstalk: float  # probability that an avalanche sends a photon to one given neighbour
    rows: int
    cols: int
    gate_every: int  # pulses per step of progressive gating, 0: none
    gate_steps: int
    frame_pulses: int  # after which progressive gating starts again
    other_period_ticks: float  # laser period of another LiDAR, 0 without one
    other_sigma: float  # of its pulse
    other_reach: float  # of its light, from the centre of its pulse on, before and after it
    bin_width: float  # of signal in bins


class Arrays(NamedTuple):
    """Arrays of the walk, float64 if no other type is given; times in ticks."""

    noise: np.ndarray  # [pixels], photons per period
    signal: np.ndarray  # [pixels, targets], photons per period
    centre: np.ndarray  # [pixels, targets], of the pulse, from the beginning of a period on
    sigma: np.ndarray  # [pixels, targets], of the pulse
    gate_start: np.ndarray  # [pixels]
    gate_len: np.ndarray  # [pixels]
    gate_step: np.ndarray  # [pixels], of progressive gating
    taps: np.ndarray  # inner borders of the TDC's phases, empty if they are ideal
    laps: np.ndarray  # int64[pixels, targets], whole periods of the flight, with their gaps
    bin_first: np.ndarray  # int64[pixels + 1], first of the pixel's bins; the next pixel's follow
    bin_start: np.ndarray  # [bins], beginning of each
    bin_photons: np.ndarray  # [bins], sum of the photons of the pixel's bins up to it
    other: np.ndarray  # [pixels], photons of another LiDAR's pulse
    other_first: np.ndarray  # [pixels], time of the first such pulse
    starts: np.ndarray  # of the pulses' periods, empty if they are back to back
    shape: np.ndarray  # times of a measured pulse, ascending; empty: a Gaussian of `sigma`
    shape_share: np.ndarray  # share of that pulse before each of these times


class Received(NamedTuple):
    """Photons of crosstalk, in the order of pixel, pulse and time."""

    where: np.ndarray  # int64[n], pixel and number of the pulse in the span: see `_PIXEL_LSB`
    time: np.ndarray  # float64[n], ticks


class Course(NamedTuple):
    """What a walk reads: the light and the detector, and which pixels go through which pulses."""

    physics: Physics
    arrays: Arrays
    seed: np.uint64
    first_pixel: int
    end_pixel: int
    first_pulse: int
    pulses: int
    received: Received


class State(NamedTuple):
    """State of the walk's pixels between two spans of pulses.

    Times are in ticks from the start of the next period.
    """

    alive_at: np.ndarray  # float64[pixels], time from which each is alive
    carriers: np.ndarray  # float64[pixels, CARRIERS_MAX], when they are released; infinite: none


class Scratch(NamedTuple):
    """Workspace of a walk."""

    law: np.ndarray  # float64[LAW_SIZE], of a pixel's number of photons
    photons: np.ndarray  # float64[n], those of a pixel and pulse, by ascending time


class Made(NamedTuple):
    """Room for what a walk makes: packed edges or, with `sending`, crosstalk."""

    packing: Packing
    sending: bool
    keys: np.ndarray  # int64[n], packed edges, or where the crosstalk goes (`Received.where`)
    times: np.ndarray  # float64[n], of the crosstalk


class _Source(NamedTuple):
    """A pixel's photons of noise, targets and bins, drawn as one superposed Poisson process.

    Numbers are photons per period.
    """

    noise: float  # 0 for a bright pixel, whose noise is drawn in the order of time
    noise_to_ticks: float
    bright: bool
    binned: float  # photons of all its bins
    mean: float  # of all sources
    parts: int  # equal parts in which the mean is drawn


class _At(NamedTuple):
    """A pixel and pulse of the walk."""

    key: np.uint64  # of its random numbers
    pixel: int
    number: int  # of the pulse in the span


class _Gate(NamedTuple):
    """When a pixel's gate is open in a pulse, in ticks."""

    opens: float
    closes: float


class _Progress(NamedTuple):
    """Where a pixel and pulse of the walk stand."""

    n: int  # photons
    alive_at: float  # time from which the SPAD is alive
    done: int  # items made


@njit(allocates=False, error_model="numpy")
def walk(course: Course, state: State, scratch: Scratch, made: Made) -> int:
    """Walk each pixel through the pulses; return the number of items made, or -1.

    made: has all items if they fit. -1: there are more photons than the scratch holds.
    """
    physics = course.physics
    arrays = course.arrays
    received = course.received
    photons = scratch.photons
    period_ticks = physics.period_ticks
    starts = arrays.starts
    taps = arrays.taps
    done = 0
    for pixel in range(course.first_pixel, course.end_pixel):
        pixel_key = key_of(key_of(course.seed, 0), pixel)
        local = pixel - course.first_pixel
        source = _source(pixel, period_ticks, arrays)
        _poisson_law(source.mean / source.parts, scratch.law)
        alive_at = state.alive_at[local]
        trapped = state.carriers[local]
        next_received = _number_up_to(received.where, (pixel << _PIXEL_LSB) - 1)
        for index in range(course.pulses):
            pulse = course.first_pulse + index
            key = key_of(pixel_key, pulse)
            at = _At(key, pixel, index)
            begin = pulse * period_ticks
            gap = 0.0
            if starts.size:
                begin = starts[pulse]
                gap = starts[pulse + 1] - begin - period_ticks
            n = 0
            if source.bright:
                n = _draw_noise(key, source.noise_to_ticks, period_ticks, photons)
            count = _draw_count(key, source.parts, scratch.law)
            if n + count >= photons.size:
                return -1
            n = _draw_photons(at, count, n, pulse, source, physics, arrays, photons)
            if count > INSERTION_MAX:
                _sort(photons, n)
            if physics.other_period_ticks > 0:
                since = begin - arrays.other_first[pixel]
                n = _draw_others(key, n, since, arrays.other[pixel], physics, photons)
            if physics.afterpulse > 0:
                n = _release(n, trapped, period_ticks, photons)
            here = (pixel << _PIXEL_LSB) + index
            while next_received < received.where.size and received.where[next_received] == here:
                n = _insert(photons, n, received.time[next_received])
                next_received += 1
            opens = _gate_opens(pixel, pulse, physics, arrays)
            gate = _Gate(opens, opens + arrays.gate_len[pixel])
            progress = _Progress(n, alive_at, done)
            progress = _avalanches(progress, at, gate, physics, taps, trapped, photons, made)
            if progress.n >= photons.size:
                return -1
            done = progress.done
            alive_at = max(progress.alive_at - period_ticks - gap, 0.0)
            if gap > 0 and physics.afterpulse > 0:
                _lose(trapped, gap)
        state.alive_at[local] = alive_at
    return done


@part(error_model="numpy")
def _source(pixel: int, period_ticks: float, arrays: Arrays) -> _Source:
    """Return the source of a pixel's photons."""
    noise = arrays.noise[pixel]
    signal = 0.0
    for target in range(arrays.signal.shape[1]):
        signal += arrays.signal[pixel, target]
    noise_to_ticks = period_ticks / noise
    bright = noise > GAPS_FROM
    if bright:
        noise = 0.0
    binned = 0.0
    end_bin = arrays.bin_first[pixel + 1]
    if end_bin > arrays.bin_first[pixel]:
        binned = arrays.bin_photons[end_bin - 1]
    mean = noise + signal + binned
    parts = int(mean / POISSON_MEAN_MAX) + 1
    return _Source(noise, noise_to_ticks, bright, binned, mean, parts)


@part(error_model="numpy")
def _draw_noise(
    key: np.uint64, noise_to_ticks: float, period_ticks: float, photons: np.ndarray
) -> int:
    """Write a bright pixel's noise to `photons` in the order of time, by exponential gaps.

    Return its number.
    """
    n = 0
    t = exponential(key, GAP, 0) * noise_to_ticks
    while t < period_ticks and n < photons.size:
        photons[n] = t
        n += 1
        t += exponential(key, GAP, n) * noise_to_ticks
    return n


@part
def _draw_count(key: np.uint64, parts: int, law: np.ndarray) -> int:
    """Return a Poisson number, the sum of `parts` of the same law."""
    count = 0
    for k in range(parts):
        u = open_unit(key_of(key, k) if k else key)
        number = 0
        while u > law[number]:
            number += 1
        count += number
    return count


@part(error_model="numpy")
def _draw_photons(
    at: _At,
    count: int,
    n: int,
    pulse: int,
    source: _Source,
    physics: Physics,
    arrays: Arrays,
    photons: np.ndarray,
) -> int:
    """Add `count` photons of `source`, with random origins and times, to the ascending photons[:n].

    Return the new n.
    """
    for i in range(count):
        mark = uniform(at.key, SOURCE, i) * source.mean
        if mark < source.noise:
            t = mark * source.noise_to_ticks
        else:
            t = _arrival(at, i, mark - source.noise, source.binned, pulse, physics, arrays)
        if t < 0:
            continue
        if count <= INSERTION_MAX:
            n = _insert(photons, n, t)
        else:
            photons[n] = t
            n += 1
    return n


@part(error_model="numpy")
def _arrival(
    at: _At, i: int, mark: float, binned: float, pulse: int, physics: Physics, arrays: Arrays
) -> float:
    """Return the arrival of photon `i`, of the target or bin to which `mark` belongs.

    Negative: in the wait before the period.
    """
    period_ticks = physics.period_ticks
    pixel = at.pixel
    target = 0
    last_target = arrays.signal.shape[1] - 1
    while target < last_target and mark >= arrays.signal[pixel, target]:
        mark -= arrays.signal[pixel, target]
        target += 1
    begins = arrays.centre[pixel, target]
    lap = arrays.laps[pixel, target]
    if binned > 0 and mark >= arrays.signal[pixel, target]:
        mark -= arrays.signal[pixel, target]
        target = 0
        begins = _start_in_bin(at, i, mark, physics, arrays)
        lap = np.int64(begins // physics.spacing_ticks)
        begins -= lap * physics.spacing_ticks
    if arrays.shape.size:
        t = begins + interpolated(uniform(at.key, SHAPE, i), arrays.shape_share, arrays.shape)
    else:
        t = begins + arrays.sigma[pixel, target] * normal(at.key, SHAPE, i)
    if arrays.starts.size:
        return _from_any_pulse(t, pulse, lap, physics, arrays)
    return _modulo(t, period_ticks)


@part(error_model="numpy")
def _from_any_pulse(t: float, pulse: int, lap: int, physics: Physics, arrays: Arrays) -> float:
    """Return the arrival of light that comes `lap` regular spacings and `t` after its own pulse.

    Pulses are at least a period apart, so at most one of them sends such light into this period; it
    may be the next one, if its light begins before its trigger. Negative: none does.
    """
    emitted = pulse - lap
    waited = arrays.starts[pulse] - _start(emitted, physics, arrays)
    t += lap * physics.spacing_ticks - waited
    while t < 0 and emitted <= pulse:
        t += _start(emitted + 1, physics, arrays) - _start(emitted, physics, arrays)
        emitted += 1
    while t >= physics.period_ticks:
        t -= _start(emitted, physics, arrays) - _start(emitted - 1, physics, arrays)
        emitted -= 1
    return t


@part(error_model="numpy")
def _start(pulse: int, physics: Physics, arrays: Arrays) -> float:
    """Return the start of a pulse's period; before the first one, the laser ran without waits."""
    return arrays.starts[pulse] if pulse >= 0 else pulse * physics.spacing_ticks


@part(error_model="numpy")
def _start_in_bin(at: _At, i: int, mark: float, physics: Physics, arrays: Arrays) -> float:
    """Return a random time in the pixel's bin to which `mark` belongs."""
    first_bin = arrays.bin_first[at.pixel]
    last_bin = arrays.bin_first[at.pixel + 1] - 1
    chosen = first_bin + _number_up_to(arrays.bin_photons[first_bin:last_bin], mark)
    return arrays.bin_start[chosen] + physics.bin_width * uniform(at.key, IN_BIN, i)


@part(error_model="numpy")
def _draw_others(
    key: np.uint64, n: int, since: float, mean: float, physics: Physics, photons: np.ndarray
) -> int:
    """Add `mean` photons per pulse of another LiDAR, whose first pulse came `since` ticks ago.

    Return the new n.
    """
    drawn = 0
    t = -_modulo(since, physics.other_period_ticks)
    while t > -physics.other_reach:  # pulses before the period, which still send late light into it
        t -= physics.other_period_ticks
    while t < physics.period_ticks + physics.other_reach:  # and those after it, early light
        sum_of_gaps = exponential(key, OTHER, drawn)
        while sum_of_gaps < mean:
            arrives = t + physics.other_sigma * normal(key, OTHER_SHAPE, drawn)
            if 0 <= arrives < physics.period_ticks:
                n = _insert(photons, n, arrives)
            drawn += 1
            sum_of_gaps += exponential(key, OTHER, drawn)
        drawn += 1
        t += physics.other_period_ticks
    return n


@part
def _release(n: int, carriers: np.ndarray, period_ticks: float, photons: np.ndarray) -> int:
    """Add the photons of carriers that are released in this period.

    The others wait for the next; return the new n.
    """
    for slot in range(CARRIERS_MAX):
        if carriers[slot] < period_ticks:
            n = _insert(photons, n, carriers[slot])
            carriers[slot] = np.inf
        carriers[slot] -= period_ticks
    return n


@part
def _lose(carriers: np.ndarray, gap: float) -> None:
    """Drop the carriers that are released in the gap between two periods."""
    for slot in range(CARRIERS_MAX):
        carriers[slot] -= gap
        if carriers[slot] < 0:
            carriers[slot] = np.inf


@part(error_model="numpy")
def _gate_opens(pixel: int, pulse: int, physics: Physics, arrays: Arrays) -> float:
    """Return the time at which a pixel's gate opens in a pulse."""
    opens = arrays.gate_start[pixel]
    if physics.gate_every > 0:
        moved = pulse % physics.frame_pulses // physics.gate_every % physics.gate_steps
        opens += arrays.gate_step[pixel] * moved
    return opens


@part
def _avalanches(
    progress: _Progress,
    at: _At,
    gate: _Gate,
    physics: Physics,
    taps: np.ndarray,
    carriers: np.ndarray,
    photons: np.ndarray,
    made: Made,
) -> _Progress:
    """Turn photons into avalanches by gate and dead time, and these into items.

    Items are edges or, with `sending`, crosstalk. Afterpulses join the photons. Returns the new
    progress.
    """
    n = progress.n
    alive_at = progress.alive_at
    done = progress.done
    i = 0
    fired = 0
    while i < n:
        t = photons[i]
        i += 1
        if t < gate.opens or t >= gate.closes:
            continue
        alive = t >= alive_at
        if alive or physics.paralyzable:
            alive_at = t + physics.dead
        if not alive:
            continue
        if physics.afterpulse > 0 and uniform(at.key, TRAP, fired) < physics.afterpulse:
            released = t + physics.afterpulse_time * exponential(at.key, RELEASE, fired)
            if released < physics.period_ticks:
                n = _insert(photons, n, released)
            else:
                carriers[_free_slot(carriers)] = released - physics.period_ticks
        if made.sending:
            done = _send(at, fired, t, done, physics, made)
        else:
            done = _edge(at, fired, t, done, physics, taps, made)
        fired += 1
    return _Progress(n, alive_at, done)


@part
def _free_slot(carriers: np.ndarray) -> int:
    """Return the slot with the latest release: a free one is infinite."""
    latest = 0
    for slot in range(1, len(carriers)):
        if carriers[slot] > carriers[latest]:
            latest = slot
    return latest


@part
def _edge(
    at: _At, fired: int, t: float, done: int, physics: Physics, taps: np.ndarray, made: Made
) -> int:
    """Write the packed edge of an avalanche; return the number of items made."""
    if done < made.keys.size:
        time = _modulo(_with_jitter(at.key, fired, t, physics), physics.period_ticks)
        tick = _tick(time, physics, taps)
        packing = made.packing
        time_key = (at.number << packing.tick_bits) + tick
        made.keys[done] = (time_key << packing.pixel_bits) + at.pixel
    return done + 1


@part
def _send(at: _At, fired: int, t: float, done: int, physics: Physics, made: Made) -> int:
    """Send the crosstalk of an avalanche to the neighbours that it reaches.

    Return the number of items made.
    """
    key = at.key
    for side in range(4):
        neighbour = _neighbour(at.pixel, side, physics.rows, physics.cols)
        if neighbour >= 0 and uniform(key, CROSSTALK, 4 * fired + side) < physics.crosstalk:
            if done < made.keys.size:
                made.keys[done] = (neighbour << _PIXEL_LSB) + at.number
                made.times[done] = t
            done += 1
    return done


@part
def _with_jitter(key: np.uint64, fired: int, t: float, physics: Physics) -> float:
    """Return the time of an avalanche's edge."""
    if physics.jitter > 0:
        t += physics.jitter * normal(key, JITTER, fired)
    if physics.tail_fraction > 0 and uniform(key, TAIL_SHARE, fired) < physics.tail_fraction:
        t += physics.tail * exponential(key, TAIL, fired)
    return t


@part(inlined=False)
def _sort(photons: np.ndarray, n: int) -> None:
    """Sort photons[:n] (Shell, with Ciura's gaps)."""
    for gap in (701, 301, 132, 57, 23, 10, 4, 1):
        for i in range(gap, n):
            t = photons[i]
            k = i
            while k >= gap and photons[k - gap] > t:
                photons[k] = photons[k - gap]
                k -= gap
            photons[k] = t


@part(inlined=False, error_model="numpy")
def _poisson_law(mean: float, law: np.ndarray) -> None:
    """Fill law[k] with the probability of at most k, until it is 1 in float64."""
    chance = math.exp(-mean)
    law[0] = chance
    last = 0
    while last < law.size - 1 and (chance > 1e-18 or last < mean):
        last += 1
        chance *= mean / last
        law[last] = law[last - 1] + chance
    law[last] = 1.0


@part
def _number_up_to(ascending: np.ndarray, value: float) -> int:
    """Return how many of some ascending values are at most `value`."""
    low = 0
    high = ascending.size
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] <= value:
            low = middle + 1
        else:
            high = middle
    return low


@part
def _insert(photons: np.ndarray, n: int, t: float) -> int:
    """Insert `t` into the ascending photons[:n] (dropped if they are full) and return n + 1, or the
    size if less.
    """
    if n == photons.size:
        return n
    i = n
    while i > 0 and photons[i - 1] > t:
        photons[i] = photons[i - 1]
        i -= 1
    photons[i] = t
    return n + 1


@part(error_model="numpy")
def _modulo(t: float, period_ticks: float) -> float:
    """Return `t` moved into [0, period_ticks]; the division is rarely needed."""
    return t if 0.0 <= t < period_ticks else t - period_ticks * np.floor(t / period_ticks)


@part(error_model="numpy")
def _tick(t: float, physics: Physics, taps: np.ndarray) -> Any:
    """Return the TDC code of time `t` in ticks.

    `taps`: the inner borders of the phases, empty = ideal.
    """
    if taps.size:
        begins = np.floor(t / physics.phases) * physics.phases  # the cycle
        t = begins + _number_up_to(taps, t - begins)
    return min(np.int64(t), np.int64(physics.period_ticks) - 1)


@part(error_model="numpy")
def _neighbour(pixel: int, side: int, rows: int, cols: int) -> int:
    """Return the pixel above, left, right or below; -1 beyond the array."""
    row = pixel // cols + (side == 3) - (side == 0)
    col = pixel % cols + (side == 2) - (side == 1)
    return row * cols + col if 0 <= row < rows and 0 <= col < cols else -1


@njit
def unpacked(
    keys: np.ndarray, first_pulse: int, packing: Packing
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (pulse, pixel, tick) of packed edges."""
    pulse = np.empty(len(keys), np.int64)
    pixel = np.empty(len(keys), np.int64)
    tick = np.empty(len(keys), np.int64)
    for i in range(len(keys)):
        key = keys[i]
        pulse[i] = first_pulse + (key >> (packing.pixel_bits + packing.tick_bits))
        pixel[i] = key & ((1 << packing.pixel_bits) - 1)
        tick[i] = key >> packing.pixel_bits & ((1 << packing.tick_bits) - 1)
    return pulse, pixel, tick
