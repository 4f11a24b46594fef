# SPDX-License-Identifier: Apache-2.0
"""Proof of the register front: AXI4-Lite towards any master, even one that breaks the rules.

The proof names its parts in order: the specification of what waits, what is proven, and the
invariants that only help the induction.
"""

from amaranth.hdl import Cat, Const, Fragment, Mux, ResetSignal, Signal
from attrs import frozen

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
    read_cycles_max,
    write_cycles_max,
)
from ..model.contract import registers
from ..model.contract.parameters import Sensor
from ..model.contract.registers import WRITABLE
from ..model.contract.settings import AUTO_BOUNDS
from .proof_bench import Bench, proof, registers_in
from .sensors import SMALL, SMALL_COUNTS

SENT = 2 * SMALL.streams + AUTO_BOUNDS  # words for the thresholds: budgets, limits and bounds


def _asks(unit, name, bit):
    """Return whether the write at work sets this bit of a register."""
    return (unit.write_address == registers.address(name)) & unit.value[bit]


@frozen
class Waiting:
    """Accesses that were taken and have no answer yet, as counted at the port.

    address, data, read: the port's channels that hold something; strobe: of the write that was
    taken; read_address: of the read; writing, reading: the access is complete, and its answer is
    not there; write_cycles, read_cycles: for how long.
    """

    address: Signal
    data: Signal
    read: Signal
    strobe: Signal
    read_address: Signal
    writing: Signal
    reading: Signal
    write_cycles: Signal
    read_cycles: Signal


@proof(depth=3, cover=20)
def register_front(b: Bench):
    """AXI4-Lite with any master: one answer each, in order, in bounded time; not ready in a reset;
    a refusal changes nothing; a write without strobes is granted and changes nothing; a read
    returns the word around its address; a frame's settings stay. A soft reset comes when it is
    asked for, in any state, and no access is lost in it.
    """
    _register_front(b, SMALL)


@proof(depth=3, cover=20)
def register_front_counts(b: Bench):
    """The same of a sensor with counts."""
    _register_front(b, SMALL_COUNTS)


def _register_front(b: Bench, sensor: Sensor) -> None:
    """Prove the register front of a sensor."""
    unit = b.place(Registers(sensor))
    _sequencer_obeys(b, unit)

    waiting = _waiting(b, unit)

    _port_obeys_axi(b, unit, waiting)
    _answers_come_in_time(b, waiting, sensor)
    _settings_are_legal_and_change_by_writes(b, unit)
    _table_decides_what_is_written(b, unit)
    _nothing_asked_is_nothing_done(b, unit, waiting)
    _reads_return_whole_words(b, unit, waiting)
    _frame_keeps_its_settings(b, unit)
    _bus_tells_settings(b, unit)
    _only_writes_abort_and_clear(b, unit)
    _only_a_write_resets(b, unit, waiting)
    _refusals_set_an_error(b, unit, waiting)

    _parities_are_right(b, unit, waiting)
    _machine_is_in_a_state(b, unit, waiting)
    _progress_bounds_the_wait(b, unit, waiting)

    axi = unit.s_axi
    b.cover(axi.bvalid & (axi.bresp == SLVERR) & waiting.read)
    b.cover(axi.rvalid & (axi.rresp == OKAY) & waiting.address & waiting.data)
    b.cover(axi.rvalid & (axi.rresp == OKAY) & waiting.read_address[:2].all())
    b.cover(_granted(unit) & (waiting.strobe == 0))
    b.cover(unit.soft_reset & waiting.reading)


def _sequencer_obeys(b: Bench, unit: Registers) -> None:
    """Assume what is proven for the sequencer: only a frame that was started is done."""
    state = unit.machine.ongoing
    b.assume(unit.flag["busy"] & ~state("thresholds") & ~state("begin"), where=unit.done)


