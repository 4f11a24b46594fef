# SPDX-License-Identifier: Apache-2.0
"""Compares the paper's four modes (coincidence x gating) with both kinds of gate, behind a pane of
glass and at 100 m.

Ref: paper III-A ("four different modes of operation with coincidence and gating", "time-gating ...
around the desired target range"). Targets are flat and fill the picture. The criteria, and all
numbers that the paper does not give, are our choice.
"""

import math
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter
from numpy.typing import ArrayLike

from coincid.lab.campaign import Processes, grouped
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup, seeded
from coincid.model.contract.result import differences
from coincid.model.light.light import Light, background_cps, signal_per_pulse
from coincid.model.light.timing import Timing
from coincid.model.shared.constants import SPEED_OF_LIGHT_M_S
from coincid.study.palette import GREY, INK, SERIES
from coincid.study.plot_style import legend_below, new_figure

from .sections import Comparison, Row, Section, section
from .setups import PULSES, Outcome, mean, mean_rows, outcome

SENSOR = {"rows": 16, "cols": 16}  # four subgroups, a quarter of the paper's array
LINK_GBPS = 2.0  # a quarter of the link of `make sim`
THRESHOLD = 2
MODES = {  # name: coincidence, kind of gate
    "neither": (False, None),
    "coincidence": (True, None),
    "logic gate": (False, "logic"),
    "SPAD gate": (False, "spad"),
    "coincidence, logic gate": (True, "logic"),
    "coincidence, SPAD gate": (True, "spad"),
}
MODE_STYLE = {
    "neither": (GREY, ":"),
    "coincidence": (INK, "-"),
    "logic gate": (SERIES[2], ":"),
    "SPAD gate": (SERIES[4], ":"),
    "coincidence, logic gate": (SERIES[2], "-"),
    "coincidence, SPAD gate": (SERIES[4], "-"),
}
METHODS = {"maximum": "the paper's peaks", "planes": "planes"}
# measure by column
MEASURES = {"right_share": "right_share", "found_share": "found_share", "rms_m": "found_rms_m"}
HALF_GATE_M = 3.0  # on either side of the target

DISTANCES_M, REFLECTIVITY = (3.0, 5.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0), 0.4
KLUX, SEEDS = (1.0, 10.0, 50.0, 100.0), 2

PANE_M, PANE_PHOTONS = 4.0, (0.0, 0.1, 0.3, 1.0, 3.0, 10.0)  # per pulse and pixel
# The target is within 1.2 m of the pane: within the SPAD's dead time of 8 ns.
BEHIND_M, BEHIND_GATE_M, PANE_KLUX = 4.9, 0.6, 10.0

FAR_M, FAR_KLUX, FAR_REFLECTIVITIES = 100.0, 10.0, (0.1, 0.4)
# Relative to the preset's laser: 5 nJ per pulse for 32 x 32 pixels.
POWERS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
PULSE_NJ = 5.0  # 10 mW at 2 MHz (paper II)
FAR_PULSES = (1000, 5000)
FAR_THRESHOLDS = (0, 1, 2, 3)  # 0: coincidence off
FAR_FRAME = {"period": 360}  # 108 m
# in cycles: a gate of 12 m moves by 10.2 m
SCAN = {"start_m": 3.0, "gate_len": 40, "gate_step": 34, "gate_steps": 10}
SCHEDULES = {
    "none": "no gate",
    "scan": "progressive SPAD gate, 3 to 108 m",
    "known": "SPAD gate of 10 m around the target",
}
SPOT_CHECKS = 5  # frames of each section that the RTL plays
FOUND_SHARE = 0.9  # share of the pixels within 15 cm, from which a target counts as found


def background(run: Processes, engine: str | None = None) -> Section:
    """Run all modes over distance, from 1 to 100 klux."""
    keys = product(MODES, KLUX, DISTANCES_M)
    setups = {
        (mode, klux, distance_m): _flat(mode, klux, distance_m, HALF_GATE_M)
        for mode, klux, distance_m in keys
    }
    table = grouped(setups, outcome, run)
    figure = new_figure(13, 6)
    axes = figure.subplots(len(METHODS), len(KLUX), sharex=True, sharey=True)
    for line, method in zip(axes, METHODS, strict=True):
        for axis, klux in zip(line, KLUX, strict=True):
            for mode, (colour, dashes) in MODE_STYLE.items():
                values = [
                    mean(table[mode, klux, distance_m], f"right_share_{method}")
                    for distance_m in DISTANCES_M
                ]
                axis.plot(DISTANCES_M, values, dashes, color=colour, label=mode)
            _share(axis)
            if method == "maximum":
                axis.set_title(f"{klux:g} klux")
            else:
                axis.set_xlabel("distance in m")
        line[0].set_ylabel(f"right pixels, {METHODS[method]}")
    legend_below(figure)
    reach = {}
    for mode in MODES:
        shares = {
            klux: [mean(table[mode, klux, d], "right_share_maximum") for d in DISTANCES_M]
            for klux in KLUX
        }
        reach[mode] = ", ".join(
            f"{klux:g} klux: {_reach(of_klux)}" for klux, of_klux in shares.items()
        )
    return section(
        "modes",
        "Four modes, two kinds of gate",
        figure,
        "Share of right pixels against distance, background from left to right, estimator from top to bottom",
        _rows(("mode", "klux", "distance_m"), table),
        Comparison("farthest distance with 90 % right pixels, the paper's peaks", "-", reach),
        text=_checks(engine, list(setups.values())),
    )


