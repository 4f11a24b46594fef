# SPDX-License-Identifier: Apache-2.0
"""What it would take that the tree arms again within a cycle: two windows per cycle, as two circuits, and their cost.

`python -m coincid.study.rearm` prints the table of docs/returns.md. Only the windows' timing is built: no pixels, no guard,
no re-arm gap. In the tree as it is, one window opens per cycle at most (`hdl/tree.py`), and only the loop from a window's
end to the next window's state must fit into a cycle. `Twice` looks for the second window when the first one has ended.
`Ahead` computes for every phase at which a window may end which window follows, before it is known which phase it is.
"""

import json
import tempfile
from collections import Counter
from pathlib import Path

from amaranth.hdl import Array, C, Cat, Module, Mux, Signal, Value
from amaranth.lib.wiring import In, Out

from ..flow.levels import longest_paths
from ..flow.synth import SPEED
from ..flow.yosys import generic_script
from ..hdl.export import units_files
from ..hdl.logic import first_one
from ..hdl.unit import Unit
from ..model.contract.parameters import Sensor
from ..tools.wheels import run_yosys

WINDOWS = 2  # that may open in one cycle
FLIP_FLOP, INVERTER = "$_DFF_P_", "$_NOT_"


class Windows(Unit):
    """Windows of a subgroup.

    Ports
    -----
    root : in, phases in which a pixel has an edge; window_ticks : in
    opened, closed : out, of each window that may open in the cycle, and of one from an earlier cycle before them: `opened` bit 0
        and `closed` bit 0 belong to the first window that is open in the cycle
    phase_0, phase_1 : out, where `opened`: the phase at which it opens

    The outputs are `latency` cycles behind the ports.
    """

    latency: int

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        ports = {"root": In(sensor.phases), "window_ticks": In(sensor.window_bits)}
        phases = {f"phase_{k}": Out(sensor.phase_bits) for k in range(WINDOWS)}
        super().__init__(**ports, opened=Out(WINDOWS), closed=Out(WINDOWS), **phases)


class Twice(Windows):
    """Looks for the second window behind the end of the first one."""

    unit_name, latency = "window_twice", 3

    def elaborate(self, platform: object) -> Module:
        m = Module()
        phases = self.sensor.phases
        window, root_1, root = Signal(self.sensor.window_bits), Signal(phases), Signal(phases)
        some, first = first_one(m, root_1, "first")
        any_2, phase_2 = Signal(), Signal(self.sensor.phase_bits)
        m.d.sync += [
            window.eq(self.window_ticks),
            root_1.eq(self.root),
            root.eq(root_1),
            any_2.eq(some),
            phase_2.eq(first),
        ]
        is_open, left = Signal(), Signal(range(self.sensor.window_max + phases))
        end = Signal.like(left)
        closing, again, last = Signal(), Signal(), Signal.like(left)
        behind = Signal(phases)
        m.d.comb += [
            end.eq(Mux(is_open, left, phase_2 + window)),
            closing.eq((is_open | any_2) & (end <= phases)),
            behind.eq(root & Cat(C(phase) >= end for phase in range(phases))),
        ]
        some_more, next_phase = first_one(m, behind, "again")
        m.d.comb += [again.eq(closing & some_more), last.eq(Mux(again, next_phase + window, end))]
        m.d.sync += [
            is_open.eq(Mux(closing, again, is_open | any_2) & (last > phases)),
            left.eq(last - phases),
            self.opened.eq(Cat(~is_open & any_2, again)),
            self.closed.eq(Cat(closing, again & (last <= phases))),
            self.phase_0.eq(phase_2),
            self.phase_1.eq(next_phase),
        ]
        return m


