# SPDX-License-Identifier: Apache-2.0
"""Photons to edges: a Monte Carlo simulation of the SPAD array in continuous time, then TDC ticks.

Ref: paper II and IV (SPAD, laser pulse). The effects that the paper leaves out, and their order,
are our choice.

The effects apply in this order, per pixel and laser pulse:

1. photons that would fire the SPAD: background and dark counts (uniform), signal (a Gaussian
   pulse around the time of flight, or around a time drawn from bins, modulo the laser period),
   another LiDAR's pulses, carriers trapped by earlier avalanches (afterpulses), photons from
   avalanches of neighbours (crosstalk);
2. SPAD gate: outside it, nothing happens;
3. dead time, which carries on from pulse to pulse: it decides which photons become avalanches;
4. jitter of the avalanche's edge, modulo the laser period;
5. the TDC's taps: from time to tick.

Every random number is a hash of (seed, pixel, pulse, purpose, counter), so neither chunks nor
workers change the edges. Crosstalk couples the pixels. A first pass finds the avalanches without
it and draws the photons that they send to their four neighbours. A second pass repeats the walk
through all pixels with the same photons and with these. An avalanche caused by crosstalk sends
no crosstalk of its own (its probability is squared, and neglected).
"""

import math
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from types import NoneType
from typing import Any

import numpy as np

from ..contract.edges import Edges
from ..contract.settings import GATE_MAX
from ..shared.arguments import check_kind, check_workers
from ..shared.constants import SIGMA_PER_FWHM, SPEED_OF_LIGHT_M_S
from ..shared.errors import SEED_MAX, InputError, check_integer
from ..shared.quantities import real_array
from ..shared.threads import Threads
from .light import RATE_MAX_CPS, SIGNAL_MAX, Interferer, Light
from .own_spad import own_chunk
from .spad import OwnSpad, Spad, SpadGate
from .timing import Timing
from .walk import (
    CARRIERS_MAX,
    LAW_SIZE,
    Arrays,
    Course,
    Made,
    Packing,
    Physics,
    Received,
    Scratch,
    State,
    unpacked,
    walk,
)

CHUNK_EDGES = 1 << 16  # edges generated and sorted at a time: they fit a core's cache
PULSES_MAX = 1 << 40
REACH_SIGMAS = 5.0  # from the centre of another LiDAR's pulse to its first and last light
APART_PULSES_MAX = 1 << 24  # pulses whose starts are kept


def generate_edges(light: Light, spad: Spad, timing: Timing, **options: Any) -> Edges:
    """Generate all edges of a number of laser pulses, sorted by (pulse, tick, pixel). Raises
    `InputError`.

    options: `pulses` and `seed`, both required; `pulse_start`, `gate`, `workers`: as in
    `edge_chunks`, which makes the same edges in chunks.
    """
    return Edges.joined(list(edge_chunks(light, spad, timing, **options)))


