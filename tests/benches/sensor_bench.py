# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of the sensor's ports: registers, frame control, reset, and an independent bus
master and stream sink.
"""

import json
import os
import random
from bisect import bisect_right
from functools import partial

import cocotb
import numpy as np
from cocotb.triggers import ClockCycles, FallingEdge, RisingEdge
from cocotb_bus.drivers.amba import AXIProtocolError
from cocotbext.axi import AxiLiteBus, AxiLiteMaster, AxiResp, AxiStreamBus, AxiStreamSink
from plain_model import period_starts

from coincid.model.contract import registers
from coincid.model.contract.config import parse_config
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.edges import Edges
from coincid.model.contract.packet import FORMATS, built_formats
from coincid.model.contract.parameters import PARTS
from coincid.model.contract.registers import Access, address
from coincid.model.contract.settings import AUTO_BOUNDS
from coincid.model.contract.stream import decode_frame
from coincid.model.golden.frame import Golden
from coincid.tb.cosim import SensorBench
from coincid.tb.scoreboard import Scoreboard
from coincid.tb.stimulus import port_words

SENSOR = json.loads(os.environ["COINCID_BENCH_SENSOR"])  # set by the test that runs the bench
STATUS = registers.BY_NAME["status"]
START_CYCLES = 200  # limit, from the write of a start to the laser
NOTHING = Edges(*(np.zeros(0, np.int64) for _ in range(3)))


def config(**tables):
    return parse_config({"sensor": SENSOR} | tables)


def some_edges(of, seed: int, n: int = 400) -> Edges:
    rng = np.random.default_rng(seed)
    return Edges(
        *(rng.integers(0, high, n) for high in (of.pulses, of.sensor.array_pixels, of.period_ticks))
    )


async def fresh(dut) -> SensorBench:
    bench = SensorBench(dut, config().sensor)
    await bench.reset()
    return bench


async def reset_cycle(bench: SensorBench) -> None:
    """Apply a reset of one cycle; no light after it."""
    bench.dut.rst.value = 1
    await FallingEdge(bench.dut.clk)
    bench.dut.rst.value = 0
    for line in bench.spad:
        line.value = 0
    bench.programmed.clear()
    await ClockCycles(bench.dut.clk, 3)


async def laser_fires(dut) -> None:
    """Wait for cycle 0 of a frame's first period."""
    for _ in range(START_CYCLES):
        if dut.laser.value == 1:
            return
        await FallingEdge(dut.clk)
    raise AssertionError(f"no laser in {START_CYCLES} cycles")


async def refuses(access) -> bool:
    """Return whether an access gets SLVERR."""
    try:
        await access
    except AXIProtocolError:
        return True
    return False


async def refused(access, bench: SensorBench, sticky: str) -> None:
    """Check that `access` gets SLVERR and sets the sticky bit; writing 1 clears the bit, writing 0
    does not.
    """
    assert await refuses(access), "not refused"
    bit = 1 << STATUS.bit(sticky)
    assert await bench.read("status") & ~(1 << STATUS.bit("done")) == bit, (
        f"status is not {sticky} alone"
    )
    await bench.write("status", 0)
    assert await bench.read("status") & bit
    await bench.write("status", bit)
    assert not await bench.read("status") & bit


def all_words(sensor):
    """Yield (name, index, register, subgroup) for every word of the map."""
    for _, register, index in registers.words(registers.GLOBAL, sensor):
        yield register, index, 0
    for subgroup in range(sensor.subgroups):
        for _, register, index in registers.words(registers.SUBGROUP, sensor):
            yield register, index, subgroup


async def check_reset_values(bench: SensorBench) -> None:
    for register, index, subgroup in all_words(bench.sensor):
        assert await bench.read(register.name, subgroup, index) == register.reset(bench.sensor), (
            register.name
        )


@cocotb.test()
async def settings_keep_what_is_written_and_refuse_the_rest(dut):
    """After a reset, they have their first values again."""
    bench = await fresh(dut)
    settings = [word for word in all_words(bench.sensor) if word[0].access is Access.SETTING]
    # of the legal values: every bit takes both values, beside others
    for high_half in (True, False):
        written = {}
        for register, index, subgroup in settings:
            low, high = register.low(bench.sensor), register.high(bench.sensor)
            middle = (low + high) // 2
            value = (
                random.randint(middle, high)
                if high_half ^ len(written) % 2
                else random.randint(low, middle)
            )
            await bench.write(register.name, value, subgroup, index)
            written[register, subgroup, index] = value
        for wait in (1, 2):  # an odd and an even number of cycles later
            await ClockCycles(dut.clk, wait)
            for (register, subgroup, index), value in written.items():
                assert await bench.read(register.name, subgroup, index) == value, register.name
    for (register, subgroup, index), value in written.items():
        for bad in {register.low(bench.sensor) - 1, register.high(bench.sensor) + 1} - {
            -1,
            1 << 32,
        }:
            await refused(bench.write(register.name, bad, subgroup, index), bench, "bad_value")
        assert await bench.read(register.name, subgroup, index) == value, register.name
    await FallingEdge(dut.clk)
    await reset_cycle(bench)
    await check_reset_values(bench)