def glass(run: Processes, engine: str | None = None) -> Section:
    """Run a target behind a pane of glass that reflects light."""
    setups = {
        (mode, photons): _flat(mode, PANE_KLUX, BEHIND_M, BEHIND_GATE_M, photons)
        for mode, photons in product(MODES, PANE_PHOTONS)
    }
    table = grouped(setups, outcome, run)
    figure = new_figure(10, 4)
    at = [max(photons, PANE_PHOTONS[1] / 3) for photons in PANE_PHOTONS]
    for axis, method in zip(figure.subplots(1, len(METHODS), sharey=True), METHODS, strict=True):
        for mode, (colour, dashes) in MODE_STYLE.items():
            values = [
                mean(table[mode, photons], f"found_share_{method}") for photons in PANE_PHOTONS
            ]
            axis.plot(at, values, dashes, color=colour, label=mode)
        _share(axis)
        axis.set_xscale("log")
        axis.set_xticks(at, [f"{photons:g}" for photons in PANE_PHOTONS])
        axis.minorticks_off()
        axis.set(xlabel="photons of the pane per pulse and pixel", title=METHODS[method])
    figure.axes[0].set_ylabel("pixels that see the target (15 cm)")
    legend_below(figure)
    return section(
        "modes_glass",
        "Behind a pane",
        figure,
        "Pixels that see the target against the pane's light",
        _rows(("mode", "pane_photons"), table),
        text=_checks(engine, list(setups.values())),
    )


def far(run: Processes, engine: str | None = None) -> Section:
    """Find the laser pulse needed to see 100 m at 10 klux, by gate schedule."""
    keys = product(FAR_REFLECTIVITIES, SCHEDULES, FAR_PULSES, FAR_THRESHOLDS, POWERS)
    setups = {key: _far(*key) for key in keys}
    table = grouped(setups, outcome, run)
    figure = new_figure(10, 6.4)
    axes = figure.subplots(len(FAR_REFLECTIVITIES), len(FAR_PULSES), sharex=True, sharey=True)
    needs: dict[str, dict[str, str]] = {}
    for line, reflectivity in zip(axes, FAR_REFLECTIVITIES, strict=True):
        for axis, pulses in zip(line, FAR_PULSES, strict=True):
            for (schedule, name), colour in zip(
                SCHEDULES.items(), (GREY, SERIES[2], SERIES[4]), strict=True
            ):
                best = [_best(table, reflectivity, schedule, pulses, power) for power in POWERS]
                shares = [mean(outcomes, "found_share_planes") for _, outcomes in best]
                axis.plot(
                    [PULSE_NJ * power for power in POWERS], shares, "-o", color=colour, label=name
                )
                needs.setdefault(f"{reflectivity:.0%}, {pulses} pulses", {})[name] = _need(best)
            _share(axis)
            axis.set_xscale("log")
            axis.set_title(f"{reflectivity:.0%}, {pulses} pulses")
    for axis in axes[-1]:
        axis.set_xlabel("laser pulse in nJ for 32 x 32 pixels")
    for line in axes:
        line[0].set_ylabel("pixels that see the target (15 cm)")
    legend_below(figure)
    return section(
        "modes_far",
        "100 m at 10 klux",
        figure,
        "Pixels that see a target at 100 m against the laser's pulse",
        _rows(("reflectivity", "schedule", "pulses", "threshold", "laser"), table),
        *(Comparison(f"least laser pulse, {what}", "-", ours) for what, ours in needs.items()),
        text=_checks(engine, list(setups.values())),
    )


def _flat(
    mode: str, klux: float, distance_m: float, half_gate_m: float, pane_photons: float | None = None
) -> list[Setup]:
    coincidence, gate = MODES[mode]
    start = max(0, _cycles(distance_m - half_gate_m))
    subgroup = {"coincidence": coincidence, "threshold": THRESHOLD, "gating": gate is not None}
    subgroup |= {"gate_start": start, "gate_len": math.ceil(2 * half_gate_m / _cycle_m())}
    signal = float(signal_per_pulse(distance_m, REFLECTIVITY))
    targets = (
        [(distance_m, signal)]
        if pane_photons is None
        else [(PANE_M, pane_photons), (distance_m, signal)]
    )
    return _setups(targets, REFLECTIVITY, klux, gate == "spad", {}, subgroup)


