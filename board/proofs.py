# SPDX-License-Identifier: Apache-2.0
"""Proofs of the emulator: frames on the serial line, the frame buffer, and the photon source.

Amaranth's library provides the CRC of a frame; here it is an arbitrary function of the bytes. The
buffer's depth is only a parameter of counters. The pixels of a source are independent, so a proof
for an arbitrary one holds for all.
"""

from amaranth.hdl import Cat, Const, Mux, Signal

from ..formal.proof_bench import Bench, proof
from ..formal.sensors import SMALL
from ..model.contract.packet import BEAT_BITS
from .parameters import Emulator
from .rtl.buffer import FrameBuffer, StreamSlice
from .rtl.source import PhotonSource
from .rtl.uart import Deframer, Framer
from .serial_link import BODY_BYTES_MAX, CRC_BYTES, ESCAPE, FLAG

EMULATOR = Emulator(sensor=SMALL, buffer_beats=64)


@proof(depth=2, cover=16)
def deframer(b: Bench) -> None:
    """A body is right only if its CRC is, no byte is broken, and it fits the memory; nothing is
    written beyond.
    """
    m, unit = b.m, b.place(Deframer())
    came, byte, broken, hold = unit.came, unit.byte_in, unit.broken_in, unit.hold
    b.always(Cat(came, byte, broken) == b.past(Cat(unit.valid, unit.byte, unit.broken)))
    b.always(
        (unit.is_flag == (~broken & (byte == FLAG))) & (unit.is_escape == (byte == ESCAPE)),
        where=unit.came,
    )
    flag = b.same("flag", came & ~broken & (byte == FLAG))
    in_frame, spoilt, put = Signal(), Signal(), Signal(range(BODY_BYTES_MAX + 2))
    with m.If(flag):
        m.d.sync += [in_frame.eq(1), spoilt.eq(0), put.eq(0)]
    with m.Elif(came & in_frame):
        m.d.sync += spoilt.eq(spoilt | broken | (put == BODY_BYTES_MAX))
        with m.If(unit.put):
            m.d.sync += put.eq(put + 1)
    with m.If(hold):
        m.d.sync += in_frame.eq(0)
    b.always(in_frame == unit.listening)
    b.always(spoilt == unit.bad, where=in_frame)
    b.always((put == unit.count) | spoilt, where=in_frame)
    b.always(unit.count <= BODY_BYTES_MAX)
    b.always((unit.index < BODY_BYTES_MAX) & in_frame & ~broken, where=unit.put)
    ends = b.same("ends", flag & in_frame & ~hold)
    b.always(b.past(ends & ~spoilt & (put > CRC_BYTES) & unit.crc.match_detected), where=unit.right)
    b.always(b.past(ends), where=unit.wrong)
    b.always(~(unit.right & unit.wrong))
    b.always(unit.length == b.past(put - CRC_BYTES), where=unit.right)
    b.cover(unit.wrong & b.past(spoilt))
    b.cover(unit.put & b.past(came & (byte == ESCAPE)))


@proof(depth=2, cover=14)
def framer(b: Bench) -> None:
    """Flags are only at a frame's ends, escapes only where needed; an offered byte stays until it
    is taken.
    """
    m, unit = b.m, b.place(Framer())
    valid, byte, last, ready = unit.valid, unit.byte, unit.last, unit.out_ready
    offered = b.same("offered", valid & ~unit.ready)
    b.assume(valid & (byte == b.last(byte)) & (last == b.last(last)), where=b.past(offered))
    ends = b.same("ends", unit.machine.ongoing("idle") | unit.machine.ongoing("flag"))
    gone = b.same("gone", unit.out_valid & ready)
    b.always((unit.out_byte == FLAG) == ends, where=unit.out_valid)
    b.always(gone & ~ends, where=unit.ready)
    b.always(
        unit.special == ((unit.next_byte == FLAG) | (unit.next_byte == ESCAPE)), where=unit.weighed
    )
    b.always(~unit.weighed | unit.machine.ongoing("body") | unit.machine.ongoing("tail"))
    b.always(~unit.weighed | valid, where=unit.machine.ongoing("body"))
    escape = Signal()  # the previous byte was an escape
    with m.If(gone):
        m.d.sync += escape.eq(~ends & (unit.out_byte == ESCAPE))
    b.always(
        escape == unit.escaped, where=unit.machine.ongoing("body") | unit.machine.ongoing("tail")
    )
    b.always(unit.out_byte != ESCAPE, where=unit.out_valid & escape & ~ends)
    b.always(
        ~unit.escaped | unit.machine.ongoing("body") | unit.machine.ongoing("tail"), where=escape
    )
    held = b.same("held", unit.out_valid & ~ready)
    b.always(unit.out_valid & (unit.out_byte == b.last(unit.out_byte)), where=b.past(held))
    b.cover(unit.machine.ongoing("flag"))


