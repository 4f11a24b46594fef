# SPDX-License-Identifier: Apache-2.0
"""What a subgroup's events say about the times and lights of its pixels: log likelihoods.

The events of a pulse constrain the firing time of each pixel of the subgroup:

- The winner fired at the stamp.
- A pixel in the map fired inside the window, and not before its minigroup's offset (format full).
  Of the pixels that fire in one tick, the one with the lowest number wins. So a pixel with a lower
  number than the winner's fired after the stamp.
  It fired at that offset if it was the first of its minigroup. The probability of this follows from
  the approximate surface times of the other pixels (`first_shares`).
- A pixel outside the map did not fire inside the window, nor while the tree waited for its first
  photon. It may have fired while the tree was blind, between the window's end and the re-arming.
- Without a map (format short), a pixel that is not the winner may have fired inside the window,
  too; one with a higher number than the winner's also in the tick of the stamp.
- Without an event nearby, it did not fire, or it left no trace (`unheard.py`).

When a pixel fires, `law.py` says.
"""

import math
from typing import NamedTuple

import numpy as np

from ..contract.parameters import OFFSET_NONE
from ..shared.compiled import njit, part
from ..shared.interpolation import interpolated
from .clusters import NEVER, SubgroupEvents
from .heard import EVER, add_heard
from .histograms import is_hit
from .law import RARE, Law, by_tick, reached
from .vector_math import fast_log

WON = 0  # how an event hit a pixel: it won,
LOWER = 1  # or its number is lower than the winner's,
HIGHER = 2  # or higher
WAYS = 3
ALIKE = 0.2  # pixels of a minigroup are treated alike if their shares differ by less


class Pixels(NamedTuple):
    """Pixels of a subgroup, and what the events that hit them say."""

    minigroup: np.ndarray  # int64[pixels]
    mask: np.ndarray  # bool[pixels]
    activity: np.ndarray  # float64[pixels], background relative to the mean
    first: np.ndarray  # int64[pixels], number of the pixel's first time
    total: np.ndarray  # float32[pixels, bins * lights], log likelihoods; only where `touched`
    touched: np.ndarray  # bool[pixels, bins]
    counted: np.ndarray  # int64[pixels], event in which the pixel was hit last
    number: np.ndarray  # int64[WAYS, pixels], of `_count`
    hit: np.ndarray  # int64[pixels], of `_count`


class Shape(NamedTuple):
    """Shape of a pulse, as in `PulseTicks`."""

    sigma: float
    times: np.ndarray  # float64[n], of a table; empty: a Gaussian
    shares: np.ndarray  # float64[n]


class _Rows(NamedTuple):
    """Workspace of a cluster, float32[times * lights]."""

    lost: np.ndarray  # probability that a photon was noticed outside the pixel's hits
    before: np.ndarray  # the same, before the present event
    alone: np.ndarray  # the same, in an event of its own between the two
    unseen: np.ndarray  # log likelihood of no hit
    logs: np.ndarray  # log likelihood of a hit, relative to that of no hit


class _Cluster(NamedTuple):
    """A cluster of events of one pulse, and single ones that differ from it in their maps only."""

    begin: int  # its first event
    end: int  # the event after its last one
    alike: np.ndarray  # int64[n], first events of all these clusters


class _Hit(NamedTuple):
    """When a pixel fired, in ticks: in [begin, until)."""

    begin: int
    own: int  # a pixel that was its minigroup's first fired in [begin, own)
    until: int


@njit
def add_events(law: Law, events: SubgroupEvents, pixels: Pixels) -> np.ndarray:
    """Return what a subgroup's events say about pixels without a hit, float32[times * lights].

    What they say about hits is added to `pixels`. In each cluster of events, a pixel's first hit
    counts.
    """
    length = law.heard.mean.shape[1]
    times = length // law.lights
    wanted = np.zeros(times + 1, np.int64)
    silent = np.zeros((2, times + 1), np.int64)
    common = np.zeros(length, np.float32)
    rows = _Rows(
        lost=np.empty(length, np.float32),
        before=np.empty(length, np.float32),
        alone=np.empty(length, np.float32),
        unseen=np.empty(length, np.float32),
        logs=np.empty(length, np.float32),
    )
    _count_wanted(pixels.first, pixels.touched.shape[1], wanted)
    for run in range(len(events.alike) - 1):
        alike = events.clusters[events.alike[run] : events.alike[run + 1]]
        _add_cluster(law, events, alike, wanted, pixels, rows, common)
    _count_silent(law, events, silent)
    _add_silent(law, silent, rows.lost, common)
    return common


