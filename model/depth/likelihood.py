# SPDX-License-Identifier: Apache-2.0
"""Likelihood of the sensor's words as a function of each pixel's surface time, on which the
estimator of planes rests.

All of this is our own choice; the paper (IV) takes the peak of every pixel's histogram. All
likelihoods are relative to a pixel that sees no surface, whose hits are background. The stages are:

1. cut the events of each subgroup into clusters (`clusters.py`);
2. compute how often a pixel that fires leaves no trace (`unheard.py`), and from it the chance that a
   photon of a surface makes an event (`heard.py`);
3. with the law of a subgroup (`law.py`), add up what the events say about each time and light of a
   pixel (`evidence.py`);
4. learn how bright the pixels of the frame are (`light_prior.py`), and average over the lights
   (`lights.py`).
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from ..contract.config import Config
from ..contract.pixels import pixel_table
from . import portable
from .clusters import SubgroupEvents, cluster_events
from .evidence import WAYS, Pixels, Shape, add_events, first_shares
from .heard import heard_in, nothing_heard
from .histograms import Events, by_subgroup
from .law import Law, fired_table
from .light_prior import (
    OFFSETS_SIGMAS,
    LightPrior,
    fall,
    learned_prior,
    mean_prior,
    own_priors,
    prior_in_doubt,
    prior_on_surfaces,
)
from .lights import add_chances_on_surfaces, add_light_chances, lights_near, mean_over_lights
from .others import OwnWindows, moves_with_others
from .pulse_ticks import PulseTicks
from .unheard import BLIND_MAX, Guess, Spread, Unheard

DEAD_S = 8e-9  # dead time of a SPAD (paper II)
QUIET_RATE = 1e-7  # photons per tick and pixel, at least: some background is everywhere


class Grid(NamedTuple):
    """Times and lights at which the likelihood is computed."""

    step: int  # ticks between times, which are step * (k + 1/2)
    lights: np.ndarray  # float32[L], photons per pulse
    prior: LightPrior | None  # of the lights; None: to be learned

    def fallen(self, first: np.ndarray, bins: int) -> np.ndarray:
        """float64, as `first`: of `fall`, in the middle of each pixel's times.

        first: int64, index of a pixel's first time. bins: number of its times.
        """
        return fall((first + bins / 2) * self.step)


class Levels(NamedTuple):
    """What is known of each pixel's times, [rows, cols, bins]."""

    level: np.ndarray  # float32, log likelihood ratio
    light: np.ndarray  # uint8, index of the likeliest light
    prior: LightPrior  # of the lights


class _Frame(NamedTuple):
    """What the likelihood is computed from."""

    events: Events
    config: Config
    pulse: PulseTicks
    shape: Shape  # of the pulse, for kernels
    pulses: int  # in which the events came
    grid: Grid
    never: Unheard
    first: np.ndarray  # int64[subgroups, pixels], index of the pixel's first time in the grid
    bins: int  # number of a pixel's times
    activity: np.ndarray  # float64[subgroups, pixels], background relative to the mean
    guess: Guess | None
    known: np.ndarray  # bool[subgroups, pixels]: does the guess know the pixel's time?
    lights: list[slice]  # by subgroup, the lights of the grid that its pixels may have
    fallen: np.ndarray  # float64[subgroups, pixels], of the grid
    clusters: list[SubgroupEvents]  # by subgroup
    origins: np.ndarray  # int64[subgroups], first time that some pixel wants
    spans: np.ndarray  # int64[subgroups], times from it to the last one that some pixel wants
    noise: np.ndarray  # float64[subgroups], background photons per tick and pixel
    alive: np.ndarray  # float64[subgroups], share of the pulses in which none has fired a pixel yet

    @property
    def reach(self) -> int:
        """Ticks from the centre of the pulse to its beginning and end."""
        return self.pulse.reach

    @property
    def with_offsets(self) -> bool:
        """Whether offsets are used: for that, approximate times of the surfaces must be known."""
        return self.guess is not None and self.events.offset.shape[1] > 0

    def with_others(self, s: int) -> bool:
        """Whether the counts of the events of subgroup s tell of pixels that they do not name.

        Without coincidence, an event is one photon.
        """
        unnamed = not self.events.mapped and self.events.window[s] > 1
        return self.guess is not None and bool(unnamed)


