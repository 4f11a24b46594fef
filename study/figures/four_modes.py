# SPDX-License-Identifier: Apache-2.0
"""The paper's four modes, coincidence x gating, with both kinds of gate; targets that need a gate; progressive gating to 100 m.

Ref: paper III-A ("four different modes of operation with coincidence and gating", "time-gating ... around the desired
target range"). Targets are flat and fill the picture. The criteria, and all numbers that the paper does not give, are our
choice.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from attrs import frozen
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from ...model.contract.config import Config, parse_config
from ...model.contract.edges import Edges
from ...model.contract.result import differences
from ...model.depth.estimate import estimate_depth
from ...model.depth.quality import OTHER_SURFACE_M, range_error, wrong_pixels
from ...model.golden.frame import golden_result
from ...model.light.light import Light, background_cps, signal_per_pulse
from ...model.light.photons import generate_edges
from ...model.light.spad import Spad, SpadGate
from ...model.light.timing import Timing
from ...model.shared.constants import SPEED_OF_LIGHT_M_S
from ..plot_style import SERIES, legend_below, new_figure
from .cases import PULSES, Engine, Runner
from .page import Comparison, Row, Section

SENSOR = {"rows": 16, "cols": 16}  # four subgroups, which is a quarter of the paper's array ...
LINK_GBPS = 2.0  # ... and a quarter of the link of `make sim`
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
    "neither": ("#999999", ":"),
    "coincidence": ("#222222", "-"),
    "logic gate": (SERIES[2], ":"),
    "SPAD gate": (SERIES[4], ":"),
    "coincidence, logic gate": (SERIES[2], "-"),
    "coincidence, SPAD gate": (SERIES[4], "-"),
}
METHODS = {"maximum": "the paper's peaks", "planes": "planes"}
HALF_GATE_M = 3.0  # around the target

DISTANCES_M, REFLECTIVITY = (3.0, 5.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0), 0.4
KLUX, SEEDS = (1.0, 10.0, 50.0, 100.0), 2

PANE_M, PANE_PHOTONS = 4.0, (0.0, 0.1, 0.3, 1.0, 3.0, 10.0)  # per pulse and pixel
BEHIND_M, BEHIND_GATE_M, PANE_KLUX = 4.9, 0.6, 10.0  # closer to the pane than the SPAD's dead time of 8 ns: 1.2 m

FAR_M, FAR_KLUX, FAR_REFLECTIVITIES = 100.0, 10.0, (0.1, 0.4)
POWERS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # times the preset's laser: 5 nJ per pulse for 32 x 32 pixels
PULSE_NJ = 5.0  # 10 mW at 2 MHz (paper II)
FAR_PULSES = (1000, 5000)
FAR_THRESHOLDS = (0, 1, 2, 3)  # 0: coincidence off
FAR_FRAME = {"period": 360}  # 108 m
SCAN = {"start_m": 3.0, "gate_len": 40, "gate_step": 34, "gate_steps": 10}  # cycles: 12 m that move by 10.2 m
SCHEDULES = {
    "none": "no gate",
    "scan": "progressive SPAD gate, 3 to 108 m",
    "known": "SPAD gate of 10 m around the target",
}
SPOT_CHECKS = 5  # frames of each section, through the RTL
FOUND_SHARE = 0.9  # of the pixels, within 15 cm


@frozen(kw_only=True)
class Shot:
    """One frame of flat targets. distance_m, signal, ambient: of each target: mean photons per pulse, and reflectivity.

    sensor: as in a configuration file. spad_gate: the gate switches the SPADs off.
    """

    distance_m: tuple[float, ...]
    signal: tuple[float, ...]
    ambient: float
    klux: float
    truth_m: float
    frame: tuple[tuple[str, Any], ...]
    subgroup: tuple[tuple[str, Any], ...]
    spad_gate: bool
    seed: int = 1

    def config(self) -> Config:
        """The configuration."""
        frame = {"pulses": PULSES, "link_gbps": LINK_GBPS} | dict(self.frame)
        return parse_config({"sensor": SENSOR, "frame": frame, "subgroup": dict(self.subgroup)})

    def edges(self, config: Config) -> Edges:
        """Return the frame's photons as edges."""
        light = Light(
            rows=SENSOR["rows"],
            cols=SENSOR["cols"],
            distance_m=np.array([self.distance_m]),
            signal_per_pulse=np.array([self.signal]),
            background_cps=background_cps(self.klux, self.ambient),
        )
        gate = SpadGate.from_config(config) if self.spad_gate else None
        return generate_edges(
            light, Spad(), Timing.from_config(config), pulses=config.pulses, seed=self.seed, gate=gate
        )


