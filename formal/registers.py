# SPDX-License-Identifier: Apache-2.0
"""Proof of the register front: AXI4-Lite towards any master, even one that breaks the rules."""

from amaranth.hdl import Cat, Mux, ResetSignal, Signal

from ..hdl import bus
from ..hdl.axi import OKAY, SLVERR
from ..hdl.registers import (
    BLOCK_BITS,
    CHECK_CYCLES,
    CONTROL,
    DECODE_CYCLES,
    READ_CYCLES,
    STATUS,
    Registers,
)
from ..model.contract import registers
from ..model.contract.registers import WRITABLE
from ..model.contract.settings import AUTO_BOUNDS
from .proof_bench import Bench, proof
from .sensors import SMALL

SENT = 2 * SMALL.streams + AUTO_BOUNDS  # words for the thresholds: budgets, limits and bounds
# After a read in progress: decode, checks, words for the thresholds.
WRITE_MAX = 1 + (READ_CYCLES + 2) + 3 + CHECK_CYCLES + SENT + 2
# After a write in progress, which may be the longest.
READ_MAX = (CHECK_CYCLES + 2) + SENT + 1 + (READ_CYCLES + 2)


def _asks(unit, name, bit):
    """Return whether the write at work sets this bit of a register."""
    return (unit.write_address == registers.address(name)) & unit.value[bit]


