# SPDX-License-Identifier: Apache-2.0
"""Draws Figs. 2 and 5 of the paper: rates and signal to background over distance, and the returning
pulse.
"""

import numpy as np
from scipy import special

from coincid.lab.campaign import Processes
from coincid.lab.outcomes import Run
from coincid.model.light.light import Light
from coincid.model.light.link_budget import FORMS, link_budget
from coincid.model.light.photons import generate_edges
from coincid.model.light.spad import Spad
from coincid.model.light.timing import Timing
from coincid.model.shared.constants import SIGMA_PER_FWHM, SPEED_OF_LIGHT_M_S
from coincid.model.shared.quantities import Numbers
from coincid.study.palette import DARK_GREY, SERIES
from coincid.study.plot_style import SOURCES, new_figure

from .sections import Comparison, Row, Section, section
from .setups import MANY, PULSES, cases

REFLECTIVITY, KLUX = 0.4, 50.0  # paper II
DISTANCE_M = np.round(np.arange(1, 50.01, 0.25), 2)
MONTE_CARLO_M = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 50.0)
SIDE = 4  # rows and columns of the simulated array
NEAR_OBJECT, FAR_OBJECT = 4, 1  # of the scene: the aluminium bin at 4.3 m, the wall at 9.7 m
PAPER_FWHM_PS = "500 to 520 ps"


def figure_2(run: Processes) -> Section:
    """Show the detected rates of a pixel, and the distance at which signal to background is 0
    dB.
    """
    budgets = {
        (form, reading): link_budget(DISTANCE_M, REFLECTIVITY, KLUX, form=form, sbr_reading=reading)
        for form in FORMS
        for reading in "AEF"
    }
    simulated = run.map(_detected_cps, MONTE_CARLO_M)
    rows: list[Row] = [
        (
            "source",
            "distance_m",
            "signal_cps",
            "background_cps",
            "background_live_cps",
            "total_live_cps",
        )
        + tuple(f"sbr_{reading.lower()}_db" for reading in "AEF")
    ]
    for form in FORMS:
        budget = budgets[form, "A"]
        of_distance = np.transpose(
            [
                DISTANCE_M,
                budget.signal_rate_cps,
                *(budgets[form, reading].sbr_db for reading in "AEF"),
            ]
        )
        for distance_m, signal_cps, *sbr_db in of_distance.tolist():
            noise = budget.background_rate_cps, budget.background_live_cps
            rows.append((form, distance_m, signal_cps, *noise, "", *sbr_db))
    rows += [
        ("Monte Carlo", d, signal, "", noise, both, "", "", "")
        for d, signal, noise, both in simulated
    ]

    figure = new_figure(11, 4.2)
    left, right = figure.subplots(1, 2)
    for form in FORMS:
        budget, style = budgets[form, "A"], SOURCES[form]
        left.loglog(DISTANCE_M, budget.signal_rate_cps, **style, label=f"signal, {form}")
        background_cps = np.full(len(DISTANCE_M), budget.background_rate_cps)
        left.loglog(DISTANCE_M, background_cps, **style, alpha=0.45, label=f"background, {form}")
    live = budgets["literal", "A"].background_live_cps
    left.axhline(live, color=DARK_GREY, linewidth=1, label="background after dead time")
    at, signal_cps, _, both_cps = zip(*simulated, strict=True)
    left.loglog(at, signal_cps, "o", color="black", label="signal alone, Monte Carlo")
    left.loglog(at, both_cps, "o", color=SOURCES["RTL"]["color"], label="all light, Monte Carlo")
    left.set(
        xlabel="distance in m", ylabel="detected events per pixel in 1/s", title="rates of a pixel"
    )
    left.set_ylim(top=2e15)
    left.legend(ncols=2, fontsize=7.5, loc="upper right")
    for reading, line in zip("AEF", ("-", "--", ":"), strict=True):
        colour = SERIES[2 * "AEF".index(reading)]
        right.semilogx(
            DISTANCE_M,
            budgets["literal", reading].sbr_db,
            line,
            color=colour,
            label=f"reading {reading}",
        )
    right.axhline(0, color=DARK_GREY, linewidth=1)
    right.axvline(4, color=SOURCES["paper"]["color"], linestyle=":", label="paper: 0 dB at 4 m")
    right.set(
        xlabel="distance in m", ylabel="signal to background in dB", title="signal to background"
    )
    right.legend()

    zero = {f"reading {reading}": ("literal", reading) for reading in "AEF"} | {
        "F, corrected": ("corrected", "F")
    }
    return section(
        "fig2",
        "Fig. 2: events per pixel and second, signal to background",
        figure,
        "Events per pixel and second (left) and signal to background (right) against distance",
        rows,
        Comparison(
            "distance of 0 dB", "4 m", {name: f"{zero_m(*key):.3g} m" for name, key in zero.items()}
        ),
    )


