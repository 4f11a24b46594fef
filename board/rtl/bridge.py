# SPDX-License-Identifier: Apache-2.0
"""Serial bridge: access to the emulator's address space over two pins.

The protocol is in `board/serial_link.py`.
"""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from ...hdl.logic import saturating_add
from ...hdl.unit import Unit, place
from ...model.contract.registers import DATA_BITS
from .. import serial_link as link
from ..parameters import ADDRESS_BITS, Emulator
from ..serial_link import Answer, Operation
from .control import ACCESS
from .uart import Deframer, Framer, Receiver, Transmitter

LAST = 1 << 8  # beside the byte on its way to the framer
FETCH_CYCLES = 2  # from the address of a byte of the request to the byte
ANSWER_DEPTH = 2  # bytes of an answer on their way to the framer; no path of logic goes through


class SerialBridge(Unit):
    """Serial bridge.

    Ports
    -----
    rx : in, tx : out, the serial line; access : out, to the control; errors : out, number of
        damaged frames

    The bytes of a request wait in a memory until their CRC has been checked; nothing is executed
    before that. Damaged requests are dropped, and so is everything that arrives while a request is
    being executed: the host then asks again. The bridge waits for the host only between requests.
    Reset clears the sequence number.
    """

    unit_name = "coincid_serial_bridge"

    def __init__(self, emulator: Emulator):
        self.emulator = emulator
        super().__init__(rx=In(1), tx=Out(1, init=1), access=Out(ACCESS), errors=Out(DATA_BITS))
        # The request.
        self.head = Signal(8 * link.HEAD_BYTES, reset_less=True)
        self.sequence = self.head[:8]
        self.operation = self.head[8:16]
        self.count = self.head[16:24]
        self.length = Signal(link.BODY_BYTES_MAX.bit_length())  # its bytes
        # Place of the byte that is fetched from it.
        self.at = Signal(range(link.BODY_BYTES_MAX + 1))
        self.waited = Signal(range(FETCH_CYCLES + 1))  # cycles of the fetch
        self.byte = Signal(8)  # the byte that was fetched
        self.hold = Signal()  # ignore what arrives
        # What it is.
        self.short = Signal()
        self.is_hello = Signal()
        self.is_read = Signal()
        self.is_write = Signal()
        self.repeated = Signal()  # its number is that of the last one
        self.follows = Signal()  # its number is the next one
        # Progress.
        self.words = Signal(8)  # words of the request that are done
        self.is_last = Signal()  # this word is the last one
        self.byte_of = Signal(range(link.WORD_BYTES))  # bytes done of the word on its way
        self.word = Signal(DATA_BITS, reset_less=True)
        self.address = Signal(ADDRESS_BITS, reset_less=True)
        self.status = Signal(Answer)
        # The last request, which the host may repeat.
        self.last = Signal(8)  # its number
        self.last_done = Signal(8)  # words that were done
        self.last_status = Signal(Answer)
        self.last_wrote = Signal()
        self.greeted = Signal()  # a host has said hello
        self.fresh = Signal(init=1)  # no read or write since reset

    def elaborate(self, platform):
        m = Module()
        clocks = self.emulator.clocks_per_bit
        receiver = Receiver(clocks)
        deframer = Deframer()
        framer = Framer()
        m.submodules.answer = answer = SyncFIFOBuffered(
            width=len(framer.byte) + 1, depth=ANSWER_DEPTH
        )
        place(m, "receiver", receiver, platform, rx=self.rx)
        place(
            m,
            "deframer",
            deframer,
            platform,
            valid=receiver.valid,
            byte=receiver.byte,
            broken=receiver.broken,
            hold=self.hold,
        )
        transmitter = Transmitter(clocks)
        place(
            m,
            "transmitter",
            transmitter,
            platform,
            valid=framer.out_valid,
            byte=framer.out_byte,
        )
        place(
            m,
            "framer",
            framer,
            platform,
            valid=answer.r_rdy,
            byte=answer.r_data[:8],
            last=answer.r_data[8],
            out_ready=transmitter.ready,
        )
        m.submodules.request = memory = Memory(
            shape=8, depth=1 << (link.BODY_BYTES_MAX - 1).bit_length(), init=[]
        )
        put = memory.write_port()
        get = memory.read_port()
        m.d.comb += [
            put.en.eq(deframer.put),
            put.addr.eq(deframer.index),
            put.data.eq(deframer.data),
            get.en.eq(1),
            self.tx.eq(transmitter.tx),
            answer.r_en.eq(framer.ready),
        ]
        with m.If(deframer.wrong):
            saturating_add(m, self.errors, 1)
        m.d.comb += get.addr.eq(self.at)
        m.d.sync += self.byte.eq(get.data)
        self._obey(m, deframer, answer)
        return m

    def _weigh(self, m):
        """Register what a request is, so that no decision waits for a comparison."""
        alone = self.length == link.HEAD_BYTES
        with_words = self.length == link.HEAD_BYTES + link.WORD_BYTES * self.count
        m.d.sync += [
            self.short.eq(self.length < link.HEAD_BYTES),
            self.is_hello.eq((self.operation == Operation.HELLO) & alone),
            self.repeated.eq(self.sequence == self.last),
            self.follows.eq(self.sequence == (self.last + 1)[:8]),
            self.is_last.eq(self.words + 1 == self.count),
            self.is_read.eq(
                (self.operation == Operation.READ)
                & alone
                & (self.count != 0)
                & (self.count <= link.READ_WORDS_MAX)
            ),
            self.is_write.eq(
                (self.operation == Operation.WRITE)
                & with_words
                & (self.count != 0)
                & (self.count <= link.WRITE_WORDS_MAX)
            ),
        ]

    def _obey(self, m, deframer, answer):
        """Read a request whose CRC was right, execute it, and send the answer."""
        access = self.access
        self._weigh(m)
        m.d.comb += [
            access.address.eq(self.address),
            access.data.eq(self.word),
            access.write.eq(self.is_write),
        ]
        m.d.comb += self.hold.eq(1)
        m.d.sync += access.valid.eq(0)
        with m.FSM():
            self._receive(m, deframer)
            with m.State("weigh"):
                m.next = "look"
            with m.State("look"):
                self._look(m)
            self._execute_write(m)
            self._send(m, answer)

    def _receive(self, m, deframer):
        """States that wait for a request and read its head out of the memory."""
        with m.State("listen"):
            m.d.comb += self.hold.eq(deframer.right)
            m.d.sync += [self.at.eq(0), self.waited.eq(0)]
            with m.If(deframer.right):
                m.d.sync += self.length.eq(deframer.length)
                m.next = "head"
        with m.State("head"):
            m.d.sync += self.waited.eq(self.waited + 1)
            with m.If(self.waited == FETCH_CYCLES):
                m.d.sync += [
                    self.head.eq(Cat(self.head[8:], self.byte)),
                    self.at.eq(self.at + 1),
                    self.waited.eq(0),
                ]
                with m.If(self.at == link.HEAD_BYTES - 1):
                    m.next = "weigh"

    def _look(self, m):
        """Decide what a request needs: words, or only an answer."""
        m.d.sync += [self.words.eq(0), self.byte_of.eq(0), self.address.eq(self.head[24:])]
        m.d.sync += self.status.eq(Answer.OKAY)
        m.next = "number"
        with m.If(self.short):
            m.d.sync += self.status.eq(Answer.UNKNOWN)
        with m.Elif(self.is_hello):
            m.d.sync += [self.last.eq(self.sequence), self.greeted.eq(1), self.last_wrote.eq(0)]
            m.d.sync += self.status.eq(Mux(self.fresh, Answer.FRESH, Answer.OKAY))
        with m.Elif(~self.greeted):
            m.d.sync += self.status.eq(Answer.FRESH)
        with m.Elif(~self.is_read & ~self.is_write):
            m.d.sync += self.status.eq(Answer.UNKNOWN)
        with m.Elif(~self.repeated & ~self.follows):
            m.d.sync += self.status.eq(Answer.SEQUENCE)
        with m.Elif(self.is_write & self.repeated):
            m.d.sync += self.words.eq(self.last_done)
            m.d.sync += self.status.eq(Mux(self.last_wrote, self.last_status, Answer.SEQUENCE))
        with m.Elif(self.is_write):
            m.d.sync += self.fresh.eq(0)
            m.next = "collect"
        with m.Else():
            m.d.sync += [self.last.eq(self.sequence), self.last_wrote.eq(0), self.fresh.eq(0)]

    def _execute_write(self, m):
        """States that take the words of a write out of the memory and write them, one by one."""
        access = self.access
        with m.State("collect"):
            m.d.sync += self.waited.eq(self.waited + 1)
            with m.If(self.waited == FETCH_CYCLES):
                m.d.sync += [self.word.eq(Cat(self.word[8:], self.byte)), self.at.eq(self.at + 1)]
                m.d.sync += [self.byte_of.eq(self.byte_of + 1), self.waited.eq(0)]
                with m.If(self.byte_of == link.WORD_BYTES - 1):
                    m.next = "write"
        with m.State("write"):
            m.d.sync += access.valid.eq(~access.done)
            with m.If(access.done):
                m.d.sync += self.address.eq(self.address + link.WORD_BYTES)
                with m.If(access.refused):
                    m.d.sync += self.status.eq(Answer.REFUSED)
                    m.next = "remember"
                with m.Else():
                    m.d.sync += self.words.eq(self.words + 1)
                    m.next = "collect"
                    with m.If(self.is_last):
                        m.next = "remember"
        with m.State("remember"):
            m.d.sync += [self.last.eq(self.sequence), self.last_wrote.eq(1)]
            m.d.sync += [self.last_done.eq(self.words), self.last_status.eq(self.status)]
            m.next = "number"

    def _send(self, m, answer):
        """States that send the answer; the words of a read are read meanwhile."""
        access = self.access
        with m.State("number"), self._sending(m, answer, self.sequence):
            m.next = "status"
            with m.If(
                self.is_write & ((self.status == Answer.OKAY) | (self.status == Answer.REFUSED))
            ):
                m.next = "written"
            with m.Elif(self.is_read & (self.status == Answer.OKAY)):
                m.next = "read"
        with m.State("written"), self._sending(m, answer, self.words):
            m.next = "status"
        with m.State("read"):
            m.d.sync += access.valid.eq(~access.done)
            with m.If(access.done):
                m.d.sync += [
                    self.address.eq(self.address + link.WORD_BYTES),
                    self.word.eq(access.value),
                ]
                m.next = "word"
                with m.If(access.refused):
                    m.d.sync += self.status.eq(Answer.REFUSED)
                    m.next = "status"
        with m.State("word"), self._sending(m, answer, self.word[:8]):
            m.d.sync += [self.word.eq(self.word >> 8), self.byte_of.eq(self.byte_of + 1)]
            with m.If(self.byte_of == link.WORD_BYTES - 1):
                m.d.sync += self.words.eq(self.words + 1)
                m.next = "read"
                with m.If(self.is_last):
                    m.next = "status"
        with m.State("status"), self._sending(m, answer, self.status | LAST):
            m.next = "listen"

    def _sending(self, m, answer, byte):
        """Offer a byte of the answer; return the condition that it is taken."""
        m.d.comb += [answer.w_en.eq(1), answer.w_data.eq(byte)]
        return m.If(answer.w_rdy)
