# SPDX-License-Identifier: Apache-2.0
"""Serial bridge: access to the emulator's address space over two pins; protocol in `model/contract/serial_link.py`."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from ...model.contract.emulator import ADDRESS_BITS, Emulator
from ...model.contract.registers import DATA_BITS
from ...model.contract.serial_link import (
    BODY_BYTES_MAX,
    HEAD_BYTES,
    READ_WORDS_MAX,
    WORD_BYTES,
    WRITE_WORDS_MAX,
    Answer,
    Operation,
)
from ..logic import saturating_add
from ..unit import Unit, place
from .control import ACCESS
from .uart import Deframer, Framer, Receiver, Transmitter

LAST = 1 << 8  # beside the byte on its way to the framer
FETCH_CYCLES = 2  # from the place of a byte of the request to the byte
ANSWER_DEPTH = 2  # bytes of an answer on their way to the framer, which no path of logic passes


class SerialBridge(Unit):
    """Serial bridge.

    Ports
    -----
    rx : in, tx : out, the serial line; access : out, to the control; errors : out, number of damaged frames

    The bytes of a request wait in a memory until their CRC has been checked; nothing is executed before that. Damaged
    requests are dropped, and so is everything that arrives while a request is being executed: the host then asks again.
    The bridge waits for the host only between requests. Reset clears the sequence number.
    """

    unit_name = "coincid_serial_bridge"

    def __init__(self, emulator: Emulator):
        self.emulator = emulator
        super().__init__({"rx": In(1), "tx": Out(1, init=1), "access": Out(ACCESS), "errors": Out(DATA_BITS)})

    def elaborate(self, platform):
        m = Module()
        clocks = self.emulator.clocks_per_bit
        receiver = place(m, "receiver", Receiver(clocks), platform)
        transmitter = place(m, "transmitter", Transmitter(clocks), platform)
        deframer = place(m, "deframer", Deframer(), platform)
        framer = place(m, "framer", Framer(), platform)
        m.submodules.answer = answer = SyncFIFOBuffered(width=len(framer.byte) + 1, depth=ANSWER_DEPTH)
        m.submodules.request = memory = Memory(shape=8, depth=1 << (BODY_BYTES_MAX - 1).bit_length(), init=[])
        put, get = memory.write_port(), memory.read_port()
        m.d.comb += [
            receiver.rx.eq(self.rx),
            deframer.valid.eq(receiver.valid),
            deframer.byte.eq(receiver.byte),
            deframer.broken.eq(receiver.broken),
            put.en.eq(deframer.put),
            put.addr.eq(deframer.index),
            put.data.eq(deframer.data),
            get.en.eq(1),
            transmitter.valid.eq(framer.out_valid),
            transmitter.byte.eq(framer.out_byte),
            framer.out_ready.eq(transmitter.ready),
            self.tx.eq(transmitter.tx),
            framer.valid.eq(answer.r_rdy),
            Cat(framer.byte, framer.last).eq(answer.r_data),
            answer.r_en.eq(framer.ready),
        ]
        with m.If(deframer.wrong):
            saturating_add(m, self.errors, 1)
        self._obey(m, deframer, answer, get)
        return m

    def _obey(self, m, deframer, answer, get):
        """Read a request whose CRC was right, execute it, and send the answer."""
        access = self.access
        head = Signal(8 * HEAD_BYTES, reset_less=True)
        length = Signal.like(deframer.length)
        at = Signal(range(BODY_BYTES_MAX + 1))
        waited = Signal(range(FETCH_CYCLES + 1))
        byte = Signal(8)  # at `at`
        m.d.sync += byte.eq(get.data)
        sequence, operation, count = head[:8], head[8:16], head[16:24]
        last, last_wrote, last_done, last_status = Signal(8), Signal(), Signal(8), Signal(Answer)
        greeted, fresh = Signal(), Signal(init=1)  # fresh: no read or write since reset
        words, byte_of = Signal(8), Signal(range(WORD_BYTES))
        word = Signal(DATA_BITS, reset_less=True)
        address = Signal(ADDRESS_BITS, reset_less=True)
        status = Signal(Answer)
        m.d.comb += [get.addr.eq(at), access.address.eq(address), access.data.eq(word)]
        # What a request is, in registers, so that no decision waits for a comparison.
        short, is_hello, is_read, is_write, repeated, follows = (Signal() for _ in range(6))
        m.d.comb += access.write.eq(is_write)
        is_last = Signal()  # the word on its way is the request's last
        m.d.sync += [
            short.eq(length < HEAD_BYTES),
            is_hello.eq((operation == Operation.HELLO) & (length == HEAD_BYTES)),
            repeated.eq(sequence == last),
            follows.eq(sequence == (last + 1)[:8]),
            is_last.eq(words + 1 == count),
            is_read.eq(
                (operation == Operation.READ) & (length == HEAD_BYTES) & (count != 0) & (count <= READ_WORDS_MAX)
            ),
            is_write.eq(
                (operation == Operation.WRITE)
                & (length == HEAD_BYTES + WORD_BYTES * count)
                & (count != 0)
                & (count <= WRITE_WORDS_MAX)
            ),
        ]
        m.d.comb += deframer.hold.eq(1)
        m.d.sync += access.valid.eq(0)
        with m.FSM():
            with m.State("listen"):
                m.d.comb += deframer.hold.eq(deframer.right)
                m.d.sync += [at.eq(0), waited.eq(0)]
                with m.If(deframer.right):
                    m.d.sync += length.eq(deframer.length)
                    m.next = "head"
            with m.State("head"):
                m.d.sync += waited.eq(waited + 1)
                with m.If(waited == FETCH_CYCLES):
                    m.d.sync += [head.eq(Cat(head[8:], byte)), at.eq(at + 1), waited.eq(0)]
                    with m.If(at == HEAD_BYTES - 1):
                        m.next = "weigh"
            with m.State("weigh"):
                m.next = "look"
            with m.State("look"):
                m.d.sync += [words.eq(0), byte_of.eq(0), address.eq(head[24:]), status.eq(Answer.OKAY)]
                m.next = "number"
                with m.If(short):
                    m.d.sync += status.eq(Answer.UNKNOWN)
                with m.Elif(is_hello):
                    m.d.sync += [last.eq(sequence), greeted.eq(1), last_wrote.eq(0)]
                    m.d.sync += status.eq(Mux(fresh, Answer.FRESH, Answer.OKAY))
                with m.Elif(~greeted):
                    m.d.sync += status.eq(Answer.FRESH)
                with m.Elif(~is_read & ~is_write):
                    m.d.sync += status.eq(Answer.UNKNOWN)
                with m.Elif(~repeated & ~follows):
                    m.d.sync += status.eq(Answer.SEQUENCE)
                with m.Elif(is_write & repeated):
                    m.d.sync += [words.eq(last_done), status.eq(Mux(last_wrote, last_status, Answer.SEQUENCE))]
                    m.next = "number"
                with m.Elif(is_write):
                    m.d.sync += fresh.eq(0)
                    m.next = "collect"
                with m.Else():
                    m.d.sync += [last.eq(sequence), last_wrote.eq(0), fresh.eq(0)]
            # A write: take the words out of the memory one by one, then answer.
            with m.State("collect"):
                m.d.sync += waited.eq(waited + 1)
                with m.If(waited == FETCH_CYCLES):
                    m.d.sync += [word.eq(Cat(word[8:], byte)), at.eq(at + 1), byte_of.eq(byte_of + 1), waited.eq(0)]
                    with m.If(byte_of == WORD_BYTES - 1):
                        m.next = "write"
            with m.State("write"):
                m.d.sync += access.valid.eq(~access.done)
                with m.If(access.done):
                    m.d.sync += address.eq(address + WORD_BYTES)
                    with m.If(access.refused):
                        m.d.sync += status.eq(Answer.REFUSED)
                        m.next = "remember"
                    with m.Else():
                        m.d.sync += words.eq(words + 1)
                        m.next = "collect"
                        with m.If(is_last):
                            m.next = "remember"
            with m.State("remember"):
                m.d.sync += [last.eq(sequence), last_wrote.eq(1), last_done.eq(words), last_status.eq(status)]
                m.next = "number"
            # Send the answer.
            with m.State("number"):
                m.d.comb += [answer.w_en.eq(1), answer.w_data.eq(sequence)]
                with m.If(answer.w_rdy):
                    m.next = "status"
                    with m.If(is_write & ((status == Answer.OKAY) | (status == Answer.REFUSED))):
                        m.next = "written"
                    with m.Elif(is_read & (status == Answer.OKAY)):
                        m.next = "read"
            with m.State("written"):
                m.d.comb += [answer.w_en.eq(1), answer.w_data.eq(words)]
                with m.If(answer.w_rdy):
                    m.next = "status"
            with m.State("read"):
                m.d.sync += access.valid.eq(~access.done)
                with m.If(access.done):
                    m.d.sync += [address.eq(address + WORD_BYTES), word.eq(access.value)]
                    m.next = "word"
                    with m.If(access.refused):
                        m.d.sync += status.eq(Answer.REFUSED)
                        m.next = "status"
            with m.State("word"):
                m.d.comb += [answer.w_en.eq(1), answer.w_data.eq(word[:8])]
                with m.If(answer.w_rdy):
                    m.d.sync += [word.eq(word >> 8), byte_of.eq(byte_of + 1)]
                    with m.If(byte_of == WORD_BYTES - 1):
                        m.d.sync += words.eq(words + 1)
                        m.next = "read"
                        with m.If(is_last):
                            m.next = "status"
            with m.State("status"):
                m.d.comb += [answer.w_en.eq(1), answer.w_data.eq(status | LAST)]
                with m.If(answer.w_rdy):
                    m.next = "listen"
