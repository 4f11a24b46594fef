"""What the photon model is told: light per pixel, SPAD, clock and gate, with the presets.

Ref: paper II (SPAD, laser), IV (pulse of 500 to 520 ps FWHM). Effects the paper leaves out are off by default.
"""

import math

import numpy as np
from attrs import frozen

from .config import Config
from .dither import DITHER_BITS_MAX, LFSR_BITS, start_cycles
from .errors import InputError, check_integer
from .golden import pixel_table
from .quantities import check_real, real, real_array

SPEED_OF_LIGHT_M_S = 299_792_458.0
SIGMA_PER_FWHM = 1 / math.sqrt(8 * math.log(2))

BACKGROUND_CPS_PER_KLUX = 1.226e6 / 50  # detected, per pixel; our preset: the level at which thresholds are selective
SIGNAL_REFERENCE = 0.613                # detected photons per pulse and pixel, equation (1) at the two values below
REFERENCE_DISTANCE_M = 4.0
REFERENCE_REFLECTIVITY = 0.4
NEAREST_M = 0.05                        # of a scene: the signal grows without bound towards 0
SIGNAL_MAX = 1e4                        # photons of a pixel and pulse
RATE_MAX_CPS = 1e12

def background_cps(klux: float) -> float:
    """Detected background of a pixel in counts per second at `klux` of ambient light: our preset, linear."""
    return BACKGROUND_CPS_PER_KLUX * check_real("klux", klux, 0)


def signal_per_pulse(distance_m, reflectivity):
    """Detected signal photons per pulse and pixel (float64, shapes broadcast); 0 where the distance is NaN.

    Equation (1) of the paper: proportional to reflectivity / distance^2.
    """
    scaled = np.asarray(reflectivity) / REFERENCE_REFLECTIVITY * (REFERENCE_DISTANCE_M / np.asarray(distance_m)) ** 2
    return np.nan_to_num(SIGNAL_REFERENCE * scaled, nan=0.0)


@frozen(kw_only=True, eq=False)
class Spad:
    """The detector. Defaults: the paper's section II; effects that it leaves out are off.

    pdp, fill_factor: photon detection probability, active share; for the link budget (rates of `Light` are detected).
    dead_time_s, paralyzable: from one avalanche to the next; paralyzable = a photon within it extends it.
    jitter_fwhm_s: Gaussian jitter of an avalanche's edge; jitter_tail_fraction of the edges are late by another,
    exponential time of mean jitter_tail_s.
    dark_cps: dark count rate, a number or float64[pixels] (see `dark_count_map`).
    afterpulse_probability: that an avalanche traps a carrier, released after an exponential time of mean afterpulse_s;
    released while the SPAD is dead, it is lost, so exp(-dead_time_s / afterpulse_s) of them are seen.
    crosstalk_probability: that an avalanche sends, at once, a photon to one given neighbour (of four).
    """

    pdp: float = real(0.05, 0, 1)
    fill_factor: float = real(0.5, 0, 1)
    dead_time_s: float = real(8e-9, 0)
    paralyzable: bool = False
    jitter_fwhm_s: float = real(100e-12, 0)
    jitter_tail_fraction: float = real(0.0, 0, 1)
    jitter_tail_s: float = real(0.0, 0)
    dark_cps: float | np.ndarray = 0.0
    afterpulse_probability: float = real(0.0, 0, 0.5)
    afterpulse_s: float = real(30e-9, 1e-12)
    crosstalk_probability: float = real(0.0, 0, 0.25)