@frozen(kw_only=True)
class Seen:
    """Results by method: share of pixels right within 3.45 cm (the paper's) and 15 cm, RMS error of the latter; events, drops."""

    right: dict[str, float]
    found: dict[str, float]
    rms_m: dict[str, float]
    events: int
    dropped: int


def look(shot: Shot) -> Seen:
    """Run photons, golden model and depth of a shot."""
    config = shot.config()
    arrays = golden_result(config, shot.edges(config))
    truth_m = np.full((SENSOR["rows"], SENSOR["cols"]), shot.truth_m)
    right, found, rms_m = {}, {}, {}
    for method in METHODS:
        depth_m = estimate_depth(arrays, config, method=method, workers=1).depth_m[:, :, 0]
        near = ~wrong_pixels(depth_m, truth_m, OTHER_SURFACE_M)
        right[method], found[method] = float(np.mean(~wrong_pixels(depth_m, truth_m))), float(near.mean())
        rms_m[method] = range_error(depth_m[near], truth_m[near])[1]
    return Seen(
        right=right, found=found, rms_m=rms_m, events=int(arrays["stored"].sum()), dropped=int(arrays["dropped"].sum())
    )


def same_on_rtl(shot: Shot, replay: Engine) -> bool:
    """Return whether the RTL gives the golden model's arrays."""
    config = shot.config()
    edges = shot.edges(config)
    return not differences(golden_result(config, edges), replay(config, edges))


def background(run: Runner, replay: Engine | None = None) -> Section:
    """Run all modes over distance, from 1 to 100 klux."""
    table = {
        (mode, klux, distance_m): [
            _flat(mode, klux, distance_m, HALF_GATE_M, seed=seed) for seed in range(1, SEEDS + 1)
        ]
        for mode in MODES
        for klux in KLUX
        for distance_m in DISTANCES_M
    }
    seen = _looked(run, table)
    rows: list[Row] = [("mode", "klux", "distance_m", *_names())]
    rows += [(*key, *_numbers(many)) for key, many in seen.items()]
    figure = new_figure(13, 6)
    axes = figure.subplots(len(METHODS), len(KLUX), sharex=True, sharey=True)
    for line, method in zip(axes, METHODS):
        for axis, klux in zip(line, KLUX):
            for mode, (colour, dashes) in MODE_STYLE.items():
                values = [_mean(seen[mode, klux, distance_m], "right", method) for distance_m in DISTANCES_M]
                axis.plot(DISTANCES_M, values, dashes, color=colour, label=mode)
            _share(axis)
            if method == "maximum":
                axis.set_title(f"{klux:g} klux")
            else:
                axis.set_xlabel("distance in m")
        line[0].set_ylabel(f"right pixels, {METHODS[method]}")
    legend_below(figure)
    reach = {
        mode: ", ".join(
            f"{klux:g} klux: {_reach([_mean(seen[mode, klux, d], 'right', 'maximum') for d in DISTANCES_M])}"
            for klux in KLUX
        )
        for mode in MODES
    }
    return Section(
        "modes",
        "Four modes, two kinds of gate",
        f"""<p>A flat target of {REFLECTIVITY:.0%} that fills the picture, {PULSES} laser pulses, threshold {THRESHOLD} with coincidence, and a
gate of {2 * HALF_GATE_M:g} m around the target with gating. A logic gate ignores edges outside; a SPAD gate keeps the SPADs off, so
that none is dead when the gate opens. {_checks(replay, list(table.values()))}</p>""",
        [
            (
                "modes",
                figure,
                "Share of right pixels against distance, background from left to right, estimator from top to bottom",
            )
        ],
        rows,
        [Comparison("farthest distance with 90 % right pixels, the paper's peaks", "-", reach, "")],
    )


def glass(run: Runner, replay: Engine | None = None) -> Section:
    """Run a target behind a pane of glass that reflects light."""
    table = {
        (mode, photons): [
            _flat(mode, PANE_KLUX, BEHIND_M, BEHIND_GATE_M, pane_photons=photons, seed=seed)
            for seed in range(1, SEEDS + 1)
        ]
        for mode in MODES
        for photons in PANE_PHOTONS
    }
    seen = _looked(run, table)
    rows: list[Row] = [("mode", "pane_photons", *_names())]
    rows += [(*key, *_numbers(many)) for key, many in seen.items()]
    figure = new_figure(10, 4)
    at = [max(photons, PANE_PHOTONS[1] / 3) for photons in PANE_PHOTONS]
    for axis, method in zip(figure.subplots(1, len(METHODS), sharey=True), METHODS):
        for mode, (colour, dashes) in MODE_STYLE.items():
            axis.plot(
                at,
                [_mean(seen[mode, photons], "found", method) for photons in PANE_PHOTONS],
                dashes,
                color=colour,
                label=mode,
            )
        _share(axis)
        axis.set_xscale("log")
        axis.set_xticks(at, [f"{photons:g}" for photons in PANE_PHOTONS])
        axis.minorticks_off()
        axis.set(xlabel="photons of the pane per pulse and pixel", title=METHODS[method])
    figure.axes[0].set_ylabel("pixels that see the target (15 cm)")
    legend_below(figure)
    return Section(
        "modes_glass",
        "Behind a pane",
        f"""<p>A target of {REFLECTIVITY:.0%} at {BEHIND_M:g} m, {BEHIND_M - PANE_M:.1f} m behind a pane, at {PANE_KLUX:g} klux; the gate extends
{BEHIND_GATE_M:g} m to both sides of the target. A SPAD that fired at the pane is dead for 8 ns, 1.2 m: it does not see the target, and a
logic gate does not help. Only a gate that keeps the SPADs off at the pane helps. {_checks(replay, list(table.values()))}</p>""",
        [("modes_glass", figure, "Pixels that see the target against the pane's light")],
        rows,
    )


