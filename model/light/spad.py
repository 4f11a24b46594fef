# SPDX-License-Identifier: Apache-2.0
"""The detector: SPAD, SPAD gate, and dark counts that differ from pixel to pixel.

Ref: paper II. Effects that the paper leaves out are off by default.
"""

from typing import ClassVar, NamedTuple

import numpy as np
from attrs import frozen

from ..contract.config import Config
from ..contract.pixels import pixel_table
from ..shared.errors import SEED_MAX, check_integer
from ..shared.quantities import Numbers, check_real, integer, real, switch


@frozen(kw_only=True, eq=False)
class Spad:
    """The detector. The defaults come from section II of the paper; effects that the paper
    leaves out are off.

    pdp, fill_factor: photon detection probability and active share of the area, for the link
    budget only, because the rates of `Light` are detected ones. dead_time_s: from an avalanche
    until the SPAD is ready again. paralyzable: a photon within the dead time extends it.
    jitter_fwhm_s: Gaussian jitter of an edge. jitter_tail_fraction,
    jitter_tail_s: share of the edges that are late by an additional, exponential time, and the
    mean of that time.
    dark_cps: dark count rate, a number or float64[pixels] (see `dark_count_map`).
    afterpulse_probability, afterpulse_s: probability that an avalanche traps a carrier, and the
    mean time to its release; a carrier that is released while the SPAD is dead is lost.
    crosstalk_probability: that an avalanche sends a photon, without delay, to one given
    neighbour of four.
    """

    pdp: float = real(0.05, 0, 1)
    fill_factor: float = real(0.5, 0, 1)
    dead_time_s: float = real(8e-9, 0)
    paralyzable: bool = switch(False)
    jitter_fwhm_s: float = real(100e-12, 0, 1)
    jitter_tail_fraction: float = real(0.0, 0, 1)
    jitter_tail_s: float = real(0.0, 0)
    dark_cps: Numbers = 0.0
    afterpulse_probability: float = real(0.0, 0, 0.5)
    afterpulse_s: float = real(30e-9, 1e-12)
    crosstalk_probability: float = real(0.0, 0, 0.25)


class SpadTimes(NamedTuple):
    """Times at which SPADs detect photons, or at which their edges come; sorted by pixel, then
    time.
    """

    pixel: np.ndarray  # int64[n]
    time_s: np.ndarray  # float64[n], since the first laser pulse


@frozen(kw_only=True, eq=False)
class OwnSpad(Spad):
    """Base class of a SPAD model of a user's own, which replaces dead time, jitter, afterpulsing
    and crosstalk.

    Of the fields of `Spad`, the light reads `pdp`, `fill_factor`, `dark_cps` and `jitter_fwhm_s`
    (the part of the light's width that is not the laser's, so the model must add it); the others
    are only for `edges_of`. docs/extend.md has an example.

    Attributes
    ----------
    name, version : str
        See `OwnPart`.
    """

    name: ClassVar[str]
    version: ClassVar[str]

    def edges_of(self, photons: SpadTimes, *, pixels: tuple[int, int], seed: int) -> SpadTimes:
        """Return the edges that the photons of a run cause, in any order; those outside of the
        run are left out.

        photons: all that the SPADs would detect without dead time: signal, background, dark
        counts and other LiDARs, inside the SPAD gate if there is one. pixels: rows and columns;
        pixel row * columns + column. seed: of the run; random numbers must depend on nothing else.
        """
        raise NotImplementedError


@frozen(kw_only=True, eq=False)
class SpadGate:
    """Gate that switches SPADs off outside the cycles [start, start + len) of a period.

    While off, they have no avalanches and no dead time. start_cycles, len_cycles, step_cycles:
    per pixel, int64[pixels] or a number. Progressive gating: in pulse k of a frame of
    frame_pulses, the start is later by step_cycles * ((k // every_pulses) mod steps);
    every_pulses = 0: never.
    """

    start_cycles: int | np.ndarray
    len_cycles: int | np.ndarray
    step_cycles: int | np.ndarray = 0
    every_pulses: int = integer(0, 0, 1 << 62)
    steps: int = integer(1, 1, 1 << 62)
    frame_pulses: int = integer(1 << 62, 1, 1 << 62)

    @classmethod
    def from_config(cls, config: Config) -> "SpadGate":
        """Return the gates of a configuration as SPAD gates, which are always open if a
        subgroup's gating is off.
        """
        subgroup, frame = pixel_table(config.sensor).subgroup, config.frame
        start, length, step = (
            np.where(config.gating, on, off)[subgroup]
            for on, off in (
                (config.gate_start, 0),
                (config.gate_len, config.period),
                (frame.gate_step, 0),
            )
        )
        return cls(
            start_cycles=start,
            len_cycles=np.minimum(length, config.period),
            step_cycles=step,
            every_pulses=frame.gate_every,
            steps=frame.gate_steps,
            frame_pulses=config.pulses,
        )


def dark_count_map(
    pixels: int, *, median_cps: float, hot_fraction: float, hot_cps: float, seed: int
) -> np.ndarray:
    """Dark count rates, float64[pixels]: `median_cps`, and `hot_cps` in a random share
    `hot_fraction` of the pixels.
    """
    pixels = check_integer("pixels", pixels, 1, 1 << 24)
    hot = round(pixels * check_real("hot_fraction", hot_fraction, 0, 1))
    seed = check_integer("seed", seed, 0, SEED_MAX)
    dark_cps = np.full(pixels, check_real("median_cps", median_cps, 0))
    dark_cps[np.random.default_rng(seed).permutation(pixels)[:hot]] = check_real(
        "hot_cps", hot_cps, 0
    )
    return dark_cps