def _waiting(b: Bench, unit: Registers) -> Waiting:
    """Specify the accesses that wait. Nothing is taken while another waits; it would be lost."""
    m = b.m
    axi = unit.s_axi
    address = Signal()
    data = Signal()
    read = Signal()
    strobe = Signal.like(axi.wstrb)
    read_address = Signal.like(axi.araddr)
    after_reset = b.last(ResetSignal())
    for held, valid, ready, response, accepted in (
        (address, axi.awvalid, axi.awready, axi.bvalid, axi.bready),
        (data, axi.wvalid, axi.wready, axi.bvalid, axi.bready),
        (read, axi.arvalid, axi.arready, axi.rvalid, axi.rready),
    ):
        with m.If(response & accepted):
            m.d.sync += held.eq(0)
        with m.Elif(valid & ready):
            m.d.sync += held.eq(1)
        b.always(ready == (~held & ~after_reset))
    b.always(unit.up == ~after_reset)
    with m.If(axi.wvalid & axi.wready):
        m.d.sync += strobe.eq(axi.wstrb)
    with m.If(axi.arvalid & axi.arready):
        m.d.sync += read_address.eq(axi.araddr)
    writing = b.same("writing", address & data & ~axi.bvalid)
    reading = b.same("reading", read & ~axi.rvalid)
    write_cycles = Signal(8)
    read_cycles = Signal(8)
    m.d.sync += write_cycles.eq((write_cycles + 1) & writing.replicate(8))
    m.d.sync += read_cycles.eq((read_cycles + 1) & reading.replicate(8))
    return Waiting(
        address=address,
        data=data,
        read=read,
        strobe=strobe,
        read_address=read_address,
        writing=writing,
        reading=reading,
        write_cycles=write_cycles,
        read_cycles=read_cycles,
    )


def _granted(unit: Registers):
    """Return whether a write is answered with OKAY."""
    return unit.s_axi.bvalid & (unit.s_axi.bresp == OKAY)


def _port_obeys_axi(b: Bench, unit: Registers, waiting: Waiting) -> None:
    """State that answers belong to accesses, and stay until they are taken."""
    axi = unit.s_axi
    b.always(waiting.address & waiting.data, where=axi.bvalid)
    b.always(waiting.read, where=axi.rvalid)
    b.stable(Cat(axi.bvalid, axi.bresp), where=axi.bvalid & ~axi.bready)
    b.stable(Cat(axi.rvalid, axi.rresp, axi.rdata), where=axi.rvalid & ~axi.rready)
    b.always((axi.bresp == OKAY) | (axi.bresp == SLVERR))
    b.always((axi.rresp == OKAY) | (axi.rresp == SLVERR))
    b.always(axi.rdata == 0, where=axi.rvalid & (axi.rresp == SLVERR))


def _answers_come_in_time(b: Bench, waiting: Waiting, sensor: Sensor) -> None:
    """State that an answer comes in time, independent of the other channel."""
    b.always(waiting.write_cycles <= write_cycles_max(sensor))
    b.always(waiting.read_cycles <= read_cycles_max(sensor))


def _settings_are_legal_and_change_by_writes(b: Bench, unit: Registers) -> None:
    """State that a setting only changes by a write that is answered with OKAY, and is legal."""
    granted = _granted(unit)
    operation = unit.command.operation
    for (name, _), setting in unit.setting.items():
        register = registers.BY_NAME[name]
        was_reset = b.past(unit.soft_reset)
        b.always((setting == b.last(setting)) | granted | was_reset, where=b.past(1))
        b.always((setting >= register.low(unit.sensor)) & (setting <= register.high(unit.sensor)))
    b.always(granted, where=operation == bus.Operation.WRITE)
    b.always(granted & unit.flag["busy"], where=unit.start_frame)
    b.always(unit.start_frame == (operation == bus.Operation.BEGIN))


def _table_decides_what_is_written(b: Bench, unit: Registers) -> None:
    """State that exactly what the table allows is answered with OKAY, except a start.

    A start is checked first.
    """
    state = unit.machine.ongoing
    address = unit.write_address
    blocks_end = registers.SUBGROUP_BASE + registers.SUBGROUP_STRIDE * unit.sensor.subgroups
    in_block = (address >= registers.SUBGROUP_BASE) & (address < blocks_end)
    allowed = []
    for table, where, offset_bits in (
        (registers.GLOBAL, 1, registers.ADDRESS_BITS),
        (registers.SUBGROUP, in_block, BLOCK_BITS),
    ):
        for offset, register, _ in registers.words(table, unit.sensor):
            if register.access in WRITABLE:
                here = where & (address[:offset_bits] == offset)
                above_low = unit.value >= register.low(unit.sensor)
                below_high = unit.value <= register.high(unit.sensor)
                allowed.append(here & above_low & below_high)
    fits = b.same("fits", unit.empty | (Cat(allowed).any() & unit.whole))
    resets = _asks(unit, "control", CONTROL.bit("reset"))
    starts = _asks(unit, "control", CONTROL.bit("start")) & ~resets & ~unit.empty
    refused = unit.s_axi.bvalid & (unit.s_axi.bresp == SLVERR)
    b.always(_granted(unit), where=b.past(state("write") & fits & ~starts))
    b.always(refused, where=b.past(state("write") & ~fits))


