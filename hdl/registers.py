# SPDX-License-Identifier: Apache-2.0
"""Register front: AXI4-Lite slave, range checks, global registers, start of a frame; map in
`model/contract/registers.py`.
"""

from itertools import pairwise
from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, ResetInserter, Signal
from amaranth.lib import data
from amaranth.lib.wiring import In, Out

from ..model.contract import registers
from ..model.contract.packet import FORMAT_NAMES, built_formats
from ..model.contract.parameters import Sensor, bits_for
from ..model.contract.registers import (
    BY_NAME,
    DATA_BITS,
    SUBGROUP_BASE,
    SUBGROUP_STRIDE,
    WRITABLE,
    Access,
)
from ..model.contract.settings import AUTO_BOUNDS
from . import bus
from .axi import LITE, OKAY, SLVERR
from .logic import any_of
from .unit import Unit
from .voted import Voted

DECODE_CYCLES = 2  # from an address in its register to the result of its decoding
READ_CYCLES = (
    5  # from a word's name on the configuration bus to its data in this block's input register
)
CHECK_CYCLES = (
    7  # from decoding a start until the start checks of all subgroups have seen the write before it
)
BLOCK_BITS = bits_for(SUBGROUP_STRIDE - 1)  # width of an address inside a subgroup's block
RESTING_CYCLES = (
    15  # if the sequencer has rested for so long, a frame that was started has been lost
)
CONTROL, STATUS = BY_NAME["control"], BY_NAME["status"]


def _sent_words(sensor: Sensor) -> int:
    """Return the number of words that a start sends for the thresholds."""
    return 2 * sensor.streams + AUTO_BOUNDS if sensor.controller else 0


def write_cycles_max(sensor: Sensor) -> int:
    """Return the most cycles from a write's address and data to its answer: those of a start, after
    a read in progress.
    """
    read_in_progress = READ_CYCLES + 2
    decoding = 3
    return 1 + read_in_progress + decoding + CHECK_CYCLES + _sent_words(sensor) + 2


def read_cycles_max(sensor: Sensor) -> int:
    """Return the most cycles from a read's address to its answer, after a start in progress."""
    start_in_progress = CHECK_CYCLES + 2 + _sent_words(sensor) + 1
    return start_in_progress + READ_CYCLES + 2


def _controller_ports(sensor: Sensor) -> dict[str, Any]:
    per_stream = data.ArrayLayout(DATA_BITS, sensor.streams)
    return {
        "capacity": Out(DATA_BITS),
        "share": Out(per_stream),
        "budget": In(per_stream),
        "limit": In(per_stream),
    }


