# SPDX-License-Identifier: Apache-2.0
"""Arrival times of events: their stamps, corrected for the lead of the first photon.

The stamp of an event is the time of its earliest photon, and its count is the number of pixels
that fired in the window. The earliest of N photons of a Gaussian pulse comes before the pulse's
centre: by 2 sigma for N = 35, which is more than the tolerance of the paper (230 ps). The paper
does not mention this lead, so the correction is our own choice: each event is moved later by the
lead of the earliest of its photons. This is the lead of their centre, as the peaks of histograms
find it (`PulseTicks.lead`).

There are two limits. First, the window should be longer than the pulse. If it is shorter, or
coincidence is off, the count is too low, and the stamps stay early (the estimator of planes
models this). Second, an event should come from one flat surface. If a subgroup sees surfaces
closer to each other than the window, the event is placed at the first of them.
"""

from collections.abc import Callable

import numpy as np

from ..contract.config import Config
from ..shared.constants import SIGMA_PER_FWHM
from ..shared.pulse import TIME_MAX_S
from ..shared.quantities import Numbers, check_real
from . import portable

SYSTEM_FWHM_S = 500e-12  # laser pulse and jitter combined (paper IV)


def pulse_sigma_ticks(config: Config, system_fwhm_s: float = SYSTEM_FWHM_S) -> float:
    """Return the sigma of laser pulse and jitter combined. Raises `InputError`."""
    fwhm_s = check_real("system_fwhm_s", system_fwhm_s, 1e-15, TIME_MAX_S)
    return fwhm_s * SIGMA_PER_FWHM / config.tick_s


def photons_of(count: Numbers, pixels: Numbers) -> np.ndarray:
    """Return the mean number of photons that fire `count` of `pixels` pixels (float64); it is
    finite if all fired.
    """
    return -pixels * portable.log1p(-np.minimum(count, pixels) / (pixels + 1))


def arrival_ticks(
    subgroup: np.ndarray,
    stamp: np.ndarray,
    count: np.ndarray,
    config: Config,
    lead: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return the expected centre of each event's pulse in ticks since the laser trigger,
    float64[n].

    subgroup, stamp, count: int64[n], per event. lead: ticks by which the first of so many photons
    comes before this centre, `PulseTicks.lead`.
    """
    pixels, kind = np.unique(np.maximum(config.mask.sum(axis=1), 1), return_inverse=True)
    occurs = np.flatnonzero(np.bincount(count))
    leads = np.zeros((len(pixels), config.sensor.pixels + 1))
    leads[:, occurs] = lead(np.maximum(photons_of(occurs, pixels[:, None]), 1))
    return stamp + 0.5 + leads[kind[subgroup], count]
