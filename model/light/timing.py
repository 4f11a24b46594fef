# SPDX-License-Identifier: Apache-2.0
"""Clock and TDC of the photon model: tick, laser period, waits between two periods."""

import numpy as np
from attrs import frozen

from ..contract.config import Config
from ..contract.counts import with_pauses
from ..contract.dither import DITHER_BITS_MAX, GAP_MAX, LFSR_BITS, start_cycles
from ..contract.parameters import CLOCK_MHZ
from ..shared.constants import SPEED_OF_LIGHT_M_S
from ..shared.errors import InputError
from ..shared.quantities import integer, real, real_array


@frozen(kw_only=True, eq=False)
class Timing:
    """Clock and TDC.

    clock_hz: system clock. phases: ticks per clock cycle. period_cycles: laser period.
    tap_width_lsb: float64[phases], widths of the TDC's phases, which sum to `phases`; None = all
    1. gap_cycles, dither_bits, dither_seed: settings of the wait between two periods
       (docs/contract.md). frame_pulses: number of pulses after which the sequence of waits starts
    again; 0: all pulses are one frame. search_pulses, search_minigroups: pulses
    of each search of a frame of counts, 0: no counts; and the minigroups of a subgroup, by which the
    pause after a search is long.
    """

    clock_hz: float = real(CLOCK_MHZ * 1e6, 1)
    phases: int = integer(32, 1, 1024)
    period_cycles: int = integer(250, 1, 1 << 20)
    tap_width_lsb: np.ndarray | None = None
    gap_cycles: int = integer(0, 0, GAP_MAX)
    dither_bits: int = integer(0, 0, DITHER_BITS_MAX)
    dither_seed: int = integer(1, 1, (1 << LFSR_BITS) - 1)
    frame_pulses: int = integer(0, 0, 1 << 16)
    search_pulses: int = integer(0, 0, 1 << 16)
    search_minigroups: int = integer(0, 0, 1 << 16)

    def __attrs_post_init__(self) -> None:
        if self.tap_width_lsb is not None:
            total = real_array("tap_width_lsb", self.tap_width_lsb, (self.phases,), 0).sum()
            if abs(total - self.phases) > 1e-9 * self.phases:
                raise InputError(
                    f"tap_width_lsb: sums to {total:g}, must sum to the {self.phases} phases"
                )

    @classmethod
    def from_config(cls, config: Config, tap_width_lsb: np.ndarray | None = None) -> "Timing":
        """Return clock, phases, period and waits of a configuration."""
        return cls(
            clock_hz=config.clock_mhz * 1e6,
            phases=config.sensor.phases,
            period_cycles=config.period,
            tap_width_lsb=tap_width_lsb,
            gap_cycles=config.gap,
            dither_bits=config.frame.dither_bits,
            dither_seed=config.frame.dither_seed,
            frame_pulses=config.pulses,
            search_pulses=config.search_pulses if config.counting else 0,
            search_minigroups=config.sensor.minigroups if config.counting else 0,
        )

    @property
    def tick_s(self) -> float:
        return 1 / (self.clock_hz * self.phases)

    @property
    def tick_m(self) -> float:
        """Distance that light has travelled, there and back, within a tick, in metres."""
        return self.tick_s * SPEED_OF_LIGHT_M_S / 2

    @property
    def period_ticks(self) -> int:
        return self.period_cycles * self.phases

    @property
    def spacing_ticks(self) -> int:
        """From the beginning of a period to that of the next one, without pauses and dither's wait."""
        return (self.period_cycles + self.gap_cycles) * self.phases

    @property
    def waits(self) -> bool:
        """Whether there may be cycles between two periods."""
        return self.gap_cycles > 0 or self.dither_bits > 0 or self.search_pulses > 0

    @property
    def period_s(self) -> float:
        return self.period_cycles / self.clock_hz

    @property
    def range_m(self) -> float:
        """Largest distance from which light returns within the laser period: the unambiguous
        range of a stamp.
        """
        return SPEED_OF_LIGHT_M_S * self.period_s / 2

    def start_cycles(self, pulses: int) -> np.ndarray:
        """int64[pulses + 1]: start of each pulse's period, in cycles from the first one. A frame
        begins where the frame before would have had one more period.
        """
        frame = start_cycles(
            self.frame_pulses or pulses,
            self.period_cycles,
            self.dither_bits,
            self.dither_seed,
            self.gap_cycles,
        )
        if self.search_pulses:
            frame = with_pauses(frame, self.search_pulses, self.search_minigroups, self.gap_cycles)
        number, pulse = np.divmod(np.arange(pulses + 1), max(1, len(frame) - 1))
        return number * frame[-1] + frame[pulse]


RANGE_M = Timing().range_m  # with the preset `silicon`