@part
def _count_wanted(first: np.ndarray, bins: int, wanted: np.ndarray) -> None:
    """Compute wanted[k], int64[times + 1]: how many times before k are in some pixel's bins."""
    times = len(wanted) - 1
    for i in range(len(first)):
        for k in range(max(0, first[i]), min(times, first[i] + bins)):
            wanted[k + 1] = 1
    for k in range(times):
        wanted[k + 1] += wanted[k]


@part
def _count_silent(law: Law, events: SubgroupEvents, silent: np.ndarray) -> None:
    """Count the pulses without an event nearby, int64[2, times + 1]: changes from time to time.

    Row 1 has those before an event that carries `overrun`, and row 0 the others.
    """
    times = silent.shape[1] - 1
    number = len(events.pulse)
    pulse = np.int64(0)  # typed, so that nothing compiles twice
    since = np.int64(0)
    for e in range(number):
        begin, end = reached(law, events.quiet[e], events.armed[e], times)
        if events.since[e] == NEVER:
            _add_silence(silent[np.int64(events.overrun[e])], pulse, since, events.pulse[e], begin)
        pulse = events.pulse[e]
        since = end
    dropping = np.int64(number > 0 and events.overrun[number - 1])
    _add_silence(silent[dropping], pulse, since, law.pulses, 0)


@part
def _add_silence(
    silent: np.ndarray, from_pulse: np.int64, since: np.int64, to_pulse: int, until: int
) -> None:
    """Count the pulses from time `since` of one pulse to time `until` of another."""
    silent[since] += 1
    silent[until] -= 1
    silent[0] += to_pulse - from_pulse


@part
def _add_silent(law: Law, silent: np.ndarray, numbers: np.ndarray, common: np.ndarray) -> None:
    """Add what the pulses without an event nearby say.

    numbers: workspace, float32[times * lights].
    """
    lights = law.lights
    times = silent.shape[1] - 1
    fired = law.fired[by_tick(law, -NEVER, 0, times)]
    for dropping in range(len(law.heard.mean)):
        number = 0
        for k in range(times):
            number += silent[dropping, k]
            for j in range(k * lights, (k + 1) * lights):
                numbers[j] = number
        for j in range(len(common)):
            unheard = np.float32(1) - law.heard.mean[dropping, j] * fired[j]
            common[j] += numbers[j] * fast_log(max(np.float32(RARE), unheard))


@part
def _add_cluster(
    law: Law,
    events: SubgroupEvents,
    alike: np.ndarray,
    wanted: np.ndarray,
    pixels: Pixels,
    rows: _Rows,
    common: np.ndarray,
) -> None:
    """Add what a cluster of events, and those `alike`, say about pixels with and without a hit."""
    begin = alike[0]
    end = _cluster_end(events, begin)
    times = len(wanted) - 1
    k0, k1 = reached(law, events.quiet[begin], events.armed[end - 1], times)
    while k0 < k1 and wanted[k0 + 1] == wanted[k0]:
        k0 += 1
    while k1 > k0 and wanted[k1] == wanted[k1 - 1]:
        k1 -= 1
    if k0 >= k1:
        return
    here = slice(k0 * law.lights, k1 * law.lights)
    rows.lost[here] = 0
    rows.before[here] = 0
    for e in range(begin, end):
        _lose(law, events, e, rows.lost, k0, k1)
    following = min(end, len(events.pulse) - 1)  # after the last event, its own `overrun` counts
    if not events.overrun[following]:
        add_heard(law, events.armed[end - 1], EVER, rows.lost, k0, k1)
    _not_lost(rows.lost[here], np.float32(len(alike)), rows.unseen[here], common[here])
    cluster = _Cluster(begin, end, alike)
    for e in range(begin, end):
        _add_hits(law, events, e, cluster, pixels, rows, k0, k1)
        if not law.mapped:
            _add_others(law, events, e, cluster, pixels, rows, k0, k1)
        if e + 1 < end:
            _lose(law, events, e, rows.before, k0, k1)


@part
def _cluster_end(events: SubgroupEvents, begin: int) -> int:
    """Return the event after the last one of the cluster that begins at an event."""
    end = begin + 1
    while end < len(events.since) and events.since[end] != NEVER:
        end += 1
    return end


