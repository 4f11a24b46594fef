# SPDX-License-Identifier: Apache-2.0
"""Widened pulses and their ends, of a Gaussian and of its table."""

import numpy as np
import pytest
from scipy import special

from coincid.model.depth.pulse_ticks import PulseTicks, pulse_ticks
from coincid.model.shared.pulse import Pulse

from ..random_cases import configured

CONFIG = configured({"rows": 8, "cols": 8})
FWHM_S = 500e-12
TIMES = np.linspace(-30, 30, 121)


@pytest.mark.parametrize("width", [1, 2, 4])
@pytest.mark.parametrize("table", [False, True])
def test_a_widened_pulse_has_so_many_times_the_sigma(table, width):
    alone = pulse_ticks(CONFIG, FWHM_S)
    pulse = pulse_ticks(CONFIG, pulse=Pulse.gaussian(FWHM_S)) if table else alone
    sigma = width * alone.sigma
    wide = pulse.widened(width)
    assert wide.sigma == pytest.approx(sigma, rel=1e-3)
    np.testing.assert_allclose(wide.share_before(TIMES), special.ndtr(TIMES / sigma), atol=2e-3)
    assert wide.reach >= 4 * sigma - 1


def test_the_reach_of_a_table_is_that_of_its_longer_side():
    """Without the last photons, as many as a Gaussian has behind four sigmas."""
    late = PulseTicks(2.0, (-3.0, 0.0, 20.0), (0.0, 0.5, 1.0))
    early = PulseTicks(2.0, (-20.0, 0.0, 3.0), (0.0, 0.5, 1.0))
    assert late.reach == early.reach == 20
