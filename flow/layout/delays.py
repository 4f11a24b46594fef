# SPDX-License-Identifier: Apache-2.0
"""Simulation of the sensor with a routed block and its delays, with the same checks as for the RTL.

The rest of the sensor is RTL without delays. Inside the block the clock arrives late, because it
passes the clock tree. So the inputs of the block change `INPUT_NS` after the edge of the clock,
as the outputs of flip-flops do.
"""

import re
from collections.abc import Collection
from pathlib import Path

from ...hdl.front_end_views import View
from ...hdl.unit import Port, Unit
from ...model.contract.parameters import TOP, Sensor
from ...tb import toolchain
from ...tb.rtl import rtl, sensor_key
from ..gls import FRAMES, cell_models, played, random_frames
from .flow import CLOCK, SDF, VERILOG

INPUT_NS = 0.4


def shell(unit: Unit, routed: Collection[str], sdf: Path) -> str:
    """Return a module that has the ports of a block and contains its routed netlist.

    routed: the ports of the netlist, each of one bit. sdf: file with the delays of the netlist.
    """
    ports = [Port(CLOCK, 1, True), Port("rst", 1, True), *unit.ports()]
    kept = {name.replace("__", "_") for name in routed}
    lines = [
        "`timescale 1ns/1ps",
        f"module {unit.unit_name} ({', '.join(escaped(port.name) for port in ports)});",
    ]
    pins = []
    for port in ports:
        name, bits = port.name, port.width
        lines.append(f"  {'input' if port.is_input else 'output'} [{bits - 1}:0] {escaped(name)};")
        inner = escaped(name)
        if port.is_input and name != CLOCK:
            inner = f"late_{name}"
            lines += [
                f"  wire [{bits - 1}:0] {inner};",
                f"  assign #{INPUT_NS} {inner} = {escaped(name)};",
            ]
        for bit in range(bits):
            pin = (f"{name}_{bit}" if bits > 1 else name).replace("__", "_")  # as Coriolis has it
            if pin in kept:
                pins.append(f"    .{pin}({inner}[{bit}])")
    lines += [f"  {unit.unit_name}_routed routed (", ",\n".join(pins), "  );"]
    return "\n".join([*lines, f'  initial $sdf_annotate("{sdf}", routed);', "endmodule", ""])


def escaped(name: str) -> str:
    """Return a name for Verilog, even if it is a keyword."""
    return f"\\{name} "


def scaled(sdf: str, factor: float) -> str:
    """Return an SDF text with every delay multiplied by a factor."""
    return re.sub(
        r"\(([-\d.]+):([-\d.]+):([-\d.]+)\)",
        lambda found: (
            "(" + ":".join(f"{factor * float(value):.4f}" for value in found.groups()) + ")"
        ),
        sdf,
    )


def play_with_delays(
    sensor: Sensor, unit: Unit, layout: Path, factor: float, view: View
) -> tuple[int, int]:
    """Play random frames through a sensor with a routed block, whose delays are multiplied by
    `factor`.

    layout: the folder of the block's netlist and delays. Returns the number of checked words and
    commits, and the cycles. Raises `Mismatch` at the first difference.
    """
    name, folder = unit.unit_name, layout / f"delays-{factor:g}"
    folder.mkdir(exist_ok=True)
    sdf, routed = folder / SDF, (layout / VERILOG).read_text(encoding="utf-8")
    sdf.write_text(scaled((layout / SDF).read_text(encoding="utf-8"), factor), encoding="utf-8")
    ports = re.findall(r"^  (?:input|output) (\w+);", routed, re.MULTILINE)
    (folder / "routed.v").write_text(
        f"`timescale 1ns/1ps\n{routed.replace(f'module {name} ', f'module {name}_routed ', 1)}",
        encoding="utf-8",
    )
    (folder / f"{name}.v").write_text(shell(unit, ports, sdf), encoding="utf-8")
    (folder / "cells.v").write_text(cell_models(), encoding="utf-8")
    others = [path for path in rtl(sensor, view) if path.stem != name]
    sources = [*others, folder / f"{name}.v", folder / "routed.v", folder / "cells.v"]
    key = f"routed-{sensor_key(sensor, view)}-{factor:g}"
    build = toolchain.build("icarus", sources, TOP, key=key, options=["-gspecify"])
    return played(build, random_frames(sensor, FRAMES), key, lines=not view.by_words)
