# SPDX-License-Identifier: Apache-2.0
"""Measures how much light is needed to see four surfaces in every pixel, and one point at 150 m.

`python -m docs.studies.returns` writes the tables of docs/returns.md and draws its picture. All
surfaces send back the same amount of light. The background is that of a target of 40 %, so it does
not depend on this amount.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from coincid.lab.campaign import Processes, grouped
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup, seeded
from coincid.model.contract.pixels import pixel_table
from coincid.model.depth.histograms import SOURCES, pixel_histogram
from coincid.model.depth.quality import TOLERANCE_M
from coincid.model.light.light import Light, background_cps, signal_per_pulse
from coincid.model.scenes.catalogue import AT, RETURNS
from coincid.model.shared.markdown import text_table
from coincid.study.palette import ALARM, GREY, SERIES
from coincid.study.plot_style import legend_below, new_figure, save_figure, style
from coincid.tools.pages import counted, picture, put

PAGE, PICTURE = "docs/returns.md", "docs/images/returns.png"
SENSOR = {"rows": 16, "cols": 16}
# NEAREST_M: two places of the nearest surface in a clock cycle.
SURFACES, STEPS_M, NEAREST_M = 4, (0.15, 0.3), (4.0, 4.1)
# For the picture. PHOTONS: per pixel and pulse, from all surfaces together. WINDOW: threshold,
# ticks.
PULSES, PHOTONS, KLUX, WINDOW = 5000, 0.1, 50.0, (2, 8)
RECORDS = {"minigroup_records": True, "mg_threshold": 1, "mg_window": 1}
METHOD, SHOWN = (
    "background",
    {"map": "pixel", "minigroup": "its minigroup's records", "subgroup": "its subgroup"},
)
WINDOWS = ((0, 1), WINDOW, (2, 16), (3, 8))  # threshold 0: coincidence off
LIGHTS, AMBIENTS, FRAMES = (0.02, 0.05, 0.1, 0.2, 0.6), (10.0, 50.0), (1000, 5000)
# cycles of half the length
FASTER = {"phases": 16, "coarse_bits": 11}, {"clock_mhz": 1000.0, "period": 500}

FAR_M, PERIOD = 150.0, 520  # cycles: 156 m
POINT = {"rows": 8, "cols": 8}  # one subgroup sees the point
# laser pulse of the preset, and the number of pixels that share it
PULSE_NJ, PULSE_PIXELS = 5.0, 1024
ENERGIES_NJ = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # of a pulse that lights only the point
FAR_PULSES, FAR_KLUX, FAR_REFLECTIVITIES = (1000, 10_000), (10.0, 50.0), (0.1, 0.4)
FAR_THRESHOLDS, FAR_WINDOW = (0, 2, 3), 8
POINTS = 20  # measurements for each combination
FOUND_SHARE = 0.9


def targets(nearest_m: float, step_m: float) -> np.ndarray:
    """float64[SURFACES]: distances of the surfaces."""
    return nearest_m + step_m * np.arange(SURFACES)


def setup(
    nearest_m: float,
    step_m: float,
    photons: float = PHOTONS,
    klux: float = KLUX,
    pulses: int = PULSES,
    window: tuple[int, int] = WINDOW,
    faster: bool = False,
) -> Setup:
    """Return the setup of surfaces in every pixel. window: threshold and ticks."""
    distance_m = targets(nearest_m, step_m)
    reflectivity = photons / SURFACES / signal_per_pulse(distance_m, 1.0)
    threshold, ticks = window
    sensor, frame = FASTER if faster else ({}, {})
    return Setup.of(
        f"{RETURNS}:"
        + ",".join(
            f"{m:g}{AT}{share:.4g}" for m, share in zip(distance_m, reflectivity, strict=True)
        ),
        sensor=SENSOR | sensor,
        frame={"pulses": pulses} | RECORDS | frame,
        subgroup={"coincidence": threshold > 0, "threshold": max(1, threshold), "window": ticks},
        klux=klux,
        background="even",
        estimators=(),
    )


def all_found(run: Run) -> dict[str, float]:
    """Return the share of pixels that find all surfaces within the tolerance, by the source of
    their histograms.
    """
    shares = {}
    for source in SOURCES:
        depth_m = run.depth(f"{METHOD}/{source}", returns=SURFACES).depth_m
        off_m = np.abs(depth_m[:, :, None] - run.scene.distance_m[0, 0][:, None])
        shares[source] = float(
            np.mean(np.nanmin(np.nan_to_num(off_m, nan=np.inf), axis=3).max(axis=2) <= TOLERANCE_M)
        )
    return shares


def found_rows(run: Processes) -> Iterator[Sequence[str]]:
    """Yield the rows of a table: the percentage of pixels that find all surfaces, for each of
    `SOURCES`.
    """
    cases = list(product(STEPS_M, FRAMES, WINDOWS, AMBIENTS))
    keys = [(*case, photons) for case in cases for photons in LIGHTS]
    setups = {
        key: [setup(nearest_m, key[0], key[4], key[3], key[1], key[2]) for nearest_m in NEAREST_M]
        for key in keys
    }
    found = grouped(setups, all_found, run)
    for step_m, pulses, window, klux in cases:
        shares = (_per_cent(found[step_m, pulses, window, klux, photons]) for photons in LIGHTS)
        yield f"{100 * step_m:.0f} cm", str(pulses), _window(window), f"{klux:g}", *shares


def _per_cent(outcomes: Sequence[dict[str, float]]) -> str:
    return " / ".join(
        f"{100 * np.mean([one[source] for one in outcomes]):.0f}" for source in SOURCES
    )


def _window(window: tuple[int, int]) -> str:
    threshold, ticks = window
    return _threshold(threshold) + f", {ticks} ticks" * (threshold > 0)


def draw_returns(path: Path) -> None:
    """Draw the histograms of a pixel, its minigroup's records and its subgroup, with the surfaces
    and the returns.
    """
    with style():
        figure = new_figure(10, 6.6)
        axes = figure.subplots(len(SOURCES), len(STEPS_M), sharey="row")
        for column, step_m in zip(axes.T, STEPS_M, strict=True):
            run = Run(setup(NEAREST_M[0], step_m))
            shares = all_found(run)
            for axis, source in zip(column, SOURCES, strict=True):
                _draw_histogram(axis, run, source)
                axis.set_title(
                    f"{SHOWN[source]}, {100 * step_m:.0f} cm apart: {shares[source]:.0%} have all"
                )
            column[-1].set_xlabel("distance in m")
        for axis in axes[:, 0]:
            axis.set_ylabel("hits")
        legend_below(figure)
        save_figure(figure, path)


def _draw_histogram(axis: Axes, run: Run, source: str) -> None:
    config, pixel = (
        run.config,
        int(np.flatnonzero(pixel_table(run.config.sensor).subgroup == 0)[27]),
    )
    tick_m = config.tick_m
    surfaces_m = run.scene.distance_m[0, 0]
    hits = pixel_histogram(run.result, config, pixel, source=source)
    at_m = (np.arange(len(hits)) + 0.5) * tick_m
    shown = np.abs(at_m - surfaces_m.mean()) < np.ptp(surfaces_m) / 2 + 0.3
    axis.bar(at_m[shown], hits[shown], width=tick_m, color=SERIES[2])
    for label, x_m, colour in (
        ("surfaces", surfaces_m, GREY),
        (
            "returns",
            run.depth(f"{METHOD}/{source}", returns=SURFACES).depth_m.reshape(-1, SURFACES)[pixel],
            ALARM,
        ),
    ):
        height = hits[shown].max() * (1.08 if label == "surfaces" else 1.18)
        axis.plot(
            x_m,
            np.full(len(x_m), height),
            "v" if label == "surfaces" else "D",
            color=colour,
            label=label,
        )


def point(reflectivity: float, klux: float, pulses: int, threshold: int, energy_nj: float) -> Setup:
    """Return the setup of a single point that all pixels of a subgroup see; the laser lights
    nothing else.
    """
    share = energy_nj / PULSE_NJ * PULSE_PIXELS / (POINT["rows"] * POINT["cols"])
    light = Light(
        rows=POINT["rows"],
        cols=POINT["cols"],
        distance_m=np.array([FAR_M]),
        signal_per_pulse=np.array([share * float(signal_per_pulse(FAR_M, reflectivity))]),
        background_cps=background_cps(klux, reflectivity),
    )
    return Setup.of(
        sensor=POINT,
        frame={"pulses": pulses, "period": PERIOD},
        subgroup={
            "coincidence": threshold > 0,
            "threshold": max(1, threshold),
            "window": FAR_WINDOW,
        },
        light=light,
        estimators=(),
    )


def point_error_m(run: Run) -> float:
    """Return the error of the point's distance, from the histogram of its subgroup; NaN if there is
    no distance.
    """
    return float(run.depth(f"{METHOD}/subgroup").depth_m[0, 0, 0] - FAR_M)


def far_rows(run: Processes) -> Iterator[Sequence[str]]:
    """Yield the rows of a table: the lowest energy at which `FOUND_SHARE` of `POINTS` measurements
    are right.
    """
    keys = product(FAR_REFLECTIVITIES, FAR_KLUX, FAR_PULSES, FAR_THRESHOLDS, ENERGIES_NJ)
    errors = grouped({key: seeded(point(*key), POINTS) for key in keys}, point_error_m, run)
    for reflectivity, klux, pulses in product(FAR_REFLECTIVITIES, FAR_KLUX, FAR_PULSES):
        cells = []
        for threshold in FAR_THRESHOLDS:
            of = {
                nj: np.array(errors[reflectivity, klux, pulses, threshold, nj])
                for nj in ENERGIES_NJ
            }
            right_m = {nj: error_m[np.abs(error_m) <= TOLERANCE_M] for nj, error_m in of.items()}
            enough = [nj for nj in ENERGIES_NJ if len(right_m[nj]) >= FOUND_SHARE * POINTS]
            rms_cm = [
                f"{nj:g} nJ, {100 * np.sqrt(np.mean(right_m[nj] ** 2)):.1f} cm" for nj in enough
            ]
            cells.append(rms_cm[0] if enough else f"more than {ENERGIES_NJ[-1]:g} nJ")
        yield f"{reflectivity:.0%}", f"{klux:g}", str(pulses), *cells


def _threshold(threshold: int) -> str:
    return f"threshold {threshold}" if threshold else "coincidence off"


def make() -> None:
    """Write tables and picture into their page."""
    draw_returns(picture(PICTURE))
    put(PAGE, "picture")
    with Processes(progress=counted) as run:
        head = "apart", "pulses", "window", "klux", *(f"{photons:g} photons" for photons in LIGHTS)
        put(PAGE, "found", text_table(head, found_rows(run), left=(0, 2)))
        bright = {
            faster: [setup(m, STEPS_M[0], LIGHTS[-1], faster=faster) for m in NEAREST_M]
            for faster in (False, True)
        }
        cells = {
            faster: _per_cent(outcomes)
            for faster, outcomes in grouped(bright, all_found, run).items()
        }
        rows = [("32 phases, 500 MHz", cells[False]), ("16 phases, 1 GHz", cells[True])]
        put(PAGE, "faster", text_table(("sensor", f"{LIGHTS[-1]:g} photons, 15 cm apart"), rows))
        head = "target", "klux", "pulses", *map(_threshold, FAR_THRESHOLDS)
        put(PAGE, "far", text_table(head, far_rows(run)))


if __name__ == "__main__":
    make()
