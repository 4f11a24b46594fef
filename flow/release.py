# SPDX-License-Identifier: Apache-2.0
"""The exported folder: Verilog, file lists, constraints, a smoke test, the register map, a
README and a manifest.
"""

import hashlib
import json
import os
import shutil
import tempfile
from importlib.metadata import files as files_of
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ..hdl import deserialiser
from ..hdl.export import FILE_LIST, cell_files, fpga_files, verilog_files
from ..hdl.front_end_views import POLYPHASE, View, view_at
from ..hdl.registers import read_cycles_max, write_cycles_max
from ..hdl.sensor import FPGA_TOP, SensorTop, has_fpga_top
from ..hdl.unit import Port
from ..model.contract import latency
from ..model.contract.config import Config, own_rule
from ..model.contract.parameters import SENSOR, TOP, Sensor
from ..model.shared.errors import InputError
from .async_constraints import async_constraints
from .c_driver import c_driver
from .captured import captured_files
from .ip_xact import with_interfaces
from .limits import beats_beside_cycles, largest_frame
from .plain_names import plain_verilog
from .ports import groups_page, instantiation, port_table, stream_words
from .prefix import checked_prefix, prefixed_files, prefixed_name
from .register_files import HEADER, IP_XACT, register_files
from .smoke import FPGA_SMOKE, SMOKE, smoke_test
from .waivers import CONTROL_FILE, OLDEST_VERILATOR, control_file

MANIFEST, CORE, README = "manifest.json", f"{TOP}.core", "README.md"
LICENCE = "LICENSE"
GROUPS = "groups.md"  # rule of the formats in which events leave in groups
GROUPS_HEAD = """\
# Groups of events

In a frame of the format `compact` or `compact-full`, `count` of the frame start is 1, and events leave
in groups.

"""
# Parts of the README: the page, and a sentence about each top: with edge words, with SPAD lines,
# and for FPGAs.
README_TEXT = Path(__file__).with_name("release_readme.md")
SYNTHESIS_LIST = "coincid_synthesis.f"  # for a view with macros
# Both for standard cells: a file list, and the folder of blocks that have another form.
CELLS_LIST, CELLS_FOLDER = ("coincid_cells.f", "cells")
TIMESCALE = "1ps/1fs"  # for a view with macros
# Shares of a period for the logic outside the ports.
PORT_DELAY = 0.4  # at most, in front of an input and behind an output
INPUT_DELAY_MIN = 0.05  # an input keeps its value for so long after the edge
OUTPUT_DELAY_MIN = 0.0  # the outside needs no output after the edge
SKEW_TICKS = 0.5  # between the delays of a SPAD line to its samplers
UNCERTAINTY = 0.05  # share of a period
DERIVED = ("array_pixels", "subgroups", "pixels", "minigroups", "guard", "stamp_bits", "period_max")
PER_TOP = {TOP: SMOKE, FPGA_TOP: FPGA_SMOKE}
TARGETS = ("lint", "sim", "verilate")  # of FuseSoC, for every top


def release_files(config: Config, view: str | View = POLYPHASE) -> dict[str, str]:
    """Return file name -> text for the sensor of a configuration at its clock, without captured
    streams and manifest.

    view: from `front_end_views.py`, or its name.
    """
    sensor, clock_mhz, view = config.sensor, config.clock_mhz, view_at(view, config.clock_mhz)
    rtl = verilog_files(sensor, view)
    lists = {TOP: rtl.pop(FILE_LIST).split()}
    registers = register_files(sensor)
    registers[IP_XACT] = with_interfaces(registers[IP_XACT], sensor, view)
    files = plain_verilog(rtl) | registers | {CONTROL_FILE: control_file(view)}
    files |= c_driver() | {LICENCE: _licence(), GROUPS: GROUPS_HEAD + groups_page()}
    if view.is_default and has_fpga_top(sensor):
        fpga = plain_verilog(fpga_files(sensor))
        files |= fpga
        lists[FPGA_TOP] = [*(name for name in lists[TOP] if name != f"{TOP}.v"), *fpga]
    for top, names in lists.items():
        smoke = f"{PER_TOP[top]}.v"
        files |= {
            smoke: smoke_test(sensor, top == FPGA_TOP, view),
            f"{PER_TOP[top]}.f": _list([*names, smoke]),
            FILE_LIST if top == TOP else f"{top}.f": _list(names),
            f"{top}.sdc": _constraints(sensor, clock_mhz, top, view),
        }
    if view.macros:
        boxes = {path.name: path.read_text(encoding="utf-8") for path in view.macros}
        files |= boxes | {SYNTHESIS_LIST: _list([*lists[TOP], *boxes])}
    cells = {
        name: (f"{CELLS_FOLDER}/{name}", text) for name, text in cell_files(sensor, view).items()
    }
    names = [cells[name][0] if name in cells else name for name in lists[TOP]]
    files |= dict(cells.values()) | {
        CELLS_LIST: _list([*names, *(path.name for path in view.macros)])
    }
    files |= {CORE: _core(lists, names, view), README: _readme(config, lists, view)}
    return dict(sorted(files.items()))


