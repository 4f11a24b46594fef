# SPDX-License-Identifier: Apache-2.0
"""The sensor and its rivals (`comparison.py`): background, range, two targets, a retroreflector, bits."""

from collections.abc import Hashable
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from ...model.depth.quality import TOLERANCE_M, wrong_share
from ...model.light.light import Light, background_cps, signal_per_pulse
from ...model.scenes.catalogue import load_scene
from ...model.scenes.scene import scene_light
from ..comparison import PULSES, RETURNS, SCHEMES, THRESHOLD, Found, shoot
from ..plot_style import legend_below, new_figure, share_axis
from .cases import Runner
from .page import Row, Section

SIDE, SMALL = 32, 16  # pixels; small arrays for two targets and the sign, which are the same in every subgroup
KLUX = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
SEEDS, FEW_SEEDS = 3, 2
BUILT_IN = ("five-objects", "letter-f", "flat:10,0.4", "two-targets:5,9", "two-returns:5,9")
BUILT_IN_KLUX = 50.0
DISTANCES_M, RANGE_KLUX, RANGE_REFLECTIVITY = (2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0), (10.0, 100.0), 0.4
DETECTED_M = 0.15  # from the truth: within one window
THRESHOLDS = (2, 3, 4, 5)  # in the plot of bits
WITH_THRESHOLD = ("sliding window", "fixed windows", "this: fixed")
NEAR_M, TWO_KLUX = 5.0, 20.0
STEPS_M = (
    0.08,
    0.10,
    0.12,
    0.15,
    0.2,
    0.3,
    0.4,
    0.6,
    1.0,
)  # above twice the tolerance, because otherwise a depth between both is right
GAINS, BEHIND_M = (1.0, 10.0, 100.0, 1000.0), (0.3, 3.0)  # of the sign against white; dark target's distance behind it
SIGN_M, DARK, SIGN, STRAY, RETRO_KLUX = 6.0, 0.1, slice(4, 12), 1e-3, 20.0  # a quarter of each subgroup sees the sign

STYLES = {
    "winner takes all": ("#999999", "-", "o"),
    "winner: planes": ("#999999", "--", "o"),
    "sliding window": ("#1f78b4", "-", "s"),
    "fixed windows": ("#a6cee3", "-", "D"),
    "last hit": ("#b2df8a", "-", "v"),
    "photon counts": ("#6a3d9a", "-", "^"),
    "count-weighted": ("#cab2d6", "-", "<"),
    "this: fixed": ("#fb9a99", "-", "P"),
    "this: controller": ("#e31a1c", "-", "X"),
    "this: pooled": ("#fdbf6f", "-", "p"),
    "this: minigroups": ("#ff7f00", "-", ">"),
    "this: fixed planes": ("#fb9a99", "--", "h"),
    "this: controller planes": ("#e31a1c", "--", "*"),
}
_Key = TypeVar("_Key", bound=Hashable)
Task = tuple[Light, int, int, tuple[str, ...]]  # seed, threshold, schemes


def found(task: Task) -> dict[str, Found]:
    """Return the result of each scheme on the same photons."""
    light, seed, threshold, names = task
    shot = shoot(light, seed, threshold=threshold)
    return {name: SCHEMES[name](shot) for name in names}


