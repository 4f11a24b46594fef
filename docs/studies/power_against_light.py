# SPDX-License-Identifier: Apache-2.0
"""Measures the power of a subgroup against the light on it, and what threshold, gate and a gated
clock save.

A sensor of one subgroup in standard cells plays one short frame for each case; `flow/power.py`
computes milliwatts from the frame. The scene is a target at the reference distance under ambient
light, seen by the paper's SPADs.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from attrs import field, frozen
from matplotlib import colormaps
from matplotlib.figure import Figure

from coincid.flow.power import Power, clock_tree_mw, count_toggles, design, power, power_at_rest
from coincid.flow.yosys import CLOCK_BUFFER, SINKS_MAX
from coincid.lab.setup import Setup
from coincid.model.golden.frame import Golden
from coincid.model.light.light import REFERENCE_DISTANCE_M, REFERENCE_REFLECTIVITY
from coincid.model.scenes.scene import Scene
from coincid.model.shared.markdown import table
from coincid.study.plot_style import new_figure, save_figure, style
from coincid.tb.frame_record import FrameJob
from coincid.tools.pages import picture, put, put_page

PULSES, SEED = 2, 1
SATURATION_KLUX = 1e5  # every SPAD fires again as soon as its dead time ends
PICTURE, TEMPLATE = "power.png", "power_page.md"
SIDE, PIXELS = 8, 64
WIRE_FF = 0.34  # wire per input: the mean of the routed minigroup (docs/layout.md)
KINDS = (
    ("clock", "clock"),
    ("internal", "inside cells"),
    ("switching", "driven pins"),
    ("leakage", "leakage"),
)
# frames per second; pulses of a frame, and their period
RATES_HZ, VIDEO_PULSES, PERIOD_US = (30, 100), 100, 0.5
# 50 ns of 500 ns, around the light of the target
GATE = {"gating": True, "gate_start": 3, "gate_len": 25}


@frozen
class Case:
    """Light on a subgroup and its settings. klux: None: no light at all."""

    name: str
    klux: float | None
    subgroup: Mapping[str, Any] = field(factory=dict)
    frame: Mapping[str, Any] = field(factory=dict)


DARK, MIDDLE = Case("dark", None), Case("50 klux", 50.0)
LIGHT = (
    DARK,
    Case("5 klux", 5.0),
    MIDDLE,
    Case("100 klux", 100.0),
    Case("saturation", SATURATION_KLUX),
)
AT_KLUX = 100.0
SETTINGS = (
    Case("coincidence off", AT_KLUX, {"coincidence": False}),
    Case("threshold 1", AT_KLUX, {"threshold": 1}),
    Case("threshold 4", AT_KLUX, {"threshold": 4}),
    Case("gate of 50 ns", AT_KLUX, GATE),
    Case("full format", AT_KLUX, frame={"format": "full"}),
    Case("minigroup records", AT_KLUX, frame={"minigroup_records": True}),
    Case("saturation, gate of 50 ns", SATURATION_KLUX, GATE),
)
CASES = (*LIGHT, *SETTINGS)
# (beginning of an instance's name, name in the table); the innermost matching instance decides
GROUPS = (
    ("minigroup", "minigroups (16)"),
    ("tree", "tree"),
    ("fifo", "FIFO"),
    ("dpcu", "DPCU"),
    ("record_buffer", "record buffer"),
    ("packetizer", "packetizer"),
    ("settings", "settings"),
    ("gating", "gate"),
    ("subgroup", "ports' registers"),
)
PLACES = (*GROUPS, ("counts", "counts"))  # counts are not in the default sensor


def setup(case: Case, **sensor: Any) -> Setup:
    """Return the setup of a short frame on a sensor with one subgroup, whose gate switches the
    SPADs off.

    sensor: parameters that differ from those of a sensor of `SIDE` x `SIDE` pixels.
    """
    built = {"rows": SIDE, "cols": SIDE} | sensor
    shape = built["rows"], built["cols"]
    distance_m = np.full(shape, np.nan if case.klux is None else REFERENCE_DISTANCE_M)
    return Setup.of(
        Scene(
            name=case.name,
            distance_m=distance_m,
            reflectivity=np.full(shape, REFERENCE_REFLECTIVITY),
        ),
        sensor=built,
        frame={"pulses": PULSES} | dict(case.frame),
        subgroup=dict(case.subgroup),
        klux=case.klux or 0.0,
        spad_gate=True,
        seed=SEED,
    )


@frozen
class Measured:
    """Measurements of a case. edges_cps: per pixel. groups: power of the subgroup by the names of
    `GROUPS`. wired: its total with wires, in mW. tree: that of a clock tree, in mW."""

    case: Case
    edges_cps: float
    events_cps: float
    groups: dict[str, Power]
    wired: float
    tree: float

    @property
    def total(self) -> Power:
        return sum(self.groups.values(), Power())


def group_of(block: str) -> str | None:
    """Return the group of a block, from the names of its instances; None: the block is not in a
    subgroup.
    """
    instances = block.split(".")
    if not any(instance.startswith("subgroup") for instance in instances):
        return None
    return next(
        name
        for instance in reversed(instances)
        for begin, name in PLACES
        if instance.startswith(begin)
    )


def _grouped(blocks: dict[str, Power]) -> dict[str, Power]:
    groups = {name: Power() for _, name in PLACES}
    for block, one in blocks.items():
        name = group_of(block)
        if name:
            groups[name] += one
    return groups


def measure(
    tell: Callable[[str], None], cases: Sequence[Case] = CASES, **sensor: Any
) -> tuple[list[Measured], Power]:
    """Return the power of the subgroup in each case, and between frames. sensor: parameters that
    differ from the preset.
    """
    setups = [setup(case, **sensor) for case in cases]
    config = setups[0].config
    golden = Golden(config.sensor)  # one for all frames, because it numbers them
    jobs = []
    for one in setups:
        edges = one.photons.edges()
        jobs.append(FrameJob(one.config, edges, golden.frame(one.config, edges)))
    whole = design(config.sensor)
    tell(f"simulating {len(jobs)} frames of {config.frame_cycles} cycles on the netlist")
    toggles = count_toggles(config.sensor, jobs)
    measured = []
    for number, (case, job) in enumerate(zip(cases, jobs, strict=True)):
        cycles = job.config.frame_cycles
        seconds = cycles / (config.clock_mhz * 1e6)
        groups, wired = (
            _grouped(power(whole, toggles, number, cycles, config.clock_mhz, wire_ff))
            for wire_ff in (0.0, WIRE_FF)
        )
        edges_cps = len(job.edges) / config.sensor.pixels / seconds
        assert job.expected is not None
        events_cps = len(job.expected.commit_subgroup) / seconds
        trees = clock_tree_mw(whole, toggles, number, cycles, config.clock_mhz, WIRE_FF)
        tree = sum(mw for block, mw in trees.items() if group_of(block))
        measured.append(
            Measured(case, edges_cps, events_cps, groups, sum(wired.values(), Power()).total, tree)
        )
        tell(f"{case.name}: {measured[-1].total.total:.2f} mW")
    return measured, sum(_grouped(power_at_rest(whole, config.clock_mhz)).values(), Power())


def write_power_page() -> None:
    """Measure, and write docs/power.md and its picture."""
    measured, between = measure(partial(print, flush=True))
    save_figure(draw(measured), picture(f"docs/images/{PICTURE}"))
    put_page("docs/power.md", "power", page(measured, between))
    put("docs/silicon.md", "power against light")


def page(measured: list[Measured], between: Power) -> str:
    """Return the page in Markdown. between: power between frames."""
    by_light = measured[: len(LIGHT)]
    others = measured[len(LIGHT) :]
    names = [one.case.name for one in by_light]
    middle = next(one for one in by_light if one.case is MIDDLE)
    reference = next(one for one in by_light if one.case.klux == AT_KLUX)
    brightest = by_light[-1]
    blocks = [[name, *(f"{one.groups[name].total:.2f}" for one in by_light)] for _, name in GROUPS]
    blocks.append(["**subgroup**", *(f"**{one.total.total:.2f}**" for one in by_light)])
    blocks.append(["with wires", *(f"{one.wired:.2f}" for one in by_light)])
    blocks.append(["and a clock tree", *(f"{one.wired + one.tree:.2f}" for one in by_light)])
    blocks.append(["uW per pixel", *(f"{1000 * one.total.total / PIXELS:.0f}" for one in by_light)])
    blocks.append(["edges per pixel and us", *(f"{one.edges_cps / 1e6:.2f}" for one in by_light)])
    kinds = [
        [label, *(f"{getattr(one.total, name):.2f}" for one in by_light)] for name, label in KINDS
    ]
    users = [["in a frame, mW", *(f"{one.total.total:.2f}" for one in by_light)]]
    users.append(["between frames, mW", *(f"{between.total:.2f}" for _ in by_light)])
    for rate_hz in RATES_HZ:
        share = rate_hz * VIDEO_PULSES * PERIOD_US * 1e-6  # of the time that frames take
        means = [between.total + share * (one.total.total - between.total) for one in by_light]
        users.append([f"mean at {rate_hz} frames/s, mW", *(f"{mean:.2f}" for mean in means)])
        users.append(["... per pixel, uW", *(f"{1000 * mean / PIXELS:.1f}" for mean in means)])
    users.append(["events per us", *(f"{one.events_cps / 1e6:.1f}" for one in by_light)])
    dark = by_light[0].total.total
    users.append(["nJ per event, all power", *(_nj(one, one.total.total) for one in by_light)])
    users.append(
        [
            "nJ per event, more than in the dark",
            *(_nj(one, one.total.total - dark) for one in by_light),
        ]
    )
    energies = [
        [name, *(_nj(one, one.groups[name].total) for one in by_light[1:])] for _, name in GROUPS
    ]
    settings = []
    for one in others:
        base = brightest if one.case.klux == SATURATION_KLUX else reference
        saved = base.total.total - one.total.total
        settings.append(
            [
                one.case.name,
                f"{one.total.total:.2f}",
                f"{saved:+.2f}",
                f"{saved / base.total.total:+.1%}",
            ]
        )
    gates = [
        [name, f"{middle.groups[name].clock:.2f}", f"{middle.groups[name].idle:.2f}"]
        for _, name in GROUPS
    ]
    gates.append(["**subgroup**", f"**{middle.total.clock:.2f}**", f"**{middle.total.idle:.2f}**"])
    return (
        Path(__file__)
        .with_name(TEMPLATE)
        .read_text(encoding="utf-8")
        .format(
            pulses=PULSES,
            picture=PICTURE,
            wire=WIRE_FF,
            buffer=CLOCK_BUFFER,
            sinks=SINKS_MAX,
            klux=AT_KLUX,
            middle=MIDDLE.klux,
            default=f"{reference.total.total:.2f}",
            share=f"{middle.total.clock / middle.total.total:.0%}",
            users="\n".join(table(["a subgroup", *names], users)),
            energies="\n".join(table(["block, nJ per event", *names[1:]], energies)),
            video=VIDEO_PULSES,
            frame_us=f"{VIDEO_PULSES * PERIOD_US:g}",
            leakage=f"{between.leakage:.2f}",
            blocks="\n".join(table(["block", *names], blocks)),
            kinds="\n".join(table(["kind", *names], kinds)),
            settings="\n".join(table(["setting", "mW", "saves mW", "share"], settings)),
            gates="\n".join(
                table(["block", "clock, mW", "of it in cycles without a change, mW"], gates)
            ),
        )
    )


def _nj(one: Measured, mw: float) -> str:
    """Return the energy per event in nJ for a power; empty without events."""
    return f"{1e6 * mw / one.events_cps:.2f}" if one.events_cps else ""


def draw(measured: list[Measured]) -> Figure:
    """Draw stacked bars against the light, by block and by kind of power."""
    shown = measured[: len(LIGHT)]
    names = [one.case.name for one in shown]
    with style():
        figure = new_figure(10.5, 4.6)
        by_block, by_kind = figure.subplots(1, 2, sharey=True)
        stacks = (
            (by_block, {name: [one.groups[name].total for one in shown] for _, name in GROUPS}),
            (
                by_kind,
                {label: [getattr(one.total, name) for one in shown] for name, label in KINDS},
            ),
        )
        for axis, values in stacks:
            below = np.zeros(len(shown))
            colours = colormaps["viridis"](np.linspace(0.05, 0.95, len(values)))
            for (label, heights), colour in zip(values.items(), colours, strict=True):
                axis.bar(names, heights, bottom=below, label=label, color=colour, width=0.65)
                below += heights
            axis.legend(loc="upper left", ncols=2, fontsize=7.5)
            axis.set_ylim(0, 1.45 * max(one.total.total for one in shown))
        by_block.set_ylabel("mW per subgroup of 64 pixels")
    return figure


if __name__ == "__main__":
    write_power_page()
