# SPDX-License-Identifier: Apache-2.0
"""A cocotb bench of the sensor's Verilog without code of this project: it looks up register
names and decodes words itself.

`plot_09_cocotb.py` starts it. COINCID_REGISTERS names the register map (`registers.json`),
COINCID_SEEN the output file.
"""

import json
import os
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import RisingEdge
from cocotbext.axi import AxiLiteBus, AxiLiteMaster, AxiStreamBus, AxiStreamSink

PHASES = 32  # ticks of a cycle
# (pixel, cycle, phase): four photons of a laser pulse
EDGES = ((9, 5, 22), (10, 5, 25), (18, 5, 30), (2, 6, 3))
REGISTERS = json.loads(os.environ["COINCID_REGISTERS"])


@cocotb.test()
async def one_event(dut):
    """Four photons within a window become one event with their count, their map, and the stamp
    of the first.
    """
    Clock(dut.clk, 2, "ns").start()
    registers = AxiLiteMaster(AxiLiteBus.from_prefix(dut, "s_axi"), dut.clk, dut.rst)
    stream = AxiStreamSink(AxiStreamBus.from_prefix(dut, "m_axis"), dut.clk, dut.rst)
    dut.spad_0.value = 0
    dut.test_enable.value = 0
    dut.rst.value = 1
    for _ in range(4):
        await RisingEdge(dut.clk)
    dut.rst.value = 0

    await registers.write_dword(REGISTERS["period"], 40)
    await registers.write_dword(REGISTERS["pulses"], 1)
    await registers.write_dword(REGISTERS["threshold"], 3)
    await registers.write_dword(REGISTERS["control"], 1)  # start

    # `laser` is sampled high at the clock edge that ends cycle 0: what is driven after that edge
    # belongs to cycle 1.
    while not dut.laser.value:
        await RisingEdge(dut.clk)
    rows = []
    for cycle in range(1, 40):
        dut.spad_0.value = sum(
            1 << pixel * PHASES + phase for pixel, at, phase in EDGES if at == cycle
        )
        await RisingEdge(dut.clk)
        rows.append([cycle, int(dut.m_axis_tvalid.value), sum(at == cycle for _, at, _ in EDGES)])

    frame = await stream.recv()
    beats = [
        int.from_bytes(frame.tdata[i : i + 8], "little") for i in range(0, len(frame.tdata), 8)
    ]
    events = [(beats[i], beats[i + 1]) for i in range(len(beats) - 1) if beats[i] >> 61 == 2]
    assert len(events) == 1, "one event with an ID map"
    header, hits = events[0]
    stamp, winner, count = header & 0x7FFF, header >> 15 & 0xFF, header >> 23 & 0x1FF
    assert stamp == 5 * PHASES + 22 and winner == 9 and count == len(EDGES)
    assert hits == sum(1 << pixel for pixel, _, _ in EDGES)
    dut._log.info(f"stamp {stamp} ticks, winner {winner}, count {count}, map {hits:#x}")
    Path(os.environ["COINCID_SEEN"]).write_text(
        json.dumps({"rows": rows, "stamp": stamp, "count": count}), encoding="utf-8"
    )