@cocotb.test()
async def the_values_of_a_reset_make_a_frame(dut):
    bench = await fresh(dut)
    await check_reset_values(bench)
    await bench.write("control", 1)
    await laser_fires(dut)
    await reset_cycle(bench)


@cocotb.test()
async def addresses_that_are_not_there(dut):
    bench = await fresh(dut)
    last = registers.SUBGROUP_BASE + registers.SUBGROUP_STRIDE * bench.sensor.subgroups
    behind = address("mask", 0, 1) + 4, address(COUNTER_NAMES[-1], 1) + 4
    there = {at for at, _, _ in registers.words(registers.GLOBAL, bench.sensor)}
    hole = next(at for at in range(0, registers.SUBGROUP_BASE, 4) if at not in there)
    for bad in (hole, 0xFFC, *behind, last, 0xFFFFC):
        await refused(bench.axi.write(bad, 1), bench, "bad_address")
        await refused(bench.axi.read(bad), bench, "bad_address")
    await refused(bench.axi.write(address("period") + 2, 1), bench, "bad_address")
    for name in ("id", "rows", "budget", "opened", "threshold_used"):
        await refused(bench.write(name, 1), bench, "bad_address")
    await refused(bench.axi.write(address("pulses"), 7, byte_enable=0b0111), bench, "bad_strobe")
    assert await bench.read("pulses") == 100


@cocotb.test()
async def accesses_of_bus_adapters(dut):
    """A beat without strobes is granted and changes nothing; a read ignores two address bits."""
    bench = await fresh(dut)
    pulses = 0x1234
    await bench.write("pulses", pulses)
    status = await bench.read("status")
    of_start, start = registers.control("start")
    unmapped = 0xFFFFC
    for where, value in (
        (address("pulses"), 7),
        (address("pulses") + 2, 7),
        (address("id"), 7),
        (of_start, start),
        (unmapped, 7),
    ):
        await bench.axi.write(where, value, byte_enable=0)
    assert await bench.read("status") == status
    for offset in range(4):
        # The master drops the bytes below the address.
        assert await bench.axi.read(address("pulses") + offset) == pulses >> 8 * offset


@cocotb.test()
async def no_channel_is_ready_in_a_reset(dut):
    bench = await fresh(dut)
    await FallingEdge(dut.clk)
    ready = [getattr(dut, f"s_axi_{channel}ready") for channel in ("aw", "w", "ar")]
    assert all(line.value == 1 for line in ready)
    dut.rst.value = 1
    for _ in range(3):
        await FallingEdge(dut.clk)
        assert all(line.value == 0 for line in ready)
    dut.rst.value = 0
    await FallingEdge(dut.clk)
    assert all(line.value == 1 for line in ready)
    await check_reset_values(bench)


@cocotb.test()
async def sticky_bits_are_cleared_one_by_one(dut):
    bench = await fresh(dut)
    assert await refuses(bench.write("id", 1)) and await refuses(bench.write("pulses", 0))
    for cleared, left in (("bad_address", 1 << STATUS.bit("bad_value")), ("bad_value", 0)):
        await bench.write("status", 1 << STATUS.bit(cleared))
        assert await bench.read("status") == left


