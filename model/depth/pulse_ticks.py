# SPDX-License-Identifier: Apache-2.0
"""The pulse as the estimators know it: when the first photons of a surface come, in ticks.

It is a Gaussian, or the table of a measured pulse (`Pulse`). Laser and jitter are both in it.
"""

import math
from functools import lru_cache
from types import NoneType
from typing import NamedTuple

import numpy as np
from scipy import special

from ..contract.config import Config
from ..shared.arguments import check_kind
from ..shared.pulse import Pulse
from ..shared.quantities import Numbers
from .arrivals import SYSTEM_FWHM_S, pulse_sigma_ticks

REACH_SIGMAS = 4.0  # from the centre of a pulse to its beginning and end
KEPT = 32  # widened tables, at most
KEPT_CENTRES = 4096  # of first photons, at most
POINTS_PER_TICK = 4  # of a widened table
NEAR_SIGMAS = 1.2  # half width of the bins that determine the centre of a peak of a histogram
FINE = 16  # steps per tick, for the centre of the first photons
CENTRINGS = 50  # in which this centre moves no more


class PulseTicks(NamedTuple):
    """Shape of a pulse around the time of its surface, in ticks."""

    sigma: float  # half of the width that has 68 % of the light in its middle
    times: tuple[float, ...] = ()  # of a table, ascending; empty: a Gaussian
    shares: tuple[float, ...] = ()  # of the light before these times; linear between them

    @property
    def reach(self) -> int:
        """Ticks from the surface's time to the pulse's beginning and end."""
        if not self.times:
            return math.ceil(REACH_SIGMAS * self.sigma)
        outside = special.ndtr(-REACH_SIGMAS)
        first = self.quantile(outside)
        last = self.quantile(1 - outside)
        return math.ceil(max(-first, last))

    def share_before(self, time: np.ndarray) -> np.ndarray:
        """Return the share of the light before times, in ticks from the surface's."""
        if not self.times:
            return special.ndtr(time / self.sigma)
        return np.interp(time, self.times, self.shares)

    def quantile(self, share: float) -> float:
        """Return the time before which so much of a table's light comes."""
        return float(np.interp(share, self.shares, self.times))

    @property
    def near(self) -> int:
        """Ticks from the centre of a peak of stamps to the farthest ones that set it."""
        return round(NEAR_SIGMAS * self.sigma)

    def lead(self, photons: Numbers) -> np.ndarray:
        """Return the ticks by which the first of so many photons (float64, at least 1) comes before
        the surface's time, in the centre as a peak's is found.

        The first photons are skewed, and a tail moves their mean, but hardly their peak. So with
        this lead, the peaks of all numbers of photons have their centres at the surface's time.
        """
        numbers, row = np.unique(photons, return_inverse=True)
        leads = np.array([-_centre_of_first(self, number) for number in numbers.tolist()])
        return leads[row].reshape(np.shape(photons))

    def widened(self, width: int) -> "PulseTicks":
        """Return the pulse that a slanted surface sends back, whose sigma is `width` times as
        large.
        """
        if not self.times:
            return PulseTicks(width * self.sigma)
        return _widened(self, width)


def pulse_ticks(
    config: Config, system_fwhm_s: float = SYSTEM_FWHM_S, pulse: Pulse | None = None
) -> PulseTicks:
    """Return the shape in ticks: of a measured pulse, or of a Gaussian (None). Raises
    `InputError`.
    """
    check_kind("config", config, Config)
    sigma_ticks = pulse_sigma_ticks(config, system_fwhm_s)
    check_kind("pulse", pulse, Pulse, NoneType)
    if pulse is None:
        return PulseTicks(sigma_ticks)
    times = pulse.time_s / config.tick_s
    table = PulseTicks(0.0, tuple(times.tolist()), tuple(pulse.share_before.tolist()))
    beside = special.ndtr(-1)
    return table._replace(sigma=(table.quantile(1 - beside) - table.quantile(beside)) / 2)


@lru_cache(KEPT_CENTRES)
def _centre_of_first(pulse: PulseTicks, photons: float) -> float:
    """Return the centre of the first of so many photons: the mean of those that are near this
    mean.
    """
    first = pulse.times[0] if pulse.times else -float(pulse.reach)
    last = pulse.times[-1] if pulse.times else float(pulse.reach)
    border = np.arange(first, last + 2 / FINE, 1 / FINE)
    none_yet = (1 - pulse.share_before(border)) ** photons
    chance = none_yet[:-1] - none_yet[1:]
    time = (border[:-1] + border[1:]) / 2
    reach = pulse.near + 0.5
    together = np.convolve(chance, np.ones(round(2 * reach * FINE) + 1), "same")
    centre = float(time[together.argmax()])
    for _ in range(CENTRINGS):
        is_near = abs(time - centre) <= reach
        centre = float(np.average(time[is_near], weights=chance[is_near]))
    return centre


@lru_cache(KEPT)
def _widened(pulse: PulseTicks, width: int) -> PulseTicks:
    """Return a table, convolved with the Gaussian that makes it `width` times as wide."""
    if width == 1:
        return pulse
    sigma = pulse.sigma * math.sqrt(width**2 - 1)
    reach = math.ceil(pulse.reach + 2 * REACH_SIGMAS * sigma)
    times = np.arange(-reach * POINTS_PER_TICK, reach * POINTS_PER_TICK + 1) / POINTS_PER_TICK
    borders = np.array(pulse.times)
    photons = np.diff(pulse.shares)
    shares = np.zeros(len(times))
    for i in np.flatnonzero(photons):
        since = _integral((times - borders[i]) / sigma)
        until = _integral((times - borders[i + 1]) / sigma)
        shares += photons[i] * sigma / (borders[i + 1] - borders[i]) * (since - until)
    shares = np.maximum.accumulate(np.clip(shares, 0, 1))
    shares[0] = 0.0
    shares[-1] = 1.0
    return PulseTicks(width * pulse.sigma, tuple(times.tolist()), tuple(shares.tolist()))


def _integral(time: np.ndarray) -> np.ndarray:
    """Return the integral of the normal distribution function up to a time, in sigmas."""
    density = np.exp(-(time**2) / 2) / math.sqrt(2 * math.pi)
    return time * special.ndtr(time) + density