class Ahead(Windows):
    """Has a table of the next window by the phase at which the one before it ends; only its look-up is in the loop."""

    unit_name, latency = "window_ahead", 6

    def elaborate(self, platform: object) -> Module:
        m = Module()
        phases, bits = self.sensor.phases, self.sensor.window_bits + 1
        window, root = Signal(self.sensor.window_bits), Signal(phases)
        m.d.sync += [window.eq(self.window_ticks), root.eq(self.root)]
        some, phase = self._next_edges(m, root)
        some, phase = self._later(m, some, "some_2"), self._later(m, phase, "phase_2")
        end = self._later(m, [one + window for one in phase], "end_3")
        some, phase = self._later(m, some, "some_3"), self._later(m, phase, "phase_3")
        # If no window is open, the first edge opens one: all of this cycle is known before the loop.
        second = end[0][: self.sensor.phase_bits]
        inside = some[0] & (end[0] < phases)
        known = [some[0], phase[0], end[0], inside & Array(some)[second], Array(phase)[second], Array(end)[second]]
        any_4, phase_4, end_4, again_4, next_4, last_4 = self._later(m, known, "fresh_4")
        fresh = [
            any_4 & ((end_4 > phases) | (again_4 & (last_4 > phases))),
            (Mux(again_4, last_4, end_4) - phases)[:bits],
            Cat(any_4, again_4),
            Cat(any_4 & (end_4 <= phases), again_4 & (last_4 <= phases)),
            phase_4,
            next_4,
        ]
        fresh = self._later(m, fresh, "fresh_5")
        tables = [some, phase, [a & (e > phases) for a, e in zip(some, end)], [(e - phases)[:bits] for e in end]]
        for stage in (4, 5):
            tables = [self._later(m, table, f"table_{stage}_{k}") for k, table in enumerate(tables)]
        is_open, left = Signal(), Signal(bits)
        more, next_phase, stays, rest = (Array(table)[left[: self.sensor.phase_bits]] for table in tables)
        here, again = Signal(), Signal()
        m.d.comb += [here.eq(left <= phases), again.eq((left < phases) & more)]
        with m.If(is_open):
            m.d.sync += [
                is_open.eq(~here | ((left < phases) & stays)),
                left.eq(Mux(here, rest, left - phases)),
                self.opened.eq(Cat(C(0, 1), again)),
                self.closed.eq(Cat(here, again & ~stays)),
                self.phase_1.eq(next_phase),
            ]
        with m.Else():
            outputs = (is_open, left, self.opened, self.closed, self.phase_0, self.phase_1)
            m.d.sync += [output.eq(value) for output, value in zip(outputs, fresh)]
        return m

    def _next_edges(self, m: Module, root: Signal) -> tuple[list[Value], list[Value]]:
        """Return (whether there is an edge, its phase) at or after each phase, in steps that double."""
        phases, bits = self.sensor.phases, self.sensor.phase_bits
        some: list[Value] = list(root)
        phase: list[Value] = [C(k, bits) for k in range(phases)]
        step = 1
        while step < phases:
            wider = [
                (Signal(name=f"some_{step}_{k}"), Signal(bits, name=f"phase_{step}_{k}")) for k in range(phases - step)
            ]
            for k, (any_edge, at) in enumerate(wider):
                m.d.comb += [any_edge.eq(some[k] | some[k + step]), at.eq(Mux(some[k], phase[k], phase[k + step]))]
            some = [any_edge for any_edge, _ in wider] + some[phases - step :]
            phase = [at for _, at in wider] + phase[phases - step :]
            step *= 2
        return some, phase

    def _later(self, m: Module, values: list[Value], name: str) -> list[Value]:
        """Return registers that hold the values one cycle later."""
        registers = [Signal(len(Value.cast(value)), name=f"{name}_{k}") for k, value in enumerate(values)]
        m.d.sync += [register.eq(value) for register, value in zip(registers, values)]
        return registers


def cost(unit: Unit) -> tuple[int, int, int]:
    """Return (levels, gates, flip-flops) as `make synth` counts them. Raises `ToolchainError`."""
    files = units_files([unit])
    mapping = ["dfflegalize -cell $_DFF_P_ x", f"abc -g gates -script {SPEED}", "opt_clean", "write_json netlist.json"]
    script = [f"read_verilog -sv {' '.join(files)}", *generic_script(unit.unit_name, flatten=True), *mapping, ""]
    with tempfile.TemporaryDirectory(prefix="coincid-rearm-") as folder:
        for name, text in files.items():
            Path(folder, name).write_text(text)
        run_yosys(Path(folder), "\n".join(script))
        module = json.loads(Path(folder, "netlist.json").read_text())["modules"][unit.unit_name]
    kinds = Counter(cell["type"] for cell in module["cells"].values())
    flip_flops = kinds.pop(FLIP_FLOP)
    kinds.pop(INVERTER, None)
    return max(path.levels for path in longest_paths(module).values()), kinds.total(), flip_flops


def main() -> None:
    print("| circuit | levels | gates | flip-flops | cycles of latency |\n| --- | ---: | ---: | ---: | ---: |")
    for unit in (Twice(Sensor()), Ahead(Sensor())):
        levels, gates, flip_flops = cost(unit)
        print(f"| {unit.unit_name} | {levels} | {gates} | {flip_flops} | {unit.latency} |")


if __name__ == "__main__":
    main()
