# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of the sensor whose registers are changed from outside: wrong copies, upset writes,
wide numbers. On Icarus.
"""

import itertools
import random

import cocotb
import numpy as np
from cocotb.handle import HierarchyObject
from cocotb.triggers import ClockCycles, FallingEdge, ReadOnly
from sensor_bench import (
    NOTHING,
    STATUS,
    Queue,
    config,
    laser_fires,
    received,
    refuses,
    reset_cycle,
    some_edges,
)
from sensor_bench import fresh as fresh_bench

from coincid.hdl.dpcu import counter_bits
from coincid.model.contract.counters import COUNTER_NAMES
from coincid.model.contract.packet import HEADER
from coincid.model.contract.stream import decode_frame
from coincid.model.golden.frame import Golden
from coincid.tb.cosim import SensorBench
from coincid.tb.scoreboard import Scoreboard
from coincid.tb.stimulus import port_words

ANSWER_CYCLES = 60  # more than any access takes


def busy_config():
    return config(
        frame={"period": 60, "pulses": 4, "format": "full", "minigroup_records": True},
        subgroup={"threshold": 1, "auto": True, "window": 12},
        override=[{"subgroups": [1], "gating": True, "gate_start": 5, "gate_len": 30}],
    )


async def pulse_reset(bench: SensorBench) -> None:
    """Apply a reset of one cycle, with quiet inputs after it."""
    await FallingEdge(bench.dut.clk)
    for line in (*bench.spad, *bench.tready):
        line.value = 0
    # As the bench's master sets them:
    for name, value in (
        ("awvalid", 0),
        ("wvalid", 0),
        ("arvalid", 0),
        ("bready", 1),
        ("rready", 1),
    ):
        getattr(bench.dut, f"s_axi_{name}").value = value
    await reset_cycle(bench)
    assert bench.dut.m_axis_tvalid.value == 0 and bench.dut.laser.value == 0


async def works(bench: SensorBench, of, edges, trace) -> None:
    """Check that the sensor plays a frame like a new one."""
    record = await bench.play(of, edges, np.zeros(0, np.uint8), Scoreboard(of.sensor, trace))
    assert record.checked > 50


async def fresh(dut):
    bench, of = await fresh_bench(dut), busy_config()
    edges = some_edges(of, 3, 300)
    return bench, of, edges, Golden(of.sensor).frame(of, edges)


def change(register, how) -> None:
    """Overwrite a register with `how` of its value."""
    register.value = how(int(register.value))


def dpcu(dut, subgroup: int):
    return dut["module_0"][f"subgroup_{subgroup}"]["dpcu"]


def codes(unit, name: str) -> dict[str, int]:
    """Return by copy of a voted register which of its bits are stored inverted."""
    full = (1 << len(unit[name])) - 1
    return {"plain": 0, "inverse": full, "by_turns": full * int(unit[f"{name}_turn"].value)}


async def put(dut, unit, name: str, value: int) -> None:
    """Set a voted register, in all three copies."""
    await FallingEdge(dut.clk)
    for copy, code in codes(unit, name).items():
        unit[f"{name}_{copy}"].value = value ^ code


def copies(unit, name: str) -> set[int]:
    """Return the values of a voted register's copies: one value if they agree."""
    return {int(unit[f"{name}_{copy}"].value) ^ code for copy, code in codes(unit, name).items()}


def voted(unit) -> list[tuple]:
    """Return (instance, name) for every register in three copies, in a unit and those inside."""
    found = [
        (unit, part._name.removesuffix("_plain")) for part in unit if part._name.endswith("_plain")
    ]
    return found + [
        one for part in unit if isinstance(part, HierarchyObject) for one in voted(part)
    ]


@cocotb.test()
async def copies_agree_and_outvote_one(dut):
    """One wrong copy of a voted register changes nothing and heals. Proofs say that without an
    upset the copies agree.
    """
    bench, of, edges, trace = await fresh(dut)
    kept = voted(dut)
    assert len(kept) >= 7  # five of the bus, frame number, budget
    await pulse_reset(bench)
    await ClockCycles(dut.clk, 2)
    for unit, name in kept:
        # both values of the turn
        for copy, cycles in itertools.product(("plain", "inverse", "by_turns"), (1, 2)):
            await ClockCycles(dut.clk, cycles)
            await FallingEdge(dut.clk)
            value = int(unit[name].value)
            bit = random.randrange(len(unit[name]))
            change(unit[f"{name}_{copy}"], lambda code, bit=bit: code ^ 1 << bit)
            await ReadOnly()
            assert int(unit[name].value) == value and len(copies(unit, name)) == 2, f"{name}_{copy}"
            await FallingEdge(dut.clk)
            assert copies(unit, name) == {int(unit[name].value)} == {value}, f"{name}_{copy}"
    await works(bench, of, edges, trace)


