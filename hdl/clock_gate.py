# SPDX-License-Identifier: Apache-2.0
"""Clock gate: stops the clock of the blocks behind it.

In simulation and on FPGAs it lets every edge pass. An edge changes nothing in the blocks behind it
while the gate is closed; `formal/clock_gate.py` proves this. In silicon, a module with a latch and
an AND, or the library's cell with both, has the same name. The paper does not mention clock gates;
they are our choice.
"""

from amaranth.hdl import (
    ClockDomain,
    ClockSignal,
    DomainRenamer,
    Elaboratable,
    Module,
    ResetSignal,
    Signal,
    Value,
)
from amaranth.lib.wiring import In, Out

from .unit import Export, Unit, place

GATED, FREE = "gated", "free"  # clock domains behind a gate and in front of it


class ClockGate(Unit):
    """Gate of a clock.

    small: it drives one block of a subgroup, not the whole subgroup.

    Ports
    -----
    enable : in, the clock's next edge is needed; it may come from logic that settles before the end
        of the cycle
    test_enable : in, every edge passes, for a test of the chip
    gated : out, the clock behind the gate
    """

    def __init__(self, small: bool = False) -> None:
        self.unit_name = "coincid_clock_gate_small" if small else "coincid_clock_gate"
        super().__init__(enable=In(1), test_enable=In(1), gated=Out(1))

    def elaborate(self, platform):
        m = Module()
        m.d.comb += self.gated.eq(ClockSignal())
        return m

    def for_cells(self) -> str:
        """Return the block's Verilog for standard cells: the latch is open in the second half of a
        cycle.
        """
        return f"""\
module {self.unit_name} (clk, rst, enable, test_enable, gated);
  input clk, rst, enable, test_enable;
  output gated;
  reg opens;
  always @* if (~clk) opens = enable | test_enable;
  assign gated = clk & opens;
endmodule
"""


def stopped(
    m: Module, platform, gate: ClockGate, enable: Value, test_enable: Value, domain: str = "sync"
) -> str:
    """Put a gate of a domain's clock into `m`, and return the domain behind it.

    A reset and `test_enable` open the gate.

    Amaranth's own simulator sees the edges of a clock behind a gate later than the others, so there
    both domains are `sync`.
    """
    exported = isinstance(platform, Export)
    domain = domain if exported else "sync"
    needed = Signal()
    m.d.comb += needed.eq(enable | ResetSignal(domain))
    place(
        m,
        "clock_gate",
        gate,
        platform,
        domain=domain,
        enable=needed,
        test_enable=test_enable,
    )
    if not exported:
        return domain
    gated = ClockDomain(GATED, local=True)
    m.domains += gated
    m.d.comb += [gated.clk.eq(gate.gated), gated.rst.eq(ResetSignal(domain))]
    return GATED


def behind(m: Module, platform, gate: ClockGate, enable: Value, test_enable: Value) -> Elaboratable:
    """Return the block `m`, with a gate in front of its whole clock, as in `stopped`."""
    stopped(m, platform, gate, enable, test_enable, FREE)
    return DomainRenamer({"sync": GATED, FREE: "sync"})(m) if isinstance(platform, Export) else m
