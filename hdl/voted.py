# SPDX-License-Identifier: Apache-2.0
"""Registers that tolerate the upset of one flip-flop: three copies and a majority vote; a reset in
two.
"""

from amaranth.hdl import Module, ResetSignal, Signal

from .logic import any_of


class Voted:
    """A register in three copies.

    All of them load the majority, so an upset is gone after one cycle.

    The copies store different codes, so that synthesis does not merge them: true, inverted, and
    alternating.

    value : Signal, the register's value; next : Signal, its next value, assigned in the domain
        `comb` (default: `value`)
    agree : Signal, the copies agree
    """

    def __init__(self, m: Module, name: str, width: int = 1, init: int = 0):
        full = (1 << width) - 1
        self.value = Signal(width, name=name)
        self.next = Signal(width, name=f"{name}_next")
        self.agree = Signal(name=f"{name}_agree")
        plain = Signal(width, name=f"{name}_plain", init=init)
        inverse = Signal(width, name=f"{name}_inverse", init=init ^ full)
        by_turns = Signal(width, name=f"{name}_by_turns", init=init)
        turn = Signal(name=f"{name}_turn")
        third = Signal(width, name=f"{name}_third")
        m.d.comb += [
            third.eq(by_turns ^ turn.replicate(width)),
            self.value.eq(
                any_of(m, [plain & ~inverse, plain & third, ~inverse & third], f"{name}_two")
            ),
            self.next.eq(self.value),
            self.agree.eq((plain == ~inverse) & (plain == third)),
        ]
        m.d.sync += [
            turn.eq(~turn),
            plain.eq(self.next),
            inverse.eq(~self.next),
            by_turns.eq(self.next ^ (~turn).replicate(width)),
        ]


def agreed_reset(m: Module) -> Signal:
    """Return the reset, one cycle later.

    Two registers of opposite polarity must agree on it, so an upset in one resets nothing.
    """
    resets = Signal(init=1, reset_less=True)
    rests = Signal(reset_less=True)
    reset = Signal()
    m.d.sync += [resets.eq(ResetSignal()), rests.eq(~ResetSignal())]
    m.d.comb += reset.eq(resets & ~rests)
    return reset
