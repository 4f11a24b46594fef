# SPDX-License-Identifier: Apache-2.0
"""Arrival times of events: their stamps, corrected for the lead of the first photon.

The stamp of an event is the time of its earliest photon, and its count says how many photons came within the window.
The earliest of N photons of a Gaussian pulse leads the pulse's centre, by 2 sigma for N = 35: more than what the paper
calls success (230 ps). The paper does not mention this, so it is our own choice: each event is moved later by the
expected lead of the earliest of its own photons.

Two limits. It takes the window for longer than the pulse: the count of a shorter one, and of coincidence off, says too
little, and such stamps stay early (the estimator of planes has their law instead). It takes an event for one flat
surface's: where surfaces nearer to each other than the window share a subgroup, the event is placed at the first of
them.
"""

import numpy as np
from scipy import special

from ..contract.config import Config
from ..shared.constants import SIGMA_PER_FWHM
from ..shared.quantities import Numbers, check_real

SYSTEM_FWHM_S = 500e-12  # laser pulse and jitter together (paper IV)

_BLOM = 0.375  # Blom 1958: expected normal order statistics, here within 0.03 sigma


def pulse_sigma_ticks(config: Config, system_fwhm_s: float = SYSTEM_FWHM_S) -> float:
    """Sigma of laser pulse and jitter together. Raises `InputError`."""
    return check_real("system_fwhm_s", system_fwhm_s, 1e-15, 1.0) * SIGMA_PER_FWHM / config.tick_s


def lead_sigmas(photons: Numbers) -> np.ndarray:
    """By how many sigma the earliest of `photons` (>= 1) normal arrival times leads their mean, on average (float64)."""
    return -special.ndtri((1 - _BLOM) / (np.asarray(photons, np.float64) + 1 - 2 * _BLOM))


def photons_of(count: Numbers, pixels: Numbers) -> np.ndarray:
    """Photons that make `count` of `pixels` distinct pixels fire, on average (float64); finite where all fired."""
    return -pixels * np.log1p(-np.minimum(count, pixels) / (pixels + 1))


def arrival_ticks(
    subgroup: np.ndarray, stamp: np.ndarray, count: np.ndarray, config: Config, sigma_ticks: float
) -> np.ndarray:
    """Expected centre of each event's pulse in ticks since the laser trigger, float64[n].

    subgroup, stamp, count: int64[n] of events. sigma_ticks: of the laser pulse and the jitter together.
    """
    pixels = np.maximum(config.mask.sum(axis=1), 1)[subgroup]
    return stamp + 0.5 + sigma_ticks * lead_sigmas(np.maximum(photons_of(count, pixels), 1))
