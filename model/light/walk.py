# SPDX-License-Identifier: Apache-2.0
"""The photon walk: takes each pixel through its laser pulses, from photons to avalanches to edges.

The code is compiled; `photons.py` describes it and calls it. Times are in ticks from the start of a pulse's period.
"""

import math
from collections import namedtuple

import numpy as np

from ..shared.compiled import njit
from .counter_random import exponential, key_of, normal, open_unit, uniform

CARRIERS_MAX = 32  # trapped carriers per pixel that outlive their pulse; further ones are lost
# Purposes of random numbers.
GAP, SOURCE, SHAPE, JITTER, TAIL_SHARE, TAIL, TRAP, RELEASE, CROSSTALK, OTHER, OTHER_SHAPE, IN_BIN = range(1, 13)
POISSON_MEAN_MAX = 64.0  # for a brighter pixel, the count is drawn in parts, each by inversion of its law
LAW_SIZE = 256
GAPS_FROM = 24.0  # noise photons per period above which they are drawn in the order of time, by exponential gaps
INSERTION_MAX = 32  # number of other photons up to which insertion is faster than sorting


# Widths of the lower fields of an edge that is packed into one integer, which sorts by (pulse, tick, pixel).
Packing = namedtuple("Packing", "pixel_bits tick_bits")
# Room for what a walk makes: packed edges (keys) or, with `sending`, the crosstalk's targets (keys) and times.
Made = namedtuple("Made", "packing sending keys times")
# Scalars of the walk; times in ticks. other_period_ticks: laser period of another LiDAR, 0 without one.
Physics = namedtuple(
    "Physics",
    "period_ticks phases dead paralyzable jitter tail_fraction tail afterpulse afterpulse_time crosstalk rows cols gate_every"
    " gate_steps frame_pulses other_period_ticks other_sigma bin_width",
)
# Arrays of the walk; times in ticks. By pixel: noise in photons per period; gate_start, gate_len, gate_step; other and
# other_first, the photons of another LiDAR's pulse and the time of the first one. By pixel and target: signal in photons per
# period, centre, sigma, and laps, the whole periods of the flight. Pixel p has the bins bin_first[p] to bin_first[p + 1];
# bin_start is the beginning of each, and bin_photons the sum of the photons of the pixel's bins up to it. taps: inner borders
# of the phases, empty if they are ideal. starts: of the pulses' periods, empty if they are back to back.
Arrays = namedtuple(
    "Arrays",
    "noise signal centre sigma gate_start gate_len gate_step taps laps bin_first bin_start bin_photons other other_first starts",
)


# A pixel's photons of noise, targets and bins, drawn as one superposed Poisson process; photons per period. noise: 0 for a
# bright pixel, whose noise is drawn in the order of time. binned: photons of all its bins. mean: of all sources; it is drawn
# in equal `parts`.
_Source = namedtuple("_Source", "noise noise_to_ticks bright binned mean parts")


@njit(allocates=False, error_model="numpy")
def walk(physics, arrays, block, seed, span, received, state, scratch, made):
    """Walk each pixel of the block through the pulses of the span; return the number of items made, or -1.

    state: time from which each pixel is alive, and its carriers. scratch: for the law of a count, and for the photons of
    a pixel and pulse in ascending time. made: has all items if they fit. -1: there are more photons than the scratch
    holds.
    """
    first_pulse, pulses = span
    (ready, carriers), (law, photons) = state, scratch
    received_where, received_time = received
    period_ticks, starts = physics.period_ticks, arrays.starts
    done = 0
    for pixel in range(block[0], block[1]):
        pixel_key, local = key_of(key_of(seed, 0), pixel), pixel - block[0]
        source = _source(pixel, period_ticks, arrays)
        _poisson_law(source.mean / source.parts, law)
        alive_at = ready[local]
        trapped = carriers[local]
        next_received = np.searchsorted(received_where, pixel << 32)
        for index in range(pulses):
            pulse = first_pulse + index
            key, n = key_of(pixel_key, pulse), 0
            begin = starts[pulse] if starts.size else pulse * period_ticks
            gap = starts[pulse + 1] - begin - period_ticks if starts.size else 0.0
            if source.bright:
                n = _draw_noise(key, source.noise_to_ticks, period_ticks, photons)
            count = _draw_count(key, source.parts, law)
            if n + count >= photons.size:
                return -1
            n = _draw_photons(key, count, n, pixel, pulse, source, physics, arrays, photons)
            if count > INSERTION_MAX:
                _sort(photons, n)
            if physics.other_period_ticks > 0:
                n = _draw_others(key, n, begin - arrays.other_first[pixel], arrays.other[pixel], physics, photons)
            if physics.afterpulse > 0:
                n = _release(n, trapped, period_ticks, photons)
            while next_received < received_where.size and received_where[next_received] == (pixel << 32) + index:
                n = _insert(photons, n, received_time[next_received])
                next_received += 1
            opens = arrays.gate_start[pixel]
            if physics.gate_every > 0:
                opens += arrays.gate_step[pixel] * _gate_step(pulse, physics)
            gate = opens, opens + arrays.gate_len[pixel]
            at = key, pixel, index
            n, alive_at, done = _avalanches(n, at, gate, alive_at, done, physics, arrays.taps, trapped, photons, made)
            if n >= photons.size:
                return -1
            alive_at = max(alive_at - period_ticks - gap, 0.0)
            if gap > 0 and physics.afterpulse > 0:
                _lose(trapped, gap)
        ready[local] = alive_at
    return done