def _licence() -> str:
    """Return the text of the licence, as it is installed."""
    (path,) = (path for path in files_of("coincid") or () if path.name == LICENCE)
    return path.read_text(encoding="utf-8")


def _list(names: list[str]) -> str:
    return "".join(f"{name}\n" for name in names)


def _constraints(sensor: Sensor, clock_mhz: float, top: str, view: View) -> str:
    period = 1000 / clock_mhz
    lines = [
        f"# Timing of {top} at {clock_mhz:g} MHz; times in ns.",
        f"set period {period:g}",
        "create_clock -name clk -period $period [get_ports clk]",
    ]
    if view.circuit is not None:
        lines += ["", async_constraints(sensor, view.circuit)]
    if top == FPGA_TOP:
        lines.append("# Clock j of the deserialisers comes j ticks after clk, from the same PLL.")
        for j in range(1, sensor.phases // 2):
            rise = period * j / sensor.phases
            edges = f"{{{rise:g} {rise + period / 2:g}}}"
            lines.append(
                f"create_clock -name phase_{j} -period $period -waveform {edges} [get_ports {{{phase_clock(sensor, j)}}}]"
            )
    ports = [
        port
        for port in SensorTop(sensor, view, top == FPGA_TOP).ports()
        if port.name != "phase_clocks"
    ]
    # clocks of their own
    events = {f"spad_{s}" for s in range(sensor.subgroups)} if view.macros else set()
    timed = [
        Port("rst", 1, True),
        *(port for port in ports if not port.name.startswith("line_") and port.name not in events),
    ]
    lines += [
        f"set_clock_uncertainty [expr {UNCERTAINTY} * $period] [all_clocks]",
        *_port_delays([port for port in timed if port.is_input], "input", INPUT_DELAY_MIN),
        *_port_delays([port for port in timed if not port.is_input], "output", OUTPUT_DELAY_MIN),
    ]
    if top == FPGA_TOP:
        lines += _line_skew([port.name for port in ports if port.name.startswith("line_")], sensor)
    return "\n".join(lines) + "\n"


def _port_delays(ports: list[Port], kind: str, at_least: float) -> list[str]:
    """Return the delays outside the ports, at least and at most. kind: input or output."""
    lines = []
    for port in ports:
        name = f"{port.name}[*]" if port.width > 1 else port.name
        for bound, share in (("min", at_least), ("max", PORT_DELAY)):
            lines.append(
                f"set_{kind}_delay -{bound} [expr {share:g} * $period] -clock clk"
                f" [get_ports {{{name}}}]"
            )
    return lines


def _line_skew(lines: list[str], sensor: Sensor) -> list[str]:
    """Return the bounds of the delays from the ports `lines` to the samplers.

    SDC has a bound of the delay only. Vivado and Quartus also know one of the skew.
    """
    ports = " ".join(f"{name}[*]" for name in lines)
    return [
        "# SPADs know no clock: their levels are sampled, and pass two flip-flops before any logic. The delays of a line to",
        "# its samplers must differ by less than a tick; if one of them is later, a single rise becomes two edges.",
        "# A tool without `set_bus_skew` bounds only the delay: read the delays of the samplers after routing.",
        f"set tick [expr $period / {sensor.phases}]",
        f"set lines [get_ports {{{ports}}}]",
        "set_max_delay $period -from $lines",
        "if {[llength [info commands set_bus_skew]]} {",
        f"  set_bus_skew -from $lines -to [get_cells -hierarchical *sample_*] [expr {SKEW_TICKS:g} * $tick]",
        "}",
    ]


def phase_clock(sensor: Sensor, j: int) -> str:
    """Return the name of clock j > 0 of the deserialisers in constraints: a bit of a port, or a
    port of one bit.
    """
    return f"phase_clocks[{j - 1}]" if sensor.phases > 4 else "phase_clocks"


def tool_options(view: View) -> dict[str, list[str]]:
    """Return purpose -> options of a tool. Delays of cells need a time scale; lint reads the
    files for synthesis.
    """
    time = [f"--timescale {TIMESCALE}"] if view.macros else []
    return {
        "icarus": ["-g2012" if view.macros else "-g2005"],
        "verilate": ["--timing", "-fno-inline", *time],
        "lint": ["-Wall", "-fno-inline", *time, *(["-DSYNTHESIS"] if view.macros else [])],
    }


def _core(lists: dict[str, list[str]], of_cells: list[str], view: View) -> str:
    """Return the core file of FuseSoC: for every top the RTL, its constraints, lint, and the smoke
    test on Icarus and Verilator; the RTL for standard cells; and the driver in C.

    of_cells: files of the RTL for standard cells.
    """
    options, boxes = tool_options(view), [path.name for path in view.macros]
    sets: dict[str, Any] = {"waivers": {"files": [CONTROL_FILE], "file_type": "vlt"}}
    sets |= {"cells": _verilog(of_cells), "driver": _driver()}
    targets: dict[str, Any] = {
        "cells": {"filesets": ["cells", "constraints"], "toplevel": TOP},
        "driver": {"filesets": ["driver"]},
    }
    for top, names in lists.items():
        smoke, suffix = PER_TOP[top], _suffix(top)
        rtl, bench = f"rtl{suffix}", f"smoke{suffix}"
        timing = f"constraints{suffix}"
        sets |= {rtl: _verilog(names), bench: _verilog([f"{smoke}.v"])}
        sets |= {timing: {"files": [f"{top}.sdc"], "file_type": "SDC"}}
        linted = ["waivers", rtl, *(["boxes"] if boxes else [])]
        icarus = {"tool": "icarus", "iverilog_options": options["icarus"]}
        verilator = {
            "tool": "verilator",
            "mode": "binary",
            "verilator_options": options["verilate"],
        }
        lint = {"tool": "verilator", "verilator_options": options["lint"]}
        targets |= {
            "default" if top == TOP else "fpga": {"filesets": [rtl, timing], "toplevel": top},
            f"lint{suffix}": {
                "flow": "lint",
                "flow_options": lint,
                "filesets": linted,
                "toplevel": top,
            },
            f"sim{suffix}": {
                "flow": "sim",
                "flow_options": icarus,
                "filesets": [rtl, bench],
                "toplevel": smoke,
            },
            f"verilate{suffix}": {
                "flow": "sim",
                "flow_options": verilator,
                "filesets": ["waivers", rtl, bench],
                "toplevel": smoke,
            },
        }
    if boxes:
        sets["boxes"] = _verilog(boxes)
    about = "SPAD direct time-of-flight sensor with coincidence detection"
    facts = {"name": f"coincid:sensor:{TOP}:{version('coincid')}", "description": about}
    entries = facts | {"filesets": sets, "targets": targets}
    return "\n".join(
        [
            "CAPI=2:",
            *(f"{key}: {json.dumps(value, indent=2)}" for key, value in entries.items()),
            "",
        ]
    )


def _suffix(top: str) -> str:
    """Return what FuseSoC's targets of a top end with."""
    return "" if top == TOP else "_fpga"


def _verilog(names: list[str]) -> dict[str, Any]:
    """Return a file set of Verilog for FuseSoC."""
    return {"files": names, "file_type": "verilogSource"}


def _driver() -> dict[str, Any]:
    """Return the file set of the driver in C for FuseSoC."""
    sources = ["coincid.c"]
    headers = [name for name in (*c_driver(), HEADER) if name.endswith(".h")]
    included = [{name: {"is_include_file": True}} for name in headers]
    return {"files": [*sources, *included], "file_type": "cSource"}


def _readme(config: Config, lists: dict[str, list[str]], view: View) -> str:
    sensor = config.sensor
    options = {tool: " ".join(given) for tool, given in tool_options(view).items()}
    linted = {
        top: SYNTHESIS_LIST if view.macros else FILE_LIST if top == TOP else f"{top}.f"
        for top in lists
    }
    commands = [
        f"verilator --lint-only {options['lint']} --top-module {top} {CONTROL_FILE} -f {names}"
        for top, names in linted.items()
    ]
    smoke = [PER_TOP[top] for top in lists]
    commands += [
        f"iverilog {options['icarus']} -s {top} -o smoke.vvp -f {top}.f && vvp -n smoke.vvp"
        for top in smoke
    ]
    verilator = f"verilator --binary {options['verilate']} --top-module"
    commands += [f"{verilator} {top} {CONTROL_FILE} -f {top}.f && obj_dir/V{top}" for top in smoke]
    targets = [f"{target}{_suffix(top)}" for top in lists for target in TARGETS]
    fusesoc = [
        f"fusesoc --cores-root . run --target {target} coincid:sensor:{TOP}" for target in targets
    ]
    about, of_words, of_lines, of_levels = README_TEXT.read_text(encoding="utf-8").split("---\n")
    tops = [of_lines if view.macros else of_words, *([of_levels] if FPGA_TOP in lists else [])]
    late = deserialiser.CYCLES
    numbers = {
        "phases": sensor.phases,
        "half": sensor.phases // 2,
        "late": late,
        "late_ticks": late * sensor.phases,
    }
    instances = (
        f"## An instance of `{top}`\n\n```verilog\n{instantiation(sensor, top, view)}```"
        for top in lists
    )
    return about.format(
        rows=sensor.rows,
        cols=sensor.cols,
        tops="".join(tops).rstrip().format(**numbers),
        clock_mhz=config.clock_mhz,
        commands="\n".join(f"    {command}" for command in commands),
        oldest=OLDEST_VERILATOR,
        fusesoc="\n".join(f"    {command}" for command in fusesoc),
        ports="\n".join(f"## Ports of `{top}`\n\n{port_table(sensor, top, view)}" for top in lists),
        words=stream_words(sensor, GROUPS),
        delays=", except in `async_cells.v`" if view.macros else "",
        write_cycles=write_cycles_max(sensor),
        read_cycles=read_cycles_max(sensor),
        beside_cycles=max(beats_beside_cycles(sensor, k) for k in range(sensor.streams)),
        largest_frame=max(largest_frame(config, k) for k in range(sensor.streams)),
        pulses=config.pulses,
        period=config.period,
        instances="\n\n".join(instances),
    )


def _manifest(config: Config, files: dict[str, bytes], view: View, prefix: str) -> str:
    sensor, clock_mhz = config.sensor, config.clock_mhz
    tops = [f"{prefix}{top}" for top in PER_TOP if f"{prefix}{top}.sdc" in files]
    facts = {
        "name": f"{prefix}{TOP}",
        "version": version("coincid"),
        "view": view.name,
        "tops": tops,
        "clock_mhz": int(clock_mhz) if clock_mhz.is_integer() else clock_mhz,
        "parameters": {name: getattr(sensor, name) for name in SENSOR} | own_rule(sensor),
        "derived": {name: getattr(sensor, name) for name in DERIVED},
        "latency_cycles": {
            name.lower(): value for name, value in vars(latency).items() if name.isupper()
        }
        | ({"deserialiser": deserialiser.CYCLES} if f"{prefix}{FPGA_TOP}" in tops else {}),
        "sha256": {
            name: hashlib.sha256(content).hexdigest() for name, content in sorted(files.items())
        },
    }
    return json.dumps(facts, indent=2) + "\n"


def write_release(
    folder: Path, config: Config, view: str | View = POLYPHASE, prefix: str = ""
) -> list[Path]:
    """Write the release of a configuration's sensor to `folder`, which appears complete and
    replaces an earlier release with the same prefix; files that are not of a release stay. Return
    the files.

    prefix: of all names of the release (see `prefix.py`), such as "near_". Releases with different
    prefixes may be in one folder.

    Raises `InputError` if the folder cannot be written, or holds other things and no release, or
    if names cannot begin with the prefix.
    """
    given, folder = folder, Path(folder).resolve()
    prefix = checked_prefix(prefix)
    if folder.exists() and not (
        folder.is_dir() and (any(folder.glob(f"*{FILE_LIST}")) or not any(folder.iterdir()))
    ):
        raise InputError(
            f"{given}: holds other things, must be a new or empty folder, or one with an earlier export"
        )
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as error:
        raise InputError(f"{given}: cannot be written: {error.strerror}") from None
    try:
        fresh, stale = beside / "fresh", beside / "stale"
        fresh.mkdir()
        files = _contents(config, view, prefix)
        for name, content in (_other_releases(folder, prefix) | files).items():
            (fresh / name).parent.mkdir(exist_ok=True)
            (fresh / name).write_bytes(content)
        if folder.exists():
            _take_along(folder, fresh)
            folder.rename(stale)
        fresh.rename(folder)
    except BaseException as error:  # also Ctrl-C
        if stale.exists() and not folder.exists():
            stale.rename(folder)
        if isinstance(error, OSError):
            raise InputError(f"{given}: cannot be written: {error.strerror}") from None
        raise
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return sorted(folder / name for name in files)


def _take_along(folder: Path, fresh: Path) -> None:
    """Copy what is in `folder` and of no release to `fresh`: files, links and folders."""
    released = {Path(name) for names in _releases(folder).values() for name in names}
    released |= {name.parent for name in released}
    for path in folder.rglob("*"):
        name = path.relative_to(folder)
        if name in released or os.path.lexists(fresh / name):
            continue
        (fresh / name).parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir() and not path.is_symlink():
            (fresh / name).mkdir()
        else:
            shutil.copy2(path, fresh / name, follow_symlinks=False)


def _releases(folder: Path) -> dict[str, list[str]]:
    """Return the files of each release in `folder`, its manifest among them, by the manifest's
    name.
    """
    releases = {}
    for manifest in folder.glob(f"*{MANIFEST}"):
        facts = _json(manifest)
        named = manifest.name.removesuffix(MANIFEST) + TOP
        # somebody else's file may have a name that ends like that of a manifest
        if not isinstance(facts, dict) or facts.get("name") != named:
            continue
        if isinstance(facts.get("sha256"), dict):
            releases[manifest.name] = [manifest.name, *facts["sha256"]]
    return releases


def _json(path: Path) -> Any:
    """Return the content of a JSON file, or None if it is none."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None


def _contents(config: Config, view: str | View, prefix: str) -> dict[str, bytes]:
    """Return the files of a release by name, with its manifest."""
    texts = prefixed_files(release_files(config, view), prefix)
    files = {name: text.encode() for name, text in texts.items()}
    for name, content in captured_files(config.sensor).items():
        files[prefixed_name(name, prefix)] = content
    manifest = _manifest(config, files, view_at(view, config.clock_mhz), prefix)
    return files | {f"{prefix}{MANIFEST}": manifest.encode()}


def _other_releases(folder: Path, prefix: str) -> dict[str, bytes]:
    """Return the files by name of the releases in `folder` that have other prefixes. Files that are
    not there any more, as their owner may have deleted them, are left out.
    """
    releases = _releases(folder)
    releases.pop(f"{prefix}{MANIFEST}", None)
    names = [name for of_release in releases.values() for name in of_release]
    return {name: (folder / name).read_bytes() for name in names if (folder / name).is_file()}