@part
def _lose(law: Law, events: SubgroupEvents, e: int, lost: np.ndarray, k0: int, k1: int) -> None:
    """Add event e to `lost`, the probability that a photon of a pixel outside its map was noticed.

    The pixel did not fire in the window, nor between the last event and it: before `quiet`, its
    photon would have made an event of its own; before `known`, it would have made this event's
    stamp earlier. Without a map, this is a pixel with a lower number than the winner's, and it may
    have fired after the stamp's tick.
    """
    here = slice(k0 * law.lights, k1 * law.lights)
    alive = law.alive
    late, early, between = _sharp_before(law, events, e)
    quiet = law.fired[by_tick(law, events.quiet[e], k0, k1)]
    known = law.fired[by_tick(law, events.known[e], k0, k1)]
    middle = law.fired[by_tick(law, between, k0, k1)]
    told_until = events.stamp[e] + (law.window if law.mapped else 1)
    told = law.fired[by_tick(law, told_until, k0, k1)]
    total = lost[here]
    for j in range(len(total)):
        in_window = alive * (told[j] - known[j])
        earlier = late * (known[j] - middle[j]) + early * (middle[j] - quiet[j])
        total[j] += in_window + earlier
    _lose_alone(law, events, e, lost, k0, k1)


@part
def _lose_alone(
    law: Law, events: SubgroupEvents, e: int, lost: np.ndarray, k0: int, k1: int
) -> None:
    """Add to `lost` the photons that would have made an event of their own before event e."""
    if not events.overrun[e]:
        add_heard(law, events.since[e], events.quiet[e], lost, k0, k1)


@part
def _sharp_before(law: Law, events: SubgroupEvents, e: int) -> tuple[np.float32, np.float32, int]:
    """Return the chances that a photon of the cycle before the stamp of event e, or of an earlier
    one, would make the stamp earlier; and the tick from which on the former holds.
    """
    cycle = events.stamp[e] // law.phases
    dropping = np.int64(events.overrun[e])
    between = max(events.quiet[e], min(events.known[e], (cycle - 1) * law.phases))
    return law.sharp[dropping, 0, cycle], law.sharp[dropping, 1, cycle], between


@part
def _not_lost(
    lost: np.ndarray, frequency: np.float32, unseen: np.ndarray, common: np.ndarray
) -> None:
    """Compute `unseen` from `lost`, and add it to `common` so many times."""
    for j in range(len(lost)):
        unseen[j] = fast_log(max(np.float32(RARE), np.float32(1) - lost[j]))
        common[j] += frequency * unseen[j]


@part
def _add_hits(
    law: Law,
    events: SubgroupEvents,
    e: int,
    cluster: _Cluster,
    pixels: Pixels,
    rows: _Rows,
    k0: int,
    k1: int,
) -> None:
    """Add what event e of a cluster, and single ones alike it, say about pixels in their maps.

    Pixels of a minigroup share a row, if their shares are alike and their background is the mean.
    """
    first_hit = reached(law, events.known[e], events.stamp[e] + law.window, k1)[0]
    k0 = max(k0, first_hit)  # for earlier surfaces, a hit is like none
    hit_pixels = _count(events, e, cluster.alike, pixels)
    rows.alone[k0 * law.lights : k1 * law.lights] = 0
    _lose_alone(law, events, e, rows.alone, k0, k1)
    groups = 1
    if len(events.shares):
        groups = events.offset.shape[1]
    for turn in range(1 + 2 * groups):  # one at a time, because its pixels share rows
        way = WON if turn == 0 else LOWER + (turn - 1) % 2
        group = (turn - 1) // 2  # no minigroup for the winner
        hit = _hit_of(law, events, e, way, group, pixels.minigroup)
        of_row = np.float32(-1.0)  # share for which the row holds; negative: for no other pixel
        for n in range(hit_pixels):
            i = pixels.hit[n]
            number = pixels.number[way, i]
            if number == 0 or not pixels.mask[i] or cluster.begin <= pixels.counted[i] < e:
                continue
            if groups > 1 and way != WON and pixels.minigroup[i] != group:
                continue
            pixels.counted[i] = e
            share = np.float32(0.0)
            if hit.own > hit.begin:
                share = events.shares[e, i]
            usual = pixels.activity[i] == 1
            low = k0
            high = k1
            if not usual or (way == WON and len(cluster.alike) == 1):  # no pixel shares this row
                low = max(k0, pixels.first[i])
                high = min(k1, pixels.first[i] + pixels.touched.shape[1])
                of_row = np.float32(-1.0)
            if of_row < 0 or abs(share - of_row) > ALIKE:
                if low < high:
                    noise = law.noise * pixels.activity[i]
                    _row(law, events, e, hit, share, noise, rows, low, high)
                of_row = share if usual else np.float32(-1.0)
            _add(pixels, i, rows.logs, np.float32(number), k0, k1, law.lights)


