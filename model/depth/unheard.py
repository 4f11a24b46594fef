# SPDX-License-Identifier: Apache-2.0
"""How often a pixel that fires leaves no trace, estimated from the events of its subgroup.

If there is no event nearby, there are three possibilities: the pixel did not fire; it fired, and
the window missed the threshold; or the tree was blind after such a window. Their frequencies follow
from the share of pulses with an event at that time. Drops come in bursts: the first windows of a
pulse fill the FIFO, and the following ones are lost until there is room again. So if the later of
two events carries `overrun`, the silence between them is informative only from the time at which
there was room; this time follows from the rate of windows. Room is more likely to come in a long gap
between two windows than in a short one. So the tree has waited longer for the first window that is
stored again than for others.

Where surfaces and lights of the pixels are roughly known, the frequencies follow from these instead
(`tree.py`).
"""

import math
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from ..contract.coincidence import Rise, event_share, rises
from ..contract.config import Config
from ..shared.compiled import njit, part
from . import portable
from .clusters import armed_ticks
from .gates import open_share_by_tick
from .histograms import Events
from .law import RARE
from .pulse_ticks import PulseTicks
from .tree import Tree, kept_shares, light_by_tick, light_scale, unheard_in
from .vector_math import fast_log

BLIND_MAX = 0.95
DROPPING_ROUNDS = 3  # rounds in which the rate of windows and the stored share of them converge
TRUST_MAX = 0.97  # in the light of a subgroup: from there on, shares of windows are not asked
RATE_MIN = 1e-3  # photons per subgroup and window, at least
SHARES = 512  # shares of events for which the number of photons is tabulated
PHOTONS_MAX = 1e3  # in a window, and number of steps up to it: for a rule of a user's own
PHOTON_STEPS = 4096

# A `map` that may use any order.
Spread = Callable[[Callable[[int], Any], Iterable[int]], Iterable[Any]]


class Unheard(NamedTuple):
    """Probabilities that a firing pixel leaves no trace in a pulse without an event nearby.

    Both are float32[2, subgroups, points], by the tick of the photon. Index 1 holds between two
    events of which the later one carries `overrun`; only there are windows dropped.
    """

    missed: np.ndarray  # its window misses the threshold, finds the tree not armed, or is dropped
    blind: np.ndarray  # it finds the tree not armed, when a window would have been noticed
    every: int  # ticks from point to point
    doubt: np.ndarray  # float64[subgroups], of the light that they follow from, from 0 to 1


class Guess(NamedTuple):
    """Prior knowledge of the pixels, [subgroups, pixels]."""

    time: np.ndarray  # float64, ticks; NaN = unknown
    light: np.ndarray  # float64, photons per pulse


class SubgroupWindows(NamedTuple):
    """What the events of a subgroup tell of its windows."""

    of_ticks: "_Ticks"
    dropping: bool  # windows were dropped
    law: tuple[Rise, ...]  # what the threshold means
    tree: Tree
    photon_rate: float  # of the background, photons per tick


def windows_of(
    events: Events, config: Config, pulses: int, pulse: PulseTicks, spread: Spread = map
) -> list[SubgroupWindows]:
    """Return what the events of each subgroup tell of its windows.

    pulses: number of pulses in which the events came; spread: as in `log_likelihood`.
    """
    sensor = config.sensor
    reach = pulse.reach

    def of_subgroup(s: int) -> SubgroupWindows:
        of_ticks, dropping = _ticks_of(events, config, pulses, reach, s)
        law = rises(sensor.rule, sensor.subgroup, int(events.threshold[s]))
        tree = Tree(
            window=int(events.window[s]),
            phases=sensor.phases,
            rearm=sensor.rearm,
            kept=kept_shares(law, sensor.pixels),
        )
        return SubgroupWindows(of_ticks, dropping, law, tree, events.photon_rate[s])

    return list(spread(of_subgroup, range(sensor.subgroups)))


