# SPDX-License-Identifier: Apache-2.0
"""Depth from counts of rules beside the one that is built, by the estimator of the product."""

import numpy as np

from coincid.model.contract.config import Config
from coincid.model.contract.pixels import pixel_table
from coincid.model.depth.count_likelihood import NO_TICK
from coincid.model.depth.counts import CountSurfaces, GateCounts, find_surfaces, trials_of
from coincid.model.depth.pulse_ticks import pulse_ticks
from coincid.model.shared.constants import SUCCESS_TOLERANCE_S
from coincid.model.shared.threads import Threads

from .count_kernels import NO_GATE, Counts


def surfaces_of(
    counts: Counts, config: Config, background: np.ndarray | None = None
) -> CountSurfaces:
    """Return the surfaces that counts show.

    background: float64[subgroups, pixels], photons per tick; None: it comes from the counts.
    """
    sensor = config.sensor
    quarter = counts.start[:, pixel_table(sensor).minigroup]
    first = np.where(quarter == NO_GATE, NO_TICK, quarter * sensor.quarter_ticks)
    counted = range(config.pulses - counts.second_pulses, config.pulses)
    trials = trials_of(first, counts.hits, counts.pulses, config, counted)
    with Threads(1) as alone:
        return find_surfaces(
            GateCounts(trials, counts.pulses, counts.second_pulses),
            config,
            pulse_ticks(config),
            tolerance_ticks=SUCCESS_TOLERANCE_S / config.tick_s,
            threads=alone,
            background=background,
        )
