# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of the sensor under faults: stalls, illegal masters, resets in any cycle, upsets. On Icarus, to see inside.

In all cases the register bus answers, and after a reset the sensor works like a new one.
"""

import itertools
import json
import os
import random
import re

import cocotb
import numpy as np
from cocotb.triggers import ClockCycles, FallingEdge
from sensor_bench import Queue, config, received, some_edges

from coincid.hdl.dpcu import counter_bits
from coincid.model.contract.packet import HEADER
from coincid.model.contract.parameters import TOP
from coincid.model.contract.registers import COUNTER_NAMES, ID_VALUE
from coincid.model.contract.stream import decode_frame
from coincid.model.golden.controller import Controller
from coincid.model.golden.frame import Golden
from coincid.tb.cosim import SensorBench
from coincid.tb.scoreboard import Scoreboard
from coincid.tb.stimulus import port_words

SOURCES = "COINCID_FAULT_SOURCES"  # the design's files, as JSON
RESETS, UPSETS = 12, 16
ANSWER_CYCLES = 60  # limit for the bus; the proof has a lower one
FLOP = re.compile(r"^  reg (?:\[(\d+):0\] )?\\?(\S+)\s+= \d+'", re.MULTILINE)
INSTANCE = re.compile(r"^  (coincid_\w+|\\coincid_\S+ ) ?\\?(\S+)\s+\(", re.MULTILINE)
MODULE = re.compile(r"^module (\\?\S+)\s*\(.*?^endmodule", re.MULTILINE | re.DOTALL)


def busy_config():
    return config(
        frame={"period": 60, "pulses": 4, "format": "full", "minigroup_records": True},
        subgroup={"threshold": 1, "auto": True, "window": 12},
        override=[{"subgroups": [1], "gating": True, "gate_start": 5, "gate_len": 30}],
    )


async def pulse_reset(bench: SensorBench) -> None:
    """Apply a reset of one cycle, with quiet inputs after it."""
    await FallingEdge(bench.dut.clk)
    bench.dut.rst.value = 1
    for line in bench.spad:
        line.value = 0
    for line in bench.tready:
        line.value = 0
    for name, value in (
        ("awvalid", 0),
        ("wvalid", 0),
        ("arvalid", 0),
        ("bready", 1),
        ("rready", 1),
    ):  # as the bench's master sets them
        getattr(bench.dut, f"s_axi_{name}").value = value
    await FallingEdge(bench.dut.clk)
    bench.dut.rst.value = 0
    bench.programmed.forget()
    await ClockCycles(bench.dut.clk, 4)
    assert bench.dut.m_axis_tvalid.value == 0 and bench.dut.laser.value == 0


async def works(bench: SensorBench, of, edges, trace) -> None:
    """Check that the sensor plays a frame like a new one."""
    record = await bench.play(of, edges, np.zeros(0, np.uint8), Scoreboard(of.sensor, trace))
    assert record.checked > 50


async def fresh(dut):
    bench = SensorBench(dut, config().sensor)
    await bench.reset()
    of = busy_config()
    edges = some_edges(of, 3, 300)
    return bench, of, edges, Golden(of.sensor).frame(of, edges)


async def run_into(bench, of, edges, cycles: int) -> None:
    """Start a frame and play its first cycles, with a stream that stalls at random."""
    await bench.program(of)
    await bench.write("control", 1)
    words = port_words(of, edges)
    for _ in range(100):
        if bench.dut.laser.value == 1:
            break
        await FallingEdge(bench.dut.clk)
    for cycle in range(cycles):
        now = dict(words.get(cycle, ()))
        for s, line in enumerate(bench.spad):
            line.value = now.get(s, 0)
        bench.dut.m_axis_tready.value = random.getrandbits(1)
        await FallingEdge(bench.dut.clk)
    for line in bench.spad:
        line.value = 0


async def bus_answers(dut) -> int:
    """Read the id, whatever the bus was doing; return the number of cycles until an answer came."""
    for name, value in (("awvalid", 0), ("wvalid", 0), ("bready", 1), ("araddr", 0), ("arvalid", 1), ("rready", 1)):
        getattr(dut, f"s_axi_{name}").value = value
    for cycle in range(ANSWER_CYCLES):
        await FallingEdge(dut.clk)
        if dut.s_axi_rvalid.value == 1:
            dut.s_axi_arvalid.value = 0
            await ClockCycles(dut.clk, 2)
            return cycle
    raise AssertionError(f"the register bus does not answer in {ANSWER_CYCLES} cycles")


@cocotb.test()
async def a_stream_that_stalls_for_ever(dut):
    bench, of, edges, trace = await fresh(dut)
    await run_into(bench, of, edges, of.period * of.pulses)
    dut.m_axis_tready.value = 0
    await ClockCycles(dut.clk, 200)
    offered = int(dut.m_axis_tdata.value), int(dut.m_axis_tlast.value)
    for _ in range(10):
        await ClockCycles(dut.clk, 200)
        assert dut.m_axis_tvalid.value == 1 and (int(dut.m_axis_tdata.value), int(dut.m_axis_tlast.value)) == offered
        assert await bench.read("id") == ID_VALUE and await bench.read("status") & 1
    await bench.write("control", 2)  # an abort does not free the stream, and does not hang anything
    assert await bench.read("status") & 1
    await pulse_reset(bench)
    assert await bench.read("status") == 0
    await works(bench, of, edges, trace)


@cocotb.test()
async def masters_that_break_the_rules(dut):
    """Valid falls before ready, addresses and data change while they wait, strobes are partial, answers are not taken."""
    bench, of, edges, trace = await fresh(dut)
    for _ in range(4):
        waiting = {}
        for _ in range(400):
            for name, bits in (("awaddr", 13), ("wdata", 3), ("wstrb", 4), ("araddr", 13)):
                getattr(dut, f"s_axi_{name}").value = random.getrandbits(bits)
            for name in ("awvalid", "wvalid", "arvalid", "bready", "rready"):
                getattr(dut, f"s_axi_{name}").value = random.random() < 0.4
            await FallingEdge(dut.clk)
            for channel in ("b", "r"):  # the sensor keeps both anyway
                valid = getattr(dut, f"s_axi_{channel}valid").value == 1
                answer = (
                    int(getattr(dut, f"s_axi_{channel}resp").value),
                    int(dut.s_axi_rdata.value) if channel == "r" else 0,
                )
                if channel in waiting:
                    assert valid and answer == waiting[channel], f"answer on {channel} withdrawn"
                waiting.pop(channel, None)
                if valid and getattr(dut, f"s_axi_{channel}ready").value == 0:
                    waiting[channel] = answer
            waiting = {}  # the next inputs decide whether the answer is taken at the coming edge
        await bus_answers(dut)
        assert dut.s_axi_rvalid.value == 0
        await pulse_reset(bench)
    await works(bench, of, edges, trace)


@cocotb.test()
async def resets_in_any_cycle(dut):
    bench, of, edges, trace = await fresh(dut)
    for _ in range(RESETS):
        await run_into(bench, of, edges, random.randrange(of.period * of.pulses + 60))
        await pulse_reset(bench)
        await works(bench, of, edges, trace)


def flip_flops(sources: list[str]) -> list[tuple[str, str, int]]:
    """Return (path of the instance, register, bits) for every flip-flop of the design."""
    flops, instances = {}, {}
    for path in sources:
        for module in MODULE.finditer(open(path).read()):
            name = module[1].lstrip("\\")
            flops[name] = [
                (register, int(top or 0) + 1)
                for top, register in FLOP.findall(module[0])
                if not register.startswith("$")
            ]
            instances[name] = [(of.strip().lstrip("\\"), inner) for of, inner in INSTANCE.findall(module[0])]
    found, todo = [], [("", TOP)]
    while todo:
        at, name = todo.pop()
        found += [(at, register, bits) for register, bits in flops[name]]
        todo += [(f"{at}.{inner}".lstrip("."), of) for of, inner in instances[name]]
    return found


def handle(dut, path: str, name: str):
    for part in filter(None, path.split(".")):
        dut = dut[part]
    return dut[name]


def change(dut, path: str, name: str, how) -> None:
    """Overwrite a register with `how` of its value."""
    register = handle(dut, path, name)
    register.value = how(int(register.value))


@cocotb.test()
async def upsets_of_any_flip_flop(dut):
    """With a flipped bit in any cycle of a frame, the bus keeps answering, and a reset repairs everything."""
    bench, of, edges, trace = await fresh(dut)
    flops = flip_flops(json.loads(os.environ[SOURCES]))
    weights = [bits for _, _, bits in flops]
    assert sum(weights) > 3000
    for _ in range(UPSETS):
        await run_into(bench, of, edges, random.randrange(1, of.period * of.pulses))
        path, name, bits = random.choices(flops, weights)[0]
        change(dut, path, name, lambda value, bits=bits: value ^ 1 << random.randrange(bits))
        await ClockCycles(dut.clk, 20)
        await bus_answers(dut)
        await pulse_reset(bench)
        await works(bench, of, edges, trace)


@cocotb.test()
async def upsets_of_the_register_front(dut):
    """Flip every bit of every register in the block that must not hang, in the middle of accesses."""
    bench, of, edges, trace = await fresh(dut)
    control = [flop for flop in flip_flops(json.loads(os.environ[SOURCES])) if flop[0] == "registers" and flop[2] <= 4]
    assert len(control) > 15
    for path, name, bits in control:
        for bit in range(bits):
            dut.s_axi_arvalid.value = 1
            dut.s_axi_rready.value = 1
            await ClockCycles(dut.clk, random.randrange(1, 9))
            await FallingEdge(dut.clk)
            change(dut, path, name, lambda value, bit=bit: value ^ 1 << bit)
            await FallingEdge(dut.clk)
            await bus_answers(dut)
            await pulse_reset(bench)
    await works(bench, of, edges, trace)


@cocotb.test()
async def counters_in_full_width(dut):
    """Force counters to values that no test frame reaches: all bits leave by stream and bus, and the counters saturate.

    The threshold controller treats them as the golden model does."""
    bench, of, edges, trace = await fresh(dut)
    controller, used = Controller(of.sensor), COUNTER_NAMES.index("threshold_used")
    bounds = [0, 0x1234_5678, 0x5A5A_A5A5, 0x5A5A_A5FF, 0xA5A5_5A5A, 0xFFFF_FFFF]
    bench.axi = Queue(bench.axi)
    dpcu = [handle(dut, f"module_0.subgroup_{s}", "dpcu") for s in range(2)]
    flops = flip_flops(json.loads(os.environ[SOURCES]))
    registers_of = {  # counter: its register (with a suffix if a port has the same name), and its bits
        register.partition("$")[0]: (register, bits)
        for path, register, bits in flops
        if path == "module_0.subgroup_0.dpcu"
    }
    names = {
        name: registers_of[name] for name in COUNTER_NAMES if name != "threshold_used"
    }  # that one is already in force
    assert all(bits == counter_bits(name, of.sensor) for name, (_, bits) in names.items())
    for value, capacity in itertools.product(
        (0xFFFF_FFFF, 0xA5A5_5A5A, 0x5A5A_A5A5, 0x1357_9BDF), (0xFFFF_FFFF, 0x9876_5432)
    ):
        of = of.with_frame(capacity=capacity, auto_bounds=bounds)
        thresholds = controller.begin(of)
        await bench.program(of)
        playing = cocotb.start_soon(bench.play(of, edges, np.zeros(0, np.uint8)))
        for _ in range(200):
            await FallingEdge(dut.clk)
            if dut.laser.value == 1:
                break
        await ClockCycles(dut.clk, of.period * of.pulses - 2)
        await FallingEdge(dut.clk)
        for unit in dpcu:
            for register, bits in names.values():
                unit[register].value = value & (1 << bits) - 1
        record = await playing
        counters = decode_frame(record.beats[0], of.sensor, 2).counters
        controller.end(of, counters)
        assert await bench.read("budget") == controller.budget[0]
        assert counters[:, used].tolist() == thresholds.tolist()
        for s in range(2):
            for name, (_, bits) in names.items():
                highest = (1 << bits) - 1
                shown = int(counters[s, COUNTER_NAMES.index(name)])
                assert shown == await bench.read(name, s), name
                assert value & highest <= shown <= min((value & highest) + 80, highest), f"{name}: {shown:#x}"


@cocotb.test()
async def pulse_numbers_in_full_width(dut):
    """Continue frames at a high pulse number: events and records carry it, and the last pulse ends the frame."""
    bench, of, edges, trace = await fresh(dut)
    usual = decode_frame(trace.beats[0], of.sensor, 2)
    for jump in (0xFFFF - (of.pulses - 1), 0xA5A5, 0x5A5A):
        await pulse_reset(bench)
        await bench.program(of.with_frame(pulses=of.pulses + jump))
        await bench.write("control", 1)
        while dut.laser.value == 0:
            await FallingEdge(dut.clk)
        words = port_words(of, edges)

        def leap(cycle, jump=jump):
            if cycle == of.period // 2:
                for path in ("sequencer", *(f"module_0.subgroup_{s}.dpcu" for s in range(2))):
                    change(dut, path, "pulse", lambda value: value + jump)

        beats = await received(bench, lambda cycle, words=words: dict(words.get(cycle, ())), leap)
        shown = decode_frame(np.array(beats, np.uint64), of.sensor, 2)
        column = list(HEADER).index("pulse")
        for one, other in (
            (shown.events[:, column], usual.events[:, column]),
            (shown.records[:, 1], usual.records[:, 1]),
        ):
            assert len(one) == len(other) >= 2 * of.pulses
            assert all(a in (b, b + jump) for a, b in zip(one.tolist(), other.tolist()))
            assert one[-1] == of.pulses - 1 + jump