class Registers(Unit):
    """Register front of the sensor.

    Ports
    -----
    s_axi : AXI4-Lite slave, 32-bit data. One access at a time; address and data of a write may come
        in any order. A write that is refused is answered with SLVERR, changes nothing and sets a
        sticky bit; a read of an unmapped address is answered with SLVERR and 0. A write without any
        strobe asks for nothing: it is answered with OKAY and changes nothing. A read ignores the
        lowest two bits of its address. `ready` is low during a reset, from its second cycle on, and
        in the cycle after it.
    command : out, configuration bus to all subgroups; data : in, OR of their answers
    gate_late, settings_upset : in, OR of the subgroups' start checks
    period : out, as programmed; frame : out, settings of the running frame; plan : out, settings of
        the sequencer
    start_frame, abort_frame : out, strobes; done : in, strobe; resting : in, the sequencer has no
        frame
    soft_reset : out, strobe: the software resets the sensor. It resets everything here except the
        port, too, so the write that asks for it is answered, and a read that waits is not lost
    capacity, share : out, as programmed, to the threshold controllers; budget, limit : in, from
        them; one word per stream; only if the controllers are built

    Reset loads the reset values of the table and drops accesses in progress. An upset may delay or
    refuse an access, but none makes it wait for ever; the handshake with the master is voted. Each
    setting keeps the parity that its value had at the port, and a start is refused if a parity does
    not match. Two registers of opposite polarity must agree on a soft reset.
    """

    unit_name = "coincid_registers"

    def __init__(self, sensor: Sensor):
        self.sensor = sensor
        super().__init__(
            s_axi=In(LITE),
            command=Out(bus.CONFIG_BUS),
            data=In(DATA_BITS),
            gate_late=In(1),
            settings_upset=In(1),
            period=Out(sensor.coarse_bits + 1),
            frame=Out(bus.frame_layout(sensor)),
            plan=Out(bus.plan_layout(sensor)),
            start_frame=Out(1),
            abort_frame=Out(1),
            soft_reset=Out(1),
            done=In(1),
            resting=In(1),
            **(_controller_ports(sensor) if sensor.controller else {}),
        )
        # An access.
        self.up = Signal()  # there was no reset in the previous cycle
        self.write_address = Signal(registers.ADDRESS_BITS)  # the address that the master gave
        self.read_word = Signal(registers.ADDRESS_BITS - 2)  # the word that the master asked for
        self.address = Signal(registers.ADDRESS_BITS)  # the address of the access at work
        self.same_address = Signal()  # it is the one that the master gave
        self.held_write = Signal()  # address and value of a write are there
        self.value = Signal(DATA_BITS)  # the value to write
        self.parity = Signal()  # its parity at the port
        self.same_value = Signal()  # it has this parity
        self.whole = Signal()  # all bytes of the word are to be written
        # No byte is. With a bit for each case, an upset of one of them never drops a write silently.
        self.empty = Signal()
        self.wait = Signal(range(max(READ_CYCLES, CHECK_CYCLES) + 1))  # cycles so far
        # Its end.
        self.grants = Signal()  # the write is answered with OKAY
        self.refuses = Signal()  # the write is answered with SLVERR
        self.answers_read = Signal()
        self.asks_reset = Signal()  # the write asks for a soft reset
        # The word at the address.
        self.in_subgroup = Signal()  # it is in a subgroup's block
        self.mapped = Signal()
        self.writable = Signal()
        self.legal = Signal()  # the value is in its range
        self.found = Signal(DATA_BITS)  # its value if it is a global register
        self.data_in = Signal(DATA_BITS)  # its value if it is in a subgroup's block
        self.named = {
            (register.name, index): Signal(name=f"named_{register.name}_{index}")
            for table in (registers.GLOBAL, registers.SUBGROUP)
            for _, register, index in registers.words(table, sensor)
        }
        # The programmed settings of the global block, by name and index.
        self.setting = {
            (register.name, index): Signal(
                bits_for(register.high(sensor)),
                init=register.reset(sensor),
                name=f"{register.name}_{index}",
            )
            for _, register, index in registers.words(registers.GLOBAL, sensor)
            if register.access is Access.SETTING
        }
        self.setting_parity = {
            key: Signal(init=setting.init.bit_count() & 1, name=f"parity_of_{setting.name}")
            for key, setting in self.setting.items()
        }
        # Flags of the status.
        self.flag = {bits.name: Signal(name=f"flag_{bits.name}") for bits in STATUS.bits}
        # A frame.
        self.sent = Signal(range(2 * sensor.streams + AUTO_BOUNDS))  # words sent for thresholds
        self.rested = Signal(range(RESTING_CYCLES + 1))  # cycles without a frame while busy
        self.plan_parity = Signal()  # parity of `plan`

    def elaborate(self, platform):
        m = Module()
        self._write_channel(m)
        self._read_channel(m)
        self._soft_reset(m)
        self.behind_port = behind = Module()
        self._global_settings(behind)
        self._decode(behind)
        self._select(behind)
        self._start_checks(behind)
        self._accesses(behind)
        m.submodules.behind_port = ResetInserter(self.soft_reset)(behind)
        return m

    def _write_channel(self, m):
        """Hold address and data of a write until the write is answered."""
        axi = self.s_axi
        m.d.sync += self.up.eq(1)
        held_address = Voted(m, "held_address")
        held_data = Voted(m, "held_data")
        self.held_read = Voted(m, "held_read")
        self.answered_write = Voted(m, "answered_write")
        self.answered_read = Voted(m, "answered_read")
        self.voted = [
            held_address,
            held_data,
            self.held_read,
            self.answered_write,
            self.answered_read,
        ]
        m.d.comb += [
            axi.awready.eq(~held_address.value & self.up),
            axi.wready.eq(~held_data.value & self.up),
            axi.bvalid.eq(self.answered_write.value),
            self.held_write.eq(held_address.value & held_data.value),
        ]
        with m.If(axi.awvalid & axi.awready):
            m.d.comb += held_address.next.eq(1)
            m.d.sync += self.write_address.eq(axi.awaddr)
        with m.If(axi.wvalid & axi.wready):
            m.d.comb += held_data.next.eq(1)
            m.d.sync += [
                self.value.eq(axi.wdata),
                self.whole.eq(axi.wstrb.all()),
                self.empty.eq(~axi.wstrb.any()),
                self.parity.eq(axi.wdata.xor()),
            ]
        with m.If(axi.bvalid & axi.bready):
            m.d.comb += [
                self.answered_write.next.eq(0),
                held_address.next.eq(0),
                held_data.next.eq(0),
            ]
        with m.If(self.grants | self.refuses):
            m.d.comb += self.answered_write.next.eq(1)
            m.d.sync += axi.bresp.eq(Mux(self.refuses, SLVERR, OKAY))

    def _read_channel(self, m):
        """Hold the address of a read until the read is answered."""
        axi = self.s_axi
        m.d.comb += [
            axi.arready.eq(~self.held_read.value & self.up),
            axi.rvalid.eq(self.answered_read.value),
        ]
        with m.If(axi.arvalid & axi.arready):
            m.d.comb += self.held_read.next.eq(1)
            m.d.sync += self.read_word.eq(axi.araddr[2:])
        with m.If(axi.rvalid & axi.rready):
            m.d.comb += [self.answered_read.next.eq(0), self.held_read.next.eq(0)]
        with m.If(self.answers_read):
            m.d.comb += self.answered_read.next.eq(1)
            m.d.sync += [
                axi.rresp.eq(Mux(self.mapped, OKAY, SLVERR)),
                axi.rdata.eq(Mux(self.mapped, Mux(self.in_subgroup, self.data_in, self.found), 0)),
            ]

    def _soft_reset(self, m):
        """Reset the sensor in the cycle in which the write that asks for it is answered."""
        resets = Signal()
        rests = Signal(init=1)
        m.d.sync += [resets.eq(self.asks_reset), rests.eq(~self.asks_reset)]
        m.d.comb += self.soft_reset.eq(resets & ~rests)

    def _global_settings(self, m):
        """Drive the outputs that show programmed settings at once, without a frame."""
        m.d.comb += self.period.eq(self.setting["period", 0])
        if self.sensor.controller:
            shares = Cat(self.setting["share", k] for k in range(self.sensor.streams))
            m.d.comb += [self.capacity.eq(self.setting["capacity", 0]), self.share.eq(shares)]

    def _decode(self, m):
        """Decode the address: is it in a subgroup's block, mapped, writable, and is the value
        legal?

        The first register behind the address says which word it is, and which ranges hold the
        value. The second one holds the entries of the table for this word.
        """
        sensor = self.sensor
        in_block = Signal()
        m.d.comb += in_block.eq(
            (self.address >= SUBGROUP_BASE)
            & (self.address < SUBGROUP_BASE + SUBGROUP_STRIDE * sensor.subgroups)
        )
        mapped, writable, legal = [], [], []
        in_range = self._ranges(m)
        names = FORMAT_NAMES[: BY_NAME["format"].high(sensor) + 1]
        numbers = [n for n, name in enumerate(names) if name not in built_formats(sensor)]
        unbuilt = Signal(name="format_unbuilt")
        m.d.sync += unbuilt.eq(Cat(self.value == number for number in numbers).any())
        for table, where, key in (
            (registers.GLOBAL, 1, self.address),
            (registers.SUBGROUP, in_block, self.address[:BLOCK_BITS]),
        ):
            for offset, register, index in registers.words(table, sensor):
                word = self.named[register.name, index]
                m.d.sync += word.eq(where & (key == offset))
                mapped.append(word)
                if register.access in WRITABLE:
                    writable.append(word)
                    refused = unbuilt & (register.name == "format")
                    if table is registers.SUBGROUP and not sensor.held:
                        refused = self.flag["busy"]
                    legal.append(
                        word & in_range[register.low(sensor), register.high(sensor)] & ~refused
                    )
        m.d.sync += [
            self.in_subgroup.eq(in_block),
            self.mapped.eq(Cat(mapped).any()),
            self.writable.eq(Cat(writable).any()),
            self.legal.eq(Cat(legal).any()),
        ]

    def _ranges(self, m):
        """Return a registered "value is in range" for each (low, high) of the writable registers;
        many share a range.
        """
        limits = {
            (r.low(self.sensor), r.high(self.sensor))
            for r in BY_NAME.values()
            if r.access in WRITABLE and r.count(self.sensor)
        }
        in_range = {
            (low, high): Signal(name=f"from_{low}_to_{high}") for low, high in sorted(limits)
        }
        value = self.value
        m.d.sync += [
            inside.eq((value >= low) & (value <= high)) for (low, high), inside in in_range.items()
        ]
        return in_range

    def _select(self, m):
        """Select the global register at the address, at the same time as the decoder's result."""
        content = self.setting | {("status", 0): Cat(self.flag[bits.name] for bits in STATUS.bits)}
        if self.sensor.controller:
            of_streams = {"budget": self.budget, "limit": self.limit}
            content |= {
                (name, k): word
                for name, words in of_streams.items()
                for k, word in enumerate(words)
            }
        for _, register, index in registers.words(registers.GLOBAL, self.sensor):
            if register.access is Access.CONSTANT:
                content[register.name, index] = Const(register.reset(self.sensor), DATA_BITS)
        chosen = [Mux(self.named[name], word, 0) for name, word in content.items()]
        m.d.sync += self.found.eq(any_of(m, chosen, "found_of"))

    def _start_checks(self, m):
        """Compute the conditions that refuse a start, by the flag that reports each."""
        bounds = [setting for (name, _), setting in self.setting.items() if name == "auto_bounds"]
        period_short = Signal()
        descends = Signal(AUTO_BOUNDS - 1)
        bounds_descend = Signal()
        gate_late = Signal()
        settings_upset = Signal()
        own_upset = Signal(len(self.setting))
        m.d.sync += [
            period_short.eq(self.period <= self.sensor.guard),
            descends.eq(Cat(low > high for low, high in pairwise(bounds))),
            bounds_descend.eq(descends.any()),
            gate_late.eq(self.gate_late),
            own_upset.eq(
                Cat(word.xor() ^ self.setting_parity[key] for key, word in self.setting.items())
            ),
            settings_upset.eq(self.settings_upset | own_upset.any()),
        ]
        self.failed = {
            "start_period": period_short,
            "start_bounds": bounds_descend,
            "start_gate": gate_late,
            "start_upset": settings_upset,
        }

    def _accesses(self, m):
        """Carry out one access at a time: a read, a write, or the write that starts a frame."""
        axi = self.s_axi
        plan_upset = Signal()  # with an upset plan, a frame might last for hours
        m.d.sync += [
            plan_upset.eq(self.plan.as_value().xor() ^ self.plan_parity),
            self.same_address.eq(self.address == self.write_address),
            self.same_value.eq(self.value.xor() == self.parity),
            self.data_in.eq(self.data),
            self.wait.eq(self.wait + 1),
            self.start_frame.eq(0),
            self.abort_frame.eq(plan_upset),
            self.command.operation.eq(bus.Operation.ACCESS),
        ]
        with m.FSM() as self.machine:
            with m.State("idle"):
                m.d.sync += [self.wait.eq(0), self.command.operation.eq(bus.Operation.IDLE)]
                with m.If(self.held_write & ~axi.bvalid):
                    m.d.sync += self.address.eq(self.write_address)
                    m.next = "decode"
                with m.Elif(self.held_read.value & ~axi.rvalid):
                    m.d.sync += self.address.eq(Cat(Const(0, 2), self.read_word))
                    m.next = "read"
            with m.State("read"):
                m.d.sync += self._name_word()
                with m.If(self.wait == READ_CYCLES):
                    with m.If(self.held_read.value):
                        self._answer_read(m)
                    m.next = "idle"
            with m.State("decode"):
                with m.If(self.wait == DECODE_CYCLES - 1):
                    m.next = "write"
            with m.State("write"):
                m.next = "idle"
                with m.If(~(self.held_write & self.same_address & (self.wait == DECODE_CYCLES))):
                    pass  # only after an upset; the access that is held starts again
                with m.Elif(self.empty & ~self.whole):
                    m.d.comb += self.grants.eq(1)
                with m.Elif(
                    self.writable & self.whole & ~self.empty & self.legal & self.same_value
                ):
                    self._write(m)
                with m.Else():
                    self._refuse_write(m)
            with m.State("check"):
                with m.If(~self.held_write):
                    m.next = "idle"
                with m.Elif(self.wait == CHECK_CYCLES):
                    m.next = "idle"
                    self._start_or_refuse(m)
            if self.sensor.controller:
                with m.State("thresholds"):
                    self._send_for_thresholds(m)
            else:
                with m.State("lost_too"):
                    m.next = "idle"
            with m.State("begin"):
                m.next = "idle"
                with m.If(self.held_write & self.flag["busy"]):
                    m.d.sync += [
                        self.command.operation.eq(bus.Operation.BEGIN),
                        self.start_frame.eq(1),
                    ]
                    if self.sensor.controller:
                        m.d.sync += self.command.data.eq(self.setting["threshold_floor", 0])
                    m.d.comb += self.grants.eq(1)
            with m.State(
                "lost"
            ):  # a code that is not a state: after an upset, the bus must not hang
                m.next = "idle"
        with m.If(
            ~(
                self.flag["busy"]
                & self.resting
                & (self.machine.ongoing("idle") | self.machine.ongoing("read"))
            )
        ):
            m.d.sync += self.rested.eq(0)
        with m.Elif(self.rested != RESTING_CYCLES):
            m.d.sync += self.rested.eq(self.rested + 1)
        with m.If(
            self.done | (self.rested == RESTING_CYCLES)
        ):  # `resting`: an upset took the frame or the strobe
            m.d.sync += [self.flag["busy"].eq(0), self.flag["done"].eq(1)]

    def _name_word(self):
        """Ask the subgroups for the word at the address."""
        word, block = self.address[2:], self.address[BLOCK_BITS:]
        return [
            self.command.subgroup.eq(block - SUBGROUP_BASE // SUBGROUP_STRIDE),
            self.command.word.eq(word),
        ]

    def _answer_read(self, m):
        m.d.comb += self.answers_read.eq(1)
        with m.If(~self.mapped):
            m.d.sync += self.flag["bad_address"].eq(1)

    def _refuse_write(self, m):
        """Refuse a write, and report the reason by a sticky flag."""
        m.d.comb += self.refuses.eq(1)
        with m.If(~self.writable):
            m.d.sync += self.flag["bad_address"].eq(1)
        with m.Elif(~self.whole):
            m.d.sync += self.flag["bad_strobe"].eq(1)
        with m.Else():
            m.d.sync += self.flag["bad_value"].eq(1)

    def _write(self, m):
        """Carry out a write: pass it to the subgroups, or change a global setting. A start waits
        for its checks, unless the same write resets the sensor.
        """
        value = self.value
        m.d.comb += self.grants.eq(1)
        with m.If(self.in_subgroup):
            m.d.sync += [
                self.command.operation.eq(bus.Operation.WRITE),
                self.command.data.eq(value),
                self.command.parity.eq(self.parity),
            ]
            m.d.sync += self._name_word()
        for key, setting in self.setting.items():
            with m.If(self.named[key]):
                m.d.sync += [setting.eq(value), self.setting_parity[key].eq(self.parity)]
        with m.If(self.named["status", 0]):
            for bits in STATUS.bits:
                if bits.clears:
                    with m.If(value[bits.lsb]):
                        m.d.sync += self.flag[bits.name].eq(0)
        with m.If(self.named["control", 0]):
            # A start that is refused must not end the frame that runs.
            aborts = value[CONTROL.bit("abort")] & ~value[CONTROL.bit("start")]
            m.d.sync += self.abort_frame.eq(aborts)
            with m.If(value[CONTROL.bit("reset")]):
                m.d.comb += self.asks_reset.eq(1)
            with m.Elif(value[CONTROL.bit("start")]):
                m.d.comb += self.grants.eq(0)
                m.next = "check"

    def _start_or_refuse(self, m):
        """Take the settings, or report by a sticky flag what is wrong with them."""
        with m.If(self.flag["busy"]):
            m.d.sync += self.flag["start_busy"].eq(1)
            m.d.comb += self.refuses.eq(1)
        with m.Elif(Cat(self.failed.values()).any()):
            m.d.sync += [
                self.flag[name].eq(self.flag[name] | bad) for name, bad in self.failed.items()
            ]
            m.d.comb += self.refuses.eq(1)
        with m.Else():
            m.d.sync += [
                self.flag["busy"].eq(1),
                self.sent.eq(0),
                self.command.operation.eq(bus.Operation.TAKE),
            ]
            for taken in (self.frame, self.plan):
                m.d.sync += [
                    taken[name].eq(self.setting[name, 0]) for name in taken.shape().members
                ]
            parities = Cat(self.setting_parity[name, 0] for name in self.plan.shape().members)
            m.d.sync += self.plan_parity.eq(parities.xor())
            m.next = "thresholds" if self.sensor.controller else "begin"

    def _send_for_thresholds(self, m):
        """Send the streams' budgets and limits and then the controller's bounds to the subgroups,
        one per cycle.
        """
        words = []
        for k in range(self.sensor.streams):
            first = self.sensor.stream_subgroups(k).start
            words += [
                (bus.Operation.BUDGET, first, self.budget[k]),
                (bus.Operation.LIMIT, first, self.limit[k]),
            ]
        words += [
            (bus.Operation.COMPARE, 0, self.setting["auto_bounds", k]) for k in range(AUTO_BOUNDS)
        ]
        with m.Switch(self.sent):
            for k, (operation, first, word) in enumerate(words):
                with m.Case(k):
                    m.d.sync += [
                        self.command.operation.eq(operation),
                        self.command.subgroup.eq(first),
                        self.command.data.eq(word),
                    ]
        m.d.sync += self.sent.eq(self.sent + 1)
        with m.If(~(self.held_write & self.flag["busy"])):
            m.next = "idle"
        with m.Elif(self.sent == len(words) - 1):
            m.next = "begin"
