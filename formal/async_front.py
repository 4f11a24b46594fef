# SPDX-License-Identifier: Apache-2.0
"""Proof of the asynchronous view's control: whatever its events leave behind, no wrong word comes
out, and it never locks up.

All cells and macros are cut away. So hit flops, roots, arbiters, window ends, samples and pictures
may have any value in any half cycle. The proof covers every pattern of edges, every delay, and
every flop that falls to the wrong side. The control remains, and the logic that collects words at
the clock. A step is half a clock cycle: registers with a rising clock edge move in one step, those
with a falling edge in the next.
"""

from functools import partial

from amaranth.hdl import Assert, Assume, Cover, EnableInserter, Module, ResetInserter, Signal
from amaranth.hdl._ast import AnySeq
from attrs import evolve

from ..hdl.logic import popcount
from ..hdl.silicon.circuit import CELLS, MACROS, SYNCHRONISER_REARM, Circuit
from ..hdl.silicon.front_end import AsyncFrontEnd
from ..hdl.silicon.window_control import AsyncControl
from ..model.contract.parameters import Sensor
from .proof_bench import KEPT, PROOFS, Proof, elaborated

DEPTH = 14  # half cycles of the induction
COVER = 40  # half cycles within which a window with two pixels that spans several cycles comes out
SMALL = Sensor(
    rows=4, cols=4, subgroup=(4, 4), minigroup=(2, 2), phases=4, coarse_bits=3, window_max=8
)
SCRIPT = """\
cutpoint -blackbox
# Steps are half cycles: an enable selects the flops that move in a step, and all have the same
# clock.
setparam -set CLK_POLARITY 1'1 t:$*dff*
"""


def bench(sensor: Sensor, circuit: Circuit) -> Module:
    """Return the front end with free events, and the statements about it."""
    m = Module()
    started, rising = (
        Signal(name=f"{KEPT}{name}", reset_less=True) for name in ("started", "rising")
    )
    reset = Signal()
    m.d.sync += [started.eq(started | rising), rising.eq(~rising)]
    m.d.comb += [reset.eq(AnySeq(1)), Assume(started | reset)]
    front = AsyncFrontEnd(sensor, circuit)
    _words_are_whole(elaborated(front), front, started)
    control = front.control
    _control_returns(elaborated(control), control, started)
    for _, member, value in front.signature.flatten(front):
        if member.flow.name == "In":
            value = value.as_value() if hasattr(value, "as_value") else value
            m.d.comb += value.eq(AnySeq(len(value)))
    m.submodules.front = ResetInserter({"sync": reset, "fall": reset})(
        EnableInserter({"sync": rising, "fall": ~rising, "read": ~rising})(front)
    )
    return m


def _words_are_whole(m: Module, front: AsyncFrontEnd, started: Signal) -> None:
    """State that a word is never empty, contains its winner, and has the count of its map; m: the
    front end's module.

    Further invariants make this inductive.
    """
    half, window = front.half, front.window
    live_4, live_5 = Signal(), Signal()
    m.d.sync += [live_4.eq(front.inside), live_5.eq(live_4)]

    def bit(value, index):
        return value.bit_select(index, 1)

    def states(condition, where):
        m.d.comb += Assert(~(where & started) | condition)

    states(live_4 == (front.opening_4 | (live_5 & ~front.closed_5)), live_4)
    states(live_4 & ~front.closing_4, front.window_open)
    states(live_4, front.closing_4)
    states(live_5, front.closed_5)
    states(bit(front.hits, front.winner), live_5)
    in_half = sum(front.counts[1:], front.counts[0]) == popcount(m, half.hits, "spec_half")
    states(bit(half.hits, half.winner) & in_half, front.closed_6)
    in_window = window.count == popcount(m, window.hits, "spec_window")
    states(bit(window.hits, window.winner) & (window.hits != 0) & in_window, front.closed)

    m.d.comb += Cover(started & front.closed & (window.count == 2) & (front.elapsed > 1))


def _control_returns(m: Module, control: AsyncControl, started: Signal) -> None:
    """State that every wait for the clock ends in time, and that a window closes within two cycles
    of its end.

    m: the control's module.
    """
    if control.banks == 1:
        waiting = Signal(range(8))
        m.d.fall += waiting.eq(0)
        with m.If(control.read):
            m.d.fall += waiting.eq(waiting + 1)
        # The clear comes two cycles after the window closed.
        m.d.comb += Assert(~started | (waiting <= 2))
        m.d.comb += Assert(~(started & control.read & (waiting == 0)) | control.closing)
    unanswered, parity = Signal(range(8)), Signal()
    ended, parity_now = control.of_current("ended"), control.of_current("parity")
    m.d.fall += [unanswered.eq(0), parity.eq(parity_now)]
    with m.If(
        control.window_open & ended & ~control.closes & ((unanswered == 0) | (parity_now == parity))
    ):
        m.d.fall += unanswered.eq(unanswered + 1)
    # If the end stays, the window closes within two cycles.
    m.d.comb += Assert(~started | (unanswered <= 2))
    if control.sensor.rearm:
        m.d.comb += Assert(~started | (control.hold < max(2, control.sensor.rearm)))


def _prove(name: str, states: str, sensor: Sensor) -> None:
    PROOFS[name] = Proof(
        name, states, partial(bench, sensor, Circuit()), DEPTH, COVER, (CELLS, MACROS), SCRIPT
    )


_prove(
    "async_two_banks",
    "Asynchronous front end: whatever its events leave behind, its words are whole.",
    SMALL,
)
_prove(
    "async_one_bank",
    "The same, with one bank, which is cleared.",
    evolve(SMALL, rearm=SYNCHRONISER_REARM),
)
