# SPDX-License-Identifier: Apache-2.0
"""Depth from a measured pulse: a Gaussian whose tail is exponential, as detectors have it."""

import numpy as np
import pytest
from scipy import special

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth.arrivals import SYSTEM_FWHM_S
from coincid.model.depth.pulse_ticks import PulseTicks, pulse_ticks
from coincid.model.scenes.scene import Scene, scene_light
from coincid.model.shared.constants import SIGMA_PER_FWHM
from coincid.model.shared.errors import InputError
from coincid.model.shared.pulse import Pulse

SIZE = 16
DISTANCE_M = 4.0
SIGMA_S = SYSTEM_FWHM_S * SIGMA_PER_FWHM
TAIL_SHARE = 0.27
TAIL_S = 250e-12
TIME_S = np.arange(-1500, 4000, 10) * 1e-12


def gaussian_pulse() -> Pulse:
    return Pulse(time_s=TIME_S, density=np.exp(-((TIME_S / SIGMA_S) ** 2) / 2))


def tailed_pulse() -> Pulse:
    """Return a pulse, of which some photons are late by an exponential time."""
    ratio = SIGMA_S / TAIL_S
    early = np.exp(-((TIME_S / SIGMA_S) ** 2) / 2) / (SIGMA_S * np.sqrt(2 * np.pi))
    late = np.exp(ratio**2 / 2 - TIME_S / TAIL_S) * special.ndtr(TIME_S / SIGMA_S - ratio) / TAIL_S
    return Pulse(time_s=TIME_S, density=(1 - TAIL_SHARE) * early + TAIL_SHARE * late)


@pytest.fixture(scope="module")
def run():
    shape = (SIZE, SIZE)
    scene = Scene(
        name="wall", distance_m=np.full(shape, DISTANCE_M), reflectivity=np.full(shape, 0.4)
    )
    setup = Setup.of(
        scene,
        sensor={"rows": SIZE, "cols": SIZE, "streams": 4},
        frame={"pulses": 1000},
    )
    return Run(setup.but(light=scene_light(scene, 10.0, pulse=tailed_pulse())), workers=2)


def bias_mm(depth):
    return float(np.mean(depth.depth_m[:, :, 0] - DISTANCE_M)) * 1e3


def test_planes_with_the_measured_pulse_have_no_bias(run):
    told = run.depth()
    assert abs(bias_mm(told)) < 1
    assert bias_mm(run.depth(pulse=None)) > 2
    signal = run.light.total_signal.mean()
    assert told.signal_per_pulse.mean() == pytest.approx(signal, rel=0.03)


@pytest.mark.parametrize("method", ["maximum", "matched", "background"])
def test_estimators_that_assume_a_gaussian_refuse_a_measured_pulse(run, method):
    with pytest.raises(InputError, match=f"pulse: the estimator {method} assumes a Gaussian"):
        run.depth(method=method)


@pytest.mark.parametrize("width", [1, 2, 4])
def test_table_of_a_gaussian_is_the_gaussian(run, width):
    usual: PulseTicks = pulse_ticks(run.config).widened(width)
    table = pulse_ticks(run.config, pulse=gaussian_pulse()).widened(width)
    time = np.linspace(-2 * usual.reach, 2 * usual.reach, 999)
    assert table.sigma == pytest.approx(usual.sigma, rel=1e-3)
    assert abs(table.reach - usual.reach) <= 1
    np.testing.assert_allclose(table.share_before(time), usual.share_before(time), atol=5e-4)