def _far(
    reflectivity: float, schedule: str, pulses: int, threshold: int, power: float
) -> list[Setup]:
    frame: dict[str, Any] = FAR_FRAME | {"pulses": pulses}
    subgroup: dict[str, Any] = {"coincidence": threshold > 0, "threshold": max(1, threshold)}
    if schedule == "known":
        subgroup |= {"gating": True, "gate_start": _cycles(FAR_M - 5), "gate_len": _cycles(10)}
    elif schedule == "scan":
        subgroup |= {
            "gating": True,
            "gate_start": _cycles(SCAN["start_m"]),
            "gate_len": SCAN["gate_len"],
        }
        frame |= {name: SCAN[name] for name in ("gate_step", "gate_steps")}
        frame["gate_every"] = pulses // int(SCAN["gate_steps"])
    targets = [(FAR_M, power * float(signal_per_pulse(FAR_M, reflectivity)))]
    return _setups(targets, reflectivity, FAR_KLUX, schedule != "none", frame, subgroup)


def _setups(
    targets: ArrayLike,
    reflectivity: float,
    klux: float,
    spad_gate: bool,
    frame: dict[str, Any],
    subgroup: dict[str, Any],
) -> list[Setup]:
    """Return setups of flat targets, each (distance in metres, photons per pulse). The last one is
    the truth.
    """
    distance_m, signal = np.transpose(targets)
    light = Light(
        rows=SENSOR["rows"],
        cols=SENSOR["cols"],
        distance_m=distance_m[None],
        signal_per_pulse=signal[None],
        background_cps=background_cps(klux, reflectivity),
    )
    setup = Setup.of(
        f"flat:{distance_m[-1]},{reflectivity}",
        sensor=SENSOR,
        frame={"pulses": PULSES, "link_gbps": LINK_GBPS} | frame,
        subgroup=subgroup,
        light=light,
        spad_gate=spad_gate,
        estimators=tuple(METHODS),
    )
    return seeded(setup, SEEDS)


def _cycle_m() -> float:
    return Timing().tick_s * Timing().phases * SPEED_OF_LIGHT_M_S / 2


def _cycles(distance_m: float) -> int:
    """Return the cycle in which light from a distance arrives."""
    return int(distance_m / _cycle_m())


def _checks(engine: str | None, groups: Sequence[list[Setup]]) -> str:
    """Play some setups on the RTL, and return a sentence about the result. Raises `AssertionError`
    if a word differs.
    """
    if engine is None:
        return ""
    chosen = [Run(groups[int(k)][0]) for k in np.linspace(0, len(groups) - 1, SPOT_CHECKS)]
    runs = [run for run in chosen if run.config.pulses <= FAR_PULSES[0]]
    for run in runs:
        assert not differences(run.result, run.but(engine=engine).result), (
            "the RTL differs from the golden model"
        )
    return f"{len(runs)} of these frames were also played on the RTL: every word equals the golden model's."


def _rows(keys: tuple[str, ...], table: dict[Any, list[Outcome]]) -> list[Row]:
    """Return the rows of a CSV."""
    columns = {
        f"{name}_{method}": f"{MEASURES[name]}_{method}"
        for name, method in product(MEASURES, METHODS)
    }
    columns |= {"events": "events", "dropped": "dropped"}
    return [(*keys, *columns), *mean_rows(keys, list(columns.values()), table)[1:]]


def _share(axis: Axes) -> None:
    axis.set_ylim(0, 1.03)
    axis.yaxis.set_major_formatter(PercentFormatter(1))


def _reach(shares: Sequence[float]) -> str:
    good = [
        distance_m
        for distance_m, share in zip(DISTANCES_M, shares, strict=True)
        if share >= FOUND_SHARE
    ]
    return f"{max(good):g} m" if good else "none"


def _best(
    table: dict[Any, list[Outcome]], reflectivity: float, schedule: str, pulses: int, power: float
) -> tuple[int, list[Outcome]]:
    """Return the best threshold and its outcomes: most pixels see the target, then most are right,
    then it is the highest.
    """

    def rank(threshold: int) -> tuple[float, float, int]:
        outcomes = table[reflectivity, schedule, pulses, threshold, power]
        return mean(outcomes, "found_share_planes"), mean(outcomes, "right_share_planes"), threshold

    best = max(FAR_THRESHOLDS, key=rank)
    return best, table[reflectivity, schedule, pulses, best, power]


def _need(best: Sequence[tuple[int, list[Outcome]]]) -> str:
    """Return the weakest laser pulse that finds the target, with the threshold and the
    precision.
    """
    for power, (threshold, outcomes) in zip(POWERS, best, strict=True):
        if mean(outcomes, "found_share_planes") >= FOUND_SHARE:
            how = f"threshold {threshold}" if threshold else "coincidence off"
            return f"{PULSE_NJ * power:g} nJ, {how}, {100 * mean(outcomes, 'found_rms_m_planes'):.1f} cm RMS"
    return f"more than {PULSE_NJ * POWERS[-1]:g} nJ"


FAMILIES: tuple[Callable[..., Section], ...] = (background, glass, far)
