# SPDX-License-Identifier: Apache-2.0
"""Clock gate: stops the clock of the blocks behind it.

In simulation and on FPGAs it lets every edge pass: the blocks behind it are such that an edge changes nothing while the
gate is closed, which `formal/clock_gate.py` proves. In silicon, a latch and an AND, or the library's cell with both, stand
under the same name. The paper does not mention clock gates; they are our choice.
"""

from amaranth.hdl import ClockSignal, Module
from amaranth.lib.wiring import In, Out

from .unit import Unit


class ClockGate(Unit):
    """Gate of a clock.

    Ports
    -----
    enable : in, the clock's next edge is needed; it may come through logic, and settles before the cycle's end
    gated : out, the clock behind the gate
    """

    unit_name = "coincid_clock_gate"

    def __init__(self) -> None:
        super().__init__({"enable": In(1), "gated": Out(1)})

    def elaborate(self, platform):
        m = Module()
        m.d.comb += self.gated.eq(ClockSignal())
        return m

    def for_cells(self) -> str:
        """Return the block's Verilog for standard cells: the latch is open in the second half of a cycle."""
        return f"""\
module {self.unit_name} (clk, rst, enable, gated);
  input clk, rst, enable;
  output gated;
  reg opens;
  always @* if (~clk) opens = enable;
  assign gated = clk & opens;
endmodule
"""