def _nothing_asked_is_nothing_done(b: Bench, unit: Registers, waiting: Waiting) -> None:
    """State that only a write of a whole word does anything, and that one without strobes is
    granted.
    """
    b.always(unit.whole == waiting.strobe.all(), where=waiting.data)
    b.always(unit.empty == ~waiting.strobe.any(), where=waiting.data)
    b.always(_granted(unit), where=unit.s_axi.bvalid & (waiting.strobe == 0))
    b.always(waiting.strobe.all() | (waiting.strobe == 0), where=_granted(unit))
    state = unit.machine.ongoing
    starting = state("check") | state("thresholds") | state("begin")
    b.always(waiting.strobe.all(), where=starting)
    decided = b.past(state("write"))
    partial = decided & ~b.past(waiting.strobe.all())
    done_nothing = (unit.command.operation != bus.Operation.WRITE) & ~unit.abort_frame
    b.always(done_nothing & ~state("check"), where=partial)
    sticky = Cat(
        unit.flag[bits.name] for bits in STATUS.bits if bits.clears and bits.name != "done"
    )
    b.always((b.last(sticky) & ~sticky) == 0, where=partial)
    programmed = Cat(*unit.setting.values(), *unit.setting_parity.values())
    b.always(programmed == b.last(programmed), where=partial)
    asked_nothing = partial & (waiting.strobe == 0)
    b.always(sticky == b.last(sticky), where=asked_nothing)