@part
def _add_others(
    law: Law,
    events: SubgroupEvents,
    e: int,
    cluster: _Cluster,
    pixels: Pixels,
    rows: _Rows,
    k0: int,
    k1: int,
) -> None:
    """Add what event e of a cluster, and single ones alike it, say without maps about pixels with
    higher numbers than their winners': they may have fired in the stamp's tick, too.
    """
    number = pixels.number[HIGHER]
    number[:] = 0
    for k in range(len(cluster.alike)):
        x = cluster.alike[k] if k else e
        for i in range(events.winner[x] + 1, len(number)):
            number[i] += 1
    here = slice(k0 * law.lights, k1 * law.lights)
    begin = law.fired[by_tick(law, events.stamp[e], k0, k1)]
    until = law.fired[by_tick(law, events.stamp[e] + 1, k0, k1)]
    lost = rows.lost[here]
    unseen = rows.unseen[here]
    logs = rows.logs[here]
    for j in range(len(logs)):
        unnoticed = np.float32(1) - lost[j] + law.alive * (until[j] - begin[j])
        logs[j] = fast_log(max(np.float32(RARE), unnoticed)) - unseen[j]
    for i in range(len(number)):
        won_before = cluster.begin <= pixels.counted[i] < e
        if number[i] and pixels.mask[i] and not won_before:
            _add(pixels, i, rows.logs, np.float32(number[i]), k0, k1, law.lights)


@part
def _hit_of(
    law: Law, events: SubgroupEvents, e: int, way: int, group: int, minigroup: np.ndarray
) -> _Hit:
    """Return when the pixels of a minigroup that event e hit in one of the `WAYS` fired."""
    stamp = events.stamp[e]
    if way == WON:
        return _Hit(stamp, stamp, stamp + 1)
    begin = stamp
    own = stamp
    if len(events.shares) and group != minigroup[events.winner[e]]:
        offset = events.offset[e, group]
        if offset != OFFSET_NONE:
            begin, own = _ticks_of(law, stamp, offset)
    if way == LOWER:
        begin = max(begin, stamp + 1)
        own = max(begin, own)
    return _Hit(begin, own, stamp + law.window)


@part
def _ticks_of(law: Law, stamp: int, offset: int) -> tuple[int, int]:
    """Return the ticks of an event's window in a step of offsets: first, and after the last."""
    cycle = stamp // law.phases * law.phases
    begin = max(stamp, cycle + offset * law.offset)
    end = min(stamp + law.window, cycle + (offset + 1) * law.offset)
    return begin, end


@part
def _count(events: SubgroupEvents, e: int, alike: np.ndarray, pixels: Pixels) -> int:
    """Count how often each pixel was hit, in event e and those alike, in each of the `WAYS`.

    `number` of `pixels` gets the counts, and `hit` the pixels with a hit. Return how many these
    are.
    """
    number = pixels.number
    number[:] = 0
    pixels_of_subgroup = number.shape[1]
    for k in range(len(alike)):
        x = alike[k] if k else e
        winner = events.winner[x]
        for i in range(winner):
            number[LOWER, i] += np.int64(is_hit(events.hits, x, i))
        number[WON, winner] += 1
        for i in range(winner + 1, pixels_of_subgroup):
            number[HIGHER, i] += np.int64(is_hit(events.hits, x, i))
    n = 0
    for i in range(pixels_of_subgroup):
        if number[WON, i] or number[LOWER, i] or number[HIGHER, i]:
            pixels.hit[n] = i
            n += 1
    return n


