# SPDX-License-Identifier: Apache-2.0
"""A first guess of the pixels' lights, from how often events name them.

The lights of the coarse seeds are too far apart for the law of silence (`unheard.py`): a seed that is
a little too early looks three times as bright, and then the law expects other windows than came.
"""

import math

import numpy as np

from .histograms import Events, hits_away
from .pulse_ticks import PulseTicks
from .unheard import Guess, SubgroupWindows, Unheard

REACH_SIGMAS = 3.0  # from a seed to stamps of windows that may hold its light
HITS_MIN = 0.5  # of such pixels together, at least
NAMED_MIN = 0.02  # chance that a photon is named, at least
FIRED_MAX = 0.99  # share of the pulses in which a pixel fires, at most


def named_light(
    events: Events,
    windows: list[SubgroupWindows],
    rough: Unheard,
    guess: Guess,
    pulses: int,
    pulse: PulseTicks,
) -> Guess:
    """Return the guess with lights that fit the number of events that name the pixels.

    windows, rough: of `windows_of` and `unheard`. pulses: number of pulses in which the events came.
    Pixels of a subgroup whose seeds are alike share a light, since each alone has few hits. Where
    every window becomes an event, and where events do not name all their pixels, the guess stays as
    it is.
    """
    rejecting = [s for s, one in enumerate(windows) if one.tree.kept[1] < 1]
    if not events.mapped or not rejecting:
        return guess
    light = guess.light.copy()
    near = _hits_near(events, guess.time, pulse.sigma)
    for s in rejecting:
        known = np.isfinite(guess.time[s])
        named = _named(windows[s], rough.missed[0, s], rough.every, guess.time[s], pulse)
        for seed in np.unique(guess.light[s][known]):
            alike = known & (guess.light[s] == seed)
            hits = max(HITS_MIN, float(near[s][alike].sum()))
            fired = hits / pulses / max(NAMED_MIN, float(named[alike].sum()))
            light[s][alike] = -math.log(1 - min(fired, FIRED_MAX))
    return guess._replace(light=light)


def _hits_near(events: Events, time: np.ndarray, sigma_ticks: float) -> np.ndarray:
    """int64[subgroups, pixels]: each pixel's hits in windows that may hold the light of its seed."""
    half = events.window / 2
    middle = time - half[:, None]
    everywhere = np.full_like(time, np.nan)
    around = REACH_SIGMAS * sigma_ticks + half
    words = events.stamp, events.hits, events.bounds
    return hits_away(*words, everywhere, around) - hits_away(*words, middle, around)


def _named(
    windows: SubgroupWindows, missed: np.ndarray, every: int, time: np.ndarray, pulse: PulseTicks
) -> np.ndarray:
    """float64[pixels]: chance that an event names a pixel that fires at its seed.

    missed, every: of `Unheard`, for this subgroup. A pixel without a seed gets any value.
    """
    of_ticks = windows.of_ticks
    ticks = len(of_ticks.covered)
    covered = np.minimum(1, of_ticks.covered)
    waiting = np.maximum(0, 1 - covered - of_ticks.unarmed)
    kept = 1 - np.repeat(missed, every)[:ticks]
    named = of_ticks.stored * (covered + waiting * kept)
    beside = np.arange(-pulse.reach, pulse.reach + 1)
    share = pulse.share_before(beside + 0.5) - pulse.share_before(beside - 0.5)
    tick = np.nan_to_num(time).astype(np.int64)[:, None] + beside
    return (named[np.clip(tick, 0, ticks - 1)] * share).sum(axis=1)
