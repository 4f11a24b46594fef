# SPDX-License-Identifier: Apache-2.0
"""cocotb test of the asynchronous view: resets in the middle of frames, while the SPADs keep
firing.
"""

import random

import cocotb
import numpy as np
from cocotb.triggers import ClockCycles, FallingEdge
from sensor_bench import config, some_edges

from coincid.model.golden.frame import Golden
from coincid.tb.cosim import LineBench
from coincid.tb.scoreboard import Scoreboard

RESETS = 5
ALWAYS = np.zeros(0, np.uint8)  # the stream is ready in every cycle


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
    bench = LineBench(dut, config().sensor)
    await bench.reset()
    frame = {"period": 60, "pulses": 4, "format": "full", "minigroup_records": True}
    of = config(frame=frame, subgroup={"threshold": 1, "auto": True})
    edges = some_edges(of, 3, 300)
    trace = Golden(of.sensor).frame(of, edges)
    await start(bench, of, edges)
    for _ in range(RESETS):
        await ClockCycles(dut.clk, random.randrange(of.period * of.pulses))
        await FallingEdge(dut.clk)
        dut.rst.value = 1
        await FallingEdge(dut.clk)
        dut.rst.value = 0
        await ClockCycles(dut.clk, random.randrange(1, 8))
        assert dut.m_axis_tvalid.value == 0 and dut.laser.value == 0
        go_dark(bench)
        bench.programmed.clear()
        record = await bench.play(of, edges, ALWAYS, Scoreboard(of.sensor, trace))
        assert record.checked > 50
        await FallingEdge(dut.clk)
        dut.rst.value = 1  # this also clears the controller's memory
        await FallingEdge(dut.clk)
        dut.rst.value = 0
        bench.programmed.clear()
        await start(bench, of, edges)
    go_dark(bench)
