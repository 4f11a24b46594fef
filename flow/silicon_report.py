# SPDX-License-Identifier: Apache-2.0
"""Clock domains and asynchronous resets of the asynchronous view, from the netlist of a module,
and its constraints.

Yosys makes the netlist, in which macros are black boxes. A latch in it is an error. OpenSTA
reads the constraints and must
not complain: it finds every object, and every flop has a clock.
"""

import json
import re
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from attrs import frozen

from ..hdl.export import units_files
from ..hdl.front_end_views import Asynchronous
from ..hdl.silicon.circuit import MACROS, Circuit
from ..hdl.subgroup_pair import SensorModule
from ..model.contract.parameters import Sensor
from ..model.shared import markdown
from ..tools.wheels import run_program, run_yosys
from .async_constraints import FS_PER_NS, SYSTEM, async_constraints
from .mapped import without_parameters
from .yosys import ENABLES, LIBERTY, cells_script, library_files

MAPPED, TIMED = "mapped.v", "timed.v"
CLOCKS = (SYSTEM, "spads", "roots", "minigroups", "ends", "taps", "mark")
FLOP = re.compile(r"\$_?(s?dffe?|adffe?|aldffe?|dffsre?|sdffce)_?$")
LATCH = re.compile(r"\$_?(dlatch|adlatch|sr)")


@frozen
class Domain:
    """Flops with the same kind of clock. clock: its net, with `*` for numbers; reset: the net of
    an asynchronous reset, or "".
    """

    clock: str
    falling: bool
    reset: str
    flops: int