@part(error_model="numpy")
def _row(
    law: Law,
    events: SubgroupEvents,
    e: int,
    hit: _Hit,
    share: np.float32,
    noise: float,
    rows: _Rows,
    k0: int,
    k1: int,
) -> None:
    """Compute `logs` of `rows` for times k0 to k1: the likelihood ratio of a hit of event e.

    share: probability that the pixel was its minigroup's first. The ratio is relative to the
    likelihood of no hit, which all pixels get. What precedes the hit is as in `_lose`.
    """
    here = slice(k0 * law.lights, k1 * law.lights)
    alive = law.alive
    late, early, between = _sharp_before(law, events, e)
    quiet = law.fired[by_tick(law, events.quiet[e], k0, k1)]
    known = law.fired[by_tick(law, events.known[e], k0, k1)]
    middle = law.fired[by_tick(law, between, k0, k1)]
    begin = law.fired[by_tick(law, hit.begin, k0, k1)]
    own = law.fired[by_tick(law, hit.own, k0, k1)]
    until = law.fired[by_tick(law, hit.until, k0, k1)]
    before = rows.before[here]
    alone = rows.alone[here]
    unseen = rows.unseen[here]
    logs = rows.logs[here]
    ticks = share * (hit.own - hit.begin) + (1 - share) * (hit.until - hit.begin)
    background = np.float32(1 / (noise * ticks))
    weight = alive * background
    for j in range(len(logs)):
        in_window = alive * (begin[j] - known[j])
        earlier = late * (known[j] - middle[j]) + early * (middle[j] - quiet[j])
        lost = before[j] + in_window + earlier + alone[j]
        unnoticed = max(np.float32(RARE), np.float32(1) - lost)
        inside = until[j] + share * (own[j] - until[j]) - begin[j]
        logs[j] = fast_log(weight * inside + unnoticed) - unseen[j]


@part
def _add(
    pixels: Pixels, i: int, row: np.ndarray, number: np.float32, k0: int, k1: int, lights: int
) -> None:
    """Add times k0 to k1 of a row, a number of times, to the total of pixel i."""
    first = pixels.first[i]
    total = pixels.total[i]
    touched = pixels.touched[i]
    low = max(k0, first)
    high = min(k1, first + len(touched))
    for k in range(low - first, high - first):
        if not touched[k]:
            touched[k] = True
            for j in range(k * lights, (k + 1) * lights):
                total[j] = 0
    if low < high:
        own = total[(low - first) * lights : (high - first) * lights]
        here = row[low * lights : high * lights]
        for j in range(len(own)):
            own[j] += number * here[j]


@njit
def first_shares(
    law: Law,
    events: SubgroupEvents,
    minigroup: np.ndarray,
    time: np.ndarray,
    light: np.ndarray,
    shape: Shape,
) -> np.ndarray:
    """float32[n, pixels]: probability that a hit pixel was the first of its minigroup.

    time, light: float64[pixels], approximate ticks and photons of the surfaces.
    """
    n = len(events.stamp)
    pixels = len(minigroup)
    shares = np.zeros((n, pixels), np.float32)
    members = np.empty(pixels, np.int64)
    later = np.empty(pixels)
    for e in range(n):
        end = events.stamp[e] + law.window
        for g in range(events.offset.shape[1]):
            offset = events.offset[e, g]
            if offset == OFFSET_NONE or g == minigroup[events.winner[e]]:
                continue
            begin, own = _ticks_of(law, events.stamp[e], offset)
            number = 0
            for i in range(pixels):
                if minigroup[i] == g and is_hit(events.hits, e, i):
                    members[number] = i
                    later[number] = _later(begin, own, end, time[i], light[i], shape)
                    number += 1
            for j in range(number):
                shares[e, members[j]] = _all_others(later, number, j)
    return shares


@part
def _later(begin: int, own: int, end: int, time: float, light: float, shape: Shape) -> float:
    """Return the probability that a pixel that fired in [begin, end) did so in [own, end)."""
    last = _unfired(end - time, light, shape)
    inside = _unfired(begin - time, light, shape) - last
    if inside > RARE:
        return (_unfired(own - time, light, shape) - last) / inside
    return (end - own) / (end - begin)  # background, or an unknown surface


@part
def _all_others(chances: np.ndarray, number: int, own: int) -> float:
    """Return the product of so many chances, except one."""
    share = 1.0
    for k in range(number):
        if k != own:
            share *= chances[k]
    return share


@part
def _unfired(distance: float, light: float, shape: Shape) -> float:
    """Return 1 - F."""
    if len(shape.times):
        return math.exp(-light * interpolated(distance, shape.times, shape.shares))
    return math.exp(-light * 0.5 * math.erfc(-distance / shape.sigma * math.sqrt(0.5)))
