# SPDX-License-Identifier: Apache-2.0
"""Draws Fig. 7 of the paper: the highest and the lowest threshold that are about as good as the
best one.
"""

from collections.abc import Iterable
from itertools import product
from typing import TypeAlias

import numpy as np

from coincid.lab.campaign import Processes, grouped
from coincid.model.light.analytic import (
    THRESHOLDS,
    expected_threshold,
    lowest_threshold,
    success_by_threshold,
)
from coincid.model.light.light import background_cps, signal_per_pulse
from coincid.model.light.link_budget import FORMS
from coincid.model.light.timing import Timing
from coincid.study.palette import GREY, INK
from coincid.study.plot_style import SOURCES, legend_below, new_figure

from .sections import Comparison, Row, Section, section
from .setups import MANY, PULSES, cases, mean, outcome

DISTANCE_M = 9.7
# photons per pixel and pulse: 0.23 is a reflectivity of 0.9 at 9.7 m
SIGNAL = np.geomspace(0.015, 0.235, 9)
KLUX = (5.0, 50.0)
WINDOW_TICKS, PIXELS, SEEDS = 16, 64, 3
Chosen: TypeAlias = dict[
    tuple[str, float, int], list[tuple[int, int]]
]  # (highest, lowest) threshold by source, klux and pulses, one pair for each of `SIGNAL`
# threshold, the paper's text about it
READINGS = (("highest", "rises with activity, 1 to 7"), ("lowest", "-"))


def figure_7(run: Processes) -> Section:
    """Show these thresholds against activity, for flat targets of increasing reflectivity under two
    backgrounds.
    """
    columns = "source klux pulses signal_per_pulse activity_cps expected_threshold lowest_threshold"
    rows: list[Row] = [
        [*columns.split(), *(f"success_threshold_{threshold}" for threshold in THRESHOLDS)]
    ]
    figure = new_figure(11, 4.2)
    axes = figure.subplots(1, 2, sharey=True)
    chosen: Chosen = {}
    for axis, klux in zip(axes, KLUX, strict=True):
        activity_cps = PIXELS * (background_cps(klux) + SIGNAL / Timing().period_s)
        for form in FORMS:
            expected = run.map(_success, [(float(signal), klux, form) for signal in SIGNAL])
            _add(rows, chosen, form, klux, PULSES, activity_cps, expected)
            highest, lowest = np.transpose(chosen[form, klux, PULSES])
            axis.semilogx(
                activity_cps, highest, **SOURCES[form], label=f"analytic, {form}: highest"
            )
            axis.semilogx(
                activity_cps, lowest, **SOURCES[form], alpha=0.4, label=f"analytic, {form}: lowest"
            )
        for pulses, marker in ((PULSES, "o"), (MANY * PULSES, "+")):
            success = _simulated(run, klux, pulses)
            _add(rows, chosen, "Monte Carlo", klux, pulses, activity_cps, success)
            for which, colour, thresholds in zip(
                ("highest", "lowest"),
                (INK, GREY),
                np.transpose(chosen["Monte Carlo", klux, pulses]),
                strict=True,
            ):
                label = f"Monte Carlo, {pulses} pulses: {which}"
                axis.semilogx(
                    activity_cps, thresholds, marker, color=colour, markersize=7, label=label
                )
        axis.set(
            xlabel="activity of the subgroup in detected photons per second",
            title=f"{klux:g} klux",
            ylim=(0.5, 7.5),
        )
    axes[0].set_ylabel("threshold within 1 % of the best")
    legend_below(figure, 4)
    names = {
        "analytic, literal": ("literal", PULSES),
        "analytic, corrected": ("corrected", PULSES),
        "Monte Carlo": ("Monte Carlo", PULSES),
        "Monte Carlo, 8x": ("Monte Carlo", MANY * PULSES),
    }
    return section(
        "fig7",
        "Fig. 7: threshold against activity",
        figure,
        "Highest and lowest threshold within 1 % of the best, against the activity of a subgroup, at 5 and 50 klux",
        rows,
        *(
            Comparison(
                f"{which} threshold within 1 % of the best, {klux:g} klux",
                paper,
                {
                    name: _ends(chosen[source, klux, pulses], i)
                    for name, (source, pulses) in names.items()
                },
            )
            for klux in KLUX
            for i, (which, paper) in enumerate(READINGS)
        ),
    )


def _success(task: tuple[float, float, str]) -> np.ndarray:
    signal, klux, form = task
    return success_by_threshold(
        signal,
        float(background_cps(klux)),
        DISTANCE_M,
        window_ticks=WINDOW_TICKS,
        pulses=PULSES,
        form=form,
    )


def _simulated(run: Processes, klux: float, pulses: int) -> np.ndarray:
    """float64[signals, thresholds]: the share of right pixels."""
    setups = {}
    for signal, threshold in product(SIGNAL, THRESHOLDS):
        reflectivity = signal / signal_per_pulse(DISTANCE_M, 1.0)
        setups[signal, threshold] = cases(
            SEEDS,
            pulses,
            scene=f"flat:{DISTANCE_M},{reflectivity:.6f}",
            klux=klux,
            sensor={"rows": 16, "cols": 16},
            subgroup={"threshold": threshold, "window": WINDOW_TICKS},
            estimators=("maximum",),
        )
    success = [
        1 - mean(outcomes, "wrong_share") for outcomes in grouped(setups, outcome, run).values()
    ]
    return np.reshape(success, (len(SIGNAL), len(THRESHOLDS)))


def _add(
    rows: list[Row],
    chosen: Chosen,
    source: str,
    klux: float,
    pulses: int,
    activity_cps: np.ndarray,
    success: Iterable[np.ndarray],
) -> None:
    """Add rows to the CSV, and add the chosen thresholds to `chosen`."""
    shares = [np.asarray(one) for one in success]
    chosen[source, klux, pulses] = [
        (expected_threshold(one), lowest_threshold(one)) for one in shares
    ]
    for signal, activity, thresholds, one in zip(
        SIGNAL, activity_cps, chosen[source, klux, pulses], shares, strict=True
    ):
        rows.append(
            (source, klux, pulses, float(signal), float(activity), *thresholds, *map(float, one))
        )


def _ends(chosen: list[tuple[int, int]], which: int) -> str:
    """Return the threshold at lowest and highest activity, and a higher one in between. which: 0
    highest, 1 lowest.
    """
    first, last, most = chosen[0][which], chosen[-1][which], max(pair[which] for pair in chosen)
    return f"{first} to {last}" + (f", {most} between them" if most > max(first, last) else "")
