# SPDX-License-Identifier: Apache-2.0
"""What a subgroup's events say about the times and lights of its pixels, as logarithms of likelihoods.

The events of a pulse constrain the firing time of each pixel of the subgroup:

- The winner fired at the stamp.
- A pixel in the map fired inside the window, and not before its minigroup's offset (format full). It fired at that
  offset if it was the first of its minigroup. The probability of this follows from the approximate surface times of the
  other pixels (`first_shares`).
- A pixel outside the map did not fire inside the window, nor while the tree waited for its first photon. It may have
  fired while the tree was blind, between the window's end and the re-arming.
- Without an event nearby, it did not fire, or it left no trace (`unheard.py`).

A pixel that sees a surface at time t with `light` photons per pulse fires at the first of them and is dead from then on.
So the probability that it has fired by time u is F(u) = 1 - exp(-light * Phi((u - t) / sigma)).
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import special

from ..contract.parameters import OFFSET_NONE
from ..shared.compiled import njit, part
from . import portable
from .clusters import NEVER
from .histograms import is_hit
from .vector_math import fast_log

REACH_SIGMAS = 4.0  # from the centre of a pulse to its beginning and end
RARE = 1e-6  # lowest probability: effects that the law does not include happen, too
KEPT = 32  # tables of F, at most: those of the next frame are mostly the same
ALIKE = 0.2  # pixels of a minigroup are treated alike if their probabilities to have been first differ by less


class Law(NamedTuple):
    """What holds for all events of a subgroup; times in ticks. Arrays over times and lights are flat, by time.

    The times of the grid are numbered from `origin`, the first one that some pixel wants.
    """

    window: int
    told: int  # ticks of the window whose hits are known: all of them, or the first (format short)
    phases: int
    offset: int  # ticks per step of an offset
    reach: int
    step: int
    origin: int
    lights: int
    noise: float  # background photons per tick and pixel
    alive: np.float32  # share of the pulses in which background has not fired the pixel yet
    pulses: int
    heard: np.ndarray  # float32[kinds, times * lights]: chance that a photon makes an event; also that while dropping
    sharp: np.ndarray  # the same: chance that it makes the stamp of an event earlier
    margin: int
    fired: np.ndarray  # of `fired_table`


class Pixels(NamedTuple):
    """Pixels of a subgroup, and what the events that hit them say, float32[pixels, bins * lights], logarithms.

    total: valid only where `touched`, bool[pixels, bins], is set.
    """

    minigroup: np.ndarray
    mask: np.ndarray
    activity: np.ndarray
    first: np.ndarray
    total: np.ndarray
    touched: np.ndarray
    counted: np.ndarray  # event in which the pixel was hit last
    number: np.ndarray  # of `_count`
    hit: np.ndarray  # the same


class _Rows(NamedTuple):
    """Workspace of a cluster, float32[times * lights].

    lost: probability that a photon was noticed outside the pixel's hits; before: the same before the present event.
    unseen: log likelihood of no hit; logs: that of a hit, relative to it.
    """

    lost: np.ndarray
    before: np.ndarray
    unseen: np.ndarray
    logs: np.ndarray


@njit
def add_events(law, events, pixels):
    """Return what a subgroup's events say about pixels without a hit, float32[times * lights]; add the hits to `pixels`.

    In each cluster of events, a pixel's first hit counts.
    """
    pulse, armed, overrun, first = events.pulse, events.armed, events.overrun, pixels.first
    lights, bins = law.lights, pixels.touched.shape[1]
    n, times = len(pulse), law.heard.shape[1] // lights
    wanted = np.zeros(times + 1, np.int64)  # running number of the times that are in some pixel's bins
    for i in range(len(first)):
        for k in range(max(0, first[i]), min(times, first[i] + bins)):
            wanted[k + 1] = 1
    for k in range(times):
        wanted[k + 1] += wanted[k]
    common = np.zeros(times * lights, np.float32)
    rows = _Rows(np.empty_like(common), np.empty_like(common), np.empty_like(common), np.empty_like(common))
    silent = np.zeros((2, times + 1), np.int64)  # change of the number of pulses without an event nearby, by `overrun`
    since, since_pulse = np.int64(0), np.int64(0)  # typed, so that nothing compiles twice
    for e in range(n):
        if events.since[e] == NEVER:
            k0, _ = reached(law, events.quiet[e], armed[e], times)
            _add_silence(silent[np.int64(overrun[e])], since_pulse, since, pulse[e], k0)
        _, since = reached(law, events.quiet[e], armed[e], times)
        since_pulse = pulse[e]
    for run in range(len(events.alike) - 1):
        alike = events.clusters[events.alike[run] : events.alike[run + 1]]
        begin, frequency = alike[0], np.float32(len(alike))
        end = begin + 1
        while end < n and events.since[end] != NEVER:
            end += 1
        k0, k1 = reached(law, events.quiet[begin], armed[end - 1], times)
        while k0 < k1 and wanted[k0 + 1] == wanted[k0]:
            k0 += 1
        while k1 > k0 and wanted[k1] == wanted[k1 - 1]:
            k1 -= 1
        if k0 >= k1:
            continue
        here = slice(k0 * lights, k1 * lights)
        rows.lost[here], rows.before[here] = 0, 0
        for e in range(begin, end):
            _lose(law, events, e, rows.lost, k0, k1)
        if not (overrun[end] if end < n else overrun[n - 1]):
            _lose_after(law, armed[end - 1], rows.lost, k0, k1)
        _not_lost(rows.lost[here], frequency, rows.unseen[here], common[here])
        for e in range(begin, end):
            _add_hits(law, events, e, begin, alike, pixels, rows, k0, k1)
            if e + 1 < end:
                _lose(law, events, e, rows.before, k0, k1)
    _add_silence(silent[np.int64(n > 0 and overrun[n - 1])], since_pulse, since, law.pulses, 0)
    always = fired_by(law, -NEVER, 0)
    always_fired = law.fired[always : always + times * lights]
    for dropping in range(len(law.heard)):
        number = 0
        for k in range(times):
            number += silent[dropping, k]
            rows.lost[k * lights : (k + 1) * lights] = number
        for j in range(len(common)):
            unheard = np.float32(1) - law.heard[dropping, j] * always_fired[j]
            common[j] += rows.lost[j] * fast_log(max(np.float32(RARE), unheard))
    return common


@part
def _add_silence(silent, from_pulse, since, to_pulse, until):
    """Count the pulses without an event nearby, from time `since` of one pulse to time `until` of another."""
    silent[since] += 1
    silent[until] -= 1
    silent[0] += to_pulse - from_pulse


@part
def _lose(law, events, e, lost, k0, k1):
    """Add event e to `lost`: a pixel outside its map did not fire in the window, nor between the last event and it.

    Before `quiet`, its photon would have made an event of its own; before `known`, it would have made this event's stamp
    earlier.
    """
    dropping, here = np.int64(events.overrun[e]), slice(k0 * law.lights, k1 * law.lights)
    z, a = fired_by(law, events.since[e], k0), fired_by(law, events.quiet[e], k0)
    b, c = fired_by(law, events.known[e], k0), fired_by(law, events.stamp[e] + law.told, k0)
    n, fired = (k1 - k0) * law.lights, law.fired
    z, a, b, c = fired[z : z + n], fired[a : a + n], fired[b : b + n], fired[c : c + n]
    heard, sharp, alive, lost = law.heard[0, here], law.sharp[dropping, here], law.alive, lost[here]
    stored = np.float32(not dropping)
    for j in range(len(lost)):
        lost[j] += alive * (c[j] - b[j]) + sharp[j] * (b[j] - a[j]) + stored * heard[j] * (a[j] - z[j])


@part
def _lose_after(law, armed, lost, k0, k1):
    """Add the silence after the last event of a pulse to `lost`."""
    here, n = slice(k0 * law.lights, k1 * law.lights), (k1 - k0) * law.lights
    d, f = fired_by(law, armed, k0), fired_by(law, -NEVER, k0)
    d, f, heard, lost = law.fired[d : d + n], law.fired[f : f + n], law.heard[0, here], lost[here]
    for j in range(len(lost)):
        lost[j] += heard[j] * (f[j] - d[j])


@part
def _not_lost(lost, frequency, unseen, common):
    """Compute `unseen` from `lost`, and add it to `common` so many times."""
    for j in range(len(lost)):
        unseen[j] = fast_log(max(np.float32(RARE), np.float32(1) - lost[j]))
        common[j] += frequency * unseen[j]


@part
def _add_hits(law, events, e, cluster, alike, pixels, rows, k0, k1):
    """Add what event e, and single events `alike` it, say about the pixels in their maps; pixels of a kind share a row."""
    mask, activity, first, counted = pixels.mask, pixels.activity, pixels.first, pixels.counted
    bins, offset, shares = pixels.touched.shape[1], events.offset, events.shares
    stamp, winner = events.stamp[e], events.winner[e]
    cycle, end = stamp // law.phases * law.phases, stamp + law.window
    k0 = max(k0, reached(law, events.known[e], end, k1)[0])  # earlier surfaces, before which a hit is like none
    groups, numbers = offset.shape[1] if len(shares) else 1, pixels.number
    hit = pixels.hit[: _count(events.hits, events.winner, e, alike, numbers, pixels.hit)]
    for group in range(-1, groups):  # one at a time, because the pixels of a group share rows; first of all the winner
        begin, own, until, of_row = stamp, stamp, end, np.float32(-1.0)
        if group < 0:
            until = stamp + 1
        elif len(shares) and group != pixels.minigroup[winner] and offset[e, group] != OFFSET_NONE:
            begin = max(stamp, cycle + offset[e, group] * law.offset)
            own = min(end, cycle + (offset[e, group] + 1) * law.offset)
        for i in hit:
            number = numbers[np.int64(group < 0), i]
            if number == 0 or not mask[i] or cluster <= counted[i] < e:
                continue
            if groups > 1 and group >= 0 and pixels.minigroup[i] != group:
                continue
            counted[i] = e
            share = shares[e, i] if own > begin else np.float32(0.0)
            low, high = k0, k1
            if activity[i] != 1 or group < 0 and len(alike) == 1:
                low, high, of_row = max(k0, first[i]), min(k1, first[i] + bins), np.float32(-1.0)
            if of_row < 0 or abs(share - of_row) > ALIKE:
                if low < high:
                    _row(law, events, e, (begin, own, until, share), law.noise * activity[i], rows, low, high)
                of_row = share if activity[i] == 1 else np.float32(-1.0)
            _add(pixels.total[i], pixels.touched[i], rows.logs, np.float32(number), first[i], k0, k1, law.lights)


@part
def _count(hits, winner, e, alike, number, hit):
    """Count how often each pixel was hit without winning, and won, in event e and those alike: int64[2, pixels].

    Write the pixels with a hit to `hit`, and return their number.
    """
    for i in range(number.shape[1]):
        number[0, i], number[1, i] = 0, 0
    for k in range(len(alike)):
        x = alike[k] if k else e
        for i in range(number.shape[1]):
            number[0, i] += np.int64(is_hit(hits, x, i))
        number[0, winner[x]] -= 1
        number[1, winner[x]] += 1
    n = 0
    for i in range(number.shape[1]):
        if number[0, i] or number[1, i]:
            hit[n] = i
            n += 1
    return n


@part(error_model="numpy")
def _row(law, events, e, hit, noise, rows, k0, k1):
    """Compute logs[k0:k1] of `rows`: the likelihood ratio of a hit of event e.

    hit: ticks begin, own and until, and share: it is in [begin, until), or before `own` with the probability `share` of
    having been its minigroup's first. The ratio is relative to the likelihood of no hit, which all pixels get. What
    precedes the hit is as in `_lose`.
    """
    begin, own, until, share = hit
    dropping, here = np.int64(events.overrun[e]), slice(k0 * law.lights, k1 * law.lights)
    z, a = fired_by(law, events.since[e], k0), fired_by(law, events.quiet[e], k0)
    b, c = fired_by(law, events.known[e], k0), fired_by(law, begin, k0)
    d, f = fired_by(law, own, k0), fired_by(law, until, k0)
    n, fired = (k1 - k0) * law.lights, law.fired
    z, a, b = fired[z : z + n], fired[a : a + n], fired[b : b + n]
    c, d, f = fired[c : c + n], fired[d : d + n], fired[f : f + n]
    heard, sharp, alive = law.heard[0, here], law.sharp[dropping, here], law.alive
    before, unseen, logs = rows.before[here], rows.unseen[here], rows.logs[here]
    stored = np.float32(not dropping)
    background = np.float32(1 / (noise * (share * (own - begin) + (1 - share) * (until - begin))))
    weight = alive * background
    for j in range(len(logs)):
        lost = alive * (c[j] - b[j]) + sharp[j] * (b[j] - a[j]) + stored * heard[j] * (a[j] - z[j])
        earlier = max(np.float32(RARE), np.float32(1) - before[j] - lost)
        inside = f[j] + share * (d[j] - f[j]) - c[j]
        logs[j] = fast_log(weight * inside + earlier) - unseen[j]


@part
def _add(total, touched, row, number, first, k0, k1, lights):
    """Add times k0 to k1 of a row, a number of times, to a pixel's total, which begins at time `first`."""
    low, high = max(k0, first), min(k1, first + len(touched))
    for k in range(low - first, high - first):
        if not touched[k]:
            touched[k] = True
            for j in range(k * lights, (k + 1) * lights):
                total[j] = 0
    if low < high:
        out, row = total[(low - first) * lights : (high - first) * lights], row[low * lights : high * lights]
        for j in range(len(out)):
            out[j] += number * row[j]


