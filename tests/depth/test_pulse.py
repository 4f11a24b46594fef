# SPDX-License-Identifier: Apache-2.0
"""Depth from a measured pulse: a Gaussian whose tail is exponential, as detectors have it."""

import numpy as np
import pytest
from scipy import special

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.contract.result import read_result, write_result
from coincid.model.depth.arrivals import SYSTEM_FWHM_S
from coincid.model.depth.estimate import estimate_depth
from coincid.model.depth.histograms import pixel_histogram
from coincid.model.depth.pulse_ticks import PulseTicks, pulse_ticks
from coincid.model.depth.quality import TOLERANCE_M
from coincid.model.scenes.scene import Scene
from coincid.model.shared.constants import SIGMA_PER_FWHM
from coincid.model.shared.errors import InputError
from coincid.model.shared.pulse import Pulse

SIZE = 16
DISTANCE_M = 4.0
SIGMA_S = SYSTEM_FWHM_S * SIGMA_PER_FWHM
TAIL_SHARE = 0.27
TAIL_S = 250e-12
TIME_S = np.arange(-1500, 4000, 10) * 1e-12


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
    return Run(setup.but(klux=10.0, pulse=tailed_pulse()), workers=2)


def bias_mm(depth):
    return float(np.mean(depth.depth_m[:, :, 0] - DISTANCE_M)) * 1e3


@pytest.mark.parametrize("method", ["planes", "matched", "background"])
def test_estimators_that_know_the_measured_pulse_have_no_bias(run, method):
    told = run.depth(method)
    assert abs(bias_mm(told)) < 1
    signal = run.light.total_signal.mean()
    assert told.signal_per_pulse.mean() == pytest.approx(signal, rel=0.03)


@pytest.mark.parametrize("method", ["planes", "matched"])
def test_estimators_that_take_a_tail_for_a_gaussian_have_a_bias(run, method):
    assert bias_mm(run.depth(method, pulse=Pulse.gaussian(SYSTEM_FWHM_S))) > 2


def test_error_and_confidence_hold_with_a_tail():
    setup = Setup.of("sun-and-shade", klux=100, frame={"pulses": 100}, subgroup={"threshold": 2})
    run = Run(setup.but(pulse=tailed_pulse()), workers=2)
    depth = run.depth()
    off_m = np.abs(depth.depth_m[:, :, 0] - run.scene.truth_m)
    right = off_m <= TOLERANCE_M
    errors = off_m[right] / depth.error_m[:, :, 0][right]
    assert 0.60 < np.mean(errors <= 1) < 0.85
    assert np.mean(errors <= 2) > 0.90
    assert depth.confidence[:, :, 0].mean() == pytest.approx(right.mean(), abs=0.05)


@pytest.mark.parametrize("method", ["planes", "matched", "background"])
@pytest.mark.parametrize("later_s", [-600e-12, 600e-12])
def test_time_0_of_a_pulse_may_be_anywhere_in_it(run, method, later_s):
    """As it is in responses that a TCSPC system records: at the trigger, not at the peak."""
    pulse = Pulse(time_s=TIME_S + later_s, density=tailed_pulse().density)
    shifted = Run(run.setup.but(pulse=pulse), workers=2)
    assert abs(bias_mm(shifted.depth(method))) < 2


def test_result_that_is_read_back_has_its_pulse(run, tmp_path):
    write_result(tmp_path / "result.npz", run.result)
    arrays = read_result(tmp_path / "result.npz")
    same = estimate_depth(arrays, run.config, method="matched")
    np.testing.assert_array_equal(same.depth_m, run.depth("matched").depth_m)
    np.testing.assert_array_equal(
        pixel_histogram(arrays, run.config, 5),
        pixel_histogram(run.result, run.config, 5, pulse=tailed_pulse()),
    )
    del arrays["pulse_density"]
    with pytest.raises(InputError, match="pulse_time_s: the result must have both"):
        estimate_depth(arrays, run.config)


def test_minigroup_stamps_refuse_a_measured_pulse(run):
    with pytest.raises(InputError, match=r"pulse: .* \(source minigroup\) assume a Gaussian"):
        run.depth("matched/minigroup")


@pytest.mark.parametrize("photons", [1, 2, 10, 60])
@pytest.mark.parametrize("pulse", [None, tailed_pulse()], ids=["gaussian", "tail"])
def test_lead_puts_the_peak_of_the_first_photons_at_the_surface(run, photons, pulse):
    """The first of so many photons, drawn: after the lead, those near 0 have the mean 0."""
    shape = pulse_ticks(run.config, pulse=pulse)
    share = np.random.default_rng(1).random((100_000, photons)).min(axis=1)
    times = np.arange(-200, 200, 1 / 16)
    first = np.interp(share, shape.share_before(times), times)
    first += shape.lead(np.array([float(photons)]))
    assert abs(first[abs(first) < shape.near + 0.5].mean()) < 0.05


def test_lead_of_a_pulse_with_two_peaks_is_that_of_the_higher_one(run):
    time_s = np.array([0, 100, 101, 2999, 3000, 3100]) * 1e-12
    density = np.array([1.0, 1, 0, 0, 2, 2])
    shape = pulse_ticks(run.config, pulse=Pulse(time_s=time_s, density=density))
    middle = 3050e-12 / run.config.tick_s
    assert shape.lead(np.ones(1))[0] == pytest.approx(-middle, abs=0.1)


@pytest.mark.parametrize("width", [1, 2, 4])
def test_table_of_a_gaussian_is_the_gaussian(run, width):
    usual: PulseTicks = pulse_ticks(run.config).widened(width)
    table = pulse_ticks(run.config, pulse=Pulse.gaussian(SYSTEM_FWHM_S)).widened(width)
    time = np.linspace(-2 * usual.reach, 2 * usual.reach, 999)
    assert table.sigma == pytest.approx(usual.sigma, rel=1e-3)
    assert abs(table.reach - usual.reach) <= 1
    np.testing.assert_allclose(table.share_before(time), usual.share_before(time), atol=5e-4)


def test_reach_holds_a_pulse_and_its_mirror_image(run):
    """Also if the long side comes first; outside there is next to no light on either side."""
    late = pulse_ticks(run.config, pulse=tailed_pulse())
    early = late._replace(
        times=tuple(-time for time in late.times[::-1]),
        shares=tuple(1 - share for share in late.shares[::-1]),
    )
    assert early.reach == late.reach
    for pulse in (late, early):
        assert pulse.share_before(np.array(-float(pulse.reach))) < 1e-4
        assert pulse.share_before(np.array(float(pulse.reach))) > 1 - 1e-4
