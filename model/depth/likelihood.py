# SPDX-License-Identifier: Apache-2.0
"""Likelihood of the sensor's words as a function of each pixel's surface time, on which the estimator of planes rests.

All of this is our own choice; the paper (IV) takes the peak of every pixel's histogram. A pixel that sees a surface at
time t with `light` photons per pulse fires at the first of them and is dead from then on. So the probability that it has
fired by time u is

    F(u) = 1 - exp(-light * Phi((u - t) / sigma)).

The events of a pulse constrain the firing time of each pixel of the subgroup:

- The winner fired at the stamp.
- A pixel in the map fired inside the window, and not before its minigroup's offset (format full). It fired at that
  offset if it was the first of its minigroup. The probability of this follows from the approximate surface times of the
  other pixels.
- A pixel outside the map did not fire inside the window, nor while the tree waited for its first photon. It may have
  fired while the tree was blind, between the window's end and the re-arming.

If there is no event nearby, there are three possibilities: the pixel did not fire; it fired, and the window missed the
threshold; or the tree was blind after such a window. Their frequencies follow from the share of pulses with an event at
that time. Drops come in bursts: the first windows of a pulse fill the FIFO, and the following ones are lost until there
is room again. So if the later of two events carries `overrun`, the silence between them is informative only from the
time at which there was room; this time follows from the rate of windows.

All likelihoods are relative to a pixel that sees no surface, whose hits are background.
"""

import math
from collections.abc import Callable, Iterable
from functools import cache, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from ..contract.config import Config
from ..contract.packet import BEAT_BITS
from ..contract.parameters import OFFSET_NONE
from ..contract.pixels import pixel_table
from ..contract.windows import armed_cycle, close_cycle
from ..shared.compiled import njit
from .histograms import Events, by_subgroup
from .vector_math import fast_exp, fast_log, top_of

REACH_SIGMAS = 4.0  # from the centre of a pulse to its beginning and end
DEAD_S = 8e-9  # dead time of a SPAD (paper II)
RARE = 1e-6  # lowest probability: effects that the law does not include happen, too
NEVER = -(1 << 40)  # a tick long before any other
QUIET_RATE = 1e-7  # photons per tick and pixel, at least: some background is everywhere
BLIND_MAX = 0.95
DROPPING_ROUNDS = 3  # rounds in which the rate of windows and the stored share of them converge
RATE_MIN = 1e-3  # photons per subgroup and window, at least
SHARES = 512  # shares of events for which the number of photons is tabulated
LIGHT_FLOOR = 0.01  # share of the pixels that is assumed for a light that no pixel has
LEARNING_ROUNDS = 30  # in which the shares of the lights converge
LIGHT_SPAN = 4.0  # lights more than so many times from those of a subgroup's seeds are left out
NEGLIGIBLE = -1.0  # log likelihood ratio below which averaging over the lights is not worth its exponentials
KEPT = 32  # tables of F, at most: those of the next frame are mostly the same
BLOCK = 32  # times that are averaged together
ALIKE = 0.2  # pixels of a minigroup are treated alike if their probabilities to have been first differ by less

Spread = Callable[[Callable[[int], Any], Iterable[int]], Iterable[Any]]  # a `map` that may use any order


class Grid(NamedTuple):
    """Times and lights at which the likelihood is computed.

    step: ticks between times, which are step * (k + 1/2). lights: float32[L], photons per pulse. prior: float32[L], log
    probability of each; None: learned from the pixels whose time the guess knows.
    """

    step: int
    lights: np.ndarray
    prior: np.ndarray | None


class Levels(NamedTuple):
    """Log likelihood ratio, float32, and index of the likeliest light, uint8, both [rows, cols, bins]; the lights' prior."""

    level: np.ndarray
    light: np.ndarray
    prior: np.ndarray


class Guess(NamedTuple):
    """Prior knowledge of the pixels, [subgroups, pixels]: time in ticks (float64, NaN = unknown) and light."""

    time: np.ndarray
    light: np.ndarray


class Unheard(NamedTuple):
    """Probabilities that a firing pixel leaves no trace in a pulse without an event nearby, by its surface's time.

    Both are float32[2, subgroups, points], one point for every `every` ticks. missed: its window misses the threshold, finds
    the tree not armed, or is dropped. blind: it finds the tree not armed, at a time at which a window would have been
    noticed. Index 1 holds between two events of which the later one carries `overrun`; only there are windows dropped.
    """

    missed: np.ndarray
    blind: np.ndarray
    every: int


class _Law(NamedTuple):
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
    fired: np.ndarray  # of `_fired`


class _Events(NamedTuple):
    """Events of a subgroup, by event; times in ticks.

    Events of the same pulse are treated together, as a cluster, if a photon may belong to either.
    """

    stamp: np.ndarray
    armed: np.ndarray  # the tree is armed again
    pulse: np.ndarray
    winner: np.ndarray
    hits: np.ndarray
    offset: np.ndarray
    overrun: np.ndarray
    known: np.ndarray  # from then on until the stamp, the tree was armed and no photon came
    quiet: np.ndarray  # before that, from then on, the tree was armed unless it was blind, because no window ends later
    since: np.ndarray  # `armed` of the previous event of the cluster, `NEVER` for the first one
    clusters: np.ndarray  # first events of the clusters, in groups that differ in their maps only
    alike: np.ndarray  # where in `clusters` each group begins, and where the last one ends
    shares: np.ndarray  # of `_first_shares`, or empty


