# SPDX-License-Identifier: Apache-2.0
"""Lint of the emitted Verilog and its test benches: Verilator with all warnings except the
waivers, and Icarus if installed.
"""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..hdl.export import FILE_LIST
from ..hdl.front_end_views import POLYPHASE, View
from ..hdl.sensor import FPGA_TOP
from ..model.contract.config import Config
from ..model.contract.parameters import TOP
from ..tb import toolchain
from .release import CELLS_LIST, SYNTHESIS_LIST, release_files, tool_options
from .smoke import FPGA_SMOKE, SMOKE
from .waivers import CONTROL_FILE, EXACT

VERILATOR = ("--lint-only", "--timing", "--quiet-stats", f"-D{EXACT}")


def lint(config: Config, view: View = POLYPHASE) -> dict[str, str]:
    """Return tool -> its findings in the Verilog of a release, "" if there are none. Raises
    `ToolchainError`.

    Every top is read, and also the forms for standard cells. In a view with macros, the files
    are those for synthesis, and there is no test bench.
    """
    files = release_files(config, view)
    benches = () if view.macros else (SMOKE, FPGA_TOP, FPGA_SMOKE)
    lists = [(TOP, SYNTHESIS_LIST if view.macros else FILE_LIST), (TOP, CELLS_LIST)]
    lists += [(top, f"{top}.f") for top in benches if f"{top}.f" in files]
    return findings(files, [(top, files[names].split()) for top, names in lists], view)


def findings(
    files: Mapping[str, str], runs: Sequence[tuple[str, list[str]]], view: View
) -> dict[str, str]:
    """Return tool -> its findings in some tops, "" if there are none.

    files: text by name. runs: of each top, its name and those of its files. Raises
    `ToolchainError`.
    """
    options = [part for option in tool_options(view)["lint"] for part in option.split()]
    found = {"verilator": ""} | (
        {"icarus": ""} if shutil.which("iverilog") and not view.macros else {}
    )
    with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
        for name, text in files.items():
            (Path(folder) / name).parent.mkdir(exist_ok=True)
            (Path(folder) / name).write_text(text, encoding="utf-8")
        for top, names in runs:
            verilator = [
                str(toolchain.verilator()),
                *VERILATOR,
                *options,
                "--top-module",
                top,
                CONTROL_FILE,
            ]
            icarus = ["iverilog", "-g2005", "-Wall", "-s", top, "-o", os.devnull]
            for tool, command in (("verilator", verilator), ("icarus", icarus)):
                if tool in found:
                    found[tool] += _complaints([*command, *names], folder)
    return found


def _complaints(command: list[str], folder: str) -> str:
    done = subprocess.run(
        command,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        encoding="utf-8",
    )
    return done.stdout or (f"exit code {done.returncode}\n" if done.returncode else "")
