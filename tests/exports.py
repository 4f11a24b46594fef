# SPDX-License-Identifier: Apache-2.0
"""Every command of an export's README, run as it stands there:
`python -m tests.exports [NAMES] [--verilator FOLDER]`.

The exports differ in size, phases and form of light. `--verilator` names a folder with another
`verilator` than the project's, such as /usr/bin, and may be given several times. The exit code is 1
if a command fails.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from coincid.flow.release import write_release
from coincid.hdl.front_end_views import POLYPHASE
from coincid.model.contract.config import load_config, parse_config
from coincid.tb import toolchain

from .random_cases import LEAN

SMALLEST = {
    "rows": 4,
    "cols": 4,
    "subgroup": [4, 4],
    "minigroup": [1, 1],
    "phases": 4,
    "window_max": 20,
}
EXPORTS = {  # name -> tables of the configuration (or a preset), view
    "default": ({}, POLYPHASE),
    "smallest": ({"sensor": SMALLEST, "frame": {"period": 100}}, POLYPHASE),
    "subgroup": ({"sensor": {"rows": 8, "cols": 8}}, POLYPHASE),
    "lean": ({"sensor": LEAN, "frame": {"period": 100}}, POLYPHASE),
    "counts": ({"sensor": {"rows": 8, "cols": 8, "counts": 1}}, POLYPHASE),
    "async": ({"sensor": {"rows": 8, "cols": 8}, "frame": {"clock_mhz": 400}}, "async"),
    "fpga": ("fpga", POLYPHASE),
    "silicon": ("silicon", POLYPHASE),
}
PASSED = re.compile(r"^PASS: \d+ checks$", re.MULTILINE)
COMPLAINT = re.compile(r"FAIL|%Warning|%Error|\bwarning:|\berror:|ERROR")


def write_export(folder: Path, name: str) -> None:
    """Write one of `EXPORTS`."""
    given, view = EXPORTS[name]
    config = load_config(given) if isinstance(given, str) else parse_config(given)
    write_release(folder, config, view)


def readme_commands(folder: Path) -> list[str]:
    """Return the commands of the README of an export, in order."""
    section = re.search(
        r"^## Lint and smoke test$(.*?)^## ",
        (folder / "README.md").read_text(encoding="utf-8"),
        re.M | re.S,
    )
    assert section is not None
    return re.findall(r"^    (.+)$", section[1], re.M)


def complaint(command: str, folder: Path, verilator: Path, cheap: bool = False) -> str:
    """Run a command of the README with the programs of `verilator` first, and return "" if it did
    what the README says.

    cheap: the C++ is compiled without optimisation, for a sensor that runs for less time than it
    compiles.
    """
    search = [str(verilator), str(Path(sys.executable).parent), os.environ["PATH"]]
    environment = os.environ | {"PATH": os.pathsep.join(search), "HOME": str(folder)}
    if cheap:
        environment["MAKEFLAGS"] = "OPT_FAST=-O0 OPT_SLOW=-O0 OPT_GLOBAL=-O0"
    done = subprocess.run(
        command,
        shell=True,
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        encoding="utf-8",
        check=False,
    )
    simulates = "smoke" in command or "--target lint" not in command and "fusesoc" in command
    right = done.returncode == 0 and not COMPLAINT.search(done.stdout)
    if right and bool(PASSED.search(done.stdout)) == simulates:
        return ""
    return f"{command}\nexit code {done.returncode}\n{done.stdout}"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="tests.exports", description=__doc__)
    parser.add_argument("names", nargs="*", help=f"exports, default all: {', '.join(EXPORTS)}")
    parser.add_argument(
        "--verilator",
        type=Path,
        action="append",
        help="folder of a verilator, default the project's",
    )
    given = parser.parse_args(arguments)
    for name in given.names:
        if name not in EXPORTS:
            parser.error(f"{name}: unknown export, must be one of {', '.join(EXPORTS)}")
    verilators = given.verilator or [toolchain.verilator().parent]
    failed = 0
    for name in given.names or EXPORTS:
        for verilator in verilators:
            with tempfile.TemporaryDirectory(prefix="coincid-") as folder:
                write_export(Path(folder), name)
                for command in readme_commands(Path(folder)):
                    told = complaint(command, Path(folder), verilator)
                    failed += bool(told)
                    print(
                        f"{name}, {verilator}: {'FAILED ' + told if told else 'ok ' + command}",
                        flush=True,
                    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