@cocotb.test()
async def writes_that_are_upset(dut):
    """Flip a bit of a value on its way from the port to a setting, in every cycle of the access.

    The write is refused, or the setting is right, or the next start is refused."""
    bench = await fresh_bench(dut)
    outcomes = []
    for cycle in range(ANSWER_CYCLES):
        wanted = random.getrandbits(32)
        await bench.program(config())
        writing = cocotb.start_soon(refuses(bench.write("capacity", wanted)))
        await ClockCycles(dut.clk, cycle + 1)
        if writing.done():
            break
        await FallingEdge(dut.clk)
        change(dut["registers"]["value"], lambda value: value ^ 1 << random.randrange(32))
        if await writing:
            outcomes.append("refused")
        elif await bench.read("capacity") == wanted:
            outcomes.append("right")
        else:
            assert await refuses(bench.write("control", 1))
            assert await bench.read("status") >> STATUS.bit("start_upset") & 1
            outcomes.append("start refused")
        await pulse_reset(bench)
    assert outcomes.count("refused") >= 2 and outcomes.count("start refused") <= 2, outcomes


def counter_registers(dut, sensor) -> dict[str, str]:
    """Return for every counter its register in the DPCU (with a suffix if a port has the same
    name).
    """
    of_dpcu = {name.partition("$")[0]: name for name in sorted(part._name for part in dpcu(dut, 0))}
    # `threshold_used` is already in force.
    names = {name: of_dpcu[name] for name in COUNTER_NAMES if name != "threshold_used"}
    assert all(len(dpcu(dut, 0)[of]) == counter_bits(name, sensor) for name, of in names.items())
    return names


async def frame_with_counters(bench, of, edges, registers, values: list[dict]) -> np.ndarray:
    """Play a frame, set the counters of each subgroup shortly before its end, and return what the
    stream says of them.
    """
    dut = bench.dut
    await bench.program(of)
    playing = cocotb.start_soon(bench.play(of, edges, np.zeros(0, np.uint8)))
    await laser_fires(dut)
    await ClockCycles(dut.clk, of.period * of.pulses - 2)
    await FallingEdge(dut.clk)
    for s, of_subgroup in enumerate(values):
        for name, value in of_subgroup.items():
            register = dpcu(dut, s)[registers[name]]
            register.value = value & (1 << len(register)) - 1
    record = await playing
    return decode_frame(record.beats[0], of.sensor, of.sensor.subgroups).counters


@cocotb.test()
async def counters_in_full_width(dut):
    """Force counters to values that no test frame reaches: all bits leave by stream and bus, and
    the counters saturate.
    """
    bench, of, edges, trace = await fresh(dut)
    bench.axi = Queue(bench.axi)
    names = counter_registers(dut, of.sensor)
    for value in (0xFFFF_FFFF, 0xA5A5_5A5A, 0x5A5A_A5A5, 0x1357_9BDF):
        counters = await frame_with_counters(
            bench, of, edges, names, [dict.fromkeys(names, value)] * 2
        )
        for s in range(2):
            for name in names:
                highest = (1 << counter_bits(name, of.sensor)) - 1
                shown = int(counters[s, COUNTER_NAMES.index(name)])
                assert shown == await bench.read(name, s), name
                assert value & highest <= shown <= min((value & highest) + 80, highest), (
                    f"{name}: {shown:#x}"
                )


@cocotb.test()
async def frame_numbers_in_full_width(dut):
    """Continue with a high frame number: the frames' first and last beats carry it, and the next
    frame the next one.
    """
    bench = await fresh_bench(dut)
    of = config(frame={"period": 60, "pulses": 1})
    _, width = HEADER["pulse"]
    for bit in range(width):
        number = (2 << bit) - 1  # one more changes all bits up to the next one
        await put(dut, dut["sequencer"], "number_voted", number)
        for expected in (number, number + 1):
            record = await bench.play(of, NOTHING, np.zeros(0, np.uint8))
            shown = decode_frame(record.beats[0], of.sensor, of.sensor.subgroups).number
            assert shown == expected & (1 << width) - 1


@cocotb.test()
async def pulse_numbers_in_full_width(dut):
    """Continue frames at a high pulse number: events and records carry it, and the last pulse ends
    the frame.
    """
    bench, of, edges, trace = await fresh(dut)
    usual = decode_frame(trace.beats[0], of.sensor, 2)
    for jump in (0xFFFF - (of.pulses - 1), 0xA5A5, 0x5A5A):
        await pulse_reset(bench)
        await bench.program(of.with_frame(pulses=of.pulses + jump))
        await bench.write("control", 1)
        await laser_fires(dut)
        words = port_words(of, edges)

        def leap(cycle, jump=jump):
            if cycle == of.period // 2:
                for unit in (dut["sequencer"], dpcu(dut, 0), dpcu(dut, 1)):
                    change(unit["pulse"], lambda value: value + jump)

        beats = await received(bench, lambda cycle, words=words: dict(words.get(cycle, ())), leap)
        shown = decode_frame(np.array(beats, np.uint64), of.sensor, 2)
        column = list(HEADER).index("pulse")
        for one, other in zip(
            *((frame.events[:, column], frame.records[:, 1]) for frame in (shown, usual)),
            strict=True,
        ):
            assert len(one) == len(other) >= 2 * of.pulses
            assert all(
                a in (b, b + jump) for a, b in zip(one.tolist(), other.tolist(), strict=True)
            )
            assert one[-1] == of.pulses - 1 + jump