@njit
def first_shares(law, events, minigroup, time, light, sigma):
    """float32[n, pixels]: probability that a hit pixel was the first of its minigroup, so that all others fired later."""
    stamp, winner, hits, offset = events.stamp, events.winner, events.hits, events.offset
    n, pixels = len(stamp), len(minigroup)
    shares = np.zeros((n, pixels), np.float32)
    members = np.empty(pixels, np.int64)
    later = np.empty(pixels)
    for e in range(n):
        cycle, end = stamp[e] // law.phases * law.phases, stamp[e] + law.window
        for g in range(offset.shape[1]):
            if offset[e, g] == OFFSET_NONE or g == minigroup[winner[e]]:
                continue
            begin = max(stamp[e], cycle + offset[e, g] * law.offset)
            own = min(end, cycle + (offset[e, g] + 1) * law.offset)
            number = 0
            for i in range(pixels):
                if minigroup[i] == g and is_hit(hits, e, i):
                    members[number] = i
                    last = _unfired(end - time[i], light[i], sigma)
                    inside = _unfired(begin - time[i], light[i], sigma) - last
                    if inside > RARE:
                        later[number] = (_unfired(own - time[i], light[i], sigma) - last) / inside
                    else:  # background, or an unknown surface
                        later[number] = (end - own) / (end - begin)
                    number += 1
            for j in range(number):
                share = 1.0
                for k in range(number):
                    if k != j:
                        share *= later[k]
                shares[e, members[j]] = share
    return shares


