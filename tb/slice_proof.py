# SPDX-License-Identifier: Apache-2.0
"""Proof that the array's module is two slices. The sliced engine needs it before it plays anything.

The sensor is an array of modules (two subgroups and the TDC that they share); the engine plays
an array of slices. Yosys proves by induction that both give their subgroups the same inputs, and
the same ports, in every cycle. The subgroups are the same block on both sides, so they are boxes
whose outputs can be anything.
"""

from pathlib import Path

from ..hdl.front_end_views import POLYPHASE
from ..hdl.subgroup import Subgroup, own_ports
from ..hdl.subgroup_pair import SensorModule, Slice
from ..hdl.unit import Port, Unit
from ..model.contract.parameters import Sensor
from ..model.shared.folders import build_root
from ..tools.build import ToolchainError
from ..tools.wheels import yosys_once
from .rtl_errors import SimulationError

STEPS = 6  # of the induction: then all registers except the TDC's count follow from the inputs
BOX, TWO = "box.v", "two.v"


def prove_module(sensor: Sensor, files: list[Path]) -> None:
    """Raise `SimulationError` unless the module in these files is two slices; asked once for the
    same files.
    """
    module, piece, subgroup = SensorModule(sensor), Slice(sensor), Subgroup(sensor)
    needed = {
        unit.unit_name
        for unit in (module, piece, *(POLYPHASE.tdc(sensor, lines) for lines in (1, module.lines)))
    }
    texts = {path.name: path.read_text(encoding="utf-8") for path in files if path.stem in needed}
    texts[BOX] = f"(* blackbox *) {_head(subgroup)}\nendmodule\n"
    texts[TWO] = _two(module, piece, sensor)
    script = [
        f"read_verilog {' '.join(texts)}",
        "hierarchy",
        "proc",
        f"flatten two {module.unit_name}",
        "cd two",
        *(f"rename slice_{k}.subgroup_0 subgroup_{k}" for k in range(module.lines)),
        "cd ..",
        "opt_clean",
        f"equiv_make {module.unit_name} two both",
        "hierarchy -top both",
        f"delete both/t:{subgroup.unit_name}",
        "techmap",
        "equiv_simple",
        f"equiv_induct -seq {STEPS}",
        "equiv_status -assert",
    ]

    try:
        yosys_once(build_root() / "slices" / "module", texts, script)
    except ToolchainError as error:
        if "Unproven $equiv" not in str(error):
            raise
        raise SimulationError(
            "the module of the array is not two slices, so the sliced engine cannot play this RTL; verilator and icarus can"
        ) from error


def _declared(port: Port) -> str:
    return f"{'input' if port.is_input else 'output'} [{port.width - 1}:0] {port.name}"


def _head(unit: Unit, name: str = "") -> str:
    return f"module {name or unit.unit_name}(input clk, input rst, {', '.join(map(_declared, unit.ports()))});"


def _two(module: SensorModule, piece: Slice, sensor: Sensor) -> str:
    """Return a module with the ports of the array's, made of slices."""
    own = own_ports(sensor)
    lines = [_head(module, "two")]
    for k in range(module.lines):
        wires = {
            port.name: f"{port.name}_{k}" if port.name in own else port.name
            for port in piece.ports()
        }
        wires |= {"clk": "clk", "rst": "rst", "number": f"{{number, 1'd{k}}}"}
        lines.append(
            f"  {piece.unit_name} slice_{k}({', '.join(f'.{port}({wire})' for port, wire in wires.items())});"
        )
    return "\n".join([*lines, "endmodule", ""])
