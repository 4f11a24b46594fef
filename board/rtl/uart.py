# SPDX-License-Identifier: Apache-2.0
"""Serial line: bytes as 8N1, and frames of bytes with a CRC.

The protocol is in `board/serial_link.py`.
"""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.crc.catalog import CRC32_ISO_HDLC
from amaranth.lib.wiring import In, Out

from ...hdl.unit import Unit
from ..serial_link import BODY_BYTES_MAX, CRC_BYTES, ESCAPE, FLAG, FLIP

BITS = 10  # per byte on the line: start, eight data bits, stop


class Receiver(Unit):
    """Receiver of bytes from the line.

    Ports
    -----
    rx : in, asynchronous, high when idle
    valid : out, strobe; byte : out; broken : out, with `valid`: the stop bit was missing

    Each bit is sampled in its middle, counted from the start bit behind two flip-flops. A line that
    stays low gives broken bytes. After a reset, the receiver waits for a start bit.
    """

    unit_name = "coincid_uart_receiver"

    def __init__(self, clocks_per_bit: int):
        self.clocks = clocks_per_bit
        super().__init__(rx=In(1), valid=Out(1), byte=Out(8), broken=Out(1))

    def elaborate(self, platform):
        m = Module()
        line = Signal(init=1)
        m.submodules.synchronizer = FFSynchronizer(self.rx, line, init=1)
        count = Signal(range(self.clocks))
        left = Signal(range(BITS + 1))  # bits of the byte still to come
        shift = Signal(BITS)
        before = Signal(init=1)
        m.d.sync += [self.valid.eq(0), before.eq(line)]
        with m.If(left == 0):
            with m.If(before & ~line):
                m.d.sync += [left.eq(BITS), count.eq((self.clocks - 1) // 2)]
        with m.Elif(count == 0):
            m.d.sync += [
                count.eq(self.clocks - 1),
                shift.eq(Cat(shift[1:], line)),
                left.eq(left - 1),
            ]
            with m.If((left == BITS) & line):  # a spike, not a start bit
                m.d.sync += left.eq(0)
            with m.If(left == 1):
                m.d.sync += [self.valid.eq(1), self.byte.eq(shift[2:]), self.broken.eq(~line)]
        with m.Else():
            m.d.sync += count.eq(count - 1)
        return m


class Transmitter(Unit):
    """Transmitter of bytes to the line.

    Ports
    -----
    valid, byte : in; ready : out, the byte is taken in a cycle with both; tx : out, high when idle

    Reset drops a byte in progress.
    """

    unit_name = "coincid_uart_transmitter"

    def __init__(self, clocks_per_bit: int):
        self.clocks = clocks_per_bit
        super().__init__(valid=In(1), byte=In(8), ready=Out(1), tx=Out(1, init=1))

    def elaborate(self, platform):
        m = Module()
        count = Signal(range(self.clocks))
        left = Signal(range(BITS + 1))
        shift = Signal(BITS)
        m.d.comb += self.ready.eq(left == 0)
        m.d.sync += self.tx.eq(Mux(left == 0, 1, shift[0]))
        with m.If(self.ready):
            with m.If(self.valid):
                m.d.sync += [
                    shift.eq(Cat(Const(0, 1), self.byte, Const(1, 1))),
                    left.eq(BITS),
                    count.eq(self.clocks - 1),
                ]
        with m.Elif(count == 0):
            m.d.sync += [count.eq(self.clocks - 1), left.eq(left - 1), shift.eq(shift >> 1)]
        with m.Else():
            m.d.sync += count.eq(count - 1)
        return m


class Deframer(Unit):
    """Finder and checker of frames in a stream of bytes.

    Ports
    -----
    valid, byte, broken : in, from the receiver; hold : in, ignore what arrives; the next frame
        begins at the next flag
    put, data, index : out, a byte of the body, and its place in the body
    right : out, strobe: a body has ended, and its CRC is right; length : out, with `right`: bytes
        without the CRC
    wrong : out, strobe: a body has ended that is not right

    A body that is longer than any request is wrong, and so is one with a broken byte. Two flags in
    a row are not a frame. Outputs refer to the byte of the previous cycle. After a reset, the
    deframer waits for a flag.
    """

    unit_name = "coincid_deframer"

    def __init__(self):
        bits = BODY_BYTES_MAX.bit_length()
        super().__init__(
            valid=In(1),
            byte=In(8),
            broken=In(1),
            hold=In(1),
            put=Out(1),
            data=Out(8),
            index=Out(bits),
            right=Out(1),
            length=Out(bits),
            wrong=Out(1),
        )
        self.crc = CRC32_ISO_HDLC(8).create()
        # The byte that came, and what it is.
        self.came = Signal()
        self.byte_in = Signal(8)
        self.broken_in = Signal()
        self.is_flag = Signal()
        self.is_escape = Signal()
        # The frame so far.
        self.listening = Signal()  # a flag has begun it
        self.escaped = Signal()  # the last byte was an escape
        self.bad = Signal()  # it is too long, or a byte was broken
        self.count = Signal(bits)  # bytes of its body

    def elaborate(self, platform):
        m = Module()
        m.submodules.crc = crc = self.crc
        m.d.comb += [
            crc.data.eq(Mux(self.escaped, self.byte_in ^ FLIP, self.byte_in)),
            self.data.eq(crc.data),
            self.index.eq(self.count),
        ]
        m.d.sync += [self.right.eq(0), self.wrong.eq(0), self.length.eq(self.count - CRC_BYTES)]
        m.d.sync += [
            self.came.eq(self.valid),
            self.byte_in.eq(self.byte),
            self.broken_in.eq(self.broken),
            self.is_flag.eq(~self.broken & (self.byte == FLAG)),
            self.is_escape.eq(self.byte == ESCAPE),
        ]
        with m.If(self.came):
            with m.If(self.is_flag):
                m.d.comb += crc.start.eq(1)
                m.d.sync += [
                    self.listening.eq(1),
                    self.escaped.eq(0),
                    self.bad.eq(0),
                    self.count.eq(0),
                ]
                with m.If(self.listening & (self.count != 0)):
                    fine = ~self.bad & ~self.escaped & (self.count > CRC_BYTES) & crc.match_detected
                    m.d.sync += [self.right.eq(fine), self.wrong.eq(~fine)]
            with m.Elif(self.listening):
                with m.If(self.broken_in | (self.count == BODY_BYTES_MAX)):
                    m.d.sync += [self.bad.eq(1), self.count.eq(Mux(self.count == 0, 1, self.count))]
                with m.Elif(self.is_escape & ~self.escaped):
                    m.d.sync += [self.escaped.eq(1), self.count.eq(self.count)]
                with m.Else():
                    m.d.comb += [self.put.eq(1), crc.valid.eq(1)]
                    m.d.sync += [self.escaped.eq(0), self.count.eq(self.count + 1)]
        with m.If(self.hold):
            m.d.sync += [self.listening.eq(0), self.right.eq(0), self.wrong.eq(0)]
        return m


class Framer(Unit):
    """Encoder of bytes into frames.

    Ports
    -----
    valid, byte, last : in; ready : out, a byte of a body is taken in a cycle with both; `last`
        marks the body's last byte
    out_valid, out_byte : out, out_ready : in, to the transmitter

    The framer puts flags around the body, appends the CRC, and escapes bytes where necessary. It
    looks at a byte for one cycle before it sends it. Reset drops a frame in progress.
    """

    unit_name = "coincid_framer"

    def __init__(self):
        super().__init__(
            valid=In(1),
            byte=In(8),
            last=In(1),
            ready=Out(1),
            out_valid=Out(1),
            out_byte=Out(8),
            out_ready=In(1),
        )
        self.next_byte = Signal(8)
        self.escaped = Signal()  # its escape has been sent
        self.special = Signal()  # it needs an escape
        self.weighed = Signal()  # `special` is that of `next_byte`

    def elaborate(self, platform):
        m = Module()
        m.submodules.crc = crc = CRC32_ISO_HDLC(8).create()
        tail = Signal(32, reset_less=True)
        left = Signal(range(CRC_BYTES + 1))
        m.d.comb += crc.data.eq(self.byte)
        m.d.sync += [
            self.special.eq((self.next_byte == FLAG) | (self.next_byte == ESCAPE)),
            self.weighed.eq(0),
        ]

        def send_body(m, comes, sent):
            """Send `byte` when it `comes`, escaped if necessary; `sent` is high in the cycle in
            which it has gone.
            """
            m.d.sync += self.weighed.eq(comes & ~sent)
            m.d.comb += [
                self.out_valid.eq(self.weighed),
                self.out_byte.eq(
                    Mux(
                        self.special,
                        Mux(self.escaped, self.next_byte ^ FLIP, ESCAPE),
                        self.next_byte,
                    )
                ),
                sent.eq(self.weighed & self.out_ready & (~self.special | self.escaped)),
            ]
            with m.If(self.weighed & self.out_ready):
                m.d.sync += self.escaped.eq(self.special & ~self.escaped)

        with m.FSM() as self.machine:
            with m.State("idle"):
                m.d.comb += [self.out_byte.eq(FLAG), self.out_valid.eq(self.valid), crc.start.eq(1)]
                m.d.sync += self.escaped.eq(0)
                with m.If(self.valid & self.out_ready):
                    m.next = "body"
            with m.State("body"):
                m.d.comb += self.next_byte.eq(self.byte)
                send_body(m, self.valid, self.ready)
                m.d.comb += crc.valid.eq(self.ready)
                with m.If(self.ready & self.last):
                    m.next = "check"
            with m.State("check"):
                m.d.sync += [tail.eq(crc.crc), left.eq(CRC_BYTES), self.escaped.eq(0)]
                m.next = "tail"
            with m.State("tail"):
                m.d.comb += self.next_byte.eq(tail[:8])
                sent = Signal()
                send_body(m, Const(1), sent)
                with m.If(sent):
                    m.d.sync += [tail.eq(tail >> 8), left.eq(left - 1)]
                    with m.If(left == 1):
                        m.next = "flag"
            with m.State("flag"):
                m.d.comb += [self.out_byte.eq(FLAG), self.out_valid.eq(1)]
                with m.If(self.out_ready):
                    m.next = "idle"
        return m