class _Pixels(NamedTuple):
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


class _Hit(NamedTuple):
    """A hit in [begin, until), or before `own` with the probability `share` of having been its minigroup's first."""

    begin: int
    own: int
    until: int
    share: np.float32


def log_likelihood(
    events: Events,
    config: Config,
    sigma_ticks: float,
    pulses: int,
    grid: Grid,
    never: Unheard,
    first: np.ndarray,
    bins: int,
    *,
    activity: np.ndarray | None = None,
    guess: Guess | None = None,
    spread: Spread = map,
) -> Levels:
    """Return the log likelihood ratio of each pixel's times, as a mean over the lights, and the likeliest light at each.

    pulses: number of pulses in which the events came. never: from `unheard`, for the same events. first:
    int64[subgroups, pixels], index of the pixel's first time in the grid. activity: float64[subgroups, pixels],
    background of each pixel relative to the mean (None: all equal). guess: needed to use offsets, which are ignored
    without it, and to learn the prior. spread: a `map` over subgroups that may use any order.
    """
    sensor = config.sensor
    reach = math.ceil(REACH_SIGMAS * sigma_ticks)
    minigroup = pixel_table(sensor).minigroup
    level, light = (np.empty((sensor.array_pixels, bins), kind) for kind in (np.float32, np.uint8))
    place = by_subgroup(np.arange(sensor.array_pixels), sensor)
    if activity is None:
        activity = np.ones((sensor.subgroups, sensor.pixels))
    offsets = guess is not None and events.offset.shape[1] > 0
    of_subgroup = _by_subgroup(events, config, pulses, reach, offsets)
    times = -(-(config.period_ticks - grid.step // 2) // grid.step)
    origins = np.clip(first.min(axis=1), 0, times - 1)
    spans = np.clip(first.max(axis=1) + bins, origins + 1, times) - origins
    chosen = [_lights_near(guess, s, config.mask[s], grid.lights) for s in range(sensor.subgroups)]
    fired = partial(_fired, sigma_ticks, reach, grid.step, 1 << int(spans.max() - 1).bit_length())

    def evidence(s: int) -> tuple[np.ndarray, _Pixels]:
        lights, origin, span = grid.lights[chosen[s]], int(origins[s]), int(spans[s])
        noise = max(events.photon_rate[s] / sensor.pixels, QUIET_RATE)
        alive = np.float32(1 - min(BLIND_MAX, noise * DEAD_S / config.tick_s))
        window, own = int(events.window[s]), of_subgroup[s]
        kinds = 1 + int(own.overrun.any())
        heard, sharp = (
            _heard(chance[:kinds, s], never.every, origin, span, grid.step, len(lights), alive)
            for chance in (never.missed, never.blind)
        )
        margin, table = fired(tuple(lights.tolist()))
        law = _Law(
            window=window,
            told=window if events.mapped else 1,
            phases=sensor.phases,
            offset=sensor.offset_ticks,
            reach=reach,
            step=grid.step,
            origin=origin,
            lights=len(lights),
            noise=noise,
            alive=alive,
            pulses=pulses,
            heard=heard,
            sharp=sharp,
            margin=margin,
            fired=table,
        )
        if guess is not None and offsets:
            own = own._replace(shares=_first_shares(law, own, minigroup, guess.time[s], guess.light[s], sigma_ticks))
        pixels = _Pixels(
            minigroup=minigroup,
            mask=config.mask[s],
            activity=activity[s],
            first=first[s] - origin,
            total=np.empty((sensor.pixels, bins * len(lights)), np.float32),
            touched=np.zeros((sensor.pixels, bins), np.bool_),
            counted=np.full(sensor.pixels, -1),
            number=np.empty((2, sensor.pixels), np.int64),
            hit=np.empty(sensor.pixels, np.int64),
        )
        return _add_events(law, own, pixels), pixels

    def average(s: int, prior: np.ndarray, common: np.ndarray, pixels: _Pixels) -> None:
        near = np.ascontiguousarray((_of_met(prior) if events.threshold[s] > 1 else prior)[chosen[s]])
        _over_lights(common, pixels, near, chosen[s].start, place[s], level, light)

    subgroups = range(sensor.subgroups)
    if grid.prior is not None:
        prior = grid.prior
        list(spread(lambda s: average(s, prior, *evidence(s)), subgroups))
    else:
        assert guess is not None
        found: list[tuple[np.ndarray, _Pixels]] = list(spread(evidence, subgroups))
        known = config.mask & ~np.isnan(guess.time)
        chance = np.zeros((sensor.subgroups, sensor.pixels, len(grid.lights)), np.float32)
        list(spread(lambda s: _of_lights(*found[s], known[s], chance[s, :, chosen[s]]), subgroups))
        prior = _learned(chance[known])
        list(spread(lambda s: average(s, prior, *found[s]), subgroups))
    shape = (sensor.rows, sensor.cols, bins)
    return Levels(level.reshape(shape), light.reshape(shape), prior)


def _lights_near(guess: Guess | None, s: int, mask: np.ndarray, lights: np.ndarray) -> slice:
    """Return the lights that the pixels of subgroup s may have: all of them without a guess."""
    known = np.empty(0) if guess is None else guess.light[s][mask & ~np.isnan(guess.time[s])]
    if not len(known):
        return slice(0, len(lights))
    low, high = np.searchsorted(lights, (known.min() / LIGHT_SPAN, known.max() * LIGHT_SPAN)).tolist()
    return slice(max(0, low - 1), min(len(lights), high + 1))


def _of_met(prior: np.ndarray) -> np.ndarray:
    """Return the prior for windows that met a threshold above 1: no light counts as rarer than a brighter one.

    Among these windows, dark pixels are hit more often than the law says, and look brighter than they are.
    """
    return np.maximum.accumulate(prior[::-1])[::-1]


def _learned(chance: np.ndarray) -> np.ndarray:
    """float32[lights]: log share of the pixels with each light; the shares make the pixels likeliest.

    chance: float32[n, lights], likelihood of each light, in a unit of the pixel's own.
    """
    share = np.full(chance.shape[1], 1 / chance.shape[1])
    for _ in range(LEARNING_ROUNDS if len(chance) else 0):
        share = share * _gain(chance, share) / len(chance)
    share += LIGHT_FLOOR
    return np.log(share / share.sum()).astype(np.float32)


@njit
def _gain(chance, share):
    """float64[lights]: sum over the pixels of each light's likelihood, relative to the mean over the lights."""
    gain = np.zeros(len(share))
    for i in range(len(chance)):
        mean = 0.0
        for x in range(len(share)):
            mean += chance[i, x] * share[x]
        for x in range(len(share)):
            gain[x] += chance[i, x] / mean
    return gain


@lru_cache(KEPT)
def _fired(sigma_ticks: float, reach: int, step: int, span: int, lights: tuple[float, ...]) -> tuple[int, np.ndarray]:
    """Return a margin, and F for ticks u and times t of a grid: float32[step * columns * lights], by row and column.

    Row r is for ticks u with (u + reach) % step = r. Then F for consecutive times is a contiguous part of the row: its
    column is `margin`, less the number of steps from t to u + reach. `margin` columns to both sides are enough for `span`
    times.
    """
    distance = np.arange(-2 * reach, 2 * reach + 1) / 2
    fired = -np.expm1(-special.ndtr(distance / sigma_ticks)[:, None] * np.array(lights)).astype(np.float32)
    margin = span + 2 * reach // step + 2
    half_ticks = 2 * np.arange(step)[:, None] + step * (2 * (margin - np.arange(2 * margin + span)) - 1)
    return margin, fired[np.clip(half_ticks, 0, 4 * reach)].ravel()


def _gate_opens(events: Events, config: Config) -> np.ndarray:
    """int64[n]: tick at which the gate opened in each event's pulse, 0 without gating."""
    subgroup = np.repeat(np.arange(config.sensor.subgroups), np.diff(events.bounds))
    steps = 0
    if config.frame["gate_every"]:
        steps = events.pulse % config.pulses // config.frame["gate_every"] % config.frame["gate_steps"]
    opens = (config.gate_start[subgroup] + config.frame["gate_step"] * steps) * config.sensor.phases
    return np.where(config.gating[subgroup], opens, 0)


@lru_cache(1)  # grids of a frame follow each other
def _by_subgroup(events: Events, config: Config, pulses: int, reach: int, offsets: bool) -> list[_Events]:
    """Return the events of each subgroup, without shares. offsets: are they used? Then no event is like another."""
    sensor = config.sensor
    subgroup = np.repeat(np.arange(sensor.subgroups), np.diff(events.bounds))
    stamp, pulse, overrun = events.stamp, events.pulse % pulses, events.overrun
    armed = armed_ticks(stamp, events.window[subgroup], config)
    with_next = (pulse[1:] == pulse[:-1]) & (subgroup[1:] == subgroup[:-1])  # in the same pulse
    previous = np.full(len(stamp), -1)  # `armed` of the event before, if it was in the same pulse
    previous[1:][with_next] = armed[:-1][with_next]
    earliest, cycle = np.maximum(_gate_opens(events, config), previous), stamp // sensor.phases * sensor.phases
    known = np.minimum(stamp, np.maximum(earliest, cycle))
    quiet_from = cycle - sensor.rearm * sensor.phases - events.window[subgroup] + 1
    quiet = np.minimum(known, np.maximum(earliest, quiet_from))
    since = np.where((previous >= 0) & (quiet <= previous + 2 * reach), np.minimum(previous, quiet), NEVER)
    followed = np.append(overrun[1:], False)  # does the next event carry `overrun`, or the last one itself?
    last = events.bounds[1:][np.diff(events.bounds) > 0] - 1
    followed[last] = overrun[last]
    kind = ((subgroup * config.period_ticks + stamp) * 2 + overrun) * 2 + followed
    clusters = np.flatnonzero(since == NEVER)
    clusters = clusters[np.argsort(kind[clusters], kind="stable")]
    alone = np.append(since[1:] == NEVER, True)[clusters] & (not offsets)
    same = alone[1:] & alone[:-1]
    for part in (kind, known, quiet):
        same &= part[clusters[1:]] == part[clusters[:-1]]
    bounds = np.searchsorted(subgroup[clusters], np.arange(sensor.subgroups + 1))
    begins = np.concatenate([np.ones(min(1, len(clusters)), bool), ~same])

    def of_subgroup(s: int) -> _Events:
        span, here = slice(events.bounds[s], events.bounds[s + 1]), slice(bounds[s], bounds[s + 1])
        parts = stamp, armed, pulse, events.winner, events.hits, events.offset, overrun, known, quiet, since
        alike = np.append(np.flatnonzero(begins[here]), bounds[s + 1] - bounds[s])
        own = clusters[here] - events.bounds[s], alike, np.empty((0, 0), np.float32)
        return _Events._make([*(part[span] for part in parts), *own])

    return [of_subgroup(s) for s in range(sensor.subgroups)]


def unheard(events: Events, config: Config, pulses: int, sigma_ticks: float, spread: Spread = map) -> Unheard:
    """Estimate from the subgroups' events how often photons leave no trace.

    pulses: number of pulses in which the events came; spread: as in `log_likelihood`.
    """
    sensor, ticks, every = config.sensor, config.period_ticks, max(1, int(sigma_ticks))
    missed, blind = (np.empty((2, sensor.subgroups, -(-ticks // every)), np.float32) for _ in range(2))
    phase = np.arange(sensor.phases)
    after_rejected = (phase + sensor.rearm * sensor.phases).astype(np.float64)  # mean blind ticks, by phase
    none, all_seen = np.zeros(ticks, np.float32), np.ones(ticks, np.float32)
    reach = math.ceil(REACH_SIGMAS * sigma_ticks)
    taps = np.arange(-(reach // every), reach // every + 1) * every
    pulse = np.exp(-0.5 * taps**2 / (sigma_ticks**2 - (every**2 - 1) / 12))  # a point is a mean over its ticks already
    shape = (pulse / pulse.sum()).astype(np.float32)

    def of_subgroup(s: int) -> None:
        window, committed = int(events.window[s]), events.committed[s]
        span = slice(events.bounds[s], events.bounds[s + 1])
        stamp, overrun = events.stamp[span], events.overrun[span]
        armed, dropping = armed_ticks(stamp, window, config), bool(overrun.any())
        kept = np.ones(ticks)
        if dropping:
            kept, found = _while_dropping(events.pulse[span] % pulses, stamp, armed, overrun, committed, pulses, config)
        dropped = 1 / kept
        dropped *= committed / max(1.0, dropped[stamp].sum())  # windows per stored window
        rejected = (events.opened[s] - committed) / pulses / ticks  # windows per tick
        threshold = int(events.threshold[s])
        _leave_no_trace(
            _share_between(stamp, stamp + window, dropped, pulses),
            np.minimum(1, _share_between(np.maximum(0, stamp - reach), armed, dropped, pulses)) if dropping else none,
            _share_between(stamp, armed, dropped, pulses) if dropping else none,
            found.astype(np.float32) if dropping else none,
            np.tile(np.minimum(BLIND_MAX, rejected * after_rejected).astype(np.float32), config.period),
            np.repeat(_gate_share(config, s), sensor.phases).astype(np.float32) if config.gating[s] else all_seen,
            np.float32(_event_share(threshold, events.photon_rate[s] * window)),
            _shares(threshold),
            shape,
            every,
            1 + dropping,
            missed[:, s],
            blind[:, s],
        )
        if not dropping:
            missed[1, s], blind[1, s] = missed[0, s], blind[0, s]

    list(spread(of_subgroup, range(sensor.subgroups)))
    return Unheard(missed, blind, every)


class _Shares(NamedTuple):
    """What follows from the share of the windows that become events, float32, at even steps of the share's logarithm.

    met: share of those that would become events with one more pixel. dark: probability that no photon came. low: lowest
    logarithm. per: steps per unit of it.
    """

    met: np.ndarray
    dark: np.ndarray
    low: np.float32
    per: np.float32


@cache
def _shares(threshold: int) -> _Shares:
    low = math.log(_event_share(threshold, 0))
    photons = special.gammaincinv(threshold, np.exp(np.linspace(low, 0, SHARES)))
    met = special.gammainc(threshold - 1, photons) if threshold > 1 else np.ones(SHARES)
    per = np.float32((SHARES - 1) / -low)
    return _Shares(met.astype(np.float32), np.exp(-photons).astype(np.float32), np.float32(low), per)


def _event_share(threshold: int, photons: float) -> float:
    """Return the share of the windows with at least `threshold` photons; it is never 0."""
    return max(float(np.finfo(np.float32).tiny), special.gammainc(threshold, max(photons, RATE_MIN)))


@njit(error_model="numpy")
def _leave_no_trace(covered, nearby, busy, found, deaf, seen, least, shares, pulse, every, kinds, missed, blind):
    """Compute missed and blind, float32[2, points], of `Unheard` for one subgroup.

    It is the mean over the arrival times of a surface's photons, by the shape of the pulse. covered to seen: float32[ticks].
    covered: windows over a tick, per pulse; while dropping:
    nearby, busy: the same for windows with their surroundings, and until the tree is armed; found: share with room.
    least: share of the windows that become events by background alone.
    """
    ticks, points, reach, one = len(covered), missed.shape[1], len(pulse) // 2, np.float32(1)
    share, place, met, dark, lost, unarmed = np.empty((6, ticks), np.float32)
    line = np.empty(points + 2 * reach, np.float32)
    for kind in range(kinds):
        for t in range(ticks):
            share[t] = max(covered[t] / (one - deaf[t]), least)
            place[t] = min((fast_log(share[t]) - shares.low) * shares.per, np.float32(SHARES - 1.001))
        for t in range(ticks):
            k = np.uint32(place[t])
            part = place[t] - np.float32(k)
            met[t] = shares.met[k] + part * (shares.met[k + 1] - shares.met[k])
            dark[t] = shares.dark[k] + part * (shares.dark[k + 1] - shares.dark[k])
        for t in range(ticks):
            awake = (one - deaf[t]) * (found[t] if kind else one)
            noticed = min(one, max(share[t], nearby[t]) if kind else share[t])
            silent = max(one - awake * noticed, np.float32(RARE))
            lost[t] = one - seen[t] * (one - min(one, (one - awake * met[t]) / silent))
            off = min(np.float32(BLIND_MAX), deaf[t] + busy[t]) if kind else deaf[t]
            unarmed[t] = off / (off + (one - off) * dark[t])
        for of_ticks, out in ((lost, missed[kind]), (unarmed, blind[kind])):
            for j in range(points):
                begin, end, total = j * every, min(ticks, (j + 1) * every), np.float32(0)
                for t in range(begin, end):
                    total += of_ticks[t]
                line[reach + j] = total / np.float32(end - begin)
            for i in range(reach):
                line[i], line[reach + points + i] = line[reach], line[reach + points - 1]
            for j in range(points):
                out[j] = 0
            for i in range(len(pulse)):
                for j in range(points):
                    out[j] += pulse[i] * line[i + j]


def armed_ticks(stamp: np.ndarray, window: int | np.ndarray, config: Config) -> np.ndarray:
    """int64[n]: tick at which the tree is armed again after events at `stamp`."""
    phases = config.sensor.phases
    return armed_cycle(close_cycle(stamp + (window - 1), 1, phases), config.sensor.rearm) * phases


def _while_dropping(
    pulse: np.ndarray,
    stamp: np.ndarray,
    armed: np.ndarray,
    overrun: np.ndarray,
    committed: int,
    pulses: int,
    config: Config,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (share of windows that are stored, the same between two events of which the later has `overrun`), float64[ticks].

    After an event was stored, the FIFO was full, and windows were dropped until there was room. From then on, no window
    came until the next event. The time at which there was room follows from the rate of windows, and this rate follows
    from the share that is stored.
    """
    phases, cells = config.sensor.phases, config.period
    later = np.flatnonzero(overrun[1:]) + 1
    begin, end = pulse * cells + armed // phases, pulse * cells + stamp // phases
    full = np.zeros(cells + 1)
    np.add.at(full, np.minimum(armed // phases, cells)[later - 1], 1)
    np.add.at(full, (stamp // phases)[later], -1)
    clear = 1 - (np.cumsum(full)[:cells] + (pulse[later] - pulse[later - 1]).sum()) / pulses
    kept, found = np.clip(clear, 1 / pulses, 1), np.zeros(cells)
    for _ in range(DROPPING_ROUNDS if len(later) else 0):
        rate = np.bincount(stamp // phases, minlength=cells) / kept
        rate *= committed / pulses / rate.sum()
        found = _room_found(begin[later - 1], end[later], rate)
        kept = np.clip(clear + (1 - clear) * found, 1 / pulses, 1)
    return np.repeat(kept, phases), np.repeat(found, phases)


@njit
def _room_found(begin, end, rate):
    """float64[cycles]: share of the intervals from `begin` to `end` in which there was room before a cycle of the period.

    begin, end: cycles of the frame. rate: windows per cycle of the period. In each interval, windows came before there
    was room, and none came after.
    """
    cells = len(rate)
    total = np.zeros(cells + 1)
    total[1:] = np.cumsum(rate)
    of_period, total = total[cells], total[:cells]
    grown, shrunk = np.exp(total), np.exp(-total)  # windows since the period began
    found, number = np.zeros(cells), np.zeros(cells)
    sums = np.empty(cells * max(1, (np.max(end) if len(end) else 0) // cells + 1))
    for i in range(len(begin)):
        first = begin[i] // cells * of_period + total[begin[i] % cells]
        last = end[i] // cells * of_period + total[end[i] % cells]
        so_far, at = 0.0, begin[i]
        while at < end[i]:
            period = at // cells
            until, none_after, none_before = (
                min(end[i], (period + 1) * cells),
                math.exp(period * of_period - last),
                math.exp(first - period * of_period),
            )
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


@njit
def _share_between(begin, end, weight, pulses):
    """float32[ticks]: number of the events that have a tick in [begin, end), per pulse, times the tick's weight."""
    ticks = len(weight)
    change = np.zeros(ticks + 1)
    for e in range(len(begin)):
        change[min(begin[e], ticks)] += 1
        change[min(end[e], ticks)] -= 1
    share = np.empty(ticks, np.float32)
    total = 0.0
    for k in range(ticks):
        total += change[k]
        share[k] = total / pulses * weight[k]
    return share


def _gate_share(config: Config, s: int) -> np.ndarray:
    """float64[cycles]: share of the pulses whose gate is open in each cycle of the period."""
    start = config.gate_start[s] + np.zeros(1, np.int64)
    if config.frame["gate_every"]:
        pulse = np.arange(config.pulses)
        start = start + config.frame["gate_step"] * (pulse // config.frame["gate_every"] % config.frame["gate_steps"])
    start, pulses = np.unique(start, return_counts=True)
    cycle = np.arange(config.period)[:, None]
    return ((cycle >= start) & (cycle < start + config.gate_len[s])) @ (pulses / pulses.sum())


@njit
def _first_shares(law, events, minigroup, time, light, sigma):
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
                if minigroup[i] == g and _hit(hits, e, i):
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


@njit(allocates=False)
def _unfired(distance, light, sigma):
    """Return 1 - F."""
    return math.exp(-light * 0.5 * math.erfc(-distance / sigma * math.sqrt(0.5)))


@njit(allocates=False)
def _hit(hits, e, i):
    return hits[e, i // BEAT_BITS] >> np.uint64(i % BEAT_BITS) & np.uint64(1) != 0


@njit
def hits_away(stamp, hits, bounds, time, near):
    """int64[subgroups, pixels]: each pixel's hits in events whose stamp is not `near` the pixel's time, or whose time is NaN."""
    number = np.zeros(time.shape, np.int64)
    for s in range(len(time)):
        of_subgroup, times = number[s], time[s]
        for e in range(bounds[s], bounds[s + 1]):
            for i in range(len(times)):
                of_subgroup[i] += np.int64(_hit(hits, e, i) and not abs(stamp[e] - times[i]) < near)
    return number


@njit
def _heard(silent, every, origin, span, step, lights, alive):
    """float32[kinds, span * lights]: `_Law.heard` or `_Law.sharp`; silent: float32[kinds, points], as in `Unheard`."""
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


@njit
def _add_events(law, events, pixels):
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
            k0, _ = _reached(law, events.quiet[e], armed[e], times)
            _add_silence(silent[np.int64(overrun[e])], since_pulse, since, pulse[e], k0)
        _, since = _reached(law, events.quiet[e], armed[e], times)
        since_pulse = pulse[e]
    for run in range(len(events.alike) - 1):
        alike = events.clusters[events.alike[run] : events.alike[run + 1]]
        begin, frequency = alike[0], np.float32(len(alike))
        end = begin + 1
        while end < n and events.since[end] != NEVER:
            end += 1
        k0, k1 = _reached(law, events.quiet[begin], armed[end - 1], times)
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
    always = _fired_by(law, -NEVER, 0)
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


@njit(allocates=False)
def _reached(law, begin, end, times):
    """Return the times of surfaces whose photons come between two ticks, the first one and the one after the last."""
    k0 = (begin - law.reach) // law.step - law.origin
    k1 = (end + law.reach) // law.step + 1 - law.origin
    return min(times, max(0, k0)), min(times, max(0, k1))


@njit(allocates=False)
def _add_silence(silent, from_pulse, since, to_pulse, until):
    """Count the pulses without an event nearby, from time `since` of one pulse to time `until` of another."""
    silent[since] += 1
    silent[until] -= 1
    silent[0] += to_pulse - from_pulse


@njit(allocates=False)
def _fired_by(law, tick, k0):
    """Return where `law.fired` has F at a tick for the surfaces from time k0 on, and all lights."""
    steps = (tick + law.reach) // law.step
    column = min(max(law.margin - steps + law.origin + k0, 0), 2 * law.margin)
    row = tick + law.reach - steps * law.step
    return row * (len(law.fired) // law.step) + column * law.lights


@njit(allocates=False)
def _lose(law, events, e, lost, k0, k1):
    """Add event e to `lost`: a pixel outside its map did not fire in the window, nor between the last event and it.

    Before `quiet`, its photon would have made an event of its own; before `known`, it would have made this event's stamp
    earlier.
    """
    dropping, here = np.int64(events.overrun[e]), slice(k0 * law.lights, k1 * law.lights)
    z, a = _fired_by(law, events.since[e], k0), _fired_by(law, events.quiet[e], k0)
    b, c = _fired_by(law, events.known[e], k0), _fired_by(law, events.stamp[e] + law.told, k0)
    n, fired = (k1 - k0) * law.lights, law.fired
    z, a, b, c = fired[z : z + n], fired[a : a + n], fired[b : b + n], fired[c : c + n]
    heard, sharp, alive, lost = law.heard[0, here], law.sharp[dropping, here], law.alive, lost[here]
    stored = np.float32(not dropping)
    for j in range(len(lost)):
        lost[j] += alive * (c[j] - b[j]) + sharp[j] * (b[j] - a[j]) + stored * heard[j] * (a[j] - z[j])


@njit(allocates=False)
def _lose_after(law, armed, lost, k0, k1):
    """Add the silence after the last event of a pulse to `lost`."""
    here, n = slice(k0 * law.lights, k1 * law.lights), (k1 - k0) * law.lights
    d, f = _fired_by(law, armed, k0), _fired_by(law, -NEVER, k0)
    d, f, heard, lost = law.fired[d : d + n], law.fired[f : f + n], law.heard[0, here], lost[here]
    for j in range(len(lost)):
        lost[j] += heard[j] * (f[j] - d[j])


@njit(allocates=False)
def _not_lost(lost, frequency, unseen, common):
    """Compute `unseen` from `lost`, and add it to `common` so many times."""
    for j in range(len(lost)):
        unseen[j] = fast_log(max(np.float32(RARE), np.float32(1) - lost[j]))
        common[j] += frequency * unseen[j]


@njit(allocates=False)
def _add_hits(law, events, e, cluster, alike, pixels, rows, k0, k1):
    """Add what event e, and single events `alike` it, say about the pixels in their maps; pixels of a kind share a row."""
    mask, activity, first, counted = pixels.mask, pixels.activity, pixels.first, pixels.counted
    bins, offset, shares = pixels.touched.shape[1], events.offset, events.shares
    stamp, winner = events.stamp[e], events.winner[e]
    cycle, end = stamp // law.phases * law.phases, stamp + law.window
    k0 = max(k0, _reached(law, events.known[e], end, k1)[0])  # earlier surfaces, before which a hit is like none
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
                    _row(law, events, e, _Hit(begin, own, until, share), law.noise * activity[i], rows, low, high)
                of_row = share if activity[i] == 1 else np.float32(-1.0)
            _add(pixels.total[i], pixels.touched[i], rows.logs, np.float32(number), first[i], k0, k1, law.lights)


@njit(allocates=False)
def _count(hits, winner, e, alike, number, hit):
    """Count how often each pixel was hit without winning, and won, in event e and those alike: int64[2, pixels].

    Write the pixels with a hit to `hit`, and return their number.
    """
    for i in range(number.shape[1]):
        number[0, i], number[1, i] = 0, 0
    for k in range(len(alike)):
        x = alike[k] if k else e
        for i in range(number.shape[1]):
            number[0, i] += np.int64(hits[x, i // BEAT_BITS] >> np.uint64(i % BEAT_BITS) & np.uint64(1))
        number[0, winner[x]] -= 1
        number[1, winner[x]] += 1
    n = 0
    for i in range(number.shape[1]):
        if number[0, i] or number[1, i]:
            hit[n] = i
            n += 1
    return n


@njit(allocates=False, error_model="numpy")
def _row(law, events, e, hit, noise, rows, k0, k1):
    """Compute logs[k0:k1] of `rows`: the likelihood ratio of a hit of event e.

    It is relative to the likelihood of no hit, which all pixels get. What precedes the hit is as in `_lose`.
    """
    dropping, here = np.int64(events.overrun[e]), slice(k0 * law.lights, k1 * law.lights)
    z, a = _fired_by(law, events.since[e], k0), _fired_by(law, events.quiet[e], k0)
    b, c = _fired_by(law, events.known[e], k0), _fired_by(law, hit.begin, k0)
    d, f = _fired_by(law, hit.own, k0), _fired_by(law, hit.until, k0)
    n, fired = (k1 - k0) * law.lights, law.fired
    z, a, b = fired[z : z + n], fired[a : a + n], fired[b : b + n]
    c, d, f = fired[c : c + n], fired[d : d + n], fired[f : f + n]
    heard, sharp, alive = law.heard[0, here], law.sharp[dropping, here], law.alive
    before, unseen, logs = rows.before[here], rows.unseen[here], rows.logs[here]
    stored, share = np.float32(not dropping), hit.share
    background = np.float32(1 / (noise * (share * (hit.own - hit.begin) + (1 - share) * (hit.until - hit.begin))))
    weight = alive * background
    for j in range(len(logs)):
        lost = alive * (c[j] - b[j]) + sharp[j] * (b[j] - a[j]) + stored * heard[j] * (a[j] - z[j])
        earlier = max(np.float32(RARE), np.float32(1) - before[j] - lost)
        inside = f[j] + share * (d[j] - f[j]) - c[j]
        logs[j] = fast_log(weight * inside + earlier) - unseen[j]


@njit(allocates=False)
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
def _of_lights(common, pixels, known, chance):
    """Compute chance, float32[pixels, lights]: sum of a known pixel's likelihoods over its times, in a unit of its own."""
    total, touched, first = pixels.total, pixels.touched, pixels.first
    lights = chance.shape[1]
    bins, times = touched.shape[1], len(common) // lights
    line = np.empty(bins * lights, np.float32)
    for i in range(len(total)):
        low, high = max(0, -first[i]), min(bins, times - first[i])
        if not known[i] or high <= low:
            continue
        for k in range(low, high):
            if not touched[i, k]:
                touched[i, k] = True
                total[i, k * lights : (k + 1) * lights] = 0
        here = common[(first[i] + low) * lights : (first[i] + high) * lights]
        own, of_pixel = total[i, low * lights : high * lights], line[low * lights : high * lights]
        for j in range(len(own)):
            of_pixel[j] = here[j] + own[j]
        top = top_of(of_pixel)
        for j in range(len(own)):
            of_pixel[j] = fast_exp(of_pixel[j] - top)
        for k in range(low, high):
            for x in range(lights):
                chance[i, x] += line[k * lights + x]


@njit
def _over_lights(common, pixels, prior, lightest, place, level, light):
    """Compute the logarithm of the mean over the lights, and the likeliest light; a masked pixel favours no time.

    lightest: index of the first light in the grid. `common` is used up.
    """
    total, touched, mask, first = pixels.total, pixels.touched, pixels.mask, pixels.first
    lights = len(prior)
    times = len(common) // lights
    work = np.zeros((lights, BLOCK), np.float32), np.zeros(BLOCK, np.float32), np.zeros(BLOCK, np.float32)
    best = np.zeros(BLOCK, np.int32)
    level_of_all, light_of_all = np.empty(times, np.float32), np.empty(times, np.uint8)
    line = np.empty(BLOCK * lights, np.float32)
    for k in range(times):
        for x in range(lights):
            common[k * lights + x] += prior[x]
    for k in range(0, times, BLOCK):
        end = min(times, k + BLOCK)
        _mean(common[k * lights : end * lights], lightest, work, best, level_of_all[k:end], light_of_all[k:end])
    for i in range(len(total)):
        if mask[i]:
            own = total[i], touched[i], first[i], level[place[i]], light[place[i]]
            _over_lights_of(*own, common, lightest, work, best, level_of_all, light_of_all, line)
        else:
            level[place[i]], light[place[i]] = 0, 0


@njit(allocates=False)
def _over_lights_of(
    total, touched, first, level, light, common, lightest, work, best, level_of_all, light_of_all, line
):
    """Compute the levels and lights of a pixel, which are those of all pixels where no event hit it."""
    lights, bins = len(work[0]), len(touched)
    low, high = max(0, -first), min(bins, len(level_of_all) - first)
    high = max(low, high)
    level[:low], light[:low], level[high:], light[high:] = 0, 0, 0, 0
    _copy(level_of_all[first + low : first + high], level[low:high])
    _copy(light_of_all[first + low : first + high], light[low:high])
    k = low
    while k < high:
        end, most = k, min(high, k + BLOCK)
        while end < most and touched[end]:
            end += 1
        if end == k:
            k += 1
            continue
        here, own = common[(first + k) * lights : (first + end) * lights], total[k * lights : end * lights]
        for j in range(len(own)):
            line[j] = here[j] + own[j]
        _mean(line[: len(own)], lightest, work, best, level[k:end], light[k:end])
        k = end


@njit(allocates=False)
def _copy(source, target):
    for k in range(len(target)):
        target[k] = source[k]


@njit(allocates=False)
def _mean(line, lightest, work, best, level, light):
    """Compute the mean over the lights and the likeliest light of at most `BLOCK` times.

    work: values, float32[lights, BLOCK], and two float32[BLOCK]; best: int32[BLOCK]. All loops over times have the same
    length, so that they compile to vector code without a remainder.
    """
    values, top, ratio = work
    n, lights = len(level), len(values)
    for k in range(n):
        for x in range(lights):
            values[x, k] = line[k * lights + x]
    for k in range(BLOCK):
        top[k], best[k], ratio[k] = values[0, k], 0, 0
    for x in range(1, lights):
        for k in range(BLOCK):
            best[k] = x if values[x, k] > top[k] else best[k]
            top[k] = max(values[x, k], top[k])
    highest = np.float32(NEGLIGIBLE)
    for k in range(n):
        level[k], light[k] = top[k], best[k] + lightest
        highest = max(highest, top[k])
    if highest > NEGLIGIBLE:
        for x in range(lights):
            for k in range(BLOCK):
                ratio[k] += fast_exp(values[x, k] - top[k])
        for k in range(BLOCK):
            ratio[k] = fast_log(ratio[k])
        for k in range(n):
            level[k] = top[k] + (ratio[k] if top[k] > NEGLIGIBLE else np.float32(0))
