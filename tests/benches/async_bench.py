# SPDX-License-Identifier: Apache-2.0
"""cocotb tests of the asynchronous view: resets and aborts in the middle of frames, while the SPADs keep firing."""

import random

import cocotb
import numpy as np
from cocotb.triggers import ClockCycles, FallingEdge, RisingEdge
from sensor_bench import config, some_edges

from coincid.model.golden.frame import Golden
from coincid.tb.cosim import LineBench
from coincid.tb.scoreboard import Scoreboard

RESETS = 8
ALWAYS = np.zeros(0, np.uint8)  # the stream is ready in every cycle


async def begun(dut, pulses: int):
    """Return a bench with a running frame and its light, in cycle 0; and its configuration and edges."""
    bench = LineBench(dut, config().sensor)
    await bench.reset()
    frame = {"period": 60, "pulses": pulses, "format": "full", "minigroup_records": True}
    of = config(frame=frame, subgroup={"threshold": 1, "auto": True})
    edges = some_edges(of, 3, 75 * pulses)
    await start(bench, of, edges)
    return bench, of, edges


async def start(bench: LineBench, of, edges) -> None:
    await bench.program(of)
    bench.shine(of, edges)
    await bench.write("control", 1)
    for line in bench.tready:
        line.value = 1
    while bench.dut.laser.value == 0:
        await FallingEdge(bench.dut.clk)


def go_dark(bench: LineBench) -> None:
    bench.light.cancel()
    for line in bench.spad:
        line.value = 0


@cocotb.test()
async def resets_in_any_cycle(dut):
    bench, of, edges = await begun(dut, 4)
    trace = Golden(of.sensor).frame(of, edges)
    for _ in range(RESETS):
        await ClockCycles(dut.clk, random.randrange(of.period * of.pulses))
        await FallingEdge(dut.clk)
        dut.rst.value = 1
        await FallingEdge(dut.clk)
        dut.rst.value = 0
        await ClockCycles(dut.clk, random.randrange(1, 8))
        assert dut.m_axis_tvalid.value == 0 and dut.laser.value == 0
        go_dark(bench)
        bench.programmed.forget()
        record = await bench.play(of, edges, ALWAYS, Scoreboard(of.sensor, trace))
        assert record.checked > 50
        await FallingEdge(dut.clk)
        dut.rst.value = 1  # this also clears the controller's memory
        await FallingEdge(dut.clk)
        dut.rst.value = 0
        bench.programmed.forget()
        await start(bench, of, edges)
    go_dark(bench)


@cocotb.test()
async def abort_ends_the_running_period(dut):
    bench, of, edges = await begun(dut, 6)
    beats = []

    async def receive():
        while True:
            if dut.m_axis_tvalid.value == 1:
                beats.append(int(dut.m_axis_tdata.value))
                if dut.m_axis_tlast.value == 1:
                    return
            await FallingEdge(dut.clk)

    receiving = cocotb.start_soon(receive())
    for _ in range(2):
        await RisingEdge(dut.laser)
    await bench.write("control", 2)
    await receiving
    go_dark(bench)
    early = edges.pulse < 3
    trace = Golden(of.sensor).frame(of, edges.take(early), pulses=3)
    assert beats == trace.beats[0].tolist()
    assert len(beats) > 50