def background(run: Runner) -> Section:
    """Show wrong share and bits against background, and wrong share against bits for several thresholds."""
    scene = load_scene("five-objects", SIDE, SIDE)
    table = _table(run, {klux: scene_light(scene, klux) for klux in KLUX}, SEEDS)
    shares, bits = {}, {}
    for name in SCHEMES:
        for klux, ones in table.items():
            shares[name, klux] = [wrong_share(one[name].depth_m[:, :, 0], scene.truth_m) for one in ones]
            bits[name, klux] = np.mean([one[name].bits for one in ones])
    other = [(klux, threshold) for klux in (10.0, BUILT_IN_KLUX) for threshold in THRESHOLDS]
    swept = run.map(found, [(scene_light(scene, klux), 1, threshold, WITH_THRESHOLD) for klux, threshold in other])
    rows: list[Row] = [("scheme", "klux", "threshold", "wrong_share", "standard_error", "bits_per_frame")]
    rows += [
        (name, klux, THRESHOLD, float(np.mean(shares[name, klux])), _error(shares[name, klux]), float(bits[name, klux]))
        for name in SCHEMES
        for klux in KLUX
    ]
    points: dict[tuple[str, float], list[tuple[float, float]]] = {}
    for (klux, threshold), one in zip(other, swept):
        for name in WITH_THRESHOLD:
            share = wrong_share(one[name].depth_m[:, :, 0], scene.truth_m)
            points.setdefault((name, klux), []).append((one[name].bits, share))
            rows.append((name, klux, threshold, share, "", float(one[name].bits)))
    figure = new_figure(14, 4.8)
    left, middle, right = figure.subplots(1, 3)
    for name in SCHEMES:
        _line(left, name, KLUX, [np.mean(shares[name, klux]) for klux in KLUX])
        _line(middle, name, KLUX, [bits[name, klux] / 1e3 for klux in KLUX])
        _line(right, name, [bits[name, BUILT_IN_KLUX] / 1e3], [np.mean(shares[name, BUILT_IN_KLUX])])
        if (name, BUILT_IN_KLUX) in points:
            sent, share = np.transpose(points[name, BUILT_IN_KLUX])
            right.plot(sent / 1e3, share, color=STYLES[name][0], linewidth=1)
    share_axis(left, xlabel="background in klux", ylabel="share of wrong pixels", xscale="log")
    middle.set(xlabel="background in klux", ylabel="kbit a frame", xscale="log", yscale="log")
    share_axis(right, xlabel="kbit a frame", ylabel="share of wrong pixels", xscale="log")
    right.set_title(f"{BUILT_IN_KLUX:g} klux; lines: thresholds {THRESHOLDS[0]} to {THRESHOLDS[-1]}")
    legend_below(figure)
    return Section(
        "rivals_background",
        "Five objects against background",
        "",
        [
            (
                "rivals_background",
                figure,
                f"Wrong share and bits of the schemes, {PULSES} pulses, threshold {THRESHOLD}, {SEEDS} seeds",
            )
        ],
        rows,
    )


def built_in(run: Runner) -> Section:
    """Show the wrong share of every built-in scene."""
    scenes = {name: load_scene(name, SIDE, SIDE) for name in BUILT_IN}
    table = _table(run, {name: scene_light(scene, BUILT_IN_KLUX) for name, scene in scenes.items()}, FEW_SEEDS)
    rows: list[Row] = [("scene", "scheme", "wrong_share", "second_surface_share", "bits_per_frame")]
    figure = new_figure(12, 4.6)
    axis = figure.subplots()
    for k, scheme in enumerate(SCHEMES):
        shares = []
        for name, scene in scenes.items():
            depths = [one[scheme].depth_m for one in table[name]]
            shares.append(np.mean([_wrong_any(depth[:, :, :1], scene.distance_m) for depth in depths]))
            second = (
                np.mean([_both(depth, scene.distance_m) for depth in depths]) if scene.distance_m.shape[2] > 1 else ""
            )
            rows.append(
                (name, scheme, float(shares[-1]), second, float(np.mean([one[scheme].bits for one in table[name]])))
            )
        axis.bar(
            np.arange(len(BUILT_IN)) + (k - len(SCHEMES) / 2 + 0.5) / 15,
            shares,
            1 / 15,
            color=STYLES[scheme][0],
            label=scheme,
            hatch="//" if STYLES[scheme][1] == "--" else None,
            edgecolor="white",
            linewidth=0,
        )
    axis.set_xticks(range(len(BUILT_IN)), labels=BUILT_IN)
    axis.set(ylabel="share of wrong pixels", title=f"{BUILT_IN_KLUX:g} klux", ylim=(0, 1))
    legend_below(figure)
    return Section(
        "rivals_scenes",
        "The built-in scenes",
        "",
        [
            (
                "rivals_scenes",
                figure,
                f"Wrong share of the built-in scenes at {BUILT_IN_KLUX:g} klux; any surface of a pixel is right",
            )
        ],
        rows,
    )


