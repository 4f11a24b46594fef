# SPDX-License-Identifier: Apache-2.0
"""Puts the bounds of a distance, and what each estimator loses, into docs/limit.md.

`python -m docs.studies.limit` writes its tables and its picture.
"""

from collections.abc import Iterator

import numpy as np

from coincid.lab.bound import Bound, bound
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth.quality import OTHER_SURFACE_M
from coincid.model.shared.markdown import text_table
from coincid.study.palette import SERIES
from coincid.study.plot_style import new_figure, save_figure, style
from coincid.tools.pages import picture, put

PAGE = "docs/limit.md"
PICTURE = "docs/images/limit.png"
KLUX = 50.0
WALLS = ((2.0, 0.4), (4.0, 0.4), (8.0, 0.4), (16.0, 0.4), (16.0, 0.1), (32.0, 0.4))
THRESHOLDS = (1, 2, 3)
PULSES = 1000
SIMULATED = ((4.0, 0.4), (16.0, 0.4), (16.0, 0.1))
THRESHOLD = 2  # of the simulated walls
METHODS = ("maximum", "matched", "background", "planes")
SIZE = 32  # rows and columns of the simulated walls
DISTANCES_M = np.geomspace(2, 40, 14)


def of_wall(distance_m: float, reflectivity: float, threshold: int, pulses: int) -> Bound:
    """Return the bound of a wall, without the share of gross errors."""
    return bound(
        distance_m=distance_m,
        reflectivity=reflectivity,
        klux=KLUX,
        threshold=threshold,
        pulses=pulses,
        trials=0,
    )


def bound_rows() -> Iterator[tuple[str, ...]]:
    """Yield the bounds of each wall, in mm."""
    for distance_m, reflectivity in WALLS:
        found = [of_wall(distance_m, reflectivity, one, PULSES) for one in THRESHOLDS]
        words = " / ".join(f"{one.bound_mm:.2f}" for one in found)
        together = " / ".join(f"{one.wall_bound_mm:.2f}" for one in found)
        yield (
            f"{distance_m:g} m, {reflectivity:.0%}",
            f"{found[0].photons_mm:.2f}",
            words,
            f"{found[0].wall_photons_mm:.2f}",
            together,
        )


def estimator_rows() -> Iterator[tuple[str, ...]]:
    """Yield the RMS errors of each estimator on simulated walls, in mm."""
    for distance_m, reflectivity in SIMULATED:
        for pulses in (100, PULSES):
            least = of_wall(distance_m, reflectivity, THRESHOLD, pulses)
            setup = Setup.of(
                f"flat:{distance_m:g},{reflectivity:g}",
                klux=KLUX,
                sensor={"rows": SIZE, "cols": SIZE, "streams": 4},
                frame={"pulses": pulses},
                subgroup={"threshold": THRESHOLD},
            )
            run = Run(setup, workers=2)
            errors = []
            for method in METHODS:
                off_m = run.frame(estimator=method).depth_m - run.scene.truth_m
                near = np.abs(off_m) <= OTHER_SURFACE_M
                rms_mm = 1e3 * np.sqrt(np.mean(off_m[near] ** 2)) if near.any() else np.nan
                errors.append(f"{rms_mm:.1f} ({np.mean(~near):.1%})")
            yield (
                f"{distance_m:g} m, {reflectivity:.0%}",
                str(pulses),
                f"{least.bound_mm:.1f}",
                f"{least.wall_bound_mm:.2f}",
                *errors,
            )


def draw() -> None:
    """Draw the bounds and the share of gross errors over the distance."""
    with style():
        figure = new_figure(9.5, 4.0)
        errors, gross = figure.subplots(1, 2)
        of_photons = [of_wall(one, 0.4, 1, PULSES).photons_mm for one in DISTANCES_M]
        errors.plot(DISTANCES_M, of_photons, color=SERIES[0], label="all photons")
        for threshold, colour in zip(THRESHOLDS, SERIES[1:], strict=False):
            of_words = [of_wall(one, 0.4, threshold, PULSES).bound_mm for one in DISTANCES_M]
            errors.plot(DISTANCES_M, of_words, color=colour, label=f"words, threshold {threshold}")
        errors.set(xscale="log", yscale="log", xlabel="distance, m", ylabel="RMS error, mm")
        errors.set_title(f"one pixel, 40 %, {KLUX:g} klux, {PULSES} pulses", loc="left")
        errors.legend()
        for pulses, colour in zip((100, PULSES), SERIES, strict=False):
            shares = [
                bound(distance_m=one, klux=KLUX, pulses=pulses, trials=200).gross_share
                for one in DISTANCES_M
            ]
            gross.plot(DISTANCES_M, shares, color=colour, label=f"{pulses} pulses")
        gross.set(xscale="log", xlabel="distance, m", ylabel="share off by more than 15 cm")
        gross.set_title("all photons of one pixel, no neighbours", loc="left")
        gross.legend()
        for axis in (errors, gross):
            axis.set_xticks([2, 5, 10, 20, 40], ["2", "5", "10", "20", "40"])
            axis.minorticks_off()
        save_figure(figure, picture(PICTURE))


def make() -> None:
    """Write tables and picture into the page."""
    head = (
        "wall",
        "1 pixel, photons",
        "1 pixel, words at 1 / 2 / 3",
        "64 pixels, photons",
        "64 pixels, words at 1 / 2 / 3",
    )
    put(PAGE, "bounds", text_table(head, bound_rows()))
    of_estimators = ("wall", "pulses", "bound, 1 pixel", "bound, 64 pixels", *METHODS)
    put(PAGE, "estimators", text_table(of_estimators, estimator_rows()))
    draw()
    put(PAGE, "picture", "![Bounds over the distance](images/limit.png)")


if __name__ == "__main__":
    make()
