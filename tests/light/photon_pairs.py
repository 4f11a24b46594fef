# SPDX-License-Identifier: Apache-2.0
"""Light, SPADs, gates and clocks of which every pair comes up, and the digests of their photons.

`python -m tests.light.photon_pairs` writes the digests again; a change that means to change the
photons says so in CHANGELOG.md.
"""

from pathlib import Path
from typing import Any

import numpy as np

from coincid.model.contract.edges import Edges
from coincid.model.light.light import Arrivals, Interferer, Light
from coincid.model.light.photons import generate_edges
from coincid.model.light.spad import Spad, SpadGate
from coincid.model.light.timing import Timing
from coincid.model.shared.pulse import Pulse

from ..digests import digest, write_digests
from ..feature_pairs import Case, Features, Pair, cases_in_turns

DIGESTS = Path(__file__).with_suffix(".json")
ROWS = 5
COLS = 7
PIXELS = ROWS * COLS
PERIOD_CYCLES = 40
PHASES = 16
PULSES = 60
FEATURES: Features = {
    "distance_m": ("5", "row by row", "none in some", "two targets", "beyond the period"),
    "signal_per_pulse": (0.4, "column by column", 5.0),
    "background_cps": (0.0, 3e6, "row by row"),
    "system_fwhm_s": (5e-10, "column by column", "table"),
    "range_ambiguity": (True, False),
    "arrivals": ("none", "peaks", "wide bins with background"),
    "interferer": ("none", "of our period", "of another period", "delayed"),
    "dead_time_s": (8e-9, 0.0, 5e-8),
    "paralyzable": (False, True),
    "jitter_fwhm_s": (1e-10, 0.0),
    "jitter_tail": (0.0, 0.3),
    "dark_cps": (0.0, 1e6, "pixel by pixel"),
    "afterpulse_probability": (0.0, 0.2),
    "afterpulse_s": (3e-8, 4e-9),
    "crosstalk_probability": (0.0, 0.2),
    "gate": ("none", "all alike", "pixel by pixel", "moving"),
    "taps": ("even", "uneven"),
    "gap_cycles": (0, 9),
    "dither_bits": (0, 4),
    "dither_seed": (1, 77),
    "frame_pulses": (0, 25),
    "search_pulses": (0, 5),
    "pulse_start": (0, 13),
    "seed": (1, 1 << 40),
}
TABLE = ("system_fwhm_s", "table")
REFUSED: frozenset[Pair] = frozenset(  # a measured pulse has the jitter in it
    [frozenset([TABLE, ("jitter_tail", 0.3)])]
)
CASES = cases_in_turns(FEATURES, REFUSED, 3)


def light_of(case: Case) -> Light:
    """Return the light of a case."""
    pixel = np.arange(PIXELS)
    row, col = np.divmod(pixel, COLS)
    range_m = timing_of(case).range_m
    distances_m: dict[str, Any] = {
        "5": np.full(PIXELS, 5.0),
        "row by row": 2.0 + 0.7 * row + 0.1 * col,
        "none in some": np.where(pixel % 4 == 1, np.nan, 3.0 + 0.2 * col),
        "two targets": np.stack([3.0 + 0.1 * row, 6.0 + 0.3 * col], axis=1),
        "beyond the period": range_m * (0.8 + 0.1 * row),
    }
    signal: Any = case["signal_per_pulse"]
    if signal == "column by column":
        signal = (0.1 + 0.5 * col)[:, None]
    background_cps: Any = case["background_cps"]
    if background_cps == "row by row":
        background_cps = 2e6 * row
    widths_s: Any = case["system_fwhm_s"]
    pulse = None
    if case["system_fwhm_s"] == "column by column":
        widths_s = (2e-10 + 1e-10 * col)[:, None]
    if case["system_fwhm_s"] == "table":
        widths_s = 5e-10
        time_s = np.arange(-5, 20) * 1e-10
        pulse = Pulse(time_s=time_s, density=1 / (1 + (time_s / 2e-10) ** 2))
    return Light(
        rows=ROWS,
        cols=COLS,
        distance_m=distances_m[case["distance_m"]],
        signal_per_pulse=signal,
        background_cps=background_cps,
        system_fwhm_s=widths_s,
        range_ambiguity=case["range_ambiguity"],
        arrivals=arrivals_of(case["arrivals"]),
        interferer=interferer_of(case["interferer"], timing_of(case).period_s),
        pulse=pulse,
    )


