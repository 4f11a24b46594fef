# SPDX-License-Identifier: Apache-2.0
"""Edges by a SPAD model of a user's own: photons as for any SPAD, then `OwnSpad.edges_of`, then
the TDC.

The photons are the edges of a SPAD without dead time and jitter at a TDC whose ticks are
`FINENESS` times shorter, so they are the same ones that the built-in SPAD gets, rounded to that
tick. The model gets all photons of a run at once.
"""

from collections.abc import Callable, Iterator

import numpy as np
from attrs import evolve

from ..contract.edges import Edges
from ..shared.errors import InputError
from ..shared.own_part import check_part
from .light import Light
from .spad import OwnSpad, Spad, SpadTimes
from .timing import Timing

FINENESS = 16  # shorter ticks, of 4 ps with the preset `silicon`
PHASES_MAX = 1024  # of `Timing`
Generate = Callable[[Light, Spad, Timing], Edges]


def own_chunk(
    light: Light, spad: OwnSpad, timing: Timing, pulses: range, seed: int, generate: Generate
) -> Iterator[Edges]:
    """Generate the edges of some pulses in one chunk, sorted by (pulse, tick, pixel). Raises
    `InputError`.

    generate: makes the edges of those pulses for a SPAD of the built-in model.
    """
    check_part("spad", spad)
    photons = _photons(light, spad, timing, pulses, generate)
    found = spad.edges_of(photons, pixels=(light.rows, light.cols), seed=seed)
    pixel = np.asarray(found.pixel)
    time_s = np.asarray(found.time_s, np.float64)
    if not np.issubdtype(pixel.dtype, np.integer) or pixel.shape != time_s.shape or pixel.ndim != 1:
        raise InputError(
            f"{spad.name}.edges_of: must return int64[n] and float64[n] of the same length"
        )
    if len(pixel) and not 0 <= pixel.min() <= pixel.max() < light.pixels:
        raise InputError(f"{spad.name}.edges_of: pixel must be from 0 to {light.pixels - 1}")
    yield _edges(pixel.astype(np.int64), time_s, timing, pulses)


def _photons(
    light: Light, spad: OwnSpad, timing: Timing, pulses: range, generate: Generate
) -> SpadTimes:
    """Return the times at which a SPAD that is always ready detects photons."""
    fineness = min(FINENESS, PHASES_MAX // timing.phases)
    fine = evolve(timing, phases=timing.phases * fineness, tap_width_lsb=None)
    laser = evolve(light, system_fwhm_s=np.sqrt(light.system_fwhm_s**2 - spad.jitter_fwhm_s**2))
    ready = Spad(dead_time_s=0.0, jitter_fwhm_s=0.0, dark_cps=spad.dark_cps)
    made = generate(laser, ready, fine)
    starts = timing.start_cycles(pulses.stop)
    ticks = (starts[made.pulse] - starts[pulses.start]) * fine.phases + made.tick
    order = np.lexsort((ticks, made.pixel))
    return SpadTimes(made.pixel[order], (ticks[order] + 0.5) * fine.tick_s)


def _edges(pixel: np.ndarray, time_s: np.ndarray, timing: Timing, pulses: range) -> Edges:
    """Return edges from their times; those outside of all periods are left out."""
    starts = timing.start_cycles(pulses.stop)[pulses.start :]
    starts = starts - starts[0]
    cycles = time_s * timing.clock_hz
    number = np.searchsorted(starts, cycles, side="right") - 1
    inside = (number >= 0) & (number < len(pulses)) & np.isfinite(cycles)
    inside[inside] = cycles[inside] < starts[number[inside]] + timing.period_cycles
    pixel = pixel[inside]
    number = number[inside]
    tick = _ticks((cycles[inside] - starts[number]) * timing.phases, timing)
    order = np.lexsort((pixel, tick, number))
    return Edges(number[order] + pulses.start, pixel[order], tick[order])


def _ticks(time: np.ndarray, timing: Timing) -> np.ndarray:
    """int64[n]: the TDC's codes of times in ticks."""
    if timing.tap_width_lsb is not None:
        taps = np.cumsum(timing.tap_width_lsb, dtype=np.float64)[:-1]
        cycle = np.floor(time / timing.phases) * timing.phases
        time = cycle + np.searchsorted(taps, time - cycle, side="right")
    return np.minimum(time.astype(np.int64), timing.period_ticks - 1)
