# SPDX-License-Identifier: Apache-2.0
"""What follows from the pace of a frame: frames per second, the mean rate of a link, the energy of a
laser pulse. All of it is arithmetic.

Ref: paper, for the laser's mean power of 10 mW.
"""

from bisect import bisect_right

from ..model.contract.config import Config
from ..model.contract.dither import GAP_MAX
from ..model.shared.errors import InputError, told_number
from ..model.shared.quantities import check_real

LASER_MEAN_W = 10e-3
RATE_MIN_PER_S = 1e-9  # below any frame rate


def frame_s(config: Config) -> float:
    """Return the seconds from the first cycle of a frame's first period to the last cycle of its
    last one, with all waits.
    """
    return config.frame_cycles / (config.clock_mhz * 1e6)


def frames_per_s(config: Config) -> float:
    """Return the frames per second if one begins as soon as the periods of the last one end."""
    return config.clock_mhz * 1e6 / config.frame_cycles


def pulse_energy_j(config: Config, mean_power_w: float = LASER_MEAN_W) -> float:
    """Return the energy of a laser pulse in joules at a mean power, over frames without pauses."""
    return mean_power_w * frame_s(config) / config.pulses


def gap_for(config: Config, rate_per_s: float) -> int:
    """Return the longest gap, in cycles, with which a configuration has so many frames per second.

    Raises `InputError` if not even a gap of 0 is short enough, or the gap would be longer than the
    longest one. A frame of one pulse has no gap, so it has a single rate.
    """
    rate_per_s = check_real("rate_per_s", rate_per_s, RATE_MIN_PER_S)

    def with_gap(gap: int) -> Config:
        return config.with_frame(gap=gap)

    # The waits of a frame are not proportional to the gap: those between searches are long already.
    # Rates are compared as they are told, so that of a frame leads back to its gap.
    gaps = range(GAP_MAX + 1)
    gap = bisect_right(gaps, -rate_per_s, key=lambda gap: -frames_per_s(with_gap(gap))) - 1
    longer = max(1, config.pulses - 1)  # cycles that a gap of one more would take
    too_long = with_gap(GAP_MAX).frame_cycles + longer
    if gap < 0 or rate_per_s <= config.clock_mhz * 1e6 / too_long:
        low = told_number(frames_per_s(with_gap(GAP_MAX)))
        high = told_number(frames_per_s(with_gap(0)))
        raise InputError(
            f"rate_per_s = {told_number(rate_per_s)}: must be from {low} to {high} with these periods",
            field="rate_per_s",
        )
    return gap if config.pulses > 1 else 0


def told_pace(config: Config) -> str:
    """Return frames per second and energy of a pulse as a phrase."""
    energy_j = pulse_energy_j(config)
    return (
        f"{frames_per_s(config):.4g} frames per second, in which a laser of"
        f" {LASER_MEAN_W * 1e3:g} mW has {energy_j * 1e9:.4g} nJ per pulse"
    )
