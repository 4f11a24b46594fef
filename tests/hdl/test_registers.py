# SPDX-License-Identifier: Apache-2.0
"""How long the register front takes for its accesses, which the README of an export tells."""

import pytest
from amaranth.sim import Simulator

from coincid.hdl.axi import OKAY
from coincid.hdl.registers import READ_CYCLES, Registers, read_cycles_max, write_cycles_max
from coincid.model.contract import registers
from coincid.model.contract.parameters import Sensor

PAUSE_CYCLES = 60  # between two pairs of accesses
OFFSETS = range(-24, 30)  # cycles from a read to the write that starts a frame


async def waits_of(ctx, axi, begins):
    """Return the cycles for which accesses wait that begin in some cycles, by kind."""
    valid = {"write": (axi.awvalid, axi.wvalid), "read": (axi.arvalid,)}
    ready = {"write": axi.awready & axi.wready, "read": axi.arready}
    answer = {"write": axi.bvalid, "read": axi.rvalid}
    taken, waits, cycle = {}, {}, 0
    while len(waits) < len(begins):
        for kind, begin in begins.items():
            if cycle == begin:
                for signal in valid[kind]:
                    ctx.set(signal, 1)
            if kind in taken and kind not in waits and ctx.get(answer[kind]):
                waits[kind] = cycle - taken[kind] - 1
        takes = [k for k in begins if ctx.get(valid[k][0]) and ctx.get(ready[k])]
        await ctx.tick()
        for kind in takes:
            taken[kind] = cycle
            for signal in valid[kind]:
                ctx.set(signal, 0)
        cycle += 1
        assert cycle < 200
    return waits


def longest_cycles(sensor: Sensor) -> tuple[int, int]:
    """Return the most cycles for which a start and a read wait, whichever comes first."""
    dut, found = Registers(sensor), []
    axi = dut.s_axi
    address, value = registers.control("start")

    async def host(ctx):
        for port, given in ((axi.awaddr, address), (axi.wdata, value), (axi.araddr, address)):
            ctx.set(port, given)
        for port in (axi.bready, axi.rready):
            ctx.set(port, 1)
        ctx.set(axi.wstrb, 0xF)
        await ctx.tick().repeat(3)
        for offset in OFFSETS:
            begins = {"write": max(0, offset), "read": max(0, -offset)}
            found.append(await waits_of(ctx, axi, begins))
            assert ctx.get(axi.bresp) == OKAY
            ctx.set(dut.done, 1)  # the frame is over
            await ctx.tick()
            ctx.set(dut.done, 0)
            await ctx.tick().repeat(PAUSE_CYCLES)

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(host)
    simulator.run()
    write, read = (max(waits[kind] for waits in found) for kind in ("write", "read"))
    return write, read


@pytest.mark.parametrize("controller", [0, 1])
@pytest.mark.parametrize("streams", [1, 3])
def test_accesses_take_as_long_as_is_told_at_most(streams, controller):
    """A read that comes with a start takes exactly so long; a start less, by some cycles of a read."""
    sensor = Sensor(
        rows=4,
        cols=12,
        subgroup=(4, 4),
        phases=4,
        window_max=9,
        streams=streams,
        controller=controller,
    )
    write, read = longest_cycles(sensor)
    assert read == read_cycles_max(sensor)
    assert 0 <= write_cycles_max(sensor) - write < READ_CYCLES
    lone = Sensor(rows=4, cols=4, subgroup=(4, 4), phases=4, window_max=9, controller=0)
    assert read - read_cycles_max(lone) == write_cycles_max(sensor) - write_cycles_max(lone)
