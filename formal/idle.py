# SPDX-License-Identifier: Apache-2.0
"""Proofs that let a simulator skip idle cycles of a gap.

The sliced engine looks whether the state of a sensor in a gap comes back after some cycles, with
`tready` low while no stream has a beat. If it does, then it goes on coming back, for the same state
and the same inputs have the same future. Two things remain: the sequencer counts the gap, and
`tready` may be high in the cycles that are skipped. These proofs say that neither of them matters.
"""

from amaranth.hdl import Cat, Mux, Signal

from ..hdl.readout import Readout
from ..hdl.sequencer import IDLE_AFTER, Sequencer
from ..model.contract.parameters import Sensor
from .proof_bench import Bench, proof, registers_in
from .sensors import SMALL, SMALL_COUNTS

READY = "m_axis__tready"


@proof(depth=IDLE_AFTER + 2, cover=40)
def idle_gap(b: Bench):
    """After `IDLE_AFTER` cycles of a gap, the sequencer is idle: until the gap is over, a counter
    counts its cycles, and all other registers are what they were two cycles before.

    Nothing starts or aborts a frame, and none is ending. Two cycles, since a voted register has a
    copy that alternates.
    """
    _idle_gap(b, SMALL)


@proof(depth=IDLE_AFTER + 2, cover=40)
def idle_gap_with_counts(b: Bench):
    """The same of a sensor with counts, also in the pause of a search."""
    _idle_gap(b, SMALL_COUNTS)


def _idle_gap(b: Bench, sensor: Sensor) -> None:
    """Prove that a gap is idle."""
    unit = Sequencer(sensor)
    registers = registers_in(b.drive(unit, "dut"))
    waits = unit.running & unit.waiting & unit.in_gap & ~unit.draining
    quiet = ~unit.start_frame & ~unit.abort_frame
    steady = (unit.plan.as_value() == b.last(unit.plan.as_value())) & (
        unit.delivered == b.last(unit.delivered)
    )
    calm = Signal(range(IDLE_AFTER + 1))
    more = Mux(calm == IDLE_AFTER, IDLE_AFTER, calm + 1)
    b.m.d.sync += calm.eq(Mux(waits & quiet & steady, more, 0))
    idle = b.same("idle", (calm == IDLE_AFTER) & waits & ~unit.gap_over)
    for register in registers:
        if register is not unit.waited:
            b.always(register == b.last(b.last(register)), where=idle)
    b.always(unit.waited == b.last(unit.waited) + 1, where=idle)
    gap = unit.least_gap if sensor.counts else unit.plan.gap
    b.always(unit.gap_over == b.last(unit.waited >= gap - 1), where=idle)
    b.cover(idle & (unit.waited == IDLE_AFTER + 4))


@proof(depth=2, cover=20)
def unasked_ready(b: Bench):
    """While a readout offers no beat, `tready` changes none of its registers and outputs.

    Its buffer may hold anything, but the same for both values of `tready`. In plain formats, what
    the buffer has is offered: this is proven for the coder.
    """
    _unasked_ready(b, SMALL)


@proof(depth=2, cover=20)
def unasked_ready_with_counts(b: Bench):
    """The same of a sensor with counts."""
    _unasked_ready(b, SMALL_COUNTS)


def _unasked_ready(b: Bench, sensor: Sensor) -> None:
    """Prove that `tready` changes nothing while no beat is offered."""
    low = Readout(sensor, 2)
    of_low = registers_in(b.drive(low, "low"))
    shared = {
        port: signal
        for port, (flow, signal) in low.flat_ports().items()
        if flow.name == "In" and port != READY
    }
    high = Readout(sensor, 2)
    of_high = registers_in(b.drive(high, "high", **shared))
    b.assume(low.buffer.r_data == high.buffer.r_data)
    b.assume(low.m_axis.tvalid, where=low.buffer.r_rdy & ~low.grouped)

    registers = list(zip(of_low, of_high, strict=True))
    equal = b.same("equal", Cat(one == other for one, other in registers).all())
    idle = b.same("idle", equal & ~low.m_axis.tvalid)
    for one, other in registers:
        b.always(one == other, where=b.last(idle))
    outputs = high.outputs()
    for port, signal in low.outputs().items():
        b.always(signal == outputs[port], where=idle)
    b.always(low.buffer.w_en == high.buffer.w_en, where=idle)
    b.always(low.buffer.w_data == high.buffer.w_data, where=idle & low.buffer.w_en)
    b.cover(b.last(idle) & low.m_axis.tvalid & ~low.m_axis.tready & high.m_axis.tready)
