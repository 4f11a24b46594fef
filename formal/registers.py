"""Proof of the register front: AXI4-Lite towards any master, one that breaks the rules included."""

from amaranth.hdl import Cat, Mux, Signal

from ..hdl import bus
from ..hdl.axi import OKAY, SLVERR
from ..hdl.registers import CHECK_CYCLES, DECODE_CYCLES, READ_CYCLES, Registers
from ..model.contract import registers
from ..model.contract.registers import AUTO_BOUNDS
from .bench import Bench, proof
from .sensors import SMALL

WRITE_MAX = 1 + (READ_CYCLES + 2) + 3 + CHECK_CYCLES + AUTO_BOUNDS + 2  # a read under way, decode, checks, bounds
READ_MAX = (CHECK_CYCLES + 2) + AUTO_BOUNDS + 1 + (READ_CYCLES + 2)  # a write under way, the longest, first


@proof(depth=3, cover=45)
def register_front(b: Bench):
    """AXI4-Lite with any master: one answer each, in bounded time; a refusal changes nothing; a running frame's settings stay."""
    sensor, m = SMALL, b.m
    unit = Registers(sensor)
    axi = unit.s_axi
    done = Signal()
    m.d.comb += done.eq(b.anything(1))
    body = b.place("dut", unit, done=done)
    state = body.machine.ongoing
    busy = body.flag["busy"]
    b.assume(
        busy & ~state("bounds") & ~state("begin"), where=done
    )  # as proven of the sequencer: of a frame that was started

    # What was taken and not answered yet, counted at the port.
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
        b.always(ready == ~held)  # what is taken while another waits would be lost
    b.always(address & data, where=axi.bvalid)
    b.always(read, where=axi.rvalid)
    b.stable(Cat(axi.bvalid, axi.bresp), where=axi.bvalid & ~axi.bready)
    b.stable(Cat(axi.rvalid, axi.rresp, axi.rdata), where=axi.rvalid & ~axi.rready)
    b.always((axi.bresp == OKAY) | (axi.bresp == SLVERR))
    b.always((axi.rresp == OKAY) | (axi.rresp == SLVERR))
    b.always(axi.rdata == 0, where=axi.rvalid & (axi.rresp == SLVERR))

    # The answer comes in time, whatever happens on the other channel.
    write_waits, read_waits = Signal(8), Signal(8)
    writing = b.same("writing", address & data & ~axi.bvalid)
    reading = b.same("reading", read & ~axi.rvalid)
    m.d.sync += [
        write_waits.eq((write_waits + 1) & writing.replicate(8)),
        read_waits.eq((read_waits + 1) & reading.replicate(8)),
    ]
    b.always(write_waits <= WRITE_MAX)
    b.always(read_waits <= READ_MAX)

    # A setting changes only by a write that is answered with OKAY, and is always legal.
    granted = axi.bvalid & (axi.bresp == OKAY)
    for (name, _), setting in body.setting.items():
        register = registers.BY_NAME[name]
        b.always((setting == b.last(setting)) | granted, where=b.past(1))
        b.always((setting >= register.low(sensor)) & (setting <= register.high(sensor)))
    operation = unit.command.operation
    b.always(granted, where=operation == bus.Operation.WRITE)
    b.always(granted & busy, where=unit.start_frame)
    b.always(unit.start_frame == (operation == bus.Operation.BEGIN))

    # A frame's settings are taken when none is running, and stay until it is done.
    in_force = Cat(unit.frame.as_value(), unit.plan.as_value())
    b.stable(in_force, where=busy)
    b.always(~b.past(busy) & busy & ~b.past(done), where=operation == bus.Operation.TAKE)
    b.always(busy, where=(operation == bus.Operation.COMPARE) | (operation == bus.Operation.BEGIN) | unit.start_frame)
    b.always((unit.plan.period > sensor.guard) & (unit.plan.period <= sensor.period_max), where=busy)
    b.always((unit.plan.pulses != 0) & (unit.plan.gate_steps != 0), where=busy)

    # A refusal leaves its mark: a sticky error.
    errors = Cat(flag for name, flag in body.flag.items() if name not in ("busy", "done"))
    b.always(errors.any(), where=axi.bvalid & ~b.past(axi.bvalid) & (axi.bresp == SLVERR))
    b.always(errors.any(), where=axi.rvalid & ~b.past(axi.rvalid) & (axi.rresp == SLVERR) & b.past(read))

    # Invariants.
    until_checked = b.same("until_checked", state("decode") | state("write") | state("check"))
    in_write = b.same("in_write", until_checked | state("bounds") | state("begin"))
    b.always(address & data & ~axi.bvalid, where=in_write)
    b.always(read & ~axi.rvalid, where=state("read"))
    b.always(b.past(body.address) == body.address, where=state("write"))
    b.always(in_write | state("idle") | state("read"))
    b.always(body.wait <= READ_CYCLES, where=state("read"))
    b.always(body.wait < DECODE_CYCLES, where=state("decode"))
    b.always(body.wait == DECODE_CYCLES, where=state("write"))
    b.always((body.wait > DECODE_CYCLES) & (body.wait <= CHECK_CYCLES), where=state("check"))
    b.always((body.bound < AUTO_BOUNDS) & busy, where=state("bounds"))
    b.always(busy, where=state("begin"))
    # How far an access has come bounds how long it has been waiting.
    before_write = READ_CYCLES + 3
    b.always(write_waits <= body.wait + 1, where=reading & state("read") & address & data & ~axi.bvalid)
    b.always(write_waits <= before_write, where=writing & state("idle"))
    b.always(write_waits <= before_write + 1 + body.wait, where=until_checked)
    b.always(write_waits <= before_write + 2 + CHECK_CYCLES + body.bound, where=state("bounds"))
    b.always(write_waits <= before_write + 2 + CHECK_CYCLES + AUTO_BOUNDS, where=state("begin"))
    b.always(read_waits <= body.wait + 1, where=until_checked)
    b.always(read_waits <= CHECK_CYCLES + 2 + body.bound, where=state("bounds"))
    b.always(read_waits <= CHECK_CYCLES + 2 + AUTO_BOUNDS, where=state("begin"))
    b.always(read_waits <= Mux(axi.bvalid, CHECK_CYCLES + 3 + AUTO_BOUNDS, 0), where=reading & state("idle"))
    b.always(read_waits <= CHECK_CYCLES + 4 + AUTO_BOUNDS + body.wait, where=state("read"))
    b.cover(unit.start_frame & b.past(busy))
    b.cover(axi.bvalid & (axi.bresp == SLVERR) & read)
    b.cover(axi.rvalid & (axi.rresp == OKAY) & address & data)
    b.cover(axi.bvalid & body.flag["start_busy"])
