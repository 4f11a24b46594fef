# SPDX-License-Identifier: Apache-2.0
"""Estimator for real geometry: the time of every pixel from the likelihood of all events, on planes
that neighbours share.

All of this is our own choice. `surfaces.py` has the steps. This file has what they read of events:
the likelihood (`likelihood.py`), for which the surfaces must be known roughly, and how bright the
pixels are in general.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from attrs import evolve

from ..contract.config import Config
from ..shared.threads import Threads
from .histograms import Events, by_subgroup, hits_away, pixel_image
from .intensity import find_intensity
from .light_prior import EVEN, LightPrior, measured_prior
from .likelihood import Grid, Levels, log_likelihood
from .named_light import named_light
from .pulse_ticks import PulseTicks
from .surfaces import BRIGHT_PHOTONS, Coarse, Fitter, peak_offset
from .unheard import Guess, Spread, SubgroupWindows, Unheard, unheard, unheard_in_light, windows_of

HOT = 2.0  # background relative to the mean from which on a pixel's own value is used
ACTIVITY_HITS = 10.0  # weight of the prior, in hits
BRIGHT_SHARE = 0.05  # of the pixels
STORED_FEW = 0.5  # of the windows
NEAR_SIGMAS = 3.0  # from a seed to stamps that may be its light


def find_surfaces(
    events: Events,
    config: Config,
    pulse: PulseTicks,
    pulses: int,
    *,
    tolerance_ticks: float,
    threads: Threads,
    returns: int = 1,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find the surfaces that the pixels see. pulses: number of pulses in which the events came.

    Returns (time, confidence, error), [rows, cols, returns], and slope, [rows, cols, 2], down and
    right; in ticks. confidence: probability that the first return is within `tolerance_ticks`, and
    that the others are not accidental. The number of threads does not change the result.
    """
    fitter = Fitter.of(pulse.sigma, config.period_ticks, pulses, config.sensor.rows, threads)
    windows = windows_of(events, config, pulses, pulse, threads.map)
    frame = _Frame(
        events=events,
        config=config,
        pulse=pulse,
        pulses=pulses,
        fitter=fitter,
        spread=threads.map,
        windows=windows,
        rough=unheard(windows, config, pulse, threads.map),
    )
    coarse, guess, never = _look_coarsely(frame)
    middle = coarse.middle
    first = fitter.first(middle)
    near = _Near(
        told=evolve(events, offset=events.offset[:, :0]),
        guess=guess,
        never=never,
        activity=background_activity(events, config.mask, guess.time, pulse.sigma),
    )
    prior = None
    if not events.mapped:
        guess, prior = _counted_light(frame, guess, threads)
        near = near._replace(guess=guess)
    levels = _around(frame, near, prior, 1, first)
    prior = levels.prior
    fit = fitter.fit(levels, first)
    uncertain = events.mapped and _lights_are_uncertain(frame, near.guess)
    # What an offset says, or a count without a map, depends on the other pixels' surfaces, and so
    # does which windows are dropped.
    dropped = _most_are_dropped(events)
    if uncertain or dropped or events.offset.shape[1] or not events.mapped:
        sharper = fitter.refined(fit).time
        guess = _sharper_guess(frame, near.guess, levels, first, sharper)
        near = near._replace(told=events, guess=guess, never=_never(frame, guess))
        if uncertain:
            levels = _around(frame, near, None, 1, first, on_surfaces=True)
            prior = levels.prior
        else:
            levels = _around(frame, near, prior, 1, first)
        fit = fitter.fit(levels, first)
    again = partial(_around, frame, near, prior)
    return fitter.surfaces(
        fitter.with_slants(fit, levels.level, middle, again),
        coarse,
        again,
        tolerance_ticks=tolerance_ticks,
        returns=returns,
        apart_ticks=float(events.window.max()),
    )


class _Frame(NamedTuple):
    """What is known of a frame before any surface is."""

    events: Events
    config: Config
    pulse: PulseTicks  # of the laser
    pulses: int  # in which the events came
    fitter: Fitter
    spread: Spread  # over subgroups
    windows: list[SubgroupWindows]
    rough: Unheard


class _Near(NamedTuple):
    """What the likelihoods in single ticks rest on."""

    told: Events  # without offsets, as long as the surfaces are not known well enough for them
    guess: Guess  # of the surfaces
    never: Unheard
    activity: np.ndarray  # float64[subgroups, pixels], of `background_activity`


def _look_coarsely(frame: _Frame) -> tuple[Coarse, Guess, Unheard]:
    """Return the seeds of the pixels, on a grid over the whole period, a guess of the surfaces, and
    what is unheard in its light.
    """
    events = frame.events
    config = frame.config
    pulse = frame.pulse
    sensor = config.sensor
    fitter = frame.fitter
    possible = fitter.coarse_lights
    level, lights, _ = log_likelihood(
        events,
        config,
        pulse,
        frame.pulses,
        Grid(fitter.step, possible, EVEN),
        frame.rough,
        np.zeros((sensor.subgroups, sensor.pixels), np.int64),
        fitter.coarse_times,
        spread=frame.spread,
    )
    coarse = fitter.coarse(level, lights)
    found = coarse.found
    chosen = np.maximum(found.bin, 0)[:, :, None]
    light = np.take_along_axis(lights, chosen, 2)[:, :, 0]
    offset = peak_offset(level, found.bin, smooth=events.mapped)
    time = found.time(fitter.step) + fitter.step * offset
    guess = Guess(
        time=by_subgroup(time, sensor),
        light=possible[by_subgroup(light, sensor)].astype(np.float64),
    )
    lit = named_light(events, frame.windows, frame.rough, guess, frame.pulses, pulse)
    return coarse, guess, _never(frame, lit)


