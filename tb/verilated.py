# SPDX-License-Identifier: Apache-2.0
"""Units that Verilator turns into archives, for C++ programs of our own: compiled once, kept by their contents."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..model.shared.folders import build_root
from ..model.shared.sources import digest
from ..tools.build import Compile, compile_once
from . import toolchain

RUN_TIME = "libverilated.a"
VERILATOR = ("--cc", *toolchain.VERILATOR_OPTIONS)
# A unit is one file for the compiler: separate, many small files and two precompiled headers take twice as long.
COMPILER = ("-std=gnu++20", "-O2", "-fPIC")  # of a program around the archives
MAKE_OPTIONS = ("VM_PARALLEL_BUILDS=0", "OPT_GLOBAL=-O2")


def verilated_unit(
    top: str, prefix: str, sources: list[Path], options: Sequence[str] = (), optimise: str = toolchain.OPTIMISE
) -> Path:
    """Verilate a unit: its headers and archive, in a folder keyed by its sources and options. optimise: of g++."""
    texts = {path.name: path.read_text() for path in sources}
    return _archive(f"lib{prefix}.a", top, prefix, texts, options, optimise)


def run_time() -> Path:
    """Return the archive of Verilator's run-time library, the same one for every unit."""
    top = "coincid_nothing"
    return _archive(RUN_TIME, top, "Vnothing", {f"{top}.v": f"module {top}; endmodule\n"}) / RUN_TIME


def _archive(
    archive: str,
    top: str,
    prefix: str,
    sources: Mapping[str, str],
    options: Sequence[str] = (),
    optimise: str = toolchain.OPTIMISE,
) -> Path:
    """Return a folder with an archive that Verilator's make file builds for the `sources`, and their headers."""
    contents = (part for item in sources.items() for part in item)
    key = digest(str(toolchain.verilator()), *VERILATOR, *MAKE_OPTIONS, optimise, archive, top, *options, *contents)
    directory = build_root() / "verilated" / f"{top}-{key}"

    def make(scratch: Path, run: Compile) -> None:
        for name, text in sources.items():
            (scratch / name).write_text(text)
        flags = [*options, "-CFLAGS", "-fPIC", "--top-module", top, "--prefix", prefix, "--Mdir", "."]
        run([str(toolchain.verilator()), *VERILATOR, *flags, *sources])
        jobs = str(os.cpu_count())
        run(["make", "-s", "-j", jobs, "-f", f"{prefix}.mk", *MAKE_OPTIONS, f"OPT_FAST={optimise}", archive])
        for path in scratch.iterdir():
            if path.suffix not in (".h", ".a"):
                path.unlink()

    return compile_once(directory, make)