def figure_5(run: Processes) -> Section:
    """Show the returning pulse: energy over time for the scene's objects, and its width as seen by
    the TDC.
    """
    dark = Run(*cases(klux=0.0))
    light, labels = dark.light, dark.scene.labels.ravel()
    objects = {int(label): int(np.flatnonzero(labels == label)[0]) for label in np.unique(labels)}
    sigma_s = light.system_fwhm_s[0, 0] * SIGMA_PER_FWHM
    strongest = light.signal_per_pulse.max()
    time_s = np.arange(25e-9, 70e-9, 25e-12)
    rows: list[Row] = [
        ("source", "object", "distance_m", "time_ns", "normalised_energy", "fwhm_ps")
    ]
    figure = new_figure(11, 4.2)
    left, right = figure.subplots(1, 2)
    width_ps: dict[tuple[str, int], float] = {}
    measured: dict[int, str] = {}
    for label, pixel in objects.items():
        distance_m, photons = light.distance_m[pixel, 0], light.signal_per_pulse[pixel, 0]
        flight_s = 2 * distance_m / SPEED_OF_LIGHT_M_S
        energy = photons / strongest * np.exp(-((time_s - flight_s) ** 2) / (2 * sigma_s**2))
        left.semilogy(
            time_s * 1e9,
            np.maximum(energy, 1e-9),
            color=SERIES[label],
            label=f"object {label}, {distance_m:g} m",
        )
        width_ps["literal", label] = light.system_fwhm_s[0, 0] * 1e12
        width_ps["corrected", label] = _first_photon_fwhm_s(photons, sigma_s) * 1e12
        for form in FORMS:
            rows.append((form, label, float(distance_m), "", "", width_ps[form, label]))
        near = energy > 1e-6
        rows += [
            ("literal", label, float(distance_m), float(t * 1e9), float(e), "")
            for t, e in zip(time_s[near], energy[near], strict=True)
        ]
    left.set(
        xlabel="time since the laser trigger in ns",
        ylabel="energy, normalised to the brightest",
        title="returning pulses",
        ylim=(1e-3, 2),
    )
    left.legend()
    for label, fwhm_ps, error_ps, distance_m, offset_ps, share in run.map(
        _pulse_width, (NEAR_OBJECT, FAR_OBJECT)
    ):
        measured[label] = f"{fwhm_ps:.0f} ± {error_ps:.0f} ps"
        rows.append(("Monte Carlo", label, distance_m, "", "", fwhm_ps))
        flight_ns = 2e9 * distance_m / SPEED_OF_LIGHT_M_S
        rows += [
            ("Monte Carlo", label, distance_m, flight_ns + o / 1000, s, "")
            for o, s in zip(offset_ps, share, strict=True)
        ]
        name = f"object {label}, {distance_m:g} m:\n{fwhm_ps:.0f} ps (Monte Carlo)"
        right.plot(offset_ps, share, "o", color=SERIES[label], label=name)
    offset_s = np.linspace(-1e-9, 1e-9, 401)
    shape = np.exp(-(offset_s**2) / (2 * sigma_s**2))
    right.plot(offset_s * 1e12, shape, **SOURCES["literal"], label="pulse and jitter:\n500 ps")
    right.set(
        xlabel="time since the time of flight in ps",
        ylabel="normalised to its maximum",
        title="nearest and farthest object",
    )
    right.set_xlim(-1050, 2100)
    right.legend(loc="center right")
    return section(
        "fig5",
        "Fig. 5: the returning pulse",
        figure,
        "Normalised energy of the returning pulse (left); avalanches of nearest and farthest object (right)",
        rows,
        *(
            Comparison(
                f"pulse FWHM at {distance}",
                PAPER_FWHM_PS,
                {
                    "literal": f"{width_ps['literal', label]:.0f} ps",
                    "corrected": f"{width_ps['corrected', label]:.0f} ps",
                    "Monte Carlo": measured[label],
                },
            )
            for distance, label in (("4.3 m", NEAR_OBJECT), ("9.7 m", FAR_OBJECT))
        ),
    )