@cocotb.test()
async def only_what_is_built(dut):
    """Parameters say what is built. Formats, switches and registers of anything else are
    refused.
    """
    bench = await fresh(dut)
    sensor = bench.sensor
    for part in (*PARTS, "counter_bits"):
        if registers.BY_NAME[part].count(sensor):
            assert await bench.read(part) == getattr(sensor, part)
        else:
            await refused(bench.axi.read(address(part)), bench, "bad_address")
    formats = [name in built_formats(sensor) for name in FORMATS]
    modes = [number < 4 or bool(sensor.controller) for number in range(8)]
    for name, subgroup, legal in (
        ("format", 0, formats),
        ("minigroup_records", 0, [True, bool(sensor.records)]),
        ("mode", 1, modes),
    ):
        for value, is_legal in enumerate(legal):
            write = bench.write(name, value, subgroup)
            if is_legal:
                await write
            else:
                await refused(write, bench, "bad_value")
    for name in ("share", "auto_bounds", "threshold_floor"):
        if not sensor.controller:
            await refused(bench.axi.write(address(name), 1), bench, "bad_address")
            await refused(bench.axi.read(address(name)), bench, "bad_address")
    await bench.write("format", 0)
    await bench.write("mode", 1, 1)
    await bench.write("control", 1)
    assert await refuses(bench.write("window", 3, 1)) == (not sensor.held)
    assert (await bench.read("window", 1) == 3) == bool(sensor.held)


@cocotb.test()
async def starts_that_make_no_sense(dut):
    bench = await fresh(dut)
    start = partial(bench.write, "control", 1)

    async def write_bounds(bounds):
        for index, bound in enumerate(bounds):
            await bench.write("auto_bounds", bound, index=index)

    of = config(frame={"period": 100, "pulses": 3})
    await bench.program(of)
    await bench.write("period", bench.sensor.guard)
    await refused(start(), bench, "start_period")
    await bench.write("period", 100)
    await bench.write("auto_bounds", 100_000, index=2)
    await refused(start(), bench, "start_bounds")
    # two neighbours differ in one bit, and are in the wrong order
    for bit in range(registers.DATA_BITS):
        value = random.getrandbits(registers.DATA_BITS) & ~(1 << bit)
        await write_bounds([value] * AUTO_BOUNDS)
        for low in range(AUTO_BOUNDS - 1):
            await bench.write("auto_bounds", value | 1 << bit, index=low)
            assert await refuses(start()), f"bit {bit} of bound {low}"
            await bench.write("auto_bounds", value, index=low)
    await bench.write("auto_bounds", value | 1 << bit, index=0)
    await refused(start(), bench, "start_bounds")  # and for no other reason
    await write_bounds(of.auto_bounds.tolist())
    await bench.write("gate_start", 100, subgroup=1)
    await bench.write("mode", 0b011, subgroup=1)
    await refused(start(), bench, "start_gate")
    await bench.write("mode", 0b001, subgroup=1)  # with gating off, a late gate does not matter
    await start()
    refusing, periods = cocotb.start_soon(refused_while_busy(bench)), []
    await laser_fires(dut)
    await received(bench, lambda cycle: {}, lambda cycle: periods.append(int(dut.laser.value)))
    await refusing
    while not await bench.read("status") >> STATUS.bit("done") & 1:
        pass
    assert not await bench.read("status") & 1, "still busy"
    assert sum(periods) == of.pulses, "the refused start ended the frame"


async def refused_while_busy(bench):
    for value in (1, 3):  # alone, and with an abort beside it, which would end the frame
        assert await refuses(bench.write("control", value)), "a second start was not refused"
    status = await bench.read("status")
    assert status & 1 and status >> STATUS.bit("start_busy") & 1


@cocotb.test()
async def control_ignores_zeros(dut):
    bench = await fresh(dut)
    await bench.write("control", 0)
    await bench.write("control", 2)  # an abort without a frame
    await ClockCycles(dut.clk, 50)
    assert await bench.read("status") == 0 and dut.laser.value == 0


@cocotb.test()
async def writes_do_not_disturb_a_running_frame(dut):
    bench = await fresh(dut)
    of = config(
        frame={"period": 120, "pulses": 12, "format": "full"},
        subgroup={"threshold": 2, "gating": True, "gate_start": 10, "gate_len": 90},
    )
    edges = some_edges(of, 5, 1500)
    other = config(
        frame=dict(
            period=60, pulses=2, format="short", minigroup_records=True, gate_every=1, gate_step=3
        ),
        subgroup={"threshold": 5, "window": 100, "coincidence": False, "mask": "1", "gate_len": 1},
    )

    async def disturb():
        while dut.laser.value == 0:
            await RisingEdge(dut.clk)
        await bench.program(other)

    trace = Golden(of.sensor).frame(of, edges)
    await bench.program(of)
    meddling = cocotb.start_soon(disturb())
    board = Scoreboard(of.sensor, trace)
    bench_axi, bench.axi = bench.axi, Queue(bench.axi)
    record = await bench.play(of, edges, np.zeros(0, np.uint8), board)
    await meddling
    bench.axi = bench_axi
    assert record.checked > 100