@proof(depth=3, cover=20)
def register_front(b: Bench):
    """AXI4-Lite with any master: one answer each, in bounded time; a refusal changes nothing; a frame's settings stay."""
    sensor, m = SMALL, b.m
    unit = b.place(Registers(sensor))
    axi = unit.s_axi
    done = unit.done
    state = unit.machine.ongoing
    busy = unit.flag["busy"]
    # As proven for the sequencer: only a frame that was started is done.
    b.assume(busy & ~state("thresholds") & ~state("begin"), where=done)

    # Accesses that were taken and not answered yet, counted at the port.
    address, data, read = Signal(), Signal(), Signal()
    for held, valid, ready, response, accepted in (
        (address, axi.awvalid, axi.awready, axi.bvalid, axi.bready),
        (data, axi.wvalid, axi.wready, axi.bvalid, axi.bready),
        (read, axi.arvalid, axi.arready, axi.rvalid, axi.rready),
    ):
        with m.If(response & accepted):
            m.d.sync += held.eq(0)
        with m.Elif(valid & ready):
            m.d.sync += held.eq(1)
        b.always(ready == ~held)  # nothing is taken while another waits; it would be lost
    b.always(address & data, where=axi.bvalid)
    b.always(read, where=axi.rvalid)
    b.stable(Cat(axi.bvalid, axi.bresp), where=axi.bvalid & ~axi.bready)
    b.stable(Cat(axi.rvalid, axi.rresp, axi.rdata), where=axi.rvalid & ~axi.rready)
    b.always((axi.bresp == OKAY) | (axi.bresp == SLVERR))
    b.always((axi.rresp == OKAY) | (axi.rresp == SLVERR))
    b.always(axi.rdata == 0, where=axi.rvalid & (axi.rresp == SLVERR))
    for voted in unit.voted:
        b.always(voted.agree)

    # The answer comes in time, independent of the other channel.
    write_waits, read_waits = Signal(8), Signal(8)
    writing = b.same("writing", address & data & ~axi.bvalid)
    reading = b.same("reading", read & ~axi.rvalid)
    m.d.sync += [
        write_waits.eq((write_waits + 1) & writing.replicate(8)),
        read_waits.eq((read_waits + 1) & reading.replicate(8)),
    ]
    b.always(write_waits <= WRITE_MAX)
    b.always(read_waits <= READ_MAX)

    # A setting only changes by a write that is answered with OKAY, and is always legal.
    granted = axi.bvalid & (axi.bresp == OKAY)
    for (name, _), setting in unit.setting.items():
        register = registers.BY_NAME[name]
        b.always((setting == b.last(setting)) | granted, where=b.past(1))
        b.always((setting >= register.low(sensor)) & (setting <= register.high(sensor)))
    for key, setting in unit.setting.items():
        b.always(setting.xor() == unit.setting_parity[key])
    b.always(unit.value.xor() == unit.parity, where=data)
    b.always(unit.plan.as_value().xor() == unit.plan_parity)
    b.always(
        unit.command.data.xor() == unit.command.parity,
        where=unit.command.operation == bus.Operation.WRITE,
    )
    operation = unit.command.operation
    b.always(granted, where=operation == bus.Operation.WRITE)
    b.always(granted & busy, where=unit.start_frame)
    b.always(unit.start_frame == (operation == bus.Operation.BEGIN))

    # Exactly what the table allows is written and answered with OKAY; a start is checked first.
    in_block = (unit.write_address >= registers.SUBGROUP_BASE) & (
        unit.write_address < registers.SUBGROUP_BASE + registers.SUBGROUP_STRIDE * sensor.subgroups
    )
    allowed = []
    for table, where, offset_bits in (
        (registers.GLOBAL, 1, registers.ADDRESS_BITS),
        (registers.SUBGROUP, in_block, BLOCK_BITS),
    ):
        for offset, register, _ in registers.words(table, sensor):
            if register.access in WRITABLE:
                low, high = register.low(sensor), register.high(sensor)
                here = where & (unit.write_address[:offset_bits] == offset)
                allowed.append(here & (unit.value >= low) & (unit.value <= high))
    fits = b.same("fits", Cat(allowed).any() & unit.whole)
    starts, aborts = (_asks(unit, "control", CONTROL.bit(name)) for name in ("start", "abort"))
    b.always(granted, where=b.past(state("write") & fits & ~starts))
    b.always(axi.bvalid & (axi.bresp == SLVERR), where=b.past(state("write") & ~fits))

    # The settings of a frame are taken while none is running, and stay until it is done.
    in_force = Cat(unit.frame.as_value(), unit.plan.as_value())
    b.stable(in_force, where=busy)
    b.always(~b.past(busy) & busy & ~b.past(done), where=operation == bus.Operation.TAKE)
    b.always(unit.command.data == b.past(unit.budget[0]), where=operation == bus.Operation.BUDGET)
    b.always(unit.command.data == b.past(unit.limit[0]), where=operation == bus.Operation.LIMIT)
    b.always(
        busy,
        where=(operation == bus.Operation.BUDGET)
        | (operation == bus.Operation.LIMIT)
        | (operation == bus.Operation.COMPARE)
        | (operation == bus.Operation.BEGIN)
        | unit.start_frame,
    )
    b.always(
        (unit.plan.period > sensor.guard) & (unit.plan.period <= sensor.period_max), where=busy
    )
    b.always((unit.plan.pulses != 0) & (unit.plan.gate_steps != 0), where=busy)

    # Only a write to `control` aborts a frame, and a sticky bit is cleared by itself.
    b.always(b.past(state("write") & aborts), where=unit.abort_frame)
    for bits in STATUS.bits:
        if bits.clears:
            flag, clears = unit.flag[bits.name], _asks(unit, "status", bits.lsb)
            b.always(flag, where=b.past(flag & ~(state("write") & clears) & ~ResetSignal()))

    # A refusal sets a sticky error bit.
    errors = Cat(flag for name, flag in unit.flag.items() if name not in ("busy", "done"))
    b.always(errors.any(), where=axi.bvalid & ~b.past(axi.bvalid) & (axi.bresp == SLVERR))
    b.always(
        errors.any(), where=axi.rvalid & ~b.past(axi.rvalid) & (axi.rresp == SLVERR) & b.past(read)
    )

    # Invariants.
    until_checked = b.same("until_checked", state("decode") | state("write") | state("check"))
    in_write = b.same("in_write", until_checked | state("thresholds") | state("begin"))
    b.always(address & data & ~axi.bvalid, where=in_write)
    b.always(read & ~axi.rvalid, where=state("read"))
    b.always(b.past(unit.address) == unit.address, where=state("write"))
    b.always(unit.address == unit.write_address, where=until_checked)
    b.always(unit.same_address & unit.same_value, where=state("write"))
    b.always(in_write | state("idle") | state("read"))
    b.always(unit.wait <= READ_CYCLES, where=state("read"))
    b.always(unit.wait < DECODE_CYCLES, where=state("decode"))
    b.always(unit.wait == DECODE_CYCLES, where=state("write"))
    b.always((unit.wait > DECODE_CYCLES) & (unit.wait <= CHECK_CYCLES), where=state("check"))
    b.always((unit.sent < SENT) & busy, where=state("thresholds"))
    b.always(busy, where=state("begin"))
    # The progress of an access bounds the time that it has been waiting.
    before_write = READ_CYCLES + 3
    b.always(
        write_waits <= unit.wait + 1, where=reading & state("read") & address & data & ~axi.bvalid
    )
    b.always(write_waits <= before_write, where=writing & state("idle"))
    b.always(write_waits <= before_write + 1 + unit.wait, where=until_checked)
    b.always(write_waits <= before_write + 2 + CHECK_CYCLES + unit.sent, where=state("thresholds"))
    b.always(write_waits <= before_write + 2 + CHECK_CYCLES + SENT, where=state("begin"))
    b.always(read_waits <= unit.wait + 1, where=until_checked)
    b.always(read_waits <= CHECK_CYCLES + 2 + unit.sent, where=state("thresholds"))
    b.always(read_waits <= CHECK_CYCLES + 2 + SENT, where=state("begin"))
    b.always(
        read_waits <= Mux(axi.bvalid, CHECK_CYCLES + 3 + SENT, 0), where=reading & state("idle")
    )
    b.always(read_waits <= CHECK_CYCLES + 4 + SENT + unit.wait, where=state("read"))
    b.cover(axi.bvalid & (axi.bresp == SLVERR) & read)
    b.cover(axi.rvalid & (axi.rresp == OKAY) & address & data)


@proof(depth=2, cover=45)
def register_front_starts(b: Bench):
    """With starts only, no read is answered; one start begins a frame, and the next one finds the front busy."""
    unit = Registers(SMALL)
    b.place(
        unit,
        s_axi__awaddr=registers.control("start")[0],
        s_axi__wdata=registers.control("start")[1],
        s_axi__wstrb=0b1111,
        s_axi__awvalid=1,
        s_axi__wvalid=1,
        s_axi__bready=1,
        s_axi__arvalid=0,
        gate_late=0,
        settings_upset=0,
        resting=0,
        done=0,
    )
    b.assume(~ResetSignal())
    for voted in unit.voted:
        b.always(voted.agree)
    b.always(~unit.held_read.value & ~unit.s_axi.rvalid)
    b.cover(unit.start_frame & b.past(unit.flag["busy"]))
    b.cover(unit.s_axi.bvalid & unit.flag["start_busy"])