def ranging(run: Runner) -> Section:
    """Show detection, bias and precision of a flat target against its distance."""
    keys = [(klux, distance_m) for klux in RANGE_KLUX for distance_m in DISTANCES_M]
    scenes = {
        distance_m: load_scene(f"flat:{distance_m},{RANGE_REFLECTIVITY}", SIDE, SIDE) for distance_m in DISTANCES_M
    }
    table = _table(
        run, {(klux, distance_m): scene_light(scenes[distance_m], klux) for klux, distance_m in keys}, FEW_SEEDS
    )
    rows: list[Row] = [
        ("scheme", "klux", "distance_m", "detected_share", "bias_m", "precision_m", "wrong_share", "bits_per_frame")
    ]
    numbers = {}
    for scheme in SCHEMES:
        for klux, distance_m in keys:
            depth_m = np.stack([one[scheme].depth_m[:, :, 0] for one in table[klux, distance_m]])
            error_m = depth_m - distance_m
            near = np.abs(error_m) <= DETECTED_M
            bias_m, precision_m = (
                (float(error_m[near].mean()), float(error_m[near].std())) if near.any() else (np.nan, np.nan)
            )
            numbers[scheme, klux, distance_m] = float(near.mean()), bias_m, precision_m
            rows.append(
                (
                    scheme,
                    klux,
                    distance_m,
                    *numbers[scheme, klux, distance_m],
                    float((~(np.abs(error_m) <= TOLERANCE_M)).mean()),
                    float(np.mean([one[scheme].bits for one in table[klux, distance_m]])),
                )
            )
    figure = new_figure(11, 8.6)
    for column, klux in zip(figure.subplots(3, len(RANGE_KLUX), sharex=True, sharey="row").T, RANGE_KLUX):
        for scheme in SCHEMES:
            seen, bias, precision = np.transpose([numbers[scheme, klux, distance_m] for distance_m in DISTANCES_M])
            _line(column[0], scheme, DISTANCES_M, seen)
            shown = seen >= 0.5
            _line(column[1], scheme, np.array(DISTANCES_M)[shown], 100 * bias[shown])
            _line(column[2], scheme, np.array(DISTANCES_M)[shown], 100 * precision[shown])
        column[0].set_title(f"{klux:g} klux")
        column[2].set_xlabel("distance in m")
    labels = f"share within {100 * DETECTED_M:g} cm", "bias in cm", "precision (1 sigma) in cm"
    for axis, label in zip(figure.axes[:: len(RANGE_KLUX)], labels):
        axis.set_ylabel(label)
    legend_below(figure)
    return Section(
        "rivals_range",
        "Detection, bias and precision",
        "",
        [
            (
                "rivals_range",
                figure,
                f"A flat target of {RANGE_REFLECTIVITY:.0%}; bias and precision of what is detected, if half is",
            )
        ],
        rows,
    )


def two_targets(run: Runner) -> Section:
    """Show two surfaces in every macro-pixel, in stripes of 4 columns."""
    scenes = {step_m: load_scene(f"two-targets:{NEAR_M},{NEAR_M + step_m:.4g}", SMALL, SMALL) for step_m in STEPS_M}
    table = _table(run, {step_m: scene_light(scene, TWO_KLUX) for step_m, scene in scenes.items()}, FEW_SEEDS)
    rows: list[Row] = [("scheme", "step_m", "wrong_share", "wrong_in_both_returns_share")]
    figure = new_figure(11, 4.8)
    axes = figure.subplots(1, 2, sharey=True)
    for scheme in SCHEMES:
        shares = []
        for step_m, scene in scenes.items():
            depths = [one[scheme].depth_m for one in table[step_m]]
            shares.append(
                [
                    np.mean([_wrong_any(depth[:, :, :returns], scene.distance_m) for depth in depths])
                    for returns in (1, RETURNS)
                ]
            )
            rows.append((scheme, step_m, *map(float, shares[-1])))
        for axis, values in zip(axes, np.transpose(shares)):
            _line(axis, scheme, 100 * np.array(STEPS_M), values)
    for axis, title in zip(axes, ("first return", "better of two returns")):
        share_axis(
            axis, xlabel=f"step behind the target at {NEAR_M:g} m in cm", ylabel="share of wrong pixels", xscale="log"
        )
        axis.set_title(title)
        axis.set_xticks([100 * step_m for step_m in STEPS_M], labels=[f"{100 * step_m:.0f}" for step_m in STEPS_M])
        axis.set_xticks([], minor=True)
    legend_below(figure)
    return Section(
        "rivals_two_targets",
        "Two targets in a macro-pixel",
        "",
        [("rivals_two_targets", figure, f"Stripes of 4 columns at {NEAR_M:g} m and a step behind, {TWO_KLUX:g} klux")],
        rows,
    )


