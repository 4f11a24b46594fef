# SPDX-License-Identifier: Apache-2.0
"""How bright the pixels are: the signal photons of each return, from the hits near its time.

All of this is our own choice. A pixel's hits near its time grow with its light, but not in
proportion: a pixel fires once in a pulse, the tree takes the first window, and a threshold rejects
windows without company. So the light is sought that makes the expected number of hits equal to the
number that was seen, for all pixels of a subgroup together. The expectation follows from one walk
through the cycles of a period:

1. `_light_windows`: the probability that a pixel fires in a window, or in its first tick;
2. `_walk_cycles`: the probability that the tree is armed and that no photon came in the cycle;
3. `_expect_hits`: the probability that a window opens at a tick, meets the threshold and holds the
   pixel; it is that of any such window, less that of one in which nobody fires at the tick.

The background comes from the number of opened windows, and its share of a pixel from the hits away
from its times.
"""

import math
from typing import NamedTuple

import numpy as np

from ..contract.coincidence import rises
from ..contract.config import Config
from ..contract.latency import armed_cycle, close_cycle
from ..contract.packet import BEAT_BITS
from ..shared.compiled import njit, part
from ..shared.threads import Threads
from .gates import GateTurns, gate_turns
from .histograms import Events, by_subgroup, pixel_image
from .likelihood import DEAD_S
from .pulse_ticks import PulseTicks
from .tree import kept_shares
from .unheard import windows_of

ROUNDS = 20  # in which the lights converge
STEP_MAX = 1.5  # of a light's logarithm in a round
ENOUGH = 3e-3  # change of all lights, relative to them and to `DIM`, that ends the rounds
DIM = 1e-4  # photons per pulse
AHEAD = 3  # every so many rounds, the lights go on to where the last changes lead
RATIO_MAX = 0.9  # of a change to the one before, there
RISE_MIN = 0.02  # of the hits' logarithm with the light's, at least
BRIGHTEST = 20.0  # photons per pulse: more cannot be told apart
FAINTEST = 1e-7
ERROR_MAX = 1e6  # nothing is known
NOISE_HITS = 10.0  # weight of the mean background in that of a pixel, in hits
NOISE_MIN = 1e-9  # photons per tick and pixel
LEAST = 1e-300  # to divide by
ONE = np.uint64(1)
BYTE = np.uint64(0xFF)
BYTE_BITS = np.uint64(8)

_close_cycle = njit(close_cycle)
_armed_cycle = njit(armed_cycle)


class Intensity(NamedTuple):
    """Light of the returns, float64[rows, cols, returns], in detected photons per pulse."""

    signal: np.ndarray  # NaN where there is no return
    error: np.ndarray  # standard error


class _Subgroup(NamedTuple):
    """What holds for the windows of a subgroup."""

    window: int  # ticks
    phases: int  # ticks per cycle
    rearm: int  # cycles
    open_ticks: int  # of a period, in which windows may open
    pulses: int
    mapped: bool  # events name all their pixels, not only the winner
    rejected: np.ndarray  # float64[n], share of the windows with so many other pixels
    turns: GateTurns
    frame_pulses: int  # of the turns
    opened: float  # windows in all pulses
    activity: np.ndarray  # float64[pixels], background relative to the mean of the lit pixels
    dead_ticks: float  # of a SPAD


class _Returns(NamedTuple):
    """Returns of a subgroup, [n]; their ticks are those at which a window may hold their light."""

    pixel: np.ndarray  # int64
    first: np.ndarray  # int64, first of their ticks
    share: np.ndarray  # float64[n, ticks], share of the pulse in each tick
    earlier: np.ndarray  # float64[n, ticks], share of the pulse before the tick's cycle
    hits: np.ndarray  # float64, of the pixel in events with these stamps
    away: np.ndarray  # float64, of the pixel in other events
    together: np.ndarray  # float64, of all pixels in events with these stamps


class _Work(NamedTuple):
    """What happens in a window that opens at a tick, and whether one opens.

    [2]: the tree was armed in the cycle before; or it was not, and pixels are dead that fired then.
    """

    alive: np.ndarray  # float64[n], chance that the pixel is not dead from an earlier photon
    fires: np.ndarray  # float64[n, ticks], probability that the pixel fires in the window,
    later: np.ndarray  # or after its first tick
    silent: np.ndarray  # float64[2, period_ticks], chance that no pixel fires in a tick
    company: np.ndarray  # float64[period_ticks, n], chance of so many pixels in the window,
    company_later: np.ndarray  # and after its first tick
    lit: np.ndarray  # bool[period_ticks], some return's light may be in the window
    lit_cycle: np.ndarray  # bool[cycles], some of its ticks are lit
    coming: np.ndarray  # float64[period_ticks], photons of the returns in the window
    waits: (
        np.ndarray
    )  # float64[2, period_ticks], the tree is armed, and no photon came in the cycle
    counted: np.ndarray  # float64[period_ticks], hits of all pixels in events that open at the tick


