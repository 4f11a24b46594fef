# SPDX-License-Identifier: Apache-2.0
"""Lint of the emitted Verilog and its test benches: Verilator with all warnings except the waivers, and Icarus if installed."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..hdl.emulator.ulx3s import BOARD_TOP
from ..hdl.export import cell_files, fpga_files
from ..hdl.front_end_views import POLYPHASE, View
from ..hdl.sensor import FPGA_TOP, has_fpga_top
from ..model.contract.parameters import TOP, Sensor
from ..tb import toolchain
from ..tb.rtl import rtl
from .emulator_release import verilog_of
from .release import CELLS_FOLDER, tool_options
from .smoke import FPGA_SMOKE, SMOKE, smoke_test
from .waivers import CONTROL_FILE, control_file

PLL_MODEL = Path(__file__).with_name("ecp5_pll.v")
VERILATOR = ("--lint-only", "--timing", "--quiet-stats")


def lint(sensor: Sensor, view: View = POLYPHASE) -> dict[str, str]:
    """Return tool -> its findings in the Verilog of `sensor`, "" if there are none. Raises `ToolchainError`.

    It sees the forms for standard cells, too, in a folder as in a release. view: from `hdl/front_end_views.py`; in a view with
    macros, lint sees the files for synthesis.
    """
    files = {path.name: path.read_text() for path in (*rtl(sensor, view), *view.macros)}
    rtl_names, cells = list(files), cell_files(sensor, view)
    benches: dict[str, dict[str, str]] = {} if view.macros else {SMOKE: {f"{SMOKE}.v": smoke_test(sensor)}}
    runs = [(TOP, rtl_names), *((top, [*rtl_names, *more]) for top, more in benches.items())]
    if view is POLYPHASE and has_fpga_top(sensor):
        fpga, without_top = fpga_files(sensor), [name for name in rtl_names if name != f"{TOP}.v"]
        benches[FPGA_SMOKE] = fpga | {f"{FPGA_SMOKE}.v": smoke_test(sensor, levels=True)}
        runs += [(FPGA_TOP, [*without_top, *fpga]), (FPGA_SMOKE, [*without_top, *benches[FPGA_SMOKE]])]
    runs.append((TOP, [f"{CELLS_FOLDER}/{name}" if name in cells else name for name in rtl_names]))
    for more in benches.values():
        files |= more
    files |= {f"{CELLS_FOLDER}/{name}": text for name, text in cells.items()} | {CONTROL_FILE: control_file(view)}
    return _findings(files, runs, view)


def lint_emulator(files: Mapping[str, str], top: str) -> dict[str, str]:
    """Return the findings in the files of `emulator_release`. Of a board's own cells, only the ports are known."""
    names = verilog_of(dict(files))
    boxes = {PLL_MODEL.name: PLL_MODEL.read_text()} if top == BOARD_TOP else {}
    return _findings(
        {name: files[name] for name in (*names, CONTROL_FILE)} | boxes, [(top, [*names, *boxes])], POLYPHASE
    )


def _findings(files: Mapping[str, str], runs: Sequence[tuple[str, list[str]]], view: View) -> dict[str, str]:
    """Return the findings in some tops. runs: of each, its name and those of its files."""
    options = [part for option in tool_options(view)["lint"] for part in option.split()]
    found = {"verilator": ""} | ({"icarus": ""} if shutil.which("iverilog") and not view.macros else {})
    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        for name, text in files.items():
            (Path(folder) / name).parent.mkdir(exist_ok=True)
            (Path(folder) / name).write_text(text)
        for top, names in runs:
            verilator = [str(toolchain.verilator()), *VERILATOR, *options, "--top-module", top, CONTROL_FILE]
            icarus = ["iverilog", "-g2005", "-Wall", "-s", top, "-o", os.devnull]
            for tool, command in (("verilator", verilator), ("icarus", icarus)):
                if tool in found:
                    found[tool] += _complaints([*command, *names], folder)
    return found


def _complaints(command: list[str], folder: str) -> str:
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    return done.stdout or (f"exit code {done.returncode}\n" if done.returncode else "")
