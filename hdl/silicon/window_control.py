# SPDX-License-Identifier: Apache-2.0
"""Window control of the asynchronous view: selects the window bank in force, arms the banks, and
classifies each cycle.

Capture first, then validate. The banks open and end with events. What happened in a cycle is read
half a cycle after its end, when every event has settled. One flop reads each fact, and only those
flops decide. So everything that follows is consistent, even if an event at a cycle boundary left a
flop in either state. Structure and timing are our choice; docs/async.md draws them.
"""

from amaranth.hdl import ClockDomain, ClockSignal, Module, Mux, ResetSignal, Signal
from amaranth.lib.wiring import In, Out

from ...model.contract.parameters import Sensor
from ..unit import Unit
from .circuit import Circuit


class AsyncControl(Unit):
    """Control of a subgroup's window banks.

    Ports
    -----
    parity : out, parity of the current cycle, which selects the listening bank of hit flops
    may_open : in, windows may open in the next cycle
    opened_b : in, bit q = an edge in a cycle of parity q has opened bank b; ended_b : in, the
        bank's window has ended
    parity_b : in, parity of the cycle in which it ended
    armed_b : out, bit q = an edge in the cycle of parity q may open bank b
    current : out, the bank whose window is in force; it changes in mid-cycle
    clearing_b : out, bank b is cleared in the last quarter of this cycle
    opening, closing, bank : out, from mid-cycle on: in the cycle before, a window opened or closed
        in this bank

    With two banks, the other bank also listens from the start of every cycle and is cleared at its
    end. If the window turns out to have closed in the cycle before, the other bank becomes the
    current one and has missed nothing (R = 0). With one bank, the clear waits for a synchroniser.
    Reset makes bank 0 the current one, without a window.
    """

    unit_name = "coincid_async_control"

    def __init__(self, sensor: Sensor, circuit: Circuit):
        self.sensor, self.banks = sensor, circuit.banks_of(sensor)
        per_bank = {
            "opened": In(2),
            "ended": In(1),
            "parity": In(1),
            "armed": Out(2),
            "clearing": Out(1),
        }
        super().__init__(
            parity=Out(1),
            may_open=In(1),
            current=Out(1),
            opening=Out(1),
            closing=Out(1),
            bank=Out(1),
            **{
                f"{name}_{b}": member
                for b in range(self.banks)
                for name, member in per_bank.items()
            },
        )
        # The window in force, in mid-cycle.
        self.opens = Signal()  # it opened in the cycle before
        self.closes = Signal()  # it closed in the cycle before
        self.window_open = Signal()  # it goes on
        self.read = Signal()  # with one bank: it has closed, and the bank is not cleared yet
        self.hold = Signal(range(sensor.rearm + 1))  # cycles until the banks are armed again

    def of_current(self, name):
        """Return the port `name` of the bank whose window is in force."""
        banks = [getattr(self, f"{name}_{b}") for b in range(self.banks)]
        return Mux(self.current, *reversed(banks)) if self.banks == 2 else banks[0]

    def elaborate(self, platform):
        m = Module()
        rearm = self.sensor.rearm
        two = self.banks == 2
        m.domains.fall = fall = ClockDomain("fall", clk_edge="neg", local=True)
        m.d.comb += [fall.clk.eq(ClockSignal()), fall.rst.eq(ResetSignal())]
        m.d.sync += self.parity.eq(~self.parity)

        # Mid-cycle: the events of the previous cycle have settled.
        before = Signal()
        m.d.comb += [
            before.eq(~self.parity),
            self.opens.eq(
                Mux(before, *reversed(self.of_current("opened"))) & ~self.window_open & ~self.read
            ),
            self.closes.eq(
                (self.opens | self.window_open)
                & self.of_current("ended")
                & (self.of_current("parity") == before)
            ),
        ]
        m.d.fall += [
            self.window_open.eq((self.opens | self.window_open) & ~self.closes),
            self.opening.eq(self.opens),
            self.closing.eq(self.closes),
            self.bank.eq(self.current),
            self.hold.eq(Mux(self.closes, max(rearm - 1, 0), self.hold - (self.hold != 0))),
        ]
        if two:
            with m.If(self.closes):
                m.d.fall += self.current.eq(~self.current)
            m.d.comb += [
                self.clearing_0.eq(self.current),
                self.clearing_1.eq(~self.current),
                self.read.eq(0),  # nothing waits for a clear
            ]
        else:
            m.d.comb += self.current.eq(0)  # there is no other bank
            first = Signal()  # the synchroniser in front of the clear
            second = Signal()
            m.d.sync += [
                first.eq(self.closing),
                second.eq(first),
            ]
            m.d.fall += self.read.eq((self.read | self.closes) & ~second)
            m.d.comb += self.clearing_0.eq(second)

        # Armed from the start of a cycle; the level stays until the last event of the cycle has
        # passed.
        for b in range(self.banks):
            now = (self.current == b) & (self.hold == 0) if rearm else 1
            for q in range(2):
                with m.If(self.parity != q):
                    m.d.sync += getattr(self, f"armed_{b}")[q].eq(self.may_open & now)
        return m