class _Expected(NamedTuple):
    """What is expected of a return in one pulse, float64[n]."""

    hits: np.ndarray
    noise: np.ndarray  # those that come without its light
    rise: np.ndarray  # of the hits with its light
    together: np.ndarray  # hits of all pixels in its ticks
    joint: np.ndarray  # rise of the hits' logarithm with that of the light of all other pixels


def find_intensity(
    events: Events,
    config: Config,
    pulse: PulseTicks,
    pulses: int,
    ticks: np.ndarray,
    threads: Threads,
) -> Intensity:
    """Return the light of each return.

    pulses: number of pulses in which the events came. ticks: float64[rows, cols, returns], times of
    the returns, NaN = none. The number of threads does not change the result.
    """
    sensor = config.sensor
    time = np.stack([by_subgroup(one, sensor) for one in np.moveaxis(ticks, 2, 0)], axis=2)
    signal = np.full(time.shape, np.nan)
    error = np.full(time.shape, np.nan)
    weight = _event_weights(events, config, pulses, pulse, threads)

    def of_subgroup(s: int) -> None:
        there = ~np.isnan(time[s]) & config.mask[s][:, None]
        if not there.any():
            return
        returns = _returns_of(events, config, pulse, time[s], there, weight, s)
        subgroup = _subgroup_of(events, config, pulses, returns, s)
        light, doubt = _fit(subgroup, returns, config.period_ticks)
        signal[s][there] = light
        error[s][there] = doubt

    threads.map(of_subgroup, range(sensor.subgroups))
    return Intensity(signal=pixel_image(signal, sensor), error=pixel_image(error, sensor))


def _event_weights(
    events: Events, config: Config, pulses: int, pulse: PulseTicks, threads: Threads
) -> np.ndarray:
    """float64[n]: windows for which an event stands, because some were dropped."""
    weight = np.ones(len(events.stamp))
    if not events.overrun.any():
        return weight
    for s, windows in enumerate(windows_of(events, config, pulses, pulse, threads.map)):
        span = slice(events.bounds[s], events.bounds[s + 1])
        stamp = events.stamp[span]
        stored = np.bincount(stamp, minlength=config.period_ticks)
        weight[span] = windows.of_ticks.committed[stamp] / stored[stamp]
    return weight


def _returns_of(
    events: Events,
    config: Config,
    pulse: PulseTicks,
    time: np.ndarray,
    there: np.ndarray,
    weight: np.ndarray,
    s: int,
) -> _Returns:
    """Return the returns of subgroup s. time, there: [pixels, returns]."""
    window = int(events.window[s])
    reach = pulse.reach
    at = time[there]
    first = np.floor(at).astype(np.int64) - reach - (window - 1)
    number = 2 * reach + window
    edge = first[:, None] + np.arange(number + 1) - at[:, None]
    share = np.diff(pulse.share_before(edge), axis=1)
    until_cycle = np.zeros((len(at), number + 1))
    until_cycle[:, 1:] = np.cumsum(share, axis=1)
    into_cycle = (first[:, None] + np.arange(number)) % config.sensor.phases
    begin_cycle = np.maximum(0, np.arange(number) - into_cycle)
    pixel = np.nonzero(there)[0]
    starts = np.searchsorted(pixel, np.arange(len(there) + 1))
    span = slice(events.bounds[s], events.bounds[s + 1])
    hits = np.zeros(len(pixel))
    total = np.zeros(len(there))
    stamp = events.stamp[span]
    counts = np.bincount(stamp, weight[span] * events.count[span], minlength=config.period_ticks)
    until = np.concatenate([[0.0], np.cumsum(counts)])
    begin = np.clip(first, 0, config.period_ticks)
    end = np.clip(first + number, 0, config.period_ticks)
    _count_hits(stamp, events.hits[span], weight[span], starts, first, number, hits, total)
    near = np.bincount(pixel, hits, minlength=len(there))
    away = np.maximum(0.0, total - near)
    return _Returns(
        pixel=pixel,
        first=first,
        share=share,
        earlier=np.take_along_axis(until_cycle, begin_cycle, 1),
        hits=hits,
        away=away[pixel],
        together=until[end] - until[begin],
    )