def far(run: Runner, replay: Engine | None = None) -> Section:
    """Find the laser pulse needed to see 100 m at 10 klux, by gate schedule."""
    table = {
        (reflectivity, schedule, pulses, threshold, power): [
            _far(reflectivity, schedule, pulses, threshold, power, seed) for seed in range(1, SEEDS + 1)
        ]
        for reflectivity in FAR_REFLECTIVITIES
        for schedule in SCHEDULES
        for pulses in FAR_PULSES
        for threshold in FAR_THRESHOLDS
        for power in POWERS
    }
    seen = _looked(run, table)
    rows: list[Row] = [("reflectivity", "schedule", "pulses", "threshold", "laser", *_names())]
    rows += [(*key, *_numbers(many)) for key, many in seen.items()]
    figure = new_figure(10, 6.4)
    axes = figure.subplots(len(FAR_REFLECTIVITIES), len(FAR_PULSES), sharex=True, sharey=True)
    needs: dict[str, dict[str, str]] = {}
    for line, reflectivity in zip(axes, FAR_REFLECTIVITIES):
        for axis, pulses in zip(line, FAR_PULSES):
            for (schedule, name), colour in zip(SCHEDULES.items(), ("#999999", SERIES[2], SERIES[4])):
                best = [_best(seen, reflectivity, schedule, pulses, power) for power in POWERS]
                axis.plot(
                    [PULSE_NJ * power for power in POWERS], [share for share, _ in best], "-o", color=colour, label=name
                )
                needs.setdefault(f"{reflectivity:.0%}, {pulses} pulses", {})[name] = _need(
                    seen, reflectivity, schedule, pulses, best
                )
            _share(axis)
            axis.set_xscale("log")
            axis.set_title(f"{reflectivity:.0%}, {pulses} pulses")
    for axis in axes[-1]:
        axis.set_xlabel("laser pulse in nJ for 32 x 32 pixels")
    for line in axes:
        line[0].set_ylabel("pixels that see the target (15 cm)")
    legend_below(figure)
    return Section(
        "modes_far",
        "100 m at 10 klux",
        f"""<p>A flat target at {FAR_M:g} m, {FAR_KLUX:g} klux, laser period of {FAR_FRAME["period"]} cycles (108 m); the best of coincidence off and
thresholds 1 to 3, depth by planes. The scan has {SCAN["gate_steps"]} positions of 12 m, so each gets a tenth of the pulses. The gate around
the target shows how a scan can continue after it has found something. The laser is that of the paper (10 mW at 2 MHz, 5 nJ per
pulse, over 32 x 32 pixels) times a factor; an array with more pixels in the same field of view needs proportionally more.
{_checks(replay, list(table.values()))}</p>""",
        [("modes_far", figure, "Pixels that see a target at 100 m against the laser's pulse")],
        rows,
        [Comparison(f"least laser pulse, {what}", "-", ours, "") for what, ours in needs.items()],
    )


def _flat(
    mode: str, klux: float, distance_m: float, half_gate_m: float, *, pane_photons: float | None = None, seed: int
) -> Shot:
    coincidence, gate = MODES[mode]
    start = max(0, _cycles(distance_m - half_gate_m))
    subgroup = {"coincidence": coincidence, "threshold": THRESHOLD, "gating": gate is not None}
    subgroup |= {"gate_start": start, "gate_len": math.ceil(2 * half_gate_m / _cycle_m())}
    signal = float(signal_per_pulse(distance_m, REFLECTIVITY))
    pane = pane_photons is not None
    return Shot(
        distance_m=(PANE_M, distance_m) if pane else (distance_m,),
        signal=(pane_photons or 0.0, signal) if pane else (signal,),
        ambient=REFLECTIVITY,
        klux=klux,
        truth_m=distance_m,
        frame=(),
        subgroup=tuple(subgroup.items()),
        spad_gate=gate == "spad",
        seed=seed,
    )


