# SPDX-License-Identifier: Apache-2.0
"""Serial bridge: access to the emulator's address space over two pins; protocol in `model/contract/serial_link.py`."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from ...model.contract import serial_link as link
from ...model.contract.emulator import ADDRESS_BITS, Emulator
from ...model.contract.registers import DATA_BITS
from ...model.contract.serial_link import Answer, Operation
from ..logic import saturating_add
from ..unit import Unit, place
from .control import ACCESS
from .uart import Deframer, Framer, Receiver, Transmitter

LAST = 1 << 8  # beside the byte on its way to the framer
FETCH_CYCLES = 2  # from the place of a byte of the request to the byte
ANSWER_DEPTH = 2  # bytes of an answer on their way to the framer, which no path of logic passes


class BridgeState:
    """Registers of the bridge.

    head, length: of the request; at: place of the byte that is fetched from it, waited: for so many cycles. words, byte_of:
    done, of the request, and of the word on its way; is_last: this word is the last one. last, last_*: of the last request.
    fresh: no read or write since reset; greeted: a host has said hello.
    """

    def __init__(self):
        self.head = Signal(8 * link.HEAD_BYTES, reset_less=True)
        self.sequence, self.operation, self.count = (self.head[8 * k : 8 * k + 8] for k in range(3))
        self.length = Signal(link.BODY_BYTES_MAX.bit_length())
        self.at = Signal(range(link.BODY_BYTES_MAX + 1))
        self.waited = Signal(range(FETCH_CYCLES + 1))
        self.byte = Signal(8)
        self.last = Signal(8)
        self.last_wrote = Signal()
        self.last_done = Signal(8)
        self.last_status = Signal(Answer)
        self.greeted = Signal()
        self.fresh = Signal(init=1)
        self.words = Signal(8)
        self.byte_of = Signal(range(link.WORD_BYTES))
        self.word = Signal(DATA_BITS, reset_less=True)
        self.address = Signal(ADDRESS_BITS, reset_less=True)
        self.status = Signal(Answer)
        self.short = Signal()
        self.is_hello = Signal()
        self.is_read = Signal()
        self.is_write = Signal()
        self.is_last = Signal()
        self.repeated = Signal()
        self.follows = Signal()


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
        super().__init__(rx=In(1), tx=Out(1, init=1), access=Out(ACCESS), errors=Out(DATA_BITS))
        self.state = BridgeState()

    def elaborate(self, platform):
        m = Module()
        clocks = self.emulator.clocks_per_bit
        receiver, deframer, framer = Receiver(clocks), Deframer(), Framer()
        m.submodules.answer = answer = SyncFIFOBuffered(width=len(framer.byte) + 1, depth=ANSWER_DEPTH)
        place(m, "receiver", receiver, platform, rx=self.rx)
        place(m, "deframer", deframer, platform, **deframer.fed(receiver.outputs()))
        sent = {"valid": framer.out_valid, "byte": framer.out_byte}
        transmitter = place(m, "transmitter", Transmitter(clocks), platform, **sent)
        place(m, "framer", framer, platform, valid=answer.r_rdy, out_ready=transmitter.ready)
        m.submodules.request = memory = Memory(shape=8, depth=1 << (link.BODY_BYTES_MAX - 1).bit_length(), init=[])
        put = memory.write_port()
        get = memory.read_port()
        m.d.comb += [
            put.en.eq(deframer.put),
            put.addr.eq(deframer.index),
            put.data.eq(deframer.data),
            get.en.eq(1),
            self.tx.eq(transmitter.tx),
            Cat(framer.byte, framer.last).eq(answer.r_data),
            answer.r_en.eq(framer.ready),
        ]
        with m.If(deframer.wrong):
            saturating_add(m, self.errors, 1)
        m.d.comb += get.addr.eq(self.state.at)
        m.d.sync += self.state.byte.eq(get.data)
        self._obey(m, deframer, answer)
        return m

    def _weigh(self, m):
        """Register what a request is, so that no decision waits for a comparison."""
        state = self.state
        alone = state.length == link.HEAD_BYTES
        with_words = state.length == link.HEAD_BYTES + link.WORD_BYTES * state.count
        m.d.sync += [
            state.short.eq(state.length < link.HEAD_BYTES),
            state.is_hello.eq((state.operation == Operation.HELLO) & alone),
            state.repeated.eq(state.sequence == state.last),
            state.follows.eq(state.sequence == (state.last + 1)[:8]),
            state.is_last.eq(state.words + 1 == state.count),
            state.is_read.eq(
                (state.operation == Operation.READ) & alone & (state.count != 0) & (state.count <= link.READ_WORDS_MAX)
            ),
            state.is_write.eq(
                (state.operation == Operation.WRITE)
                & with_words
                & (state.count != 0)
                & (state.count <= link.WRITE_WORDS_MAX)
            ),
        ]

    def _obey(self, m, deframer, answer):
        """Read a request whose CRC was right, execute it, and send the answer."""
        state, access = self.state, self.access
        self._weigh(m)
        m.d.comb += [access.address.eq(state.address), access.data.eq(state.word), access.write.eq(state.is_write)]
        m.d.comb += deframer.hold.eq(1)
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
        state = self.state
        with m.State("listen"):
            m.d.comb += deframer.hold.eq(deframer.right)
            m.d.sync += [state.at.eq(0), state.waited.eq(0)]
            with m.If(deframer.right):
                m.d.sync += state.length.eq(deframer.length)
                m.next = "head"
        with m.State("head"):
            m.d.sync += state.waited.eq(state.waited + 1)
            with m.If(state.waited == FETCH_CYCLES):
                m.d.sync += [
                    state.head.eq(Cat(state.head[8:], state.byte)),
                    state.at.eq(state.at + 1),
                    state.waited.eq(0),
                ]
                with m.If(state.at == link.HEAD_BYTES - 1):
                    m.next = "weigh"

    def _look(self, m):
        """Decide what a request needs: words, or only an answer."""
        state = self.state
        m.d.sync += [state.words.eq(0), state.byte_of.eq(0), state.address.eq(state.head[24:])]
        m.d.sync += state.status.eq(Answer.OKAY)
        m.next = "number"
        with m.If(state.short):
            m.d.sync += state.status.eq(Answer.UNKNOWN)
        with m.Elif(state.is_hello):
            m.d.sync += [state.last.eq(state.sequence), state.greeted.eq(1), state.last_wrote.eq(0)]
            m.d.sync += state.status.eq(Mux(state.fresh, Answer.FRESH, Answer.OKAY))
        with m.Elif(~state.greeted):
            m.d.sync += state.status.eq(Answer.FRESH)
        with m.Elif(~state.is_read & ~state.is_write):
            m.d.sync += state.status.eq(Answer.UNKNOWN)
        with m.Elif(~state.repeated & ~state.follows):
            m.d.sync += state.status.eq(Answer.SEQUENCE)
        with m.Elif(state.is_write & state.repeated):
            m.d.sync += state.words.eq(state.last_done)
            m.d.sync += state.status.eq(Mux(state.last_wrote, state.last_status, Answer.SEQUENCE))
        with m.Elif(state.is_write):
            m.d.sync += state.fresh.eq(0)
            m.next = "collect"
        with m.Else():
            m.d.sync += [state.last.eq(state.sequence), state.last_wrote.eq(0), state.fresh.eq(0)]

    def _execute_write(self, m):
        """States that take the words of a write out of the memory and write them, one by one."""
        state, access = self.state, self.access
        with m.State("collect"):
            m.d.sync += state.waited.eq(state.waited + 1)
            with m.If(state.waited == FETCH_CYCLES):
                m.d.sync += [state.word.eq(Cat(state.word[8:], state.byte)), state.at.eq(state.at + 1)]
                m.d.sync += [state.byte_of.eq(state.byte_of + 1), state.waited.eq(0)]
                with m.If(state.byte_of == link.WORD_BYTES - 1):
                    m.next = "write"
        with m.State("write"):
            m.d.sync += access.valid.eq(~access.done)
            with m.If(access.done):
                m.d.sync += state.address.eq(state.address + link.WORD_BYTES)
                with m.If(access.refused):
                    m.d.sync += state.status.eq(Answer.REFUSED)
                    m.next = "remember"
                with m.Else():
                    m.d.sync += state.words.eq(state.words + 1)
                    m.next = "collect"
                    with m.If(state.is_last):
                        m.next = "remember"
        with m.State("remember"):
            m.d.sync += [state.last.eq(state.sequence), state.last_wrote.eq(1)]
            m.d.sync += [state.last_done.eq(state.words), state.last_status.eq(state.status)]
            m.next = "number"

    def _send(self, m, answer):
        """States that send the answer; the words of a read are read meanwhile."""
        state, access = self.state, self.access
        with m.State("number"), self._sending(m, answer, state.sequence):
            m.next = "status"
            with m.If(state.is_write & ((state.status == Answer.OKAY) | (state.status == Answer.REFUSED))):
                m.next = "written"
            with m.Elif(state.is_read & (state.status == Answer.OKAY)):
                m.next = "read"
        with m.State("written"), self._sending(m, answer, state.words):
            m.next = "status"
        with m.State("read"):
            m.d.sync += access.valid.eq(~access.done)
            with m.If(access.done):
                m.d.sync += [state.address.eq(state.address + link.WORD_BYTES), state.word.eq(access.value)]
                m.next = "word"
                with m.If(access.refused):
                    m.d.sync += state.status.eq(Answer.REFUSED)
                    m.next = "status"
        with m.State("word"), self._sending(m, answer, state.word[:8]):
            m.d.sync += [state.word.eq(state.word >> 8), state.byte_of.eq(state.byte_of + 1)]
            with m.If(state.byte_of == link.WORD_BYTES - 1):
                m.d.sync += state.words.eq(state.words + 1)
                m.next = "read"
                with m.If(state.is_last):
                    m.next = "status"
        with m.State("status"), self._sending(m, answer, state.status | LAST):
            m.next = "listen"

    def _sending(self, m, answer, byte):
        """Offer a byte of the answer; return the condition that it is taken."""
        m.d.comb += [answer.w_en.eq(1), answer.w_data.eq(byte)]
        return m.If(answer.w_rdy)