@njit(inline="always")
def _source(pixel, period_ticks, arrays):
    noise, signal = arrays.noise[pixel], arrays.signal[pixel].sum()
    first_bin, end_bin = arrays.bin_first[pixel], arrays.bin_first[pixel + 1]
    noise_to_ticks, bright = period_ticks / noise, noise > GAPS_FROM
    if bright:
        noise = 0.0
    binned = arrays.bin_photons[end_bin - 1] if end_bin > first_bin else 0.0
    mean = noise + signal + binned
    return _Source(noise, noise_to_ticks, bright, binned, mean, int(mean / POISSON_MEAN_MAX) + 1)


@njit(inline="always")
def _draw_noise(key, noise_to_ticks, period_ticks, photons):
    """Write a bright pixel's noise to `photons` in the order of time, by exponential gaps; return its number."""
    n, t = 0, exponential(key, GAP, 0) * noise_to_ticks
    while t < period_ticks and n < photons.size:
        photons[n] = t
        n += 1
        t += exponential(key, GAP, n) * noise_to_ticks
    return n


@njit(inline="always")
def _draw_count(key, parts, law):
    """Return a Poisson number, the sum of `parts` of the same law."""
    count = 0
    for part in range(parts):
        u, k = open_unit(key_of(key, part) if part else key), 0
        while u > law[k]:
            k += 1
        count += k
    return count


@njit(inline="always")
def _draw_photons(key, count, n, pixel, pulse, source, physics, arrays, photons):
    """Add `count` photons of `source`, with random origins and times, to the ascending photons[:n]; return the new n."""
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
    return n


