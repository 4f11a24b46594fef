# SPDX-License-Identifier: Apache-2.0
"""Lint of the emitted Verilog and its test benches: Verilator with all warnings except the waivers, and Icarus if installed."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
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
    tops = {TOP: {}} if view.macros else {TOP: {}, SMOKE: {f"{SMOKE}.v": smoke_test(sensor)}}
    options = [part for option in tool_options(view)["lint"] for part in option.split()]
    if view is POLYPHASE and has_fpga_top(sensor):
        fpga = fpga_files(sensor)
        tops |= {FPGA_TOP: fpga, FPGA_SMOKE: fpga | {f"{FPGA_SMOKE}.v": smoke_test(sensor, levels=True)}}
    cells = {name: f"{CELLS_FOLDER}/{name}" for name in cell_files(sensor, view)}
    plain = {
        top: [*(name for name in files if top not in (FPGA_TOP, FPGA_SMOKE) or name != f"{TOP}.v"), *more]
        for top, more in tops.items()
    }
    runs = [*plain.items(), (TOP, [cells.get(name, name) for name in plain[TOP]])]
    for more in tops.values():
        files |= more
    files |= {cells[name]: text for name, text in cell_files(sensor, view).items()} | {CONTROL_FILE: control_file(view)}
    found = {"verilator": ""} | ({"icarus": ""} if shutil.which("iverilog") and not view.macros else {})
    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        (Path(folder) / CELLS_FOLDER).mkdir()
        for name, text in files.items():
            (Path(folder) / name).write_text(text)
        for top, names in runs:
            command = [str(toolchain.verilator()), *VERILATOR, *options, "--top-module", top, CONTROL_FILE, *names]
            found["verilator"] += _complaints(command, folder)
            if "icarus" in found:
                found["icarus"] += _complaints(
                    ["iverilog", "-g2005", "-Wall", "-s", top, "-o", os.devnull, *names], folder
                )
    return found


def lint_emulator(files: Mapping[str, str], top: str) -> dict[str, str]:
    """Tool -> what it found in an emulator as `emulator_release` gives it; of a board's cells the ports alone are known. Raises `ToolchainError`."""
    names = verilog_of(dict(files))
    options = [part for option in tool_options(POLYPHASE)["lint"] for part in option.split()]
    found = {}
    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        for name in (*names, CONTROL_FILE):
            (Path(folder) / name).write_text(files[name])
        boxes = [PLL_MODEL.name] if top == BOARD_TOP else []
        for box in boxes:
            (Path(folder) / box).write_text(PLL_MODEL.read_text())
        given = [CONTROL_FILE, *names, *boxes]
        found["verilator"] = _complaints(
            [str(toolchain.verilator()), *VERILATOR, *options, "--top-module", top, *given], folder
        )
        if shutil.which("iverilog"):
            found["icarus"] = _complaints(
                ["iverilog", "-g2005", "-Wall", "-s", top, "-o", os.devnull, *given[1:]], folder
            )
    return found


def _complaints(command: list[str], folder: str) -> str:
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    return done.stdout or (f"exit code {done.returncode}\n" if done.returncode else "")