@frozen(kw_only=True, eq=False)
class Timing:
    """Clock and TDC. clock_hz, phases: tick_s = 1 / (clock_hz * phases). period_cycles: laser period.

    tap_width_lsb: widths of the TDC's phases, float64[phases] that sum to `phases`; None = all 1.
    dither_bits, dither_seed: how long the next trigger waits after a period (`dither.py`), anew with every frame of frame_pulses
    (0: all pulses are one frame).
    """

    clock_hz: float = real(500e6, 1)
    phases: int = 32
    period_cycles: int = 250
    tap_width_lsb: np.ndarray | None = None
    dither_bits: int = 0
    dither_seed: int = 1
    frame_pulses: int = 0

    def __attrs_post_init__(self):
        check_integer("phases", self.phases, 1, 1024)
        check_integer("period_cycles", self.period_cycles, 1, 1 << 20)
        check_integer("dither_bits", self.dither_bits, 0, DITHER_BITS_MAX)
        check_integer("dither_seed", self.dither_seed, 1, (1 << LFSR_BITS) - 1)
        check_integer("frame_pulses", self.frame_pulses, 0, 1 << 16)
        if self.tap_width_lsb is not None:
            total = real_array("tap_width_lsb", self.tap_width_lsb, (self.phases,), 0).sum()
            if abs(total - self.phases) > 1e-9 * self.phases:
                raise InputError(f"tap_width_lsb: sums to {total:g}, must sum to the {self.phases} phases")

    @classmethod
    def from_config(cls, config: Config, clock_hz: float = 500e6, tap_width_lsb: np.ndarray | None = None) -> "Timing":
        """The configuration's phases, period and dither, at a clock that it does not know."""
        return cls(
            clock_hz=clock_hz, phases=config.sensor.phases, period_cycles=config.period, tap_width_lsb=tap_width_lsb,
            dither_bits=config.frame["dither_bits"], dither_seed=config.frame["dither_seed"], frame_pulses=config.pulses,
        )

    @property
    def tick_s(self) -> float:
        return 1 / (self.clock_hz * self.phases)

    @property
    def period_ticks(self) -> int:
        return self.period_cycles * self.phases

    @property
    def period_s(self) -> float:
        return self.period_cycles / self.clock_hz

    def start_cycles(self, pulses: int) -> np.ndarray:
        """int64[pulses + 1]: when each pulse's period begins, in cycles from the first one's on. Frames follow without a gap."""
        frame = start_cycles(self.frame_pulses or pulses, self.period_cycles, self.dither_bits, self.dither_seed)
        number, pulse = np.divmod(np.arange(pulses + 1), max(1, len(frame) - 1))
        return number * frame[-1] + frame[pulse]


@frozen(kw_only=True, eq=False)
class Interferer:
    """Another LiDAR whose pulses reach the sensor.

    photons_per_pulse: detected of each of its pulses, a number or float64[pixels]. period_s: its own laser period. phase_s: from
    our first trigger to the arrival of its first pulse; pulses before that came, too. delay_s: added for each pixel, a number or
    float64[pixels]. fwhm_s: of its pulse.
    """

    photons_per_pulse: float | np.ndarray
    period_s: float = real(500e-9, 1e-9)
    phase_s: float = real(0.0, 0)
    delay_s: float | np.ndarray = 0.0
    fwhm_s: float = real(490e-12, 0)


@frozen(kw_only=True, eq=False)
class Arrivals:
    """Signal of any shape in time, in bins; the laser pulse's own shape comes on top. Pixel p has the bins first[p] to first[p + 1].

    first: int64[pixels + 1]. start_s: float64[n], when each bin begins, ascending in a pixel, since the laser trigger (beyond the
    laser period: light of an earlier pulse). photons: float64[n], mean detected per pulse. width_s: of a bin, filled evenly.
    """

    first: np.ndarray
    start_s: np.ndarray
    photons: np.ndarray
    width_s: float = real(0.0, 0, 1)

    def __attrs_post_init__(self):
        n = len(self.photons)
        first = np.asarray(self.first, np.int64)
        if first.ndim != 1 or len(first) < 2 or first[0] != 0 or first[-1] != n or np.any(np.diff(first) < 0):
            raise InputError(f"first: must ascend from 0 to the {n} bins")
        object.__setattr__(self, "first", first)
        object.__setattr__(self, "start_s", real_array("start_s", self.start_s, (n,), 0))
        object.__setattr__(self, "photons", real_array("photons", self.photons, (n,), 0, SIGNAL_MAX))
        inner = np.delete(np.diff(self.start_s), first[1:-1][(first[1:-1] > 0) & (first[1:-1] < n)] - 1)
        if np.any(inner < 0):
            raise InputError("start_s: must ascend in every pixel")


