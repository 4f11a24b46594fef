# SPDX-License-Identifier: Apache-2.0
"""Frame buffer: takes the sensor's beats at full speed, and keeps them until the host has read them, as often as it wants, and takes them out."""

from types import SimpleNamespace

from amaranth.hdl import Module, Signal
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from ...model.contract.emulator import Emulator
from ...model.contract.packet import BEAT_BITS
from ...model.contract.registers import DATA_BITS
from ..axi import STREAM
from ..unit import Unit


class FrameBuffer(Unit):
    """Ring of beats.

    Ports
    -----
    s_axis : in, the sensor's stream; `tready` is low only while the buffer is full
    level, first : out, beats that are not taken, and the place of the first of them; take : in, strobe, amount : in, beats to take, at most `level`
    address : in, word of 32 bits to read, low half first; word : out, two cycles later
    stalls : out, cycles in which the sensor waited; stays at its highest value

    Reset empties; what the memory holds stays.
    """

    unit_name = "coincid_frame_buffer"

    def __init__(self, emulator: Emulator):
        self.depth = emulator.buffer_beats
        bits = (self.depth - 1).bit_length()
        super().__init__(
            {
                "s_axis": In(STREAM),
                "level": Out(bits + 1),
                "first": Out(bits),
                "take": In(1),
                "amount": In(bits + 1),
                "address": In(bits + 1),
                "word": Out(DATA_BITS),
                "stalls": Out(DATA_BITS),
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.beats = beats = Memory(shape=BEAT_BITS, depth=self.depth, init=[])
        write, read = beats.write_port(), beats.read_port()
        behind = Signal(range(self.depth))
        high = Signal()
        taken = Signal()
        m.d.comb += [
            self.s_axis.tready.eq(self.level != self.depth),
            taken.eq(self.s_axis.tvalid & self.s_axis.tready),
            write.addr.eq(behind),
            write.data.eq(self.s_axis.tdata),
            write.en.eq(taken),
            read.addr.eq(self.address[1:]),
            read.en.eq(1),
        ]
        m.d.sync += [
            high.eq(self.address[0]),
            self.word.eq(read.data.word_select(high, DATA_BITS)),
            behind.eq(behind + taken),
            self.level.eq(self.level + taken - (self.amount & self.take.replicate(len(self.amount)))),
        ]
        with m.If(self.take):
            m.d.sync += self.first.eq(self.first + self.amount)
        with m.If(self.s_axis.tvalid & ~self.s_axis.tready & ~self.stalls.all()):
            m.d.sync += self.stalls.eq(self.stalls + 1)
        self.state = SimpleNamespace(behind=behind, beats=beats)
        return m
