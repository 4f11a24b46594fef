# SPDX-License-Identifier: Apache-2.0
"""Frame buffer: takes the sensor's beats at full speed and keeps them until the host removes them;
it may read them often.

Between the two there is a register slice, because on an FPGA they are far apart.
"""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from ...hdl.axi import STREAM
from ...hdl.unit import Unit
from ...model.contract.packet import BEAT_BITS
from ...model.contract.registers import DATA_BITS
from ..parameters import Emulator


class StreamSlice(Unit):
    """Registers in a stream, in both directions: data, `tvalid` and `tready`.

    Ports
    -----
    s_axis : in, a stream; m_axis : out, its beats, one cycle later, without `tlast`, which stays 0

    It can take a beat in every cycle. A second register keeps the beat that arrives before `tready`
    can fall because the output waits. Reset empties both.
    """

    unit_name = "coincid_stream_slice"

    def __init__(self):
        super().__init__(s_axis=In(STREAM), m_axis=Out(STREAM))
        self.valid = Signal()  # there is a beat at the output
        self.spare_valid = Signal()  # there is a beat in the second register
        self.spare = Signal(BEAT_BITS, reset_less=True)  # the second register

    def elaborate(self, platform):
        m = Module()
        valid = self.valid
        spare = self.spare
        spare_valid = self.spare_valid
        data = Signal(BEAT_BITS, reset_less=True)
        comes = Signal()
        waits = Signal()
        m.d.comb += [
            self.s_axis.tready.eq(~spare_valid),
            self.m_axis.tdata.eq(data),
            self.m_axis.tvalid.eq(valid),
            self.m_axis.tlast.eq(0),
            comes.eq(self.s_axis.tvalid & ~spare_valid),
            waits.eq(valid & ~self.m_axis.tready),
        ]
        with m.If(~spare_valid):
            m.d.sync += spare.eq(self.s_axis.tdata)
        with m.If(waits):
            m.d.sync += spare_valid.eq(spare_valid | comes)
        with m.Else():
            m.d.sync += [
                valid.eq(spare_valid | comes),
                spare_valid.eq(0),
                data.eq(Mux(spare_valid, spare, self.s_axis.tdata)),
            ]
        return m


class FrameBuffer(Unit):
    """Ring buffer of beats.

    Ports
    -----
    s_axis : in, the sensor's stream; `tready` is low only while the buffer is full
    level, first : out, number of beats in the buffer, and address of the first
    take : in, strobe: remove beats; amount : in, their number, at most `level`
    address : in, number of the 32-bit word to read, low half of a beat first; word : out, four
        cycles later
    stalls : out, number of cycles in which a beat waited; saturates

    A beat is in the memory two cycles after it has been taken from the stream. Reset empties the
    buffer; the memory keeps its contents.
    """

    unit_name = "coincid_frame_buffer"

    def __init__(self, emulator: Emulator):
        self.depth = emulator.buffer_beats
        bits = (self.depth - 1).bit_length()
        super().__init__(
            s_axis=In(STREAM),
            level=Out(bits + 1),
            first=Out(bits),
            take=In(1),
            amount=In(bits + 1),
            address=In(bits + 1),
            word=Out(DATA_BITS),
            stalls=Out(DATA_BITS),
        )
        self.behind = Signal(range(self.depth))  # address behind the last beat

    def elaborate(self, platform):
        m = Module()
        m.submodules.beats = beats = Memory(shape=BEAT_BITS, depth=self.depth, init=[])
        write = beats.write_port()
        read = beats.read_port()
        behind = self.behind
        high = Signal(3)
        row = Signal(range(self.depth), reset_less=True)
        stored = Signal(BEAT_BITS, reset_less=True)
        beat = Signal(BEAT_BITS, reset_less=True)
        place = Signal.like(behind, reset_less=True)
        # A register beside the level, so that the sensor does not wait for a comparison.
        room = Signal(init=1)
        taken = Signal()
        m.d.comb += [
            self.s_axis.tready.eq(room),
            taken.eq(self.s_axis.tvalid & self.s_axis.tready),
            read.addr.eq(row),
            read.en.eq(1),
            write.addr.eq(place),
            write.data.eq(stored),
        ]
        m.d.sync += [
            room.eq(
                (room & ~(self.s_axis.tvalid & (self.level == self.depth - 1)))
                | (self.take & self.amount.any())
            ),
            # The block RAMs are far apart, so there are registers in front of and behind them.
            place.eq(behind),
            stored.eq(self.s_axis.tdata),
            write.en.eq(taken),
            row.eq(self.address[1:]),
            high.eq(Cat(self.address[0], high)),
            beat.eq(read.data),
            self.word.eq(beat.word_select(high[-1], DATA_BITS)),
            behind.eq(behind + taken),
            self.level.eq(
                self.level + taken - (self.amount & self.take.replicate(len(self.amount)))
            ),
        ]
        with m.If(self.take):
            m.d.sync += self.first.eq(self.first + self.amount)
        with m.If(self.s_axis.tvalid & ~self.s_axis.tready & ~self.stalls.all()):
            m.d.sync += self.stalls.eq(self.stalls + 1)
        return m