def unheard(
    windows: list[SubgroupWindows], config: Config, pulse: PulseTicks, spread: Spread = map
) -> Unheard:
    """Estimate how often photons leave no trace, from the shares of the windows. windows: of
    `windows_of`.
    """
    never = _none_yet(config, pulse)

    def of_subgroup(s: int) -> None:
        one = windows[s]
        kinds = 1 + one.dropping
        missed = never.missed[:, s]
        blind = never.blind[:, s]
        least = np.float32(_event_share(one.law, one.photon_rate * one.tree.window))
        _leave_no_trace(one.of_ticks, least, _shares(one.law), never.every, kinds, missed, blind)
        missed[kinds:] = missed[0]
        blind[kinds:] = blind[0]

    list(spread(of_subgroup, range(len(windows))))
    return never


def unheard_in_light(
    windows: list[SubgroupWindows],
    rough: Unheard,
    guess: Guess,
    config: Config,
    pulses: int,
    pulse: PulseTicks,
    spread: Spread = map,
) -> Unheard:
    """Estimate how often photons leave no trace, from a guess of the light.

    Where the guess cannot be trusted, the estimate is near to that from the shares of the windows.
    rough: the latter, of `unheard`; the others are as in `windows_of`.
    """
    never = _none_yet(config, pulse)
    reach = pulse.reach
    before = pulse.share_before(np.arange(-2 * reach, 2 * reach + 1) / 2)

    def of_subgroup(s: int) -> None:
        of_ticks, dropping, _, tree, photon_rate = windows[s]
        kinds = 1 + dropping
        missed = never.missed[:, s]
        blind = never.blind[:, s]
        noise = float(photon_rate) * (1 - 1 / max(1, config.mask[s].sum()))
        time = np.where(config.mask[s], guess.time[s], np.nan)
        signal = light_by_tick(time, guess.light[s], before, config.period_ticks)
        seen = float(of_ticks.committed[signal > 0].sum())
        scale, trust = light_scale(signal, noise, tree, of_ticks.seen, seen, pulses)
        if trust > 0:
            lit = signal * scale
            kept, unarmed = _leave_no_trace_in(
                of_ticks, lit, noise, tree, never.every, missed[0], blind[0]
            )
            if dropping:
                near, none = _company(lit + noise, reach, tree.phases)
                _leave_no_trace_dropping(
                    of_ticks, kept, unarmed, near, none, never.every, missed[1], blind[1]
                )
        never.doubt[s] = min(1.0, (1 - trust) / (1 - TRUST_MAX))
        if trust < TRUST_MAX:
            share = np.float32(trust)
            missed[:kinds] = _mixed(rough.missed[:kinds, s], missed[:kinds], share)
            blind[:kinds] = _mixed(rough.blind[:kinds, s], blind[:kinds], share)
        missed[kinds:] = missed[0]
        blind[kinds:] = blind[0]

    list(spread(of_subgroup, range(len(windows))))
    return never