def zero_m(form: str, reading: str) -> float:
    """Return the distance at which the ratio is 0 dB, in metres."""
    distance_m = np.geomspace(0.05, 50, 4000)
    sbr_db = link_budget(distance_m, REFLECTIVITY, KLUX, form=form, sbr_reading=reading).sbr_db
    return float(np.interp(0, -sbr_db, distance_m))


def _detected_cps(distance_m: float) -> tuple[float, float, float, float]:
    """Return the distance, and three rates of a pixel after dead time: from the signal alone, from
    the background alone, and from both.
    """
    budget, timing = link_budget(distance_m, REFLECTIVITY, KLUX), Timing()

    def detected_cps(signal: Numbers, background_cps: float) -> float:
        light = Light(
            rows=SIDE,
            cols=SIDE,
            distance_m=distance_m,
            signal_per_pulse=signal,
            background_cps=background_cps,
        )
        edges = generate_edges(light, Spad(), timing, pulses=PULSES, seed=1)
        return len(edges) / (SIDE**2 * PULSES * timing.period_s)

    signal, background_cps = budget.signal_per_pulse, budget.background_rate_cps
    lights = (signal, 0.0), (0.0, background_cps), (signal, background_cps)
    signal_cps, noise_cps, both_cps = (detected_cps(*each) for each in lights)
    return distance_m, signal_cps, noise_cps, both_cps


def _pulse_width(label: int) -> tuple[int, float, float, float, list[float], list[float]]:
    """Return an object, the pulse's FWHM in ps, its standard error, the distance, and a histogram:
    offsets in ps, relative counts.
    """
    run, timing = Run(*cases(pulses=MANY * PULSES, klux=0.0)), Timing()
    pixels = np.flatnonzero(run.scene.labels.ravel() == label)
    distance_m = float(run.scene.truth_m.ravel()[pixels[0]])
    tick = run.edges.tick[np.isin(run.edges.pixel, pixels)]
    offset_s = (tick + 0.5) * timing.tick_s - 2 * distance_m / SPEED_OF_LIGHT_M_S
    offset_s = offset_s[np.abs(offset_s) < 2e-9]
    variance_s2 = offset_s.var() - timing.tick_s**2 / 12  # the TDC's own share
    fwhm_ps = np.sqrt(variance_s2) / SIGMA_PER_FWHM * 1e12
    ticks, counts = np.unique(np.round(offset_s * 1e12, 3), return_counts=True)
    error_ps = fwhm_ps / np.sqrt(2 * len(offset_s))
    return (
        label,
        float(fwhm_ps),
        float(error_ps),
        distance_m,
        ticks.tolist(),
        (counts / counts.max()).tolist(),
    )


def _first_photon_fwhm_s(photons: float, sigma_s: float) -> float:
    """Return the FWHM of the first photon's time, for a Gaussian pulse with a Poisson number of
    photons.
    """
    z = np.linspace(-8, 8, 4001)
    density = np.exp(-(z**2) / 2 - photons * special.ndtr(z))
    mean = np.average(z, weights=density)
    return sigma_s * np.sqrt(np.average((z - mean) ** 2, weights=density)) / SIGMA_PER_FWHM
