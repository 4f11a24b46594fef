# SPDX-License-Identifier: Apache-2.0
"""Draws the comparison with rivals (`comparison.py`): background, bits, range, two targets, a
retroreflector.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from coincid.lab.campaign import Processes, grouped
from coincid.lab.setup import Setup, seeded
from coincid.model.depth.quality import OTHER_SURFACE_M, TOLERANCE_M, wrong_pixels, wrong_share
from coincid.model.light.light import Light, background_cps, signal_per_pulse
from coincid.model.scenes.catalogue import load_scene
from coincid.study.palette import ALARM, AMBER, BLUE, GREEN, GREY, INK, SKY, VIOLET
from coincid.study.plot_style import legend_below, new_figure, share_axis

from ..comparison import PULSES, RETURNS, SCHEMES, THRESHOLD, Found, compared, schemes
from .sections import Row, Section, section
from .setups import SCENE

# Rows and columns; two targets and the sign are the same in every subgroup, so a small array is
# enough.
SIDE, SMALL = 32, 16
KLUX = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
SEEDS, FEW_SEEDS = 3, 2
DISTANCES_M, RANGE_KLUX, RANGE_REFLECTIVITY = (
    (2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0),
    (10.0, 100.0),
    0.4,
)
THRESHOLDS = (2, 3, 4, 5)  # in the plot of bits
OF_RETURNS = ("first return", "better of two returns")
# in the picture of bits
SWEPT = ("sliding window", "this: fixed", "this: fixed planes", "this: fixed compact planes")
BITS_KLUX, SEEDS_OF_PULSES = (10.0, 50.0, 100.0), {PULSES: SEEDS, 10 * PULSES: 1}
NEAR_M, TWO_KLUX = 5.0, 20.0
# Above twice the tolerance, because otherwise a depth between the surfaces would count as right.
STEPS_M = (0.08, 0.10, 0.12, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0)
# Light of the sign relative to a white wall; distance from the sign to the dark target.
GAINS, BEHIND_M = (1.0, 10.0, 100.0, 1000.0), (0.3, 3.0)
# a quarter of each subgroup sees the sign
SIGN_M, DARK, SIGN, STRAY, RETRO_KLUX = 6.0, 0.1, slice(4, 12), 1e-3, 20.0

STYLES = {
    "winner takes all": ("#999999", "-", "o"),
    "winner: planes": ("#999999", "--", "o"),
    "sliding window": ("#1f78b4", "-", "s"),
    "photon counts": ("#6a3d9a", "-", "^"),
    "this: fixed": ("#fb9a99", "-", "P"),
    "this: controller": ("#e31a1c", "-", "X"),
    "this: pooled": ("#fdbf6f", "-", "p"),
    "this: minigroups": ("#ff7f00", "-", ">"),
    "this: fixed planes": ("#fb9a99", "--", "h"),
    "this: controller planes": ("#e31a1c", "--", "*"),
}
SHOWN = tuple(STYLES)  # in all pictures except that of bits
# Lines of the picture of bits: the beginning of their schemes' names; colour, line and marker.
LINES = {
    "zoomed": (VIOLET, "-", "^"),
    "Fourier": (AMBER, "-", "v"),
    "equi-depth": (GREEN, "-", "D"),
    "time stamps": (BLUE, "-", "s"),
    "photon counts": (INK, "", "p"),
    "winner: planes": (GREY, "", "o"),
    "sliding window": (SKY, "--", "s"),
    "this: fixed": ("#fb9a99", "-", "P"),
    "this: fixed planes": ("#fb9a99", "--", "h"),
    "this: fixed compact planes": (ALARM, "--", "h"),
    "this: controller planes": ("#fb9a99", "", "*"),
    "this: controller compact planes": (ALARM, "", "*"),
}


def background(run: Processes) -> Section:
    """Show wrong share and bits against background."""
    scene = load_scene(SCENE, SIDE, SIDE)
    table = _table(run, {klux: compared(scene, klux=klux) for klux in KLUX}, SEEDS)
    rows: list[Row] = [("scheme", "klux", "wrong_share", "standard_error", "bits_per_frame")]
    figure = new_figure(11, 4.8)
    left, right = figure.subplots(1, 2)
    for name in SHOWN:
        wrong = np.array(
            [
                [wrong_share(one[name].depth_m[:, :, 0], scene.truth_m) for one in table[k]]
                for k in KLUX
            ]
        )
        errors, bits = (
            wrong.std(axis=1) / np.sqrt(SEEDS),
            [_bits(table[klux], name) for klux in KLUX],
        )
        rows += [
            (name, *row)
            for row in zip(KLUX, wrong.mean(axis=1).tolist(), errors.tolist(), bits, strict=True)
        ]
        _line(left, name, KLUX, wrong.mean(axis=1))
        _line(right, name, KLUX, np.array(bits) / 1e3)
    share_axis(left, xlabel="background in klux", ylabel="share of wrong pixels", xscale="log")
    right.set(xlabel="background in klux", ylabel="kbit per frame", xscale="log", yscale="log")
    legend_below(figure)
    return section(
        "rivals_background",
        "Five objects against background",
        figure,
        f"Wrong share and bits of the schemes, {PULSES} pulses, threshold {THRESHOLD}, {SEEDS} seeds",
        rows,
    )


def bits(run: Processes) -> Section:
    """Show wrong share against the bits that leave the chip, for few and many pulses."""
    scene = load_scene(SCENE, SIDE, SIDE)
    line_of = {
        name: line
        for line in LINES
        for name in SCHEMES
        if name == line or name.startswith(f"{line}:")
    }

    def table(
        names: Sequence[str], thresholds: Sequence[int]
    ) -> dict[tuple[int, float, int], list[dict[str, Found]]]:
        setups = {
            (pulses, klux, threshold): seeded(
                compared(scene, threshold, {"pulses": pulses}, klux=klux), seeds
            )
            for (pulses, seeds), klux, threshold in product(
                SEEDS_OF_PULSES.items(), BITS_KLUX, thresholds
            )
        }
        return grouped(setups, partial(schemes, names=names), run)

    found = table(tuple(line_of), [THRESHOLD])
    found |= table(SWEPT, [threshold for threshold in THRESHOLDS if threshold != THRESHOLD])
    rows: list[Row] = [
        (
            "scheme",
            "pulses",
            "klux",
            "threshold",
            "wrong_share",
            "off_by_15_cm_share",
            "bits_per_frame",
        )
    ]
    lines: dict[tuple[int, float, str], list[tuple[float, float]]] = {}
    for (pulses, klux, threshold), ones in sorted(found.items()):
        for name in ones[0]:
            wrong, other = (
                float(
                    np.mean(
                        [
                            wrong_share(one[name].depth_m[:, :, 0], scene.truth_m, limit_m)
                            for one in ones
                        ]
                    )
                )
                for limit_m in (TOLERANCE_M, OTHER_SURFACE_M)
            )
            rows.append((name, pulses, klux, threshold, wrong, other, _bits(ones, name)))
            lines.setdefault((pulses, klux, line_of[name]), []).append(
                (_bits(ones, name) / 1e3, wrong)
            )
    figure = new_figure(14, 9)
    axes = figure.subplots(len(SEEDS_OF_PULSES), len(BITS_KLUX), sharey=True, squeeze=False)
    panels = dict(zip(product(SEEDS_OF_PULSES, BITS_KLUX), axes.flat, strict=True))
    for (pulses, klux), axis in panels.items():
        share_axis(axis, xscale="log", title=f"{klux:g} klux, {pulses} pulses")
    for (pulses, klux, line), points in lines.items():
        colour, dashes, marker = LINES[line]
        panels[pulses, klux].plot(
            *np.transpose(points), dashes, marker=marker, color=colour, label=line, clip_on=False
        )
    for axis in axes[-1]:
        axis.set_xlabel("kbit per frame")
    for axis in axes[:, 0]:
        axis.set_ylabel("share of wrong pixels")
    legend_below(figure)
    return section(
        "rivals_bits",
        "Bits against wrong pixels",
        figure,
        "Five objects; along the lines: 16 to 64 bins (zoomed), 8 to 32 codes (Fourier), 8 to 32 bins (equi-depth), "
        f"8 to 128 time stamps, thresholds {THRESHOLDS[-1]} to {THRESHOLDS[0]} (sliding window, this)",
        rows,
    )


def ranging(run: Processes) -> Section:
    """Show detection, bias and precision of a flat target against its distance."""
    setups = {
        (klux, distance_m): compared(
            load_scene(f"flat:{distance_m},{RANGE_REFLECTIVITY}", SIDE, SIDE), klux=klux
        )
        for klux, distance_m in product(RANGE_KLUX, DISTANCES_M)
    }
    table = _table(run, setups, FEW_SEEDS)
    rows: list[Row] = [
        (
            "scheme",
            "klux",
            "distance_m",
            "detected_share",
            "bias_m",
            "precision_m",
            "wrong_share",
            "bits_per_frame",
        )
    ]
    numbers = {}
    for scheme, ((klux, distance_m), ones) in product(SHOWN, table.items()):
        depth_m = np.stack([one[scheme].depth_m[:, :, 0] for one in ones])
        near = ~wrong_pixels(depth_m, np.full_like(depth_m, distance_m), OTHER_SURFACE_M)
        error_m = depth_m[near] - distance_m
        bias_m, precision_m = (
            (float(error_m.mean()), float(error_m.std())) if near.any() else (np.nan, np.nan)
        )
        numbers[scheme, klux, distance_m] = float(near.mean()), bias_m, precision_m
        wrong = wrong_share(depth_m, np.full_like(depth_m, distance_m))
        rows.append(
            (
                scheme,
                klux,
                distance_m,
                *numbers[scheme, klux, distance_m],
                wrong,
                _bits(ones, scheme),
            )
        )
    figure = new_figure(11, 8.6)
    for column, klux in zip(
        figure.subplots(3, len(RANGE_KLUX), sharex=True, sharey="row").T, RANGE_KLUX, strict=True
    ):
        for scheme in SHOWN:
            seen, bias, precision = np.transpose(
                [numbers[scheme, klux, distance_m] for distance_m in DISTANCES_M]
            )
            _line(column[0], scheme, DISTANCES_M, seen)
            shown = seen >= 0.5
            _line(column[1], scheme, np.array(DISTANCES_M)[shown], 100 * bias[shown])
            _line(column[2], scheme, np.array(DISTANCES_M)[shown], 100 * precision[shown])
        column[0].set_title(f"{klux:g} klux")
        column[2].set_xlabel("distance in m")
    labels = f"share within {100 * OTHER_SURFACE_M:g} cm", "bias in cm", "precision (1 sigma) in cm"
    for axis, label in zip(figure.axes[:: len(RANGE_KLUX)], labels, strict=True):
        axis.set_ylabel(label)
    legend_below(figure)
    return section(
        "rivals_range",
        "Detection, bias and precision",
        figure,
        f"A flat target of {RANGE_REFLECTIVITY:.0%}; bias and precision of what is detected, if half is",
        rows,
    )


def two_targets(run: Processes) -> Section:
    """Show two surfaces in every macro-pixel, in stripes of 4 columns."""
    scenes = {
        step_m: load_scene(f"two-targets:{NEAR_M},{NEAR_M + step_m:.4g}", SMALL, SMALL)
        for step_m in STEPS_M
    }
    table = _table(
        run, {step_m: compared(scene, klux=TWO_KLUX) for step_m, scene in scenes.items()}, FEW_SEEDS
    )
    rows: list[Row] = [("scheme", "step_m", "wrong_share", "wrong_in_both_returns_share")]
    figure = new_figure(11, 4.8)
    axes = figure.subplots(1, 2, sharey=True)
    for scheme in SHOWN:
        shares = []
        for step_m, scene in scenes.items():
            depths = [one[scheme].depth_m for one in table[step_m]]
            wrong = [
                [_wrong_any(depth[:, :, :returns], scene.distance_m) for returns in (1, RETURNS)]
                for depth in depths
            ]
            shares.append(np.mean(wrong, axis=0).tolist())
            rows.append((scheme, step_m, *shares[-1]))
        for axis, values in zip(axes, np.transpose(shares), strict=True):
            _line(axis, scheme, 100 * np.array(STEPS_M), values)
    for axis, title in zip(axes, OF_RETURNS, strict=True):
        share_axis(axis, ylabel="share of wrong pixels", xscale="log", title=title)
        axis.set_xlabel(f"step behind the target at {NEAR_M:g} m in cm")
        axis.set_xticks(
            [100 * step_m for step_m in STEPS_M],
            labels=[f"{100 * step_m:.0f}" for step_m in STEPS_M],
        )
        axis.set_xticks([], minor=True)
    legend_below(figure)
    return section(
        "rivals_two_targets",
        "Two targets in a macro-pixel",
        figure,
        f"Stripes of 4 columns at {NEAR_M:g} m and a step behind, {TWO_KLUX:g} klux",
        rows,
    )


def retroreflector(run: Processes) -> Section:
    """Show a dark target around and behind a retroreflective sign, whose light strays onto all
    pixels.
    """
    table = _table(
        run, {key: compared(sign_light(*key)) for key in product(BEHIND_M, GAINS)}, FEW_SEEDS
    )
    dark = np.ones((SMALL, SMALL), bool)
    dark[SIGN, SIGN] = False
    columns = "scheme behind_m gain wrong_share_of_dark wrong_in_both_returns_share wrong_share_of_sign bits_per_frame"
    rows: list[Row] = [columns.split()]
    figure = new_figure(11, 8.2)
    for column, behind_m in zip(
        figure.subplots(RETURNS, len(BEHIND_M), sharex=True, sharey=True).T, BEHIND_M, strict=True
    ):
        for scheme in SHOWN:
            shares = []
            for gain in GAINS:
                ones = [one[scheme] for one in table[behind_m, gain]]
                wrong = np.stack(
                    [~(np.abs(one.depth_m - (SIGN_M + behind_m)) <= TOLERANCE_M) for one in ones]
                )[:, dark]
                shares.append((wrong[:, :, 0].mean(), wrong.all(axis=2).mean()))
                of_sign = np.mean(
                    [~(np.abs(one.depth_m[SIGN, SIGN, 0] - SIGN_M) <= TOLERANCE_M) for one in ones]
                )
                sent = _bits(table[behind_m, gain], scheme)
                rows.append((scheme, behind_m, gain, *map(float, shares[-1]), float(of_sign), sent))
            for axis, values in zip(column, np.transpose(shares), strict=True):
                _line(axis, scheme, GAINS, values)
        for axis, returns in zip(column, OF_RETURNS, strict=True):
            share_axis(axis, ylabel="share of wrong pixels, dark target", xscale="log")
            axis.set_title(f"{behind_m:g} m behind the sign, {returns}")
        column[-1].set_xlabel("light of the sign against a white target's")
    legend_below(figure)
    return section(
        "rivals_retroreflector",
        "Beside a retroreflector",
        figure,
        f"A target of {DARK:.0%} in the subgroups of a sign at {SIGN_M:g} m, {RETRO_KLUX:g} klux; "
        f"{STRAY:g} of the sign's light strays onto every pixel",
        rows,
    )


def sign_light(behind_m: float, gain: float) -> Light:
    """Return the light of a dark wall behind a sign of 8 x 8 pixels, where four subgroups meet.
    gain: of the sign over white.
    """
    sign = np.zeros((SMALL, SMALL), bool)
    sign[SIGN, SIGN] = True
    of_sign = gain * float(signal_per_pulse(SIGN_M, 1.0))
    signal = np.stack(
        [
            np.where(sign, of_sign, STRAY * of_sign),
            np.where(sign, 0, signal_per_pulse(SIGN_M + behind_m, DARK)),
        ],
        axis=2,
    )
    return Light(
        rows=SMALL,
        cols=SMALL,
        distance_m=np.array([[SIGN_M, SIGN_M + behind_m]]),
        signal_per_pulse=signal.reshape(SMALL * SMALL, 2),
        background_cps=background_cps(RETRO_KLUX),
    )


def _table(
    run: Processes, setups: Mapping[Any, Setup], seeds: int
) -> dict[Any, list[dict[str, Found]]]:
    """Return the results of each setup by `SHOWN` schemes, for several seeds."""
    read = partial(schemes, names=SHOWN)
    return grouped({key: seeded(setup, seeds) for key, setup in setups.items()}, read, run)


def _bits(ones: Sequence[dict[str, Found]], scheme: str) -> float:
    return float(np.mean([one[scheme].bits for one in ones]))


def _wrong_any(depth_m: np.ndarray, distance_m: np.ndarray) -> float:
    """Return the share of pixels in which no return (last axis) is within the tolerance of any
    target (last axis).
    """
    apart = np.abs(depth_m[:, :, :, None] - distance_m[:, :, None, :])
    return float(1 - (apart <= TOLERANCE_M).any(axis=(2, 3)).mean())


def _line(axis: Axes, name: str, at: ArrayLike, values: ArrayLike) -> None:
    colour, line, marker = STYLES[name]
    width = 2 if name.startswith("this") else 1.4
    axis.plot(at, values, line, marker=marker, color=colour, label=name, linewidth=width)
