# SPDX-License-Identifier: Apache-2.0
"""Memory: rows that are written occasionally and can be read at any time.

In simulation and on FPGAs it is a memory (LUT RAM on an FPGA). In silicon, a block with rows of
latches has the same name, and less than half the area of flip-flops. The paper names only
registers; the latches are our choice.
"""

from typing import Any

from amaranth.hdl import Module
from amaranth.lib import memory
from amaranth.lib.wiring import In, Out

from ..model.contract.parameters import bits_for
from .unit import Unit


class Memory(Unit):
    """`depth` rows of `width` bits.

    Ports
    -----
    write : in, data goes into row `to` at the cycle's end; data : in
    row : in, number of the row to read; value : out, that row, combinational (no `to` and `row` if
        there is one row)
    test_enable : in, for a test of the chip: latches are transparent, so every row shows `data`;
        other forms of the memory ignore it

    `write`, `to` and `data` come from registers, through at most half a cycle of logic: the latches
    are open in the second half of the cycle. A row must therefore not be used in the cycle in which
    it is written. There is no reset: a row that was never written is undefined.
    """

    def __init__(self, depth: int, width: int):
        self.depth, self.width = depth, width
        self.unit_name = f"coincid_memory_{depth}x{width}"
        bits = bits_for(depth - 1)
        super().__init__(
            write=In(1),
            test_enable=In(1),
            data=In(width),
            value=Out(width),
            **self.at(to=In(bits), row=In(bits)),
        )

    def at(self, **places: Any) -> dict[str, Any]:
        """Return what belongs to the ports `to` and `row`; nothing if there is one row."""
        return places if self.depth > 1 else {}

    def elaborate(self, platform):
        m = Module()
        m.submodules.rows = rows = memory.Memory(shape=self.width, depth=self.depth, init=[])
        writes = rows.write_port()
        reads = rows.read_port(domain="comb")
        m.d.comb += [writes.en.eq(self.write), writes.data.eq(self.data), self.value.eq(reads.data)]
        if self.depth > 1:
            m.d.comb += [writes.addr.eq(self.to), reads.addr.eq(self.row)]
        self.rows = rows
        return m

    def for_cells(self) -> str:
        """Return the block's Verilog with latches; each row has a write line that is high in the
        second half of its cycle.
        """
        ports = (
            {"to": bits_for(self.depth - 1), "row": bits_for(self.depth - 1)}
            if self.depth > 1
            else {}
        )
        ranges = {"data": self.width} | ports
        lines = [
            f"module {self.unit_name} (clk, rst, write, test_enable, value, {', '.join(ranges)});",
            "  input clk, rst, write, test_enable;",
        ]
        lines += [f"  input [{width - 1}:0] {name};" for name, width in ranges.items()]
        lines += [f"  output [{self.width - 1}:0] value;"]
        read = []
        for r in range(self.depth):
            written = "write" if self.depth == 1 else f"write & to == {r}"
            lines += [
                f"  reg [{self.width - 1}:0] row_{r};",
                f"  wire open_{r} = test_enable | ~clk & ({written});",
                f"  always @* if (open_{r}) row_{r} = data;",
            ]
            read.append(
                f"row_{r}" if self.depth == 1 else f"({{{self.width}{{row == {r}}}}} & row_{r})"
            )
        lines += [f"  assign value = {' | '.join(read)};", "endmodule", ""]
        return "\n".join(lines)