class Queue:
    """A register master that several tasks share: an access waits until the previous one has
    ended.
    """

    def __init__(self, axi):
        self._axi, self._lock = axi, cocotb.triggers.Lock()

    async def write(self, *args):
        async with self._lock:
            return await self._axi.write(*args)

    async def read(self, *args):
        async with self._lock:
            return await self._axi.read(*args)


async def received(bench, light, each=lambda cycle: None) -> list[int]:
    """Return the beats of the frame that is in cycle 0, with its stream always ready.

    light: the words of a cycle by subgroup; each: called in each cycle.
    """
    dut, beats, cycle = bench.dut, [], 0
    dut.m_axis_tready.value = 1
    while True:
        each(cycle)
        now = light(cycle)
        for s, line in enumerate(bench.spad):
            line.value = now.get(s, 0)
        if dut.m_axis_tvalid.value == 1:
            beats.append(int(dut.m_axis_tdata.value))
            if dut.m_axis_tlast.value == 1:
                return beats
        cycle += 1
        await FallingEdge(dut.clk)


@cocotb.test()
async def abort_ends_the_running_period(dut):
    bench = await fresh(dut)
    frame = {"period": 100, "pulses": 50, "format": "id", "auto_bounds": [0] * 6, "capacity": 20}
    of = config(frame=frame, subgroup={"threshold": 1, "auto": True})
    edges = some_edges(of, 7, 1000)
    bench.axi = Queue(bench.axi)
    await bench.program(of)

    async def abort():
        for _ in range(3):
            await RisingEdge(dut.laser)
        await bench.write("control", 2)

    words, periods = port_words(of, edges), []
    await bench.write("control", 1)
    aborting = cocotb.start_soon(abort())
    await laser_fires(dut)
    beats = await received(
        bench,
        lambda cycle: dict(words.get(cycle, ())),
        lambda cycle: periods.append(int(dut.laser.value)),
    )
    await aborting
    assert sum(periods) == 3, f"aborted in the third period, {sum(periods)} periods"
    early = edges.pulse < 3
    golden = Golden(of.sensor)
    trace = golden.frame(of, edges.take(early), pulses=3)
    assert beats == trace.beats[0].tolist()
    while not await bench.read("status") >> STATUS.bit("done") & 1:
        pass
    trace = golden.frame(of, edges)  # thresholds and budget continue from the aborted frame
    assert trace.counters[:, COUNTER_NAMES.index("threshold_used")].max() > 1
    await bench.play(of, edges, np.zeros(0, np.uint8), Scoreboard(of.sensor, trace))
    assert await bench.read("budget") == trace.budget[0]


@cocotb.test()
async def soft_reset_with_a_dead_receiver(dut):
    """In a frame whose receiver has taken nothing, with a read that waits: the sensor is as after
    `rst`, and the next frame is that of a new one.
    """
    bench = await fresh(dut)
    of = config(
        frame={"period": 100, "pulses": 3, "format": "full", "minigroup_records": True},
        subgroup={"threshold": 1, "auto": bool(bench.sensor.controller)},
    )
    edges = some_edges(of, 17, 1000)
    words = port_words(of, edges)
    await bench.program(of)
    dut.m_axis_tready.value = 0
    await bench.write("control", 1)
    await laser_fires(dut)
    for cycle in range(of.period * of.pulses + 100):
        now = dict(words.get(cycle, ()))
        for s, line in enumerate(bench.spad):
            line.value = now.get(s, 0)
        await FallingEdge(dut.clk)
    await bench.write("control", 2)
    assert await bench.read("status") == 1, "busy for ever"
    assert dut.m_axis_tvalid.value == 1

    start_and_reset = 0b101
    waiting = cocotb.start_soon(bench.read("pulses"))
    await bench.write("control", start_and_reset)
    assert await waiting in (of.pulses, config().pulses)
    assert dut.m_axis_tvalid.value == 0
    bench.programmed.clear()
    await check_reset_values(bench)
    assert await bench.read("status") == 0
    trace = Golden(of.sensor).frame(of, edges)
    await bench.play(of, edges, np.zeros(0, np.uint8), Scoreboard(of.sensor, trace))


@cocotb.test()
async def control_resets_only_if_it_is_written_whole(dut):
    bench = await fresh(dut)
    where, reset = registers.control("reset")
    await bench.write("pulses", 0x1234)
    await bench.axi.write(where, reset, byte_enable=0)
    await refused(bench.axi.write(where, reset, byte_enable=1), bench, "bad_strobe")
    await refused(bench.axi.write(where, reset | 8), bench, "bad_value")
    assert await bench.read("pulses") == 0x1234
    await bench.axi.write(where, reset)
    await check_reset_values(bench)