def _never(frame: _Frame, guess: Guess) -> Unheard:
    """Return what is unheard in the light of a guess."""
    return unheard_in_light(
        frame.windows,
        frame.rough,
        guess,
        frame.config,
        frame.pulses,
        frame.pulse,
        frame.spread,
    )


def _counted_light(frame: _Frame, guess: Guess, threads: Threads) -> tuple[Guess, LightPrior]:
    """Return the guess with the lights that the events' numbers of hits ask for, and the prior of
    these lights on the grid in single ticks.

    It is for events without maps: a light that is too faint fits their winners as well as a time
    that is too early does.
    """
    config = frame.config
    time = pixel_image(guess.time, config.sensor)[:, :, None]
    counted = find_intensity(frame.events, config, frame.pulse, frame.pulses, time, threads)
    signal = counted.signal[:, :, 0]
    error = counted.error[:, :, 0]
    prior = measured_prior(signal, error, frame.fitter.lights, time[:, :, 0])
    light = by_subgroup(np.nan_to_num(signal), config.sensor)
    return guess._replace(light=light), prior


def _lights_are_uncertain(frame: _Frame, guess: Guess) -> bool:
    """Return whether many pixels fire in most pulses, whatever their light is.

    At threshold 1, their light and their time are nearly one number: the brighter they are, the
    earlier they fire. Without coincidence, events do not tell more of the light than that.
    """
    free = _takes_every_window(frame.events)
    bright = guess.light[free][~np.isnan(guess.time[free])] > BRIGHT_PHOTONS
    return bool(bright.sum() > BRIGHT_SHARE * guess.light.size)


def _takes_every_window(events: Events) -> np.ndarray:
    """bool[subgroups]: whether coincidence is on with a threshold of 1."""
    return (events.threshold == 1) & (events.window > 1)


def _most_are_dropped(events: Events) -> bool:
    """Return whether at threshold 1 fewer than `STORED_FEW` of the windows are stored."""
    free = _takes_every_window(events)
    stored = np.diff(events.bounds)[free].sum()
    return bool(stored < STORED_FEW * events.committed[free].sum())


def _around(
    frame: _Frame,
    near: _Near,
    prior: LightPrior | None,
    width: int,
    first: np.ndarray,
    *,
    on_surfaces: bool = False,
) -> Levels:
    """Return the likelihoods for pulses so many times as wide as the laser's, in steps of as many
    ticks.

    prior: of the lights; None: to be learned, from each pixel alone or `on_surfaces`. first:
    int64[rows, cols], number of the first step.
    """
    return log_likelihood(
        near.told,
        frame.config,
        frame.pulse.widened(width),
        frame.pulses,
        Grid(width, frame.fitter.lights, prior),
        near.never,
        by_subgroup(first, frame.config.sensor),
        frame.fitter.bins,
        activity=near.activity,
        guess=near.guess,
        on_surfaces=on_surfaces,
        spread=frame.spread,
    )


def _sharper_guess(
    frame: _Frame, guess: Guess, levels: Levels, first: np.ndarray, time: np.ndarray
) -> Guess:
    """Return a guess with better times, and the likeliest lights there.

    first: int64[rows, cols], first tick of the levels. time: float64[rows, cols], ticks.
    """
    sensor = frame.config.sensor
    last = levels.level.shape[2] - 1
    inside = np.clip(np.floor(time) - first, 0, last).astype(np.int64)[:, :, None]
    light = frame.fitter.lights[np.take_along_axis(levels.light, inside, 2)[:, :, 0]]
    return Guess(
        time=np.where(np.isnan(guess.time), np.nan, by_subgroup(time, sensor)),
        light=by_subgroup(light, sensor).astype(np.float64),
    )


def background_activity(
    events: Events, mask: np.ndarray, seed: np.ndarray, sigma_ticks: float
) -> np.ndarray:
    """float64[subgroups, pixels]: background of a pixel over the mean of the live ones, from its
    hits away from its seed; 1 unless hot.

    mask: bool[subgroups, pixels], live pixels.
    """
    near = np.full(len(seed), NEAR_SIGMAS * sigma_ticks)
    hits = hits_away(events.stamp, events.hits, events.bounds, seed, near)
    live = np.maximum(mask.sum(axis=1, keepdims=True), 1)
    mean = np.where(mask, hits, 0).sum(axis=1, keepdims=True) / live
    ratio = (hits + ACTIVITY_HITS) / (mean + ACTIVITY_HITS)
    return np.where(ratio > HOT, ratio, 1.0)