@frozen(kw_only=True, eq=False)
class Light:
    """What each of rows x cols pixels detects (PDE applied, before dead time); arrays broadcast to the stated shapes.

    distance_m: float64[pixels, targets], NaN = no target. signal_per_pulse: float64[pixels, targets], mean photons.
    background_cps: float64[pixels]. A one-dimensional distance or signal is [pixels] with one target each.
    system_fwhm_s: float64[pixels, targets], FWHM of the signal at the TDC's input: laser pulse and SPAD jitter
    together, squares added, so the laser pulse is sqrt(system_fwhm_s^2 - jitter_fwhm_s^2).
    range_ambiguity: light from beyond the laser period falls into a later period (the laser is taken to run before the
    first pulse); False = it is lost. arrivals: more signal, of any shape in time, whose laser pulse has the width of the
    pixel's first target. interferer: another LiDAR, or None.
    """

    rows: int
    cols: int
    distance_m: np.ndarray
    signal_per_pulse: np.ndarray
    background_cps: np.ndarray = 0.0
    system_fwhm_s: float | np.ndarray = 500e-12
    range_ambiguity: bool = True
    arrivals: Arrivals | None = None
    interferer: Interferer | None = None

    def __attrs_post_init__(self):
        check_integer("rows", self.rows, 1, 4096)
        check_integer("cols", self.cols, 1, 4096)
        for name in ("distance_m", "signal_per_pulse", "system_fwhm_s"):
            array = np.asarray(getattr(self, name))
            object.__setattr__(self, name, array[:, None] if array.ndim == 1 else array)
        targets = max(self.distance_m.shape[-1:] + self.signal_per_pulse.shape[-1:], default=1)
        per_target = (self.pixels, targets)
        for name, shape, highest in (("distance_m", per_target, math.inf), ("signal_per_pulse", per_target, SIGNAL_MAX),
                                     ("system_fwhm_s", per_target, 1.0), ("background_cps", (self.pixels,), RATE_MAX_CPS)):
            checked = real_array(name, getattr(self, name), shape, 0, highest, nan=name == "distance_m")
            object.__setattr__(self, name, checked)
        if self.arrivals is not None and len(self.arrivals.first) != self.pixels + 1:
            raise InputError(f"arrivals: are of {len(self.arrivals.first) - 1} pixels, must be of {self.pixels}")

    @property
    def pixels(self) -> int:
        return self.rows * self.cols

    @classmethod
    def from_scene(cls, distance_m, reflectivity, klux: float, **others) -> "Light":
        """Light of the presets, background uniform.

        distance_m: float64[rows, cols] or [rows, cols, targets], NaN = no target; reflectivity: broadcast to it.
        """
        distance_m = np.asarray(distance_m, dtype=np.float64)
        if distance_m.ndim not in (2, 3):
            raise InputError(f"distance_m: has {distance_m.ndim} dimensions, must have 2 or 3: rows, cols, targets")
        rows, cols = distance_m.shape[:2]
        distance_m = real_array("distance_m", distance_m, distance_m.shape, NEAREST_M, nan=True)
        signal = signal_per_pulse(distance_m, real_array("reflectivity", reflectivity, distance_m.shape, 0, 1))
        flat = (rows * cols, -1)
        return cls(rows=rows, cols=cols, distance_m=distance_m.reshape(flat), signal_per_pulse=signal.reshape(flat),
                   background_cps=background_cps(klux), **others)


@frozen(kw_only=True, eq=False)
class SpadGate:
    """SPADs switched off outside [start, start + len) cycles of a period: there no avalanche and no dead time.

    start_cycles, len_cycles, step_cycles: per pixel, int64[pixels] or a number. Progressive gating: pulse k of a frame of
    frame_pulses adds step_cycles * ((k // every_pulses) mod steps) to the start; every_pulses = 0: never.
    """

    start_cycles: np.ndarray
    len_cycles: np.ndarray
    step_cycles: np.ndarray = 0
    every_pulses: int = 0
    steps: int = 1
    frame_pulses: int = 1 << 62

    def __attrs_post_init__(self):
        for name, low in (("every_pulses", 0), ("steps", 1), ("frame_pulses", 1)):
            check_integer(name, getattr(self, name), low, 1 << 62)

    @classmethod
    def from_config(cls, config: Config) -> "SpadGate":
        """The gates of a configuration as SPAD gates; open all the time where a subgroup's gating is off."""
        subgroup, frame = pixel_table(config.sensor).subgroup, config.frame
        start, length, step = (np.where(config.gating, on, off)[subgroup] for on, off in (
            (config.gate_start, 0), (config.gate_len, config.period), (frame["gate_step"], 0)))
        return cls(start_cycles=start, len_cycles=np.minimum(length, config.period), step_cycles=step,
                   every_pulses=frame["gate_every"], steps=frame["gate_steps"], frame_pulses=config.pulses)


def dark_count_map(pixels: int, *, median_cps: float, hot_fraction: float, hot_cps: float, seed: int) -> np.ndarray:
    """Dark count rates float64[pixels]: `median_cps`, but `hot_cps` in a random share `hot_fraction` of the pixels."""
    check_integer("pixels", pixels, 1, 1 << 24)
    hot = round(pixels * check_real("hot_fraction", hot_fraction, 0, 1))
    dark_cps = np.full(pixels, check_real("median_cps", median_cps, 0))
    dark_cps[np.random.default_rng(seed).permutation(pixels)[:hot]] = check_real("hot_cps", hot_cps, 0)
    return dark_cps