def netlist(sensor: Sensor, circuit: Circuit, folder: Path) -> tuple[str, dict[str, Any]]:
    """Return the name and the flattened netlist of a module from Yosys, in generic cells and
    black boxes.
    """
    module = SensorModule(sensor, min(2, sensor.subgroups), Asynchronous(circuit))
    files = units_files([module]) | {
        path.name: path.read_text(encoding="utf-8") for path in (*Asynchronous.cells, MACROS)
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    run_yosys(
        folder,
        f"read_verilog -sv {' '.join(files)}",
        f"hierarchy -check -top {module.unit_name}",
        "proc; flatten; opt_clean; memory -nomap",
        "check -assert",
        "write_json netlist.json",
    )
    return module.unit_name, json.loads((folder / "netlist.json").read_text(encoding="utf-8"))[
        "modules"
    ][module.unit_name]


def mapped(folder: Path, top: str) -> None:
    """Map the files of `netlist` in `folder` to standard cells. The hierarchy stays."""
    for name, text in library_files().items():
        (folder / name).write_text(text, encoding="utf-8")
    ours = {MAPPED, TIMED, ENABLES.name}
    files = " ".join(sorted(path.name for path in folder.glob("*.v") if path.name not in ours))
    run_yosys(
        folder,
        f"read_liberty -lib {LIBERTY}",
        f"read_verilog -sv {files}",
        *cells_script(top, gated=False),
        "check -assert",
        f"write_verilog -noexpr -noattr -simple-lhs {MAPPED}",
    )


def timing(
    folder: Path, top: str, sdc: str
) -> tuple[list[str], list[tuple[str, str, float, float]]]:
    """Return the complaints of OpenSTA about the constraints `sdc` on the netlist of `mapped`,
    and the longest paths.

    A path is (from clock, to clock, ns required, ns taken), without wires. Macros and the gates
    of the OR tree are black boxes.
    """
    text = without_parameters((folder / MAPPED).read_text(encoding="utf-8"))
    text = re.sub(
        r"^module \S*coincid_or2.*?^endmodule\n", "", text, flags=re.MULTILINE | re.DOTALL
    )
    (folder / TIMED).write_text(text, encoding="utf-8")
    lines = [
        f"read_liberty {LIBERTY}",
        f"read_verilog {TIMED}",
        f"link_design {top}",
        f"read_sdc {sdc}",
    ]
    lines += ["check_setup -no_clock -loops -generated_clocks", 'puts "PATHS"']
    report = "report_checks -path_delay max -format end"
    lines += [
        f'puts "{a} {b}"; {report} -from [get_clocks {a}] -to [get_clocks {b}]'
        for a in CLOCKS
        for b in CLOCKS
    ]
    (folder / "timing.tcl").write_text("\n".join([*lines, ""]), encoding="utf-8")
    head, paths = run_program(["sta", "-exit", "timing.tcl"], folder, "sta").split("PATHS\n")
    complaints = [
        line
        for line in head.splitlines()
        if re.match("Error|Warning", line) and "black box" not in line
    ]
    ends = re.compile(
        r"^(\w+) (\w+)\n(?:(?!^\w+ \w+$).*\n)*?\S+ \(\w+\) +(-?[\d.]+) +(-?[\d.]+) ", re.MULTILINE
    )
    return complaints, [
        (a, b, float(required), float(taken)) for a, b, required, taken in ends.findall(paths)
    ]


def latches(module: dict[str, Any]) -> list[str]:
    """Return the latches in a netlist. There must be none, because all intended ones are inside
    macros.
    """
    return sorted(name for name, cell in module["cells"].items() if LATCH.match(cell["type"]))


def domains(module: dict[str, Any]) -> list[Domain]:
    """Return the flops of a netlist by clock and asynchronous reset."""
    names: dict[int, str] = {}
    for name, net in sorted(
        module["netnames"].items(),
        key=lambda item: (item[1].get("hide_name", 0), len(item[0]), item[0]),
    ):
        for i, bit in enumerate(net["bits"]):
            if isinstance(bit, int):
                names.setdefault(bit, name + (f"[{i}]" if len(net["bits"]) > 1 else ""))
    inverters = {
        bit: cell["connections"]
        for cell in module["cells"].values()
        if cell["type"] in ("$not", "$_NOT_")
        for bit in cell["connections"]["Y"]
    }
    flops: Counter[tuple[str, bool, str]] = Counter()
    for cell in module["cells"].values():
        if FLOP.match(cell["type"]):
            pins = cell["connections"]
            bit, falling = pins["CLK"][0], int(cell["parameters"]["CLK_POLARITY"], 2) == 0
            while inverter := inverters.get(bit):
                bit, falling = inverter["A"][inverter["Y"].index(bit)], not falling
            reset = general(names.get(pins["ARST"][0], "constant")) if "ARST" in pins else ""
            flops[general(names[bit]), falling, reset] += len(pins["Q"])
    return [Domain(*key, count) for key, count in sorted(flops.items())]


def general(name: str) -> str:
    """Return a net's name without the numbers of its instance."""
    return re.sub(r"\d+", "*", re.sub(r"\$\d+", "", name))


def report(
    sensor: Sensor,
    circuit: Circuit,
    module: dict[str, Any],
    paths: list[tuple[str, str, float, float]],
) -> str:
    """Return the report as Markdown. paths: from `timing`."""
    flops = (
        (
            f"`{d.clock}`",
            "falling" if d.falling else "rising",
            d.flops,
            f"`{d.reset}`" if d.reset else "none",
        )
        for d in domains(module)
    )
    longest = ((a, b, f"{required:.2f}", f"{taken:.2f}") for a, b, required, taken in paths)
    lines = [
        "# Clock domains and asynchronous resets of the asynchronous view",
        "",
        f"A module of {min(2, sensor.subgroups)} subgroups of {sensor.pixels} SPADs, {circuit.banks_of(sensor)} window bank(s), "
        f"R = {sensor.rearm}; read from its netlist. `*` stands for a number. There is no latch outside the macros.",
        "",
        *markdown.table(
            ["clock", "edge", "flip-flops", "asynchronous reset"], flops, left=range(4)
        ),
        "",
        f"Longest paths in NanGate 45 nm cells, without wires, against the constraints for a cycle of {circuit.clock_fs / FS_PER_NS:g} ns:",
        "",
        *markdown.table(
            ["from clock", "to clock", "required ns", "taken ns"], longest, left=range(2)
        ),
        "",
    ]
    return "\n".join(lines)


def write(sensor: Sensor, circuit: Circuit, folder: Path) -> tuple[str, Path, Path]:
    """Write netlists, report and constraints of a sensor to `folder`; return the module's name,
    and the paths of the last two.

    Raises `ValueError` if a netlist has a latch, or if the timing tool complains about the
    constraints.
    """
    top, module = netlist(sensor, circuit, folder)
    text, sdc = folder / "domains.md", folder / "coincid_async.sdc"
    clock = (
        f"create_clock -name {SYSTEM} -period {circuit.clock_fs / FS_PER_NS:g} [get_ports {SYSTEM}]"
    )
    sdc.write_text(f"{clock}\n{async_constraints(sensor, circuit, 'words_*')}", encoding="utf-8")
    mapped(folder, top)
    complaints, paths = timing(folder, top, sdc.name)
    if found := [*latches(module), *complaints]:
        raise ValueError(
            f"latches outside the macros, or constraints that do not hold on: {', '.join(found)}"
        )
    text.write_text(report(sensor, circuit, module, paths), encoding="utf-8")
    return top, text, sdc


if __name__ == "__main__":
    _, *written = write(Sensor(), Circuit(), Path(sys.argv[1] if sys.argv[1:] else "build/async"))
    print(*written, sep="\n")
