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
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from scipy import ndimage, special

from ..contract.config import Config
from ..contract.packet import BEAT_BITS
from ..contract.parameters import OFFSET_NONE
from ..contract.pixels import pixel_table
from ..contract.windows import armed_cycle, close_cycle
from ..shared.compiled import njit
from .histograms import Events, by_subgroup

REACH_SIGMAS = 4.0  # from the centre of a pulse to its beginning and end
DEAD_S = 8e-9  # dead time of a SPAD (paper II)
RARE = 1e-6  # lowest probability: effects that the law does not include happen, too
QUIET_RATE = 1e-7  # photons per tick and pixel, at least: some background is everywhere
BLIND_MAX = 0.95
DROPPING_ROUNDS = 3  # rounds in which the rate of windows and the stored share of them converge
RATES = np.geomspace(1e-3, 50, 200)  # photons per subgroup and window, over which the share of events is tabulated
LIGHT_FLOOR = 0.01  # share of the pixels that is assumed for a light that no pixel has
LEARNING_ROUNDS = 30  # in which the shares of the lights converge
FAINT = -15.0  # log likelihood relative to the best time: less likely times add nothing
NEGLIGIBLE = -1.0  # log likelihood ratio below which averaging over the lights is not worth its exponentials
ALIKE = 0.2  # pixels of a minigroup are treated alike if their probabilities to have been first differ by less

_FRACTION_BITS = 23  # of a float32
_LOG = (
    np.polynomial.chebyshev.Chebyshev.interpolate(np.log1p, 7, domain=[0, 1])
    .convert(kind=np.polynomial.Polynomial)
    .coef.astype(np.float32)
)  # log(1 + x), error below 1e-7


Result = TypeVar("Result")


class Spread(Protocol):
    """A `map` that may use any order."""

    def __call__(self, function: Callable[[int], Result], items: Iterable[int], /) -> Iterable[Result]: ...


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

    All are float32[subgroups, ticks]. missed: its window misses the threshold, finds the tree not armed, or is dropped.
    blind: it finds the tree not armed, at a time at which a window would have been noticed. `_dropping`: between two
    events of which the later one carries `overrun`; only there are windows dropped.
    """

    missed: np.ndarray
    missed_dropping: np.ndarray
    blind: np.ndarray
    blind_dropping: np.ndarray


class _Law(NamedTuple):
    """What holds for all events of a subgroup; times in ticks."""

    window: int
    told: int  # ticks of the window whose hits are known: all of them, or the first (format short)
    phases: int
    rearm: int
    offset: int  # ticks per step of an offset
    reach: int
    step: int
    noise: float  # background photons per tick and pixel
    alive: float  # share of the pulses in which background has not fired the pixel yet
    pulses: int
    missed: np.ndarray  # float32[2, times]: of `Unheard`, otherwise and while dropping
    blind: np.ndarray  # the same
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
    since: np.ndarray  # `armed` of the previous event of the cluster, -1 for the first one
    shares: np.ndarray  # of `_first_shares`, or empty


class _Silence(NamedTuple):
    """The time before an event's stamp: three of its `_Events`, and whether windows were dropped then."""

    since: int
    quiet: int
    known: int
    dropping: int


class _Pixels(NamedTuple):
    """Pixels of a subgroup, and what the events that hit them say, float32[pixels, bins, lights], logarithms.

    total: valid only where `touched`, bool[pixels, bins], is set.
    """

    minigroup: np.ndarray
    mask: np.ndarray
    activity: np.ndarray
    first: np.ndarray
    total: np.ndarray
    touched: np.ndarray
    counted: np.ndarray  # first event of the cluster in which the pixel was hit last


