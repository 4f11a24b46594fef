# SPDX-License-Identifier: Apache-2.0
"""Units that Verilator turns into object files, for C++ programs of our own: compiled once, kept
by their contents.
"""

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from ..model.shared.folders import build_root
from ..model.shared.sources import digest
from ..tools.build import Compile, compile_once
from . import toolchain

VERILATOR = ("--cc", *toolchain.VERILATOR_OPTIONS)
COMPILER = ("g++", "-std=gnu++20", "-fPIC")
SLOW = "__Slow.cpp"  # ends the names of files that only the first evaluation needs
RUN_TIME = ("verilated.cpp", "verilated_threads.cpp")
UNOPTIMISED = "-O0"  # for what hardly runs


def include() -> list[str]:
    """Return the compiler's options that find Verilator's headers."""
    folder = toolchain.verilator().parents[1] / "include"
    return [f"-I{folder}", f"-I{folder / 'vltstd'}"]


def verilated_unit(
    top: str,
    prefix: str,
    sources: list[Path],
    options: Sequence[str] = (),
    optimise: str = toolchain.OPTIMISE,
) -> Path:
    """Verilate a unit: its headers and `objects_in`, in a folder keyed by its sources and
    options. optimise: of g++.
    """
    texts = {path.name: path.read_text(encoding="utf-8") for path in sources}
    flags = [*VERILATOR, *options, "--top-module", top, "--prefix", prefix, "--Mdir", "."]
    key = digest(
        str(toolchain.verilator()),
        *flags,
        *COMPILER,
        optimise,
        *(part for of in texts.items() for part in of),
    )

    def make(scratch: Path, run: Compile) -> None:
        for name, text in texts.items():
            (scratch / name).write_text(text, encoding="utf-8")
        run([str(toolchain.verilator()), *flags, *texts])
        names = {path.name for path in scratch.glob("*.cpp")}
        slow = {name for name in names if name.endswith(SLOW)}
        with (
            ThreadPoolExecutor() as pool
        ):  # two files for the compiler, because many small ones take twice as long
            fast = pool.submit(_compiled, scratch, run, "fast.cpp", names - slow, optimise)
            _compiled(scratch, run, "slow.cpp", slow, UNOPTIMISED)
            fast.result()
        for path in scratch.iterdir():
            if path.suffix not in (".h", ".o"):
                path.unlink()

    return compile_once(build_root() / "verilated" / f"{top}-{key}", make)


def run_time() -> Path:
    """Return the folder with Verilator's run-time library, the same one for every unit."""
    key = digest(str(toolchain.verilator()), *COMPILER, *RUN_TIME, UNOPTIMISED)
    return compile_once(
        build_root() / "verilated" / f"run-time-{key}",
        lambda scratch, run: _compiled(scratch, run, "all.cpp", RUN_TIME, UNOPTIMISED),
    )


def objects_in(*folders: Path) -> list[Path]:
    """Return the object files of units and of the run-time library."""
    return [path for folder in folders for path in sorted(folder.glob("*.o"))]


def _compiled(folder: Path, run: Compile, file: str, names: Iterable[str], optimise: str) -> None:
    """Compile C++ files as one."""
    (folder / file).write_text(
        "".join(f'#include "{name}"\n' for name in sorted(names)), encoding="utf-8"
    )
    run([*COMPILER, optimise, *include(), "-c", file, "-o", Path(file).with_suffix(".o").name])
