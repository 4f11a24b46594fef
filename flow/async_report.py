"""Clock domains and asynchronous resets of the asynchronous view, as Yosys finds them, and the constraints that go with them.

The netlist of a module with its macros as black boxes is what the report reads; nothing is said that is not in it. Latches are refused.
"""

import json
import re
import sys
from collections import Counter
from pathlib import Path

from attrs import frozen

from ..hdl.async_circuit import CLOCK_FS, MACROS, Circuit
from ..hdl.async_constraints import FS_PER_NS, SYSTEM, constraints
from ..hdl.export import units_files
from ..hdl.module import SensorModule
from ..hdl.views import Asynchronous
from ..model.parameters import Sensor
from .yosys import LIBERTY, run_yosys, standard_cells

MACRO_NAMES = ("coincid_phases", "coincid_window", "coincid_delay", "coincid_mutex")
FLOP = re.compile(r"\$_?(s?dffe?|adffe?|aldffe?|dffsre?|sdffce)_?$")
LATCH = re.compile(r"\$_?(dlatch|adlatch|sr)")


@frozen
class Domain:
    """Flops of one kind of clock. clock: its net, `*` for numbers; reset: net of an asynchronous reset, or ''."""

    clock: str
    falling: bool
    reset: str
    clocks: int
    flops: int


def netlist(sensor: Sensor, circuit: Circuit, folder: Path) -> dict:
    """The flattened netlist of a module as Yosys writes it: cells generic, macros black boxes."""
    view = Asynchronous(circuit)
    module = SensorModule(sensor, min(2, sensor.subgroups), view)
    files = units_files([module]) | {path.name: path.read_text() for path in (*view.cells, MACROS)}
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    run_yosys(
        f"read_verilog -sv {' '.join(files)}\nhierarchy -check -top {module.unit_name}\nproc\nflatten\nopt_clean\nmemory -nomap\n"
        "check -assert\nwrite_json netlist.json\n", folder,
    )
    return json.loads((folder / "netlist.json").read_text())["modules"][module.unit_name]


def mapped(folder: Path, top: str) -> dict[str, int]:
    """Standard cells and macros that the files of `netlist` in `folder` become: type -> number."""
    standard_cells()
    (folder / LIBERTY.name).write_bytes(LIBERTY.read_bytes())
    files = " ".join(sorted(path.name for path in folder.glob("*.v")))
    run_yosys(
        f"read_liberty -lib {LIBERTY.name}\nread_verilog -sv {files}\nhierarchy -check -top {top}\n"
        f"synth -flatten -top {top}\ndfflibmap -liberty {LIBERTY.name}\nabc -liberty {LIBERTY.name}\nopt_clean\ncheck -assert\n"
        "tee -q -o cells.json stat -json\n", folder,
    )
    return json.loads((folder / "cells.json").read_text())["design"]["num_cells_by_type"]


def latches(module: dict) -> list[str]:
    """Names of the latches in a netlist: there must be none, as the macros hold all that are meant."""
    return sorted(name for name, cell in module["cells"].items() if LATCH.match(cell["type"]))


def domains(module: dict) -> list[Domain]:
    """The flops of a netlist by clock and asynchronous reset."""
    names: dict[int, str] = {}
    for name, net in sorted(module["netnames"].items(), key=lambda item: (item[1].get("hide_name", 0), len(item[0]), item[0])):
        for i, bit in enumerate(net["bits"]):
            if isinstance(bit, int):
                names.setdefault(bit, name + (f"[{i}]" if len(net["bits"]) > 1 else ""))
    drivers = {
        bit: cell for cell in module["cells"].values() if cell["type"] in ("$not", "$_NOT_")
        for bit in cell["connections"]["Y"]
    }

    def source(bit, inverted=False):
        while bit in drivers:
            cell = drivers[bit]
            bit, inverted = cell["connections"]["A"][cell["connections"]["Y"].index(bit)], not inverted
        return bit, inverted

    flops, clocks = Counter(), {}
    for cell in module["cells"].values():
        if not FLOP.match(cell["type"]):
            continue
        pins, parameters = cell["connections"], cell["parameters"]
        bit, inverted = source(pins["CLK"][0])
        falling = inverted ^ (int(parameters["CLK_POLARITY"], 2) == 0)
        reset = general(names.get(pins["ARST"][0], "constant")) if "ARST" in pins else ""
        key = general(names[bit]), falling, reset
        flops[key] += len(pins["Q"])
        clocks.setdefault(key, set()).add(bit)
    return [Domain(*key, len(clocks[key]), count) for key, count in sorted(flops.items())]


def general(name: str) -> str:
    """A net's name without its instance's numbers."""
    return re.sub(r"\d+", "*", re.sub(r"\$\d+", "", name))


def report(sensor: Sensor, circuit: Circuit, module: dict) -> str:
    """The report, Markdown."""
    macros = Counter(cell["type"].split("$paramod")[-1].strip("\\").split("\\")[0] for cell in module["cells"].values())
    lines = [
        "# Clock domains and asynchronous resets of the asynchronous view", "",
        f"A module of {min(2, sensor.subgroups)} subgroups of {sensor.pixels} SPADs, {circuit.banks_of(sensor)} window bank(s), "
        f"R = {sensor.rearm}; read from its netlist. `*` stands for a number.", "",
        "| clock | edge | nets | flip-flops | asynchronous reset |", "| --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| `{d.clock}` | {'falling' if d.falling else 'rising'} | {d.clocks} | {d.flops} | {f'`{d.reset}`' if d.reset else 'none'} |"
        for d in domains(module)
    ]
    lines += ["", "| macro (black box) | instances |", "| --- | --- |"]
    lines += [f"| `{name}` | {sum(n for kind, n in macros.items() if name in kind)} |" for name in MACRO_NAMES]
    return "\n".join([*lines, "", f"Latches outside the macros: {len(latches(module))}.", ""])


def module_constraints(sensor: Sensor) -> str:
    """SDC of the module that the report reads."""
    return f"create_clock -name {SYSTEM} -period {CLOCK_FS / FS_PER_NS:g} [get_ports {SYSTEM}]\n{constraints(sensor, 'words_*')}"


def write(sensor: Sensor, circuit: Circuit, folder: Path) -> list[Path]:
    """Writes netlist, report and constraints of a sensor to `folder`; raises `ValueError` where the netlist has a latch."""
    module = netlist(sensor, circuit, folder)
    if found := latches(module):
        raise ValueError(f"latches outside the macros: {', '.join(found)}")
    files = {"domains.md": report(sensor, circuit, module), "coincid_async.sdc": module_constraints(sensor)}
    for name, text in files.items():
        (folder / name).write_text(text)
    return [folder / name for name in files]


if __name__ == "__main__":
    for path in write(Sensor(), Circuit(), Path(sys.argv[1] if sys.argv[1:] else "build/async")):
        print(path)
