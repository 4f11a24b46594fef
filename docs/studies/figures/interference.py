# SPDX-License-Identifier: Apache-2.0
"""Measures the effect of a second LiDAR in the scene, and the benefit of a laser period that
changes from pulse to pulse.
"""

from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np

from coincid.lab.campaign import Processes, grouped
from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth.quality import wrong_share
from coincid.model.light.light import Interferer
from coincid.model.light.timing import Timing
from coincid.model.scenes.catalogue import load_scene
from coincid.model.scenes.scene import scene_light
from coincid.study.palette import SERIES
from coincid.study.plot_style import legend_below, new_figure, share_axis

from ..comparison import PULSES, compared, schemes
from .rivals import STYLES
from .sections import Row, Section, section
from .setups import SCENE

SIDE, KLUX, SEEDS = 32, 20.0, 3
SHOWN = (
    "winner: planes",
    "this: fixed",
    "this: controller",
    "this: fixed planes",
    "this: controller planes",
)
# Of the other LiDAR, per pixel and pulse; our own laser gives 0.23 from a white wall at 10 m.
PHOTONS = (0.0, 0.02, 0.05, 0.2, 0.5, 1.0)
OFFSETS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)  # relative, of the other LiDAR's laser period
DITHER_BITS = (0, 1, 2, 3, 4, 6)
PHOTONS_SHOWN, OFFSET_SHOWN, BITS_SHOWN = 0.2, 0.0, (0, 2, 4)
# phase of the other LiDAR by seed: before, among and behind the objects
PHASE_SHARE = (0.07, 0.11, 0.6)
Key: TypeAlias = tuple[float, float, int]  # photons, offset, bits


class Result(NamedTuple):
    wrong: dict[str, float]
    ghosts: dict[str, float]  # share of pixels at the most frequent depth without an object
    bits: dict[str, int]


def setup(photons: float, offset: float, bits: int, seed: int) -> Setup:
    """Return the setup of five objects with another LiDAR, whose light reaches all pixels at the
    same time.
    """
    scene, period_s = load_scene(SCENE, SIDE, SIDE), Timing().period_s
    other = Interferer(
        photons_per_pulse=photons,
        period_s=period_s * (1 + offset),
        phase_s=PHASE_SHARE[seed - 1] * period_s,
    )
    light = scene_light(scene, KLUX, interferer=other if photons else None)
    return compared(scene, light=light, seed=seed, frame={"dither_bits": bits})


def look(run: Run) -> Result:
    """Return the result of the schemes `SHOWN` on the same photons."""
    found, truth_m = schemes(run, SHOWN), run.scene.truth_m
    depths = {name: one.depth_m[:, :, 0] for name, one in found.items()}
    return Result(
        {name: wrong_share(depth, truth_m) for name, depth in depths.items()},
        {name: _same_and_wrong(depth, truth_m) for name, depth in depths.items()},
        {name: one.bits for name, one in found.items()},
    )


def _same_and_wrong(depth_m: np.ndarray, truth_m: np.ndarray) -> float:
    """Return the size of the largest ghost: pixels that are wrong by over half a metre and agree
    within 30 cm.
    """
    wrong = depth_m[np.abs(depth_m - truth_m) > 0.5]
    return (
        float(np.bincount((wrong / 0.3).astype(np.int64), minlength=1).max() / truth_m.size)
        if wrong.size
        else 0.0
    )


def interference(run: Processes) -> Section:
    """Show the wrong share against the other LiDAR's light, its period, and the dither."""
    keys = {
        "photons per pixel and pulse of the other LiDAR": [
            *product(PHOTONS, [OFFSET_SHOWN], BITS_SHOWN)
        ],
        "its laser period longer by": [*product([PHOTONS_SHOWN], OFFSETS, BITS_SHOWN)],
        "longest wait in cycles": [*product([PHOTONS_SHOWN], [OFFSET_SHOWN], DITHER_BITS)],
    }
    wanted = list(dict.fromkeys(key for part in keys.values() for key in part))
    table = grouped(
        {key: [setup(*key, seed + 1) for seed in range(SEEDS)] for key in wanted}, look, run
    )
    columns = "scheme photons_per_pulse period_offset dither_bits frame_us wrong_share ghost_share bits_per_frame"
    rows: list[Row] = [columns.split()]
    for key, results in table.items():
        frame_us = Timing(dither_bits=key[2]).start_cycles(PULSES)[-1] / Timing().clock_hz * 1e6
        for name in SHOWN:
            means = (
                float(np.mean([part[name] for part in parts]))
                for parts in zip(*results, strict=True)
            )
            rows.append((name, *key, float(frame_us), *means))
    figure = new_figure(15, 5)
    left, middle, right = figure.subplots(1, 3, sharey=True)
    far_apart = (SERIES[0], SERIES[3], SERIES[5])
    colours = dict(zip(BITS_SHOWN, far_apart[: len(BITS_SHOWN)], strict=True))
    *of_the_other, of_the_dither = keys.items()
    for axis, at, (label, part) in zip((left, middle), (0, 1), of_the_other, strict=True):
        for bits in BITS_SHOWN:
            chosen = [key for key in part if key[2] == bits]
            for name, line in (("this: fixed planes", "-o"), ("this: fixed", "--o")):
                wait = f"wait of 0 to {(1 << bits) - 1} cycles" if bits else "no wait"
                shares, label_of = _shares(table, chosen, name), f"{wait}, {name}"
                axis.plot(
                    [key[at] for key in chosen], shares, line, color=colours[bits], label=label_of
                )
        share_axis(axis, xlabel=label)
        axis.set_xscale("symlog", linthresh=part[len(BITS_SHOWN)][at], linscale=0.3)
        axis.set_xlim(left=0)
    label, chosen = of_the_dither
    for name in SHOWN:
        colour, line, marker = STYLES[name]
        waits = [(1 << key[2]) - 1 for key in chosen]
        right.plot(
            waits, _shares(table, chosen, name), line, marker=marker, color=colour, label=name
        )
    share_axis(right, xlabel=label, title=f"{PHOTONS_SHOWN:g} photons, same period")
    right.set_xscale("symlog", linthresh=1)
    right.set_xlim(left=0)
    left.set(ylabel="share of wrong pixels", title="same period")
    middle.set_title(f"{PHOTONS_SHOWN:g} photons")
    legend_below(figure, 4)
    return section(
        "interference",
        "A second LiDAR, with and without dither of the laser period",
        figure,
        f"Five objects at {KLUX:g} klux, {PULSES} pulses, {SEEDS} phases of the other LiDAR",
        rows,
    )


def _shares(table: dict[Key, list[Result]], keys: list[Key], name: str) -> list[float]:
    return [float(np.mean([one.wrong[name] for one in table[key]])) for key in keys]