def _subgroup_of(
    events: Events, config: Config, pulses: int, returns: _Returns, s: int
) -> _Subgroup:
    """Return what holds for the windows of subgroup s."""
    sensor = config.sensor
    mask = config.mask[s]
    kept = kept_shares(rises(sensor.rule, sensor.subgroup, int(events.threshold[s])), sensor.pixels)
    until = int(np.argmax(kept[1:] >= 1.0)) + 1  # so many pixels are never rejected
    away = np.full(sensor.pixels, np.nan)
    away[returns.pixel] = returns.away
    mean = np.nanmean(away)
    activity = np.where(np.isnan(away), 1.0, (away + NOISE_HITS) / (mean + NOISE_HITS))
    return _Subgroup(
        window=int(events.window[s]),
        phases=sensor.phases,
        rearm=sensor.rearm,
        open_ticks=(config.period - sensor.guard) * sensor.phases,
        pulses=pulses,
        mapped=events.mapped,
        rejected=1.0 - kept[1 : max(2, until)],
        turns=gate_turns(config, s),
        frame_pulses=config.pulses,
        opened=float(events.opened[s]),
        activity=np.where(mask, activity, 0.0),
        dead_ticks=DEAD_S / config.tick_s,
    )


@njit
def _count_hits(
    stamp: np.ndarray,
    maps: np.ndarray,
    weight: np.ndarray,
    starts: np.ndarray,
    first: np.ndarray,
    number: int,
    hits: np.ndarray,
    total: np.ndarray,
) -> None:
    """Count the hits of each return in events with one of its ticks, and those of each pixel.

    starts: int64[pixels + 1], first return of each pixel. number: of a return's ticks.
    """
    for e in range(len(stamp)):
        for word in range(maps.shape[1]):
            left = maps[e, word]
            i = BEAT_BITS * word
            while left:
                if not left & BYTE:
                    left >>= BYTE_BITS
                    i += 8
                    continue
                if left & ONE:
                    total[i] += weight[e]
                    for n in range(starts[i], starts[i + 1]):
                        if first[n] <= stamp[e] < first[n] + number:
                            hits[n] += weight[e]
                left >>= ONE
                i += 1


