# SPDX-License-Identifier: Apache-2.0
"""Packer of a stream: packs parts of events into the beats of groups, and lets all other beats
through.

The paper leaves the readout open. Groups of events that are packed to the bit are our choice;
`docs/compact.md` gives the reasons, and `model/contract/groups.py` the widths.
"""

from functools import cache

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..model.contract.groups import (
    CHECK_BITS,
    CHECK_LSB,
    CHECK_POLYNOMIAL,
    PAYLOAD_BITS,
    group_widths,
)
from ..model.contract.packet import BEAT_BITS, GROUP_KIND, KIND_BITS
from ..model.contract.parameters import Sensor, bits_for
from .axi import STREAM
from .unit import Unit


@cache
def check_terms() -> tuple[frozenset[int], ...]:
    """Return, for each bit of a group's check, the bits of (check before the beat, beat) whose
    parity it is after the beat.
    """
    terms = [frozenset([bit]) for bit in range(CHECK_BITS)]
    for bit in range(BEAT_BITS):
        out = terms[0] ^ {CHECK_BITS + bit}
        terms = [*terms[1:], frozenset()]
        terms = [term ^ out if CHECK_POLYNOMIAL >> k & 1 else term for k, term in enumerate(terms)]
    return tuple(terms)


class Packer(Unit):
    """Packer.

    Ports
    -----
    offer, part, bits : in, a part of the group: its lowest `bits` bits, zeros above them
    close : in, the group ends with what has been packed. No part is offered meanwhile
    free : out, the next cycle can bring a new offer: the part is packed, or the group's last beat
        leaves
    passes, beat, last : in, a beat of another packet, while no group is open; it leaves when
        `m_axis` does
    frame_begin : in, forget everything
    m_axis : AXI4-Stream master

    A part is packed unless a full beat waits for the receiver; both may happen in the same cycle.
    `tready` and `passes` only select; all other inputs come from registers. Reset forgets
    everything.
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
        longest = PAYLOAD_BITS - 1 + group_widths(sensor).part_bits  # bits that wait at most
        behind = longest - PAYLOAD_BITS + 1 if longest > 2 * PAYLOAD_BITS else PAYLOAD_BITS
        # Bits that wait, lowest first: a beat's payload if one is `ready`, and `offset` bits behind
        # it.
        self.packed = Signal(longest)
        self.offset = Signal(range(behind))
        self.ready = Signal()
        self.crowded = Signal()  # the bits behind it are another payload
        self.room = Signal(init=1)  # they leave room for the check
        self.waiting = Signal(longest)  # bits that wait after this cycle, without the part
        self.total = Signal(range(longest + 1))  # `offset` with the part
        self.packs = Signal()  # the part is packed
        self.begins = Signal(init=1)  # no beat of the group has left
        self.final = Signal()  # the beat that is offered ends the group
        self.check = Signal(CHECK_BITS, init=-1)  # of the beats that have left

    def elaborate(self, platform):
        m = Module()
        self._pack(m)
        self._form_beat(m)
        return m

    def _pack(self, m):
        """Put a part behind the bits that wait.

        Registers know its place, so `tready` only selects.
        """
        waits = Signal()  # a full beat waits for the receiver
        placed = Signal.like(self.packed)  # the part at its place
        nothing = ~self.offer & ~self.close
        packable = self.offer & ~self.crowded
        free_if_ready = nothing | packable | self.final
        free_if_not = nothing | (packable & ~self.ready)
        m.d.comb += [
            waits.eq((self.ready | self.close) & ~self.m_axis.tready),
            self.packs.eq(self.offer & ~waits & ~self.crowded),
            self.free.eq(Mux(self.m_axis.tready, free_if_ready, free_if_not)),
            self.waiting.eq(
                Mux(self.ready, self.packed >> PAYLOAD_BITS, Mux(self.close, 0, self.packed))
            ),
            placed.eq(self.part << self.offset),
            self.total.eq(self.offset + self.bits),
        ]
        with m.If(self.packs):
            m.d.sync += [
                self.packed.eq(self.waiting | placed),
                self.ready.eq(self.total >= PAYLOAD_BITS),
                self.crowded.eq(self.total >= 2 * PAYLOAD_BITS),
                self.offset.eq(
                    Mux(self.total >= PAYLOAD_BITS, self.total - PAYLOAD_BITS, self.total)
                ),
                self.room.eq(
                    Mux(
                        self.total >= PAYLOAD_BITS,
                        self.total <= PAYLOAD_BITS + CHECK_LSB,
                        self.total <= CHECK_LSB,
                    )
                ),
            ]
        with m.Elif(~waits):
            m.d.sync += [
                self.packed.eq(self.waiting),
                self.ready.eq(self.crowded),
                self.crowded.eq(0),
            ]
            with m.If(self.crowded):
                m.d.sync += [
                    self.offset.eq(self.offset - PAYLOAD_BITS),
                    self.room.eq(self.offset <= PAYLOAD_BITS + CHECK_LSB),
                ]
            with m.Elif(self.close & ~self.ready):
                m.d.sync += [self.offset.eq(0), self.room.eq(1)]
        with m.If(self.frame_begin):
            m.d.sync += [
                signal.eq(0) for signal in (self.packed, self.ready, self.crowded, self.offset)
            ]
            m.d.sync += self.room.eq(1)

    def _form_beat(self, m):
        """Offer a beat of the group, with its marks and, in the last one, the check; or let another
        beat pass.
        """
        axis = self.m_axis
        forms = Signal()  # a beat of the group is offered
        sent = Signal()  # it leaves
        beat = Signal(BEAT_BITS)
        check = Signal(CHECK_BITS)
        kind = Const(GROUP_KIND, KIND_BITS)
        m.d.comb += [
            forms.eq(self.ready | self.close),
            self.final.eq(self.close & ~self.ready & self.room),
            beat.eq(Cat(self.packed[:PAYLOAD_BITS], self.final, self.begins, kind)),
            sent.eq(forms & axis.tready),
            axis.tvalid.eq(forms | self.passes),
            axis.tdata.eq(Mux(forms, beat, self.beat)),
            axis.tlast.eq(~forms & self.last),
        ]
        inputs = Cat(self.check, beat)
        m.d.comb += check.eq(
            Cat(Cat(inputs[bit] for bit in sorted(term)).xor() for term in check_terms())
        )
        with m.If(self.final):
            m.d.comb += axis.tdata[CHECK_LSB:PAYLOAD_BITS].eq(~check)
        with m.If(sent):
            m.d.sync += [self.check.eq(Mux(self.final, ~0, check)), self.begins.eq(self.final)]
        with m.If(self.frame_begin):
            m.d.sync += [self.check.eq(~0), self.begins.eq(1)]
