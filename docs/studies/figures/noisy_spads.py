# SPDX-License-Identifier: Apache-2.0
"""Noisy SPADs: dark counts, hot pixels and crosstalk against wrong pixels and events."""

from itertools import product
from typing import Any

from coincid.lab.campaign import Processes, grouped
from coincid.model.contract.parameters import Sensor
from coincid.model.light.spad import Spad, dark_count_map
from coincid.study.palette import SERIES
from coincid.study.plot_style import legend_below, new_figure, share_axis

from .sections import Section, section
from .setups import PULSES, cases, mean, mean_rows, outcome

METHODS = {"planes": "-o", "matched": "--s"}  # estimator: its line
THRESHOLDS = {2: SERIES[0], 3: SERIES[3], 5: SERIES[5]}
SEEDS = 2
HOT_CPS = 5e6
# Kinds of noise. Each of their values has fields of `Setup.of`.
SPADS: dict[str, dict[float, dict[str, Any]]] = {
    "dark counts of every pixel in 1/s": {
        rate_cps: {"spad": Spad(dark_cps=rate_cps)} for rate_cps in (0.0, 1e3, 1e4, 1e5, 1e6, 5e6)
    },
    f"share of hot pixels ({HOT_CPS / 1e6:g}e6/s)": {
        share: {
            "spad": Spad(
                dark_cps=dark_count_map(
                    Sensor().array_pixels, median_cps=0, hot_fraction=share, hot_cps=HOT_CPS, seed=1
                )
            )
        }
        for share in (0.0, 0.01, 0.02, 0.05, 0.1, 0.2)
    },
    "crosstalk probability to each neighbour": {
        share: {"spad": Spad(crosstalk_probability=share)}
        for share in (0.0, 0.005, 0.01, 0.02, 0.05, 0.1)
    },
}


def noisy_spads(run: Processes) -> Section:
    """Draw a column for each kind of noise: wrong pixels above, events below."""
    setups = {}
    for (study, values), threshold in product(SPADS.items(), THRESHOLDS):
        for value, fields in values.items():
            subgroup = {"threshold": threshold}
            setups[study, value, threshold] = cases(
                SEEDS, subgroup=subgroup, estimators=tuple(METHODS), **fields
            )
    table = grouped(setups, outcome, run)
    figure = new_figure(4.4 * len(SPADS), 7.5)
    axes = figure.subplots(2, len(SPADS), sharey="row", squeeze=False)
    for (above, below), (study, values) in zip(axes.T, SPADS.items(), strict=True):
        at = range(len(values))
        for threshold, colour in THRESHOLDS.items():
            shown, label = (
                [table[study, value, threshold] for value in values],
                f"threshold {threshold}",
            )
            for method, mark in METHODS.items():
                wrong = [mean(one, f"wrong_share_{method}") for one in shown]
                above.plot(at, wrong, mark, color=colour, label=f"{label}, {method}")
            below.plot(at, [mean(one, "events_per_s") / 1e6 for one in shown], "-o", color=colour)
        for axis in (above, below):
            axis.set_xticks(at, labels=[f"{value:g}" for value in values])
        below.set_xlabel(study)
    share_axis(axes[0, 0], ylabel="share of wrong pixels")
    axes[1, 0].set_ylabel("events in 1e6/s")
    legend_below(figure)
    measures = (*(f"wrong_share_{method}" for method in METHODS), "events_per_s")
    rows = mean_rows(("study", "value", "threshold"), measures, table)
    caption = f"Five objects at 50 klux, {PULSES} pulses: wrong pixels (above) and events (below)"
    return section("noisy_spads", "Dark counts, hot pixels, crosstalk", figure, caption, rows)
