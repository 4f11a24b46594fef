# SPDX-License-Identifier: Apache-2.0
"""The design that is placed and routed: a module of the FPGA preset on a large ECP5."""

import json
import re
from pathlib import Path
from typing import Any

from attrs import evolve

from ..hdl.export import FILE_LIST, fpga_files, verilog_files
from ..model.contract.config import load_config
from ..model.contract.parameters import TOP
from ..tools.wheels import wheel_folder
from .pnr import NEXTPNR, Board, place, write_placement_page

WRAPPER = Path(__file__).with_name("ecp5.v")
# of the device of `fpga_module`, in the wheel of nextpnr
PADS = "share/trellis/database/ECP5/LFE5UM5G-85F/iodb.json"
PACKAGE = "CABGA756"


def fpga_module() -> Board:
    """Return a module of the FPGA preset with registers, readout and deserialisers. Raises
    `ToolchainError` without nextpnr.
    """
    preset = load_config("fpga")
    sensor = evolve(preset.sensor, rows=8, cols=16)
    files = (
        verilog_files(sensor)
        | fpga_files(sensor)
        | {WRAPPER.name: WRAPPER.read_text(encoding="utf-8")}
    )
    del files[FILE_LIST], files[f"{TOP}.v"]
    return Board(
        title="The FPGA preset placed and routed",
        page="docs/place-and-route.md",
        command="make pnr",
        what="a module of two subgroups (with TDC, FIFOs and deserialisers), readout, registers and a PLL",
        chip=f"ECP5 um5g-85k, {PACKAGE}, speed grade 8",
        top="coincid_ecp5",
        files=files,
        pins=_along_the_edge(),
        device=("--um5g-85k", "--package", PACKAGE, "--speed", "8"),
        goal_mhz=preset.clock_mhz,
        sampled="spad",
        tick_ns=1000 / preset.clock_mhz / sensor.phases,
    )


def _along_the_edge() -> str:
    """Return constraints that place the ports of the wrapper along the edge of the chip in
    order, as on a board.

    Without them nextpnr would place the ports, and the logic behind them, at random. nextpnr
    chooses only the clock pin.
    """
    sites = json.loads((wheel_folder(NEXTPNR) / PADS).read_text(encoding="utf-8"))["packages"][
        PACKAGE
    ]
    right = max(site["col"] for site in sites.values())

    def clockwise(item: tuple[str, dict[str, Any]]) -> tuple[int, int, str]:
        """Return side, place on it and pad, from the lower left corner on."""
        row, col, pad = item[1]["row"], item[1]["col"], item[1]["pio"]
        side, along = (
            (0, -row)
            if col == 0
            else (1, col)
            if row == 0
            else (2, row)
            if col == right
            else (3, -col)
        )
        return side, along, pad

    ports = re.findall(
        r"(?:input|output) (?:\[(\d+):0\] )?(\w+)", WRAPPER.read_text(encoding="utf-8")
    )
    bits = [
        f"{name}[{k}]" if msb else name
        for msb, name in ports
        for k in range(int(msb or 0) + 1)
        if name != "clk_in"
    ]
    along = (site for site, _ in sorted(sites.items(), key=clockwise))
    return "".join(
        f'LOCATE COMP "{bit}" SITE "{site}";\n' for bit, site in zip(bits, along, strict=False)
    )


def place_fpga_module() -> None:
    """Place the module of the FPGA preset, and write its page. Raises `ToolchainError`."""
    board = fpga_module()
    write_placement_page(board, place(board))