def arrivals_of(kind: str) -> Arrivals | None:
    """Return light in bins: one or two for most pixels, none for some."""
    if kind == "none":
        return None
    number = np.arange(PIXELS) % 3
    first = np.concatenate([[0], np.cumsum(number)])
    inside = np.arange(first[-1]) - np.repeat(first[:-1], number)
    start_s = 1e-8 + 2e-8 * inside
    wide = kind != "peaks"
    return Arrivals(
        first=first,
        start_s=start_s,
        photons=np.full(len(start_s), 0.5),
        width_s=5e-9 if wide else 0.0,
        background_cps=1e6 if wide else 0.0,
        span_s=5e-8 if wide else 0.0,
    )


def interferer_of(kind: str, period_s: float) -> Interferer | None:
    """Return another LiDAR."""
    delayed = kind == "delayed"
    kinds: dict[str, float] = {
        "of our period": period_s,
        "of another period": 0.37 * period_s,
        "delayed": 1.9 * period_s,
    }
    if kind not in kinds:
        return None
    return Interferer(
        photons_per_pulse=np.linspace(0, 1, PIXELS) if delayed else 0.3,
        period_s=kinds[kind],
        phase_s=2e-8,
        delay_s=np.arange(PIXELS) * 1e-9 if delayed else 0.0,
        fwhm_s=3e-10,
    )


def timing_of(case: Case) -> Timing:
    """Return the clock of a case."""
    widths_lsb = np.ones(PHASES)
    widths_lsb[[2, 3]] = 1.6, 0.4
    searches = case["search_pulses"]
    return Timing(
        clock_hz=5e8,
        phases=PHASES,
        period_cycles=PERIOD_CYCLES,
        tap_width_lsb=widths_lsb if case["taps"] == "uneven" else None,
        gap_cycles=case["gap_cycles"],
        dither_bits=case["dither_bits"],
        dither_seed=case["dither_seed"],
        frame_pulses=case["frame_pulses"],
        search_pulses=searches,
        search_minigroups=6 if searches else 0,
    )


def spad_of(case: Case) -> Spad:
    """Return the SPADs of a case."""
    dark_cps = case["dark_cps"]
    if dark_cps == "pixel by pixel":
        dark_cps = 1e5 * np.arange(PIXELS)
    names = (
        "dead_time_s",
        "paralyzable",
        "jitter_fwhm_s",
        "afterpulse_probability",
        "afterpulse_s",
        "crosstalk_probability",
    )
    return Spad(
        dark_cps=dark_cps,
        jitter_tail_fraction=case["jitter_tail"],
        jitter_tail_s=6e-10,
        **{name: case[name] for name in names},
    )


def gate_of(case: Case) -> SpadGate | None:
    """Return the times at which the SPADs are on."""
    pixel = np.arange(PIXELS)
    kinds = {
        "none": None,
        "all alike": SpadGate(start_cycles=5, len_cycles=20),
        "pixel by pixel": SpadGate(start_cycles=pixel % 9, len_cycles=pixel % 11 * 3),
        "moving": SpadGate(
            start_cycles=2,
            len_cycles=12,
            step_cycles=pixel % 3,
            every_pulses=7,
            steps=4,
            frame_pulses=case["frame_pulses"] or PULSES,
        ),
    }
    return kinds[case["gate"]]


def edges_of(case: Case) -> Edges:
    """Return the edges of a case."""
    return generate_edges(
        light_of(case),
        spad_of(case),
        timing_of(case),
        pulses=PULSES,
        seed=case["seed"],
        pulse_start=case["pulse_start"],
        gate=gate_of(case),
    )


def digest_of(case: Case) -> str:
    """Return the digest of the edges of a case."""
    edges = edges_of(case)
    return digest((edges.pulse, edges.pixel, edges.tick))


if __name__ == "__main__":
    write_digests(DIGESTS, [digest_of(case) for case in CASES])