@cocotb.test()
async def gate_output_leads_the_spads(dut):
    """`spad_gate` is high exactly in the cycles whose edges the gate accepts, and always if gating
    is off.
    """
    bench = await fresh(dut)
    of = config(
        frame={
            "period": 40,
            "pulses": 6,
            "gate_step": 7,
            "gate_every": 2,
            "gate_steps": 2,
            "dither_bits": 3,
        },
        subgroup={"gating": True, "gate_start": 5, "gate_len": 30},
        override=[{"subgroups": [1], "gating": False}],
    )
    await bench.program(of)
    dut.m_axis_tready.value = 1
    await bench.write("control", 1)
    await laser_fires(dut)
    starts = period_starts(of)
    for cycle in range(starts[-1] + of.period):
        pulse = bisect_right(starts, cycle) - 1
        in_period = cycle - starts[pulse]
        start = 5 + 7 * (pulse // 2 % 2)
        expected = 2 | (start <= in_period < min(start + 30, of.period))
        assert int(dut.spad_gate.value) == expected, f"cycle {cycle}"
        assert int(dut.laser.value) == (in_period == 0), f"cycle {cycle}"
        await FallingEdge(dut.clk)
    assert int(dut.spad_gate.value) == 2


@cocotb.test()
async def no_edge_counts_between_two_periods(dut):
    bench = await fresh(dut)
    of = config(
        frame={
            "period": 40,
            "pulses": 6,
            "gap": 9,
            "dither_bits": 5,
            "minigroup_records": True,
        },
        subgroup={"threshold": 1},
    )
    await bench.program(of)
    starts, all_lines = period_starts(of), (1 << len(bench.spad[0])) - 1
    dark = {cycle for start in starts for cycle in range(start, start + of.period)}
    assert starts[-1] + of.period - len(dark) > 5 * 9 + 10
    await bench.write("control", 1)
    await laser_fires(dut)
    everywhere = dict.fromkeys(range(of.sensor.subgroups), all_lines)
    beats = await received(
        bench, lambda cycle: {} if cycle in dark or cycle > starts[-1] else everywhere
    )
    assert beats == Golden(of.sensor).frame(of, NOTHING).beats[0].tolist()


@cocotb.test()
async def independent_master_and_sink(dut):
    """Configure a frame with cocotbext-axi, and read it as packets and as registers."""
    await fresh(dut)
    sensor = config().sensor
    master = AxiLiteMaster(AxiLiteBus.from_prefix(dut, "s_axi"), dut.clk, dut.rst)
    sink = AxiStreamSink(AxiStreamBus.from_prefix(dut, "m_axis"), dut.clk, dut.rst)
    of = config(frame={"period": 90, "pulses": 5}, subgroup={"threshold": 1})
    edges = some_edges(of, 13)
    for where, value in of.register_writes():
        assert (await master.write(where, value.to_bytes(4, "little"))).resp == AxiResp.OKAY
    assert (await master.write(address("period"), bytes(4))).resp == AxiResp.SLVERR
    sink.set_pause_generator(iter(lambda: random.random() < 0.3, None))
    words = port_words(of, edges)

    async def light():
        await laser_fires(dut)
        for cycle in range(of.period * of.pulses):
            now = dict(words.get(cycle, ()))
            for s in range(sensor.subgroups):
                getattr(dut, f"spad_{s}").value = now.get(s, 0)
            await FallingEdge(dut.clk)

    shining = cocotb.start_soon(light())
    assert (await master.write(address("control"), (1).to_bytes(4, "little"))).resp == AxiResp.OKAY
    received = await sink.recv()
    await shining
    frame = decode_frame(np.frombuffer(bytes(received.tdata), "<u8"), sensor, sensor.subgroups)
    trace = Golden(sensor).frame(of, edges)
    assert np.array_equal(frame.counters[:, :3], trace.counters[:, :3])
    assert len(frame.events) == frame.counters[:, 3].sum() > 20
    status = 0
    while not status >> STATUS.bit("done") & 1:
        status = int.from_bytes((await master.read(address("status"), 4)).data, "little")
    for s in range(sensor.subgroups):
        for i, name in enumerate(COUNTER_NAMES):
            assert (
                int.from_bytes((await master.read(address(name, s), 4)).data, "little")
                == frame.counters[s, i]
            ), name