def _company(photons: np.ndarray, reach: int, phases: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the chance that another pixel fires within `reach` of a tick, and the chance that none
    does in the tick's cycle, float32[ticks].

    photons: of the other pixels, float64[ticks].
    """
    before = np.cumsum(np.pad(photons, (reach + 1, reach)))
    around = before[2 * reach + 1 :] - before[: len(photons)]
    in_cycle = np.repeat(photons.reshape(-1, phases).sum(axis=1), phases)
    near = -portable.expm1(-around)
    return near.astype(np.float32), portable.exp(-in_cycle).astype(np.float32)


def _none_yet(config: Config, pulse: PulseTicks) -> Unheard:
    """Return probabilities to be filled."""
    every = max(1, int(pulse.sigma))
    shape = 2, config.sensor.subgroups, -(-config.period_ticks // every)
    return Unheard(
        missed=np.empty(shape, np.float32),
        blind=np.empty(shape, np.float32),
        every=every,
        doubt=np.ones(config.sensor.subgroups),
    )


def _mixed(rough: np.ndarray, lit: np.ndarray, share: np.float32) -> np.ndarray:
    """Return a mean of two lines. share: the weight of the second; at 0, it may be empty."""
    return rough + share * (lit - rough) if share > 0 else rough


def _ticks_of(
    events: Events, config: Config, pulses: int, reach: int, s: int
) -> tuple["_Ticks", bool]:
    """Return what is known of the ticks of subgroup s, and whether its windows were dropped."""
    sensor = config.sensor
    ticks = config.period_ticks
    window = int(events.window[s])
    committed = events.committed[s]
    span = slice(events.bounds[s], events.bounds[s + 1])
    stamp = events.stamp[span]
    overrun = events.overrun[span]
    armed = armed_ticks(stamp, window, config)
    dropping = bool(overrun.any())
    none = np.zeros(ticks, np.float32)
    nearby = none
    busy = none
    ready = none
    gap = none
    room = none
    stored_share = np.ones(ticks)
    if dropping:
        number = events.pulse[span] % pulses
        stored_share, found = _while_dropping(
            number, stamp, armed, overrun, committed, pulses, config
        )
        room = found.astype(np.float32)
    dropped = 1 / stored_share
    dropped *= committed / max(1.0, dropped[stamp].sum())  # windows per stored window
    if dropping:
        nearby = _share_between(np.maximum(0, stamp - reach), armed, dropped, pulses)
        nearby = np.minimum(1, nearby)
        busy, ready = _busy(stamp, armed, dropped, pulses, sensor.phases)
        gap = _gap(stamp, armed, dropped[stamp] / pulses, ready[:: sensor.phases], sensor.phases)
    seen = open_share_by_tick(config, s)
    of_ticks = _Ticks(
        committed=np.bincount(stamp, minlength=ticks) * dropped,
        covered=_share_between(stamp, stamp + window, dropped, pulses),
        unarmed=_share_between(stamp + window, armed, dropped, pulses),
        stored=np.divide(1, dropped, out=np.ones(ticks), where=dropped > 0).astype(np.float32),
        nearby=nearby,
        busy=busy,
        ready=ready,
        gap=gap,
        room=room,
        deaf=_deaf(events, config, pulses, s),
        seen=seen.astype(np.float32),
    )
    return of_ticks, dropping


def _deaf(events: Events, config: Config, pulses: int, s: int) -> np.ndarray:
    """float32[ticks]: chance that the tree of a subgroup is blind after a rejected window."""
    sensor = config.sensor
    phase = np.arange(sensor.phases)
    blind_ticks = (phase + sensor.rearm * sensor.phases).astype(np.float64)  # a mean, by phase
    rejected = (events.opened[s] - events.committed[s]) / pulses / config.period_ticks  # per tick
    deaf = np.minimum(BLIND_MAX, rejected * blind_ticks).astype(np.float32)
    return np.tile(deaf, config.period)


def _while_dropping(
    pulse: np.ndarray,
    stamp: np.ndarray,
    armed: np.ndarray,
    overrun: np.ndarray,
    committed: int,
    pulses: int,
    config: Config,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of windows that are stored, float64[ticks], in general and after a full
    FIFO.

    The second one is for two events of which the later one has `overrun`. After an event was
    stored, the FIFO was full, and windows were dropped until there was room. From then on, no
    window came until the next event. The time at which there was room follows from the rate of
    windows, and this rate follows from the share that is stored.
    """
    phases = config.sensor.phases
    cells = config.period
    armed_cycles = armed // phases
    stamp_cycles = stamp // phases
    begin = pulse * cells + armed_cycles
    end = pulse * cells + stamp_cycles
    later = np.flatnonzero(overrun[1:]) + 1
    full = np.zeros(cells + 1)
    np.add.at(full, np.minimum(armed_cycles, cells)[later - 1], 1)
    np.add.at(full, stamp_cycles[later], -1)
    whole_periods = (pulse[later] - pulse[later - 1]).sum()
    clear = 1 - (np.cumsum(full)[:cells] + whole_periods) / pulses
    stored_share = np.clip(clear, 1 / pulses, 1)
    found = np.zeros(cells)
    for _ in range(DROPPING_ROUNDS if len(later) else 0):
        rate = np.bincount(stamp_cycles, minlength=cells) / stored_share
        rate *= committed / pulses / rate.sum()
        found = _room_found(begin[later - 1], end[later], rate)
        stored_share = np.clip(clear + (1 - clear) * found, 1 / pulses, 1)
    return np.repeat(stored_share, phases), np.repeat(found, phases)


def _busy(
    stamp: np.ndarray, armed: np.ndarray, dropped: np.ndarray, pulses: int, phases: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of the pulses in which a window has come and the tree is armed again at the
    next cycle, and the share in which it is armed at the beginning of this cycle, float32[ticks].
    """
    cycle = np.arange(len(dropped)) // phases * phases
    not_armed = _share_between(stamp, armed, dropped, pulses)
    until_next = _share_between(np.maximum(stamp, armed - phases), armed, dropped, pulses)
    beyond_next = np.pad(not_armed - until_next, (phases, 0))
    ready = 1 - beyond_next[cycle + phases - 1]  # of the last tick of the cycle before
    return until_next, np.maximum(1 - BLIND_MAX, ready).astype(np.float32)


def _gap(
    stamp: np.ndarray, armed: np.ndarray, weight: np.ndarray, ready: np.ndarray, phases: int
) -> np.ndarray:
    """Return the mean number of cycles between two windows of which the second opens in the cycle
    after the tick's own, and the first was over when the own cycle began, float32[ticks].

    weight: float64[n], windows per pulse for each event. ready: float32[cycles], share of the pulses
    in which the tree is armed at a cycle.
    """
    cells = len(ready)
    opened = np.bincount(stamp // phases, weight, minlength=cells)
    over = np.bincount(armed // phases, weight, minlength=cells)[:cells]
    none = 1 - np.minimum(1, opened / ready)
    waited = np.ones(cells)  # cycles from the end of a window to that of one that opens in a cycle
    total = float(over.mean())  # their sum over the pulses in which the tree is armed
    for cycle in range(cells):
        total = over[cycle] + none[cycle - 1] * (total + ready[cycle - 1])
        waited[cycle] = max(1.0, total / ready[cycle])
    return np.repeat(waited + 1, phases).astype(np.float32)


@njit
def _room_found(begin: np.ndarray, end: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """float64[cycles]: share of the intervals from `begin` to `end` in which there was room before
    a cycle of the period.

    begin, end: cycles of the frame. rate: windows per cycle of the period. In each interval,
    windows came before there was room, and none came after.
    """
    cells = len(rate)
    total = np.zeros(cells + 1)
    for k in range(
        cells
    ):  # Numba takes seconds to compile the message of a slice that does not fit
        total[k + 1] = total[k] + rate[k]
    of_period = total[cells]
    total = total[:cells]  # windows since the period began
    grown = np.exp(total)
    shrunk = np.exp(-total)
    found = np.zeros(cells)
    number = np.zeros(cells)
    periods = 1
    if len(end):
        periods = max(1, np.max(end) // cells + 1)
    sums = np.empty(cells * periods)
    for i in range(len(begin)):
        first = begin[i] // cells * of_period + total[begin[i] % cells]
        last = end[i] // cells * of_period + total[end[i] % cells]
        so_far = 0.0
        at = begin[i]
        while at < end[i]:
            period = at // cells
            until = min(end[i], (period + 1) * cells)
            none_after = math.exp(period * of_period - last)
            none_before = math.exp(first - period * of_period)
            for j in range(at, until):
                k = j - period * cells
                so_far += none_after * grown[k] * (1 + RARE - none_before * shrunk[k])
                sums[j - begin[i]] = so_far
            at = until
        for j in range(begin[i], end[i]):
            found[j % cells] += sums[j - begin[i]] / so_far
            number[j % cells] += 1
    for k in range(cells):
        found[k] /= max(1.0, number[k])
    return found


def _share_between(
    begin: np.ndarray, end: np.ndarray, weight: np.ndarray, pulses: int
) -> np.ndarray:
    """float32[ticks]: number of the events that have a tick in [begin, end), per pulse, times the
    tick's weight.
    """
    ticks = len(weight)
    begun = np.bincount(np.minimum(begin, ticks), minlength=ticks + 1)[:ticks]
    ended = np.bincount(np.minimum(end, ticks), minlength=ticks + 1)[:ticks]
    return (np.cumsum(begun - ended) / pulses * weight).astype(np.float32)


class _Ticks(NamedTuple):
    """What is known of the ticks of a subgroup's period, float32[ticks], each per pulse."""

    committed: np.ndarray  # float64[ticks], windows that opened at a tick, in all pulses
    covered: np.ndarray  # windows over a tick
    unarmed: np.ndarray  # windows that are over, after which the tree is not armed again
    stored: np.ndarray  # share of the windows that are stored
    nearby: np.ndarray  # the same for windows with their surroundings; 0 if nothing is dropped
    busy: np.ndarray  # windows after which the tree is armed at the next cycle,
    ready: np.ndarray  # and share in which it is at the tick's own cycle; 0 if nothing is dropped
    gap: np.ndarray  # of `_gap`; 0 if nothing is dropped
    room: np.ndarray  # share with room in the FIFO; 0 if nothing is dropped
    deaf: np.ndarray  # chance that the tree is blind after a rejected window
    seen: np.ndarray  # share of the pulses whose gate is open


class _Shares(NamedTuple):
    """What follows from the share of the windows that become events.

    It is tabulated at even steps of the share's logarithm.
    """

    met: np.ndarray  # float32[SHARES], share of those that would become events with one more pixel
    dark: np.ndarray  # float32[SHARES], probability that no photon came
    low: np.float32  # lowest logarithm
    per: np.float32  # steps per unit of it


@cache
def _shares(law: tuple[Rise, ...]) -> _Shares:
    """Tabulate the shares for a threshold. law: what it means (`rises`)."""
    low = math.log(_event_share(law, 0))
    photons = _photons(law, portable.exp(np.linspace(low, 0, SHARES)))
    met = event_share(law, lambda pixels: _at_least(pixels - 1, photons))
    return _Shares(
        met=met.astype(np.float32),
        dark=portable.exp(-photons).astype(np.float32),
        low=np.float32(low),
        per=np.float32((SHARES - 1) / -low),
    )


def _event_share(law: tuple[Rise, ...], photons: float) -> float:
    """Return the share of the windows that become events; it is never 0.

    photons: in a window, on average.
    """
    share = event_share(law, lambda pixels: special.gammainc(pixels, max(photons, RATE_MIN)))
    return max(float(np.finfo(np.float32).tiny), share)


def _at_least(pixels: int, photons: np.ndarray) -> np.ndarray:
    """Return the share of windows with at least so many photons."""
    return special.gammainc(pixels, photons) if pixels else np.ones(len(photons))


def _photons(law: tuple[Rise, ...], share: np.ndarray) -> np.ndarray:
    """Return the mean photons in a window with which these shares of the windows become events."""
    if len(law) == 1:
        return special.gammaincinv(law[0].pixels, share)
    photons = portable.exp(np.linspace(math.log(RATE_MIN), math.log(PHOTONS_MAX), PHOTON_STEPS))
    return np.interp(share, event_share(law, lambda pixels: _at_least(pixels, photons)), photons)


@njit(error_model="numpy")
def _leave_no_trace(
    of_ticks: _Ticks,
    least: np.float32,
    shares: _Shares,
    every: int,
    kinds: int,
    missed: np.ndarray,
    blind: np.ndarray,
) -> None:
    """Compute missed and blind, float32[2, points], of `Unheard` for one subgroup.

    least: share of the windows that become events by background alone. kinds: 2 if windows are
    dropped, else 1.
    """
    covered = of_ticks.covered
    deaf = of_ticks.deaf
    ticks = len(covered)
    one = np.float32(1)
    highest_place = np.float32(SHARES - 1.001)
    share = np.empty(ticks, np.float32)
    place = np.empty(ticks, np.float32)
    met = np.empty(ticks, np.float32)
    dark = np.empty(ticks, np.float32)
    lost = np.empty(ticks, np.float32)
    unarmed = np.empty(ticks, np.float32)
    for kind in range(kinds):
        for t in range(ticks):
            share[t] = max(covered[t] / (one - deaf[t]), least)
            place[t] = min((fast_log(share[t]) - shares.low) * shares.per, highest_place)
        for t in range(ticks):
            k = np.uint32(place[t])
            beyond = place[t] - np.float32(k)
            met[t] = shares.met[k] + beyond * (shares.met[k + 1] - shares.met[k])
            dark[t] = shares.dark[k] + beyond * (shares.dark[k + 1] - shares.dark[k])
        for t in range(ticks):
            awake = (one - deaf[t]) * (of_ticks.room[t] if kind else one)
            noticed = min(one, max(share[t], of_ticks.nearby[t]) if kind else share[t])
            silent = max(one - awake * noticed, np.float32(RARE))
            lost[t] = one - of_ticks.seen[t] * (one - min(one, (one - awake * met[t]) / silent))
            off = min(np.float32(BLIND_MAX), deaf[t] + of_ticks.busy[t]) if kind else deaf[t]
            armed = min(one - off, of_ticks.ready[t]) * of_ticks.gap[t] if kind else one - off
            unarmed[t] = off / (off + armed * dark[t])
        _mean_over_ticks(lost, every, missed[kind])
        _mean_over_ticks(unarmed, every, blind[kind])


@njit(error_model="numpy")
def _leave_no_trace_in(
    of_ticks: _Ticks,
    signal: np.ndarray,
    noise: float,
    tree: Tree,
    every: int,
    missed: np.ndarray,
    blind: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute missed and blind, float32[points], of `Unheard` for one subgroup with known light,
    where no window is dropped.

    signal, noise: of `unheard_in`. Return by tick, float32[ticks], the chance that the gate is open
    and the photon makes an event, and the chance that the tree is not armed.
    """
    ticks = len(signal)
    one = np.float32(1)
    lost = np.empty(ticks, np.float32)
    unarmed = np.empty(ticks, np.float32)
    kept = np.empty(ticks, np.float32)
    unheard_in(signal, noise, tree, lost, unarmed)
    for t in range(ticks):
        kept[t] = of_ticks.seen[t] * (one - lost[t])
        lost[t] = one - kept[t]
    _mean_over_ticks(lost, every, missed)
    _mean_over_ticks(unarmed, every, blind)
    return kept, unarmed


@njit(error_model="numpy")
def _leave_no_trace_dropping(
    of_ticks: _Ticks,
    kept: np.ndarray,
    unarmed: np.ndarray,
    near: np.ndarray,
    none: np.ndarray,
    every: int,
    missed: np.ndarray,
    blind: np.ndarray,
) -> None:
    """Compute missed and blind, float32[points], of `Unheard` for one subgroup with known light,
    between two events of which the later one carries `overrun`.

    kept, unarmed: of `_leave_no_trace_in`. near, none: of `_company`.
    """
    ticks = len(kept)
    one = np.float32(1)
    lost = np.empty(ticks, np.float32)
    off = np.empty(ticks, np.float32)
    for t in range(ticks):
        room = of_ticks.room[t]
        share = min(one, of_ticks.covered[t])
        met = one - (one - kept[t]) * (one - share)
        # If others fire nearby, their windows were dropped, with this photon or without it.
        noticed = min(one, max(share, of_ticks.nearby[t], near[t]))
        lost[t] = min(one, (one - room * met) / max(one - room * noticed, np.float32(RARE)))
        # A tree that was armed would have opened a window at the first photon of this cycle.
        busy = of_ticks.busy[t]
        # It waits longer than after a window that was over in this cycle, so room is more likely.
        waiting = of_ticks.ready[t] * none[t] * of_ticks.gap[t]
        off[t] = max(unarmed[t], busy / max(np.float32(RARE), busy + waiting))
    _mean_over_ticks(lost, every, missed)
    _mean_over_ticks(off, every, blind)


@part
def _mean_over_ticks(values: np.ndarray, every: int, means: np.ndarray) -> None:
    """Compute the mean of values by tick, over each point's ticks."""
    for j in range(len(means)):
        begin = j * every
        end = min(len(values), (j + 1) * every)
        total = np.float32(0)
        for t in range(begin, end):
            total += values[t]
        means[j] = total / np.float32(end - begin)