@njit
def _fit(
    subgroup: _Subgroup, returns: _Returns, period_ticks: int
) -> tuple[np.ndarray, np.ndarray]:
    """float64[n] twice: the lights with which as many hits are expected as were seen, and their
    standard errors.
    """
    number, ticks = returns.share.shape
    orders = len(subgroup.rejected)
    work = _Work(
        alive=np.empty(number),
        fires=np.empty((number, ticks)),
        later=np.empty((number, ticks)),
        silent=np.empty((2, period_ticks)),
        coming=np.empty(period_ticks),
        counted=np.empty(period_ticks),
        company=np.empty((period_ticks, orders)),
        company_later=np.empty((period_ticks, orders)),
        lit=np.zeros(period_ticks, np.bool_),
        lit_cycle=np.zeros(period_ticks // subgroup.phases, np.bool_),
        waits=np.empty((2, period_ticks)),
    )
    expected = _Expected(
        hits=np.empty(number),
        noise=np.empty(number),
        rise=np.empty(number),
        together=np.empty(number),
        joint=np.empty(number),
    )
    for n in range(number):
        for t in range(max(0, returns.first[n]), min(period_ticks, returns.first[n] + ticks)):
            work.lit[t] = True
            work.lit_cycle[t // subgroup.phases] = True
    pulses = float(subgroup.pulses)
    seen = returns.hits / pulses
    light = np.empty(number)
    for n in range(number):
        light[n] = max(FAINTEST, -math.log(1 - min(0.99, seen[n])))
    activity = subgroup.activity.sum()
    opened = subgroup.opened / pulses
    noise = opened / period_ticks / max(1.0, activity)
    change = np.zeros(number)  # of the lights' logarithms in the last round
    for k in range(ROUNDS):
        _light_windows(subgroup, returns, light, noise, work)
        all_noise = noise * activity
        armed, windows = _walk_cycles(subgroup, work, math.exp(-all_noise))
        _expect_hits(subgroup, returns, light, noise, work, expected)
        ahead = k % AHEAD == AHEAD - 1
        moved = _step(subgroup, returns, seen, expected, light, change, ahead)
        more = (opened - windows) / max(LEAST, armed * activity)
        noise = max(NOISE_MIN, noise + min(noise, max(-noise / 2, more)))
        if moved < ENOUGH:
            break
    error = np.empty(number)
    for n in range(number):
        hits = min(1 - 0.5 / pulses, max(0.5 / pulses, expected.hits[n]))
        of_noise = expected.noise[n]
        variance = hits * (1 - hits) / pulses + of_noise * of_noise / (returns.away[n] + NOISE_HITS)
        error[n] = min(ERROR_MAX, math.sqrt(variance) / max(LEAST, expected.rise[n]))
    return light, error


@part
def _step(
    subgroup: _Subgroup,
    returns: _Returns,
    seen: np.ndarray,
    expected: _Expected,
    light: np.ndarray,
    change: np.ndarray,
    ahead: bool,
) -> float:
    """Change each light as its own hits differ; return the largest change, relative to the light
    and to `DIM`.

    A step is shortened as if all lights changed alike, so that they do not overshoot together. The
    winners alone tell how the lights differ, but not how bright they are together; the counts of
    their events do.

    change: float64[n], that of the last round, which becomes that of this one. ahead: go on to
    where the two lead, if both go the same way (Aitken).
    """
    most = 0.0
    for n in range(len(light)):
        hits = max(LEAST, expected.hits[n])
        off = math.log(max(LEAST, seen[n]) / hits)
        own = min(1.0, max(RISE_MIN, light[n] * expected.rise[n] / hits))
        if not subgroup.mapped:
            counted = returns.together[n] / subgroup.pulses
            together = math.log(max(LEAST, counted) / max(LEAST, expected.together[n]))
            off = off / 2 + together
        step = off / (own + expected.joint[n])
        step = min(STEP_MAX, max(-STEP_MAX, step))
        ratio = 0.0
        if ahead and change[n] != 0:
            ratio = min(RATIO_MAX, max(0.0, step / change[n]))
        change[n] = step
        before = light[n]
        light[n] = min(BRIGHTEST, max(FAINTEST, before * math.exp(step / (1 - ratio))))
        most = max(most, abs(light[n] - before) / (before + DIM))
    return most


@part(allocates=True)
def _light_windows(
    subgroup: _Subgroup, returns: _Returns, light: np.ndarray, noise: float, work: _Work
) -> None:
    """Compute what happens in windows: all of `_Work` but `waits`.

    noise: photons per tick of a pixel with an activity of 1.
    """
    window = subgroup.window
    orders = len(subgroup.rejected)
    period_ticks = work.silent.shape[1]
    number, ticks = returns.share.shape
    dark = np.zeros(orders)
    dark_later = np.zeros(orders)
    dark[0] = 1.0
    dark_later[0] = 1.0
    all_noise = 0.0
    for i in range(len(subgroup.activity)):
        own = noise * subgroup.activity[i]
        all_noise += own
        _with_pixel(dark, 1 - math.exp(-own * window))
        _with_pixel(dark_later, 1 - math.exp(-own * (window - 1)))
    silent = math.exp(-all_noise)
    for t in range(period_ticks):
        if work.lit_cycle[t // subgroup.phases]:
            work.silent[0, t] = silent
            work.silent[1, t] = silent
            work.coming[t] = 0.0
        if work.lit[t]:
            _copy(dark, work.company[t])
            _copy(dark_later, work.company_later[t])
    for n in range(number):
        own = noise * subgroup.activity[returns.pixel[n]]
        alive = _alive(returns, n, light, own, subgroup.dead_ticks)
        work.alive[n] = alive
        dark_fires = 1 - math.exp(-own * window)
        dark_later_fires = 1 - math.exp(-own * (window - 1))
        noise_tick = math.exp(own)
        noise_window = math.exp(-own * window)
        earlier = 0.0
        left = 1.0  # chance that the pixel did not fire before the tick's cycle
        signal = 0.0  # photons of the return in the window from tick k on
        for k in range(ticks - 1, -1, -1):
            here = light[n] * returns.share[n, k]
            signal += here
            if k + window < ticks:
                signal = max(0.0, signal - light[n] * returns.share[n, k + window])
            quiet = math.exp(-here)
            none = math.exp(-signal) * noise_window
            fires = alive * (1 - none)
            later = alive * (1 - none / quiet * noise_tick)
            work.fires[n, k] = fires
            work.later[n, k] = later
            t = returns.first[n] + k
            if 0 <= t < period_ticks:
                if returns.earlier[n, k] != earlier:
                    earlier = returns.earlier[n, k]
                    left = math.exp(-light[n] * earlier)
                work.coming[t] += signal
                work.silent[0, t] *= 1 - alive * (1 - quiet)
                work.silent[1, t] *= 1 - left * alive * (1 - quiet)
                _without_pixel(work.company[t], dark_fires)
                _with_pixel(work.company[t], fires)
                _without_pixel(work.company_later[t], dark_later_fires)
                _with_pixel(work.company_later[t], later)


@part
def _alive(returns: _Returns, n: int, light: np.ndarray, noise: float, dead_ticks: float) -> float:
    """Return the chance that a return's pixel is not dead from its background or an earlier
    return.
    """
    alive = 1 / (1 + noise * dead_ticks)
    for m in range(len(light)):
        since = returns.first[n] - returns.first[m]
        if returns.pixel[m] == returns.pixel[n] and 0 < since < dead_ticks:
            alive *= math.exp(-light[m])
    return alive


@part
def _with_pixel(company: np.ndarray, fires: float) -> None:
    """Add a pixel to the chances of so many pixels; fires: its own chance."""
    for k in range(len(company) - 1, 0, -1):
        company[k] += fires * (company[k - 1] - company[k])
    company[0] *= 1 - fires


@part
def _without_pixel(company: np.ndarray, fires: float) -> None:
    """Take a pixel out again."""
    silent = max(LEAST, 1 - fires)
    company[0] /= silent
    for k in range(1, len(company)):
        company[k] = (company[k] - fires * company[k - 1]) / silent


@part(allocates=True)
def _walk_cycles(subgroup: _Subgroup, work: _Work, silent: float) -> tuple[float, float]:
    """Compute `waits` of the lit cycles; return the ticks of a period in which the tree waits for a
    photon behind an open gate, and the windows that it opens.

    silent: chance that no pixel fires in a tick without light.
    """
    phases = subgroup.phases
    cycles = len(work.lit_cycle)
    coming = np.zeros(cycles + 4 + subgroup.rearm + subgroup.window // phases)
    away = np.zeros(len(coming) - cycles)  # of an armed tree: armed again so many cycles later
    dark_ticks = 0.0
    left = 1.0
    for t in range(phases):
        close = _close_cycle(t, subgroup.window, phases)
        away[_armed_cycle(close, subgroup.rearm)] += left * (1 - silent)
        dark_ticks += left
        left *= silent
    dark_stays = left
    before = 0.0  # chance that the tree was armed all through the cycle before
    is_open = 0  # pulses of a frame whose gate is open
    ticks = 0.0
    windows = 0.0
    for c in range(cycles):
        begin = c * phases
        closes = subgroup.turns.closes[c]
        if closes:
            # The trees behind the gates that close are taken to be as often armed as the others.
            stays = 1 - closes / is_open
            before *= stays
            for k in range(c, len(coming)):
                coming[k] *= stays
        is_open += subgroup.turns.opens[c] - closes
        coming[c] += subgroup.turns.opens[c] / subgroup.frame_pulses
        armed = (before, coming[c])
        before = 0.0
        if begin >= subgroup.open_ticks or is_open == 0:
            for t in range(begin, begin + phases):
                work.waits[0, t] = 0.0
                work.waits[1, t] = 0.0
        elif work.lit_cycle[c]:
            for after in range(2):
                left = armed[after]
                for t in range(begin, begin + phases):
                    work.waits[after, t] = left
                    opens = left * (1 - work.silent[after, t])
                    close = _close_cycle(t, subgroup.window, phases)
                    coming[_armed_cycle(close, subgroup.rearm)] += opens
                    ticks += left
                    windows += opens
                    left -= opens
                before += left
        else:
            whole = armed[0] + armed[1]
            for k in range(1, len(away)):
                coming[c + k] += whole * away[k]
            ticks += whole * dark_ticks
            windows += whole * (1 - dark_stays)
            before = whole * dark_stays
    return ticks, windows


@part(allocates=True)
def _expect_hits(
    subgroup: _Subgroup,
    returns: _Returns,
    light: np.ndarray,
    noise: float,
    work: _Work,
    expected: _Expected,
) -> None:
    """Compute what is expected of each return."""
    number, ticks = returns.share.shape
    window = subgroup.window
    period_ticks = len(work.counted)
    orders = len(subgroup.rejected)
    company = np.empty(orders)
    # chance that no pixel with a lower number fires in a tick
    lower = np.ones((2, 1 if subgroup.mapped else period_ticks))
    if not subgroup.mapped:
        _count_noise(subgroup, returns, noise, work)
    for n in range(number):
        own = noise * subgroup.activity[returns.pixel[n]]
        alive = work.alive[n]
        hits = 0.0
        of_noise = 0.0
        rise = 0.0
        joint = 0.0
        earlier = 0.0
        left_then = 1.0  # chance that the pixel did not fire before the tick's cycle
        inside = 0.0  # share of the pulse in the window from tick k on
        for k in range(ticks - 1, -1, -1):
            share = returns.share[n, k]
            inside += share
            if k + window < ticks:
                inside = max(0.0, inside - returns.share[n, k + window])
            t = returns.first[n] + k
            if not 0 <= t < period_ticks:
                continue
            fires = work.fires[n, k]
            later = work.later[n, k]
            _copy(work.company[t], company)
            _without_pixel(company, fires)
            kept = 1 - _rejected(company, subgroup.rejected)
            one_less = company[orders - 1] * subgroup.rejected[orders - 1] * work.coming[t]
            _copy(work.company_later[t], company)
            _without_pixel(company, later)
            kept_later = 1 - _rejected(company, subgroup.rejected)
            now = 0.0
            if not subgroup.mapped:
                now = alive * (1 - math.exp(-own - light[n] * share))
            if returns.earlier[n, k] != earlier:
                earlier = returns.earlier[n, k]
                left_then = math.exp(-light[n] * earlier)
            for after in range(2):
                waits = work.waits[after, t]
                left = left_then if after else 1.0
                spent = earlier if after else 0.0
                silent = work.silent[after, t]
                here = left * (fires * kept - later * kept_later * silent)
                if subgroup.mapped:
                    noise_here = own * (window * kept - (window - 1) * kept_later * silent)
                    rise_here = (alive - fires) * inside * kept
                    rise_here -= (alive - later) * (inside - share) * kept_later * silent
                    rise_here = left * rise_here - spent * here
                else:
                    work.counted[t] += waits * here
                    won = lower[after, t] * (kept + kept_later) / 2
                    here = left * now * won
                    noise_here = own * won
                    rise_here = left * (alive - now) * share * won - spent * here
                    lower[after, t] *= 1 - left * now
                hits += waits * here
                joint += waits * here / max(LEAST, kept) * one_less
                of_noise += waits * noise_here
                rise += waits * rise_here
        expected.hits[n] = hits
        expected.noise[n] = of_noise
        expected.rise[n] = rise
        expected.joint[n] = joint / max(LEAST, hits)
    for n in range(number if not subgroup.mapped else 0):
        total = 0.0
        for t in range(max(0, returns.first[n]), min(period_ticks, returns.first[n] + ticks)):
            total += work.counted[t]
        expected.together[n] = total


@part
def _count_noise(subgroup: _Subgroup, returns: _Returns, noise: float, work: _Work) -> None:
    """Compute `counted` for the pixels without a return there."""
    number, ticks = returns.share.shape
    window = subgroup.window
    mean = noise * subgroup.activity.sum() / len(subgroup.activity)
    for t in range(len(work.counted)):
        work.counted[t] = len(subgroup.activity)
    for n in range(number):
        for t in range(max(0, returns.first[n]), min(len(work.counted), returns.first[n] + ticks)):
            work.counted[t] -= 1
    for t in range(len(work.counted)):
        if work.lit[t] and work.counted[t] > 0:
            kept = 1 - _rejected(work.company[t], subgroup.rejected)
            kept_later = 1 - _rejected(work.company_later[t], subgroup.rejected)
            here = 0.0
            for after in range(2):
                one = window * kept - (window - 1) * kept_later * work.silent[after, t]
                here += work.waits[after, t] * one
            work.counted[t] *= mean * here
        else:
            work.counted[t] = 0.0


@part
def _copy(source: np.ndarray, target: np.ndarray) -> None:
    """Copy the values of a line to another one of the same length."""
    for k in range(len(target)):
        target[k] = source[k]


@part
def _rejected(company: np.ndarray, rejected: np.ndarray) -> float:
    """Return the chance that a window of a pixel and its company is rejected."""
    total = 0.0
    for k in range(len(rejected)):
        total += company[k] * rejected[k]
    return total
