"""Lint of the emitted Verilog: Verilator with every warning, less the waivers, and Icarus where it is installed."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from ..hdl.sensor import TOP
from ..hdl.waivers import CONTROL_FILE, control_file
from ..model.parameters import Sensor
from . import toolchain
from .rtl import rtl


def lint(sensor: Sensor) -> dict[str, str]:
    """Tool -> what it found in the Verilog of `sensor`, "" where that is nothing. Raises `ToolchainError`."""
    sources = rtl(sensor)
    folder, names = sources[0].parent, [path.name for path in sources]
    with tempfile.NamedTemporaryFile("w", suffix=CONTROL_FILE) as control:
        control.write(control_file())
        control.flush()
        options = ["--lint-only", "-Wall", "-fno-inline", "--quiet-stats", "--top-module", TOP]
        found = {"verilator": _complaints([str(toolchain.verilator()), *options, control.name, *names], folder)}
    if shutil.which("iverilog"):
        found["icarus"] = _complaints(["iverilog", "-g2012", "-Wall", "-s", TOP, "-o", os.devnull, *names], folder)
    return found


def _complaints(command: list[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    return done.stdout or (f"exit code {done.returncode}\n" if done.returncode else "")