@njit(inline="always")
def _arrival(key, i, mark, binned, pixel, pulse, physics, arrays):
    """Return the arrival of photon `i`, of the target or bin to which `mark` belongs; negative: in the gap before the period."""
    period_ticks, signal, starts = physics.period_ticks, arrays.signal, arrays.starts
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
        lap = np.int64(begins // period_ticks)
        begins -= lap * period_ticks
    t = begins + arrays.sigma[pixel, target] * normal(key, SHAPE, i)
    if starts.size and lap:  # from an earlier pulse, whose distance in time varies
        emitted = max(pulse - lap, 0)
        t += (pulse - emitted) * period_ticks - (starts[pulse] - starts[emitted])
        if not 0 <= t < period_ticks:
            return -1.0
    return _modulo(t, period_ticks)


@njit(inline="always")
def _draw_others(key, n, since, mean, physics, photons):
    """Add `mean` photons per pulse of another LiDAR, whose first pulse came `since` ticks ago; return the new n."""
    drawn = 0
    t = -_modulo(since, physics.other_period_ticks)  # tail of the last pulse before the period
    while t < physics.period_ticks:
        sum_of_gaps = exponential(key, OTHER, drawn)
        while sum_of_gaps < mean:
            at = t + physics.other_sigma * normal(key, OTHER_SHAPE, drawn)
            if 0 <= at < physics.period_ticks:
                n = _insert(photons, n, at)
            drawn += 1
            sum_of_gaps += exponential(key, OTHER, drawn)
        drawn += 1
        t += physics.other_period_ticks
    return n


@njit(inline="always")
def _release(n, carriers, period_ticks, photons):
    """Add the photons of carriers that are released in this period; the others wait for the next; return the new n."""
    for slot in range(CARRIERS_MAX):
        if carriers[slot] < period_ticks:
            n = _insert(photons, n, carriers[slot])
            carriers[slot] = np.inf
        carriers[slot] -= period_ticks
    return n


@njit(inline="always")
def _lose(carriers, gap):
    """Drop the carriers that are released in the gap between two periods."""
    for slot in range(CARRIERS_MAX):
        carriers[slot] -= gap
        if carriers[slot] < 0:
            carriers[slot] = np.inf


@njit(inline="always")
def _gate_step(pulse, physics):
    """Return the number of steps that progressive gating has moved."""
    return pulse % physics.frame_pulses // physics.gate_every % physics.gate_steps


@njit(inline="always")
def _avalanches(n, at, gate, alive_at, done, physics, taps, carriers, photons, made):
    """Turn photons into avalanches by gate and dead time, and these into edges or, with `sending`, into crosstalk.

    at: key, pixel and index of the pulse. Afterpulses join the photons. Returns the new n, the time from which the SPAD
    is alive, and the number of items made.
    """
    (key, pixel, index), (opens, closes), packing = at, gate, made.packing
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
            if released < physics.period_ticks:
                n = _insert(photons, n, released)
            else:
                carriers[np.argmax(carriers)] = released - physics.period_ticks  # a free slot is infinite
        if made.sending:
            done = _send(at, fired, t, done, physics, made)
        else:
            if done < made.keys.size:
                tick = _tick(_modulo(_with_jitter(key, fired, t, physics), physics.period_ticks), physics, taps)
                made.keys[done] = (((index << packing.tick_bits) + tick) << packing.pixel_bits) + pixel
            done += 1
        fired += 1
    return n, alive_at, done


@njit(inline="always")
def _send(at, fired, t, done, physics, made):
    """Send the crosstalk of an avalanche to the neighbours that it reaches; return the number of items made."""
    key, pixel, index = at
    for side in range(4):
        neighbour = _neighbour(pixel, side, physics.rows, physics.cols)
        if neighbour >= 0 and uniform(key, CROSSTALK, 4 * fired + side) < physics.crosstalk:
            if done < made.keys.size:
                made.keys[done], made.times[done] = (neighbour << 32) + index, t
            done += 1
    return done


@njit(inline="always")
def _with_jitter(key, fired, t, physics):
    """Return the time of an avalanche's edge."""
    if physics.jitter > 0:
        t += physics.jitter * normal(key, JITTER, fired)
    if physics.tail_fraction > 0 and uniform(key, TAIL_SHARE, fired) < physics.tail_fraction:
        t += physics.tail * exponential(key, TAIL, fired)
    return t


@njit
def _sort(photons, n):
    """Sort photons[:n] (Shell, with Ciura's gaps)."""
    for gap in (701, 301, 132, 57, 23, 10, 4, 1):
        for i in range(gap, n):
            t, k = photons[i], i
            while k >= gap and photons[k - gap] > t:
                photons[k] = photons[k - gap]
                k -= gap
            photons[k] = t


@njit
def _poisson_law(mean, law):
    """Fill law[k] with the probability of at most k, until it is 1 in float64."""
    chance = math.exp(-mean)
    law[0], last = chance, 0
    while last < law.size - 1 and (chance > 1e-18 or last < mean):
        last += 1
        chance *= mean / last
        law[last] = law[last - 1] + chance
    law[last] = 1.0


@njit(inline="always")
def _insert(photons, n, t):
    """Insert `t` into the ascending photons[:n] (dropped if they are full) and return n + 1, or the size if less."""
    if n == photons.size:
        return n
    i = n
    while i > 0 and photons[i - 1] > t:
        photons[i] = photons[i - 1]
        i -= 1
    photons[i] = t
    return n + 1


@njit(inline="always")
def _modulo(t, period_ticks):
    """Return `t` moved into [0, period_ticks]; the division is rarely needed."""
    return t if 0.0 <= t < period_ticks else t - period_ticks * np.floor(t / period_ticks)


@njit(inline="always")
def _tick(t, physics, taps):
    """Return the TDC code of time `t` in ticks; `taps`: the inner borders of the phases, empty = ideal."""
    if taps.size:
        cycle = np.floor(t / physics.phases)
        t = cycle * physics.phases + np.searchsorted(taps, t - cycle * physics.phases, side="right")
    return min(np.int64(t), np.int64(physics.period_ticks) - 1)


@njit(inline="always")
def _neighbour(pixel, side, rows, cols):
    """Return the pixel above, left, right or below; -1 beyond the array."""
    row, col = pixel // cols + (side == 3) - (side == 0), pixel % cols + (side == 2) - (side == 1)
    return row * cols + col if 0 <= row < rows and 0 <= col < cols else -1


@njit
def unpacked(keys, first_pulse, packing):
    """Return (pulse, pixel, tick) of packed edges."""
    pixel_bits, tick_bits = packing
    pulse, pixel, tick = np.empty_like(keys), np.empty_like(keys), np.empty_like(keys)
    for i, key in enumerate(keys):
        pulse[i] = first_pulse + (key >> (pixel_bits + tick_bits))
        pixel[i] = key & ((1 << pixel_bits) - 1)
        tick[i] = key >> pixel_bits & ((1 << tick_bits) - 1)
    return pulse, pixel, tick