@part
def _unfired(distance, light, sigma):
    """Return 1 - F."""
    return math.exp(-light * 0.5 * math.erfc(-distance / sigma * math.sqrt(0.5)))


@lru_cache(KEPT)
def fired_table(
    sigma_ticks: float, reach: int, step: int, span: int, lights: tuple[float, ...]
) -> tuple[int, np.ndarray]:
    """Return a margin, and F for ticks u and times t of a grid: float32[step * columns * lights], by row and column.

    Row r is for ticks u with (u + reach) % step = r. Then F for consecutive times is a contiguous part of the row: its
    column is `margin`, less the number of steps from t to u + reach. `margin` columns to both sides are enough for `span`
    times.
    """
    distance = np.arange(-2 * reach, 2 * reach + 1) / 2
    fired = -portable.expm1(-special.ndtr(distance / sigma_ticks)[:, None] * np.array(lights)).astype(np.float32)
    margin = span + 2 * reach // step + 2
    half_ticks = 2 * np.arange(step)[:, None] + step * (2 * (margin - np.arange(2 * margin + span)) - 1)
    return margin, fired[np.clip(half_ticks, 0, 4 * reach)].ravel()


@njit
def chances_to_be_heard(silent, every, origin, span, step, lights, alive):
    """float32[kinds, span * lights]: `Law.heard` or `Law.sharp`; silent: float32[kinds, points], as in `Unheard`."""
    heard = np.empty((len(silent), span * lights), np.float32)
    last = silent.shape[1] - 1
    for k in range(span):
        place = min(max(((origin + k) * step + step // 2 + 0.5) / every - 0.5, 0.0), float(last))
        before = int(place)
        after, part = min(before + 1, last), np.float32(place - before)
        for kind in range(len(silent)):
            share = silent[kind, before] + part * (silent[kind, after] - silent[kind, before])
            for j in range(k * lights, (k + 1) * lights):
                heard[kind, j] = alive * (np.float32(1) - share)
    return heard


@part
def reached(law, begin, end, times):
    """Return the times of surfaces whose photons come between two ticks, the first one and the one after the last."""
    k0 = (begin - law.reach) // law.step - law.origin
    k1 = (end + law.reach) // law.step + 1 - law.origin
    return min(times, max(0, k0)), min(times, max(0, k1))


@part
def fired_by(law, tick, k0):
    """Return where `law.fired` has F at a tick for the surfaces from time k0 on, and all lights."""
    steps = (tick + law.reach) // law.step
    column = min(max(law.margin - steps + law.origin + k0, 0), 2 * law.margin)
    row = tick + law.reach - steps * law.step
    return row * (len(law.fired) // law.step) + column * law.lights