def _reads_return_whole_words(b: Bench, unit: Registers, waiting: Waiting) -> None:
    """State that a read is answered for the word around its address; shown for the constants."""
    axi = unit.s_axi
    word = waiting.read_address[2:]
    b.always(unit.read_word == word, where=waiting.read)
    in_read = waiting.read & unit.machine.ongoing("read")
    b.always(unit.address == Cat(Const(0, 2), word), where=in_read)
    for offset, register, _ in registers.words(registers.GLOBAL, unit.sensor):
        if register.access is registers.Access.CONSTANT:
            here = axi.rvalid & (word == offset // 4)
            b.always((axi.rresp == OKAY) & (axi.rdata == register.reset(unit.sensor)), where=here)


def _frame_keeps_its_settings(b: Bench, unit: Registers) -> None:
    """State that a frame's settings are taken while none is running, and stay until it is done."""
    busy = unit.flag["busy"]
    plan = unit.plan
    b.stable(Cat(unit.frame.as_value(), plan.as_value()), where=busy & ~unit.soft_reset)
    begins = ~b.past(busy) & busy & ~b.past(unit.done)
    b.always(begins, where=unit.command.operation == bus.Operation.TAKE)
    b.always(
        (plan.period > unit.sensor.guard) & (plan.period <= unit.sensor.period_max), where=busy
    )
    b.always((plan.pulses != 0) & (plan.gate_steps != 0), where=busy)


def _bus_tells_settings(b: Bench, unit: Registers) -> None:
    """State which words the configuration bus carries, and that most come only with a frame."""
    operation = unit.command.operation
    data = unit.command.data
    b.always(data == b.past(unit.budget[0]), where=operation == bus.Operation.BUDGET)
    b.always(data == b.past(unit.limit[0]), where=operation == bus.Operation.LIMIT)
    b.always(
        unit.flag["busy"],
        where=(operation == bus.Operation.BUDGET)
        | (operation == bus.Operation.LIMIT)
        | (operation == bus.Operation.COMPARE)
        | (operation == bus.Operation.BEGIN)
        | unit.start_frame,
    )


def _only_writes_abort_and_clear(b: Bench, unit: Registers) -> None:
    """State that only a write to `control` aborts a frame; a sticky bit is cleared by itself."""
    writes = unit.machine.ongoing("write")
    aborts = _asks(unit, "control", CONTROL.bit("abort"))
    aborts &= ~_asks(unit, "control", CONTROL.bit("start"))
    b.always(b.past(writes & aborts), where=unit.abort_frame)
    for bits in STATUS.bits:
        if bits.clears:
            flag = unit.flag[bits.name]
            clears = _asks(unit, "status", bits.lsb)
            resets = unit.soft_reset | ResetSignal()
            b.always(flag, where=b.past(flag & ~(writes & clears) & ~resets))


def _only_a_write_resets(b: Bench, unit: Registers, waiting: Waiting) -> None:
    """State that a write to `control` resets, and nothing else; and that everything behind the
    port then has its value after a reset.

    Answers come in time whatever the other blocks do, so a reset can be asked for in any state.
    """
    state = unit.machine.ongoing
    asks = _asks(unit, "control", CONTROL.bit("reset"))
    granted = b.same("reset_granted", state("write") & asks & waiting.strobe.all())
    fits = unit.value <= CONTROL.high(unit.sensor)
    b.always(unit.soft_reset == b.past(granted & fits))
    b.always(_granted(unit) & state("idle"), where=unit.soft_reset)
    for register in registers_in(Fragment.get(unit.behind_port, None)):
        b.always(register == register.init, where=b.past(unit.soft_reset))


def _refusals_set_an_error(b: Bench, unit: Registers, waiting: Waiting) -> None:
    """State that a refusal sets a sticky error bit."""
    axi = unit.s_axi
    errors = Cat(flag for name, flag in unit.flag.items() if name not in ("busy", "done"))
    write_answered = axi.bvalid & ~b.past(axi.bvalid)
    read_answered = axi.rvalid & ~b.past(axi.rvalid)
    b.always(errors.any(), where=write_answered & (axi.bresp == SLVERR))
    b.always(errors.any(), where=read_answered & (axi.rresp == SLVERR) & b.past(waiting.read))


def _parities_are_right(b: Bench, unit: Registers, waiting: Waiting) -> None:
    """State that no copy and no parity differs without an upset."""
    for voted in unit.voted:
        b.always(voted.agree)
    for key, setting in unit.setting.items():
        b.always(setting.xor() == unit.setting_parity[key])
    b.always(unit.value.xor() == unit.parity, where=waiting.data)
    b.always(unit.plan.as_value().xor() == unit.plan_parity)
    b.always(
        unit.command.data.xor() == unit.command.parity,
        where=unit.command.operation == bus.Operation.WRITE,
    )


def _until_checked(unit: Registers):
    """Return whether a write is on its way, and its address and value are still needed."""
    state = unit.machine.ongoing
    return state("decode") | state("write") | state("check")


def _machine_is_in_a_state(b: Bench, unit: Registers, waiting: Waiting) -> None:
    """Help the induction: what holds in each state."""
    axi = unit.s_axi
    state = unit.machine.ongoing
    busy = unit.flag["busy"]
    until_checked = b.same("until_checked", _until_checked(unit))
    in_write = b.same("in_write", until_checked | state("thresholds") | state("begin"))
    b.always(waiting.address & waiting.data & ~axi.bvalid, where=in_write)
    b.always(waiting.read & ~axi.rvalid, where=state("read"))
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


def _progress_bounds_the_wait(b: Bench, unit: Registers, waiting: Waiting) -> None:
    """Help the induction: the progress of an access bounds the time that it has been waiting."""
    axi = unit.s_axi
    state = unit.machine.ongoing
    write_cycles = waiting.write_cycles
    read_cycles = waiting.read_cycles
    until_checked = _until_checked(unit)

    before_write = READ_CYCLES + 3
    before_sending = before_write + 2 + CHECK_CYCLES
    both_wait = waiting.reading & state("read") & waiting.address & waiting.data
    b.always(write_cycles <= unit.wait + 1, where=both_wait & ~axi.bvalid)
    b.always(write_cycles <= before_write, where=waiting.writing & state("idle"))
    b.always(write_cycles <= before_write + 1 + unit.wait, where=until_checked)
    b.always(write_cycles <= before_sending + unit.sent, where=state("thresholds"))
    b.always(write_cycles <= before_sending + SENT, where=state("begin"))

    b.always(read_cycles <= unit.wait + 1, where=until_checked)
    b.always(read_cycles <= CHECK_CYCLES + 2 + unit.sent, where=state("thresholds"))
    b.always(read_cycles <= CHECK_CYCLES + 2 + SENT, where=state("begin"))
    after_write = axi.bvalid | b.past(unit.soft_reset)
    behind_write = Mux(after_write, CHECK_CYCLES + 3 + SENT, 0)
    b.always(read_cycles <= behind_write, where=waiting.reading & state("idle"))
    b.always(read_cycles <= CHECK_CYCLES + 4 + SENT + unit.wait, where=state("read"))


@proof(depth=2, cover=45)
def register_front_starts(b: Bench):
    """With starts only, no read is answered; one start begins a frame, and the next one finds the
    front busy.
    """
    unit = Registers(SMALL)
    address, start = registers.control("start")
    b.place(
        unit,
        s_axi__awaddr=address,
        s_axi__wdata=start,
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