class _Rows(NamedTuple):
    """Workspace of a cluster, float32[times, lights].

    unseen: likelihood of no hit; before: the same before the present event; product, logs: of a pixel with a hit.
    """

    unseen: np.ndarray
    before: np.ndarray
    product: np.ndarray
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
    fired = _fired(grid.lights, sigma_ticks, reach)
    minigroup = pixel_table(sensor).minigroup
    level, light = (np.empty((sensor.array_pixels, bins), kind) for kind in (np.float32, np.uint8))
    place = by_subgroup(np.arange(sensor.array_pixels), sensor)
    if activity is None:
        activity = np.ones((sensor.subgroups, sensor.pixels))
    opens = _gate_opens(events, config)

    def evidence(s: int) -> tuple[np.ndarray, _Pixels]:
        noise = max(events.photon_rate[s] / sensor.pixels, QUIET_RATE)
        window = int(events.window[s])
        chances = np.stack([of_tick[s, grid.step // 2 :: grid.step] for of_tick in never])
        law = _Law(
            window=window,
            told=window if events.mapped else 1,
            phases=sensor.phases,
            rearm=sensor.rearm,
            offset=sensor.offset_ticks,
            reach=reach,
            step=grid.step,
            noise=noise,
            alive=1 - min(BLIND_MAX, noise * DEAD_S / config.tick_s),
            pulses=pulses,
            missed=chances[:2],
            blind=chances[2:],
            fired=fired,
        )
        own = _events_of(s, events, law, opens, config)
        if guess is not None and events.offset.shape[1]:
            own = own._replace(shares=_first_shares(law, own, minigroup, guess.time[s], guess.light[s], sigma_ticks))
        pixels = _Pixels(
            minigroup=minigroup,
            mask=config.mask[s],
            activity=activity[s],
            first=first[s],
            total=np.empty((sensor.pixels, bins, len(grid.lights)), np.float32),
            touched=np.zeros((sensor.pixels, bins), np.bool_),
            counted=np.full(sensor.pixels, -1),
        )
        return _add_events(law, own, pixels), pixels

    def average(s: int, prior: np.ndarray, common: np.ndarray, pixels: _Pixels) -> None:
        of_subgroup = _of_met(prior) if events.threshold[s] > 1 else prior
        _over_lights(common, pixels, of_subgroup, place[s], level, light)

    subgroups = range(sensor.subgroups)
    if grid.prior is not None:
        prior = grid.prior
        list(spread(lambda s: average(s, prior, *evidence(s)), subgroups))
    else:
        assert guess is not None
        found = list(spread(evidence, subgroups))
        known = config.mask & ~np.isnan(guess.time)
        prior = _learned(np.concatenate(list(spread(lambda s: _of_lights(*found[s], known[s]), subgroups))))
        list(spread(lambda s: average(s, prior, *found[s]), subgroups))
    shape = (sensor.rows, sensor.cols, bins)
    return Levels(level.reshape(shape), light.reshape(shape), prior)


def _of_met(prior: np.ndarray) -> np.ndarray:
    """Return the prior for windows that met a threshold above 1: no light counts as rarer than a brighter one.

    Among these windows, dark pixels are hit more often than the law says, and look brighter than they are.
    """
    return np.maximum.accumulate(prior[::-1])[::-1]


def _learned(of_lights: np.ndarray) -> np.ndarray:
    """float32[lights]: log share of the pixels with each light; the shares make the pixels, float32[n, lights], likeliest."""
    chance = np.exp(of_lights - of_lights.max(axis=1, keepdims=True, initial=-np.inf), dtype=np.float64)
    share = np.full(chance.shape[1], 1 / chance.shape[1])
    for _ in range(LEARNING_ROUNDS if len(chance) else 0):
        of_pixel = chance * share
        share = (of_pixel / of_pixel.sum(axis=1, keepdims=True)).mean(axis=0)
    share += LIGHT_FLOOR
    return np.log(share / share.sum()).astype(np.float32)


def _fired(lights: np.ndarray, sigma_ticks: float, reach: int) -> np.ndarray:
    """float32[4 reach + 1, lights]: F at u - t = -reach to reach, in steps of half a tick."""
    distance = np.arange(-2 * reach, 2 * reach + 1) / 2
    return -np.expm1(-special.ndtr(distance / sigma_ticks)[:, None] * lights).astype(np.float32)


def _gate_opens(events: Events, config: Config) -> np.ndarray:
    """int64[n]: tick at which the gate opened in each event's pulse, 0 without gating."""
    subgroup = np.repeat(np.arange(config.sensor.subgroups), np.diff(events.bounds))
    steps = 0
    if config.frame["gate_every"]:
        steps = events.pulse % config.pulses // config.frame["gate_every"] % config.frame["gate_steps"]
    opens = (config.gate_start[subgroup] + config.frame["gate_step"] * steps) * config.sensor.phases
    return np.where(config.gating[subgroup], opens, 0)


def _events_of(s: int, events: Events, law: _Law, opens: np.ndarray, config: Config) -> _Events:
    """Return the events of subgroup s, without shares; opens: from `_gate_opens`."""
    span = slice(events.bounds[s], events.bounds[s + 1])
    stamp, pulse = events.stamp[span], events.pulse[span] % law.pulses
    armed = armed_ticks(stamp, law.window, config)
    previous = np.full(len(stamp), -1)  # `armed` of the event before, if it was in the same pulse
    previous[1:][pulse[1:] == pulse[:-1]] = armed[:-1][pulse[1:] == pulse[:-1]]
    earliest, cycle = np.maximum(opens[span], previous), stamp // law.phases * law.phases
    known = np.minimum(stamp, np.maximum(earliest, cycle))
    quiet = np.minimum(known, np.maximum(earliest, cycle - law.rearm * law.phases - law.window + 1))
    return _Events(
        stamp=stamp,
        armed=armed,
        pulse=pulse,
        winner=events.winner[span],
        hits=events.hits[span],
        offset=events.offset[span],
        overrun=events.overrun[span],
        known=known,
        quiet=quiet,
        since=np.where(quiet <= previous + 2 * law.reach, previous, -1),
        shares=np.empty((0, 0), np.float32),
    )


def unheard(events: Events, config: Config, pulses: int, sigma_ticks: float, spread: Spread = map) -> Unheard:
    """Estimate from the subgroups' events how often photons leave no trace.

    pulses: number of pulses in which the events came; spread: as in `log_likelihood`.
    """
    shape, reach = (config.sensor.subgroups, config.period_ticks), math.ceil(REACH_SIGMAS * sigma_ticks)
    missed, missed_dropping, blind, blind_dropping = (np.empty(shape, np.float32) for _ in range(4))
    after_rejected = (
        np.arange(config.sensor.phases) + config.sensor.rearm * config.sensor.phases
    )  # mean blind ticks after a rejected window, by phase

    def of_subgroup(s: int) -> None:
        ticks, window = config.period_ticks, int(events.window[s])
        span = slice(events.bounds[s], events.bounds[s + 1])
        stamp, armed = events.stamp[span], armed_ticks(events.stamp[span], window, config)
        threshold = int(events.threshold[s])
        commits, met = (
            special.pdtrc(others - 1, RATES) if others else np.ones(len(RATES)) for others in (threshold, threshold - 1)
        )
        rejected = (events.opened[s] - events.committed[s]) / pulses / ticks  # windows per tick
        deaf = np.minimum(BLIND_MAX, rejected * np.resize(after_rejected, ticks))
        kept, found = _while_dropping(
            events.pulse[span] % pulses, stamp, armed, events.overrun[span], events.committed[s], pulses, config
        )
        dropped = 1 / kept
        dropped *= events.committed[s] / max(1.0, dropped[stamp].sum())  # windows per stored window
        covered = _share_between(stamp, stamp + window, ticks, pulses) * dropped / (1 - deaf)
        photons = np.maximum(np.interp(covered, commits, RATES), events.photon_rate[s] * window)
        commits, met = (np.interp(photons, RATES, of_rate) for of_rate in (commits, met))
        seen = _gate_share(config, s, np.arange(ticks) // config.sensor.phases) if config.gating[s] else 1.0

        def tell(
            of_missed: np.ndarray,
            of_blind: np.ndarray,
            room: np.ndarray | float,
            noticed: np.ndarray,
            unarmed: np.ndarray,
        ) -> None:
            silent = deaf + (1 - deaf) * (1 - room * noticed)
            lost = (deaf + (1 - deaf) * (1 - room * met)) / np.maximum(silent, RARE)
            of_missed[s] = _over_pulse(1 - seen * (1 - np.minimum(1, lost)), sigma_ticks)
            of_blind[s] = _over_pulse(unarmed / (unarmed + (1 - unarmed) * np.exp(-photons)), sigma_ticks)

        tell(missed, blind, 1.0, commits, deaf)
        if events.overrun[span].any():
            nearby = np.minimum(1, dropped * _share_between(np.maximum(0, stamp - reach), armed, ticks, pulses))
            busy = np.minimum(BLIND_MAX, deaf + dropped * _share_between(stamp, armed, ticks, pulses))
            tell(missed_dropping, blind_dropping, found, np.maximum(commits, nearby), busy)
        else:  # not used
            missed_dropping[s], blind_dropping[s] = missed[s], blind[s]

    list(spread(of_subgroup, range(config.sensor.subgroups)))
    return Unheard(missed, missed_dropping, blind, blind_dropping)


def armed_ticks(stamp: np.ndarray, window: int, config: Config) -> np.ndarray:
    """int64[n]: tick at which the tree is armed again after events at `stamp`."""
    phases = config.sensor.phases
    return armed_cycle(close_cycle(stamp, window, phases), config.sensor.rearm) * phases


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


def _over_pulse(of_photon: np.ndarray, sigma_ticks: float) -> np.ndarray:
    """Return the mean over the arrival times of a surface's photons, for a surface at each tick."""
    return ndimage.gaussian_filter1d(of_photon, sigma_ticks, mode="nearest", truncate=REACH_SIGMAS)


def _share_between(begin: np.ndarray, end: np.ndarray, ticks: int, pulses: int) -> np.ndarray:
    """float64[ticks]: share of the pulses in which a tick lies in [begin, end) of an event."""
    change = sum(sign * np.bincount(np.minimum(at, ticks), minlength=ticks + 1) for sign, at in ((1, begin), (-1, end)))
    return np.cumsum(change)[:ticks] / pulses


def _gate_share(config: Config, s: int, cycle: np.ndarray) -> np.ndarray:
    """Return the share of the pulses whose gate is open in each cycle."""
    start = config.gate_start[s] + np.zeros(1, np.int64)
    if config.frame["gate_every"]:
        pulse = np.arange(config.pulses)
        start = start + config.frame["gate_step"] * (pulse // config.frame["gate_every"] % config.frame["gate_steps"])
    inside = (cycle[:, None] >= start) & (cycle[:, None] < start + config.gate_len[s])
    return inside.mean(axis=1)


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
def _add_events(law, events, pixels):
    """Return what a subgroup's events say about pixels without a hit, float32[times, lights]; add the hits to `pixels`.

    In each cluster of events, a pixel's first hit counts.
    """
    pulse, armed, overrun, first = events.pulse, events.armed, events.overrun, pixels.first
    n, times = len(pulse), law.missed.shape[1]
    bins, lights = pixels.total.shape[1:]
    wanted = np.zeros(times + 1, np.int64)  # running number of the times that are in some pixel's bins
    for i in range(len(first)):
        wanted[max(0, first[i]) + 1 : max(0, first[i] + bins) + 1] = 1
    wanted = np.cumsum(wanted)
    common = np.zeros((times, lights), np.float32)
    unseen, before = np.empty_like(common), np.empty_like(common)
    product, logs = np.zeros_like(common), np.zeros_like(common)
    rows = _Rows(unseen, before, product, logs)
    silent = np.zeros((2, times + 1), np.int64)  # change of the number of pulses without an event nearby, by `overrun`
    begin, since, since_pulse = 0, 0, 0
    while begin < n:
        end = begin + 1
        while end < n and events.since[end] >= 0:
            end += 1
        k0 = min(times, max(0, (events.quiet[begin] - law.reach) // law.step))
        k1 = min(times, (armed[end - 1] + law.reach) // law.step + 1)
        _add_silence(silent[np.int64(overrun[begin])], since_pulse, since, pulse[begin], k0)
        since, since_pulse = k1, pulse[begin]
        while k0 < k1 and wanted[k0 + 1] == wanted[k0]:
            k0 += 1
        while k1 > k0 and wanted[k1] == wanted[k1 - 1]:
            k1 -= 1
        if k0 < k1:
            dropping = overrun[end] if end < n else overrun[n - 1]
            unseen[k0:k1] = 1
            before[k0:k1] = 1
            for e in range(begin, end):
                _subtract(law, events, e, unseen, k0, k1)
            _subtract_after(law, armed[end - 1], dropping, unseen, k0, k1)
            _log(unseen, logs, k0, k1)
            common[k0:k1] += logs[k0:k1]
            for e in range(begin, end):
                _add_hits(law, events, e, begin, pixels, rows, k0, k1)
                _subtract(law, events, e, before, k0, k1)
        begin = end
    _add_silence(silent[np.int64(n > 0 and overrun[n - 1])], since_pulse, since, law.pulses, 0)
    always = law.fired[len(law.fired) - 1]
    for change, chance in zip(silent, law.missed):
        for k in range(times):
            for x in range(lights):
                product[k, x] = max(np.float32(RARE), 1 - law.alive * (1 - chance[k]) * always[x])
        _log(product, logs, 0, times)
        number = 0
        for k in range(times):
            number += change[k]
            for x in range(lights):
                common[k, x] += number * logs[k, x]
    return common


@njit(allocates=False)
def _add_silence(silent, from_pulse, since, to_pulse, until):
    """Count the pulses without an event nearby, from time `since` of one pulse to time `until` of another."""
    silent[since] += 1
    silent[until] -= 1
    silent[0] += to_pulse - from_pulse


@njit(allocates=False)
def _at(law, k, tick):
    """Return the row of `fired` for a tick, for a surface at time k of the grid."""
    return min(max(2 * (tick + law.reach) - (2 * k + 1) * law.step, 0), len(law.fired) - 1)


@njit(allocates=False)
def _silence(events, e):
    return _Silence(events.since[e], events.quiet[e], events.known[e], int(events.overrun[e]))


@njit(allocates=False)
def _before_stamp(law, k, silence):
    """Return the rows of `fired` that bound the time before an event's stamp, and the chances to notice a photon there.

    Between rows z and a, the photon would have made an event of its own (chance `heard`); between a and b, it would have
    made this event's stamp earlier (`sharp`).
    """
    a, b = _at(law, k, silence.quiet), _at(law, k, silence.known)
    z = min(_at(law, k, silence.since), a) if silence.since >= 0 else 0
    heard = np.float32(0 if silence.dropping else law.alive * (1 - law.missed[0, k]))
    sharp = np.float32(law.alive * (1 - law.blind[silence.dropping, k]))
    return z, a, b, heard, sharp


@njit(allocates=False)
def _subtract(law, events, e, unseen, k0, k1):
    """Reduce `unseen` by event e: a pixel outside its map did not fire in the window, nor between the last event and it."""
    fired, alive = law.fired, np.float32(law.alive)
    silence, told = _silence(events, e), events.stamp[e] + law.told
    for k in range(k0, k1):
        z, a, b, heard, sharp = _before_stamp(law, k, silence)
        c = _at(law, k, told)
        for x in range(unseen.shape[1]):
            left = unseen[k, x] - (
                alive * (fired[c, x] - fired[b, x])
                + sharp * (fired[b, x] - fired[a, x])
                + heard * (fired[a, x] - fired[z, x])
            )
            unseen[k, x] = max(np.float32(RARE), left)


@njit(allocates=False)
def _subtract_after(law, armed, dropping, unseen, k0, k1):
    """Reduce `unseen` by the silence after the last event of a pulse."""
    if dropping:
        return
    fired, top = law.fired, len(law.fired) - 1
    for k in range(k0, k1):
        d = _at(law, k, armed)
        heard = np.float32(law.alive * (1 - law.missed[0, k]))
        for x in range(unseen.shape[1]):
            unseen[k, x] = max(np.float32(RARE), unseen[k, x] - heard * (fired[top, x] - fired[d, x]))


@njit(allocates=False)
def _add_hits(law, events, e, cluster, pixels, rows, k0, k1):
    """Add what event e says about the pixels in its map; pixels of the same kind share a row."""
    mask, activity, first, counted = pixels.mask, pixels.activity, pixels.first, pixels.counted
    bins, offset, shares = pixels.total.shape[1], events.offset, events.shares
    silence, stamp, winner = _silence(events, e), events.stamp[e], events.winner[e]
    cycle, end = stamp // law.phases * law.phases, stamp + law.window
    if mask[winner] and counted[winner] != cluster:
        counted[winner] = cluster
        low, high = max(k0, first[winner]), min(k1, first[winner] + bins)
        at_stamp = _Hit(stamp, stamp, stamp + 1, np.float32(0))
        _row(law, silence, at_stamp, law.noise * activity[winner], rows, low, high)
        _add(pixels.total[winner], pixels.touched[winner], rows.logs, first[winner], low, high)
    groups = offset.shape[1] if len(shares) else 1
    for group in range(groups):  # one at a time, because the pixels of a group share rows
        begin, own, of_row = stamp, stamp, np.float32(-1.0)
        if len(shares) and group != pixels.minigroup[winner] and offset[e, group] != OFFSET_NONE:
            begin = max(stamp, cycle + offset[e, group] * law.offset)
            own = min(end, cycle + (offset[e, group] + 1) * law.offset)
        for i in range(len(first)):
            if (
                groups > 1
                and pixels.minigroup[i] != group
                or not mask[i]
                or counted[i] == cluster
                or not _hit(events.hits, e, i)
            ):
                continue
            counted[i] = cluster
            share = shares[e, i] if own > begin else np.float32(0.0)
            low, high = k0, k1
            if activity[i] != 1:
                low, high, of_row = max(k0, first[i]), min(k1, first[i] + bins), np.float32(-1.0)
            if of_row < 0 or abs(share - of_row) > ALIKE:
                _row(law, silence, _Hit(begin, own, end, share), law.noise * activity[i], rows, low, high)
                of_row = share if activity[i] == 1 else np.float32(-1.0)
            _add(pixels.total[i], pixels.touched[i], rows.logs, first[i], low, high)


@njit(allocates=False)
def _row(law, silence, hit, noise, rows, k0, k1):
    """Compute logs[k0:k1] of `rows`: the likelihood ratio of a hit of an event.

    It is relative to the likelihood of no hit, which all pixels get.
    """
    fired, before, unseen, product = law.fired, rows.before, rows.unseen, rows.product
    alive, share = np.float32(law.alive), hit.share
    background = np.float32(1 / (noise * (share * (hit.own - hit.begin) + (1 - share) * (hit.until - hit.begin))))
    for k in range(k0, k1):
        z, a, b, heard, sharp = _before_stamp(law, k, silence)
        c, d, f = _at(law, k, hit.begin), _at(law, k, hit.own), _at(law, k, hit.until)
        for x in range(product.shape[1]):
            earlier = before[k, x] - (
                heard * (fired[a, x] - fired[z, x])
                + sharp * (fired[b, x] - fired[a, x])
                + alive * (fired[c, x] - fired[b, x])
            )
            inside = fired[f, x] + share * (fired[d, x] - fired[f, x]) - fired[c, x]
            product[k, x] = (alive * inside * background + max(np.float32(RARE), earlier)) / unseen[k, x]
    _log(product, rows.logs, k0, k1)


@njit(allocates=False)
def _add(total, touched, row, first, k0, k1):
    for k in range(max(k0, first), min(k1, first + total.shape[0])):
        if touched[k - first]:
            for x in range(total.shape[1]):
                total[k - first, x] += row[k, x]
        else:
            touched[k - first] = True
            for x in range(total.shape[1]):
                total[k - first, x] = row[k, x]


@njit(allocates=False, error_model="numpy")
def _log(values, logs, k0, k1):
    """Compute logs = log(values) from the bits of the float32: exponent and a polynomial of the fraction."""
    bits = values[k0:k1].reshape(-1).view(np.int32)
    out = logs[k0:k1].reshape(-1)
    c = _LOG
    for j in range(len(bits)):
        x = np.float32(bits[j] & np.int32((1 << _FRACTION_BITS) - 1)) * np.float32(1 / (1 << _FRACTION_BITS))
        y = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * (c[5] + x * (c[6] + x * c[7]))))))
        out[j] = y + np.float32(math.log(2)) * np.float32((bits[j] >> np.int32(_FRACTION_BITS)) - np.int32(127))


@njit
def _of_lights(common, pixels, known):
    """float32[known pixels, lights]: logarithm of the sum of a pixel's likelihoods over its times."""
    total, touched, first = pixels.total, pixels.touched, pixels.first
    times, lights = common.shape
    found = np.empty((known.sum(), lights), np.float32)
    line = np.empty((total.shape[1], lights), np.float32)
    number = 0
    for i in range(len(total)):
        if not known[i]:
            continue
        top = np.full(lights, -np.inf, np.float32)
        low, high = max(0, -first[i]), min(total.shape[1], times - first[i])
        for k in range(low, high):
            for x in range(lights):
                line[k, x] = common[first[i] + k, x] + (total[i, k, x] if touched[i, k] else np.float32(0))
                top[x] = max(top[x], line[k, x])
        ratio = np.zeros(lights, np.float32)
        for k in range(low, high):
            for x in range(lights):
                if line[k, x] > top[x] + FAINT:
                    ratio[x] += math.exp(line[k, x] - top[x])
        found[number] = top + np.log(ratio)
        number += 1
    return found


@njit
def _over_lights(common, pixels, prior, place, level, light):
    """Compute the logarithm of the mean over the lights, and the likeliest light; a masked pixel favours no time."""
    total, touched, mask, first = pixels.total, pixels.touched, pixels.mask, pixels.first
    times, lights = common.shape
    values = np.empty(lights, np.float32)
    level_of_all, light_of_all = np.empty(times, np.float32), np.empty(times, np.uint8)
    for k in range(times):
        for x in range(lights):
            values[x] = common[k, x] + prior[x]
        level_of_all[k], light_of_all[k] = _mean(values)
    for i in range(len(total)):
        p = place[i]
        for k in range(total.shape[1]):
            time = first[i] + k
            if not mask[i] or time < 0 or time >= times:
                level[p, k], light[p, k] = 0, 0
            elif not touched[i, k]:
                level[p, k], light[p, k] = level_of_all[time], light_of_all[time]
            else:
                for x in range(lights):
                    values[x] = total[i, k, x] + common[time, x] + prior[x]
                level[p, k], light[p, k] = _mean(values)


@njit(allocates=False)
def _mean(values):
    """Return (logarithm of the sum, index of the largest)."""
    best = 0
    for x in range(len(values)):
        if values[x] > values[best]:
            best = x
    top = values[best]
    if top > NEGLIGIBLE:
        ratio = np.float32(0)
        for x in range(len(values)):
            ratio += math.exp(values[x] - top)
        top += math.log(ratio)
    return top, best
