# SPDX-License-Identifier: Apache-2.0
"""Power of a subgroup against the light that falls on it, and what threshold, gate and a gated clock save.

A sensor of one subgroup in standard cells plays one short frame for each case; `flow/power.py` says how a frame becomes milliwatts. The light
is a target at the reference distance under ambient light, with the paper's SPAD.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from attrs import frozen
from matplotlib.figure import Figure

from ..flow.power import Power, design, power, simulate
from ..model.contract.config import Config, parse_config, sensor_table
from ..model.contract.edges import Edges
from ..model.contract.parameters import Sensor
from ..model.golden.frame import Golden
from ..model.light.light import REFERENCE_DISTANCE_M, REFERENCE_REFLECTIVITY, Light
from ..model.light.photons import generate_edges
from ..model.light.spad import Spad, SpadGate
from ..model.light.timing import Timing
from ..model.shared.files import whole_file
from ..tb.frames import FrameJob
from .plot_style import legend_below, new_figure, save_figure, style

PULSES, SEED = 2, 1
SATURATION_KLUX = 1e5  # every SPAD fires as soon as its dead time is over
PICTURE, TABLE = "power.png", "power.md"
GATE = {"gating": True, "gate_start": 3, "gate_len": 25}  # 50 of 500 ns around the target's light


@frozen
class Case:
    """Light on a subgroup and its settings. klux: None: no light at all; shown: whether the picture has it."""

    name: str
    klux: float | None
    subgroup: dict[str, Any] = {}  # noqa: RUF012
    frame: dict[str, Any] = {}  # noqa: RUF012
    shown: bool = False


LIGHT = tuple(Case(name, klux, shown=True) for name, klux in (
    ("dark", None), ("5 klux", 5.0), ("50 klux", 50.0), ("100 klux", 100.0), ("saturation", SATURATION_KLUX)
))  # fmt: skip
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
GROUPS = (  # what the table calls blocks: the innermost instance that begins so decides
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


def configuration(case: Case) -> Config:
    """The preset's sensor with one subgroup, for a short frame."""
    sensor = Sensor(rows=8, cols=8)
    return parse_config(
        {"sensor": sensor_table(sensor), "frame": {"pulses": PULSES} | case.frame, "subgroup": case.subgroup}
    )


def edges(case: Case, config: Config) -> Edges:
    """SPAD edges of the frame. A gate switches the SPADs off, as the output `spad_gate` does."""
    shape = config.sensor.rows, config.sensor.cols
    distance_m = np.full(shape, np.nan if case.klux is None else REFERENCE_DISTANCE_M)
    light = Light.from_scene(distance_m, np.full(shape, REFERENCE_REFLECTIVITY), case.klux or 0.0)
    gate = SpadGate.from_config(config)
    return generate_edges(light, Spad(), Timing.from_config(config), pulses=config.pulses, seed=SEED, gate=gate)


@frozen
class Measured:
    """A case with its edges per pixel and second, and the subgroup's power by the groups' names; `other` is outside the subgroup."""

    case: Case
    edges_cps: float
    groups: dict[str, Power]

    @property
    def total(self) -> Power:
        return sum(self.groups.values(), Power())


def group_of(path: tuple[str, ...]) -> str | None:
    """The group that a block is of; None: it is not in the subgroup."""
    for instance in reversed(path):
        for begin, name in GROUPS:
            if instance.startswith(begin):
                return name
    return None


def _grouped(blocks: dict[tuple[str, ...], Power]) -> dict[str, Power]:
    groups = {name: Power() for _, name in GROUPS}
    for path, one in blocks.items():
        name = group_of(path) if any(instance.startswith("subgroup") for instance in path) else None
        if name:
            groups[name] += one
    return groups


def measure(tell: Callable[[str], None] = print) -> tuple[dict[str, Power], list[Measured]]:
    """Power of the subgroup with nothing but its clock, and of every case."""
    golden, jobs = Golden(configuration(CASES[0]).sensor), []
    for case in CASES:
        config = configuration(case)
        given = edges(case, config)
        jobs.append(FrameJob(config, given, golden.frame(config, given)))
    config = jobs[0].config
    tell(f"simulating {len(jobs)} frames of {config.frame_cycles} cycles on the netlist")
    whole, toggles = design(config.sensor), simulate(config.sensor, jobs)
    clock = _grouped(power(whole, None, 0, 1, config.clock_mhz))
    measured = []
    for number, (case, job) in enumerate(zip(CASES, jobs)):
        groups = _grouped(power(whole, toggles, number, job.config.frame_cycles, config.clock_mhz))
        seconds = job.config.frame_cycles / (config.clock_mhz * 1e6)
        measured.append(Measured(case, len(job.edges) / config.sensor.pixels / seconds, groups))
        tell(f"{case.name}: {measured[-1].total.total:.2f} mW")
    return clock, measured