def log_likelihood(
    events: Events,
    config: Config,
    pulse: PulseTicks,
    pulses: int,
    grid: Grid,
    never: Unheard,
    first: np.ndarray,
    bins: int,
    *,
    activity: np.ndarray | None = None,
    guess: Guess | None = None,
    on_surfaces: bool = False,
    spread: Spread = map,
) -> Levels:
    """Return the log likelihood ratio of each pixel's times, as a mean over the lights, and the
    likeliest light at each.

    pulses: number of pulses in which the events came. never: from `unheard`, for the same events.
    first: int64[subgroups, pixels], index of the pixel's first time in the grid. bins: number of a
    pixel's times. activity: float64[subgroups, pixels], background of each pixel relative to the
    mean (None: all equal). guess: needed to use offsets, which are ignored without it, and to learn
    the prior. on_surfaces: whether the prior is learned at the times of the guess, which are those of
    surfaces that neighbours share. spread: a `map` over subgroups that may use any order.
    """
    sensor = config.sensor
    subgroups = range(sensor.subgroups)
    if activity is None:
        activity = np.ones((sensor.subgroups, sensor.pixels))
    known = np.zeros(config.mask.shape, bool)
    lights = [slice(0, len(grid.lights))] * sensor.subgroups
    if guess is not None:
        known = config.mask & ~np.isnan(guess.time)
        lights = [lights_near(guess.light[s][known[s]], grid.lights) for s in subgroups]
    noise, alive = _background(events, config)
    times = -(-(config.period_ticks - grid.step // 2) // grid.step)
    origins = np.clip(first.min(axis=1), 0, times - 1)
    frame = _Frame(
        events=events,
        config=config,
        pulse=pulse,
        shape=Shape(pulse.sigma, np.array(pulse.times), np.array(pulse.shares)),
        pulses=pulses,
        grid=grid,
        never=never,
        first=first,
        bins=bins,
        activity=activity,
        guess=guess,
        known=known,
        lights=lights,
        fallen=grid.fallen(first, bins),
        clusters=[],
        origins=origins,
        spans=np.clip(first.max(axis=1) + bins, origins + 1, times) - origins,
        noise=noise,
        alive=alive,
    )
    clusters = cluster_events(events, config, pulses, frame.reach, frame.with_offsets)
    frame = frame._replace(clusters=clusters)
    shape = (sensor.rows, sensor.cols, bins)
    level = np.empty((sensor.array_pixels, bins), np.float32)
    light = np.empty((sensor.array_pixels, bins), np.uint8)
    place = by_subgroup(np.arange(sensor.array_pixels), sensor)
    where = portable.log(grid.lights).astype(np.float32)

    def average(s: int, prior: LightPrior, evidence: _Evidence) -> None:
        own = own_priors(prior, grid.lights, frame.fallen[s])
        if events.mapped and events.threshold[s] > 1:
            own = prior_in_doubt(own, never.doubt[s])
        own = np.ascontiguousarray(own[:, lights[s]])
        common, pixels = evidence
        mean_over_lights(
            common,
            pixels,
            mean_prior(own, config.mask[s]),
            own,
            where[lights[s]],
            lights[s].start,
            place[s],
            level,
            light,
            -np.inf,
        )
        if frame.with_others(s):
            level[place[s]] += _moves(frame, s)

    if grid.prior is not None:
        prior = grid.prior
        list(spread(lambda s: average(s, prior, _evidence(frame, s)), subgroups))
    else:
        found = list(spread(partial(_evidence, frame), subgroups))
        learned = _prior_on_surfaces if on_surfaces else _learned_prior
        prior = learned(frame, found, spread)
        list(spread(lambda s: average(s, prior, found[s]), subgroups))
    return Levels(level.reshape(shape), light.reshape(shape), prior)


class _Evidence(NamedTuple):
    """What a subgroup's events say, logarithms of likelihoods."""

    common: np.ndarray  # float32[times * lights], about pixels without a hit
    pixels: Pixels  # about those that were hit


def _evidence(frame: _Frame, s: int) -> _Evidence:
    """Return what the events of subgroup s say."""
    own = frame.clusters[s]
    law = _law(frame, s)
    minigroup = pixel_table(frame.config.sensor).minigroup
    guess = frame.guess
    if guess is not None and frame.with_offsets:
        time = guess.time[s]
        shares = first_shares(law, own, minigroup, time, guess.light[s], frame.shape)
        own = own._replace(shares=shares)
    number = len(minigroup)
    pixels = Pixels(
        minigroup=minigroup,
        mask=frame.config.mask[s],
        activity=frame.activity[s],
        first=frame.first[s] - law.origin,
        total=np.empty((number, frame.bins * law.lights), np.float32),
        touched=np.zeros((number, frame.bins), np.bool_),
        counted=np.full(number, -1),
        number=np.empty((WAYS, number), np.int64),
        hit=np.empty(number, np.int64),
    )
    return _Evidence(add_events(law, own, pixels), pixels)


def _law(frame: _Frame, s: int) -> Law:
    """Return the law for the events of subgroup s."""
    events = frame.events
    config = frame.config
    step = frame.grid.step
    never = frame.never
    lights = frame.grid.lights[frame.lights[s]]
    window = int(events.window[s])
    origin = int(frame.origins[s])
    span = int(frame.spans[s])
    widest = 1 << int(frame.spans.max() - 1).bit_length()  # one table for all subgroups
    margin, fired = fired_table(frame.pulse, frame.reach, step, widest, tuple(lights.tolist()))
    alive = np.float32(frame.alive[s])
    kinds = 1 + int(frame.clusters[s].overrun.any())

    law = Law(
        window=window,
        mapped=events.mapped,
        phases=config.sensor.phases,
        offset=config.sensor.offset_ticks,
        reach=frame.reach,
        step=step,
        origin=origin,
        lights=len(lights),
        noise=float(frame.noise[s]),
        alive=alive,
        pulses=frame.pulses,
        heard=nothing_heard(),
        sharp=np.empty((0, 0, 0), np.float32),
        margin=margin,
        fired=fired,
    )
    return law._replace(
        heard=heard_in(law, never.missed[:kinds, s], never.every, span, config),
        sharp=law.alive * (1 - _blind_before(never.blind[:kinds, s], never.every, window, config)),
    )


def _background(events: Events, config: Config) -> tuple[np.ndarray, np.ndarray]:
    """Return the background photons per tick and live pixel of each subgroup, and the share of the
    pulses in which none of them has fired a pixel yet, float64[subgroups].
    """
    live = np.maximum(config.mask.sum(axis=1), 1)
    noise = np.maximum(events.photon_rate / live, QUIET_RATE)
    return noise, 1 - np.minimum(BLIND_MAX, noise * DEAD_S / config.tick_s)


def _moves(frame: _Frame, s: int) -> np.ndarray:
    """float32[pixels, bins]: what the counts of the events of subgroup s say about the times."""
    guess = frame.guess
    assert guess is not None
    events = frame.events
    return moves_with_others(
        OwnWindows(
            stamp=frame.clusters[s].stamp,
            winner=frame.clusters[s].winner,
            others=events.count[events.bounds[s] : events.bounds[s + 1]] - 1,
        ),
        int(events.window[s]),
        frame.pulse,
        float(frame.noise[s]),
        float(frame.alive[s]),
        frame.config.mask[s],
        guess.time[s],
        guess.light[s],
        (frame.first[s][:, None] + np.arange(frame.bins) + 0.5) * frame.grid.step,
    )


def _blind_before(blind: np.ndarray, every: int, window: int, config: Config) -> np.ndarray:
    """float32[kinds, 2, cycles]: mean of `blind` over the ticks of the cycle before each cycle, and
    over those before it from which the tree is not armed until this cycle.

    blind: float32[kinds, points], of `Unheard`, a point for every `every` ticks.
    """
    phases = config.sensor.phases
    before = max(1, window - 1 + config.sensor.rearm * phases)
    begins = np.arange(config.period) * phases
    middle = np.maximum(0, begins - min(before, phases))
    since = np.minimum(middle, np.maximum(0, begins - before))
    by_tick = np.repeat(blind.astype(np.float64), every, axis=1)[:, : config.period_ticks]
    total = np.cumsum(np.pad(by_tick, ((0, 0), (1, 0))), axis=1)
    ends = np.stack([begins, middle])
    starts = np.stack([middle, since])
    mean = (total[:, ends] - total[:, starts]) / np.maximum(1, ends - starts)
    return mean.astype(np.float32)


def _learned_prior(frame: _Frame, found: Sequence[_Evidence], spread: Spread) -> LightPrior:
    """Return the prior of the lights, learned from the pixels whose time the guess knows."""
    chance = np.zeros((*frame.known.shape, len(frame.grid.lights)), np.float32)

    def add(s: int) -> None:
        common, pixels = found[s]
        add_light_chances(common, pixels, frame.known[s], chance[s, :, frame.lights[s]])

    list(spread(add, range(len(found))))
    return learned_prior(chance[frame.known], frame.grid.lights, frame.fallen[frame.known])


def _prior_on_surfaces(frame: _Frame, found: Sequence[_Evidence], spread: Spread) -> LightPrior:
    """Return the prior of the lights, learned at the guess's times from the pixels of minigroups: most
    see one surface.
    """
    guess = frame.guess
    assert guess is not None
    minigroup = pixel_table(frame.config.sensor).minigroup
    order = np.argsort(minigroup, kind="stable")
    offset = OFFSETS_SIGMAS * frame.pulse.sigma / frame.grid.step
    chance = np.zeros((*frame.known.shape, len(offset), len(frame.grid.lights)), np.float32)
    there = frame.known.copy()

    def add(s: int) -> None:
        common, pixels = found[s]
        at = guess.time[s] / frame.grid.step - 0.5 - frame.first[s]
        add_chances_on_surfaces(
            common, pixels, at, offset, there[s], chance[s, :, :, frame.lights[s]]
        )

    list(spread(add, range(len(found))))
    there = there[:, order]
    group = np.arange(len(found))[:, None] * len(order) + minigroup[order]
    return prior_on_surfaces(
        chance[:, order][there],
        frame.grid.lights,
        frame.fallen[:, order][there],
        group[there],
    )
