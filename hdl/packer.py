# SPDX-License-Identifier: Apache-2.0
"""Packer of a stream: packs parts of events into the beats of groups, and lets all other beats through.

The paper leaves the readout open. Groups of events that are packed to the bit are our choice; `docs/compact.md` gives the
reasons, and `model/contract/groups.py` the widths.
"""

from functools import cache

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.groups import CHECK_BITS, CHECK_LSB, CHECK_POLYNOMIAL, PAYLOAD_BITS, group_widths
from ..model.contract.packet import BEAT_BITS, GROUP_KIND, KIND_BITS
from ..model.contract.parameters import Sensor, bits_for
from .axi import STREAM
from .unit import Unit


@cache
def check_terms() -> tuple[frozenset[int], ...]:
    """Return, for each bit of a group's check after a beat, the bits of (check before it, beat) that it is the parity of."""
    terms = [frozenset([bit]) for bit in range(CHECK_BITS)]
    for bit in range(BEAT_BITS):
        out = terms[0] ^ {CHECK_BITS + bit}
        terms = [*terms[1:], frozenset()]
        terms = [term ^ out if CHECK_POLYNOMIAL >> k & 1 else term for k, term in enumerate(terms)]
    return tuple(terms)


class PackerState:
    """Inner registers and signals of a packer.

    packed: bits that wait, lowest first: a beat's payload if one is `ready`, and `offset` bits behind it; crowded: these are
    another payload; room: they leave room for the check. begins: no beat of the group has left. check: of the beats that
    have left. final: the beat that is offered ends the group. packs: the part is packed. sent: a beat leaves.
    """

    def __init__(self, sensor: Sensor):
        longest = PAYLOAD_BITS - 1 + group_widths(sensor).part_bits  # bits that wait at most
        self.packed = Signal(longest)
        self.kept = Signal(longest)
        self.ready = Signal()
        self.offset = Signal(range(longest - PAYLOAD_BITS + 1 if longest > 2 * PAYLOAD_BITS else PAYLOAD_BITS))
        self.total = Signal(range(longest + 1))
        self.crowded = Signal()
        self.room = Signal(init=1)
        self.begins = Signal(init=1)
        self.check = Signal(CHECK_BITS, init=-1)
        self.final = Signal()
        self.packs = Signal()
        self.sent = Signal()
        self.beat = Signal(BEAT_BITS)


class Packer(Unit):
    """Packer.

    Ports
    -----
    offer, part, bits : in, a part of the group: its lowest `bits` bits, zeros above them
    close : in, the group ends with what has been packed. No part is offered meanwhile
    free : out, nothing is offered any more from the next cycle on: the part is packed, or the group's last beat leaves
    passes, beat, last : in, a beat of another packet, while no group is open; it leaves when `m_axis` does
    frame_begin : in, forget everything
    m_axis : AXI4-Stream master

    A part is packed unless a full beat waits for the receiver; both may happen in the same cycle. `tready` and `passes`
    only select; all other inputs come from registers. Reset forgets everything.
    """

    unit_name = "coincid_packer"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            offer=In(1),
            part=In(group_widths(sensor).part_bits),
            bits=In(bits_for(group_widths(sensor).part_bits)),
            close=In(1),
            free=Out(1),
            passes=In(1),
            beat=In(BEAT_BITS),
            last=In(1),
            frame_begin=In(1),
            m_axis=Out(STREAM),
        )
        self.state = PackerState(sensor)

    def elaborate(self, platform):
        m = Module()
        self._pack(m)
        self._form_beat(m)
        return m

    def _pack(self, m):
        """Put a part behind the bits that wait. Its place is known from registers, so the receiver only selects."""
        state = self.state
        waits, placed = Signal(name="waits"), Signal.like(state.packed, name="placed")
        nothing, packable = ~self.offer & ~self.close, self.offer & ~state.crowded
        free_if_ready, free_if_not = nothing | packable | state.final, nothing | (packable & ~state.ready)
        m.d.comb += [
            waits.eq((state.ready | self.close) & ~self.m_axis.tready),
            state.packs.eq(self.offer & ~waits & ~state.crowded),
            self.free.eq(Mux(self.m_axis.tready, free_if_ready, free_if_not)),
            state.kept.eq(Mux(state.ready, state.packed >> PAYLOAD_BITS, Mux(self.close, 0, state.packed))),
            placed.eq(self.part << state.offset),
            state.total.eq(state.offset + self.bits),
        ]
        with m.If(state.packs):
            m.d.sync += [
                state.packed.eq(state.kept | placed),
                state.ready.eq(state.total >= PAYLOAD_BITS),
                state.crowded.eq(state.total >= 2 * PAYLOAD_BITS),
                state.offset.eq(Mux(state.total >= PAYLOAD_BITS, state.total - PAYLOAD_BITS, state.total)),
                state.room.eq(
                    Mux(state.total >= PAYLOAD_BITS, state.total <= PAYLOAD_BITS + CHECK_LSB, state.total <= CHECK_LSB)
                ),
            ]
        with m.Elif(~waits):
            m.d.sync += [state.packed.eq(state.kept), state.ready.eq(state.crowded), state.crowded.eq(0)]
            with m.If(state.crowded):
                m.d.sync += [
                    state.offset.eq(state.offset - PAYLOAD_BITS),
                    state.room.eq(state.offset <= PAYLOAD_BITS + CHECK_LSB),
                ]
            with m.Elif(self.close & ~state.ready):
                m.d.sync += [state.offset.eq(0), state.room.eq(1)]
        with m.If(self.frame_begin):
            m.d.sync += [signal.eq(0) for signal in (state.packed, state.ready, state.crowded, state.offset)]
            m.d.sync += state.room.eq(1)

    def _form_beat(self, m):
        """Offer a beat of the group, with its marks and, in the last one, the check; or let another beat pass."""
        state, axis = self.state, self.m_axis
        forms = Signal()
        check = Signal(CHECK_BITS)
        kind = Const(GROUP_KIND, KIND_BITS)
        m.d.comb += [
            forms.eq(state.ready | self.close),
            state.final.eq(self.close & ~state.ready & state.room),
            state.beat.eq(Cat(state.packed[:PAYLOAD_BITS], state.final, state.begins, kind)),
            state.sent.eq(forms & axis.tready),
            axis.tvalid.eq(forms | self.passes),
            axis.tdata.eq(Mux(forms, state.beat, self.beat)),
            axis.tlast.eq(~forms & self.last),
        ]
        inputs = Cat(state.check, state.beat)
        m.d.comb += check.eq(Cat(Cat(inputs[bit] for bit in sorted(term)).xor() for term in check_terms()))
        with m.If(state.final):
            m.d.comb += axis.tdata[CHECK_LSB:PAYLOAD_BITS].eq(~check)
        with m.If(state.sent):
            m.d.sync += [state.check.eq(Mux(state.final, ~0, check)), state.begins.eq(state.final)]
        with m.If(self.frame_begin):
            m.d.sync += [state.check.eq(~0), state.begins.eq(1)]
