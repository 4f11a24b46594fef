# SPDX-License-Identifier: Apache-2.0
"""The sensor in Amaranth's own simulator: the slowest way to run it, and the only one without
any Verilog.
"""

from collections.abc import Callable

import numpy as np
from amaranth.sim import Simulator, SimulatorContext

from ..hdl.sensor import SensorTop
from ..model.contract import registers
from ..model.contract.config import Config
from ..model.contract.edges import Edges
from .frame_record import cycle_limit
from .rtl_errors import SimulationError
from .stimulus import port_words


async def write_register(ctx: SimulatorContext, dut: SensorTop, address: int, value: int) -> None:
    """Write over the sensor's AXI4-Lite port, with `wstrb` and `bready` set; return in the cycle
    of the answer.
    """
    ctx.set(dut.s_axi.awaddr, address)
    ctx.set(dut.s_axi.wdata, value)
    channels = [(dut.s_axi.awvalid, dut.s_axi.awready), (dut.s_axi.wvalid, dut.s_axi.wready)]
    for valid, _ in channels:
        ctx.set(valid, 1)
    answered = False
    while not answered:
        taken = [valid for valid, ready in channels if ctx.get(valid) and ctx.get(ready)]
        answered = bool(ctx.get(dut.s_axi.bvalid))
        await ctx.tick()
        for valid in taken:
            ctx.set(valid, 0)


def play(
    config: Config, edges: Edges, progress: Callable[[int], None] = lambda cycle: None
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Program the sensor, play a frame with `tready` high, and return per stream the beats
    (uint64) and cycles (int64).

    progress: called at the beginning of each cycle of the frame with its number. Raises
    `SimulationError` if the frame does not end.
    """
    sensor = config.sensor
    dut, words = SensorTop(sensor), port_words(config, edges)
    frame_cycles = config.frame_cycles
    names = [sensor.stream_name(stream) for stream in range(sensor.streams)]
    beats: list[list[int]] = [[] for _ in names]
    beat_cycle: list[list[int]] = [[] for _ in names]

    async def host(ctx: SimulatorContext) -> None:
        ctx.set(dut.s_axi.wstrb, 0xF)
        ctx.set(dut.s_axi.bready, 1)
        for address, value in [*config.register_writes(), registers.control("start")]:
            await write_register(ctx, dut, address, value)

    async def frame(ctx: SimulatorContext) -> None:
        streams = [
            [getattr(getattr(dut, name), wire) for wire in ("tvalid", "tdata", "tlast", "tready")]
            for name in names
        ]
        spads = [getattr(dut, f"spad_{s}") for s in range(sensor.subgroups)]
        for *_, ready in streams:
            ctx.set(ready, 1)
        while not ctx.get(dut.laser):
            await ctx.tick()
        running, cycle = list(range(len(streams))), 0
        driven: dict[int, int] = {}
        while running or cycle < frame_cycles:
            progress(cycle)
            now = dict(words.get(cycle, ()))
            for s in driven.keys() | now.keys():
                ctx.set(spads[s], now.get(s, 0))
            driven = now
            for stream in tuple(running):
                valid, data, last, _ = streams[stream]
                if ctx.get(valid):
                    beats[stream].append(ctx.get(data))
                    beat_cycle[stream].append(cycle)
                    if ctx.get(last):
                        running.remove(stream)
            cycle += 1
            if cycle >= cycle_limit(config, 0):
                raise SimulationError(f"no frame end after {cycle} cycles: the sensor hangs")
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-6 / config.clock_mhz)
    simulator.add_testbench(host)
    simulator.add_testbench(frame)
    simulator.run()
    return [np.array(data, np.uint64) for data in beats], [
        np.array(cycles, np.int64) for cycles in beat_cycle
    ]