def _far(reflectivity: float, schedule: str, pulses: int, threshold: int, power: float, seed: int) -> Shot:
    frame: dict[str, Any] = FAR_FRAME | {"pulses": pulses}
    subgroup: dict[str, Any] = {"coincidence": threshold > 0, "threshold": max(1, threshold)}
    if schedule == "known":
        subgroup |= {"gating": True, "gate_start": _cycles(FAR_M - 5), "gate_len": _cycles(10)}
    elif schedule == "scan":
        subgroup |= {"gating": True, "gate_start": _cycles(SCAN["start_m"]), "gate_len": SCAN["gate_len"]}
        frame |= {name: SCAN[name] for name in ("gate_step", "gate_steps")} | {
            "gate_every": pulses // int(SCAN["gate_steps"])
        }
    return Shot(
        distance_m=(FAR_M,),
        signal=(power * float(signal_per_pulse(FAR_M, reflectivity)),),
        ambient=reflectivity,
        klux=FAR_KLUX,
        truth_m=FAR_M,
        frame=tuple(frame.items()),
        subgroup=tuple(subgroup.items()),
        spad_gate=schedule != "none",
        seed=seed,
    )


def _cycle_m() -> float:
    return Timing().tick_s * Timing().phases * SPEED_OF_LIGHT_M_S / 2


def _cycles(distance_m: float) -> int:
    """Return the cycle in which light from a distance arrives."""
    return int(distance_m / _cycle_m())


def _looked(run: Runner, table: dict[Any, list[Shot]]) -> dict[Any, list[Seen]]:
    seen = iter(run.map(look, [shot for shots in table.values() for shot in shots]))
    return {key: [next(seen) for _ in shots] for key, shots in table.items()}


def _checks(replay: Engine | None, groups: Sequence[list[Shot]]) -> str:
    """Play some of the shots on the RTL, and return a sentence about it. Raises `AssertionError` if a word differs."""
    if replay is None:
        return ""
    chosen = [groups[int(k)][0] for k in np.linspace(0, len(groups) - 1, SPOT_CHECKS)]
    same = [same_on_rtl(shot, replay) for shot in chosen if shot.config().pulses <= FAR_PULSES[0]]
    assert all(same), "the RTL differs from the golden model"
    return f"{len(same)} of these frames were also played on the RTL: every word equals the golden model's."


def _names() -> list[str]:
    return [f"{what}_{method}" for what in ("right_share", "found_share", "rms_m") for method in METHODS] + [
        "events",
        "dropped",
    ]


def _numbers(many: list[Seen]) -> list[float]:
    shares = [_mean(many, what, method) for what in ("right", "found", "rms_m") for method in METHODS]
    return shares + [float(np.mean([one.events for one in many])), float(np.mean([one.dropped for one in many]))]


def _mean(many: list[Seen], what: str, method: str) -> float:
    return float(np.mean([getattr(one, what)[method] for one in many]))


def _share(axis: Axes) -> None:
    axis.set_ylim(0, 1.03)
    axis.yaxis.set_major_formatter(PercentFormatter(1))


def _reach(shares: Sequence[float]) -> str:
    good = [distance_m for distance_m, share in zip(DISTANCES_M, shares) if share >= FOUND_SHARE]
    return f"{max(good):g} m" if good else "none"


def _best(
    seen: dict[Any, list[Seen]], reflectivity: float, schedule: str, pulses: int, power: float
) -> tuple[float, int]:
    """Return (share of pixels that see the target, threshold) for the threshold with most of them, then with most right ones."""
    ranked = []
    for threshold in FAR_THRESHOLDS:
        many = seen[reflectivity, schedule, pulses, threshold, power]
        ranked.append((_mean(many, "found", "planes"), _mean(many, "right", "planes"), threshold))
    found, _, threshold = max(ranked)
    return found, threshold


def _need(
    seen: dict[Any, list[Seen]], reflectivity: float, schedule: str, pulses: int, best: Sequence[tuple[float, int]]
) -> str:
    """Return the weakest laser pulse that finds the target, with the threshold and the precision."""
    for power, (share, threshold) in zip(POWERS, best):
        if share >= FOUND_SHARE:
            rms_m = _mean(seen[reflectivity, schedule, pulses, threshold, power], "rms_m", "planes")
            how = f"threshold {threshold}" if threshold else "coincidence off"
            return f"{PULSE_NJ * power:g} nJ, {how}, {100 * rms_m:.1f} cm RMS"
    return f"more than {PULSE_NJ * POWERS[-1]:g} nJ"


FAMILIES: tuple[Callable[..., Section], ...] = (background, glass, far)