def edge_chunks(
    light: Light,
    spad: Spad,
    timing: Timing,
    *,
    pulses: int,
    seed: int,
    pulse_start: int = 0,
    gate: SpadGate | None = None,
    workers: int = 1,
    chunk_pulses: int | None = None,
) -> Iterator[Edges]:
    """Generate the edges of laser pulses in chunks of whole pulses, each sorted by (pulse, tick,
    pixel).

    All SPADs are ready at `pulse_start`; dead time and trapped carriers continue from chunk to
    chunk. The memory needed depends only on the chunk. Raises `InputError` if a value is out of
    range.

    pulses: number of laser pulses; pulse_start: number of the first one. seed: of the photons.
    gate: times at which the SPADs are on; None = always. workers: threads that share the pixels.
    chunk_pulses: pulses per chunk; None: about `CHUNK_EDGES` edges. Neither workers nor chunks
    change the edges. A SPAD model of a user's own (`OwnSpad`) makes one chunk of all pulses.
    """
    check_kind("light", light, Light)
    check_kind("spad", spad, Spad, OwnSpad)
    check_kind("timing", timing, Timing)
    check_kind("gate", gate, SpadGate, NoneType)
    pulses = check_integer("pulses", pulses, 1, PULSES_MAX)
    pulse_start = check_integer("pulse_start", pulse_start, 0, PULSES_MAX)
    seed = check_integer("seed", seed, 0, SEED_MAX)
    workers = check_workers(workers)
    physics, arrays = _in_ticks(light, spad, timing, gate, pulse_start + pulses)
    if isinstance(spad, OwnSpad):
        generate = partial(
            generate_edges,
            pulses=pulses,
            pulse_start=pulse_start,
            seed=seed,
            gate=gate,
            workers=workers,
        )
        return own_chunk(
            light, spad, timing, range(pulse_start, pulse_start + pulses), seed, generate
        )
    photons_per_pulse = _photons_per_pulse(physics, arrays)
    edges_per_pulse = _edges_per_pulse(photons_per_pulse, physics)
    packing = Packing((light.pixels - 1).bit_length(), (timing.period_ticks - 1).bit_length())
    if chunk_pulses is None:
        chunk_pulses = min(max(1, int(CHUNK_EDGES / (edges_per_pulse.sum() + 1e-9))), CHUNK_EDGES)
    chunk_pulses = check_integer(
        "chunk_pulses", chunk_pulses, 1, 1 << min(31, 63 - sum(packing)), "of this array and period"
    )
    borders = [light.pixels * i // workers for i in range(workers + 1)]
    walkers = [
        _Walker(
            physics,
            arrays,
            np.uint64(seed),
            block,
            packing,
            photons_per_pulse.max(),
            edges_per_pulse,
        )
        for block in pairwise(borders)
    ]
    return _chunks(walkers, range(pulse_start, pulse_start + pulses), chunk_pulses)


def edges_at_most(light: Light, spad: Spad, timing: Timing, gate: SpadGate | None = None) -> float:
    """Return an upper estimate of the edges of all pixels in a laser pulse. Arguments and errors
    are those of `edge_chunks`.
    """
    physics, arrays = _in_ticks(light, spad, timing, gate, 1)
    return float(_edges_per_pulse(_photons_per_pulse(physics, arrays), physics).sum())


def _chunks(walkers: list["_Walker"], pulses: range, chunk_pulses: int) -> Iterator[Edges]:
    """For each chunk, run both passes over all blocks of pixels, then sort by time."""
    physics = walkers[0].physics
    packing = walkers[0].packing
    with Threads(len(walkers)) as threads:
        for first in pulses[::chunk_pulses]:
            span = (first, min(chunk_pulses, pulses.stop - first))
            received = Received(np.empty(0, np.int64), np.empty(0))
            if physics.crosstalk > 0:
                sent = threads.map(
                    partial(_Walker.walk, span=span, received=received, sending=True), walkers
                )
                where = np.concatenate([part.where for part in sent])
                time = np.concatenate([part.time for part in sent])
                order = np.lexsort((time, where))
                received = Received(where[order], time[order])
            made = threads.map(
                partial(_Walker.walk, span=span, received=received, sending=False), walkers
            )
            keys = np.concatenate([part.where for part in made])
            keys.sort()
            yield Edges(*unpacked(keys, first, packing))


def _in_ticks(
    light: Light, spad: Spad, timing: Timing, gate: SpadGate | None, pulse_stop: int
) -> tuple[Physics, Arrays]:
    """Convert seconds, metres and rates to ticks and photons per period."""
    _check_pulse(light, spad, timing)
    tick_s, period_ticks, pixels = timing.tick_s, timing.period_ticks, light.pixels
    dark_cps = real_array("dark_cps", spad.dark_cps, (pixels,), 0, RATE_MAX_CPS)
    rate_cps = light.background_cps + dark_cps
    pulse = light.pulse
    jitter_fwhm_s = spad.jitter_fwhm_s if pulse is None else 0.0
    pulse_variance_s2 = light.system_fwhm_s**2 - jitter_fwhm_s**2
    if np.any(pulse_variance_s2 < 0):
        narrowest = light.system_fwhm_s.min()
        raise InputError(
            f"system_fwhm_s = {narrowest:g}: must be at least the SPAD's {spad.jitter_fwhm_s:g}"
        )
    flight_ticks = np.nan_to_num(2 * light.distance_m / SPEED_OF_LIGHT_M_S / tick_s)
    seen = ~np.isnan(light.distance_m) & (light.range_ambiguity | (flight_ticks < period_ticks))
    gate = gate or SpadGate(start_cycles=0, len_cycles=timing.period_cycles)
    gate_start, gate_len, gate_step = (
        real_array(name, getattr(gate, name), (pixels,), 0, longest) * timing.phases
        for name, longest in (
            ("start_cycles", timing.period_cycles),
            ("len_cycles", timing.period_cycles),
            ("step_cycles", GATE_MAX),  # a gate beyond the period is closed
        )
    )
    other = light.interferer or Interferer(photons_per_pulse=0.0)
    other_sigma = other.fwhm_s * SIGMA_PER_FWHM / tick_s
    if timing.waits:
        pulse_stop = check_integer(
            "pulses", pulse_stop, 0, APART_PULSES_MAX, "with a gap, dither or pauses"
        )
    physics = Physics(
        period_ticks=float(period_ticks),
        spacing_ticks=float(timing.spacing_ticks),
        phases=timing.phases,
        dead=spad.dead_time_s / tick_s,
        paralyzable=spad.paralyzable,
        jitter=jitter_fwhm_s * SIGMA_PER_FWHM / tick_s,
        tail_fraction=spad.jitter_tail_fraction,
        tail=spad.jitter_tail_s / tick_s,
        afterpulse=spad.afterpulse_probability,
        afterpulse_time=spad.afterpulse_s / tick_s,
        crosstalk=spad.crosstalk_probability,
        rows=light.rows,
        cols=light.cols,
        gate_every=gate.every_pulses,
        gate_steps=gate.steps,
        frame_pulses=gate.frame_pulses,
        other_period_ticks=other.period_s / tick_s if light.interferer else 0.0,
        other_sigma=other_sigma,
        # A pulse of several periods, which is no pulse, would take forever.
        other_reach=min(REACH_SIGMAS * other_sigma, float(period_ticks)),
        bin_width=light.arrivals.width_s / tick_s if light.arrivals else 0.0,
    )
    bin_first, bin_start, bin_photons = _bins(light, tick_s, period_ticks)
    arrays = Arrays(
        noise=rate_cps * timing.period_s,
        signal=np.where(seen, light.signal_per_pulse, 0.0),
        centre=flight_ticks % timing.spacing_ticks,
        sigma=np.sqrt(pulse_variance_s2) * SIGMA_PER_FWHM / tick_s,
        gate_start=gate_start,
        gate_len=gate_len,
        gate_step=gate_step,
        taps=np.empty(0)
        if timing.tap_width_lsb is None
        else np.cumsum(timing.tap_width_lsb, dtype=np.float64)[:-1],
        laps=(flight_ticks // timing.spacing_ticks).astype(np.int64),
        bin_first=bin_first,
        bin_start=bin_start,
        bin_photons=bin_photons,
        other=real_array("photons_per_pulse", other.photons_per_pulse, (pixels,), 0, SIGNAL_MAX),
        other_first=(other.phase_s + real_array("delay_s", other.delay_s, (pixels,), 0)) / tick_s,
        starts=timing.start_cycles(pulse_stop) * float(timing.phases)
        if timing.waits
        else np.empty(0),
        shape=np.empty(0) if pulse is None else pulse.time_s / tick_s,
        shape_share=np.empty(0) if pulse is None else pulse.share_before,
    )
    return physics, arrays


def _check_pulse(light: Light, spad: Spad, timing: Timing) -> None:
    """Raise `InputError` if there is a measured pulse, and the detector or the period does not go
    with it.
    """
    pulse = light.pulse
    if pulse is None:
        return
    if isinstance(spad, OwnSpad):
        raise InputError(
            f"pulse: the SPAD {spad.name} adds its own jitter, which a measured pulse has in it",
            field="pulse",
        )
    if spad.jitter_tail_fraction > 0:
        raise InputError(
            "spad.jitter_tail_fraction: must be 0 with a measured pulse, which has the jitter in it",
            field="spad.jitter_tail_fraction",
        )
    if pulse.time_s[-1] - pulse.time_s[0] >= timing.period_s:
        raise InputError(
            f"pulse: must be shorter than the laser period of {timing.period_s * 1e9:g} ns",
            field="pulse",
        )


def _photons_per_pulse(physics: Physics, arrays: Arrays) -> np.ndarray:
    """Upper estimate of the photons of each pixel in a period, which sets the size of buffers
    only.
    """
    filled = np.diff(arrays.bin_first) > 0
    binned = np.zeros(len(filled))
    binned[filled] = arrays.bin_photons[arrays.bin_first[1:][filled] - 1]
    others = (
        physics.period_ticks / physics.other_period_ticks + 1 if physics.other_period_ticks else 0.0
    )
    photons: np.ndarray = (
        arrays.noise + (arrays.signal.sum(axis=1) + binned) + arrays.other * others
    )
    return photons


def _edges_per_pulse(photons_per_pulse: np.ndarray, physics: Physics) -> np.ndarray:
    """float64[pixels]: upper estimate of the edges in a period."""
    edges = photons_per_pulse * (1 + 2 * physics.afterpulse + 4 * physics.crosstalk)
    if physics.dead:
        edges = np.minimum(edges, physics.period_ticks / physics.dead + 1)
    return edges


def _bins(
    light: Light, tick_s: float, period_ticks: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(bin_first, bin_start, bin_photons) of `Arrays`."""
    if light.arrivals is None:
        return np.zeros(light.pixels + 1, np.int64), np.empty(0), np.empty(0)
    first, start, photons = (
        light.arrivals.first,
        light.arrivals.start_s / tick_s,
        light.arrivals.photons,
    )
    if not light.range_ambiguity:
        photons = np.where(start < period_ticks, photons, 0.0)
    summed = np.concatenate([np.cumsum(photons[begin:end]) for begin, end in pairwise(first)])
    return first, start, summed


class _Walker:
    """A block of pixels and their state from chunk to chunk, for the sending pass of crosstalk
    and for the last pass.

    block: first pixel, and the one after the last. brightest: photons per pulse of the brightest
    pixel; edges_per_pulse: of each pixel. Both are upper estimates, for the sizes of buffers.
    """

    def __init__(
        self,
        physics: Physics,
        arrays: Arrays,
        seed: np.uint64,
        block: tuple[int, int],
        packing: Packing,
        brightest: float,
        edges_per_pulse: np.ndarray,
    ):
        self.physics = physics
        self.arrays = arrays
        self.seed = seed
        self.first, self.end = block
        self.packing = packing
        self.edges_per_pulse = edges_per_pulse[self.first : self.end].sum()
        # doubled if it is ever exceeded
        self.photons_max = int(brightest + 12 * math.sqrt(brightest)) + 64
        pixels = self.end - self.first
        carriers = np.full((pixels, CARRIERS_MAX if physics.afterpulse else 0), np.inf)
        fresh = State(np.zeros(pixels), carriers)
        self.state = {True: fresh, False: fresh}  # by pass: is it the sending one?

    def walk(self, span: tuple[int, int], received: Received, sending: bool) -> Received:
        """Return packed edges or, with `sending`, the crosstalk's targets and times: int64[n]
        and float64[n].

        span: first pulse, and number of pulses.
        """
        course = Course(self.physics, self.arrays, self.seed, self.first, self.end, *span, received)
        capacity = int(self.edges_per_pulse * course.pulses * 1.1) + 1000
        while True:
            before = self.state[sending]
            state = State(before.alive_at.copy(), before.carriers.copy())
            made = Made(self.packing, sending, np.empty(capacity, np.int64), np.empty(capacity))
            scratch = Scratch(np.empty(LAW_SIZE), np.empty(self.photons_max))
            n: int = walk(course, state, scratch, made)
            if n < 0:
                self.photons_max *= 2
            elif n > capacity:
                capacity = n
            else:
                self.state[sending] = state
                return Received(made.keys[:n], made.times[:n])