@proof(depth=2, cover=8)
def frame_buffer(b: Bench) -> None:
    """The sensor waits only while the buffer is full; waiting beats are contiguous, and none is
    overwritten.
    """
    unit = b.place(FrameBuffer(EMULATOR))
    take, amount, comes = unit.take, unit.amount, unit.s_axis.tvalid
    b.assume(amount <= unit.level, where=take)
    depth = EMULATOR.buffer_beats
    b.always(unit.level <= depth)
    b.always(unit.s_axis.tready == (unit.level != depth))
    b.always(((unit.first + unit.level) % depth) == unit.behind)
    stored = b.same("stored_now", comes & unit.s_axis.tready)
    b.always(
        unit.level == b.last(unit.level) + b.past(stored) - Mux(b.past(take), b.last(amount), 0),
        where=b.past(Const(1)),
    )
    b.cover(take & (amount > 2) & comes)


@proof(depth=2, cover=8)
def stream_slice(b: Bench) -> None:
    """All beats leave in their order, and none is lost or doubled; a beat that waits stays as it
    is.
    """
    m, unit = b.m, StreamSlice()
    comes, ready = unit.s_axis.tvalid, unit.m_axis.tready
    # Beats that came and that left; a beat is its number.
    taken, left = (
        Signal(BEAT_BITS),
        Signal(BEAT_BITS),
    )
    b.place(unit, s_axis__tdata=taken)
    m.d.sync += [
        taken.eq(taken + (comes & unit.s_axis.tready)),
        left.eq(left + (unit.m_axis.tvalid & ready)),
    ]
    b.always(taken == (left + unit.valid + unit.spare_valid)[:BEAT_BITS])
    b.always(unit.m_axis.tdata == left, where=unit.m_axis.tvalid)
    b.always(unit.valid & (unit.spare == (left + 1)[:BEAT_BITS]), where=unit.spare_valid)
    held = b.same("held", unit.m_axis.tvalid & ~ready)
    b.always(unit.m_axis.tvalid, where=b.past(held))
    b.cover(unit.spare_valid & ready)


@proof(depth=4, cover=10)
def photon_source(b: Bench) -> None:
    """A pixel has at most one edge per cycle, none during its dead time, and none outside the
    periods.
    """
    m, unit = b.m, PhotonSource(EMULATOR)
    b.place(unit, common=b.constant(unit.common.shape().size))
    dead = b.same("dead", unit.common.as_value()[4:])
    words = b.same("words", unit.words)
    phases = SMALL.phases
    word = b.same("word", words[:phases])
    b.always((word & (word - 1)) == 0)
    b.always(b.past(unit.timing.running, 3), where=word != 0)
    left = Signal.like(dead)  # cycles of dead time left
    with m.If(word != 0):
        m.d.sync += left.eq(dead)
    with m.Elif(left != 0):
        m.d.sync += left.eq(left - 1)
    b.always(word == 0, where=left != 0)
    b.always(unit.dead[0] == Mux(word != 0, dead, Mux(left == 0, 0, left - 1)))
    b.cover(word != 0)
    b.cover((word != 0) & (dead == 2))