def retroreflector(run: Runner) -> Section:
    """Show a dark target around and behind a retroreflective sign, whose light strays onto all pixels."""
    keys = [(behind_m, gain) for behind_m in BEHIND_M for gain in GAINS]
    table = _table(run, {key: sign_light(*key) for key in keys}, FEW_SEEDS)
    dark = np.ones((SMALL, SMALL), bool)
    dark[SIGN, SIGN] = False
    rows: list[Row] = [
        (
            "scheme",
            "behind_m",
            "gain",
            "wrong_share_of_dark",
            "wrong_in_both_returns_share",
            "wrong_share_of_sign",
            "bits_per_frame",
        )
    ]
    figure = new_figure(11, 8.2)
    for column, behind_m in zip(figure.subplots(RETURNS, len(BEHIND_M), sharex=True, sharey=True).T, BEHIND_M):
        for scheme in SCHEMES:
            shares = []
            for gain in GAINS:
                ones = [one[scheme] for one in table[behind_m, gain]]
                wrong = np.stack([~(np.abs(one.depth_m - (SIGN_M + behind_m)) <= TOLERANCE_M) for one in ones])[:, dark]
                shares.append((wrong[:, :, 0].mean(), wrong.all(axis=2).mean()))
                of_sign = np.mean([~(np.abs(one.depth_m[SIGN, SIGN, 0] - SIGN_M) <= TOLERANCE_M) for one in ones])
                rows.append(
                    (
                        scheme,
                        behind_m,
                        gain,
                        *map(float, shares[-1]),
                        float(of_sign),
                        float(np.mean([one.bits for one in ones])),
                    )
                )
            for axis, values in zip(column, np.transpose(shares)):
                _line(axis, scheme, GAINS, values)
        for axis, returns in zip(column, ("first return", "better of two returns")):
            share_axis(
                axis,
                ylabel="share of wrong pixels, dark target",
                xscale="log",
                title=f"{behind_m:g} m behind the sign, {returns}",
            )
        column[-1].set_xlabel("light of the sign against a white target's")
    legend_below(figure)
    return Section(
        "rivals_retroreflector",
        "Beside a retroreflector",
        "",
        [
            (
                "rivals_retroreflector",
                figure,
                f"A target of {DARK:.0%} in the subgroups of a sign at {SIGN_M:g} m, {RETRO_KLUX:g} klux; "
                f"{STRAY:g} of the sign's light strays onto every pixel",
            )
        ],
        rows,
    )


def sign_light(behind_m: float, gain: float) -> Light:
    """Return a dark wall `behind_m` behind a sign of 8 x 8 pixels at a corner of four subgroups; gain: over a white target."""
    sign = np.zeros((SMALL, SMALL), bool)
    sign[SIGN, SIGN] = True
    of_sign = gain * float(signal_per_pulse(SIGN_M, 1.0))
    signal = np.stack(
        [np.where(sign, of_sign, STRAY * of_sign), np.where(sign, 0, signal_per_pulse(SIGN_M + behind_m, DARK))], axis=2
    )
    return Light(
        rows=SMALL,
        cols=SMALL,
        distance_m=np.array([[SIGN_M, SIGN_M + behind_m]]),
        signal_per_pulse=signal.reshape(SMALL * SMALL, 2),
        background_cps=background_cps(RETRO_KLUX),
    )


def _table(run: Runner, lights: dict[_Key, Light], seeds: int) -> dict[_Key, list[dict[str, Found]]]:
    """Return the schemes' results for each light, for several seeds."""
    tasks = [(light, seed + 1, THRESHOLD, tuple(SCHEMES)) for light in lights.values() for seed in range(seeds)]
    made = iter(run.map(found, tasks))
    return {key: [next(made) for _ in range(seeds)] for key in lights}


def _wrong_any(depth_m: np.ndarray, distance_m: np.ndarray) -> float:
    """Return the share of pixels in which no return (last axis) is within the tolerance of any target (last axis)."""
    apart = np.abs(depth_m[:, :, :, None] - distance_m[:, :, None, :])
    return float(1 - (apart <= TOLERANCE_M).any(axis=(2, 3)).mean())


def _both(depth_m: np.ndarray, distance_m: np.ndarray) -> float:
    """Return the share of pixels in which every target is among the returns."""
    return float(
        (np.abs(depth_m[:, :, :, None] - distance_m[:, :, None, :]) <= TOLERANCE_M).any(axis=2).all(axis=2).mean()
    )


def _error(values: list[float]) -> float:
    return float(np.std(values) / np.sqrt(len(values)))


def _line(axis: Axes, name: str, at: ArrayLike, values: ArrayLike) -> None:
    colour, line, marker = STYLES[name]
    axis.plot(
        at, values, line, marker=marker, color=colour, label=name, linewidth=2 if name.startswith("this") else 1.4
    )
